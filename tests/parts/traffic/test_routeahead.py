"""The way that each mode will take, point by point."""

import math
from pathlib import Path
from typing import Any, Final

import msgspec
import pytest

from delfim import config
from delfim.base.modes import Mode
from delfim.parts.traffic.encounter import Own
from delfim.parts.traffic.routeahead import own_of, route_ahead
from delfim.parts.traffic.trialways import RouteAhead
from delfim.vehicle.control.hull import filled
from delfim.vehicle.control.memory import Memory, settings_of
from delfim.vehicle.plans.zones import Point
from delfim.vehicle.state import Arc, Line, Motion, Plan, Setpoint, Waypoint

LIMITS: Final = settings_of(filled(config.load(Path(__file__).parents[3] / "etc/delfimx.toml", ())))
SPEEDS: Final = msgspec.structs.replace(LIMITS.control.speed, cruise_mps=1.3, max_mps=2.2)
HOLD, HOME = config.HoldTable(radius_m=5.0), config.HomeTable(speed_mps=1.1)
PATH: Final = msgspec.structs.replace(LIMITS.control.path, lookahead_m=8.0)
SETTINGS: Final = LIMITS._replace(
    control=msgspec.structs.replace(LIMITS.control, speed=SPEEDS, hold=HOLD, home=HOME, path=PATH)
)
ALL: Final = frozenset({"position", "heading", "velocity"})
HERE: Final = Motion(ALL, 40.0, -30.0, 2.0, 0.0, 1.2, 0.9)
STAYS: Final = RouteAhead((), 1.3, False, (43.0, -30.0))
POINTS: Final = tuple(Waypoint(100.0 * i, 7.0 * i, 1.0 + 0.05 * i, 5.0) for i in range(20))
LINES: Final = tuple(Line(100.0 * i, 0.0, 100.0 * (i + 1), 0.0, 1.0 + 0.05 * i) for i in range(20))


def ahead(mode: Mode, motion: Motion = HERE, memory: Any = None, **setpoint: Any) -> RouteAhead:
    """The boat began its leg, or stays, three metres to the north of it."""
    known = Memory(north_m=43.0, east_m=-30.0)._replace(**(memory or {}))
    return route_ahead(mode, known, Setpoint()._replace(**setpoint), motion, SETTINGS)


def plan(*path: Line | Arc, holds: dict[int, float] | None = None, points: tuple[Waypoint, ...] = POINTS) -> Plan:
    holding = holds or {}
    return Plan("round", tuple(to._replace(hold_s=holding.get(i, 0.0)) for i, to in enumerate(points)), path)


def at(*waypoints: Waypoint) -> tuple[Point, ...]:
    return tuple((to.north_m, to.east_m) for to in waypoints)


@pytest.mark.parametrize(
    ("has", "north_mps", "course_rad"),
    [(ALL, 0.4, 2.0), (ALL, -0.41, math.pi), (ALL - {"heading"}, -0.1, math.pi), (ALL, 0.0, 2.0)],
)
def test_the_course_of_a_boat_that_hardly_moves_is_its_heading(has, north_mps, course_rad):
    assert own_of(HERE._replace(has=has, north_mps=north_mps, east_mps=0.0)) == Own(40.0, -30.0, course_rad, abs(north_mps))
    assert own_of(HERE) == pytest.approx((40.0, -30.0, math.atan2(0.9, 1.2), 1.5))


@pytest.mark.parametrize(
    ("leg", "holds", "found"),
    [
        (0, {}, POINTS[:12]),
        (2, {}, POINTS[2:14]),
        (2, {1: 9.0, 4: 0.5, 6: 1.0}, POINTS[2:5]),
        (4, {4: 9.0}, POINTS[4:5]),
        (19, {}, POINTS[19:]),
    ],
)
def test_a_mission_leads_by_its_waypoints_to_the_first_one_where_it_stays(leg, holds, found):
    for left_s in (0.0, -0.2):
        there = ahead(Mode.PLAY, memory={"leg": leg, "left_s": left_s}, plan=plan(holds=holds))
        assert there == RouteAhead(at(*found), 1.0 + 0.05 * leg)


@pytest.mark.parametrize(
    ("mode", "memory", "setpoint"),
    [
        (Mode.PLAY, {"leg": 2, "left_s": 0.5}, {"plan": plan(*LINES)}),  # waits at its waypoint
        (Mode.PLAY, {"leg": 20}, {"plan": plan(*LINES)}),
        (Mode.PLAY, {}, {}),
        (Mode.PATH, {}, {}),
        (Mode.PATH, {"leg": 20}, {"plan": plan(*LINES)}),
        (Mode.GOTO, {}, {"via": POINTS, "plan": plan(*LINES)}),
        (Mode.HOME, {"leg": -1}, {"track": ((0.0, 0.0),)}),
        (Mode.HOME, {"leg": 1}, {"track": ((0.0, 0.0),)}),
        (Mode.HOLD, {}, {"target": POINTS[3], "plan": plan(*LINES), "track": ((0.0, 0.0),), "speed_mps": 1.0}),
    ],
)
def test_without_a_way_of_its_own_a_boat_goes_back_to_its_place(mode: Mode, memory: Any, setpoint: Any) -> None:
    for override_mps in (None, 2.0):
        assert ahead(mode, memory=memory, override_mps=override_mps, **setpoint) == STAYS
    edge = HERE._replace(north_m=53.0)  # twice the radius of hold
    assert ahead(mode, edge, memory, **setpoint) == STAYS
    assert ahead(mode, edge._replace(north_m=53.1), memory, **setpoint) == STAYS._replace(points=((43.0, -30.0),))
    assert ahead(Mode.IDLE, edge._replace(north_m=99.0), memory, **setpoint) == STAYS


