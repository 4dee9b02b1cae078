"""Rangefinders on a DroneCAN bus: pydronecan makes the frames, and what they see is what the look-out knows."""

import math

import pytest
from dronecan import uavcan
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.echoes import EVERY_S, STALE_S
from delfim.base.errors import ConfigError
from delfim.base.geodesy import origin
from delfim.base.input.untrusted import parse_toml
from delfim.canproxy.dronecan.datatypes import RangeMeasured
from delfim.canproxy.socket import ANYTHING
from delfim.parts.dronecan.rangefinders import Rangefinders
from delfim.parts.dronecan.table import Dronecan, Rangefinder
from delfim.simulator.lockstepbus import LockstepBus
from delfim.vehicle.build import build
from delfim.vehicle.links import Links
from delfim.vehicle.state import NoLog, State
from tests.parts.dronecan.test_dronecan_sensors import COMPASS, GNSS, TWIN, earth, field, fix, frames, imu, turned

NODE, LIDAR = 50, 2
VALID, TOO_FAR = 1, 3
AHEAD = Rangefinder(NODE, forward_m=1.5)
ASTERN = Rangefinder(NODE, 1, angle_deg=180.0, starboard_m=0.5)


def measured(distance_m: float, sensor: int = 0, reading: int = VALID, beam_rad: float = 0.0, kind: int = LIDAR) -> object:
    return uavcan.equipment.range_sensor.Measurement(
        sensor_id=sensor, sensor_type=kind, reading_type=reading, range=distance_m, field_of_view=beam_rad
    )


class Boat:
    """A boat at rest on a heading of 1 rad, with all of its program, on a bus of which pydronecan is the rest."""

    def __init__(self, *rows: Rangefinder) -> None:
        settings = config.Vehicle(
            boat=config.BoatTable(name="test"),
            navigation=config.NavigationTable(sources=("dronecan",), rate_hz=10.0, estimator=True),
            sensors=config.Sensors(names=("dronecan",)),
            thrusters=TWIN,
            dronecan=Dronecan(rangefinders=rows),
        )
        self.clock, self.state = ManualClock(100.0), State()
        bus = LockstepBus(self.clock)
        self.devices = bus.socket("devices")
        self.devices.bind(ANYTHING)
        links = Links(lambda interface, filters: bus.bound(*filters), lambda device, baud, form="8N1": None)
        self.built = build(settings, self.clock, self.state, links, NoLog())
        self._numbers: dict = {}
        self._turn = 0

    def live(self, *said: object, seconds: float = 1.0) -> None:
        """Each tenth of a second all devices speak, and the rangefinders say this."""
        for _ in range(round(10.0 * seconds)):
            wobble = 1e-4 * (self._turn % 5)
            at = fix(latitude_deg_1e8=3_869_070_000 + self._turn % 5, east_mps=wobble)
            self._turn += 1
            its = [(at, GNSS), (imu((0.0, 0.0, wobble)), COMPASS), (field(earth(turned(1.0 + wobble)), 3), COMPASS)]
            for message, node in [*its, *((each, NODE) for each in said)]:
                for frame in frames(message, node, self._numbers):
                    self.devices.sendmsg(frame)
            for source in self.built.vehicle.sources:
                while self.built.vehicle.on_navigation(source):
                    pass
            for each in self.built.inputs:
                self.built.vehicle.on_sensor(each)
            self.built.vehicle.on_watchdog()
            self.clock.advance(0.1)

    def seen(self) -> list[tuple[str, float, float]]:
        """Name of each thing, and how far ahead and to starboard of the boat its middle is."""
        motion, found = self.state.motion, []
        c, s = math.cos(motion.heading_rad), math.sin(motion.heading_rad)
        for each in self.state.traffic.targets:
            assert each.kind == "thing"
            north_m, east_m = each.north_m - motion.north_m, each.east_m - motion.east_m
            found.append((each.name, c * north_m + s * east_m, c * east_m - s * north_m))
        return sorted(found)


def test_what_a_beam_sees_stands_where_it_looks() -> None:
    boat = Boat(AHEAD, ASTERN)
    boat.live(seconds=3.0)
    boat.live(measured(20.0, beam_rad=math.radians(6.0)), measured(8.0, 1), seconds=4.0)
    (ahead, far_m, aside_m), (astern, back_m, aside_back_m) = boat.seen()
    assert (ahead, astern) == (f"lidar {NODE}.0", f"lidar {NODE}.1")
    assert far_m == pytest.approx(1.5 + 20.0 + 20.0 * math.tan(math.radians(3.0)), abs=0.1)
    assert aside_m == pytest.approx(0.0, abs=0.1)
    assert (back_m, aside_back_m) == (pytest.approx(-8.3, abs=0.1), pytest.approx(0.5, abs=0.1))
    assert boat.state.counts == {}


