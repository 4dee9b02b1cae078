"""Keeping clear of other vessels: the rules of the road in standard encounters, and any input at all."""

import math
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.things import thing
from delfim import config
from delfim.base.cooperative import Sliced
from delfim.base.geodesy import wrap
from delfim.parts.traffic.cpa import approach, closest, domain
from delfim.parts.traffic.encounter import Own, duty, stands_on
from delfim.parts.traffic.keepclear import Choice, Memory, decide, deciding
from delfim.parts.traffic.trialways import RouteAhead, route_legs
from delfim.parts.traffic.watchkeeper import caution
from delfim.vehicle.control.memory import settings_of
from delfim.vehicle.plans.fence import Fence
from delfim.vehicle.plans.zones import circle, clearance_m, polygon
from delfim.vehicle.target import CourseOrder, Target
from tests.parts.traffic.encounters import LIMITS, encounters, place, sail, score, target
from tests.parts.traffic.encounters import ClassB as ByClassB
from tests.parts.traffic.encounters import Ship as Vessel

NORTH = Own(0.0, 0.0, 0.0, 1.5)
GOAL = RouteAhead(((5000.0, 0.0),), 1.5)


def ship(north_m: float, east_m: float, course_deg: float, speed_mps: float, length_m: float = 30.0, status: int = 0) -> Target:
    vessel = Vessel(north_m, east_m, math.radians(course_deg), speed_mps, length_m, "", 0.0)
    return target(1, vessel)._replace(name="MARIA", status=status)


def met(tcpa_s: float, course_deg: float, mps: float, length_m: float, off_m: float = 0.0) -> Target:
    """A ship that meets the boat, which goes north, after this time, so many metres to the side of its course."""
    north_m, east_m = (mps * tcpa_s * each(math.radians(course_deg)) for each in (math.cos, math.sin))
    return ship(1.5 * tcpa_s - north_m, off_m - east_m, course_deg, mps, length_m)


def ordered(*targets: Target, around: Fence | None = None, stand_on: str = "always") -> CourseOrder | None:
    return decide(LIMITS._replace(stand_on=stand_on), Memory(), NORTH, GOAL, targets, around, 0.0).order


@pytest.mark.parametrize(
    ("name", "failing"),
    [
        ("imazu22-similar", 0),
        pytest.param("imazu22-real", 0, marks=pytest.mark.long),
        pytest.param("dnv55-similar", 3, marks=pytest.mark.long),
        pytest.param("dnv55-real", 3, marks=pytest.mark.long),
    ],
)
def test_standard_encounters_are_kept_clear_of_by_the_rules(name: str, failing: int) -> None:
    """`failing`: checks that may fail, because two ships ask for opposite things."""
    scores = {title: score(sail(ships)) for title, ships in encounters(name)}
    assert {title: each.nearness for title, each in scores.items() if min(each.nearness) < 0.999} == {}
    failed = [f"{title}: {rule}" for title, each in scores.items() for rule, kept in each.checks.items() if False in kept]
    assert len(failed) <= failing, failed
    never = ("8a ample time", "8b large", "8d clear", "14, 15 not to port")
    assert {rule for line in failed if (rule := line.split(": ")[1]) in never} == set()


@pytest.mark.long
@pytest.mark.parametrize("name", ["imazu22-similar", "imazu22-real", "dnv55-similar", "dnv55-real"])
def test_reports_of_class_b_of_which_a_fifth_is_lost_suffice(name: str) -> None:
    scores = {title: score(sail(ships, see=ByClassB(seed))) for seed, (title, ships) in enumerate(encounters(name))}
    assert {title: each.nearness for title, each in scores.items() if min(each.nearness) < 0.999} == {}


