"""The source `nmea0183` and the boat's judgement of it: silence, frozen receivers, jumps, floods; the sensor of that name."""

import os

import pytest

from delfim import config
from delfim.base.clock import ManualClock
from delfim.lines.nmea0183.framing import framed
from delfim.parts.nmea0183.source import GREETING, WATCH
from delfim.parts.nmea0183.table import Nmea0183, Nmea0183Port
from delfim.simulator.line import LockstepLine
from delfim.vehicle import sensors
from delfim.vehicle.links import Links
from delfim.vehicle.navigation.fixes import open_sources, take
from delfim.vehicle.state import State


class Boat:
    """The sources of a file on lines that the test speaks on."""

    def __init__(self, sources: tuple[str, ...] = ("nmea0183",), names: tuple[str, ...] = ("nmea0183",)) -> None:
        self.clock, self.lines, self.state = ManualClock(monotonic_s=1000.0), dict[str, LockstepLine](), State()
        ports = {
            "gnss": Nmea0183Port(device="gpsd:127.0.0.1:2947"),
            "compass": Nmea0183Port(device="/dev/compass", baud=38400),
        }
        self.settings = config.Vehicle(
            boat=config.BoatTable(name="tried"),
            navigation=config.NavigationTable(sources=sources, stale_s=2.5),
            sensors=config.Sensors(names=names),
            nmea0183=Nmea0183(ports=ports),
        )
        self.links = Links(lambda *_: pytest.fail("no bus"), self.line)

    def line(self, device: str, baud: int, form: str = "8N1") -> LockstepLine:
        self.lines[device] = LockstepLine(self.clock)
        return self.lines[device]

    def open(self) -> None:
        (self.source,) = open_sources(self.settings, self.links, self.state)

    def hear(self, body: str, device: str = "tcp:127.0.0.1:2947") -> bool:
        """Whether a position went into the state."""
        self.lines[device].put(framed(body))
        fix = self.source.read(self.clock.monotonic_s())
        return fix is not None and take(self.source, fix, (self.source,), self.state, self.settings.navigation)

    def later(self, seconds: float) -> None:
        self.clock.advance(seconds)


def rmc(second: int, minutes: float = 41.4420, knots: float = 2.0) -> str:
    return f"GPRMC,1200{second:02d}.00,A,38{minutes:07.4f},N,00912.9180,W,{knots},90.0,221126,,,A"


@pytest.fixture
def boat() -> Boat:
    made = Boat()
    made.open()
    return made


def test_a_frozen_receiver_is_seen(boat):
    """The same sentence again and again is no new position, and a compass that lives does not hide that."""
    assert boat.hear(rmc(1))
    for i in range(5):
        boat.later(1.0)
        boat.hear(f"HEHDT,{i}.0,T", "/dev/compass")
        assert not boat.hear(rmc(1))
    assert boat.clock.monotonic_s() - boat.state.navigation_s == 5.0
    assert boat.source.report(0.0)["repeated"] == 5
    assert boat.hear(rmc(2))


def test_silence_has_its_age_and_ends(boat):
    assert boat.hear(rmc(1))
    boat.later(5.0)
    boat.hear("HEHDT,274.0,T", "/dev/compass")
    assert boat.clock.monotonic_s() - boat.state.navigation_s == 5.0, "a compass alone is no position"
    assert boat.source.heard_s == boat.state.navigation_s
    assert boat.hear(rmc(6))


def test_a_jump_is_refused_and_counted(boat):
    assert boat.hear(rmc(1))
    boat.later(1.0)
    assert not boat.hear(rmc(2, minutes=42.4420))
    assert boat.state.counts["navigation_jumps"] == 1
    boat.later(1.0)
    assert boat.hear(rmc(3))


class LoudLine(LockstepLine):
    """Somebody waits for it."""

    def fileno(self) -> int:
        return self.end


def test_a_call_reads_one_piece_of_one_line_and_each_line_has_its_turn():
    """However much waits, navigation by another input has its turn after a fraction of a millisecond."""
    boat = Boat()
    LoudLine.end, far = os.pipe()
    boat.line = lambda device, baud, form="8N1": boat.lines.setdefault(device, LoudLine(boat.clock))  # type: ignore[method-assign]
    boat.links = Links(lambda *_: pytest.fail("no bus"), boat.line)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("delfim.parts.nmea0183.source.AnyPort", lambda ports: None)
        boat.open()
    for line in boat.lines.values():
        for _ in range(10):
            line.put(framed("GPGSV,1,1,00"))
    left = list[tuple[int, ...]]()
    for _ in range(6):
        boat.source.read(1000.0)
        left.append(tuple(len(line._pieces) for line in boat.lines.values()))
    assert left == [(9, 10), (9, 9), (8, 9), (8, 8), (7, 8), (7, 7)]
    for end in (LoudLine.end, far):
        os.close(end)


def test_gpsd_is_asked_for_its_sentences_when_it_greets(boat):
    line = boat.lines["tcp:127.0.0.1:2947"]
    line.put(GREETING + b',"release":"3.22"}\r\n')
    line.put(framed(rmc(1)))
    assert boat.source.read(1000.0) is not None
    assert list(line.written) == [WATCH]


def test_a_report_says_who_is_believed_and_what_was_refused(boat):
    boat.hear("HEHDT,nan,T", "/dev/compass")
    boat.hear(rmc(1))
    told = boat.source.report(1001.0)
    assert told["ports"]["compass"] == {"heard": {"HEHDT": 1}, "refused": {"HDT: not a number": 1}, "garbled": ""}
    assert told["kinds"]["position"] == {"talker": "gnss:GN", "age_s": 1.0}
    assert told["kinds"]["heading"] == {"talker": None, "age_s": None}


def test_values_beside_navigation_are_in_the_state_if_the_file_names_the_sensor():
    for names, measured in ((("nmea0183",), {"depth_m": (7.5, 1000.0)}), ((), {})):
        boat = Boat(names=names)
        boat.open()
        boat.hear("SDDPT,7.5,,", "/dev/compass")
        assert boat.state.measured == measured
        for sensor in sensors.open_sensors(boat.settings, boat.links):
            sensor.read(boat.state, 1000.0)
            assert sensor.input.rebind()
    assert {value.name for value in sensors.values(Boat().settings)} >= {"depth_m", "wind_true_mps"}


def test_a_boat_that_navigates_otherwise_has_a_sounder_alone():
    boat = Boat(sources=("dsor",))
    (sounder,) = sensors.open_sensors(boat.settings, boat.links)
    boat.lines["/dev/compass"].put(framed("SDDBT,,f,7.5,M,,F"))
    sounder.read(boat.state, 1000.0)
    assert boat.state.measured == {"depth_m": (7.5, 1000.0)}
