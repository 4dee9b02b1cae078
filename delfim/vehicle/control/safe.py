"""The safe state: all thrusters off, however many there are. The shortest file, on purpose."""

from delfim.vehicle.state import Wanted

STOP = Wanted(run=False)
