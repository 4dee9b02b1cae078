"""One vessel: what its reports make of it, and where it is reckoned to be, number by number (docs/traffic.md)."""

import math
from dataclasses import asdict, replace
from typing import Any, Final

import pytest

from delfim.base import geodesy
from delfim.base.vessels import VesselFacts, VesselPosition
from delfim.parts.traffic.reckoning import VesselTrack, begun
from delfim.vehicle.target import NEVER_S, Target

AT: Final = math.radians(50.0), math.radians(-9.0)
ORIGIN: Final = geodesy.origin(*AT)
RADIUS_M: Final = 6_378_137.0
KNOT: Final = 1852.0 / 3600.0
LIKE: Final = VesselPosition(244_660_123, *AT, 0.0, 5.0, None, None, "A", 0)  # to the north at 5 m/s
EAST: Final = math.pi / 2.0


def told(
    north_m: float = 0.0, east_m: float = 0.0, at_s: float = 0.0, at: tuple[float, float] = AT, **more: Any
) -> VesselTrack:
    """A report so far from a place."""
    latitude_rad = at[0] + north_m / RADIUS_M
    longitude_rad = geodesy.wrap(at[1] + east_m / (RADIUS_M * math.cos((at[0] + latitude_rad) / 2.0)))
    track = begun(LIKE._replace(latitude_rad=latitude_rad, longitude_rad=longitude_rad)._replace(**more), "ais", at_s)
    assert track is not None
    return track


def north_of_the_equator(far_m: float) -> float:
    """The latitude that is exactly so far from it."""
    guess = far_m / RADIUS_M
    return next(it for it in (guess, math.nextafter(guess, 0.0), math.nextafter(guess, 1.0)) if RADIUS_M * it == far_m)


def test_a_first_report_is_kept_as_it_was_told() -> None:
    position = LIKE._replace(course_rad=-1.0, heading_rad=7.0, rate_radps=-0.02, kind="B", status=3, second=59)
    track = begun(position, "udp", 12.5)
    assert track is not None
    assert asdict(track) == {
        "kind": "B", "by": "udp", "at_s": 12.5, "latitude_rad": AT[0], "longitude_rad": AT[1], "second": 59, "status": 3,
        "course_rad": math.tau - 1.0, "speed_mps": 5.0, "heading_rad": pytest.approx(7.0 - math.tau), "rate_radps": -0.02,
        "base": (*AT, 12.5), "reports": 1, "rival": None, "name": "", "size": None, "ahead_m": 0.0, "starboard_m": 0.0,
        "doubt_m": 0.0, "doubt_s": NEVER_S,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("more", "is_one"),
    [
        ({"latitude_rad": None}, False),
        ({"longitude_rad": None}, False),
        ({"latitude_rad": 0.0, "longitude_rad": 0.0}, False),
        ({"latitude_rad": 0.0}, True),
        ({"longitude_rad": 0.0}, True),
        ({"latitude_rad": 0.1, "longitude_rad": 0.1}, True),
        ({"kind": "?"}, False),
        *(({"latitude_rad": side * math.radians(deg)}, deg < 89.5) for side in (1, -1) for deg in (89.0, 90.0, math.nan)),
        *(({"longitude_rad": side * (math.pi + more)}, more < 1.1e-6) for side in (1, -1) for more in (0.0, 1e-6, 1.5e-6)),
        ({"longitude_rad": math.nan}, False),
        *(({"speed_mps": speed_mps}, True) for speed_mps in (None, 0.0, 60.0 * KNOT)),
        *(({"speed_mps": speed_mps}, False) for speed_mps in (-0.1, 60.1 * KNOT, math.inf, math.nan)),
    ],
)
def test_where_a_vessel_can_be_and_how_fast(more: dict[str, Any], is_one: bool) -> None:
    assert (begun(LIKE._replace(**more), "ais", 0.0) is not None) == is_one


@pytest.mark.parametrize(
    ("rate_deg", "is_one"),
    [(0.1, True), (0.09, False), (0.0, False), (3.0, True), (12.0, True), (12.1, False), (math.nan, False)],
)
def test_a_slower_turn_is_none_and_a_faster_one_a_sensor_gone_wrong(rate_deg: float, is_one: bool) -> None:
    for rate_radps in (math.radians(rate_deg), -math.radians(rate_deg)):
        assert told(rate_radps=rate_radps).rate_radps == (rate_radps if is_one else 0.0)


