"""CAN: frames in and out, the loopback bus, the proxy; the protocols DSOR, NMEA 2000 and DroneCAN, and the time on the bus."""
