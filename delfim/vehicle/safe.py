"""The safe state: both propellers off. The shortest file, on purpose."""

from delfim.vehicle.state import Actuation

STOP = Actuation(starboard_rpm=0.0, port_rpm=0.0, run=False)