@pytest.mark.parametrize("angle_rad", [None, math.nan, math.inf])
def test_an_angle_that_is_none_is_not_known(angle_rad: float | None) -> None:
    track = told(course_rad=angle_rad, heading_rad=angle_rad)
    assert (track.course_rad, track.heading_rad) == (None, None)


@pytest.mark.parametrize(
    ("north_m", "east_m", "after_s", "can"),
    [
        (149.9, 0.0, 0.0, True),
        (150.1, 0.0, 0.0, False),
        (0.0, -149.9, -50.0, True),
        (0.0, -150.1, -50.0, False),
        (0.0, 150.0 + 600.0 * KNOT - 0.1, 10.0, True),
        (0.0, 150.0 + 600.0 * KNOT + 0.1, 10.0, False),
        (-300.0, 300.0, 10.0, True),
        (-330.0, 330.0, 10.0, False),
    ],
)
def test_no_vessel_is_faster_than_60_kn(north_m: float, east_m: float, after_s: float, can: bool) -> None:
    assert told(at_s=100.0).can_be_at(told(north_m, east_m, 100.0 + after_s)) == can
    date_line = AT[0], math.pi
    assert told(at=date_line).can_be_at(told(north_m, east_m, after_s, (AT[0], -math.pi))) == can
    assert told(at=(0.0, 0.1)).can_be_at(told(at=(north_of_the_equator(150.0), 0.1)))


@pytest.mark.parametrize(
    ("was", "new", "late_s", "off", "unlike", "far_m"),
    [
        ({}, told(60.0, 40.0, 10.0), 0.0, 41.23106 / 140.0, 41.23106 / 40.0, 41.23106),  # beside and ahead
        ({"course_rad": EAST}, told(20.0, 35.0, 10.0, course_rad=EAST), 0.0, 25.0 / 140.0, 25.0 / 40.0, 25.0),
        ({}, told(-5.0, 10.0, -3.0), 0.0, 11.18034 / 40.0, 11.18034 / 40.0, 11.18034),  # no time passed
        ({}, told(-20.0, 8.0, 9.0), 6.0, 12.80625 / 40.0, 12.80625 / 40.0, 12.80625),  # compared with where it was
        ({}, told(10.0, 0.0, 2.0, speed_mps=1.0), 0.0, 4.0 / 7.0, 4.0 / 3.0, 0.0),  # slower
        ({}, told(10.0, 3.0, 2.0, course_rad=EAST), 0.0, 7.0710678 / 7.0, 3.0 / 40.0 + 7.0710678 / 3.0, 3.0),  # turned
        ({"status": 1, "speed_mps": None}, told(30.0, 40.0, 4.0, speed_mps=0.0), 0.0, 50.0 / 46.0, 50.0 / 30.0, 50.0),
        ({}, told(50.0, 9.0, 10.0, speed_mps=None), 0.0, 9.0 / 140.0, 9.0 / 40.0, 9.0),  # nothing to compare
        ({"course_rad": 1.0}, told(0.0, 0.0, course_rad=1.0), 0.0, 0.0, 0.0, 0.0),
        ({"course_rad": None}, told(30.0, 40.0, 4.0), 0.0, 50.0 / (30.0 + 240.0 * KNOT), 50.0 / 30.0, 50.0),
        ({"speed_mps": None}, told(30.0, -40.0, 4.0), 3.0, 50.0 / (30.0 + 180.0 * KNOT), 50.0 / 30.0, 50.0),
    ],
)
def test_how_far_a_report_strays(was, new, late_s, off, unlike, far_m):
    found = told(**was).strays(new, late_s) if late_s else told(**was).strays(new)
    assert found == pytest.approx((off, unlike, far_m), rel=1e-5, abs=1e-6)


def test_a_doubt_is_minded_for_a_minute_and_the_largest_of_them() -> None:
    track = told(speed_mps=0.0, at_s=500.0)
    for far_m, now_s, at_s, doubt_m in (
        (100.0, 505.0, 505.0, 100.0),
        (40.0, 564.0, 623.0, 100.0),
        (40.0, 564.0, 624.0, 0.0),
        (0.5, 624.0, 624.0, 0.5),  # the former one is over
        (0.2, 683.9, 700.0, 0.5),
    ):
        track.doubt(far_m, now_s)
        age_s = at_s - 500.0
        assert track.target("maria", age_s, False, ORIGIN).margin_m == pytest.approx(10.0 + 0.15 * age_s + doubt_m)


