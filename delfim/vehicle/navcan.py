"""Navigation from the bus (navcan.c in the thesis): frames in, one complete navigation message out.

Two sources exist and speak through the same `read`: the boat's own navigation node (a DSOR segmented message) and an
NMEA 2000 bus of off-the-shelf sensors. Sources stand in order of preference; a message of a less preferred source counts
only while every better one is silent.
"""

from typing import NamedTuple, Protocol

from delfim.canproxy.dsor import Message, Receiver
from delfim.canproxy.nmea2000 import Nmea2000Source
from delfim.canproxy.socket import CanSocket
from delfim.errors import BusError, FormatError
from delfim.messages import NAVIGATION_ID, Navigation, Node, unpack_navigation
from delfim.vehicle.state import State

FRAMES_PER_READ = 64  # bounds one call on a flooded bus; what is left stays readable
READS = FRAMES_PER_READ
LOOKS = 8  # for the next frame of a message, 20 us in all: many an adapter hands over its frames in a burst


class Fix(NamedTuple):
    """One navigation message and when its last frame arrived."""

    navigation: Navigation
    t0_ns: int  # kernel's stamp
    received_s: float  # monotonic


class Source(Protocol):
    """A navigation input. `read` never raises and never waits."""

    name: str
    socket: CanSocket
    heard_s: float

    def read(self, now_s: float) -> Fix | None: ...


class DsorNavigation:
    """The boat's own navigation node."""

    name = "dsor"

    def __init__(self, socket: CanSocket, state: State) -> None:
        self.socket, self._state = socket, state
        self.heard_s = -1e9
        self._receive_many = socket.receive_many
        self._receiver = Receiver(Node.VEHICLE, lambda message: message.id == NAVIGATION_ID)
        self.expire, self.errors = self._receiver.expire, self._receiver.errors

    def read(self, now_s: float) -> Fix | None:
        """The next complete message, None when there is none yet. What is behind it stays readable. Malformed ones are
        counted."""
        feed, fix, looks = self._receiver.feed, None, 0
        for _ in range(READS):
            try:
                frames = self._receive_many()
            except BusError:
                self._state.count("navigation_bus_errors")
                break
            for frame in frames:  # no more than a message has, so that no two can be complete
                message = feed(frame, now_s)
                if message is not None:
                    fix = self._fix(message, now_s) or fix
            if frames:
                looks = 0
            elif looks == LOOKS or not self._receiver.is_waiting:
                break
            else:
                looks += 1
            if fix is not None:
                break
        return fix

    def _fix(self, message: Message, now_s: float) -> Fix | None:
        self.heard_s = now_s
        try:
            return Fix(unpack_navigation(message.data), message.t_ns, now_s)
        except FormatError:
            self._state.count("navigation_malformed")
            return None


class Nmea2000Navigation:
    """Off-the-shelf sensors."""

    name = "nmea2000"

    def __init__(self, socket: CanSocket, source: Nmea2000Source, state: State) -> None:
        self.socket, self._source, self._state = socket, source, state
        self.heard_s = -1e9

    def read(self, now_s: float) -> Fix | None:
        """As `DsorNavigation.read`: a fix whenever the chosen position source spoke."""
        fix = None
        for _ in range(FRAMES_PER_READ):
            try:
                frame = self.socket.receive()
            except BusError:
                self._state.count("nmea2000_bus_errors")
                break
            if frame is None:
                break
            navigation = self._source.feed(frame, now_s)
            if navigation is not None:
                fix = Fix(navigation, frame.t_ns, now_s)
                self.heard_s = now_s
        return fix


def preferred(source: Source, sources: tuple[Source, ...], now_s: float, stale_s: float) -> bool:
    """Whether every source before this one is silent."""
    for better in sources:
        if better is source:
            return True
        if now_s - better.heard_s <= stale_s:
            return False
    return True
