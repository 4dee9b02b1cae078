"""Things that stand, and swimmers: who is believed, how long, and the way past them."""

import json
import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import pytest

from bench import things as worlds
from delfim import config
from delfim.base.cooperative import Sliced
from delfim.base.geodesy import origin
from delfim.base.vessels import ThingSeen
from delfim.parts.mavlink.codec.aisvessel import kind_of, number_of, told
from delfim.parts.traffic.encounter import Own
from delfim.parts.traffic.pastthings import SPENT, Passage, past
from delfim.parts.traffic.swimmers import swimmer_near
from delfim.parts.traffic.things import MOST, Things
from delfim.parts.traffic.trialways import Caution, RouteAhead
from delfim.vehicle.plans.fence import Fence
from delfim.vehicle.plans.zones import polygon
from delfim.vehicle.target import Target
from tests.parts.mavlink.test_mavlink_station import afloat, sail

LIMITS = Caution(length_m=4.0, turn_radps=0.25, ramp_mps2=0.4)
HERE = 38.6907, -9.2153
PLANE = origin(math.radians(HERE[0]), math.radians(HERE[1]))
OWN = Own(0.0, 0.0, 0.0, 1.5)
NORTH = RouteAhead(((300.0, 0.0),), 1.5)
KEEPS_M = 14.5  # of the middle of the boat to that of a buoy: 10 m, 2 m of the place, both halves


def seen(north_m: float = 0.0, east_m: float = 0.0, **more: Any) -> ThingSeen:
    place = PLANE.latitude_rad + north_m / PLANE.north_m_per_rad, PLANE.longitude_rad + east_m / PLANE.east_m_per_rad
    return ThingSeen(*place, more.pop("radius_m", 0.5), **more)


def looked(things: Things, now_s: float) -> list[Target]:
    return Sliced(things.looked(now_s, PLANE, PLANE.latitude_rad, PLANE.longitude_rad)).finish()


def thing(number: int, north_m: float, east_m: float, radius_m: float = 0.5, kind: str = "thing") -> Target:
    return worlds.thing(number, (north_m, east_m, radius_m))._replace(key=f"{kind} {number}", kind=kind)


def way(*things: Target, own: Own = OWN, route: RouteAhead = NORTH, around: Fence | None = None, **more: Any) -> Passage | None:
    return Sliced(past(LIMITS, own, route, things, around, more.get("was"))).finish()


def nearest_m(passage: Passage, this: Target, own: Own = OWN) -> float:
    """Of the straight pieces of a way to the middle of a thing."""
    points = [own[:2], *passage.points]
    at = (this.north_m, this.east_m)
    pieces = pairwise(points)
    return min(
        math.dist(at, (a[0] + i / 50 * (b[0] - a[0]), a[1] + i / 50 * (b[1] - a[1]))) for a, b in pieces for i in range(51)
    )


@pytest.mark.parametrize(
    ("confidence", "sightings", "is_there"), [(1.0, 1, True), (0.3, 3, False), (0.3, 4, True), (0.05, 19, False)]
)
def test_confidences_add_up_one_a_second(confidence: float, sightings: int, is_there: bool) -> None:
    things = Things(config.TrafficTable())
    for i in range(sightings * 10):  # ten a second
        things.hear(seen(confidence=confidence), "lidar 1", 0.1 * i)
    assert [each.name for each in looked(things, sightings)] == (["lidar 1"] if is_there else [])


def test_it_is_kept_ten_times_as_long_as_it_was_seen_within_bounds() -> None:
    for seconds, kept_s in ((1, 15.0), (20, 200.0), (100, 600.0)):
        things = Things(config.TrafficTable())
        for i in range(seconds):
            things.hear(seen(), "lidar 1", float(i))
        assert looked(things, seconds - 1 + kept_s)
        assert not looked(things, seconds + kept_s)
        assert len(things) == 0


