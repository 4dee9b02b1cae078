"""The runtime, the supervisor and the daemons around the vehicle."""