@pytest.mark.parametrize(
    ("at", "to", "is_same"),
    [
        *(((0.0, 0.1), (side * 5e-8, 0.1), True) for side in (1, -1)),
        *(((0.1, 0.0), (0.1, side * 5e-8), True) for side in (1, -1)),
        *(((0.1, 0.1), (0.1 + side * 6e-8, 0.1), False) for side in (1, -1)),
        *(((0.1, 0.1), (0.1, 0.1 + side * 6e-8), False) for side in (1, -1)),
        ((0.1, math.pi - 2e-8), (0.1, 2e-8 - math.pi), True),
    ],
)
def test_the_same_place_but_for_rounding(at: tuple[float, float], to: tuple[float, float], is_same: bool) -> None:
    assert told(at=at).is_at(replace(told(), latitude_rad=to[0], longitude_rad=to[1])) == is_same


@pytest.mark.parametrize(
    ("speed_mps", "after_s", "is_stuck"),
    [(5.0, 2.0, False), (5.0, 2.5, True), (1.0, 10.5, True), (1.0, 10.0, False), (0.9, 60.0, False), (None, 60.0, False)],
)
def test_an_old_place_of_a_vessel_that_says_that_it_moves(speed_mps: float | None, after_s: float, is_stuck: bool) -> None:
    new = told(at_s=300.0 + after_s, speed_mps=speed_mps)
    assert told(at_s=300.0).is_stuck(new) == is_stuck
    assert not told(5.0, 0.0, 300.0).is_stuck(new)


@pytest.mark.parametrize(
    ("after_s", "course_rad", "speed_mps", "course", "speed", "is_based"),
    [
        (5.0, 1.0, 3.0, 1.0, 3.0, False),
        (10.0, 1.0, 3.0, 1.0, 3.0, True),
        (5.0, None, 0.2, None, 0.2, False),  # it lies
        (5.0, None, 0.25, 0.0, 0.25, False),  # the course of the last report
        (5.0, 1.0, None, 0.0, 5.0, False),
        (9.9, None, None, 0.0, 5.0, False),
        (10.0, None, None, "made", 25.0, True),
        (10.0, 1.0, None, "made", 25.0, True),
        (12.5, None, 4.0, "made", 20.0, True),
        (1.0 + 8.0, None, 4.0, 0.0, 4.0, False),
    ],
)
def test_the_next_report(after_s, course_rad, speed_mps, course, speed, is_based):
    """Two positions make a velocity that is not told: here 150 m to the south and 200 m to the west."""
    track, more = told(at_s=100.0), {"course_rad": course_rad, "speed_mps": speed_mps}
    new = told(-150.0, -200.0, 100.0 + after_s, status=5, second=7, heading_rad=2.0, rate_radps=0.1, **more)
    new.by = "udp"
    track.take(new)
    assert (track.by, track.at_s, track.second, track.status, track.reports) == ("udp", 100.0 + after_s, 7, 5, 2)
    assert (track.latitude_rad, track.longitude_rad) == (new.latitude_rad, new.longitude_rad)
    assert (track.heading_rad, track.rate_radps, track.kind) == (2.0, 0.1, "A")
    made = math.pi + math.atan2(4.0, 3.0) if course == "made" else course
    assert track.course_rad == (made if made is None else pytest.approx(made, abs=1e-4))
    assert track.speed_mps == pytest.approx(speed, rel=1e-4)
    assert track.base == (new.base if is_based else (*AT, 100.0))


def test_no_two_positions_make_more_than_60_kn_and_the_date_line_is_none() -> None:
    track = told(at=(AT[0], math.pi))
    track.take(told(0.0, 100.0, 20.0, (AT[0], -math.pi), speed_mps=None))
    assert (track.course_rad, track.speed_mps) == pytest.approx((EAST, 5.0))
    track.take(told(0.0, 600.0, 31.0, (AT[0], -math.pi), speed_mps=None))
    assert track.speed_mps == pytest.approx(60.0 * KNOT)


def facts(**more: Any) -> VesselFacts:
    return VesselFacts(244_660_123, None, None, None, None, None, None, None)._replace(**more)


