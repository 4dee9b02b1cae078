"""The boat's own navigation node: a DSOR segmented message (navcan.c in the thesis)."""

from delfim import config
from delfim.base.errors import BusError, FormatError
from delfim.canproxy.dsor.messages import NAVIGATION_ID, Navigation, Node, unpack_navigation
from delfim.canproxy.dsor.protocol import Message, message_filter
from delfim.canproxy.dsor.receiver import Receiver
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.vehicle.links import FRAMES_PER_READ, Links
from delfim.vehicle.navigation.fixes import Fix
from delfim.vehicle.state import State

LOOKS = 8  # polls for the next frame of a message, 20 us in all: many adapters deliver frames in bursts


class DsorNavigation:
    """The boat's own navigation node."""

    name = "dsor"

    def __init__(self, socket: CanSocket, state: State, node: int = Node.VEHICLE) -> None:
        self.input, self._state = socket, state
        self.heard_s = -1e9
        self._last: Navigation | None = None
        self._counter = 0  # of the message that follows it
        self._receive_many = socket.receive_many
        self._receiver = Receiver(node, lambda message: message.id == NAVIGATION_ID)

    def read(self, now_s: float) -> Fix | None:
        """Read the next complete message, None when there is none yet. Later frames stay readable. Malformed ones are
        counted."""
        feed, fix, looks = self._receiver.feed, None, 0
        for _ in range(FRAMES_PER_READ):
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
            navigation = unpack_navigation(message.data)
        except FormatError:
            self._state.count("navigation_malformed")
            return None
        if (navigation.counter - self._counter) & 0x80:
            self._stepped_back(navigation, now_s)
        self._last, self._counter = navigation, navigation.counter + 1
        return tuple.__new__(Fix, (navigation, message.t_ns, now_s))  # half the time of Fix(...)

    def _stepped_back(self, navigation: Navigation, now_s: float) -> None:
        """Whether a message does not come after the one before, whichever of two nodes sent it. A node that repeats itself is
        one."""
        if self._last is not None and navigation != self._last:
            self._state.count("navigation_twice")
            self._state.twice.append(now_s)

    def report(self, now_s: float) -> dict[str, object]:
        return dict(self._receiver.errors)


def open_source(settings: config.Vehicle, links: Links, state: State) -> DsorNavigation:
    navigation = CanAddress(*message_filter(source=Node.NAVIGATION))
    return DsorNavigation(links.bus(settings.can.interface, (navigation,)), state, settings.can.node)
