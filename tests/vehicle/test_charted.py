"""What a chart forbids: its file is whole or not taken, the boat keeps out of the water, and a mission opens a band by name."""

import hashlib
import math
import random
from pathlib import Path

import pytest

from delfim import config
from delfim.base import geodesy
from delfim.base.cooperative import Sliced
from delfim.base.errors import ConfigError, FormatError, Refused
from delfim.base.modes import Mode
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.orders.entrusting import within
from delfim.vehicle.plans import fence
from delfim.vehicle.plans.clearance import INSIDE, LOOKS, OUTSIDE_M, STEP_M, ClearanceField, LaidGrid, laid
from delfim.vehicle.plans.clearancefile import BYTES, load, read
from delfim.vehicle.plans.mission import Mission, Waypoint, canonical, parse_mission
from delfim.vehicle.plans.missionreader import gathered
from delfim.vehicle.plans.missionreader import written as lines_of
from delfim.vehicle.plans.zones import LOOKS as ZONES_LOOKS
from delfim.vehicle.plans.zones import charted, clearance_m, least, may, searched
from delfim.vehicle.state import NoLog
from tests.vehicle.charted import chart, written

VEHICLE = Path(__file__).parents[2] / "etc/delfimx.toml"
HERE = 38.690696, -9.215310  # where the simulated boat lies
AT = geodesy.origin(math.radians(HERE[0]), math.radians(HERE[1]))
SHOAL, ROCK = (90.0, 0.0, 30.0), (-60.0, 60.0, 15.0)
DATA = chart(AT, (SHOAL, ROCK), opened=(ROCK,))
WATCHED = 'sensors.names=["sysstat", "nmea2000"]', 'sensors.required=["depth_m"]', "failsafe.shallow.min_depth_m=1.0"


def of(band: str = "", at: geodesy.Origin = AT) -> ClearanceField:
    return laid(read(DATA).water(band), at)


def true_m(north_m: float, east_m: float) -> float:
    return min(math.hypot(north_m - n, east_m - e) - radius_m for n, e, radius_m in (SHOAL, ROCK))


def test_a_field_never_says_more_than_true_and_little_less() -> None:
    field, drawn = of(), random.Random(1)
    for _ in range(5000):
        place = drawn.uniform(-240.0, 240.0), drawn.uniform(-240.0, 240.0)
        clear_m = min(true_m(*place), 299.0 - max(map(abs, place)))
        said_m = field.clear_m(*place)
        assert said_m <= clear_m
        if 0.0 < clear_m < 50.0:
            assert said_m > 0.95 * clear_m - 1.0
    assert field.clear_m(0.0, 300.0) == field.clear_m(-1e7, 0.0) == OUTSIDE_M


def test_in_another_plane_it_lies_at_the_same_place() -> None:
    north = geodesy.origin(AT.latitude_rad + 0.002, AT.longitude_rad - 0.002)  # 12 km
    moved, still = of(at=north), of()
    assert moved.shrink < 1.0
    for n, e in ((0.0, 0.0), (50.0, 20.0), (-60.0, 40.0)):
        there = geodesy.to_plane(north, *geodesy.from_plane(AT, n, e))
        assert moved.clear_m(*there) == pytest.approx(still.clear_m(n, e), rel=0.005, abs=0.01)
        assert moved.clear_m(*there) <= still.clear_m(n, e) + 1e-9


def test_a_way_is_as_near_as_its_nearest_place() -> None:
    zone, drawn = charted("no-go water", of()), random.Random(2)
    for _ in range(500):
        a, b = ((drawn.uniform(-200.0, 200.0), drawn.uniform(-200.0, 200.0)) for _ in range(2))
        places = [(a[0] + (b[0] - a[0]) * i / 400, a[1] + (b[1] - a[1]) * i / 400) for i in range(401)]
        nearest_m = min(clearance_m(zone, *place) for place in places)
        found_m, looks = least(zone, a, b, 6.0)
        if looks <= LOOKS:
            if nearest_m < 0.0:
                assert found_m <= 0.0 or found_m < STEP_M
            elif nearest_m < 6.0 - STEP_M:
                assert nearest_m - 0.1 <= found_m <= nearest_m + STEP_M
            elif nearest_m >= 6.0:
                assert found_m == math.inf
        whole_m = Sliced(searched(zone, a, b, 6.0)).finish()
        assert whole_m == found_m or looks > LOOKS
    assert LOOKS == ZONES_LOOKS


def test_a_way_along_an_edge_is_given_up_and_searched_in_slices() -> None:
    data = chart(AT, [(0.0, east, 20.0) for east in range(-290, 291, 10)])
    zone = charted("no-go water", laid(read(data).water(""), AT))
    a, b = (21.6, -280.0), (21.6, 280.0)
    found_m, looks = least(zone, a, b, 1.7)
    assert looks > LOOKS or found_m < 1.7
    assert 0.5 < Sliced(searched(zone, a, b, 1.7)).finish() < 1.7


