"""OBSTACLE_DISTANCE, encoded by pymavlink: what it says becomes things that stand, through the link and the look-out."""

import math
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from delfim.parts.mavlink.received.othervessels import NEAREST
from tests.parts.mavlink.test_mavlink_station import afloat, sail

BODY, GLOBAL, NOTHING = 12, 0, 65_535


@pytest.fixture
def sea(boat):
    return afloat(boat)


def say(sea: Any, at: dict[int, int], seconds: float = 4.0, **more: Any) -> None:
    """A lidar of 72 directions of 5 degrees, twice a second; `at`: cm by direction."""
    told = {"increment": 5, "least": 50, "most": 4000, "increment_f": 0.0, "offset": 0.0, "frame": BODY} | more
    distances = [at.get(i, NOTHING) for i in range(72)]
    for _ in range(round(2.0 * seconds)):
        sea.console.say("obstacle_distance", 0, 0, distances, *told.values())
        sail(sea, 0.5)


def seen(sea: Any) -> list[tuple[float, float]]:
    """(distance to the near edge, bearing in degrees) of each thing, from the boat."""
    motion, found = sea.state.motion, []
    for each in sea.state.traffic.targets:
        assert each.kind == "thing"
        north_m, east_m = each.north_m - motion.north_m, each.east_m - motion.east_m
        found.append((math.hypot(north_m, east_m) - each.length_m / 2.0, math.degrees(math.atan2(east_m, north_m)) % 360.0))
    return sorted(found)


def test_an_obstacle_stands_where_it_was_seen_from_the_bow(sea) -> None:
    say(sea, {4: 2000})
    ((far_m, bearing_deg),) = seen(sea)
    heading_deg = math.degrees(sea.state.motion.heading_rad)
    assert far_m == pytest.approx(20.0, abs=0.3)
    assert bearing_deg == pytest.approx((heading_deg + 20.0) % 360.0, abs=1.0)
    assert sea.state.traffic.targets[0].name == f"lidar {sea.console.party[1]}"


def test_from_north_with_an_offset_and_steps_of_its_own(sea) -> None:
    say(sea, {10: 1500}, frame=GLOBAL, increment_f=2.5, offset=-45.0)
    ((far_m, bearing_deg),) = seen(sea)
    assert far_m == pytest.approx(15.0, abs=0.3)
    assert bearing_deg == pytest.approx(340.0, abs=1.0)


def test_what_is_seen_once_is_not_believed_and_nothing_is_no_obstacle(sea) -> None:
    say(sea, {4: 2000}, seconds=0.5)
    assert seen(sea) == []
    say(sea, {1: 4001, 2: 49, 3: 0})
    assert seen(sea) == []


def test_of_a_wall_the_nearest_directions_are_taken(sea) -> None:
    say(sea, {i: 1000 + 50 * i for i in range(40)})
    assert 0 < len(sea.state.traffic.targets) <= NEAREST
    assert min(seen(sea))[0] == pytest.approx(10.0, abs=0.5)


@pytest.mark.parametrize("frame", [1, 8, 20])
def test_a_frame_that_the_message_does_not_have_is_refused(sea, frame) -> None:
    say(sea, {4: 2000}, seconds=0.5, frame=frame)
    assert sea.state.traffic.targets == ()
    assert sea.station.consoles.counts["vessels_refused"] == 1


def test_a_boat_that_does_not_know_where_it_is_sees_nothing(sea) -> None:
    sea.state.motion = sea.state.motion._replace(has=frozenset({"heading"}))
    sea.console.say("obstacle_distance", 0, 0, [2000] * 72, 5, 50, 4000, 0.0, 0.0, BODY)
    assert sea.station.consoles.counts["vessels_refused"] == 1


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=40, deadline=None)
@given(
    st.lists(st.integers(0, 65_535), min_size=72, max_size=72),
    st.tuples(st.integers(0, 255), st.integers(0, 65_535), st.integers(0, 65_535)),
    st.tuples(st.floats(width=32), st.floats(width=32)),
    st.sampled_from((BODY, GLOBAL)),
)
def test_whatever_it_says_it_is_taken_or_refused(sea, distances, bounds, angles, frame) -> None:
    sea.station.consoles.obstacles_s = -math.inf
    sea.state.heard.clear()
    sea.console.say("obstacle_distance", 0, 9, distances, *bounds, *angles, frame)
    assert len(sea.state.heard) <= NEAREST
    for each in sea.state.heard.values():
        assert math.isfinite(each.told.latitude_rad + each.told.longitude_rad + each.told.radius_m)
