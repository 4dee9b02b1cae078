"""The fence's geometry, against slow and obvious ways to say the same."""

import math

import msgspec
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from delfim import config
from delfim.base import geodesy
from delfim.base.cooperative import Sliced
from delfim.base.errors import ConfigError
from delfim.vehicle.plans import fence
from delfim.vehicle.plans.fence import Fence, stopping_m
from delfim.vehicle.plans.legs import complaint
from delfim.vehicle.plans.mission import canonical, digest, parse_mission
from delfim.vehicle.plans.zones import LOOKS, circle, clearance_m, least, polygon, searched, together
from delfim.vehicle.state import Arc, Line, Motion, Plan, Waypoint

LIMITS = config.FenceTable()
WITH = msgspec.structs.replace


def whole(work, *arguments: object):
    return Sliced(work(*arguments)).finish()


ALL = frozenset({"position", "heading", "velocity"})
SQUARE = polygon("square", True, [(-50.0, -50.0), (50.0, -50.0), (50.0, 50.0), (-50.0, 50.0)])
ROCK = circle("rock", False, (0.0, 100.0), 10.0)
WALL = polygon("wall", False, [(20.0, -40.0), (20.5, -40.0), (20.5, 40.0), (20.0, 40.0)])

metres = st.floats(-150.0, 150.0, allow_nan=False)
points = st.tuples(metres, metres)


@st.composite
def stars(draw: st.DrawFn) -> list[tuple[float, float]]:
    """Corners of a polygon that does not cross itself: by bearing around a point."""
    n = draw(st.integers(3, 12))
    radii = draw(st.lists(st.floats(5.0, 80.0), min_size=n, max_size=n))
    at = draw(points)
    return [(at[0] + r * math.cos(math.tau * i / n), at[1] + r * math.sin(math.tau * i / n)) for i, r in enumerate(radii)]


def motion(north_m: float, east_m: float, north_mps: float = 0.0, east_mps: float = 0.0, has: frozenset[str] = ALL) -> Motion:
    return Motion(has, north_m, east_m, 0.0, 0.0, north_mps, east_mps)


def winds_around(corners: list[tuple[float, float]], at: tuple[float, float]) -> bool:
    """Inside by the sum of angles."""
    total = 0.0
    for a, b in zip(corners, [*corners[1:], corners[0]], strict=True):
        first, second = math.atan2(a[1] - at[1], a[0] - at[0]), math.atan2(b[1] - at[1], b[0] - at[0])
        total += geodesy.wrap(second - first)
    return abs(total) > math.pi


def sampled_distance(corners: list[tuple[float, float]], at: tuple[float, float], steps: int = 400) -> float:
    sides = zip(corners, [*corners[1:], corners[0]], strict=True)
    return min(
        math.dist(at, (a[0] + (b[0] - a[0]) * i / steps, a[1] + (b[1] - a[1]) * i / steps))
        for a, b in sides
        for i in range(steps + 1)
    )


@settings(deadline=None)
@given(stars(), points)
def test_clearance_is_the_distance_to_the_edge_with_the_sign_of_the_side(corners, at):
    away = clearance_m(polygon("", False, corners), *at)
    assume(abs(away) > 0.5)
    assert (away < 0.0) is winds_around(corners, at)
    assert abs(away) == pytest.approx(sampled_distance(corners, at), abs=0.5)


@settings(deadline=None)
@given(stars(), points, st.booleans())
def test_keep_in_and_keep_out_are_opposites_and_the_direction_of_corners_does_not_matter(corners, at, reverse):
    inwards = clearance_m(polygon("", True, corners[::-1] if reverse else corners), *at)
    assert clearance_m(polygon("", False, corners), *at) == pytest.approx(-inwards, abs=1e-9)


@settings(deadline=None)
@given(stars(), points, points)
def test_clearance_changes_no_faster_than_the_boat_moves(corners, a, b):
    zone = polygon("", True, corners)
    assert abs(clearance_m(zone, *a) - clearance_m(zone, *b)) <= math.dist(a, b) + 1e-6


@settings(deadline=None)
@given(stars(), points, points, st.booleans())
def test_the_least_clearance_of_a_way_is_that_of_its_worst_point(corners, a, b, keep_in):
    zone = polygon("", keep_in, corners)
    smallest, _ = least(zone, a, b)
    ways = [clearance_m(zone, a[0] + (b[0] - a[0]) * i / 200, a[1] + (b[1] - a[1]) * i / 200) for i in range(201)]
    if smallest > 0.0:
        assert smallest == pytest.approx(min(ways), abs=math.dist(a, b) / 200 + 1e-9)
        assert min(ways) > 0.0
    else:
        assert min(ways) < math.dist(a, b) / 200 + 1e-9, "between two samples, or at one of them, the way is forbidden"


