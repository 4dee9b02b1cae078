"""The geometry of zones where it turns: on the edge, at a corner, at the last metre; and what each answer costs."""

import math

import pytest

from delfim.base.cooperative import Sliced
from delfim.vehicle.plans.zones import (
    LOOKS,
    OVERLAP,
    Box,
    Facet,
    Point,
    Zone,
    apart,
    circle,
    clearance_m,
    cost,
    from_segment,
    least,
    may,
    polygon,
    searched,
    together,
)

SQUARE = [(-50.0, -50.0), (50.0, -50.0), (50.0, 50.0), (-50.0, 50.0)]
DIAMOND = [(10.0, 0.0), (0.0, 10.0), (-10.0, 0.0), (0.0, -10.0)]
TEETH = [(0.0, 0.0), *((10.0 if n % 2 else 5.0, float(n)) for n in range(9)), (0.0, 8.0)]  # 11 corners: two parts
IN, OUT = True, False


def spent(zone: Zone, a: Point, b: Point, within_m: float) -> tuple[float, list[int]]:
    """What `searched` finds, and what each of its slices says that it cost."""
    costs: list[int] = []

    def counted():
        work = searched(zone, a, b, within_m)
        try:
            while True:
                costs.append(next(work))
                yield costs[-1]
        except StopIteration as end:
            return end.value

    return Sliced(counted()).finish(), costs


def test_a_polygon_is_kept_in_parts_with_a_box_around_each() -> None:
    zone = polygon("teeth", OUT, TEETH)
    assert zone == Zone("teeth", OUT, zone.sides, (0.0, 0.0, 10.0, 8.0), 0.0, 0.0, 0.0, zone.parts, ())
    assert [(side[:2], side[4:]) for side in zone.sides] == list(zip(TEETH, [*TEETH[1:], TEETH[0]], strict=True))
    assert zone.sides[1] == (5.0, 0.0, 5.0, 1.0, 10.0, 1.0)
    first, second = Facet((0.0, 0.0, 10.0, 7.0), zone.sides[:8]), Facet((0.0, 0.0, 10.0, 8.0), zone.sides[8:])
    assert zone.parts == (first, second)


def test_a_circle_and_areas_together_have_a_box() -> None:
    disc = circle("disc", IN, (3.0, -4.0), 10.0)
    assert disc == Zone("disc", IN, (), (-7.0, -14.0, 13.0, 6.0), 3.0, -4.0, 10.0, (), ())
    assert together("both", [disc]) is disc
    square = polygon("square", IN, SQUARE)
    assert together("both", [disc, square]) == Zone(
        "both", IN, (), (-50.0, -50.0, 50.0, 50.0), 0.0, 0.0, 0.0, (), (disc, square)
    )
    far = circle("far", IN, (100.0, 200.0), 10.0)
    assert together("far", [far, disc]).box == (-7.0, -14.0, 110.0, 210.0)


@pytest.mark.parametrize(
    ("corners", "at", "is_inside"),
    [
        (SQUARE, (-50.0, 0.0), True),  # the edge in the south and that in the west belong to it,
        (SQUARE, (0.0, -50.0), True),
        (SQUARE, (50.0, 0.0), False),  # the others do not
        (SQUARE, (0.0, 50.0), False),
        (DIAMOND, (0.0, 0.0), True),  # due west of a corner
        (DIAMOND, (0.0, -11.0), False),
        (DIAMOND, (6.0, 5.0), False),  # in its box
        (TEETH, (7.0, 3.5), True),
        (TEETH, (8.0, 6.0), False),  # between two teeth
        (TEETH, (5.0, -1.0), False),
    ],
)
def test_a_point_is_in_a_polygon_or_not(corners: list[Point], at: Point, is_inside: bool) -> None:
    assert may(polygon("", IN, corners), *at) is is_inside
    assert may(polygon("", OUT, corners), *at) is not is_inside


def test_the_edge_of_a_circle_belongs_to_the_water_outside() -> None:
    for keep_in in (IN, OUT):
        zone = circle("", keep_in, (10.0, -20.0), 5.0)
        assert may(zone, 13.0, -16.0) is not keep_in
        assert may(zone, 12.9, -16.0) is keep_in
        assert clearance_m(zone, 10.0, -17.0) == (2.0 if keep_in else -2.0)
        assert clearance_m(zone, 16.0, -28.0) == (-5.0 if keep_in else 5.0)


