"""What the boat is moved with, a file each, named as in `propulsion.actuators` of the vehicle's file.

To add an actuator: a file here with a function `open_actuator(settings, links)`, and its name in `ActuatorName` of
`delfim/config.py` (CONTRIBUTING.md, "How to add an actuator"). The supervisor opens it, too, for the dead-man.
"""

from importlib import import_module
from typing import Protocol

from delfim import config
from delfim.vehicle.links import Links
from delfim.vehicle.state import Actuation


class Actuator(Protocol):
    """Takes its part of what all are asked for. Nothing here waits, and but for `stop` nothing raises."""

    name: str  # as in `propulsion.actuators`

    def send(self, sent: Actuation, now_s: float) -> int: ...  # within value and rate already; how many commands were not taken
    def stop(self) -> None: ...  # whatever was sent before, and by another process; raises OSError where it was not taken
    def disconnect(self, sides: tuple[str, ...]) -> None: ...  # of these sides it takes the power, for good, where it can
    def report(self) -> dict[str, object]: ...  # JSON-ready figures, empty where there are none


def open_actuator(name: str, settings: config.Vehicle, links: Links) -> Actuator:
    """Its file is loaded when it is asked for. Raises DelfimError."""
    actuator: Actuator = import_module(f"{__name__}.{name}").open_actuator(settings, links)
    return actuator