def test_two_programs_and_new_names_make_one_thing_and_no_confidence_takes_it_back() -> None:
    things = Things(config.TrafficTable())
    for i, name in enumerate(("lidar 1", "camera 9", "lidar 2")):
        things.hear(seen(100.0 + 0.5 * i), name, float(i))
    (only,) = looked(things, 3.0)
    assert (only.key, only.name, only.kind, only.age_s) == ("thing 1", "lidar 1", "thing", 1.0)
    assert 100.0 < only.north_m < 101.0
    things.hear(seen(100.5, confidence=0.0), "lidar 7", 4.0)
    assert looked(things, 4.0) == []


def test_of_more_than_there_is_room_for_the_nearest_are_known() -> None:
    things = Things(config.TrafficTable())
    looked(things, 0.0)
    for i in range(MOST + 20):
        things.hear(seen(1000.0 - 8.0 * i), f"lidar {i}", 0.0)
    things.hear(seen(2000.0), "lidar far", 0.0)
    found = looked(things, 0.0)
    assert len(found) == MOST
    assert max(each.north_m for each in found) < 1000.0 - 8.0 * 19
    assert things.refused == 21


@pytest.mark.parametrize(
    "place", [{"latitude_rad": 1.6}, {"latitude_rad": 0.0, "longitude_rad": 0.0}, {"latitude_rad": math.nan}]
)
def test_a_place_that_is_none_is_refused(place: dict[str, float]) -> None:
    things = Things(config.TrafficTable())
    things.hear(seen()._replace(**place), "lidar 1", 0.0)
    assert (len(things), things.refused) == (0, 1)


def test_a_swimmer_may_have_swum() -> None:
    things = Things(config.TrafficTable())
    for i in range(100):
        things.hear(seen(0.5 * i, kind="person"), "camera 1", float(i))
    (one,) = looked(things, 119.0)
    assert (one.kind, one.margin_m, round(one.north_m)) == ("person", 22.0, 54)
    assert looked(things, 99.0 + 120.0)
    assert not looked(things, 99.0 + 121.0)


def test_what_one_program_calls_a_swimmer_is_one_whoever_else_sees_it() -> None:
    things = Things(config.TrafficTable())
    for i in range(5):  # a lidar sees something small
        things.hear(seen(0.0, 0.1 * i, radius_m=0.3), "lidar 5", float(i))
    things.hear(seen(4.0, 0.5, kind="person", radius_m=2.0), "camera 1", 5.0)
    (one,) = looked(things, 5.0)
    assert (one.key, one.kind) == ("person 1", "person")
    for i in range(6, 60):  # the camera has turned away, and the lidar sees it yet
        things.hear(seen(0.0, 0.1 * i, radius_m=0.3), "lidar 5", float(i))
    (one,) = looked(things, 60.0)
    assert (one.kind, one.margin_m) == ("person", 3.0)
    assert abs(one.east_m - 5.9) < 0.5


def test_a_moored_boat_beside_a_swimmer_stays_a_thing_and_heads_near_each_other_are_one() -> None:
    things = Things(config.TrafficTable())
    things.hear(seen(radius_m=5.0), "lidar 1", 0.0)
    things.hear(seen(5.0, kind="person"), "camera 1", 0.0)
    things.hear(seen(12.0, kind="person"), "camera 2", 0.0)
    things.hear(seen(8.4, kind="person"), "camera 1", 1.0)
    assert sorted(each.kind for each in looked(things, 1.0)) == ["person", "thing"]


def test_clear_water_needs_no_other_way() -> None:
    assert way() is None
    assert way(thing(1, 100.0, 20.0)) is None
    assert way(thing(1, -10.0, 0.0)) is None, "it lies astern"
    assert way(thing(1, 250.0, 0.0)) is None, "it is met in more than two minutes"
    assert way(thing(1, 100.0, 0.0), route=RouteAhead((), 1.5)) is None, "the boat stays"