def test_of_many_areas_at_a_point_some_are_compared() -> None:
    """And where there is none, the one whose box is nearest."""
    rising = together("", [circle("", IN, (0.0, 0.0), 10.0 + n) for n in range(OVERLAP + 1)])
    assert clearance_m(rising, 0.0, 0.0) == 9.0 + OVERLAP == 13.0
    two = together("", [polygon("", IN, SQUARE), polygon("", IN, [(n + 200.0, e + 200.0) for n, e in SQUARE])])
    assert clearance_m(two, -53.0, -54.0) == -5.0
    assert clearance_m(two, 253.0, 254.0) == -5.0
    assert clearance_m(two, 200.0, 120.0) == -30.0
    assert clearance_m(two, 120.0, 200.0) == -30.0


def test_a_clearance_costs_a_quarter_of_the_sides_that_are_near() -> None:
    teeth = polygon("", IN, TEETH)
    assert cost(teeth, (999.0, 0.0)) == 2
    both = together("", [teeth, polygon("", IN, [(n + 100.0, e) for n, e in SQUARE])])
    assert [cost(both, at) for at in ((5.0, 5.0), (50.0, 0.0), (150.0, 0.0), (300.0, 0.0))] == [2, 1, 1, 0]


@pytest.mark.parametrize("turn", range(4))
@pytest.mark.parametrize("mirror", [1.0, -1.0])
@pytest.mark.parametrize("reverse", [False, True])
def test_a_side_that_begins_near_a_way_and_ends_far_away_counts(turn: int, mirror: float, reverse: bool) -> None:
    """In each direction, and from either end."""

    def turned(at: Point) -> Point:
        north, east = at[0], mirror * at[1]
        for _ in range(turn):
            north, east = -east, north
        return north, east

    # The way runs along the middle of the long side, and its neighbours are farther away.
    corners = [turned(each) for each in [(0.0, 0.0), (300.0, 400.0), (300.0, -400.0), (-900.0, -900.0), (0.0, -20.0)]]
    zone = polygon("", OUT, corners[::-1] if reverse else corners)
    a, b = turned((30.0 - 4.0, 40.0 + 3.0)), turned((33.0 - 4.0, 44.0 + 3.0))
    assert least(zone, a, b, 6.0)[0] == pytest.approx(5.0)
    assert least(zone, b, a, 6.0)[0] == pytest.approx(5.0)
    assert least(zone, a, b, 4.9)[0] == math.inf


@pytest.mark.parametrize(
    ("zone", "a", "b", "within_m", "found"),
    [
        (circle("", IN, (10.0, 0.0), 50.0), (40.0, 0.0), (10.0, 40.0), math.inf, (10.0, 1)),
        (circle("", IN, (10.0, 0.0), 50.0), (10.0, 40.0), (40.0, 0.0), 1.0, (10.0, 1)),
        (circle("", OUT, (10.0, -20.0), 5.0), (0.0, 0.0), (20.0, 0.0), math.inf, (15.0, 1)),
        (circle("", OUT, (10.0, -20.0), 5.0), (0.0, 0.0), (20.0, 0.0), 14.0, (math.inf, 0)),
        (polygon("", IN, SQUARE), (0.0, 0.0), (10.0, 0.0), math.inf, (40.0, 9)),
        (polygon("", IN, SQUARE), (0.0, 10.0), (0.0, 0.0), 40.5, (40.0, 9)),
        (polygon("", IN, SQUARE), (0.0, 0.0), (10.0, 0.0), 40.0, (math.inf, 9)),
        (polygon("", IN, SQUARE), (0.0, 0.0), (60.0, 0.0), 1.0, (-10.0, 3)),
        (polygon("", IN, SQUARE), (-70.0, 0.0), (0.0, 0.0), 1.0, (-20.0, 3)),
        (polygon("", OUT, SQUARE), (0.0, 0.0), (60.0, 0.0), 1.0, (-50.0, 3)),
        (polygon("", OUT, SQUARE), (60.0, -10.0), (-60.0, 10.0), 1.0, (0.0, 9)),  # from edge to edge
        (polygon("", OUT, SQUARE), (53.0, 54.0), (53.0, 54.0), 9.0, (5.0, 9)),  # on the spot
        (polygon("", OUT, TEETH), (9.5, -1.0), (9.5, 1.5), 1.0, (0.0, 18)),  # the first of two parts is enough
        (polygon("", OUT, TEETH), (7.0, 9.0), (5.0, 9.0), 1.5, (1.0, 8)),
        (polygon("", OUT, TEETH), (99.0, 9.0), (98.0, 9.0), 1.5, (math.inf, 0)),
        (polygon("", IN, TEETH), (1.0, 4.0), (2.0, 4.0), 1.5, (1.0, 24)),
        (polygon("", IN, TEETH), (3.0, 4.0), (2.0, 4.0), 1.0, (math.inf, 24)),
    ],
)
def test_the_least_clearance_of_a_way_and_what_it_costs(zone, a, b, within_m, found):
    assert least(zone, a, b, within_m) == found
    assert spent(zone, a, b, within_m) == (found[0], [found[1]])


