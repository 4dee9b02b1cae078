"""How near two vessels come: the closed form against small steps, and its limits."""

import math
from random import Random

import pytest

from delfim.parts.traffic.cpa import Approach, Domain, Leg, approach, closest, domain, into, passing_by
from delfim.vehicle.target import Target

SHIP = Target("1", "", 30.0, -40.0, 0.0, 2.0, 0.0, 30.0, 8.0, True, 0.0, 0.0, False, "A", 0)
UNIT = Domain(0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0)
STEPS = 4000


def stepped(around: Domain, legs: list[Leg], until_s: float, after_s: float) -> Approach:
    """The same by looking often."""
    least, entered_s = Approach(math.inf, until_s, 0.0, 0.0), math.inf
    for step in range(STEPS + 1):
        t_s = after_s + (until_s - after_s) * step / STEPS
        from_s, _, north_m, east_m, north_mps, east_mps = next(leg for leg in reversed(legs) if leg[0] <= t_s)
        n = north_m + north_mps * (t_s - from_s) - around.north_m - around.north_mps * t_s
        e = east_m + east_mps * (t_s - from_s) - around.east_m - around.east_mps * t_s
        x, y = n * around.ahead_n + e * around.ahead_e, n * around.starboard_n + e * around.starboard_e
        near = math.hypot(x, y)
        if near < 1.0 and entered_s == math.inf:
            entered_s = t_s
        if near < least.nearness:
            least = Approach(near, t_s, x, y)
    return least if least.nearness >= 1.0 else least._replace(at_s=entered_s)


@pytest.mark.parametrize("seed", range(16))
def test_the_closed_form_is_what_small_steps_find(seed: int) -> None:
    chance = Random(seed)
    target = SHIP._replace(course_rad=chance.uniform(0.0, math.tau), speed_mps=chance.uniform(0.0, 2.0))
    around, legs, at, from_s = (
        domain(target, 90.0, 50.0),
        list[Leg](),
        (chance.uniform(-300, 300), chance.uniform(-300, 300)),
        0.0,
    )
    for last in (False, False, True):
        to = math.inf if last else from_s + chance.uniform(50.0, 150.0)
        speed = chance.uniform(-3.0, 3.0), chance.uniform(-3.0, 3.0)
        legs.append((from_s, to, *at, *speed))
        if not last:
            at, from_s = (at[0] + speed[0] * (to - from_s), at[1] + speed[1] * (to - from_s)), to
    for until_s, after_s in ((500.0, 0.0), (120.0, 30.0), (400.0, 180.0)):
        found, near = approach(around, legs, until_s, after_s), stepped(around, legs, until_s, after_s)
        assert found.nearness == pytest.approx(near.nearness, abs=0.02)
        assert found.at_s == pytest.approx(near.at_s, abs=1.0)
        assert (found.ahead, found.starboard) == pytest.approx((near.ahead, near.starboard), abs=0.06)


def test_a_domain_moves_with_its_vessel_along_its_course() -> None:
    course_rad = math.radians(30.0)
    around = domain(SHIP._replace(course_rad=course_rad), 100.0, 40.0)
    cos, sin = math.cos(course_rad), math.sin(course_rad)
    assert around[:4] == (30.0, -40.0, 2.0 * cos, 2.0 * sin)
    for (n, e), place in (((100.0 * cos, 100.0 * sin), (1.0, 0.0)), ((-40.0 * sin, 40.0 * cos), (0.0, 1.0))):
        stretched = n * around.ahead_n + e * around.ahead_e, n * around.starboard_n + e * around.starboard_e
        assert stretched == pytest.approx(place)


