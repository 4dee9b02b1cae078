"""Simulation in real time: the nodes on their buses, instruments on lines, a model in another program, faults by a socket."""
