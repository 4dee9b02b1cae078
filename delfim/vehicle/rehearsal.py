"""Warm-up: the critical path without effect, shortly before navigation is due.

Between two cycles caches lose much of the path's code and data (docs/decisions/0002-warm-and-in-one-call.md). So the vehicle
has a twin: the same classes, the same code, state of its own, and a mirror for a socket. When a window opens the twin is
fed the vehicle's last message and does what the vehicle would. While the window waits, it repeats parts of that, because
the caches would get cold in waiting.
"""

from itertools import count, cycle
from typing import cast

import msgspec

from delfim.base.parts import OWN_NODES
from delfim.canproxy.dsor.messages import NAVIGATION_ID, NAVIGATION_PRIORITY, Navigation, Node, pack_navigation
from delfim.canproxy.dsor.protocol import Message, segments
from delfim.canproxy.socket import CanSocket, Many
from delfim.lines.forms import Form
from delfim.vehicle.build import build
from delfim.vehicle.links import Links, ReadableLine
from delfim.vehicle.loop import VehicleLoop
from delfim.vehicle.state import NoLog, State


class Rehearsal:
    """For `NavigationLoop.set_rehearsal`. Never raises, whatever navigation says."""

    def __init__(self, boat: VehicleLoop, outlets: tuple[CanSocket, ...], mirror: Many) -> None:
        """`outlets` are the sockets by which the actuators are commanded, `mirror` that of a socket like one of them."""
        state, clock, settings = State(), boat.clock, boat.helm.settings
        self._boat, self._outlets, self._tell = boat, outlets, mirror.send_many
        link = cast(CanSocket, mirror)
        navigation = msgspec.structs.replace(settings.navigation, sources=(OWN_NODES,), estimator=False)
        dsor = msgspec.structs.replace(settings, navigation=navigation)
        self._twin = build(dsor, clock, state, Links(lambda _, filters: link, _no_line), NoLog()).vehicle
        (self._source,) = self._twin.sources
        self._numbers, self._messages = count(), cycle([list[tuple[int, bytes]]()])
        self._parts = cycle((self._hear, self._command, *(outlet.rehearse for outlet in outlets)))

    def whole(self) -> None:
        """The path from end to end, sending included, with the last message heard. About 0.15 ms, the first time in a while."""
        heard = self._boat.state.navigation
        if heard is None:
            return
        self._messages = cycle([_frames(heard._replace(counter=next(self._numbers))) for _ in range(2)])  # repeats are ignored
        self._twin.follow(self._boat)
        self._tell(next(self._messages))
        self._twin.on_navigation(self._source)
        for outlet in self._outlets:
            outlet.rehearse()

    def part(self) -> None:
        """From the bus to the state, from there to the propellers' bytes, or through the kernel: in turns, about 10 us each."""
        next(self._parts)()

    def _hear(self) -> None:
        self._tell(next(self._messages))
        fix = self._source.read(self._twin.clock.monotonic_s())
        if fix is not None:
            self._twin.take(self._source, fix)

    def _command(self) -> None:
        self._twin.follow(self._boat)  # its tables and memory get as cold as its code
        self._twin.helm.steer(self._twin.clock.monotonic_s())


def _frames(navigation: Navigation) -> list[tuple[int, bytes]]:
    message = Message(NAVIGATION_PRIORITY, Node.NAVIGATION, Node.BROADCAST, NAVIGATION_ID, pack_navigation(navigation))
    return [(frame.arb, frame.data) for frame in segments(message, navigation.counter)]


class _NoLine:
    """A serial line that takes all data and gives none."""

    t_ns = 0

    def fileno(self) -> int:
        return -1

    def rebind(self) -> bool:
        return True

    def read(self) -> bytes:
        return b""

    def write(self, data: bytes) -> bool:
        return True


def _no_line(device: str, baud: int, form: Form = "8N1") -> ReadableLine:
    return _NoLine()
