"""NMEA 0183: sentences to values, and navigation to sentences (docs/nmea0183.md); no sockets, no clock. What the boat makes of
the values is in `delfim/parts/nmea0183`."""