@settings(deadline=None)
@given(points, points, st.floats(1.0, 60.0))
def test_the_same_around_a_circle(a, b, radius_m):
    zone = circle("", False, (10.0, -20.0), radius_m)
    ways = [clearance_m(zone, a[0] + (b[0] - a[0]) * i / 200, a[1] + (b[1] - a[1]) * i / 200) for i in range(201)]
    assert least(zone, a, b)[0] == pytest.approx(min(ways), abs=math.dist(a, b) / 200 + 1e-9)


# Several areas to stay in.

EAST = polygon("east", True, [(-50.0, 30.0), (50.0, 30.0), (50.0, 130.0), (-50.0, 130.0)])
POND = circle("pond", True, (0.0, 200.0), 80.0)
BOTH = together("keep-in zones", [SQUARE, EAST, POND])  # they overlap by 20 m and by 10 m
discs = st.builds(lambda at, radius_m: circle("", True, at, radius_m), points, st.floats(5.0, 100.0))
polygons = st.builds(lambda corners: polygon("", True, corners), stars())


@settings(deadline=None)
@given(st.lists(st.one_of(discs, polygons), min_size=2, max_size=6), points, points, st.floats(0.5, 20.0))
def test_a_way_is_clear_where_one_of_the_areas_clears_each_point(areas, a, b, within_m):
    zone = together("", areas)
    smallest, step_m = whole(searched, zone, a, b, within_m), math.dist(a, b) / 200
    at = [(a[0] + (b[0] - a[0]) * i / 200, a[1] + (b[1] - a[1]) * i / 200) for i in range(201)]
    least_m = min(max(clearance_m(area, *point) for area in areas) for point in at)
    if smallest >= within_m:
        assert least_m >= within_m - step_m - 1e-6
    else:
        assert least_m < within_m + step_m + 1e-6
        assert smallest >= min(clearance_m(zone, *point) for point in at) - step_m - 1e-6
    assert least(zone, a, b, within_m)[0] in (smallest, math.inf)


@pytest.mark.parametrize(
    ("north_m", "east_m", "north_mps", "east_mps", "stops"),
    [
        (0.0, 38.0, 0.0, 2.0, False),  # through the overlap, which no side of a polygon ends
        (0.0, 122.0, 0.0, 2.0, False),  # the second overlap has 5 m in its middle
        (0.0, 110.0, 0.0, 0.5, False),
        (45.0, 38.0, 0.0, 2.0, False),
        (45.0, 38.0, 2.0, 0.0, True),  # out at the top
        (0.0, 275.0, 0.0, 2.0, True),
        (0.0, 275.0, 0.0, -2.0, False),
        (60.0, 0.0, -1.0, 0.0, False),  # outside, on the way back
        (60.0, 0.0, 1.0, 0.0, True),
    ],
)
def test_ahead_the_boat_may_go_from_one_area_into_the_next(north_m, east_m, north_mps, east_mps, stops):
    around = Fence((BOTH,), LIMITS)
    assert (fence.ahead(around, motion(north_m, east_m, north_mps, east_mps)) is not None) is stops


def test_outside_is_outside_of_all_areas():
    around = Fence((BOTH,), LIMITS)
    assert fence.outside(around, 0.0, 40.0) is None
    assert fence.outside(around, 0.0, 279.0) is None
    assert fence.outside(around, 0.0, 290.0) == "10.0 m outside the keep-in zones"
    assert fence.outside(around, 60.0, 40.0) == "10.0 m outside the keep-in zones"
    assert fence.outside(Fence((POND,), LIMITS), 0.0, 290.0) == "10.0 m outside the pond"


def test_a_mission_may_lead_from_one_area_into_the_next():
    def why(*places, areas=BOTH):
        to = tuple(Waypoint(*place, 1.0, 2.0) for place in places)
        return whole(complaint, Fence((areas,), LIMITS), Plan("", to, ()), 5.0)

    assert why((0.0, 0.0), (0.0, 90.0)) is None
    assert why((0.0, 0.0), (0.0, 90.0), areas=together("both", [SQUARE, POND])) == (
        "the leg to waypoint 2 leads out of the both; missions keep 6 m away"
    )
    narrow = "the leg to waypoint 2 leads 5.0 m past keep-in zones; missions keep 6 m away"
    assert why((0.0, 90.0), (0.0, 200.0)) == narrow, "an overlap of 10 m has 5 m in its middle"


