"""The drivers of the boat's thrusters, a file each, named as `driver` in `[[thrusters]]` of the vehicle's file.

To add one: a file here with a function `open_actuator(settings, links)`, and its row in `OWN` of
`delfim/base/parts.py` (CONTRIBUTING.md, "How to add an actuator"). The supervisor opens it, too, for the dead-man.
"""

from typing import Any, Protocol

from delfim import config
from delfim.base import parts
from delfim.vehicle.links import Links, LoopInput
from delfim.vehicle.state import Actuation


class Actuator(Protocol):
    """A driver takes its rows of a command for all thrusters. No method waits, and only `stop` raises."""

    name: str  # as `driver` in the vehicle's file
    period_s: float | None  # how often its devices want to hear something; None: once per control cycle is enough
    inputs: tuple[LoopInput, ...]  # what its devices report

    def send(self, sent: Actuation, now_s: float) -> int: ...  # limited already; returns how many commands were not taken
    def repeat(self, now_s: float) -> int: ...  # called every `period_s`: the last command again; returns as `send`
    def stop(self) -> None: ...  # also after another process sent commands; raises OSError when the stop was not taken
    def disconnect(self, names: tuple[str, ...]) -> None: ...  # cuts the power of these thrusters for good, where it can
    def report(self) -> dict[str, object]: ...  # JSON-ready figures, empty where there are none


def open_actuator(name: str, settings: config.Vehicle, links: Links) -> Actuator:
    """Opens an actuator, and loads its file only then. Raises DelfimError."""
    actuator: Actuator = module(name, settings).open_actuator(settings, links)
    return actuator


def module(name: str, settings: config.Vehicle) -> Any:
    """The file of a driver. Raises PermanentFailure for a part's that cannot be imported."""
    return parts.module(settings.aboard, "driver", name)
