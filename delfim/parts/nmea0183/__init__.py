"""NMEA 0183: navigation and sensors of a ship's instruments on serial lines and the network."""