def test_many_areas_are_watched_within_bounds():
    """20 areas of 100 corners, all of them here: the check of the loop gives up with the safe answer, and reviews go on."""
    ring = [(60.0 * math.cos(math.tau * i / 100), 60.0 * math.sin(math.tau * i / 100)) for i in range(100)]
    areas = [polygon("", True, [(north + n, east) for north, east in ring]) for n in range(config.AREAS)]
    zone = together("keep-in zones", areas)
    a, b = (-200.0, 0.0), (200.0, 0.0)
    assert least(zone, a, b, 3.0) == (math.inf, LOOKS + 1)
    assert "too many corners" in (fence.ahead(Fence((zone,), LIMITS), motion(70.0, 0.0, 9.0, 0.0)) or "")
    assert whole(searched, zone, a, b, 3.0) < 0.0
    assert max(searched(zone, a, b, 3.0)) <= 1 + config.AREAS * config.CORNERS // 4


def test_two_large_areas_are_no_hindrance():
    """Nor for a boat that is too near to the edge and leaves it."""
    ring = [(60.0 * math.cos(math.tau * i / 100), 60.0 * math.sin(math.tau * i / 100)) for i in range(100)]
    around = Fence((together("both", [polygon("", True, [(n + at, e) for n, e in ring]) for at in (0.0, 80.0)]),), LIMITS)
    for at in (0.0, 30.0, 40.0, 90.0):
        assert fence.ahead(around, motion(at, 0.0, 2.0, 0.0)) is None
    assert fence.ahead(around, motion(0.0, 58.5, 0.0, -1.0)) is None
    assert (fence.ahead(around, motion(0.0, 57.0, 0.0, 1.0)) or "").startswith("both 3.0 m away")
    assert (fence.ahead(around, motion(139.0, 0.0, 1.0, 0.0)) or "").startswith("both 1.0 m away")


@settings(deadline=None)
@given(stars())
def test_a_polygon_by_bearing_is_accepted_and_one_that_crosses_itself_is_not(corners):
    assert Sliced(geodesy.polygon_fault(corners)).finish() is None
    assert "same corner twice" in (Sliced(geodesy.polygon_fault([*corners, corners[0]])).finish() or "")


@pytest.mark.parametrize(
    ("corners", "reason"),
    [
        ([], "it needs three"),
        ([(0, 0), (1, 1)], "it needs three"),
        ([(0, 0), (1, 1), (1, 0), (0, 1)], "the side from corner 1 meets the one from corner 3"),
        ([(0, 0), (2, 0), (2, 2), (1, 0), (0, 2)], "crosses itself"),  # touches
        ([(0, 0), (1, 0), (2, 0)], "on one line"),
        ([(0, 0), (1, 0), (0, 0), (0, 1)], "same corner twice"),
    ],
)
def test_polygons_that_nobody_can_have_meant(corners, reason):
    assert reason in (Sliced(geodesy.polygon_fault(corners)).finish() or "")


@settings(deadline=None)
@given(st.floats(0.2, 2.5), st.floats(-math.pi, math.pi))
def test_a_boat_that_keeps_its_course_is_stopped_in_time(speed_mps, course_rad):
    """From the middle to the edge, looked at ten times a second: the first alarm leaves stopping distance and margin."""
    around = Fence((SQUARE, ROCK, WALL), LIMITS)
    north_m = east_m = 0.0
    for _ in range(5_000):
        if fence.ahead(around, motion(north_m, east_m, speed_mps * math.cos(course_rad), speed_mps * math.sin(course_rad))):
            break
        north_m += 0.1 * speed_mps * math.cos(course_rad)
        east_m += 0.1 * speed_mps * math.sin(course_rad)
    room_m = stopping_m(LIMITS, speed_mps)
    end = north_m + room_m * math.cos(course_rad), east_m + room_m * math.sin(course_rad)
    assert min(least(zone, (north_m, east_m), end)[0] for zone in around.zones) >= LIMITS.margin_m - 0.1 * speed_mps - 1e-6