BOX: Box = (0.0, 0.0, 10.0, 20.0)


@pytest.mark.parametrize(
    ("a", "b", "away"),
    [
        ((0.0, -40.0), (9.0, -40.0), (0.0, 35.0)),  # it ends 5 m west of it
        ((3.0, 60.0), (3.0, 70.0), (0.0, -35.0)),
        ((-40.0, 3.0), (-30.0, 4.0), (25.0, 0.0)),
        ((50.0, 3.0), (60.0, 4.0), (-35.0, 0.0)),
        ((47.0, -21.0), (-13.0, 59.0), (0.0, 0.0)),  # it passes a corner
        ((23.0, -39.0), (-37.0, 41.0), (0.0, 0.0)),
        ((-37.0, -21.0), (23.0, 59.0), (0.0, 0.0)),
        ((-13.0, -39.0), (47.0, 41.0), (0.0, 0.0)),
    ],
)
def test_a_way_is_apart_from_a_box_that_is_farther_away_than_that(a: Point, b: Point, away: Point) -> None:
    """Of each of these ways the box is 5 m away."""
    a, b = (a[0] + away[0], a[1] + away[1]), (b[0] + away[0], b[1] + away[1])
    for first, second in ((a, b), (b, a)):
        assert not apart(BOX, first, second, 5.0)
        assert apart(BOX, first, second, 4.99)
        assert not apart(BOX, first, second, math.inf)


@pytest.mark.parametrize(
    ("by", "p", "away_m"),
    [
        ((6.0, 8.0), (8.0, 3.0), 5.0),  # beside its middle
        ((6.0, 8.0), (-2.0, -2.0), 5.0),
        ((6.0, 8.0), (10.0, 14.0), 5.0),
        ((0.0, 0.0), (4.0, 6.0), 5.0),
        ((0.0, 8.0), (4.0, 5.0), 3.0),
        ((0.5, 0.0), (1.25, 5.0), 3.0),
    ],
)
def test_the_distance_from_a_segment(by: Point, p: Point, away_m: float) -> None:
    assert from_segment((1.0, 2.0), by, p) == away_m


ROOMS = [circle("", IN, (0.0, 0.0), 50.0), circle("", IN, (0.0, 80.0), 50.0)]
HALLS = [polygon("", IN, [(-50.0, e), (50.0, e), (50.0, e + 100.0), (-50.0, e + 100.0)]) for e in (-50.0, 30.0)]
ASIDE = circle("", IN, (-60.5, 0.0), 60.0)  # half a metre beside the way


@pytest.mark.parametrize(
    ("areas", "within_m", "least_m", "costs"),
    [
        (ROOMS, 20.0, 10.0, [1, 0, 1, 0, 1, 1, 1]),
        (ROOMS, 10.0, math.inf, [1, 0, 1, 0]),
        ([ASIDE, *ROOMS], 10.0, math.inf, [1, 1, 0, 1, 0]),
        ([*ROOMS, ASIDE], 10.0, math.inf, [1, 0, 1, 0]),
        (HALLS, 20.0, 10.0, [1, 9, 1, 9, 3, 3, 3]),
        (HALLS, 10.0, math.inf, [1, 9, 1, 9]),
        (HALLS[1:], 1.0, -30.0, [1, 9, 1, 1, 2]),
    ],
)
def test_a_way_through_areas_is_looked_at_where_none_covers_it(areas, within_m, least_m, costs):
    """At the ends and in the middle of each such stretch."""
    zone = Zone("", IN, (), (-math.inf, -math.inf, math.inf, math.inf), areas=tuple(areas))
    found, told = spent(zone, (0.0, 0.0), (0.0, 80.0), within_m)
    assert (found, told) == (least_m, costs)
    assert least(zone, (0.0, 0.0), (0.0, 80.0), within_m) == (least_m, sum(costs))


BEND = [(-50.0, -50.0), (50.0, -50.0), (50.0, 0.0), (0.0, 0.0), (0.0, 50.0), (-50.0, 50.0)]
LONG = [(-50.0, -200.0), (50.0, -200.0), (50.0, 200.0), (-50.0, 200.0)]


