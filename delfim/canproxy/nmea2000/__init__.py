"""NMEA 2000: navigation from off-the-shelf sensors, and the boat as a device of their bus; no sockets, time handed in.

An NMEA 2000 identifier is SAE J1939's: priority 3 bits, PGN 18 bits, source address 8 bits. PGNs below PDU format 240 carry a
destination in their low byte; the ones read here are all broadcast. Messages of up to 8 bytes are one frame, longer ones are
fast packets. Field layouts are those documented by the canboat project; the largest three values of a field mean not
available, error and reserved, and all arrive as None.

`source.py` only listens: frames in, `delfim.canproxy.dsor.messages.Navigation` out. `device.py` claims an address and says who
the boat is; `delfim/parts/nmea2000/nmea2000d.py` carries it to the bus, in a process of its own.
"""