@settings(deadline=None)
@given(points, st.floats(0.05, 3.0))
def test_a_boat_that_goes_straight_away_from_a_zone_is_not_stopped(at, speed_mps):
    away_m = math.dist(at, (ROCK.north_m, ROCK.east_m))
    assume(away_m > 0.1)
    course = (at[0] - ROCK.north_m) / away_m, (at[1] - ROCK.east_m) / away_m
    assert fence.ahead(Fence((ROCK,), LIMITS), motion(*at, speed_mps * course[0], speed_mps * course[1])) is None


def test_a_boat_at_rest_is_not_stopped_and_one_of_unknown_velocity_is_when_it_is_near():
    around = Fence((SQUARE,), LIMITS)
    assert fence.ahead(around, motion(49.0, 0.0)) is None
    unknown = motion(49.0, 0.0, has=frozenset({"position"}))
    assert fence.ahead(around, unknown) == "square 1.0 m away, velocity unknown"
    assert fence.ahead(around, unknown._replace(north_m=0.0)) is None


DISC = circle("disc", True, (0.0, 0.0), 50.0)
SLOW = config.FenceTable(margin_m=3.0, reaction_s=1.0, deceleration_mps2=0.5)  # 2 m at 1 m/s


@pytest.mark.parametrize(("reaction_s", "speed_mps", "way_m"), [(1.0, 0.0, 0.0), (1.0, 1.0, 2.0), (2.0, 2.0, 8.0)])
def test_the_stopping_distance_is_that_of_the_reaction_and_of_the_drag(reaction_s, speed_mps, way_m):
    assert stopping_m(WITH(SLOW, reaction_s=reaction_s), speed_mps) == way_m


@pytest.mark.parametrize("zone", [DISC, SQUARE])
@pytest.mark.parametrize(
    ("north_m", "north_mps", "says"),
    [
        (45.0, 1.0, None),  # it stops at the margin
        (45.5, 1.0, "4.5 m away at 1.0 m/s"),
        (48.0, 0.005, None),  # it goes along the edge
        (48.0, 0.015, "2.0 m away at 0.0 m/s"),
        (54.0, 1.0, "0.0 m away at 1.0 m/s"),
        (54.0, -1.0, None),
    ],
)
def test_ahead_counts_the_stopping_distance_to_the_metre(zone, north_m, north_mps, says):
    told = None if says is None else f"{zone.name} {says}"
    assert fence.ahead(Fence((zone,), SLOW), motion(north_m, 0.0, north_mps, 0.0)) == told
    assert fence.ahead(Fence((zone,), SLOW), motion(0.0, north_m, 0.0, north_mps)) == told


@pytest.mark.parametrize(("north_m", "near"), [(46.9, False), (47.1, True)])
def test_an_unknown_velocity_stops_within_the_margin(north_m, near):
    unknown = motion(north_m, 0.0, 9.0, 9.0, frozenset({"position"}))
    assert (fence.ahead(Fence((SQUARE,), SLOW), unknown) is not None) is near


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(
    ("at_m", "mps", "known", "says"),
    [
        (53.0, 0.0, True, None),  # within the margin
        (53.5, 0.0, True, "3.5 m outside the {} and not coming back"),
        (53.5, -0.05, True, "3.5 m outside the {} and not coming back"),
        (53.5, -0.15, True, None),
        (53.5, -0.15, False, "3.5 m outside the {} and not coming back"),
        (53.5, 0.15, True, "3.5 m outside the {} and not coming back"),
    ],
)
def test_left_is_beyond_the_margin_and_not_coming_back(axis, at_m, mps, known, says):
    has = ALL if known else frozenset({"position"})
    place, speed = ((at_m, 0.0), (mps, 0.0)) if axis == 0 else ((0.0, at_m), (0.0, mps))
    for zone in (DISC, SQUARE):
        told = None if says is None else says.format(zone.name)
        assert fence.left(Fence((zone,), SLOW), motion(*place, *speed, has)) == told


@pytest.mark.parametrize("offset", [(4.0, 0.0), (-4.0, 0.0), (0.0, 4.0), (0.0, -4.0)])
def test_left_is_in_a_zone_to_stay_out_of_too(offset):
    """On each side of its middle; beside it, it is not."""
    north_m, east_m = offset
    around = Fence((ROCK,), SLOW)
    assert fence.left(around, motion(north_m, 100.0 + east_m)) == "6.0 m inside rock and not coming back"
    assert fence.outside(around, north_m, 100.0 + east_m) == "6.0 m inside rock"
    assert fence.left(around, motion(5.0 * north_m, 100.0 + 5.0 * east_m)) is None
    assert fence.outside(around, 5.0 * north_m, 100.0 + 5.0 * east_m) is None


