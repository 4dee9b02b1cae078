"""A mode that a hold interrupted, to go on with."""

from typing import NamedTuple

from delfim.modes import Mode
from delfim.vehicle.control.memory import Memory
from delfim.vehicle.state import Plan


class Paused(NamedTuple):
    mode: Mode
    memory: Memory
    plan: Plan | None