def test_a_buoy_is_left_on_the_nearer_side_by_the_distance_of_the_file() -> None:
    buoy = thing(1, 100.0, 4.0)
    passage = way(buoy)
    assert passage is not None
    assert passage.words == "keeping clear of lidar 1, which stands, leaving it to starboard"
    assert KEEPS_M <= nearest_m(passage, buoy) < KEEPS_M + 2.0
    assert passage.points[-1] == (300.0, 0.0)
    order = passage.order(OWN, 1.5, 7.0)
    assert (order.key, order.speed_mps, order.at_s) == ("thing 1", 1.5, 7.0)
    assert -0.2 < order.course_rad < -0.1


def test_the_way_leads_between_and_not_round_all() -> None:
    row = [thing(i, 100.0, e) for i, e in enumerate((-60.0, -25.0, 10.0, 45.0))]
    passage = way(*row)
    assert passage is not None
    assert min(nearest_m(passage, each) for each in row) >= KEEPS_M
    assert all(-25.0 < e <= 10.0 for _, e in passage.points)


def test_a_way_that_is_sailed_is_kept_though_another_became_a_little_shorter() -> None:
    to_port, to_starboard = way(thing(1, 100.0, 1.0)), way(thing(1, 100.0, -1.0))
    assert to_port is not None
    assert to_starboard is not None
    kept = way(thing(1, 100.0, -1.0), was=to_port)
    assert (kept and kept.words, to_port.words) == (
        to_port.words,
        "keeping clear of lidar 1, which stands, leaving it to starboard",
    )
    assert to_starboard.words != to_port.words


def test_where_it_is_narrow_the_boat_goes_through_slowly() -> None:
    gate = [thing(i, 40.0, float(e)) for i, e in enumerate(range(-160, 161, 5)) if abs(e) > 8]
    passage = way(*gate)
    assert passage is not None
    assert (passage.part, passage.is_narrow) == (0.5, True)
    assert passage.words.endswith("which stands, where it is narrow, at half speed")
    far = way(*gate, own=OWN._replace(north_m=-100.0))
    assert (far and far.part, far and far.is_narrow) == (1.0, True), "slowly where it is near"


def test_without_a_way_the_boat_stops_before_it_and_says_so() -> None:
    basin = [thing(i, 60.0 * math.cos(0.1 * i), 60.0 * math.sin(0.1 * i)) for i in range(63)]
    assert way(*basin) is None, "not yet"
    passage = way(*basin, own=OWN._replace(north_m=34.0))
    assert passage is not None
    assert passage.words == "keeping clear of lidar 0, which stands, no way past it, stopped"
    assert passage.order(OWN, 1.5, 0.0).speed_mps == 0.0


def test_a_waypoint_beside_a_thing_is_reached_and_one_on_it_is_not() -> None:
    beside = way(thing(1, 100.0, 8.0), route=RouteAhead(((100.0, 0.0), (300.0, 0.0)), 1.5))
    assert beside is None or beside.points[-2:] == ((100.0, 0.0), (300.0, 0.0))
    passage = way(thing(1, 40.0, 0.0), route=RouteAhead(((40.0, 0.0),), 1.5), own=OWN._replace(north_m=22.0))
    assert passage is not None
    assert passage.part == 0.0


def test_a_line_is_taken_again_behind_the_thing() -> None:
    passage = way(thing(1, 60.0, 2.0), route=NORTH._replace(points=((1000.0, 0.0),), is_line=True))
    assert passage is not None
    goal, end = passage.points[-2:]
    assert end == (1000.0, 0.0)
    assert 60.0 + KEEPS_M < goal[0] < 60.0 + KEEPS_M + 10.0
    assert goal[1] == pytest.approx(0.0)


def test_the_way_does_not_lead_over_the_fence() -> None:
    limits = config.FenceTable(keep_out=(config.Area(centre=((0.0, 0.0),), radius_m=1.0),))
    shore = polygon(
        "the shore", False, [(0.0, -8.0 - limits.mission_margin_m), (300.0, -8.0 - limits.mission_margin_m), (150.0, -300.0)]
    )
    passage = way(thing(1, 100.0, 3.0), around=Fence((shore,), limits))
    assert passage is not None
    assert passage.words.endswith("leaving it to port")