def test_on_the_edge_is_where_the_boat_may_be():
    for zone in (DISC, SQUARE, circle("", False, (50.0, 100.0), 100.0)):
        assert fence.outside(Fence((zone,), SLOW), 50.0, 0.0) is None


@pytest.mark.parametrize(
    ("least_m", "inwards", "outwards"),
    [
        (0.5, "0.5 m past pond", "0.5 m past rock"),
        (0.0, "out of the pond", "through rock"),
        (-1.0, "out of the pond", "through rock"),
    ],
)
def test_a_way_is_told_by_what_it_passes(least_m, inwards, outwards):
    assert (fence.through(POND, least_m), fence.through(ROCK, least_m)) == (inwards, outwards)


def test_a_way_that_leaves_a_margin_may_do_so_but_not_come_nearer():
    around = Fence((DISC,), SLOW)
    assert fence.crossing(around, motion(48.0, 0.0), (45.0, 0.0)) is None
    assert fence.crossing(around, motion(48.0, 0.0), (47.995, 0.0)) is None
    assert fence.crossing(around, motion(48.0, 0.0), (48.015, 0.0)) == "the way leads 2.0 m past disc"
    assert fence.crossing(around, motion(40.0, 0.0), (47.0, 0.0)) is None, "to the margin"
    hold = whole(fence.place_to_hold, around, (48.0, 0.0), (48.5, 0.0), ((45.0, 0.0),), 2.0)
    assert hold == ((45.0, 0.0), 1.0), "the margin and the radius, to the metre"


def test_outside_is_told_with_the_distance():
    around = Fence((SQUARE, ROCK), LIMITS)
    assert fence.outside(around, 0.0, 0.0) is None
    assert fence.outside(around, 50.0, 0.0) is None
    assert fence.outside(around, 62.0, 0.0) == "12.0 m outside the square"
    assert fence.outside(Fence((ROCK,), LIMITS), 0.0, 96.0) == "6.0 m inside rock"


def to(north_m: float, east_m: float, speed_mps: float = 1.5) -> Waypoint:
    return Waypoint(north_m, east_m, speed_mps, 5.0)


@pytest.mark.parametrize(
    ("waypoints", "reason"),
    [
        ([to(0, 0)], None),
        ([to(48, 0)], "waypoint 1 leads 2.0 m past square; missions keep 6 m away"),
        ([to(0, 0), to(0, 40)], None),
        ([to(0, 0), to(0, 60)], "the leg to waypoint 2 leads out of the square; missions keep 6 m away"),
        ([to(0, -44), to(15, 30)], "the leg to waypoint 2 leads 5.0 m past wall; missions keep 6 m away"),
        ([to(0, 0), to(40, 0)], "the leg to waypoint 2 leads through wall; missions keep 6 m away"),
        ([to(0, 0), to(0, 43), to(-20, 43)], "the leg to waypoint 2 ends at 1.5 m/s without room to stop before square"),
        ([to(0, 0), to(0, 43, 0.5), to(-20, 43)], None),
    ],
)
def test_missions_are_held_against_the_fence(waypoints, reason):
    assert whole(complaint, Fence((SQUARE, WALL), LIMITS), Plan("", tuple(waypoints), ()), 5.0) == reason


def test_a_place_to_stay_at_needs_room_to_drift():
    waits = to(0, 43)._replace(hold_s=10.0)
    reason = "no room to wait at waypoint 2: square is nearer than 8 m"
    assert whole(complaint, Fence((SQUARE,), LIMITS), Plan("", (to(0, 0), waits), ()), 5.0) == reason
    assert whole(complaint, Fence((SQUARE,), LIMITS), Plan("", (to(0, 0), waits), ()), 4.0) is None


def test_paths_and_their_arcs_too():
    line = Line(-20.0, -30.0, -20.0, 0.0, 1.5)
    inside = Arc(0.0, 0.0, 20.0, math.pi, -math.pi / 2, 1.5)
    around = Fence((SQUARE,), LIMITS)
    assert whole(complaint, around, Plan("", (), (line, inside)), 5.0) is None
    bulging = Arc(-20.0, 20.0, 28.0, -math.pi / 2, -math.pi, 1.5)
    assert (whole(complaint, around, Plan("", (), (line, bulging)), 5.0) or "").startswith("piece 2 of the path leads")


