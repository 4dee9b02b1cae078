"""The critical path gone through without effect, shortly before navigation is due.

Between two cycles a processor forgets much of what the path needs (docs/decisions/0002-warm-and-in-one-call.md). So the vehicle
has a twin: the same classes, the same code, state of its own, and links that lead nowhere. When a window opens the twin is
shown what the vehicle heard last, and does what the vehicle would. While the window waits, it does parts of that again and
again: waiting alone would let them get cold.
"""

from collections.abc import Sequence
from itertools import count, cycle
from typing import cast

from delfim.canproxy.dsor import Message, segments
from delfim.canproxy.socket import CanSocket
from delfim.frames import Frame
from delfim.messages import NAVIGATION_ID, NAVIGATION_PRIORITY, Navigation, Node, pack_navigation
from delfim.vehicle.grex import Guest
from delfim.vehicle.loop import Vehicle
from delfim.vehicle.navcan import DsorNavigation
from delfim.vehicle.propulsion import Propulsion
from delfim.vehicle.state import State


class Rehearsal:
    """For `NavigationLoop.set_rehearsal`. Never raises for what navigation says."""

    def __init__(self, boat: Vehicle, outlet: CanSocket) -> None:
        """`outlet` is the socket by which the propulsion is commanded."""
        state, clock, settings = State(), boat.clock, boat.settings
        self._boat, self._outlet, self._stage = boat, outlet, _Stage()
        stage = cast(CanSocket, self._stage)
        self._source = DsorNavigation(stage, state)
        propulsion = Propulsion(stage, settings.propulsion, state)
        self._twin = Vehicle(settings, clock, state, (self._source,), propulsion, Guest(state, clock), _NoLog())
        self._numbers, self._messages = count(), cycle(list[list[Frame]]([[]]))
        self._parts = cycle((self._hear, self._command, outlet.rehearse))

    def whole(self) -> None:
        """The path from end to end, sending included, with what was heard last. About 0.15 ms, the first time in a while."""
        heard = self._boat.state.navigation
        if heard is None:
            return
        self._messages = cycle([_frames(heard._replace(counter=next(self._numbers))) for _ in range(2)])  # one twice is no news
        self._twin.follow(self._boat)
        self._stage.frames = next(self._messages)
        self._twin.on_navigation(self._source)
        self._outlet.rehearse()

    def part(self) -> None:
        """From the bus to the state, from there to the propellers' bytes, or through the kernel: in turns, about 10 us each."""
        next(self._parts)()

    def _hear(self) -> None:
        self._stage.frames = next(self._messages)
        fix = self._source.read(self._twin.clock.monotonic_s())
        if fix is not None:
            self._twin.take(self._source, fix)

    def _command(self) -> None:
        self._twin.steer(self._twin.clock.monotonic_s())


def _frames(navigation: Navigation) -> list[Frame]:
    data = pack_navigation(navigation)
    return segments(Message(NAVIGATION_PRIORITY, Node.NAVIGATION, Node.BROADCAST, NAVIGATION_ID, data), navigation.counter)


class _Stage:
    """A socket with what is to be received, that sends nowhere."""

    def __init__(self) -> None:
        self.frames: list[Frame] = []

    def receive_many(self) -> list[Frame]:
        frames, self.frames = self.frames, []
        return frames

    def send_many(self, messages: Sequence[tuple[int, bytes]]) -> int:
        return 0


class _NoLog:
    """A twin leaves no record."""

    def write(self, state: State, now_s: float) -> None: ...
    def note(self, text: str) -> None: ...
    def reason(self) -> str:
        return ""

    def close(self) -> None: ...