@pytest.mark.parametrize("said", [measured(20.0, reading=TOO_FAR), measured(0.4), measured(101.0), measured(math.nan, 0, 0)])
def test_nothing_in_reach_is_no_thing(said: object) -> None:
    boat = Boat(AHEAD)
    boat.live(seconds=3.0)
    boat.live(said, seconds=4.0)
    assert boat.seen() == []
    assert boat.state.counts == {}


def test_what_is_seen_for_a_moment_is_not_believed() -> None:
    boat = Boat(AHEAD)
    boat.live(seconds=3.0)
    boat.live(measured(20.0), seconds=0.2)
    boat.live(seconds=2.0)
    assert boat.seen() == []


@pytest.mark.parametrize("distance_m", [-1.0, math.nan])
def test_a_distance_that_is_none_is_malformed(distance_m: float) -> None:
    boat = Boat(AHEAD)
    boat.live(seconds=2.0)
    boat.live(measured(distance_m), seconds=0.1)
    assert boat.state.counts == {"dronecan_malformed": 1}


def test_a_sensor_without_a_row_is_counted_and_sees_nothing() -> None:
    boat = Boat(AHEAD)
    boat.live(seconds=2.0)
    boat.live(measured(5.0, 7), seconds=4.0)
    assert boat.seen() == []
    assert boat.state.counts == {"dronecan_other_rangefinders": 40}


def test_a_boat_without_rows_does_not_read_them() -> None:
    boat = Boat()
    boat.live(measured(5.0), seconds=1.0)
    assert boat.state.counts == {}


def test_a_boat_that_does_not_know_where_it_is_sees_nothing() -> None:
    boat = Boat(AHEAD)
    boat.live(seconds=2.0)
    their = Rangefinders(boat.built.vehicle.helm.settings)
    state = boat.state
    for lost in ({"position"}, {"heading"}):
        known, state.motion = state.motion, state.motion._replace(has=frozenset(lost))
        their.hear(state, NODE, RangeMeasured(0, LIDAR, 20.0, 0.0), boat.clock.monotonic_s())
        state.motion = known
    their.hear(state, NODE, RangeMeasured(0, LIDAR, 20.0, 0.0), state.navigation_s + STALE_S + 0.1)
    assert state.counts == {"dronecan_ranges_without_place": 3}
    assert state.heard == {}


@given(st.lists(st.tuples(st.floats(0.0, 3.0), st.floats(0.5, 100.0)), max_size=40))
def test_however_often_it_speaks_it_is_heard_four_times_a_second(said: list[tuple[float, float]]) -> None:
    table, names = Dronecan(rangefinders=(AHEAD,)), config.Sensors(names=("dronecan",))
    settings = config.Vehicle(boat=config.BoatTable(name="test"), dronecan=table, sensors=names)
    state, heard = State(), 0
    state.origin, state.motion = origin(0.675, -0.16), state.motion._replace(has=frozenset({"position", "heading"}))
    their, last_s = Rangefinders(settings), -math.inf
    for at_s, distance_m in sorted(said):
        state.navigation_s = at_s
        before = len(state.heard)
        their.hear(state, NODE, RangeMeasured(0, LIDAR, distance_m, 0.0), at_s)
        if at_s - last_s >= EVERY_S:
            heard, last_s = heard + 1, at_s
            assert len(state.heard) == before + 1
    assert len(state.heard) == heard


def test_two_rows_of_one_sensor_and_rows_that_nobody_reads_are_refused() -> None:
    text = '[boat]\nname = "x"\n[sensors]\nnames = [{names}]\n[dronecan]\nrangefinders = [{rows}]\n'
    row = "{ node = 50, sensor = 3, angle_deg = 10.0 }"
    with pytest.raises(ConfigError, match="sensor 3 of node 50 has two rows"):
        config.read(parse_toml(text.format(names='"dronecan"', rows=f"{row}, {row}")), "x.toml")
    with pytest.raises(ConfigError, match="nobody reads them: name"):
        config.read(parse_toml(text.format(names='"sysstat"', rows=row)), "x.toml")
