"""A board with ArduPilot as source of navigation: its messages, as another program packs them, and what is made of them."""

import math

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.modes import Mode
from delfim.canproxy.dsor.messages import Navigation
from delfim.parts.frontseats.mavlink_source import FIXES
from delfim.parts.frontseats.table import MavlinkFrontSeat
from delfim.simulator.line import LockstepLine
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.build import build
from delfim.vehicle.links import Links
from delfim.vehicle.navigation.fixes import open_sources, take
from delfim.vehicle.state import NoLog, State

UTC_NS = 1_795_000_000_000_000_000
LAT, LON = 386_907_000, -92_153_000
UNKNOWN = (*[None] * 8, 0, 0, None)  # from the position to the dilution


class Board:
    """The source on a line on which the test speaks as the board."""

    def __init__(self, **navigation: object) -> None:
        self.clock, self.state = ManualClock(monotonic_s=1000.0), State()
        self.line = LockstepLine(self.clock)
        self.settings = config.Vehicle(
            boat=config.BoatTable(name="tried"),
            navigation=config.NavigationTable(sources=("mavlink_front_seat",), **navigation),
            mavlink_front_seat=MavlinkFrontSeat(board=7, system=250),
        )
        links = Links(lambda *_: pytest.fail("no bus"), lambda *_: self.line)
        (self.source,) = open_sources(self.settings, links, self.state)
        self._codec, self._heard = dialect.MAVLink(None, 7, 1), dialect.MAVLink(None)
        self.boot_ms = 60_000

    def says(self, *messages: object, system: int = 7, component: int = 1) -> Navigation | None:
        """The message of navigation that comes of it."""
        self._codec.srcSystem, self._codec.srcComponent = system, component
        self.line.put(b"".join(each.pack(self._codec) for each in messages))
        fix = self.source.read(self.clock.monotonic_s())
        return None if fix is None else fix.navigation

    def receiver(self, fix: int = 3, eph: int = 90, satellites: int = 11, h_acc: int = 1500) -> object:
        return dialect.MAVLink_gps_raw_int_message(1, fix, LAT, LON, 0, eph, 0, 0, 0, satellites, 0, h_acc)

    def placed(self, lat: int = LAT, lon: int = LON, hdg: int = 4500) -> object:
        self.boot_ms += 100
        return dialect.MAVLink_global_position_int_message(self.boot_ms, lat, lon, 0, 0, 123, -45, 6, hdg)

    def attitude(self, yaw_rad: float = -0.5) -> object:
        return dialect.MAVLink_attitude_message(self.boot_ms, 0.01, -0.02, yaw_rad, 0.0, 0.0, 0.03)

    def clock_told(self) -> object:
        return dialect.MAVLink_system_time_message(UTC_NS // 1000, self.boot_ms)

    def taken(self, *messages: object) -> bool:
        """Whether a position went into the state."""
        self.line.put(b"".join(each.pack(self._codec) for each in messages))
        fix = self.source.read(now_s := self.clock.monotonic_s())
        return fix is not None and take(self.source, fix, (self.source,), self.state, self.settings.navigation) and now_s > 0

    def asked(self) -> list[object]:
        return [each for data in self.line.written for each in self._heard.parse_buffer(data)]


def heartbeat() -> object:
    return dialect.MAVLink_heartbeat_message(11, 3, 0x81, 0, 4, 3)


def test_units_and_signs():
    board = Board()
    assert board.says(board.clock_told(), board.receiver(), board.attitude()) is None
    told = board.says(board.placed())
    assert told == Navigation(
        UTC_NS + 100_000_000,  # its own time, a tenth of a second after the clock was told
        pytest.approx(math.radians(38.6907)),
        pytest.approx(math.radians(-9.2153)),
        1.23,  # cm/s
        -0.45,
        pytest.approx(math.tau - 0.5),  # from -pi..pi
        pytest.approx(0.03),
        pytest.approx(0.01),
        pytest.approx(-0.02),
        3,
        11,
        0.9,
        1,
        1.5,  # mm
    )


@pytest.mark.parametrize(("told", "fix"), [*FIXES.items(), (0, 0), (1, 0), (9, 0)])
def test_kinds_of_fix_have_other_numbers_there(told, fix):
    board = Board()
    board.says(board.receiver(told))
    n = board.says(board.placed())
    assert n.fix == fix
    assert ((n.latitude_rad, n.north_mps) != (None, None)) is (fix > 0), "without a fix the board reckons on for a while"


def test_what_is_not_known_is_not_a_zero():
    board = Board()
    board.says(board.receiver(eph=0xFFFF, satellites=255, h_acc=0), board.attitude(math.nan))
    n = board.says(board.placed())
    assert (n.utc_ns, n.hdop, n.satellites, n.accuracy_m) == (0, None, 0, None)
    assert n.heading_rad == pytest.approx(math.radians(45.0)), "of the position, where the attitude has none"
    board.says(board.attitude())
    assert board.says(board.placed(hdg=0xFFFF)).heading_rad is None, "its heading is not aligned yet"
    assert board.says(board.placed(lat=0, lon=0)).latitude_rad is None
    assert Board().says(board.placed())[1:12] == (*[None] * 4, pytest.approx(math.radians(45.0)), *[None] * 3, 0, 0, None)


def test_each_value_has_its_age():
    board = Board(stale_s=1.0)
    board.says(board.receiver(), board.attitude())
    board.clock.advance(1.1)
    n = board.says(board.placed())
    assert (n.heading_rad, n.yaw_rate_radps, n.roll_rad) == (pytest.approx(math.radians(45.0)), None, None)
    assert n.fix == 3, "a receiver may speak once a second, or in two"
    board.clock.advance(1.5)
    assert board.says(board.placed())[1:3] == (None, None)


def test_another_device_of_the_boat_is_not_the_board():
    board = Board()
    board.says(board.receiver())
    for party in ({"system": 8}, {"component": 154}):
        assert board.says(board.placed(), **party) is None
    assert board.says(board.placed()) is not None


def test_what_is_said_again_is_no_news_and_the_board_is_silent():
    board = Board()
    said = board.placed()
    assert board.taken(board.receiver(), said)
    for _ in range(5):
        board.clock.advance(0.5)
        assert not board.taken(board.receiver(), said)
    assert board.state.counts["mavlink_front_seat_repeated"] == 5
    assert board.clock.monotonic_s() - board.source.heard_s == 2.5


def test_a_frozen_board_and_one_that_jumps_are_seen():
    board = Board()
    for _ in range(5):
        board.clock.advance(0.2)
        assert board.taken(board.receiver(), board.attitude(), board.placed())
    assert board.clock.monotonic_s() - board.state.changed_s == pytest.approx(0.8)
    board.clock.advance(0.2)
    assert not board.taken(board.placed(lat=LAT + 10_000))
    assert board.state.counts["navigation_jumps"] == 1


def test_it_is_asked_for_its_messages_at_once_and_again_because_it_forgets():
    board = Board(rate_hz=5.0)
    board.says(board.placed())
    assert board.asked() == [], "only what has said that it is there"
    board.says(heartbeat())
    asked = {each.param1: each for each in board.asked()}
    assert {number: each.param2 for number, each in asked.items()} == {33: 2e5, 30: 2e5, 24: 5e5, 2: 5e5}
    assert {(each.command, each.target_system, each.get_srcSystem()) for each in asked.values()} == {(511, 7, 250)}
    board.line.written.clear()
    board.clock.advance(9.0)
    board.says(heartbeat())
    assert not board.line.written
    board.clock.advance(1.1)
    board.says(heartbeat())
    assert len(board.asked()) == 4


@settings(suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(st.lists(st.binary(max_size=60), max_size=8))
def test_noise_is_counted_and_does_no_harm(pieces):
    board = Board()
    for each in pieces:
        board.line.put(each)
        board.source.read(1.0)
    board.line.put(b"\0" * 300)  # until a frame that the noise began has ended
    board.source.read(1.0)
    board.says(board.receiver())
    assert board.says(board.placed()).fix == 3


def test_motors_and_navigation_share_the_line():
    """One program opens it, and both hear all of it."""
    clock, opened = ManualClock(monotonic_s=1000.0), list[LockstepLine]()
    row = {"driver": "mavlink_front_seat", "thrust_n": (-30.0, 50.0)}
    rows = tuple(
        config.ThrusterTable(name=name, address=i, y_m=y_m, **row) for i, (name, y_m) in enumerate((("a", 0.3), ("b", -0.3)))
    )
    vehicle = config.Vehicle(
        boat=config.BoatTable(name="tried"),
        can=config.Can(interface="canloop:shared-line"),
        navigation=config.NavigationTable(sources=("mavlink_front_seat",)),
        sensors=config.Sensors(names=()),
        thrusters=rows,
    )

    def line(*_: object) -> LockstepLine:
        opened.append(LockstepLine(clock))
        return opened[-1]

    state = State()
    boat = build(vehicle, clock, state, Links(lambda *_: None, line), NoLog())
    assert len(opened) == 1
    assert boat.inputs == (), "nothing else waits for the line"
    codec = dialect.MAVLink(None, 1, 1)
    power = dialect.MAVLink_sys_status_message(0, 0, 0, 0, 15_200, 450, 80, 0, 0, 0, 0, 0, 0)
    fix = dialect.MAVLink_gps_raw_int_message(1, 3, LAT, LON, 0, 90, 0, 0, 0, 11, 0, 1500)
    at = dialect.MAVLink_global_position_int_message(60_000, LAT, LON, 0, 0, 0, 0, 0, 0)
    opened[0].put(b"".join(each.pack(codec) for each in (heartbeat(), power, fix, at)))
    assert boat.vehicle.on_navigation(boat.vehicle.sources[0])
    assert state.motion.has == {"position", "heading", "velocity"}
    assert (state.thrusters["a"].voltage_v, state.thrusters["b"].refuses) == (15.2, "")


BOARD = ['navigation.sources=["mavlink_front_seat"]', "navigation.estimator=false", "simulation.instruments=[]"]


def test_a_boat_sails_its_mission_by_its_board_alone():
    """BlueBoat, whose board tells it all, in wind and current; then the board falls silent."""
    sea = Lockstep(config.load("etc/boats/blueboat.toml", BOARD), 1, lambda clock: NoLog())
    for _ in sea.cycles(5.0):
        pass
    assert sea.command(console.Course(90.0, 1.0)) is None
    for state in sea.cycles(60.0):
        model = sea.nodes.model
        assert math.hypot(state.motion.north_m - model.north_m, state.motion.east_m - model.east_m) < 3.0
    assert (state.mode, state.notices) == (Mode.COURSE, ())
    assert state.motion.east_m > 40.0
    assert abs(state.motion.north_m) < 6.0
    sea.nodes.receivers[0].silent = True
    for _ in sea.cycles(5.0):
        pass
    assert state.mode is Mode.IDLE
    assert "navigation" in state.reason, state.reason
