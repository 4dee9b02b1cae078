"""A vehicle on a real bus (canloop) with a clock that is handed in: send what nodes send, see what the propellers are told.

Fixtures for the folders that need a boat."""

import math
import os
from collections.abc import Callable, Iterator
from itertools import count

import pytest

from delfim import config
from delfim.base import tables
from delfim.base.clock import ManualClock
from delfim.base.cooperative import SLICE, Sliced
from delfim.base.frames import Frame
from delfim.canproxy.dsor import messages
from delfim.canproxy.dsor.messages import BatteriesStatus, Fault, Navigation, Node, PropellerCommand, PropellerStatus, Status
from delfim.canproxy.dsor.protocol import Message, segments
from delfim.canproxy.opening import open_bound
from delfim.canproxy.socket import ANYTHING, CanAddress, CanSocket
from delfim.lines.serialline import Form
from delfim.simulator.line import LockstepLine
from delfim.vehicle.build import build
from delfim.vehicle.links import Links
from delfim.vehicle.plans import fence
from delfim.vehicle.state import State

WELL = Fault(0)
MOST_AT_ONCE = 2 * fence.LOOKS + SLICE  # comparisons between two yields: those of one question, with the zone that was too much
_names = count()

BEYOND = ("accuracy_m", "corrections_s")  # what other sources tell, and this one has no room for


class Records:
    """A log that keeps the records it is given."""

    def __init__(self) -> None:
        self.modes: list[str] = []
        self.notes: list[str] = []
        self.why = ""

    def write(self, state: State, now_s: float) -> None:
        self.modes.append(state.mode.name)

    def note(self, text: str) -> None:
        self.notes.append(text)

    def reason(self) -> str:
        return self.why

    def close(self) -> None:
        pass


