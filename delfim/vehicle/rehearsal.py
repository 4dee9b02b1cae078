"""The critical path gone through without effect, shortly before navigation is due.

Between two cycles a processor forgets much of what the path needs (docs/decisions/0002-warm-and-in-one-call.md). So the vehicle
has a twin: the same classes, the same code, state of its own, and links that lead nowhere. When a window opens the twin is
shown what the vehicle heard last, and does what the vehicle would.
"""

from collections.abc import Sequence
from typing import cast

from delfim.canproxy.dsor import Message, segments
from delfim.canproxy.socket import CanSocket
from delfim.frames import Frame
from delfim.messages import NAVIGATION_ID, NAVIGATION_PRIORITY, Node, pack_navigation
from delfim.vehicle.grex import Guest
from delfim.vehicle.loop import Vehicle
from delfim.vehicle.navcan import DsorNavigation
from delfim.vehicle.propulsion import Propulsion
from delfim.vehicle.state import State


class Rehearsal:
    """Called when a window opens. Takes about 0.15 ms and never raises for what navigation says."""

    def __init__(self, boat: Vehicle, outlet: CanSocket) -> None:
        """`outlet` is the socket by which the propulsion is commanded."""
        state, clock, settings = State(), boat.clock, boat.settings
        self._boat, self._stage = boat, _Stage(outlet)
        stage = cast(CanSocket, self._stage)
        self._source = DsorNavigation(stage, state)
        propulsion = Propulsion(stage, settings.propulsion, state)
        self._twin = Vehicle(settings, clock, state, (self._source,), propulsion, Guest(state, clock), _NoLog())
        self._number = 0

    def __call__(self) -> None:
        boat, twin = self._boat, self._twin
        heard = boat.state.navigation
        if heard is None:
            return
        self._number += 1
        last = heard._replace(counter=self._number & 0xFF)
        message = Message(NAVIGATION_PRIORITY, Node.NAVIGATION, Node.BROADCAST, NAVIGATION_ID, pack_navigation(last))
        self._stage.frames = segments(message, self._number)
        twin.follow(boat)
        twin.on_navigation(self._source)


class _Stage:
    """A socket with what is to be received, that sends nowhere."""

    def __init__(self, outlet: CanSocket) -> None:
        self.frames: list[Frame] = []
        self._rehearse = outlet.rehearse

    def receive_many(self) -> list[Frame]:
        frames, self.frames = self.frames, []
        return frames

    def send_many(self, messages: Sequence[tuple[int, bytes]]) -> int:
        self._rehearse()
        return 0


class _NoLog:
    """A twin leaves no record."""

    def write(self, state: State, now_s: float) -> None: ...
    def note(self, text: str) -> None: ...
    def reason(self) -> str:
        return ""

    def close(self) -> None: ...