@pytest.mark.parametrize(
    ("length_m", "beam_m", "is_one"),
    [
        *((1.0, 0.3, True), (0.9, 0.3, False), (1.0, 0.2, False), (500.0, 100.0, True), (501.0, 100.0, False)),
        *((500.0, 101.0, False), (None, 5.0, False), (10.0, None, False), (math.nan, 5.0, False)),
    ],
)
def test_a_size_that_no_vessel_has_is_not_known(length_m: float | None, beam_m: float | None, is_one: bool) -> None:
    track = told()
    track.measure(facts(length_m=length_m, beam_m=beam_m))
    assert track.size == ((length_m, beam_m) if is_one else None)
    target = track.target("maria", 0.0, False, ORIGIN)
    assert (target.length_m, target.beam_m, target.is_size_known) == (*((length_m, beam_m) if is_one else (50.0, 10.0)), is_one)


@pytest.mark.parametrize(
    ("bow_m", "side_m", "where"),
    [
        *((30.0, 2.0, (10.0, -3.0)), (0.5, 0.0, (-19.5, -5.0)), (40.0, 10.0, (20.0, 5.0)), (0.0, 5.0, None), (41.0, 5.0, None)),
        *((30.0, -1.0, None), (30.0, 11.0, None), (None, 2.0, None), (30.0, None, None), (math.nan, 2.0, None)),
    ],
)
def test_where_the_antenna_stands(bow_m: float | None, side_m: float | None, where: tuple[float, float] | None) -> None:
    track = told()
    track.measure(facts(length_m=40.0, beam_m=10.0, from_bow_m=30.0, from_starboard_m=2.0, name="MARIA"))
    track.measure(facts(length_m=40.0, beam_m=10.0, from_bow_m=bow_m, from_starboard_m=side_m))
    assert ((track.ahead_m, track.starboard_m), track.name) == (where or (0.0, 0.0), "MARIA")


def test_who_reports_in_long_intervals() -> None:
    resting = [status for status in range(16) if told(status=status, speed_mps=1.0).is_resting]
    assert resting == [1, 5, 6]
    for kind, status, speed_mps, rests in (
        *(("A", 1, 2.9 * KNOT, True), ("A", 1, 3.0 * KNOT, False), ("A", 1, None, True), ("A", 0, 0.0, False)),
        *(("B", 15, 1.9 * KNOT, True), ("B", 15, 2.0 * KNOT, False), ("B", 15, None, False), ("B", 1, 2.5 * KNOT, False)),
    ):
        assert told(kind=kind, status=status, speed_mps=speed_mps).is_resting == rests


def test_class_a_in_haste_reports_more_often() -> None:
    hastes = [told(speed_mps=speed_mps).haste for speed_mps in (None, 13.9 * KNOT, 14.0 * KNOT, 22.9 * KNOT, 23.0 * KNOT)]
    assert hastes == [1.0, 1.0, 0.6, 0.6, 0.5]


def ended(course_rad: float, speed_mps: float, rate_radps: float, passed_s: float) -> tuple[float, float, float]:
    """A way, step by step: north, east, course."""
    north_m = east_m = 0.0
    steps = 1000
    for i in range(steps):
        now_rad = course_rad + rate_radps * min((i + 0.5) * passed_s / steps, 30.0)
        north_m += speed_mps * math.cos(now_rad) * passed_s / steps
        east_m += speed_mps * math.sin(now_rad) * passed_s / steps
    return north_m, east_m, (course_rad + rate_radps * min(passed_s, 30.0)) % math.tau


