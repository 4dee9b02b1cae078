"""The DSOR higher-layer protocol: messages longer than a frame, from node to node of the boat (thesis 5.2.6 and 5.3.3).

A message is a header frame and body frames. Between two nodes each frame is acknowledged before the next one is sent
(idle RQ); a broadcast message goes out back to back and is lost when a frame of it is lost. `docs/dsor.md` shows every bit.

`protocol` has the frames, `receiver` and `sender` the state machines, `sockets` the sockets for programs.
"""
