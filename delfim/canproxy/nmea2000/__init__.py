"""NMEA 2000: navigation from off-the-shelf sensors. Frames in, `delfim.messages.Navigation` out; no sockets, time handed in.

An NMEA 2000 identifier is SAE J1939's: priority 3 bits, PGN 18 bits, source address 8 bits. PGNs below PDU format 240 carry a
destination in their low byte; the ones read here are all broadcast. Messages of up to 8 bytes are one frame, longer ones are
fast packets. Field layouts are those documented by the canboat project; the largest three values of a field mean not
available, error and reserved, and all arrive as None.

It only listens: it claims no address, answers no requests and sends nothing.
"""