@pytest.mark.parametrize("rate_radps", [0.0, 0.02, -0.03])
@pytest.mark.parametrize("age_s", [0.0, 12.0, 50.0])
def test_an_arc_for_half_a_minute_then_straight_on(rate_radps: float, age_s: float) -> None:
    track = told(at_s=1000.0, course_rad=0.7, heading_rad=0.3, speed_mps=4.0, rate_radps=rate_radps)
    found = track.target("maria", age_s, False, ORIGIN)
    north_m, east_m, course_rad = ended(0.7, 4.0, rate_radps, age_s)
    assert (found.north_m, found.east_m) == pytest.approx((north_m, east_m), abs=0.02)
    assert (found.course_rad, found.heading_rad) == pytest.approx((course_rad, (course_rad - 0.4) % math.tau))


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ({}, {}),
        ({"name": "MARIA"}, {"name": "MARIA"}),
        ({"heading_rad": 1.0}, {"heading_rad": 1.0}),
        ({"course_rad": None, "heading_rad": 0.0}, {"heading_rad": 0.0}),
        ({"course_rad": None}, {"north_m": 0.0, "speed_mps": 0.0, "margin_m": 10.0 + 5.15 * 20.0}),
        ({"course_rad": None, "speed_mps": 2.0}, {"north_m": 0.0, "speed_mps": 0.0, "margin_m": 10.0 + 2.65 * 20.0}),
        ({"speed_mps": None}, {"north_m": 0.0, "speed_mps": 0.0, "margin_m": 10.0 + 2.65 * 20.0}),
        ({"speed_mps": 0.25}, {"north_m": 5.0, "speed_mps": 0.25}),
        ({"speed_mps": 0.2}, {"north_m": 0.0, "speed_mps": 0.0}),
        ({"speed_mps": None, "status": 6}, {"north_m": 0.0, "speed_mps": 0.0, "status": 6}),
        ({"speed_mps": 1.5, "status": 5}, {"north_m": 0.0, "speed_mps": 0.0, "status": 5}),
        ({"speed_mps": 3.0 * KNOT, "status": 5}, {"north_m": 60.0 * KNOT, "speed_mps": 3.0 * KNOT, "status": 5}),
        (
            {"kind": "B", "course_rad": EAST},
            {"north_m": 0.0, "east_m": 100.0, "course_rad": EAST, "length_m": 15.0, "beam_m": 5.0},
        ),
        ({"kind": "fleet"}, {"length_m": 5.0, "beam_m": 2.5}),
        ({"kind": "payload"}, {"length_m": 15.0, "beam_m": 5.0}),
        ({"kind": "distress", "status": 14}, {"length_m": 15.0, "beam_m": 5.0, "status": 14}),
        ({"age_s": 5000.0}, {"north_m": 25_000.0, "margin_m": 500.0, "age_s": 5000.0, "is_lost": True}),
    ],
)
def test_a_vessel_is_told_whole(more: dict[str, Any], expected: dict[str, Any]) -> None:
    """Twenty seconds after its report, unless told otherwise."""
    age_s, name = more.get("age_s", 20.0), more.get("name", "")
    track = told(**{key: value for key, value in more.items() if key not in ("age_s", "name")})
    track.name = name
    found = track.target("maria", age_s, age_s > 60.0, ORIGIN)
    whole = Target("maria", "maria", 100.0, 0.0, 0.0, 5.0, math.nan, 50.0, 10.0, False, 13.0, age_s, False, "A", 0)
    whole = whole._replace(kind=more.get("kind", "A"))._replace(**expected)
    assert found._asdict() == pytest.approx(whole._asdict(), nan_ok=True, abs=1e-6)


@pytest.mark.parametrize(
    ("more", "north_m", "east_m", "margin_m"),
    [
        ({"heading_rad": 0.0}, 30.0, 8.0, 10.0),
        ({"heading_rad": EAST, "speed_mps": 0.0}, -8.0, 30.0, 10.0),
        ({"heading_rad": 3.0 * math.pi / 4.0}, -19.0 * math.sqrt(2.0), 11.0 * math.sqrt(2.0), 10.0),
        ({"course_rad": EAST, "speed_mps": 1.0}, -8.0, 30.0, 10.0),
        ({"course_rad": EAST, "speed_mps": 0.9}, 0.0, 0.0, 10.0 + math.hypot(30.0, 8.0)),
        ({"course_rad": EAST, "speed_mps": 1.2, "status": 1}, 0.0, 0.0, 10.0 + math.hypot(30.0, 8.0)),
    ],
)
def test_the_middle_of_the_hull(more: dict[str, Any], north_m: float, east_m: float, margin_m: float) -> None:
    track = told(**more)
    track.measure(facts(length_m=100.0, beam_m=20.0, from_bow_m=80.0, from_starboard_m=18.0))
    found = track.target("maria", 0.0, False, ORIGIN)
    assert (found.north_m, found.east_m, found.margin_m) == pytest.approx((north_m, east_m, margin_m), abs=1e-6)


@pytest.mark.parametrize("kind", ["thing", "person"])
def test_what_another_boat_tells_of_a_thing_is_small_and_known_to_two_metres(kind: str) -> None:
    found = told(kind=kind, speed_mps=0.0).target("buoy", 60.0, False, ORIGIN)
    assert (found.length_m, found.beam_m, found.margin_m, found.is_size_known) == (1.0, 1.0, 2.0, False)
