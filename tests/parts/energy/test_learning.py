"""What the energy learns: power by push, the water's way, and what a metre costs."""

import math
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.cooperative import Sliced
from delfim.parts.energy.consumption import Consumption, Propulsive
from delfim.parts.energy.drift import DriftFound, Drifting, over_ground_mps, still_mps
from delfim.parts.energy.gauge import Gauge
from delfim.parts.energy.reach import DIRECTIONS, Metre, ahead_of, costs, doubt, joules, metre, metres
from delfim.vehicle.state import Arc, Line, Plan, Waypoint

HULL = Propulsive((20.0, 60.0), 200.0)
ANY = st.floats(allow_nan=True, allow_infinity=True)
EAST = 0.5 * math.pi
SURE = ((0.0,) * 6,) * 6


def water(north_mps: float, east_mps: float) -> DriftFound:
    return DriftFound(1.2, north_mps=north_mps, east_mps=east_mps, covariance=SURE)


def consumption() -> Consumption:
    return Consumption(HULL, 10.0, 1000.0)


@dataclass
class Sea:
    """A boat that goes `factor` times as fast as its file says, in this current; and a wind that shoves it aside, too."""

    factor: float
    north_mps: float
    east_mps: float
    wind_north_mps: float = 0.0

    def sailed(self, headings_deg: list[float], seconds: int = 130, stills: tuple[float, ...] = (1.2,)) -> Drifting:
        drifting = Drifting(1.2)
        for still in stills:
            for heading in map(math.radians, headings_deg):
                north, east = math.cos(heading), math.sin(heading)
                ahead, aside = self.wind_north_mps * north * 1.2 / still, -2.5 * self.wind_north_mps * east * 1.2 / still
                through = self.factor * still + ahead
                over = through * north - aside * east + self.north_mps, through * east + aside * north + self.east_mps
                for _ in range(seconds):
                    drifting.learn(still, heading, *over, 1.0)
                    drifting.pass_by(1.0)
        return drifting


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
    found = Sea(0.9, 0.2, -0.1).sailed([0.0, 90.0, 180.0, 270.0] * 2).found
    assert (found.factor, found.north_mps, found.east_mps) == pytest.approx((0.9, 0.2, -0.1), abs=0.03)


def test_wind_that_shoves_the_boat_aside_is_no_current() -> None:
    found = Sea(1.0, 0.0, 0.2, 0.08).sailed([0.0, 90.0, 180.0, 270.0, 45.0] * 2).found
    assert (found.north_mps, found.east_mps, found.wind_north_mps) == pytest.approx((0.0, 0.2, 0.08), abs=0.03)


def test_gusts_that_the_autopilot_answers_are_no_slow_hull() -> None:
    drifting = Drifting(1.2)
    for heading in map(math.radians, [0.0, 90.0, 180.0, 270.0]):
        for second in range(300):
            gust = 0.1 * math.sin(second)  # more push, and the same speed
            drifting.learn(1.2 + gust, heading, 1.2 * math.cos(heading), 1.2 * math.sin(heading), 1.0)
            drifting.pass_by(1.0)
    found = drifting.found
    assert (found.factor, found.slope) == pytest.approx((1.0, 0.0), abs=0.03)