@pytest.mark.parametrize(
    ("leg", "holds", "found"),
    [(2, {}, LINES[2:14]), (2, {1: 9.0, 4: 0.5, 6: 1.0}, LINES[2:5]), (4, {4: 9.0}, LINES[4:5]), (-3, {4: 9.0}, LINES[2:5])],
)
def test_a_path_leads_by_its_pieces_to_the_first_one_at_whose_end_it_stays(
    leg: int, holds: dict[int, float], found: tuple[Line, ...]
) -> None:
    path = tuple(piece._replace(hold_s=holds.get(i, 0.0)) for i, piece in enumerate(LINES))
    there = ahead(Mode.PATH, HERE._replace(east_m=2.0), {"leg": leg}, plan=plan(*path))
    onto = ((200.0, 0.0),) if leg < 0 else ()
    assert there == RouteAhead(
        (*onto, *((piece.to_north_m, piece.to_east_m) for piece in found)), found[0].speed_mps, is_line=True
    )


@pytest.mark.parametrize(
    ("leg", "many", "found"),
    [(0, 2, POINTS[:2]), (1, 2, POINTS[1:2]), (2, 2, ()), (0, 11, POINTS[:11]), (3, 19, POINTS[3:15]), (3, 14, POINTS[3:14])],
)
def test_goto_leads_round_zones_to_its_target(leg: int, many: int, found: tuple[Waypoint, ...]) -> None:
    target = Waypoint(900.0, 900.0, 1.7, 5.0)
    there = ahead(Mode.GOTO, memory={"leg": leg}, target=target, via=POINTS[:many])
    assert there == RouteAhead(at(*found, target)[:12], 1.7)


@pytest.mark.parametrize(
    ("leg", "found"),
    [
        (0, [0]),
        (1, [1, 0]),
        (9, [9, 8, 7, 6, 5, 4, 3, 2, 1, 0]),
        (24, [24, 21, 18, 15, 12, 9, 6, 3, 0]),
        (299, [*range(299, 0, -26), 0]),
        (700, [*range(700, 400, -26), 400]),  # no more than 300 points are looked at
    ],
)
def test_the_way_home_leads_back_along_the_track_to_its_end(leg: int, found: list[int]) -> None:
    track = tuple((float(i), 0.01 * i * i) for i in range(leg + 3))
    there = ahead(Mode.HOME, memory={"leg": leg}, track=track)
    assert there == RouteAhead(tuple(track[i] for i in found), 1.1)
    assert len(there.points) <= 13


@pytest.mark.parametrize(
    ("mode", "asked_rad", "speed_mps"),
    [(Mode.COURSE, 0.3, 0.7), (Mode.HEADING, None, 0.7), (Mode.GREX, None, 0.9), (Mode.MANUAL, None, 1.5)],
)
def test_a_course_leads_far(mode: Mode, asked_rad: float | None, speed_mps: float) -> None:
    setpoint = {"heading_rad": 0.3, "speed_mps": 0.7, "guest_speed_mps": 0.9, "override_mps": 2.0}
    course_rad = math.atan2(0.9, 1.2) if asked_rad is None else asked_rad
    (point,), *rest = ahead(mode, **setpoint)
    assert point == pytest.approx((40.0 + 20_000.0 * math.cos(course_rad), -30.0 + 20_000.0 * math.sin(course_rad)))
    assert rest == [speed_mps, False, None, False]


def test_no_faster_than_the_file_allows_or_than_it_goes_and_one_that_is_hardly_asked_to_go_lies() -> None:
    fast = HERE._replace(north_mps=0.0, east_mps=3.0)
    target, lies = POINTS[3]._replace(speed_mps=5.0), RouteAhead((), 1.3, False)
    assert ahead(Mode.GOTO, target=target).speed_mps == 2.2
    assert ahead(Mode.GOTO, fast, target=target).speed_mps == 3.0
    assert ahead(Mode.GOTO, target=target, override_mps=0.8).speed_mps == 0.8
    assert ahead(Mode.GOTO, target=target, override_mps=0.3).speed_mps == 0.3
    assert ahead(Mode.GOTO, target=target, override_mps=0.2) == lies
    assert ahead(Mode.MANUAL, HERE._replace(north_mps=0.2, east_mps=0.0), speed_mps=2.0) == lies
    assert ahead(Mode.COURSE, HERE._replace(north_m=900.0), speed_mps=0.2) == lies, "it is not called back"


