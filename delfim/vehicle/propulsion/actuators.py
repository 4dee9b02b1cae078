"""What drivers of thrusters keep, and how one is opened: by the row of its part, named as `driver` in `[[thrusters]]`
of the vehicle's file (CONTRIBUTING.md, "A part is a folder"). The supervisor opens it, too, for the dead-man.

A row of a thruster that is `reversed` is commanded, and reports, with the other sign. What a driver hears of a thruster
goes into `State.thrusters` under the row's name; `refuses` there says why it does not obey, which is a trouble.
"""

from typing import Any, Protocol

from delfim import config
from delfim.base import parts
from delfim.vehicle.links import Links, LoopInput
from delfim.vehicle.state import Actuation


class Actuator(Protocol):
    """A driver takes its rows of a command for all thrusters. No method waits, and only `stop` raises. One whose motors turn
    only once they were heard has `begin(state, now_s)`, too, which says so in the state."""

    name: str  # as `driver` in the vehicle's file
    period_s: float | None  # how often its devices want to hear something; None: once per control cycle is enough
    inputs: tuple[LoopInput, ...]  # what its devices report

    def send(self, sent: Actuation, now_s: float) -> int: ...  # limited already; returns how many commands were not taken
    def repeat(self, now_s: float) -> int: ...  # called every `period_s`: the last command again; returns as `send`
    def stop(self) -> None: ...  # also after another process sent commands; raises OSError when the stop was not taken
    def disconnect(self, names: tuple[str, ...]) -> None: ...  # cuts the power of these thrusters for good, where it can
    def report(self) -> dict[str, object]: ...  # JSON-ready figures, empty where there are none


def open_actuator(name: str, settings: config.Vehicle, links: Links) -> Actuator:
    """Opens an actuator, and loads its module only then. Raises DelfimError."""
    actuator: Actuator = module(name, settings).open_actuator(settings, links)
    return actuator


def module(name: str, settings: config.Vehicle) -> Any:
    """The module of a driver. Raises PermanentFailure for a part's that cannot be imported."""
    return parts.module(settings.aboard, "driver", name)
