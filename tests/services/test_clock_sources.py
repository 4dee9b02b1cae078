"""The keeper of the clock on a boat: its sources as they come, a kernel that refuses, another keeper, and the words for it."""

import logging
from collections import deque

import msgspec
import pytest

from delfim.base.clock import MADE_NS, ManualClock
from delfim.base.errors import BusError
from delfim.base.frames import Frame, standard
from delfim.base.modes import Mode
from delfim.canproxy.dsor.messages import TIME, TIME_FRAME, Navigation, time_frame
from delfim.canproxy.nmea2000.pgns import GnssPosition, PositionRapid, SystemTime, encode
from delfim.parts.nmea2000.combining import Nmea2000Source
from delfim.parts.nmea2000.table import Nmea2000
from delfim.services.clock.discipline import ENOUGH
from delfim.services.clock.sources import OURS, ClockKeeping
from delfim.vehicle.state import State

START_NS = MADE_NS + 300 * 86_400_000_000_000  # UTC at monotonic zero
FIX = Navigation(0, 0.67, -0.16, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 3, 9, 0.8, 0)


class Bus:
    """The socket of time frames."""

    def __init__(self) -> None:
        self.frames: deque[Frame] = deque()
        self.failed = False

    def receive(self) -> Frame | None:
        if self.failed:
            raise BusError("the bus is gone")
        return self.frames.popleft() if self.frames else None


class Kernel:
    """A kernel's clock in memory: the clock that the whole test runs by."""

    def __init__(self, clock: ManualClock) -> None:
        self._clock, self.slews = clock, list[float]()
        self.is_disciplined, self.refuses = False, False

    def disciplined(self) -> bool:
        return self.is_disciplined

    def step(self, by_s: float) -> None:
        if self.refuses:
            raise PermissionError(1, "Operation not permitted")
        self._clock.step(by_s)

    def slew(self, by_s: float) -> None:
        self.slews.append(by_s)


class Boat:
    def __init__(
        self, why_not: str = "", battery_ns: int | None = None, time_ns: int = 0, time_frame: int = TIME_FRAME
    ) -> None:
        self.clock = ManualClock(monotonic_s=50.0, time_ns=time_ns)
        self.kernel, self.bus, self.state = Kernel(self.clock), Bus(), State(source="dsor")
        self.steps: list[tuple[float, str]] = []
        told = lambda by_s, source: self.steps.append((by_s, source))  # noqa: E731
        self.keeping = ClockKeeping(self.kernel, self.clock, why_not, self.bus, told, battery_ns, time_frame)  # type: ignore[arg-type]

    def second(self, *, frame: Frame | None = None, navigation: Navigation | None = None) -> None:
        self.clock.advance(1.0)
        if frame is not None:
            self.bus.frames.append(frame._replace(t_ns=self.clock.time_ns() - 400_000_000))
        if navigation is not None:
            self.state.navigation_s = self.clock.monotonic_s() - 0.1
            self.state.navigation = navigation
        self.state.computer = self.state.computer._replace(clock=self.keeping.look(self.state))

    def true_ns(self, ago_s: float) -> int:
        return START_NS + round((self.clock.monotonic_s() + 1.0 - ago_s) * 1e9)

    def heard(self, seconds: int) -> None:
        """Time frames of another computer: they come 0.4 s before a look."""
        for _ in range(seconds):
            self.second(frame=Frame(TIME_FRAME, TIME.pack(self.true_ns(0.4))))

    def navigated(self, seconds: int, fix: int = 3) -> None:
        """Navigation messages: they come 0.1 s before a look."""
        for _ in range(seconds):
            self.second(navigation=FIX._replace(utc_ns=self.true_ns(0.1), fix=fix))

    @property
    def off_s(self) -> float:
        """How wrong the computer's clock is."""
        return (self.clock.time_ns() - START_NS) / 1e9 - self.clock.monotonic_s()

    @property
    def told(self):
        return self.state.computer.clock


def test_time_frames_set_a_clock_that_was_never_set(caplog):
    caplog.set_level(logging.INFO)
    boat = Boat()
    boat.heard(20)
    assert abs(boat.off_s) < 1e-6
    ((by_s, source),) = boat.steps
    assert by_s == pytest.approx(START_NS / 1e9, abs=60.0)
    assert source == "the time frame"
    assert boat.told.kept == OURS
    assert boat.told.source == "the time frame"
    assert boat.told.off_s == pytest.approx(0.0, abs=1e-6)
    assert boat.kernel.slews == pytest.approx([0.0, 0.0], abs=1e-6)
    assert [each.message for each in caplog.records if "stepped" in each.message] == [
        f"clock: stepped by {by_s:+.3f} s to the time of the time frame"
    ]


def test_the_time_frame_of_another_vehicle_sets_nothing():
    boat = Boat(time_frame=time_frame(0xD0))
    boat.heard(20)
    assert (boat.steps, boat.told.source) == ([], "")