def turned(at: Point) -> Point:
    return 0.6 * at[0] - 0.8 * at[1] + 7.0, 0.8 * at[0] + 0.6 * at[1] - 3.0


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize(
    ("corners", "a", "b", "within_m", "least_m", "costs"),
    [
        (BEND, (-2.99, 0.3), (-2.99, 0.7), 3.0, 2.99, [2, 2, 2]),  # beside one side, just past the corner
        (BEND, (-2.99, -0.7), (-2.99, -0.3), 3.0, math.inf, []),  # just before it
        (BEND, (0.3, -2.99), (0.7, -2.99), 3.0, 2.99, [2, 2, 2]),
        (BEND, (-0.7, -2.99), (-0.3, -2.99), 3.0, math.inf, []),
        (BEND, (-3.0, -40.0), (-3.0, 40.0), 2.99, math.inf, []),
        (BEND, (-10.0, -10.0), (10.0, 10.0), 5.0, -10.0, [2, 2, 2]),  # out at the corner
        (BEND, (-30.0, -30.0), (10.0, 10.0), 5.0, -10.0, [2, 2, 2]),
        (BEND, (40.0, -10.0), (-10.0, 40.0), 5.0, -15.0, [2, 2, 2]),  # across it
        (BEND, (-0.18, -0.42), (-0.42, -0.18), 0.5, 0.3 * 2.0**0.5, [2, 2, 2]),  # past it, within half a metre
        (BEND, (0.0, -80.0), (0.0, -5.0), 4.0, -30.0, [2, 2, 2]),
        (LONG, (0.0, -20.0), (0.0, 20.0), 49.99, math.inf, []),
        (LONG, (0.0, -20.0), (0.0, 20.0), 50.01, 50.0, [2, 2, 2]),
        (SQUARE, (0.0, -90.0), (0.0, 40.0), 5.0, -40.0, [1, 2, 2]),
        (SQUARE, (-90.0, 0.0), (40.0, 0.0), 5.0, -40.0, [1, 2, 2]),
    ],
)
def test_a_way_is_near_the_sides_of_an_area_however_they_lie(corners, a, b, within_m, least_m, costs, reverse):
    area = polygon("", IN, [turned(each) for each in (corners[::-1] if reverse else corners)])
    zone = Zone("", IN, (), (-math.inf, -math.inf, math.inf, math.inf), areas=(area,))
    for first, last in ((a, b), (b, a)):
        found, (_, _, *told) = spent(zone, turned(first), turned(last), within_m)
        assert found == pytest.approx(least_m, abs=1e-9)
        assert sorted(told) == costs


def test_a_way_is_bare_where_it_is_outside_or_no_farther_from_a_side() -> None:
    """It ends within, where the way beyond would be outside again; it keeps the distance to the metre."""
    for corners, a, b, within_m, found in (
        (SQUARE, (0.0, -80.0), (0.0, 40.0), 5.0, (-30.0, [1, 9, 1, 2, 1])),
        (LONG, (0.0, -20.0), (0.0, 20.0), 50.0, (math.inf, [1, 9, 2, 2, 2])),
        (LONG[::-1], (0.0, -20.0), (0.0, 20.0), 50.0, (math.inf, [1, 9, 2, 2, 2])),
    ):
        zone = Zone("", IN, (), (-math.inf, -math.inf, math.inf, math.inf), areas=(polygon("", IN, corners),))
        assert spent(zone, a, b, within_m) == found


def test_a_way_through_discs_is_covered_where_they_leave_room() -> None:
    places = [turned((0.0, 0.0)), turned((0.0, 80.0))]
    zone = together("", [circle("", IN, each, 50.0) for each in places])
    for a, b in (places, places[::-1]):
        assert spent(zone, a, b, 20.0) == (pytest.approx(10.0), [1, 0, 1, 0, 1, 1, 1])
        assert spent(zone, a, b, 9.99) == (math.inf, [1, 0, 1, 0])
        near = a[0] + 0.1 * (b[0] - a[0]), a[1] + 0.1 * (b[1] - a[1])
        assert spent(zone, a, near, 60.0)[0] == pytest.approx(42.0), "no disc leaves so much"


def test_on_the_spot_areas_are_looked_at_there() -> None:
    zone = together("", ROOMS)
    assert spent(zone, (0.0, 30.0), (0.0, 30.0), 21.0) == (20.0, [1, 1, 1])
    assert spent(zone, (0.0, 30.0), (0.0, 30.0), 20.0) == (math.inf, [1, 1, 1])


def test_a_way_that_comes_to_light_in_many_places_is_not_looked_at() -> None:
    chain = [circle("", IN, (0.0, 20.0 * n), 5.0) for n in range(10)]
    assert spent(together("", chain[:9]), (0.0, 0.0), (0.0, 160.0), 1.0)[0] == -5.0
    assert spent(together("", chain), (0.0, 0.0), (0.0, 180.0), 1.0)[0] == 0.0
    most = chain * (LOOKS // 10)
    assert least(together("", most[1:]), (0.0, 0.0), (0.0, 180.0), 1.0) == (0.0, LOOKS - 1)
    assert least(together("", most), (0.0, 0.0), (0.0, 180.0), 1.0) == (math.inf, LOOKS + 1)