def test_a_turn_that_points_at_the_fence_needs_room_too():
    """Legs along the fence, and between them half a turn towards it."""
    there, back = [to(-30, 43), to(0, 43)], to(-30, 43.9)
    assert "without room to stop" in (whole(complaint, Fence((SQUARE,), LIMITS), Plan("", (*there, back), ()), 5.0) or "")
    assert whole(complaint, Fence((SQUARE,), LIMITS), Plan("", (to(-30, 36), to(0, 36), to(-30, 34)), ()), 5.0) is None


def test_the_way_to_where_a_mode_begins_is_held_against_it():
    around = Fence((WALL,), LIMITS)
    assert fence.crossing(around, motion(0.0, 0.0), (40.0, 0.0)) == "the way leads through wall"
    assert fence.crossing(around, motion(0.0, 0.0), (0.0, 30.0)) is None
    assert fence.crossing(around, motion(0.0, 0.0), None) is None
    assert fence.crossing(around, motion(19.0, 0.0), (0.0, 30.0)) is None, "out of the margin it may go"


def test_it_holds_where_it_has_room():
    around = Fence((SQUARE,), LIMITS)
    track = ((0.0, 0.0), (0.0, 20.0), (0.0, 40.0), (0.0, 45.0))
    for here, of, place, part in (
        ((0.0, 10.0), track, (0.0, 10.0), 1.0),
        ((0.0, 47.0), track, (0.0, 40.0), 1.0),
        ((0.0, 47.0), ((0.0, 49.0),), (0.0, 47.0), 0.4),
        ((0.0, 47.0), ((0.0, 44.0), (0.0, 46.0)), (0.0, 44.0), 0.4),
    ):
        assert whole(fence.place_to_hold, around, here, here, of, 5.0) == (place, part)


def test_it_holds_where_the_straight_way_does_not_cross_a_zone_that_the_track_led_around():
    around = Fence((circle("the rock", False, (0.0, 0.0), 10.0),), LIMITS)
    here, beside, behind = (0.0, 12.0), (15.0, 15.0), (0.0, -25.0)
    assert whole(fence.place_to_hold, around, here, here, (beside, behind), 5.0) == (beside, 1.0)
    assert whole(fence.place_to_hold, around, here, here, (behind,), 5.0) == (here, 0.4), "rather than through the rock"


MISSION = """version = 1
name = "fenced"

[[waypoint]]
latitude_deg = 38.69
longitude_deg = -9.21

[fence]
version = 1

[[fence.keep_in]]
polygon = [[38.6, -9.3], [38.8, -9.3], [38.8, -9.1], [38.6, -9.1]]

[[fence.keep_in]]
name = "the bay"
centre = [[38.8, -9.2]]
radius_m = 500.0

[[fence.keep_out]]
name = "the \\"old\\" pier"
centre = [[38.7, -9.2]]
radius_m = 30.0

[[fence.keep_out]]
polygon = [[38.61, -9.29], [38.62, -9.29], [38.62, -9.28]]
"""


def test_a_missions_fence_is_part_of_its_text_and_comes_on_top_of_the_boats():
    mission = parse_mission(MISSION)
    assert canonical(mission) == MISSION
    assert digest(mission) != digest(parse_mission(MISSION.replace("30.0", "31.0")))
    own = config.FenceTable(keep_out=(config.Area(name="buoy", centre=((38.7, -9.25),), radius_m=5.0),))
    at = geodesy.origin(math.radians(38.69), math.radians(-9.21))
    around = whole(fence.survey, own, mission.fence, at)
    assert around is not None
    assert [zone.name for zone in around.zones] == [
        "buoy",
        "mission's keep-in zones",
        'the "old" pier',
        "mission's keep-out zone 2",
    ]
    assert [area.name for area in around.zones[1].areas] == ["mission's keep-in zone 1", "the bay"]
    assert whole(fence.survey, config.FenceTable(), config.Zones(), at) is None
    unlaid = fence.unlaid(own, config.Zones())
    assert unlaid is not None
    assert not unlaid.is_laid
    assert fence.unlaid(config.FenceTable(), config.Zones()) is None


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ("version = 2", "fence.version"),
        (
            "keep_in = [{polygon = [[38.6, -9.3], [38.8, -9.1], [38.8, -9.3], [38.6, -9.1]]}]",
            "keep_in[0]: the polygon crosses itself",
        ),
        ("keep_in = [{polygon = [[38.6, -9.3], [38.8, -9.1]]}]", "a polygon of 2 corners: it needs three"),
        ("keep_out = [{}]", "either a polygon or a centre with a radius"),
        ("keep_out = [{centre = [[38.7, -9.2]]}]", "a circle needs its centre and its radius"),
        ("keep_out = [{centre = [[98.7, -9.2]], radius_m = 3}]", "-89.0 to 89.0"),
        ("moat = 3", "fence.moat"),
    ],
)
def test_a_fence_that_cannot_be_meant_is_refused_in_words(wrong, reason):
    with pytest.raises(ConfigError) as refused:
        parse_mission(MISSION[: MISSION.index("[fence]")] + "[fence]\n" + wrong)
    assert reason in str(refused.value)


