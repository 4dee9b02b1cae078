"""What a part of the boat's own adds to the loop, where the vehicle's file has it: its row names the function that opens it."""

from typing import NamedTuple, Protocol

from delfim import config
from delfim.base.clock import Clock
from delfim.vehicle.helm import Helm
from delfim.vehicle.links import Links, LoopInput
from delfim.vehicle.state import State, StateLog


class PartWatch(Protocol):
    """It looks at the boat ten times a second, before the failsafe does. Nothing of it raises."""

    def look(self, helm: Helm, now_s: float) -> None: ...
    def report(self, now_s: float) -> dict[str, object]: ...  # for the console, JSON-ready


class OpenedWith(NamedTuple):
    """What a part is opened with."""

    settings: config.Vehicle
    clock: Clock
    state: State
    links: Links
    log: StateLog


class Added(NamedTuple):
    """What a part adds."""

    watch: PartWatch
    inputs: tuple[LoopInput, ...] = ()
