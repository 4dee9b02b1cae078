"""NMEA 2000: frames to values and back, and the device that the boat is on the bus; no sockets, time handed in.

An NMEA 2000 identifier is SAE J1939's: priority 3 bits, PGN 18 bits, source address 8 bits. PGNs below PDU format 240 carry a
destination in their low byte; the ones read here are all broadcast. Messages of up to 8 bytes are one frame, longer ones are
fast packets. Field layouts are those documented by the canboat project; the largest three values of a field mean not
available, error and reserved, and all arrive as None.

`device.py` claims an address and says who the boat is. What the boat makes of the values, and the process that carries
the device to the bus, are in `delfim/parts/nmea2000`.
"""
