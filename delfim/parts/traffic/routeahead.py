"""The route ahead in a mode, as points and a speed for the guard. Pure, and bounded in the number of points."""

import math
from collections.abc import Iterator, Sequence
from itertools import chain, islice
from typing import Final

from delfim.base.modes import OF_PARTS, Mode
from delfim.parts.traffic.encounter import Own
from delfim.parts.traffic.trialways import RouteAhead
from delfim.vehicle.control.memory import Memory, Settings
from delfim.vehicle.control.modes.path import arc_point, goal, nearest, piece_of
from delfim.vehicle.helm import setpoints
from delfim.vehicle.plans.underway import SAILS
from delfim.vehicle.plans.zones import Point
from delfim.vehicle.state import Arc, Line, Motion, Setpoint

POINTS: Final = 12
FAR_M: Final = 20_000.0  # a course leads there
TRACK: Final = 300  # points of the way home that are looked at, of which some are taken
CHORD_RAD: Final = math.radians(30.0)
LIES_MPS: Final = 0.3  # a boat that is asked for less stays where it is, and may use its cruising speed
UNDER_WAY_MPS: Final = 0.4  # below this the course over ground means nothing


def own_of(motion: Motion) -> Own:
    """The boat as the guard sees it; its course is its heading while it hardly moves."""
    speed_mps = math.hypot(motion.north_mps, motion.east_mps)
    is_under_way = speed_mps > UNDER_WAY_MPS or "heading" not in motion.has
    course_rad = math.atan2(motion.east_mps, motion.north_mps) if is_under_way else motion.heading_rad
    return Own(motion.north_m, motion.east_m, course_rad, speed_mps)


def route_ahead(mode: Mode, memory: Memory, setpoint: Setpoint, motion: Motion, settings: Settings) -> RouteAhead:
    """The route ahead. A boat that stays at a place goes back there; without a mode's own way it goes on as it does. Whatever
    is requested, it goes no faster than its file allows, or than it goes by hand."""
    own, speeds, override_mps, has_end = own_of(motion), settings.control.speed, setpoint.override_mps, True
    points, speed_mps, here = list[Point](), 0.0, (memory.north_m, memory.east_m)  # the last: where it stays, if it does
    if mode in SAILS and memory.left_s > 0.0:
        pass
    elif mode is Mode.PLAY and setpoint.plan is not None:
        ahead = list(islice(setpoint.plan.waypoints, memory.leg, memory.leg + POINTS))
        stays = next((i for i, to in enumerate(ahead) if to.hold_s > 0.0), len(ahead))
        points = [(to.north_m, to.east_m) for to in ahead[: stays + 1]]
        speed_mps = ahead[0].speed_mps if ahead else 0.0
    elif mode is Mode.PATH and setpoint.plan is not None and memory.leg < len(setpoint.plan.path):
        points, speed_mps = _along_path(memory, setpoint, motion, settings)
    elif mode is Mode.GOTO and setpoint.target is not None:
        to = (*setpoint.via[memory.leg :], setpoint.target)[:POINTS]
        points, speed_mps = [(each.north_m, each.east_m) for each in to], setpoint.target.speed_mps
    elif mode is Mode.HOME and 0 <= memory.leg < len(setpoint.track):
        driven = setpoint.track[max(memory.leg - TRACK, 0) : memory.leg + 1]
        points = [*driven[: 0 : -(len(driven) // POINTS + 1)], driven[0]]
        speed_mps = settings.control.home.speed_mps
    elif mode in (Mode.COURSE, Mode.HEADING, Mode.GREX, Mode.MANUAL) or mode in OF_PARTS:
        asked_rad = setpoint.heading_rad if mode is Mode.COURSE else own.course_rad
        points = [(own.north_m + FAR_M * math.cos(asked_rad), own.east_m + FAR_M * math.sin(asked_rad))]
        asked = {**dict.fromkeys(OF_PARTS, own.speed_mps), Mode.MANUAL: own.speed_mps, Mode.GREX: setpoint.guest_speed_mps}
        speed_mps, override_mps, has_end = asked.get(mode, setpoint.speed_mps), None, False
    if points and override_mps is not None:
        speed_mps = override_mps
    if points and speed_mps >= LIES_MPS:
        speed_mps = min(speed_mps, max(speeds.max_mps, own.speed_mps))
        return RouteAhead(tuple(points), speed_mps, has_end, is_line=mode is Mode.PATH)
    is_away = mode is not Mode.IDLE and math.dist(here, (own.north_m, own.east_m)) > 2.0 * settings.control.hold.radius_m
    place = None if points else here
    return RouteAhead((here,) if is_away and not points else (), setpoints.speed(None, speeds), has_end=False, place=place)


def _along_path(memory: Memory, setpoint: Setpoint, motion: Motion, settings: Settings) -> tuple[list[Point], float]:
    """The route onto the path at 45 degrees from beside it, then along its pieces."""
    assert setpoint.plan is not None
    path, first, leg = setpoint.plan.path, list[Point](), memory.leg
    if leg < 0:
        leg = piece_of(leg)
        first = [goal(memory, path)]
    else:
        tangent_rad, cross_m, left_m, _ = nearest(path[leg], motion, memory.swept_rad)
        if abs(cross_m) > settings.control.path.lookahead_m:
            ahead_m = min(abs(cross_m), max(left_m, 0.0))
            cos, sin = math.cos(tangent_rad), math.sin(tangent_rad)
            onto = motion.north_m + ahead_m * cos + cross_m * sin, motion.east_m + ahead_m * sin - cross_m * cos
            first.append(onto)
    ahead = path[leg : leg + POINTS]
    stays = next((i for i, piece in enumerate(ahead) if piece.hold_s > 0.0), POINTS)
    return list(islice(chain(first, _ends(ahead[: stays + 1], memory.swept_rad)), POINTS)), path[leg].speed_mps


def _ends(pieces: Sequence[Line | Arc], swept_rad: float) -> Iterator[Point]:
    """The ends of straight pieces, and of chords of arcs; `swept_rad`: of the first piece."""
    for piece in pieces:
        if isinstance(piece, Line):
            yield piece.to_north_m, piece.to_east_m
        else:
            left_rad = max(abs(piece.turn_rad) - swept_rad, 0.0)
            chords = min(max(1, math.ceil(left_rad / CHORD_RAD)), POINTS)
            for i in range(1, chords + 1):
                yield arc_point(piece, math.copysign(swept_rad + left_rad * i / chords, piece.turn_rad))
        swept_rad = 0.0
