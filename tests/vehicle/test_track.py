"""The driven track: spacing, loops, bounds."""

import itertools
import math

from hypothesis import given
from hypothesis import strategies as st

from delfim.config import HomeTable
from delfim.vehicle.plans.track import Track


def sail(track: Track, *corners: tuple[float, float], step_m: float = 0.3) -> None:
    for (n0, e0), (n1, e1) in itertools.pairwise(corners):
        steps = math.ceil(math.dist((n0, e0), (n1, e1)) / step_m)
        for i in range(steps + 1):
            track.add(n0 + (n1 - n0) * i / steps, e0 + (e1 - e0) * i / steps)


def test_points_are_spaced() -> None:
    track = Track(HomeTable())
    sail(track, (0.0, 0.0), (100.0, 0.0), (100.0, 50.0))
    points = track.points()
    assert points[0] == (0.0, 0.0)
    assert all(5.0 <= math.dist(a, b) < 5.4 for a, b in itertools.pairwise(points))
    assert math.dist(points[-1], (100.0, 50.0)) < 5.4


def test_a_loop_is_cut() -> None:
    track = Track(HomeTable())
    sail(track, (0.0, 0.0), (50.0, 0.0), (50.0, 50.0), (30.0, 50.0), (30.0, 0.0), (30.0, -40.0))
    points = track.points()
    assert max(north for north, _ in points) < 36.0
    assert len(points) < 18


def test_the_way_back_takes_the_track_back() -> None:
    track = Track(HomeTable())
    sail(track, (0.0, 0.0), (200.0, 0.0), (0.0, 0.0))
    assert len(track.points()) <= 2


def test_the_other_side_of_a_narrow_pier_is_not_a_short_cut() -> None:
    track = Track(HomeTable())
    sail(track, (0.0, 0.0), (60.0, 0.0), (60.0, 4.0), (10.0, 4.0))
    assert max(north for north, _ in track.points()) > 55.0


def test_a_full_track_doubles_its_spacing_and_keeps_both_ends() -> None:
    track = Track(HomeTable(points=10))
    sail(track, (0.0, 0.0), (1000.0, 0.0))
    points = track.points()
    assert len(points) <= 10
    assert points[0] == (0.0, 0.0)
    assert 1000.0 - points[-1][0] < 1000.0 / 4.0
    gaps = [math.dist(a, b) for a, b in itertools.pairwise(points)]
    assert max(gaps) < 2.1 * min(gaps)


@given(st.lists(st.tuples(st.floats(-60.0, 60.0), st.floats(-60.0, 60.0)), max_size=300), st.integers(2, 40))
def test_whatever_is_driven_the_track_is_bounded_and_was_driven(places: list[tuple[float, float]], most: int) -> None:
    track = Track(HomeTable(points=most))
    for place in places:
        track.add(*place)
    points = track.points()
    assert len(points) <= most
    assert set(points) <= set(places)
    assert not places or points[0] == places[0]


def test_the_way_home_ends_at_the_last_harbour_that_was_passed_whenever_that_was_said() -> None:
    track = Track(HomeTable())
    sail(track, (0.0, 0.0), (1000.0, 0.0))
    track.call_at(((100.0, 3.0), (300.0, -3.0), (600.0, 30.0)), 5.0)
    assert track.way_home() == track.points(), "not looked at yet"
    for _ in range(len(track.points())):
        track.look_back()
    assert track.end() == track.way_home()[0]
    assert math.dist(track.way_home()[0], (300.0, -3.0)) <= 5.0
    track.call_at(((1100.0, 0.0),), 5.0)
    sail(track, (1000.0, 0.0), (1200.0, 0.0))
    assert math.dist(track.way_home()[0], (1100.0, 0.0)) <= 5.0, "passed later"
    sail(track, (1200.0, 0.0), (1050.0, 0.0))
    assert track.way_home() == track.points(), "and forgotten with the loop that led there"


def test_squares_of_forgotten_points_are_cleared_little_by_little() -> None:
    track = Track(HomeTable())
    for loop in range(20):
        sail(track, (0.0, 0.0), (0.0, 500.0), (50.0 + loop, 500.0), (50.0 + loop, 0.0), (0.0, 0.0), step_m=2.0)
    assert len(track._cells) < 300, "one loop of 220 points and what is left of the one before"
    assert len(track.points()) < 10


@given(st.lists(st.tuples(st.floats(-60.0, 60.0), st.floats(-60.0, 60.0)), max_size=200), st.integers(0, 199))
def test_harbours_are_found_wherever_the_track_was_cut_or_thinned(places: list[tuple[float, float]], called: int) -> None:
    track, harbours = Track(HomeTable(points=12)), ((0.0, 0.0), (30.0, 30.0))
    for at, place in enumerate(places):
        if at == called:
            track.call_at(harbours, 10.0)
        track.add(*place)
    if len(places) <= called:
        track.call_at(harbours, 10.0)
    for _ in range(12):
        track.look_back()
    way = track.way_home()
    assert way == track.points()[len(track.points()) - len(way) :]
    assert not any(math.dist(point, harbour) <= 10.0 for point in way[1:] for harbour in harbours)
