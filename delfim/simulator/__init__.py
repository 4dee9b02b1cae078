"""Simulation of the boat: a model of the hull, the other CAN nodes, a guest computer, in lock step and in real time."""