def on_path(*path: Line | Arc, motion: Motion = HERE, **memory: Any) -> tuple[list[Any], float]:
    there = ahead(Mode.PATH, motion, memory, plan=plan(*path))
    assert (there.has_end, there.place) == (True, None)
    return [pytest.approx(point, abs=1e-6) for point in there.points], there.speed_mps


NORTH: Final = HERE._replace(north_m=0.0, east_m=0.0)


@pytest.mark.parametrize(
    ("leg", "found", "speed_mps"),
    [
        (-1, [(100.0 * i, 0.0) for i in range(12)], 1.0),
        (-4, [(100.0 * i, 0.0) for i in range(3, 15)], 1.15),  # it was told to begin with the fourth piece
        (0, [(100.0 * i, 0.0) for i in range(1, 13)], 1.0),
        (2, [(100.0 * i, 0.0) for i in range(3, 15)], 1.1),
        (18, [(1900.0, 0.0), (2000.0, 0.0)], 1.9),
    ],
)
def test_a_path_of_lines(leg: int, found: list[Point], speed_mps: float) -> None:
    assert on_path(*LINES, motion=NORTH, leg=leg) == (found, pytest.approx(speed_mps))


@pytest.mark.parametrize(
    ("north_m", "east_m", "onto"),
    [
        (10.0, 8.0, []),
        (10.0, 8.5, [(18.5, 0.0)]),
        (10.0, -20.0, [(30.0, 0.0)]),
        (90.0, 30.0, [(100.0, 0.0)]),  # no farther than to the end of the piece
        (120.0, 30.0, [(120.0, 0.0)]),
    ],
)
def test_from_beside_its_path_a_boat_comes_onto_it_at_45_degrees(north_m: float, east_m: float, onto: list[Point]) -> None:
    beside = NORTH._replace(north_m=north_m, east_m=east_m)
    assert on_path(*LINES[:2], motion=beside, leg=0) == ([*onto, (100.0, 0.0), (200.0, 0.0)], 1.0)
    # The same with the path to the east, and the boat on its other side
    turned = tuple(Line(0.0, each.north_m, 0.0, each.to_north_m, 1.0) for each in LINES[:2])
    beside = NORTH._replace(north_m=0.999 * east_m if abs(east_m) == 8.0 else east_m, east_m=north_m)
    assert on_path(*turned, motion=beside, leg=0)[0] == [point[::-1] for point in (*onto, (100.0, 0.0), (200.0, 0.0))]
    assert len(on_path(*LINES, motion=NORTH._replace(east_m=50.0), leg=0)[0]) == 12


def circle(*degrees: float, radius_m: float = 50.0) -> list[Point]:
    """Points by their bearings from the centre, which is in the origin."""
    return [(radius_m * math.cos(math.radians(each)), radius_m * math.sin(math.radians(each))) for each in degrees]


@pytest.mark.parametrize(
    ("turn_deg", "swept_deg", "found"),
    [
        (90.0, 0.0, [30.0, 60.0, 90.0]),
        (90.0, 45.0, [67.5, 90.0]),
        (-90.0, 0.0, [-30.0, -60.0, -90.0]),
        (-90.0, 61.0, [-90.0]),
        (100.0, 0.0, [25.0, 50.0, 75.0, 100.0]),
        (20.0, 0.0, [20.0]),
        (20.0, 21.0, [21.0]),  # past its end
        (720.0, 0.0, [60.0 * i for i in range(1, 13)]),
    ],
)
def test_an_arc_is_chords_of_30_degrees(turn_deg: float, swept_deg: float, found: list[float]) -> None:
    arc = Arc(0.0, 0.0, 50.0, 0.0, math.radians(turn_deg), 0.9)
    (north_m, east_m), side = circle(swept_deg)[0], math.copysign(1.0, turn_deg)
    there = NORTH._replace(north_m=north_m, east_m=side * east_m)
    assert on_path(arc, motion=there, leg=0, swept_rad=math.radians(swept_deg)) == (circle(*found), 0.9)
    # A later piece is sailed from its beginning; so is the first one, as long as the boat is on the way to it
    onto, whole = Line(50.0, -99.0, 50.0, 0.0, 1.0), circle(*(turn_deg * i / 3.0 for i in range(1, 4)))
    if abs(turn_deg) == 90.0:
        motion = NORTH._replace(north_m=50.0, east_m=-70.0)
        assert on_path(onto, arc, motion=motion, leg=0, swept_rad=math.radians(swept_deg))[0] == [(50.0, 0.0), *whole]
        assert on_path(arc, motion=motion, leg=-1)[0] == [(50.0, 0.0), *whole]


def test_no_more_than_a_dozen_points_of_arcs() -> None:
    arcs = [Arc(0.0, 0.0, 50.0, math.radians(140.0 * i), math.radians(140.0), 0.9) for i in range(20)]
    assert on_path(*arcs, motion=NORTH._replace(north_m=50.0), leg=0)[0] == circle(*(28.0 * i for i in range(1, 13)))
