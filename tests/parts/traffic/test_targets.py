"""The tracker of other vessels: what it believes, what it refuses, and that nothing makes it fail or grow."""

import math
import sys
from collections.abc import Callable
from functools import partial
from random import Random
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from delfim.base import geodesy
from delfim.base.vessels import VesselFacts, VesselPosition
from delfim.config import TrafficTable
from delfim.parts.traffic.reckoning import MARGIN_MAX_M
from delfim.parts.traffic.targets import FACTS_MOST, MOST, Tracker, silence_s
from delfim.vehicle.target import NEVER_S, Target

AT = geodesy.origin(math.radians(38.5), math.radians(-9.0))
OWN = 263_000_001
MARIA = 244_660_123
KNOT = 1852.0 / 3600.0
JUMP, TWICE, TWO, FULL = (
    "jump faster than 60 kn",
    "heard before",
    "two vessels with one number",
    "too many: those met last are not kept",
)
NOWHERE = "no position, or none that a vessel can have"


def report(north_m: float, east_m: float, mmsi: int = MARIA, **more: Any) -> VesselPosition:
    """Sailing north at 5 m/s, unless told otherwise."""
    told: dict[str, Any] = {"course_rad": 0.0, "speed_mps": 5.0, "heading_rad": None, "rate_radps": None, "status": 0}
    return VesselPosition(mmsi, *geodesy.from_plane(AT, north_m, east_m), **(told | more))


def facts(mmsi: int = MARIA, **more: Any) -> VesselFacts:
    told: dict[str, Any] = dict.fromkeys(VesselFacts._fields[1:])
    return VesselFacts(mmsi, **(told | more))


def tracker() -> Tracker:
    return Tracker(TrafficTable(mmsi=OWN))


def seen(tracked: Tracker, now_s: float) -> tuple[Target, ...]:
    return tracked.at(now_s, AT, 0.0, 0.0)


def one(tracked: Tracker, now_s: float) -> Target:
    (target,) = seen(tracked, now_s)
    return target


def test_the_boat_itself_is_no_target() -> None:
    tracked = tracker()
    tracked.hear(report(0.0, 0.0, mmsi=OWN), "nmea2000", 4.0)
    tracked.hear(report(0.0, 0.0, mmsi=MARIA, is_own=True), "nmea2000", 5.0)
    assert seen(tracked, 5.0) == ()
    tracked.facts(facts(mmsi=OWN, name="DELFIM"), 6.0)
    tracked.facts(facts(mmsi=MARIA, name="DELFIM", is_own=True), 7.0)
    assert (tracked.own_s, tracked.heard_s, tracked.refused) == (7.0, NEVER_S, {"own transponder": 2})


def test_what_is_no_vessel_is_no_target_and_distress_is_a_kind_of_its_own() -> None:
    tracked = tracker()
    for mmsi in (2_442_000, 992_446_006, 111_232_506):
        tracked.hear(report(100.0, 0.0, mmsi=mmsi), "nmea2000", 1.0)
    assert (seen(tracked, 1.0), tracked.refused, tracked.heard_s) == ((), {"no vessel": 3}, 1.0)
    for i, mmsi in enumerate((970_012_345, 972_012_345, 974_012_345)):
        tracked.hear(report(100.0 * i, 0.0, mmsi=mmsi, status=14), "nmea2000", 1.0)
    assert [each.kind for each in seen(tracked, 1.0)] == ["distress"] * 3


def test_a_jump_is_refused_and_counted_until_it_is_the_second_report_there() -> None:
    tracked = tracker()
    tracked.hear(report(0.0, 0.0), "nmea2000", 0.0)
    tracked.hear(report(50.0, 0.0), "nmea2000", 10.0)
    tracked.hear(report(5000.0, 0.0), "nmea2000", 20.0)
    assert one(tracked, 20.0).north_m == pytest.approx(100.0, abs=0.1)
    assert tracked.refused == {JUMP: 1}
    tracked.hear(report(150.0, 0.0), "nmea2000", 30.0)
    assert one(tracked, 30.0).north_m == pytest.approx(150.0, abs=0.1)


def test_two_ships_with_one_number_are_two_and_it_is_told() -> None:
    tracked = tracker()
    for i in range(5):
        tracked.hear(report(50.0 * i, 0.0), "nmea2000", 10.0 * i)
        tracked.hear(report(-6000.0, 50.0 * i, course_rad=math.pi / 2.0), "nmea2000", 10.0 * i + 5.0)
    near, far = seen(tracked, 45.0)
    assert (near.key, far.key) == ("244660123", "244660123 b")
    assert (near.north_m, far.north_m) == pytest.approx((225.0, -6000.0), abs=0.1)
    assert tracked.refused == {JUMP: 2, TWO: 1}