def test_so_does_navigation_with_a_fix():
    boat = Boat()
    boat.navigated(20, fix=0)
    assert boat.steps == []
    boat.navigated(ENOUGH)
    assert [source for _, source in boat.steps] == ["navigation (dsor)"]
    assert abs(boat.off_s) < 1e-6


@pytest.mark.parametrize("pgn", [129029, 126992])
def test_so_does_nmea_2000(pgn):
    boat, source = Boat(), Nmea2000Source(Nmea2000(), stale_s=1.0)
    boat.state.source = "nmea2000"
    for number in range(20):
        now_s, utc_ns = boat.clock.monotonic_s() + 0.9, boat.true_ns(0.1)
        alone = (GnssPosition(utc_ns, 0.67, -0.16, 1, 9, 0.8),)
        for message in alone if pgn == 129029 else (SystemTime(utc_ns), PositionRapid(0.67, -0.16)):
            for frame in encode(message, 3, number % 8):
                navigation = source.feed(frame, now_s)
        boat.second(navigation=navigation)
    assert [source for _, source in boat.steps] == ["navigation (nmea2000)"]
    assert abs(boat.off_s) < 2e-4, "the bus counts tenths of milliseconds"


def test_a_navigation_message_without_time_or_that_came_before_is_none():
    boat = Boat()
    boat.navigated(1)
    for _ in range(20):
        boat.second()
    for _ in range(20):
        boat.second(navigation=FIX._replace(utc_ns=0))
    assert boat.steps == []
    assert boat.told.off_s is None


@pytest.mark.parametrize(
    "frame",
    [
        Frame(TIME_FRAME, TIME.pack(START_NS), sent_here=True),
        Frame(TIME_FRAME, bytes(7)),
        Frame(standard(0x0C1), TIME.pack(START_NS)),
    ],
)
def test_the_computers_own_and_other_frames_tell_no_time(frame):
    boat = Boat()
    for _ in range(20):
        boat.second(frame=frame)
    assert boat.steps == []
    assert boat.told.source == ""


def test_a_bus_that_fails_or_floods_costs_nothing_but_time():
    boat = Boat()
    boat.bus.failed = True
    boat.heard(10)
    boat.bus.failed = False
    boat.bus.frames.extend([Frame(TIME_FRAME, TIME.pack(boat.true_ns(0.0)), boat.clock.time_ns())] * 1000)
    boat.second()
    assert len(boat.bus.frames) == 1010 - 16


@pytest.mark.parametrize("why_not", ["not set: the bus is simulated", "kept by chronyd"])
def test_a_clock_that_is_not_ours_is_compared_and_left_alone(why_not, caplog):
    caplog.set_level(logging.INFO)
    boat = Boat(why_not, time_ns=START_NS)
    boat.heard(40)
    assert boat.steps == boat.kernel.slews == []
    assert msgspec.structs.astuple(boat.told) == (why_not, "the time frame", pytest.approx(-50.0, abs=1e-6), "", False)
    assert [each.message for each in caplog.records].count(f"clock: {why_not}") == 1


def test_another_keeper_that_comes_later_is_given_way_to(caplog):
    boat = Boat()
    boat.heard(20)
    slews = len(boat.kernel.slews)
    boat.kernel.is_disciplined = True
    boat.heard(20)
    assert len(boat.kernel.slews) == slews
    assert boat.told.kept == "kept by another program, which tunes the kernel's clock"
    assert [each.message for each in caplog.records] == [f"clock: {boat.told.kept}"]


def test_a_kernel_that_refuses_is_asked_once(caplog):
    boat = Boat()
    boat.kernel.refuses = True
    boat.heard(40)
    assert boat.steps == []
    assert boat.told.kept == "not set: Operation not permitted"
    assert [each.message for each in caplog.records] == ["clock: not set: Operation not permitted"]


def test_under_way_nothing_is_stepped_and_a_refusal_is_told_once(caplog):
    boat = Boat()
    boat.state.mode, boat.state.armed = Mode.HEADING, True
    boat.heard(40)
    assert boat.steps == []
    assert len(caplog.records) == 1
    assert "is set when the boat is idle" in caplog.records[0].message
    boat.state.mode = Mode.IDLE
    boat.heard(20)
    assert boat.steps == [], "armed in idle, it may leave at once"
    boat.state.armed = False
    boat.heard(1)
    assert len(boat.steps) == 1


def test_a_clock_that_was_set_by_the_battery_clock_says_so():
    boat = Boat(battery_ns=START_NS, time_ns=START_NS + 1_300_000_000)
    boat.second()
    assert msgspec.structs.astuple(boat.told) == (OURS, "the battery clock", None, "", False)
    boat = Boat(battery_ns=0, time_ns=0)
    boat.second()
    assert boat.told.source == ""