# What it costs: each answer is given up, safely, after LOOKS comparisons.

SLOPE = polygon("slope", False, [(0.0, 0.0), (10.0, 0.0), (0.0, 10.0)])  # not in the corner of its box
EIGHT = polygon("eight", False, [(20.0 * math.cos(at), 20.0 * math.sin(at)) for at in (math.tau * i / 8 for i in range(8))])
TEN = together("ten", [circle("", True, (0.0, float(i)), 50.0) for i in range(10)])


@pytest.mark.parametrize(("zone", "north_m", "east_m", "most"), [(SLOPE, 9.0, 9.0, 200), (TEN, 0.0, 0.0, 20)])
def test_outside_watches_so_many_zones(zone, north_m, east_m, most):
    assert fence.outside(Fence((zone,) * most, SLOW), north_m, east_m) is None
    words = f"in more zones than can be watched, {zone.name} among them: use fewer zones"
    assert fence.outside(Fence((zone,) * (most + 1), SLOW), north_m, east_m) == words


@pytest.mark.parametrize(
    ("zone", "at", "most"),
    [(SLOPE, (9.0, 9.0), 200), (TEN, (0.0, 0.0), 20), (EIGHT, (17.6, 0.0), 40)],  # the last one: in it, by less than the margin
)
def test_left_looks_at_so_many_zones(zone, at, most):
    deep = circle("deep", False, at, 9.0)
    assert fence.left(Fence((*(zone,) * most, deep), SLOW), motion(*at)) == "9.0 m inside deep and not coming back"
    assert fence.left(Fence((*(zone,) * (most + 1), deep), SLOW), motion(*at)) is None


@pytest.mark.parametrize(
    ("zone", "north_m", "north_mps", "most"),
    [(DISC, 0.0, 1.0, 200), (SQUARE, 0.0, 1.0, 22), (SQUARE, 48.0, -1.0, 20)],  # the last one: away from an edge that is near
)
def test_ahead_looks_at_so_many_zones(zone, north_m, north_mps, most):
    assert fence.ahead(Fence((zone,) * most, SLOW), motion(north_m, 0.0, north_mps)) is None
    words = f"too many corners of zones close by to watch, {zone.name} among them: simplify the zones"
    assert fence.ahead(Fence((zone,) * (most + 1), SLOW), motion(north_m, 0.0, north_mps)) == words


def test_a_way_passes_so_many_zones():
    assert fence.crossing(Fence((DISC,) * 200, SLOW), motion(0.0, 0.0), (9.0, 0.0)) is None
    words = "the way passes too many corners of zones, disc among them: go there in shorter stretches"
    assert fence.crossing(Fence((DISC,) * 201, SLOW), motion(0.0, 0.0), (9.0, 0.0)) == words


def test_a_place_to_hold_is_looked_for_among_so_many_zones():
    """Where it has room, and where only the way to it passes too many; with what it says that it cost."""
    far = circle("far", False, (999.0, 999.0), 1.0)  # which only counts
    corner = polygon("corner", False, [(20.0, 50.0), (-20.0, 50.0), (20.0, -10.0)])
    for zone, at, here, most, cost in (
        (DISC, (0.0, 0.0), (0.0, 0.0), 200, 2 * (201 + 50 + 1)),
        (corner, (-18.0, -8.0), (-40.0, -8.0), 28, 2 * (203 + 7 + 1)),
    ):
        watched, too_many = (Fence((far, far, *(zone,) * count), SLOW) for count in (most, most + 1))
        assert whole(fence.place_to_hold, watched, at, here, (), 5.0) == (here, 1.0)
        assert list(fence.place_to_hold(watched, at, here, (), 5.0)) == []
        assert whole(fence.place_to_hold, too_many, at, here, (), 5.0) == (here, 0.4)
        assert list(fence.place_to_hold(too_many, at, here, (), 5.0)) == [cost, cost]