def test_a_boat_within_the_margin_may_leave_it() -> None:
    zone = charted("no-go water", of())
    for bearing in range(0, 360, 7):
        away = math.cos(math.radians(bearing)), math.sin(math.radians(bearing))
        for from_m in (1.0, -5.0):
            here, there = ((SHOAL[0] + away[0] * r, SHOAL[1] + away[1] * r) for r in (30.0 + from_m, 50.0 + from_m))
            smallest_m, _ = least(zone, here, there, 3.0)
            assert smallest_m >= clearance_m(zone, *here) - 0.01, bearing
        assert may(zone, *there)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda data: data[:-1], "it is not whole: its digest is another one; bring it aboard again"),
        (lambda data: data[:200], "it is not whole"),
        (lambda data: data.replace(b'"draught_m":0.5', b'"draught_m":0.1'), "it is not whole"),
        (lambda data: b"", "not a file of clearances: delfim charts makes one"),
        (lambda data: data + bytes(BYTES), f"files of more than {BYTES} are not read"),
    ],
)
def test_a_file_that_is_not_whole_is_not_taken(change: object, words: str, tmp_path: Path) -> None:
    file = tmp_path / "harbour.clearance"
    file.write_bytes(change(DATA))  # type: ignore[operator]
    settings = config.load(VEHICLE, (f'fence.chart="{file}"',))
    with pytest.raises(ConfigError) as refused:
        load(settings)
    assert words in str(refused.value)
    with pytest.raises(ConfigError):
        Lockstep(settings, 1, lambda clock: NoLog())
    file.unlink()
    with pytest.raises(ConfigError, match="there is no such file: the boat, its dry runs and replays"):
        load(settings)


def test_a_head_that_lies_is_refused() -> None:
    for was, new in (
        (b'"rows":300', b'"rows":299'),
        (b'"rows":300', b'"rows":4096'),
        (b'"bands":[""', b'"bands":["1"'),
        (b'"sizes":[', b'"sizes":[1,'),
    ):
        content = DATA[:-32].replace(was, new)
        assert content != DATA[:-32]
        with pytest.raises(FormatError):
            read(content + hashlib.sha256(content).digest())


def test_a_chart_for_a_smaller_boat_is_refused(tmp_path: Path) -> None:
    named = written(tmp_path, DATA)
    assert load(config.load(VEHICLE, (named, "boat.draught_m=0.5"))) is not None
    with pytest.raises(ConfigError, match=r"made for draught_m 0\.5, and boat\.draught_m is 0\.6: make it anew"):
        load(config.load(VEHICLE, (named, "boat.draught_m=0.6")))
    with pytest.raises(ConfigError, match="air_draught_m"):
        load(config.load(VEHICLE, (named, "boat.air_draught_m=3.1")))


class CharteredSea:
    """A boat in the middle of the chart."""

    def __init__(self, folder: Path, *overrides: str) -> None:
        settings = config.load(VEHICLE, (written(folder, DATA), "simulation.heading_deg=0.0", *overrides))
        self.run = Lockstep(settings, 1, lambda clock: NoLog())
        for _ in self.run.cycles(5.0):
            pass

    def mission(self, *places: tuple[float, float], opens: str = "") -> str | None:
        rows = tuple(Waypoint(latitude_deg=n, longitude_deg=e) for n, e in (self.at(*place) for place in places))
        return self.run.command(console.Upload(Mission(version=1, name="test", waypoint=rows, opens=opens)))

    def at(self, north_m: float, east_m: float) -> tuple[float, float]:
        latitude_rad, longitude_rad = geodesy.from_plane(AT, north_m, east_m)
        return math.degrees(latitude_rad), math.degrees(longitude_rad)

    @property
    def here(self) -> tuple[float, float]:
        motion, origin = self.run.state.motion, self.run.state.origin
        assert origin is not None
        return geodesy.to_plane(AT, *geodesy.from_plane(origin, motion.north_m, motion.east_m))


def test_missions_keep_off_charted_dangers(tmp_path: Path) -> None:
    sea = CharteredSea(tmp_path)
    assert sea.mission((0.0, -60.0), (200.0, -60.0)) is None
    words = "mission refused: the leg to waypoint 2 leads through no-go water of chart XX5TEST1 edition 2"
    assert sea.mission((0.0, 0.0), (200.0, 0.0)) == f"{words}; missions keep 6 m away"
    assert sea.mission((0.0, 0.0), (0.0, 400.0)) == f"{words}; missions keep 6 m away", "there is no chart"
    near = sea.mission((0.0, -34.0), (200.0, -34.0))
    assert near is not None
    assert "m past no-go water of chart XX5TEST1 edition 2; missions keep 6 m away" in near