def test_without_a_guard_the_same_encounters_end_in_domains() -> None:
    def blind(t_s: float, ships: object) -> list[Target]:
        return []

    scores = [score(sail(ships, see=blind)) for _, ships in encounters("imazu22-similar")[:4]]
    assert all(min(each.nearness) < 0.1 for each in scores)


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (met(150.0, 180.0, 1.5, 30.0), "giving way to MARIA, head-on, port to port"),
        (met(150.0, 270.0, 1.5, 30.0), "giving way to MARIA, crossing from starboard, passing astern"),
        (met(150.0, 0.0, 0.7, 30.0), "overtaking MARIA, passing on its "),
        (met(80.0, 90.0, 1.5, 30.0), "keeping clear of MARIA, crossing from port and not giving way, passing "),
        (met(300.0, 0.0, 6.0, 110.0), "keeping clear of MARIA, which overtakes, passing on its "),
        (ship(150.0, 0.0, 0.0, 0.0), "keeping clear of MARIA, which lies still, passing on its "),
        (met(150.0, 90.0, 1.5, 30.0)._replace(status=7), "giving way to MARIA, fishing, passing astern"),
    ],
)
def test_words(other: Target, words: str) -> None:
    order = ordered(other)
    assert order is not None
    assert order.words.startswith(words)
    assert "CPA" in order.words


def test_the_boat_turns_to_port_for_one_head_on_only_where_nothing_else_is_clear() -> None:
    other = met(60.0, 180.0, 4.0, 12.0)
    moored = [ship(north_m, 60.0, 0.0, 0.0)._replace(key=str(north_m), name="PIER") for north_m in range(-200, 401, 100)]
    order = ordered(other)
    assert order is not None
    assert wrap(order.course_rad) > 0.0
    assert "to port as" not in order.words
    order = ordered(other, *moored)
    assert order is not None
    assert wrap(order.course_rad) < 0.0
    assert ", to port as nothing else is clear" in order.words


def test_a_vessel_from_abaft_the_starboard_beam_passes_ahead_of_a_slower_boat() -> None:
    order = ordered(met(160.0, 330.0, 1.5, 22.0))
    assert order is not None
    assert (wrap(order.course_rad), order.speed_part) == (pytest.approx(0.0, abs=1e-9), 0.5)
    assert "crossing from starboard, passing astern" in order.words


def test_an_order_that_leads_into_nothing_stands_for_half_a_minute() -> None:
    """So that others see it: a boat amid three ships does not change its mind from second to second."""
    (_, ships), *_ = [each for each in encounters("dnv55-real") if each[0].startswith("dnv-38 ")]
    log = sail(ships, LIMITS._replace(stand_on="small"), see=ByClassB(1))
    changed_s = [now.t_s for was, now in pairwise(log) if abs(wrap(now.course_rad - was.course_rad)) > 0.2]
    assert changed_s
    assert all(after - before >= 28.0 for before, after in pairwise(changed_s))


@pytest.mark.parametrize("ahead_m", [180.0, 240.0, 300.0])
def test_a_boat_before_a_ships_bow_rather_enters_another_domain_than_being_struck(ahead_m: float) -> None:
    """Two ships turn in on both sides of a boat that lies stopped: the one comes straight at it, the other would pass."""
    stopped, route = Choice(math.radians(347.0), 0.0, is_last=False), RouteAhead(((5000.0, 0.0),), 1.5)
    before = Memory(CourseOrder(stopped.course_rad, 0.0, 0.0, "", "0", 0.5, 0.0), stopped, 0.0, 1.0)
    coming = seen_from_it(-ahead_m, 19.0, 25.0, 6.1)._replace(key="0")
    passing = seen_from_it(-217.0 - (ahead_m - 182.0) * 4.3 / 6.1, -156.0, 40.0, 4.3)._replace(key="1")
    limits = LIMITS._replace(stand_on="small")
    order = decide(limits, before, Own(0.0, 0.0, 0.0, 0.0), route, [coming, passing], None, 10.0).order
    assert order is not None
    assert order.speed_part == 1.0
    assert order.nearness > 0.28, "0.13 where it lies"


def seen_from_it(ahead_m: float, starboard_m: float, course_deg: float, speed_mps: float) -> Target:
    """A ship of 90 m, so far ahead of the boat and to starboard on its own course."""
    c, s = math.cos(math.radians(course_deg)), math.sin(math.radians(course_deg))
    return ship(ahead_m * c - starboard_m * s, ahead_m * s + starboard_m * c, course_deg, speed_mps, 90.0)


def test_the_boat_stands_on_for_whom_the_owner_says() -> None:
    small, large = met(160.0, 90.0, 1.5, 15.0), met(300.0, 90.0, 1.5, 60.0)
    assert duty(NORTH, small) == duty(NORTH, large) == "stand-on"
    assert [stands_on("stand-on", each, "small") for each in (small, large)] == [True, False]
    assert ordered(large, stand_on="always") is None
    assert ordered(large, stand_on="small") is not None
    assert ordered(small, stand_on="small") is None
    assert ordered(small, stand_on="never") is not None