HARBOUR = config.Area(polygon=((38.6, -9.3), (38.8, -9.3), (38.8, -9.1), (38.6, -9.1)))
BUOY = config.Area(centre=((38.7, -9.25),), radius_m=5.0)
PLACE = geodesy.origin(math.radians(38.69), math.radians(-9.21))


def test_zones_are_laid_with_their_names_and_what_they_cost():
    own = config.FenceTable(keep_in=(HARBOUR,), keep_out=(BUOY, HARBOUR))
    assert list(fence.survey(own, config.Zones(), PLACE)) == [9, 1, 9]
    laid = whole(fence.survey, own, config.Zones(keep_in=(HARBOUR, HARBOUR)), PLACE)
    assert [(zone.name, zone.keep_in) for zone in laid.zones] == [
        ("keep-in zone", True),
        ("keep-out zone 1", False),
        ("keep-out zone 2", False),
        ("mission's keep-in zones", True),
    ]
    assert (laid.own, laid.is_laid) == (3, True)
    assert [area.name for area in laid.zones[3].areas] == ["mission's keep-in zone 1", "mission's keep-in zone 2"]
    named = whole(fence.survey, config.FenceTable(keep_in=(WITH(HARBOUR, name="bay"),)), config.Zones(), PLACE)
    assert [zone.name for zone in named.zones] == ["keep-in zone"]


def test_the_boats_own_zones_are_taken_from_a_fence_in_this_plane():
    own, mission = config.FenceTable(keep_out=(BUOY, BUOY)), config.Zones(keep_out=(HARBOUR,))
    before = whole(fence.survey, own, mission, PLACE)
    assert list(fence.survey(own, mission, PLACE, before)) == [9], "only the mission's"
    again = whole(fence.survey, own, config.Zones(), PLACE, before)
    assert (again.zones, again.own) == (before.zones[:2], 2)
    assert whole(fence.survey, own, mission, PLACE, fence.unlaid(own, mission)) == before
    assert Fence((), own) == (((), own, 0, True))


@pytest.mark.parametrize("which", ["keep_in", "keep_out"])
def test_there_is_a_fence_as_soon_as_anybody_has_a_zone(which):
    zones = {which: (BUOY,)}
    for own, mission in ((config.FenceTable(**zones), config.Zones()), (config.FenceTable(), config.Zones(**zones))):
        assert fence.unlaid(own, mission) == Fence((), own, 0, False)


def test_zones_elsewhere_cost_nothing():
    elsewhere, deep = (EIGHT,) * 201, circle("deep", False, (99.0, 0.0), 9.0)
    assert fence.outside(Fence(elsewhere, SLOW), 99.0, 0.0) is None
    assert fence.left(Fence((*elsewhere, deep), SLOW), motion(99.0, 0.0)) == "9.0 m inside deep and not coming back"


def test_a_way_that_keeps_the_margin_to_the_metre_is_a_way():
    beside = Fence((circle("beside", False, (0.0, 13.0), 10.0),), SLOW)
    assert fence.crossing(beside, motion(-20.0, 0.0), (20.0, 0.0)) is None
    assert whole(fence.place_to_hold, beside, (-20.0, 0.0), (20.0, 0.0), (), 5.0) == ((20.0, 0.0), 1.0)


@pytest.mark.parametrize(
    ("east_m", "zones", "is_cut_off"),
    [
        (100.0, [circle("rock", False, (0.0, 50.0), 10.0)], True),
        (100.0, [circle("rock", False, (0.0, 50.0), 10.0), circle("far", False, (500.0, 0.0), 1.0)], True),
        (100.0, [circle("rock", False, (0.0, 150.0), 10.0)], False),
        (100.0, [], False),
        (10.0, [circle("rock", False, (0.0, 5.0), 1.0)], False),
        (math.nextafter(10.0, 11.0), [circle("rock", False, (0.0, 5.0), 1.0)], True),
        (100.0, None, False),
    ],
)
def test_a_place_is_cut_off_by_a_zone_on_the_straight_way_back(east_m, zones, is_cut_off):
    around = None if zones is None else Fence(tuple(zones), config.FenceTable())
    assert fence.cuts_off(around, motion(0.0, east_m), (0.0, 0.0)) is is_cut_off