def test_a_boat_stops_before_charted_dangers_and_goto_leads_into_none(tmp_path: Path) -> None:
    sea = CharteredSea(tmp_path)
    assert sea.run.command(console.Goto(*sea.at(90.0, 5.0))) is not None
    assert sea.run.command(console.Heading(0.0, 1.5)) is None
    nearest_m = math.inf
    for _ in sea.run.cycles(60.0):
        nearest_m = min(nearest_m, true_m(*sea.here))
    assert "no-go water of chart XX5TEST1 edition 2" in sea.run.state.reason
    assert sea.run.state.mode is Mode.HOLD
    assert 0.0 < nearest_m < 20.0


def test_a_band_is_opened_by_name_for_one_mission_and_watched_by_the_sounder(tmp_path: Path) -> None:
    through = (0.0, 0.0), (200.0, 0.0)
    assert CharteredSea(tmp_path).mission(*through, opens="0-2 m") == (
        "the mission opens water of 0-2 m: no sounder watches it: sensors.required needs depth_m, and failsafe.shallow its "
        "min_depth_m"
    )
    sea = CharteredSea(tmp_path, *WATCHED)
    assert sea.mission(*through, opens="0-9 m") == (
        "the mission opens water of 0-9 m, and the chart aboard has been made for 0-2 m"
    )
    assert sea.mission(*through) is not None
    assert sea.mission(*through, opens="0-2 m") is None
    assert sea.mission((0.0, 0.0), (-60.0, 60.0), opens="0-2 m") is not None, "the rock is in no band"
    plans = sea.run.vehicle.helm.plans
    assert plans.mission is not None
    assert plans.fence is not None
    assert may(plans.fence.zones[-1], 90.0, 0.0)
    assert sea.run.command(console.SetFence(config.Zones())) is None
    assert may(plans.fence.zones[-1], 90.0, 0.0), "the mission is the same"
    assert sea.run.command(console.Unload()) is None
    assert not may(plans.fence.zones[-1], 90.0, 0.0), "it is closed with the mission"


def test_without_a_chart_nothing_is_opened_and_no_program_opens_a_band() -> None:
    run = Lockstep(config.load(VEHICLE), 1, lambda clock: NoLog())
    mission = Mission(version=1, name="test", waypoint=(Waypoint(latitude_deg=HERE[0], longitude_deg=HERE[1]),), opens="0-2 m")
    for _ in run.cycles(3.0):
        pass
    refused = run.command(console.Upload(mission))
    assert refused == "mission refused: it opens water of 0-2 m, and the boat has no chart (fence.chart)"
    with pytest.raises(Refused, match="the operator's to open"):
        within(console.Upload(mission), config.Zones())


def test_the_band_is_in_the_missions_text_and_comes_through_its_reader() -> None:
    mission = Mission(version=1, name="test", waypoint=(Waypoint(latitude_deg=1.0, longitude_deg=2.0),), opens="0-2 m")
    assert 'opens = "0-2 m"' in canonical(mission)
    assert parse_mission(canonical(mission)) == mission
    assert Sliced(gathered([line.rstrip() for line in lines_of(mission)])).finish() == mission


def test_a_band_that_closes_leaves_all_zones_of_the_boat_and_of_the_mission() -> None:
    rock, quay = (config.Area(name=name, centre=(HERE,), radius_m=5.0) for name in ("rock", "quay"))
    water, zones = read(DATA).water, config.Zones(keep_out=(quay,))
    opened = Sliced(fence.survey(config.FenceTable(keep_out=(rock,)), zones, AT, None, water("0-2 m"))).finish()
    assert opened is not None
    closed = fence.shut(opened, water(""), AT)
    assert closed.zones[:-1] == opened.zones[:-1]
    assert [zone.name for zone in closed.zones] == ["rock", "quay", "no-go water of chart XX5TEST1 edition 2"]
    assert [may(each.zones[-1], *SHOAL[:2]) for each in (opened, closed)] == [True, False]
    assert (closed.own, closed.limits) == (1, opened.limits)


@pytest.mark.parametrize(("code", "is_free"), [(INSIDE - 1, False), (INSIDE, True), (INSIDE + 1, True)])
def test_the_boat_may_be_up_to_the_edge_of_charted_water(code: int, is_free: bool) -> None:
    field = ClearanceField((LaidGrid(1.0, 0.0, 1.0, 0.0, 1, 1, 2, 0.0, bytes([code] * 4)),), 1.0)
    assert may(charted("no-go water", field), 0.5, 0.5) is is_free


def test_a_slice_of_a_search_along_an_edge_is_small_and_says_what_it_cost() -> None:
    field = ClearanceField((LaidGrid(1.0, 0.0, 1.0, 0.0, 1, 100, 101, 0.0, bytes([INSIDE + 6] * 202)),), 1.0)
    assert STEP_M < field.clear_m(0.5, 0.5) < 2.0 * STEP_M
    costs = list(searched(charted("no-go water", field), (0.5, 1.0), (0.5, 31.0), 5.0))
    assert costs == [42, 42, 42, 2], "20 looks in each slice, two comparisons a look"
