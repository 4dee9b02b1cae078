"""DroneCAN (UAVCAN v0) on classic CAN: motor controllers, servos, GNSS receivers, batteries. Frames in, values out, and the
other way round; no sockets, time handed in.

A message has a 16-bit type; its fields follow each other without alignment (`fields`). A transfer of one message is one
frame, or several with a checksum (`transfers`). `datatypes` has a row for each type that is used here, `nodenumbers` the
numbers of devices that ask for one. Source: the DroneCAN specification, chapters 3 (serialization), 4.1 (transport) and 5.3
(node numbers).

It sends and reads broadcasts. Of the requests of one node to another `nodeservices` answers those for a node's description and
for a restart; parameters and firmware of devices are not here.
"""