@pytest.mark.parametrize("status", [2, 3, 7, 8])
@pytest.mark.parametrize("course_deg", [0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0])
def test_the_boat_gives_way_to_vessels_of_rule_18_in_every_geometry(status: int, course_deg: float) -> None:
    speed_mps = 0.7 if course_deg == 0.0 else 1.5
    order = ordered(met(150.0, course_deg, speed_mps, 30.0)._replace(status=status))
    assert order is not None
    assert "not giving way" not in order.words


@given(
    st.floats(100.0, 400.0), st.floats(0.5, 6.0), st.floats(5.0, 150.0), st.floats(-20.0, 20.0),
    st.one_of(st.floats(185.0, 280.0), st.floats(166.0, 194.0)),
)  # fmt: skip
@settings(max_examples=300)
def test_every_manoeuvre_for_a_single_ship_is_large_and_not_to_port(tcpa_s, speed_mps, length_m, off_m, course_deg):
    """Head-on and crossing, from when there is ample time."""
    other = met(tcpa_s, course_deg, speed_mps, length_m, off_m)
    owed = duty(NORTH, other)
    if owed not in ("head-on", "give-way") or place_in(other) < 2.0 or tcpa_s < 1.6 * length_m / 1.5 * 2.0:
        return
    order = ordered(other)
    if order is not None:
        turn_deg = math.degrees(wrap(order.course_rad))
        assert order.speed_part <= 0.5 or turn_deg >= 29.9
        assert turn_deg >= -0.1 or abs(turn_deg) > 175.0


BOATS = sorted((Path(__file__).parents[3] / "etc" / "boats").glob("*.toml"))


@pytest.mark.parametrize("file", BOATS, ids=lambda file: file.stem)
def test_boats_of_all_sizes_keep_clear_with_the_same_settings(file: Path) -> None:
    """Scaled by their speed and their rate of turn alone."""
    boat = config.load(file)
    limits = caution(boat, settings_of(boat))
    cruise_mps = boat.control.speed.cruise_mps
    scale = cruise_mps / 1.5
    for title, ships in encounters("imazu22-similar")[4:6]:
        scaled = [
            each._replace(north_m=each.north_m * scale, east_m=each.east_m * scale, speed_mps=each.speed_mps * scale)
            for each in ships
        ]
        assert min(score(sail(scaled, limits, cruise_mps), cruise_mps).nearness) >= 0.999, title


def place_in(other: Target) -> float:
    return place(NORTH, Vessel(*other[2:6], other.length_m, "", 0.0))[0]


_ANY = st.floats(allow_nan=True, allow_infinity=True)
_SANE = st.floats(-5000.0, 5000.0)
_NUMBER = st.one_of(_SANE, st.sampled_from([0.0, math.nan, math.inf, -math.inf, 1e308, -1e308, 1e-320]))
_TARGETS = st.lists(
    st.builds(
        Target,
        *(st.sampled_from(["1", "2", "3"]), st.just("X"), _NUMBER, _NUMBER, _NUMBER, _NUMBER, _ANY, _NUMBER, _NUMBER),
        *(st.booleans(), _NUMBER, _NUMBER, st.booleans(), st.just("A"), st.integers(0, 15)),
    ),
    max_size=30,
)
_HARBOUR = polygon("harbour", True, [(-300.0, -300.0), (900.0, -300.0), (900.0, 300.0), (-300.0, 300.0)])
_FENCE = Fence((_HARBOUR, circle("rock", False, (100.0, 0.0), 20.0)), config.FenceTable())


@given(
    st.tuples(_NUMBER, _NUMBER, _NUMBER, _NUMBER), st.lists(st.tuples(_NUMBER, _NUMBER), max_size=5), _NUMBER, _TARGETS,
    st.sampled_from([None, _FENCE]), st.lists(_NUMBER, min_size=3, max_size=3), st.booleans(),
)  # fmt: skip
@settings(max_examples=150)
def test_no_input_raises_and_every_order_is_finite(own, points, speed_mps, targets, around, times_s, has_end):
    memory = Memory()
    for now_s in times_s:
        memory, order, passes = decide(
            LIMITS, memory, Own(*own), RouteAhead(tuple(points), speed_mps, has_end), targets, around, now_s
        )
        assert len(passes) <= 12
        if order is not None:
            assert math.isfinite(order.course_rad)
            assert 0.0 <= order.speed_part <= 1.0
            assert order.speed_mps == order.speed_part * speed_mps
            assert not math.isnan(order.nearness)


