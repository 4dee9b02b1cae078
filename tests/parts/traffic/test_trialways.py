"""The ways that a decision compares, leg by leg."""

import math

import pytest

from delfim.parts.traffic.encounter import Own
from delfim.parts.traffic.trialways import Caution, RouteAhead, clear_m, core, route_legs, swept, trial_legs
from delfim.vehicle.target import Target

OWN = Own(100.0, -200.0, 0.0, 1.0)


def test_along_its_route_the_boat_goes_as_fast_as_asked_and_then_stays() -> None:
    route = RouteAhead(((400.0, -200.0), (400.0, 200.0)), 2.0)
    assert route[1:] == (2.0, True, None, False)
    assert route_legs(OWN, route) == [
        (0.0, 150.0, 100.0, -200.0, 2.0, 0.0),
        (150.0, 350.0, 400.0, -200.0, 0.0, 2.0),
        (350.0, math.inf, 400.0, 200.0, 0.0, 0.0),
    ]


@pytest.mark.parametrize(("speed_mps", "legs"), [(0.0, 1), (0.05, 1), (0.0625, 2)])
def test_a_boat_that_hardly_moves_stays(speed_mps: float, legs: int) -> None:
    assert len(route_legs(OWN, RouteAhead(((110.0, -200.0),), speed_mps))) == legs


@pytest.mark.parametrize(("north_m", "legs"), [(100.0, 1), (100.0625, 1), (100.125, 2)])
def test_a_point_where_the_boat_is_already_is_no_leg(north_m: float, legs: int) -> None:
    found = route_legs(OWN, RouteAhead(((north_m, -200.0), (100.0, -100.0)), 1.0))
    assert len(found) == legs + 1
    assert found[-1][2:4] == (100.0, -100.0)
    assert len(route_legs(Own(0.0, 0.0, 0.0, 1.0), RouteAhead(((0.1, 0.0),), 1.0))) == 2


@pytest.mark.parametrize(("first_m", "legs"), [(1800.0, 3), (1801.0, 2)])
def test_what_comes_after_half_an_hour_does_not_matter(first_m: float, legs: int) -> None:
    points = (100.0 + first_m, -200.0), (100.0 + first_m, 0.0)
    assert len(route_legs(OWN, RouteAhead(points, 1.0))) == legs


@pytest.mark.parametrize(
    ("own_rad", "course_rad", "speed_mps", "wait_s"),
    [
        (0.0, 0.0, 1.0, 0.0),
        (0.0, 1.0, 1.0, 2.0),
        (1.0, -0.5, 1.0, 3.0),
        (0.25, math.tau - 0.25, 1.0, 1.0),
        (0.5, 0.5, 3.0, 2.0),
        (0.5, 0.5, 0.5, 0.5),
        (0.5, 1.5, 3.0, 2.0),
        (0.5, 1.0, 4.0, 3.0),
    ],
)
def test_a_turn_and_a_change_of_speed_are_a_wait_on_the_old_course(own_rad, course_rad, speed_mps, wait_s):
    boat = Caution(5.0, 0.25, 0.5)
    assert boat[3:] == (180.0, "small", 10.0, 30.0, 8.0)
    first, then = trial_legs(boat, OWN._replace(course_rad=own_rad, speed_mps=1.0), course_rad, speed_mps)
    way = math.cos(own_rad), math.sin(own_rad)
    assert first == pytest.approx((0.0, wait_s, 100.0, -200.0, *way))
    place = 100.0 + wait_s * way[0], -200.0 + wait_s * way[1]
    assert then == pytest.approx((wait_s, math.inf, *place, speed_mps * math.cos(course_rad), speed_mps * math.sin(course_rad)))
    fast, _ = trial_legs(boat, OWN._replace(speed_mps=2.0), 0.0, 2.0)
    assert fast == (0.0, 0.0, 100.0, -200.0, 2.0, 0.0)


@pytest.mark.parametrize(
    ("kind", "part", "expected_m"),
    [("thing", 1.0, 10.0), ("thing", 0.5, 5.0), ("person", 1.0, 30.0), ("person", 0.5, 15.0), ("person", 0.25, 14.0)],
)
def test_how_far_a_boat_keeps_from_things_and_swimmers(kind: str, part: float, expected_m: float) -> None:
    assert clear_m(Caution(4.0, 0.25, 0.5), kind, part) == expected_m, "never as near as where the propellers stop"


def test_where_the_middle_of_the_boat_cannot_be() -> None:
    thing = Target("1", "buoy", 0.0, 0.0, 0.0, 0.0, math.nan, 2.0, 2.0, True, 0.5, 0.0, False, "thing", 0)
    assert core(Caution(4.0, 0.25, 0.5), thing) == 3.5


@pytest.mark.parametrize(
    ("its_mps", "off", "speed_mps", "half_m"),
    [
        (0.0, (24.0, 18.0), 2.0, 0.0),
        (1.0, (24.0, 18.0), 2.0, 7.5),  # 30 m: the boat is there in 15 s, and the swimmer 15 m farther
        (0.5, (-24.0, 18.0), 2.0, 3.75),
        (0.5, (240.0, 180.0), 2.0, 5.0),  # reckoned on for 20 s at most
        (0.5, (0.6, 0.8), 0.05, 2.5),  # a boat that hardly moves counts as 0.1 m/s
    ],
)
def test_what_moves_is_passed_where_it_may_be_by_then(its_mps, off, speed_mps, half_m) -> None:
    place = OWN.north_m + off[0], OWN.east_m + off[1]
    swimmer = Target("1", "ANA", *place, math.radians(30.0), its_mps, math.nan, 1.0, 1.0, True, 3.0, 0.0, False, "person", 0)
    found = swept(OWN, speed_mps, swimmer)
    north_m, east_m = half_m * math.cos(math.radians(30.0)), half_m * math.sin(math.radians(30.0))
    assert (found.north_m, found.east_m) == pytest.approx((place[0] + north_m, place[1] + east_m))
    assert found.margin_m == pytest.approx(3.0 + half_m), "the circle holds where it is and where it will be"
    assert found._replace(north_m=place[0], east_m=place[1], margin_m=3.0) == swimmer._replace(heading_rad=found.heading_rad)
