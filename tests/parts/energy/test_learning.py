"""What the energy learns: power by push, the water's way, and what a metre costs."""

import math
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.cooperative import Sliced
from delfim.parts.energy.consumption import Consumption, Propulsive
from delfim.parts.energy.drift import DriftFound, Drifting, over_ground_mps, still_mps
from delfim.parts.energy.reach import DIRECTIONS, ahead_of, along, costs, joules_per_m
from delfim.vehicle.state import Arc, Line, Plan, Waypoint

HULL = Propulsive((20.0, 60.0), 200.0)
ANY = st.floats(allow_nan=True, allow_infinity=True)
EAST = 0.5 * math.pi
SURE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def consumption() -> Consumption:
    return Consumption(HULL, 10.0, 1000.0)


@dataclass
class Sea:
    """A boat that goes `factor` times as fast as its file says, in this current."""

    factor: float
    north_mps: float
    east_mps: float

    def sailed(self, headings_deg: list[float], seconds: int = 60, still: float = 1.2) -> DriftFound:
        drifting = Drifting(still)
        for heading in map(math.radians, headings_deg):
            for _ in range(seconds):
                through = self.factor * still
                over_ground = through * math.cos(heading) + self.north_mps, through * math.sin(heading) + self.east_mps
                drifting.learn(still, heading, *over_ground, 1.0)
        return drifting.found


def test_push_and_speed_are_each_other() -> None:
    assert HULL.push(HULL.still_mps(0.4)) == pytest.approx(0.4)
    assert Propulsive((50.0, 0.0), 100.0).still_mps(0.5) == pytest.approx(1.0)
    assert HULL.still_mps(-0.3) == 0.0


def test_a_boat_that_never_sailed_answers_by_its_file() -> None:
    assert consumption().watts(HULL.full_mps) == pytest.approx(1010.0)
    assert consumption().watts(0.0) < 15.0


def test_what_was_told_at_some_speeds_is_answered_between_and_beyond() -> None:
    power = consumption()
    for speed_mps in (0.7, 1.0, 1.2) * 3:
        power.learn(speed_mps, 25.0 + 100.0 * speed_mps**2.2, 100.0)
    power.learn(0.0, 25.0, 60.0)
    assert power.watts(0.9) == pytest.approx(25.0 + 100.0 * 0.9**2.2, rel=0.05)
    assert power.watts(1.5) == pytest.approx(25.0 + 100.0 * 1.5**2.2, rel=0.12)


@given(st.lists(st.tuples(ANY, ANY, ANY), max_size=30))
def test_no_report_makes_the_power_raise_or_be_none(reports: list[tuple[float, float, float]]) -> None:
    power = consumption()
    for report in reports:
        power.learn(*report)
    assert 0.0 <= power.watts(1.0) < math.inf


def test_courses_all_round_tell_boat_and_water_apart() -> None:
    found = Sea(0.85, 0.2, -0.1).sailed([0.0, 90.0, 180.0, 270.0])
    assert (found.factor, found.north_mps, found.east_mps) == pytest.approx((0.85, 0.2, -0.1), abs=0.03)


def test_one_course_leaves_the_way_back_uncertain() -> None:
    one, all_round = Sea(1.0, 0.3, 0.0).sailed([0.0], 240), Sea(1.0, 0.3, 0.0).sailed([0.0, 90.0, 180.0, 270.0])
    assert all(still_mps(found, 1.5, 0.0) == pytest.approx(1.2, abs=0.05) for found in (one, all_round))
    more = [
        still_mps(each, 1.5, math.pi) - still_mps(each._replace(covariance=SURE), 1.5, math.pi) for each in (one, all_round)
    ]
    assert more[0] > 1.5 * more[1] > 0.0


@given(st.lists(st.tuples(ANY, ANY, ANY, ANY, ANY), max_size=30))
def test_no_motion_makes_the_drift_raise_or_be_none(motions: list[tuple[float, float, float, float, float]]) -> None:
    drifting = Drifting(1.5)
    for motion in motions:
        drifting.learn(*motion)
    assert all(map(math.isfinite, drifting.found[:3]))
    assert still_mps(drifting.found, 1.0, 1.0) >= 0.0


def test_a_metre_against_the_water_costs_more_than_one_with_it() -> None:
    water = DriftFound(1.0, 0.0, 0.3, SURE)
    by_direction = Sliced(costs(consumption(), water, HULL.full_mps, 1.0)).finish()
    assert len(by_direction) == DIRECTIONS
    east, west = by_direction[DIRECTIONS // 4], by_direction[3 * DIRECTIONS // 4]
    assert west > 3.0 * east
    assert by_direction[0] == pytest.approx(by_direction[DIRECTIONS // 2])


def test_a_boat_that_the_water_carries_away_has_no_way_back() -> None:
    water = DriftFound(1.0, 0.0, 2.5, SURE)
    assert over_ground_mps(water, HULL.full_mps, -EAST) == 0.0
    assert joules_per_m(consumption(), water, HULL.full_mps, 1.0, -EAST) == math.inf
    assert math.isfinite(joules_per_m(consumption(), water, HULL.full_mps, 1.0, EAST))


def test_a_way_is_the_sum_of_its_metres() -> None:
    by_direction = tuple(float(index) for index in range(DIRECTIONS))
    way = (0.0, 0.0), (10.0, 0.0), (10.0, 20.0), (10.0, 20.0)
    assert Sliced(along(way, by_direction)).finish() == pytest.approx(20.0 * DIRECTIONS / 4)


def test_a_plan_is_its_places_from_the_present_leg_on() -> None:
    waypoints = tuple(Waypoint(float(north), 0.0, 1.0 + north, 3.0) for north in range(3))
    assert Sliced(ahead_of(Plan("a", waypoints, ()), 1)).finish() == (((1.0, 0.0), (2.0, 0.0)), 2.5)
    path = Line(0.0, 0.0, 10.0, 0.0, 1.0), Arc(10.0, 5.0, 5.0, -EAST, math.pi, 1.0)
    places, _ = Sliced(ahead_of(Plan("b", (), path), 0)).finish()
    assert len(places) == 5
    assert places[-1] == pytest.approx((10.0, 10.0))
    assert Sliced(ahead_of(Plan("c", (), ()), 0)).finish() == ((), 0.0)