def test_one_course_leaves_the_way_back_uncertain() -> None:
    one, all_round = (Sea(1.0, 0.3, 0.0).sailed(each).found for each in ([0.0], [0.0, 90.0, 180.0, 270.0]))
    assert all(still_mps(found, 1.5, 0.0)[0] == pytest.approx(1.2, abs=0.05) for found in (one, all_round))
    back = [0.0] * (DIRECTIONS // 2) + [1000.0] + [0.0] * (DIRECTIONS // 2 - 1)
    power = consumption()
    for speed_mps in (0.8, 1.0, 1.2, 1.4) * 20:
        power.learn(speed_mps, 25.0 + 100.0 * speed_mps**2.2, 10.0)
    more = [doubt(back, Sliced(costs(power, each, HULL.full_mps, 1.2)).finish(), each) for each in (one, all_round)]
    assert more[0] > 1.5 * more[1] > 0.0


@pytest.mark.parametrize(("is_guessed", "off_mps"), [(True, 0.01), (False, 0.04)])
def test_a_slow_boat_that_is_slower_than_the_square_of_her_drag_has_it_is_foretold_when_fast(
    is_guessed: bool, off_mps: float
) -> None:
    drifting = Drifting(1.5, is_guessed)
    for still, through_mps in ((1.0, 0.92), (1.2, 1.144)):  # of DelfimX; 1.5 makes 1.48
        for heading in (0.0, math.pi):
            for _ in range(130):
                drifting.learn(still, heading, through_mps * math.cos(heading) + 0.2, 0.0, 1.0)
                drifting.pass_by(1.0)
    assert still_mps(drifting.found, 1.68, 0.0)[0] == pytest.approx(1.5 + off_mps, abs=0.01)


def test_a_current_that_turns_by_120_degrees_an_hour_is_followed() -> None:
    drifting, turn_radps = Drifting(1.2), math.radians(120.0) / 3600.0
    for second in range(3600):
        heading = math.radians(100.0 * (second // 100))
        north_mps, east_mps = 0.4 * math.cos(turn_radps * second), 0.4 * math.sin(turn_radps * second)
        drifting.learn(1.2, heading, 1.2 * math.cos(heading) + north_mps, 1.2 * math.sin(heading) + east_mps, 1.0)
        drifting.pass_by(1.0)
    assert math.dist((drifting.found.north_mps, drifting.found.east_mps), (north_mps, east_mps)) < 0.05


def test_what_is_known_of_the_water_ages() -> None:
    drifting = Sea(1.0, 0.3, 0.0).sailed([0.0, 90.0, 180.0, 270.0])
    before = drifting.found.covariance
    for _ in range(3600):
        drifting.pass_by(1.0)
    assert drifting.found.covariance[2][2] > 2.0 * before[2][2]
    assert drifting.found.covariance[2][2] <= 0.3**2


@given(st.lists(st.tuples(ANY, ANY, ANY, ANY, ANY), max_size=30))
def test_no_motion_makes_the_drift_raise_or_be_none(motions: list[tuple[float, float, float, float, float]]) -> None:
    drifting = Drifting(1.5)
    for motion in motions:
        drifting.learn(*motion)
    assert all(map(math.isfinite, drifting.found[:7]))
    assert still_mps(drifting.found, 1.0, 1.0)[0] >= 0.0


def test_a_metre_against_the_water_costs_more_than_one_with_it() -> None:
    by_direction = Sliced(costs(consumption(), water(0.0, 0.3), HULL.full_mps, 1.0)).finish()
    assert len(by_direction) == DIRECTIONS
    east, west = by_direction[DIRECTIONS // 4].joules, by_direction[3 * DIRECTIONS // 4].joules
    assert west > 3.0 * east
    assert by_direction[0].joules == pytest.approx(by_direction[DIRECTIONS // 2].joules)


@pytest.mark.parametrize("index", range(6))
@pytest.mark.parametrize(("speed_mps", "rel"), [(1.0, 0.2), (1.6, 0.4)])  # with push to spare, and without
def test_the_slopes_of_a_metre_are_those_of_its_energy(index: int, speed_mps: float, rel: float) -> None:
    power, course_rad = consumption(), math.radians(40.0)
    at = DriftFound(1.2, 0.95, 0.1, 0.0, -0.3)
    before = metre(power, at, 1.5, speed_mps, course_rad)
    moved = list(at)
    moved[1 + index] += 1e-3
    after = metre(power, DriftFound(*moved), 1.5, speed_mps, course_rad)  # type: ignore[arg-type]
    assert (after.joules - before.joules) / 1e-3 == pytest.approx(before.by[index], rel=rel, abs=0.05 * before.joules)


def test_a_boat_that_the_water_carries_away_has_no_way_back() -> None:
    away = water(0.0, 2.5)
    assert over_ground_mps(away, HULL.full_mps, -EAST) == 0.0
    assert metre(consumption(), away, HULL.full_mps, 1.0, -EAST).joules == math.inf
    assert math.isfinite(metre(consumption(), away, HULL.full_mps, 1.0, EAST).joules)


def test_a_way_is_the_sum_of_its_metres() -> None:
    by_direction = [Metre(float(index)) for index in range(DIRECTIONS)]
    by_direction[1] = Metre(math.inf)  # no way there, and none of it
    lengths_m = Sliced(metres(((0.0, 0.0), (10.0, 0.0), (10.0, 20.0), (10.0, 20.0)))).finish()
    assert joules(lengths_m, by_direction) == pytest.approx(20.0 * DIRECTIONS / 4)


def test_a_battery_that_holds_less_than_its_file_says_is_found_out() -> None:
    gauge, left_wh = Gauge(1000.0), 1000.0
    for second in range(3600):
        left_wh -= 1.25 * 500.0 / 3600.0
        gauge.learn(round(left_wh / 5.0) * 5.0, 500.0, 1.0)
        if second == 1800:
            gauge.learn(300.0, 500.0, 1.0)  # it said nonsense once
    assert gauge.per == pytest.approx(1.25, abs=0.02), "what was believed before it told is forgotten"


@given(st.lists(st.tuples(st.none() | ANY, st.none() | ANY, ANY), max_size=30))
def test_no_battery_makes_the_gauge_raise_or_be_none(told: list[tuple[float | None, float | None, float]]) -> None:
    gauge = Gauge(100.0)
    for each in told:
        gauge.learn(*each)
    assert 0.6 <= gauge.per <= 1.6


def test_a_plan_is_its_places_from_the_present_leg_on() -> None:
    waypoints = tuple(Waypoint(float(north), 0.0, 1.0 + north, 3.0) for north in range(3))
    assert Sliced(ahead_of(Plan("a", waypoints, ()), 1)).finish() == (((1.0, 0.0), (2.0, 0.0)), 2.5)
    path = Line(0.0, 0.0, 10.0, 0.0, 1.0), Arc(10.0, 5.0, 5.0, -EAST, math.pi, 1.0)
    places, _ = Sliced(ahead_of(Plan("b", (), path), 0)).finish()
    assert len(places) == 5
    assert places[-1] == pytest.approx((10.0, 10.0))
    assert Sliced(ahead_of(Plan("c", (), ()), 0)).finish() == ((), 0.0)