def test_a_swimmer_is_passed_well_clear_and_slowly() -> None:
    swimmer = thing(1, 100.0, 3.0, kind="person")
    passage = way(swimmer)
    assert passage is not None
    assert "lidar 1, a swimmer, leaving" in passage.words
    assert nearest_m(passage, swimmer) >= KEEPS_M + 20.0
    assert swimmer_near(LIMITS, OWN, 1.5, [swimmer]) is None
    assert swimmer_near(LIMITS, OWN._replace(north_m=40.0), 1.5, [swimmer]) is swimmer


def test_a_decision_among_a_hundred_is_bounded_and_goes_in_slices() -> None:
    wall = [thing(i, 60.0 + 30.0 * (i % 2), -4.0 * i if i % 4 < 2 else 4.0 * i) for i in range(MOST)]
    slices: Sequence[int] = list(past(LIMITS, OWN, NORTH, wall, None, None))
    assert sum(slices) < SPENT + 3 * 1000
    assert max(slices) <= 2 * MOST


@pytest.mark.parametrize("seed", [20047, 20219, 3003, 3011])
def test_out_of_a_pocket_of_walls_the_boat_finds_its_way(seed: int) -> None:
    sailed = worlds.sail(seed)
    assert (sailed.sort, sailed.end) == ("pocket", "arrived")
    assert sailed.nearest_m > 4.0


@pytest.mark.parametrize(("seed", "sort"), [(1, "moorings"), (5, "moorings"), (2, "entrance"), (6, "entrance")])
def test_between_moored_boats_and_through_an_entrance_it_goes_clear(seed: int, sort: str) -> None:
    sailed = worlds.sail(seed)
    assert (sailed.sort, sailed.end) == (sort, "arrived")
    assert sailed.nearest_m > 6.0


@pytest.mark.parametrize("seed", [0, 3, 8, 236])
def test_worlds_that_were_hard_are_sailed(seed: int) -> None:
    sailed = worlds.sail(seed)
    assert sailed.end == "arrived"
    assert sailed.nearest_m > 5.0
    assert sailed.long < 1.3


# Through the whole program.


@pytest.fixture
def sea(boat: Any) -> Any:
    return afloat(boat)


def say(sea: Any, **more: Any) -> None:
    target = {"id": "7", "latitude_deg": HERE[0] + 0.001, "longitude_deg": HERE[1], "kind": "thing", "radius_m": 1.5} | more
    sea.vehicle.on_guest(json.dumps({"target": target}).encode())
    sail(sea, 2.5)


def test_a_thing_that_the_guest_sees_is_told_to_consoles(sea: Any) -> None:
    say(sea)
    (target,) = sea.state.traffic.targets
    assert (target.key, target.name, target.kind, target.length_m, target.is_lost) == (
        "thing 1",
        "guest 7",
        "thing",
        3.0,
        False,
    )
    message = told(target, sea.state.origin)
    assert (message.MMSI, kind_of(message.MMSI), message.name) == (990_000_001, "thing", "guest 7")
    assert (number_of("person 12"), kind_of(990_001_012), kind_of(244_660_123), kind_of(17)) == (990_001_012, "person", "", "")
    seen = json.loads(bytes(sea.state.traffic.told[0]))
    assert (seen["key"], seen["kind"], seen["name"]) == ("thing 1", "thing", "guest 7")


def test_what_is_hardly_believed_is_not_told(sea: Any) -> None:
    say(sea, confidence=0.4)
    assert sea.state.traffic.targets == ()
    assert "guest_malformed" not in sea.state.counts


@pytest.mark.parametrize(
    "more", [{"kind": "rock"}, {"radius_m": 51}, {"radius_m": -1}, {"confidence": 1.1}, {"confidence": None}]
)
def test_what_no_thing_can_be_is_malformed(sea: Any, more: dict[str, Any]) -> None:
    say(sea, **more)
    assert sea.state.counts["guest_malformed"] == 1
