"""What a part of the boat's own adds to the loop, where the vehicle's file has it: its row names the function that opens it."""

from collections.abc import Iterator
from typing import NamedTuple, Protocol

from delfim import config
from delfim.base.clock import Clock
from delfim.vehicle import console
from delfim.vehicle.grex import Guest
from delfim.vehicle.helm.helm import Helm
from delfim.vehicle.links import Links, LoopInput
from delfim.vehicle.state import State, StateLog


class PartWatch(Protocol):
    """It looks at the boat ten times a second, before the failsafe does. Nothing of it raises."""

    def look(self, helm: Helm, now_s: float) -> None: ...
    def report(self, now_s: float) -> dict[str, object]: ...  # for the console, JSON-ready


class Hand(LoopInput, Protocol):
    """An operator aboard: a hand-set, a kill switch. It is read as a sensor is, and orders in the words of a console, so that
    every order goes through the one door, into the log, and into a replay."""

    name: str  # the operator's

    def orders(
        self, state: State, now_s: float
    ) -> Iterator[console.Commands]: ...  # each is carried out before the next is asked


class OpenedWith(NamedTuple):
    """What a part is opened with."""

    settings: config.Vehicle
    clock: Clock
    state: State
    links: Links
    log: StateLog
    guest: Guest


class Added(NamedTuple):
    """What a part adds."""

    watch: PartWatch | None = None
    inputs: tuple[LoopInput, ...] = ()
    hands: tuple[Hand, ...] = ()
