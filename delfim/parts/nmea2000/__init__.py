"""NMEA 2000: navigation and sensors of a ship's bus, and the boat as a device of it."""