def test_of_two_with_one_number_the_one_that_goes_on_is_one() -> None:
    """The first was forged beside it, and is silent since."""
    tracked = tracker()
    tracked.hear(report(0.0, 130.0), "nmea2000", 0.0)
    for i in range(80):
        tracked.hear(report(50.0 * i, 0.0), "nmea2000", 10.0 * i + 0.1)
        if i == 5:
            assert {each.key for each in seen(tracked, 50.1)} == {"244660123", "244660123 b"}
            assert tracked.disputed == (50.1, "244660123")
        seen(tracked, 10.0 * i + 0.1)
    assert one(tracked, 790.1).key == "244660123 b"
    assert tracked.disputed[0] < 100.0
    assert tracked.refused == {TWO: 1}


def test_of_many_with_one_number_those_that_are_met_last_give_way() -> None:
    """The boat lies; the ship comes last."""
    tracked = tracker()
    for i in range(6):
        tracked.hear(report(1000.0 + 400.0 * i, 300.0 * (-1.0) ** i), "nmea2000", 1.0 + 0.1 * i)
        tracked.hear(report(1000.0 + 400.0 * i, 300.0 * (-1.0) ** i), "nmea2000", 2.0 + 0.1 * i)
    assert len(seen(tracked, 3.0)) == 6, "drawing apart"
    for second in (10.0, 20.0):
        tracked.hear(report(5000.0 - 5.0 * second, 0.0, course_rad=math.pi), "nmea2000", second)
    targets = seen(tracked, 20.0)
    assert len(targets) == 6
    assert [each.speed_mps * math.cos(each.course_rad) for each in targets].count(-5.0) == 1
    tracked.hear(report(4900.0, 900.0), "nmea2000", 21.0)
    tracked.hear(report(4905.0, 900.0), "nmea2000", 22.0)
    assert len(seen(tracked, 22.0)) == 6
    assert tracked.refused["too many vessels with one number: those met last are not kept"] >= 1


def test_class_b_on_its_rhythm_of_half_a_minute_is_never_taken_for_late() -> None:
    tracked, random = tracker(), Random(1)
    for i in range(200):
        tracked.hear(report(150.0 * i, 0.0, kind="B", second=30 * i % 60), "nmea2000", 30.0 * i + random.uniform(0.0, 3.0))
    assert tracked.refused == {}


@pytest.mark.parametrize(
    ("more", "lost_s", "kept_s"),
    [
        ({}, 60.0, 400.0),
        ({"speed_mps": 16.0 * KNOT}, 36.0, 400.0),
        ({"speed_mps": 25.0 * KNOT}, 30.0, 400.0),
        ({"status": 1, "speed_mps": 0.1}, 1080.0, 400.0),
        ({"kind": "B"}, 180.0, 400.0),
        ({"kind": "B", "speed_mps": 0.5}, 1080.0, 400.0),
        ({"kind": "fleet"}, 15.0, 45.0),
    ],
)
def test_who_falls_silent_is_lost_after_the_limit_of_its_kind_and_then_forgotten(more, lost_s, kept_s):
    tracked = tracker()
    key = "boat 3" if "fleet" in more.values() else ""
    tracked.hear(report(0.0, 0.0, **more), "nmea2000", 0.0, key)
    assert [one(tracked, at_s).is_lost for at_s in (lost_s, lost_s + 0.1, lost_s + kept_s)] == [False, True, True]
    assert seen(tracked, lost_s + kept_s + 0.1) == ()
    assert len(tracked) == 0


def test_a_target_on_the_own_position_is_a_target_like_any_other() -> None:
    tracked = tracker()
    tracked.hear(report(0.0, 0.0, speed_mps=0.0), "nmea2000", 0.0)
    assert (one(tracked, 0.0).north_m, one(tracked, 0.0).east_m) == pytest.approx((0.0, 0.0), abs=1e-6)