class Boat:
    """The vehicle, the bus it is on, and the other nodes' end of it."""

    def __init__(self, settings: config.Vehicle) -> None:
        name = f"canloop:test-{os.getpid()}-{next(_names)}"
        self.clock = ManualClock(monotonic_s=1000.0)
        self.state, self.log = State(), Records()
        self.sockets = [open_bound(settings.can, name, (ANYTHING,))]

        def open_bus(_: str, filters: tuple[CanAddress, ...]) -> CanSocket:
            self.sockets.append(open_bound(settings.can, name, filters))
            return self.sockets[-1]

        self.nodes, self.lines = self.sockets[0], dict[str, LockstepLine]()

        def open_line(device: str, baud: int, form: Form = "8N1") -> LockstepLine:
            return self.lines.setdefault(device, LockstepLine(self.clock))

        links = Links(open_bus, open_line)
        self.vehicle, (self.sensor, *_), self.hands, self.outlets = build(settings, self.clock, self.state, links, self.log)
        self.guest, (self.source,) = self.vehicle.guest, self.vehicle.sources
        self._number = 0

    def navigate(self, **changes: object) -> bool:
        """A navigation message on the bus, and the loop's turn. By default: at rest off Lisbon, heading north, rocking."""
        self._number += 1
        rocking_rad = 0.01 * (self._number % 2)
        place, utc_ns = (math.radians(38.6925), math.radians(-9.215)), self.clock.time_ns()
        still = Navigation(utc_ns, *place, 0.0, 0.0, 0.0, 0.0, rocking_rad, 0.0, 3, 9, 0.9, self._number & 255)
        data = messages.pack_navigation(still._replace(**changes))
        self.send(data, Node.NAVIGATION, messages.NAVIGATION_ID)
        is_taken = self.vehicle.on_navigation(self.source)
        if self.state.navigation is not None and (told := {name: changes[name] for name in BEYOND if name in changes}):
            self.state.navigation = self.state.navigation._replace(**told)
        return is_taken

    def send(self, data: bytes, source: Node, identifier: int) -> None:
        message = Message(messages.NAVIGATION_PRIORITY, source, Node.BROADCAST, identifier, data)
        for frame in segments(message, self._number):
            self.nodes.sendmsg(frame)

    def report(self, status: Status = Status.GOOD, faults: Fault = WELL, silent: tuple[str, ...] = ()) -> None:
        """Every node reports its health, the starboard propeller as told; those named in `silent` do not. Propellers obey."""
        rpm = [round(1200 * part) for part in self.state.actuation.thrust]
        starboard = PropellerStatus(status, faults, rpm[0], 1.0, 20, 0)
        port = PropellerStatus(Status.GOOD, WELL, rpm[1], 1.0, 20, 0)
        batteries = messages.pack_batteries_status(BatteriesStatus(Status.GOOD, WELL, 48.0, 1.0, 0.9, 20))
        reports = {
            Node.PROPELLER_STARBOARD: messages.pack_propeller_status(starboard),
            Node.PROPELLER_PORT: messages.pack_propeller_status(port),
            Node.BATTERIES_STARBOARD: batteries,
            Node.BATTERIES_PORT: batteries,
        }
        for node, data in reports.items():
            if node.name.lower() not in silent:
                self.nodes.sendmsg(Frame(messages.sysstat_arb(node), data))
        if "gps" not in silent:
            gps = messages.GpsStatus(Status.GOOD, WELL, 3, 9, 0.9, self.clock.time_ns())
            self.send(messages.pack_gps_status(gps), Node.GPS, messages.GPS_SYSSTAT_ID)
        self.vehicle.on_sensor(self.sensor)

    def heard(self) -> list[Frame]:
        """What the vehicle has sent since the last call."""
        frames = []
        while (frame := self.nodes.receive()) is not None:
            frames.append(frame)
        return frames

    def propellers(self) -> tuple[PropellerCommand, PropellerCommand]:
        """The newest commands to starboard and port."""
        newest = {frame.arb: frame.data for frame in self.heard()}
        return (
            messages.unpack_propeller_command(newest[messages.PROPELLER_STARBOARD]),
            messages.unpack_propeller_command(newest[messages.PROPELLER_PORT]),
        )

    def ready(self) -> None:
        """Everything reports, navigation comes: fit to leave idle."""
        self.report()
        assert self.navigate()
        self.heard()

    def pass_time(self, seconds: float, *, navigation: bool = True) -> None:
        """Cycles at 5 Hz with sysstat, watchdog at 10 Hz."""
        for tick in range(round(seconds * 10)):
            self.clock.advance(0.1)
            if navigation and tick % 2:
                self.navigate()
            if tick % 10 == 0:
                self.report()
            self.attend()
            self.vehicle.on_watchdog()

    def attend(self) -> None:
        """The operators aboard are read, and their orders carried out."""
        for hand in self.hands:
            self.vehicle.on_sensor(hand)
            for order in hand.orders(self.state, self.clock.monotonic_s()):
                self.vehicle.on_command(order, hand.name)


@pytest.fixture
def make_boat() -> Iterator[Callable[..., Boat]]:
    """Boats from tables of a vehicle's file: `make_boat(log=config.LogTable(required=False))`."""
    boats = []

    def make(**tables: tables.Table) -> Boat:
        boats.append(Boat(config.Vehicle(boat=config.BoatTable(name="test"), **tables)))
        return boats[-1]

    yield make
    for boat in boats:
        for socket in boat.sockets:
            socket.close()


@pytest.fixture
def boat(make_boat: Callable[..., Boat]) -> Boat:
    return make_boat()


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """What each slice of what takes its time has compared, in comparisons."""
    spent: list[int] = []
    step = Sliced.step

    def counting(self: Sliced[object], most: int = SLICE) -> bool:
        before = self.spent
        is_done = step(self, most)
        spent.append(self.spent - before)
        return is_done

    monkeypatch.setattr(Sliced, "step", counting)
    return spent
