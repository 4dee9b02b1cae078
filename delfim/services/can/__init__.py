"""The daemons of the CAN buses: cantcpd, canzlogd, canip, logd, router, and the interfaces set up."""
