"""The safe state: all thrusters off, however many there are. The shortest file, on purpose."""

from delfim.vehicle.state import Actuation

STOP = Actuation(thrust=(), angle_rad=(), run=False)