@pytest.mark.parametrize(
    ("legs", "until_s", "after_s", "found"),
    [
        ([], 9.0, 0.0, (math.inf, 9.0, 0.0, 0.0)),
        ([(0.0, 5.0, 3.0, 0.0, 0.0, 0.0)], 9.0, 5.0, (math.inf, 9.0, 0.0, 0.0)),
        ([(5.0, 7.0, 3.0, 0.0, 0.0, 0.0)], 5.0, 0.0, (math.inf, 5.0, 0.0, 0.0)),
        ([(0.0, 9.0, 3.0, 4.0, 0.0, 0.0)], 9.0, 2.0, (5.0, 2.0, 3.0, 4.0)),
        ([(0.0, 9.0, 0.5, 0.0, 0.0, 0.0)], 9.0, 2.0, (0.5, 2.0, 0.5, 0.0)),
        ([(0.0, 9.0, 0.5, 0.0, 0.0, 0.0)], 9.0, 0.0, (0.5, 0.0, 0.5, 0.0)),
        ([(0.0, 5.0, 3.0, 4.0, 0.0, 0.0), (5.0, 9.0, 3.0, 4.0, 0.0, 0.0)], 9.0, 0.0, (5.0, 0.0, 3.0, 4.0)),
        (
            [(0.0, 6.0, -3.0, 1.2, 1.0, 0.0), (6.0, 12.0, 3.0, 1.2, -1.0, -0.4)],
            12.0,
            0.0,
            (0.0, 9.0 - 1.0 / math.sqrt(1.16), 0.0, 0.0),
        ),
        ([(0.0, 9.0, -3.0, 0.0, 1.0, 0.0)], 9.0, 0.0, (0.0, 2.0, 0.0, 0.0)),
        ([(0.0, 9.0, -3.0, 0.0, 1.0, 0.0)], 9.0, 2.5, (0.0, 2.5, 0.0, 0.0)),
        ([(0.0, 9.0, -3.0, 0.0, 1.0, 0.0)], 9.0, 6.0, (3.0, 6.0, 3.0, 0.0)),
        ([(0.0, 9.0, -3.0, 1.0, 1.0, 0.0)], 9.0, 0.0, (1.0, 3.0, 0.0, 1.0)),
        ([(0.0, 2.0, -3.0, 2.0, 1.0, 0.0), (2.0, 9.0, -1.0, 2.0, 0.0, 0.0)], 9.0, 0.0, (math.sqrt(5.0), 2.0, -1.0, 2.0)),
        ([(0.0, math.inf, -2.0, 0.0, math.sqrt(1.5e-12), 0.0)], 2e6, 0.0, (0.0, 1.0 / math.sqrt(1.5e-12), 0.0, 0.0)),
        ([(0.0, math.inf, -2.0, 0.0, math.sqrt(0.5e-12), 0.0)], 4e6, 0.0, (2.0, 0.0, -2.0, 0.0)),
    ],
)
def test_the_limits(legs: list[Leg], until_s: float, after_s: float, found: tuple[float, ...]) -> None:
    assert approach(UNIT, legs, until_s, after_s) == pytest.approx(found, abs=1e-9)
    if not after_s:
        assert approach(UNIT, legs, until_s) == passing_by(UNIT, legs, until_s) == pytest.approx(found, abs=1e-9)


@pytest.mark.parametrize(
    ("place", "speed", "course_rad", "cpa"),
    [
        ((30.0, -140.0), (0.0, 3.0), 0.0, (100.0 * 2.0 / math.sqrt(13.0), 300.0 / 13.0)),
        ((30.0, -140.0), (0.0, -3.0), 0.0, (100.0, -300.0 / 13.0)),
        ((130.0, -40.0), (-1.0, 0.0), 0.0, (0.0, 100.0 / 3.0)),
        ((60.0, 0.0), (2.0, 0.0), 0.0, (50.0, 0.0)),
        ((60.0, 0.0), (2.009, 0.0), 0.0, (50.0, 0.0)),
        ((60.0, -40.0), (1.98828125, 0.0), 0.0, (0.0, 30.0 / 0.01171875)),
        ((30.0, 60.0), (0.0, 0.0), math.pi / 2.0, (0.0, 50.0)),
    ],
)
def test_the_closest_point_of_approach(place, speed, course_rad, cpa):
    assert closest(0.0, 0.0, 0.0, 0.0, SHIP._replace(speed_mps=0.01)) == (50.0, 0.0), "as good as none"
    assert closest(*place, *speed, SHIP._replace(course_rad=course_rad)) == pytest.approx(cpa, abs=1e-9)


GOES = SHIP._replace(north_m=40.0, east_m=-20.0, margin_m=15.0, length_m=5.0)  # away: 50 m from the middle
COMES = GOES._replace(north_m=-36.0, east_m=-8.0, speed_mps=5.0, course_rad=math.atan2(4.0, 3.0))  # 20 m from it after 10 s


@pytest.mark.parametrize(
    ("target", "radius_m", "within_s", "at_s"),
    [
        (GOES, 31.0, 60.0, 0.0),
        (GOES, 30.0, 60.0, None),
        (COMES, 5.0, 60.0, 10.0),
        (COMES, 5.0, 8.0, 8.0),
        (COMES, 5.0, 2.0, None),
        (COMES._replace(margin_m=5.0), 5.0, 60.0, None),
    ],
)
def test_who_comes_into_a_circle_and_when(target: Target, radius_m: float, within_s: float, at_s: float | None) -> None:
    assert into(10.0, 20.0, radius_m, target, within_s) == (None if at_s is None else pytest.approx(at_s))