ANY = st.floats(allow_nan=True, allow_infinity=True) | st.none()
ANGLE = st.floats(-7.0, 7.0) | ANY
PLACES = st.tuples(st.floats(0.6, 0.7), st.floats(-0.2, -0.1)) | st.tuples(ANGLE, ANGLE)
NUMBERS = st.integers(244_660_000, 244_660_003) | st.integers(0, 999_999_999) | st.sampled_from([OWN, 970_000_001, 992_000_001])
WHEN = st.floats(0.0, 40.0)
REPORTS = st.builds(
    lambda mmsi, place, *more: VesselPosition(mmsi, *place, *more),
    NUMBERS,
    PLACES,
    ANGLE,
    st.floats(0.0, 40.0) | ANY,
    ANGLE,
    st.floats(-0.3, 0.3) | ANY,
    st.sampled_from(["A", "B", "fleet", "payload", "distress", "?"]),
    st.integers(0, 15),
    st.none() | st.integers(0, 59),
    st.booleans(),
)
SIZE = st.floats(-10.0, 600.0) | ANY
FACTS = st.builds(VesselFacts, NUMBERS, st.none() | st.text(max_size=20), st.none(), st.none(), SIZE, SIZE, SIZE, SIZE)
KEYS = st.sampled_from(["", "", "", "boat 2", "radar 7"])


@settings(max_examples=100, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(st.lists(st.tuples(REPORTS | FACTS, WHEN, KEYS), max_size=40), st.floats(0.0, 2000.0))
def test_no_report_makes_it_fail_and_nothing_comes_out_that_is_not_finite(reports, later_s):
    tracked, now_s = tracker(), 0.0
    for told, passed_s, key in reports:
        now_s += passed_s
        if isinstance(told, VesselPosition):
            tracked.hear(told, "nmea2000", now_s, key)
        else:
            tracked.facts(told, now_s, key)
    for at_s in (now_s, now_s + later_s):
        targets = seen(tracked, at_s)
        assert len({each.key for each in targets}) == len(targets) <= MOST
        for each in targets:
            assert all(
                math.isfinite(value)
                for name, value in each._asdict().items()
                if isinstance(value, float) and name != "heading_rad"
            )
            assert math.isnan(each.heading_rad) or 0.0 <= each.heading_rad < math.tau
            assert 0.0 <= each.course_rad < math.tau
            assert each.speed_mps >= 0.0 < each.length_m
            assert each.beam_m > 0.0 <= each.age_s
            assert 10.0 <= each.margin_m <= MARGIN_MAX_M


def calls(work: Callable[[], object]) -> int:
    """How many functions were called."""
    count = 0

    def profile(*_: object) -> None:
        nonlocal count
        count += 1

    sys.setprofile(profile)
    try:
        work()
    finally:
        sys.setprofile(None)
    return count


def test_a_report_costs_the_same_however_many_vessels_there_are() -> None:
    """But for one after each look, which puts the list of the farthest in order. Many contradict others of their number."""
    tracked, random = tracker(), Random(2)
    for second in range(80):
        assert calls(partial(seen, tracked, float(second))) <= 100 * MOST
        costs = []
        for i in range(50):
            told = report(random.uniform(-9e4, 9e4), random.uniform(-9e4, 9e4), mmsi=MARIA + random.randrange(3 * MOST))
            costs.append(calls(partial(tracked.hear, told, "nmea2000", float(second))))
            tracked.facts(facts(mmsi=MARIA + 50 * second + i), float(second))
        *others, dearest = sorted(costs)
        assert others[-1] <= 150
        assert dearest <= 150 + 3 * MOST
    assert len(tracked) == MOST
    assert len(tracked._facts) == FACTS_MOST


def test_what_is_refused_is_counted_by_a_few_words() -> None:
    tracked, random = tracker(), Random(3)
    for i in range(3000):
        tracked.hear(report(random.uniform(-9e5, 9e5), 0.0, mmsi=random.randrange(10**9), second=i % 60), "nmea2000", i / 9.0)
    tracked.hear(report(math.nan, 0.0), "nmea2000", 1.0)
    assert set(tracked.refused) <= {JUMP, TWICE, TWO, FULL, NOWHERE, "no vessel", "own transponder"}


@pytest.mark.parametrize(
    ("kind", "is_resting", "expected_s"),
    [("thing", True, 1.0), ("person", False, 1.0), ("A", True, 2.0), ("A", False, 12.0), ("B", False, 4.0)],
)
def test_what_is_silent_is_lost_after_the_time_of_its_kind(kind: str, is_resting: bool, expected_s: float) -> None:
    limits = msgspec.structs.replace(
        TrafficTable(), kept_thing_s=1.0, lost_rest_s=2.0, lost_a_s=3.0, lost_b_s=4.0, lost_near_s=5.0
    )
    track: Any = SimpleNamespace(kind=kind, is_resting=is_resting, haste=4.0)
    assert silence_s(limits, track) == expected_s