def test_two_hundred_targets_and_one_on_the_own_position() -> None:
    crowd = [ship(100.0 * (i % 20) - 1000.0, 100.0 * (i // 20) - 500.0, 37.0 * i, 0.1 * (i % 50)) for i in range(200)]
    crowd = [each._replace(key=str(i)) for i, each in enumerate(crowd)]
    _, order, passes = decide(LIMITS, Memory(), NORTH, GOAL, crowd, _FENCE, 0.0)
    assert order is not None
    assert 1 <= len(passes) <= 12
    assert ordered(ship(0.0, 0.0, 0.0, 1.5)) is not None


def test_entering_is_what_counts_not_the_nearest_moment() -> None:
    """A ship of 120 m that overtakes exactly from astern: its domain reaches 480 m ahead of it."""
    around = domain(ship(-2000.0, 0.0, 0.0, 6.5, 120.0), 480.0, 192.0)
    passed = approach(around, route_legs(NORTH, GOAL), 900.0)
    assert passed.nearness == pytest.approx(0.0, abs=1e-6)
    assert passed.at_s == pytest.approx((2000.0 - 480.0) / 5.0)
    assert approach(around, route_legs(NORTH, GOAL), 300.0).nearness == pytest.approx(500.0 / 480.0)


def test_cpa_and_its_time() -> None:
    assert closest(0.0, 0.0, 1.5, 0.0, ship(300.0, 40.0, 180.0, 1.5)) == pytest.approx((40.0, 100.0))
    assert closest(0.0, 0.0, 1.5, 0.0, ship(-300.0, 0.0, 180.0, 1.5)) == pytest.approx((300.0, -100.0))
    assert closest(0.0, 0.0, 1.5, 0.0, ship(30.0, 40.0, 0.0, 1.5)) == pytest.approx((50.0, 0.0))


@pytest.mark.parametrize("half_m", [300.0, 75.0])
def test_no_encounter_drives_the_boat_over_the_fence(half_m: float) -> None:
    for _, ships in encounters("imazu22-similar")[5:9]:
        rock = circle("rock", False, (1.5 * ships[0].tcpa_s - 150.0, 60.0), 15.0)
        channel = polygon("channel", True, [(-300.0, -half_m), (9000.0, -half_m), (9000.0, half_m), (-300.0, half_m)])
        log = sail(ships, around=Fence((channel, rock), config.FenceTable()))
        assert min(clearance_m(zone, *now.own[:2]) for now in log for zone in (channel, rock)) > 3.0
        assert min(score(log).nearness) >= 0.999


@pytest.mark.parametrize("ghosts", [1, 4, 12])
@pytest.mark.parametrize("clear_m", [40.0, 12.0, 7.0, 5.0, 1.0, -5.0])
@pytest.mark.parametrize("speed_mps", [0.0, 0.05, 1.5])
def test_however_many_are_near_no_order_leads_over_the_fence(ghosts: int, clear_m: float, speed_mps: float) -> None:
    """The fence is to the west. What is left may be a stop; a boat that is too near, or outside, may come back in."""
    sea = polygon("sea", True, [(-900.0, -clear_m), (-900.0, 900.0), (900.0, 900.0), (900.0, -clear_m)])
    arc = [math.radians(45.0 + 90.0 * i / ghosts) for i in range(ghosts)]
    around = [ship(20.0 * math.cos(a), 20.0 * math.sin(a), 0.0, 0.0, 60.0)._replace(key=str(i)) for i, a in enumerate(arc)]
    own, memory = Own(0.0, 0.0, math.radians(-60.0), speed_mps), Memory()
    for t in range(3):
        route = RouteAhead((), 1.5, has_end=False)
        memory, order, _ = decide(LIMITS, memory, own, route, around, Fence((sea,), config.FenceTable()), float(t))
        if order is not None and order.speed_mps:
            there = math.sin(order.course_rad) * order.speed_mps * 20.0
            assert clearance_m(sea, 0.0, there) > min(6.0, clear_m - 0.02)


def test_a_zone_in_the_way_is_sailed_round() -> None:
    rock = circle("the rock", False, (200.0, 5.0), 40.0)
    own, memory, course_rad, around = NORTH, Memory(), 0.0, Fence((rock,), config.FenceTable())
    said = set[str]()
    for t in range(400):
        memory, order, _ = decide(LIMITS, memory, own, RouteAhead(((400.0, 0.0),), 1.5), (), around, float(t))
        said.add(order.words if order else "")
        course_rad = order.course_rad if order else math.atan2(-own.east_m, 400.0 - own.north_m)
        own = Own(own.north_m + 1.5 * math.cos(course_rad), own.east_m + 1.5 * math.sin(course_rad), course_rad, 1.5)
        assert clearance_m(rock, own.north_m, own.east_m) > 3.0
        if math.dist(own[:2], (400.0, 0.0)) < 5.0:
            break
    assert math.dist(own[:2], (400.0, 0.0)) < 5.0
    assert said == {"", "keeping clear of the rock"}


def test_a_boat_that_steers_for_the_fence_stops_where_each_way_leads_over_it() -> None:
    sea = polygon("sea", True, [(-900.0, -5.0), (-900.0, 900.0), (900.0, 900.0), (900.0, -5.0)])
    own, route = Own(0.0, 0.0, math.radians(-90.0), 1.5), RouteAhead(((0.0, -5000.0),), 1.5, has_end=False)
    _, order, _ = decide(LIMITS, Memory(), own, route, [ship(0.0, 20.0, 0.0, 0.0)], Fence((sea,), config.FenceTable()), 0.0)
    assert order is not None
    assert order.speed_part == 0.0
    assert order.words.endswith(", as all else leads over the fence, nothing is clear, stopped")


ROCK = Fence((circle("the rock", False, (200.0, 5.0), 40.0),), config.FenceTable())


def passed_m(order: CourseOrder | None, own: Own, this: Target) -> float:
    """How near the course of an order comes to a thing within a minute."""
    assert order is not None
    ways = [order.speed_mps * t for t in range(61)]
    places = [(own.north_m + m * math.cos(order.course_rad), own.east_m + m * math.sin(order.course_rad)) for m in ways]
    return min(math.dist(place, (this.north_m, this.east_m)) for place in places)


@pytest.mark.parametrize(("kind", "keeps_m"), [("thing", 14.0), ("person", 34.0)])
@pytest.mark.parametrize(
    ("others", "around", "east_m"),
    [
        ((), ROCK, 45.0),
        ((), ROCK, 30.0),
        ((met(150.0, 180.0, 1.5, 30.0),), None, 45.0),
        ((met(150.0, 270.0, 1.5, 30.0),), None, 55.0),
    ],
)
def test_a_course_for_ships_or_round_a_zone_leads_over_no_swimmer_and_no_thing(others, around, east_m, kind, keeps_m) -> None:
    """Whether or not a vessel is in sight."""
    own, this = Own(25.0, 0.0, 0.0, 1.5), thing(1, (90.0, east_m, 0.5))._replace(key=f"{kind} 1", kind=kind)
    told = LIMITS, Memory(), own, RouteAhead(((400.0, 0.0),), 1.5), others, around, 0.0
    blind = Sliced(deciding(*told)).finish().order
    assert passed_m(blind, own, this) < keeps_m, "it would, if it did not look"
    assert passed_m(Sliced(deciding(*told, (this,))).finish().order, own, this) > keeps_m


@pytest.mark.parametrize("far_m", [20.0, 60.0])
def test_things_alone_stop_no_boat_that_each_way_leads_over_the_fence(far_m: float) -> None:
    """Its mode brings it back, as without them; for a vessel it stops."""
    sea = polygon("sea", True, [(-900.0, -5.0), (-900.0, 900.0), (900.0, 900.0), (900.0, -5.0)])
    told = LIMITS, Memory(), Own(0.0, 0.0, math.radians(-90.0), 1.5), RouteAhead(((0.0, -5000.0),), 1.5)
    around, buoy = Fence((sea,), config.FenceTable()), thing(1, (0.0, far_m, 0.5))
    assert Sliced(deciding(*told, (), around, 0.0, (buoy,))).finish().order is None
    order = Sliced(deciding(*told, [ship(0.0, 20.0, 0.0, 0.0)], around, 0.0, (buoy,))).finish().order
    assert order is not None
    assert order.speed_part == 0.0
