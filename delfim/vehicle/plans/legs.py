"""Checks the legs and paths of a mission against the fence: work in slices, because either may be long."""

import math
from collections.abc import Iterator
from itertools import islice, pairwise
from typing import Final, NamedTuple

from delfim.base import geodesy
from delfim.base.cooperative import Work
from delfim.vehicle.control.modes.path import arc_point, end_of
from delfim.vehicle.plans.fence import BOXES, Fence, stopping_m, through
from delfim.vehicle.plans.zones import Box, Point, Zone, apart, box_of, circle, searched
from delfim.vehicle.state import Line, Plan

CHORD_RAD = math.radians(5.0)  # arcs are checked in chords of this angle: 0.1 % of the radius off
TURN_STEP_RAD = math.radians(15.0)


class Stretch(NamedTuple):
    """A straight piece of a mission, the speed at its end, and the box around the leg or arc that it belongs to."""

    name: str
    a: Point
    b: Point
    speed_mps: float
    around: Box


class Behind(NamedTuple):
    """How many legs, and pieces of the path, a boat has behind it."""

    legs: int
    pieces: int


NOTHING: Final = Behind(0, 0)


def complaint(fence: Fence, plan: Plan, radius_m: float, behind: Behind = NOTHING) -> Work[str | None]:
    """Why the fence forbids a mission, in words: a leg or path nearer than `mission_margin_m`; a corner where the boat,
    whichever way it points while it turns, has less than the stopping distance and `margin_m` ahead; or a place to wait at
    without room to drift about within `radius_m`. What is behind the boat is left out.
    """
    room_m = radius_m + fence.limits.margin_m
    for text, at, hold_s in _stays(plan, behind):
        for zone in fence.zones if hold_s else ():
            if (yield from searched(zone, at, at, room_m)) < room_m:
                return f"no room to wait at {text}: {zone.name} is nearer than {room_m:g} m"
        yield 1 + len(fence.zones) // BOXES if hold_s else 0
    for ways in (_legs(plan, behind.legs), _pieces(plan, behind.pieces)):
        way, around, zones = next(ways, None), None, fence.zones
        while way is not None:
            if way.around is not around:
                yield 1 + len(fence.zones) // BOXES
                around, zones = way.around, _near(fence, way)
            onwards = next(ways, None)
            why = yield from _fault(fence._replace(zones=zones), way, onwards or way)
            if why is not None:
                return why
            way = onwards
    return None


def _stays(plan: Plan, behind: Behind) -> Iterator[tuple[str, Point, float]]:
    """The waypoints and ends of pieces ahead, by name, and how long the boat stays there."""
    for number, to in islice(enumerate(plan.waypoints, 1), behind.legs, None):
        yield f"waypoint {number}", (to.north_m, to.east_m), to.hold_s
    for number, piece in islice(enumerate(plan.path, 1), behind.pieces, None):
        if piece.hold_s:
            yield f"the end of piece {number} of the path", end_of(piece), piece.hold_s


def _near(fence: Fence, way: Stretch) -> tuple[Zone, ...]:
    """The zones that the boat could come near to on a leg or an arc, and from it, by stopping."""
    limits, (south, west, north, east) = fence.limits, way.around
    room_m = max(limits.mission_margin_m, limits.margin_m + stopping_m(limits, way.speed_mps))
    return tuple(
        zone
        for zone in fence.zones
        if zone.keep_in
        or not (
            zone.box[2] < south - room_m
            or zone.box[0] > north + room_m
            or zone.box[3] < west - room_m
            or zone.box[1] > east + room_m
        )
    )


def _fault(fence: Fence, way: Stretch, onwards: Stretch) -> Work[str | None]:
    """Why the fence forbids one straight piece of a mission or the turn at its end."""
    limits, (text, a, b, speed_mps, _) = fence.limits, way
    yield 1 + len(fence.zones) // BOXES
    room_m = stopping_m(limits, speed_mps)
    ends = tuple(_stops(a, b, onwards, room_m))
    for zone in fence.zones:
        if not zone.keep_in and apart(zone.box, a, b, max(limits.mission_margin_m, limits.margin_m + room_m)):
            continue
        smallest = yield from searched(zone, a, b, limits.mission_margin_m)
        if smallest < limits.mission_margin_m:
            return f"{text} leads {through(zone, smallest)}; missions keep {limits.mission_margin_m:g} m away"
        for end in ends:
            if (yield from searched(zone, b, end, limits.margin_m)) < limits.margin_m:
                return f"{text} ends at {speed_mps:.1f} m/s without room to stop before {zone.name}"
    return None


def _stops(a: Point, b: Point, onwards: Stretch, room_m: float) -> Iterator[Point]:
    """Where a boat that came from a and turns at b could come to rest."""
    came_rad = math.atan2(b[1] - a[1], b[0] - a[0])
    turn_rad = geodesy.wrap(math.atan2(onwards.b[1] - onwards.a[1], onwards.b[0] - onwards.a[0]) - came_rad)
    steps = math.ceil(abs(turn_rad) / TURN_STEP_RAD)
    for step in range(steps + 1):
        heading_rad = came_rad + (turn_rad * step / steps if steps else 0.0)
        yield b[0] + room_m * math.cos(heading_rad), b[1] + room_m * math.sin(heading_rad)


def _legs(plan: Plan, behind: int) -> Iterator[Stretch]:
    """The straight pieces of the waypoints to play. At the last one the boat has stopped."""
    at = [(to.north_m, to.east_m) for to in plan.waypoints]
    if len(at) == 1:
        yield Stretch("waypoint 1", at[0], at[0], 0.0, box_of(at))
    for number, (a, b) in islice(enumerate(pairwise(at), 2), max(behind - 1, 0), None):
        end_mps = 0.0 if number == len(at) else plan.waypoints[number - 1].speed_mps
        yield Stretch(f"the leg to waypoint {number}", a, b, end_mps, box_of((a, b)))


def _pieces(plan: Plan, behind: int) -> Iterator[Stretch]:
    """The straight pieces of the path to follow, arcs in chords; a circle is checked only once."""
    for number, piece in islice(enumerate(plan.path, 1), behind, None):
        name = f"piece {number} of the path"
        end_mps = 0.0 if number == len(plan.path) else piece.speed_mps
        if isinstance(piece, Line):
            a, b = (piece.north_m, piece.east_m), (piece.to_north_m, piece.to_east_m)
            yield Stretch(name, a, b, end_mps, box_of((a, b)))
            continue
        around = circle("", False, (piece.north_m, piece.east_m), piece.radius_m).box
        round_rad = math.copysign(min(abs(piece.turn_rad), math.tau), piece.turn_rad)
        from_rad, chords = piece.turn_rad - round_rad, max(1, math.ceil(abs(round_rad) / CHORD_RAD))
        points = (arc_point(piece, from_rad + round_rad * i / chords) for i in range(chords + 1))
        for i, (a, b) in enumerate(pairwise(points), 1):
            yield Stretch(name, a, b, end_mps if i == chords else piece.speed_mps, around)
