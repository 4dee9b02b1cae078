"""NMEA 0183: sentences of sensors to values, values to navigation, and navigation to sentences (docs/nmea0183.md). No sockets,
no clock."""
