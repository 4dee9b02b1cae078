"""Operators aboard: a hand-set, a kill switch. They are read as sensors are and order in the words of a console, so that
every order goes through the one door, into the log, and into a replay.
"""

from collections.abc import Iterator
from typing import Protocol

from delfim.vehicle import console
from delfim.vehicle.links import LoopInput
from delfim.vehicle.state import State


class Hand(LoopInput, Protocol):
    """`name` is the operator's. The caller carries out each order before it asks for the next, which may depend on it."""

    name: str

    def orders(self, state: State, now_s: float) -> Iterator[console.Commands]: ...


def change(name: str, reason: str, state: State) -> Iterator[console.Kill]:
    """The order of a switch that says kill for this reason, or does not (empty), if that is new."""
    if bool(reason) != (name in state.killed.held):
        yield console.Kill(name, reason, "on") if reason else console.Kill(name, switch="off")
