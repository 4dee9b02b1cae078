"""CAN: frames in and out, the DSOR protocol, the loopback bus, NMEA 2000, the proxy and the time service."""
