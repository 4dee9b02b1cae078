"""The fence: where the boat may be. Pure geometry in metres of the local plane; no clock, no state (docs/failsafe.md).

A clearance is the distance to the edge of a zone, positive where the boat may be, negative where it may not. Zones do not add
up to one shape: each is asked by itself, so a gap between two of them is as narrow as it is.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

from delfim import config, geodesy
from delfim.vehicle.control.path_following import arc_point
from delfim.vehicle.state import Line, Mode, Motion, Plan, Setpoint

Point = tuple[float, float]  # north_m, east_m

CHORD_RAD = math.radians(5.0)  # an arc is looked at in pieces of this angle: 0.1 % of the radius off
TURN_STEP_RAD = math.radians(15.0)
RECEDES_M = 0.01  # a boat whose clearance does not shrink by more than this goes away from a zone, or along it


class Side(NamedTuple):
    """A side of a polygon: from a point, by so much, to a point. (Start and step do not add up to the end, to the last bit.)"""

    north_m: float
    east_m: float
    by_north_m: float
    by_east_m: float
    to_north_m: float
    to_east_m: float


class Zone(NamedTuple):
    """A polygon to stay in or out of; or, without sides, a circle to stay out of."""

    name: str
    keep_in: bool
    sides: tuple[Side, ...]
    north_m: float = 0.0  # centre of the circle
    east_m: float = 0.0
    radius_m: float = 0.0


class Way(NamedTuple):
    """A straight piece of a mission, and the speed at its end."""

    name: str
    a: Point
    b: Point
    speed_mps: float


class Fence(NamedTuple):
    """All zones that are obeyed, and what the boat needs to obey them."""

    zones: tuple[Zone, ...]
    limits: config.Fence


def polygon(name: str, keep_in: bool, corners: Sequence[Point]) -> Zone:
    """A zone from the corners of a polygon, in either direction."""
    ends = [*corners[1:], corners[0]]
    return Zone(name, keep_in, tuple(Side(*a, b[0] - a[0], b[1] - a[1], *b) for a, b in zip(corners, ends, strict=True)))


def survey(limits: config.Fence, mission: config.Zones, at: geodesy.Origin | None) -> Fence | None:
    """The boat's own zones and the mission's, laid into the local plane; none yet while there is no plane. None: no fence."""
    if not (limits.keep_in or limits.keep_out or mission.keep_in or mission.keep_out):
        return None
    return Fence((*_zones("", limits, at), *_zones("mission's ", mission, at)) if at is not None else (), limits)


def _zones(whose: str, zones: config.Zones, at: geodesy.Origin) -> Iterator[Zone]:
    def plane(position: tuple[float, float]) -> Point:
        return geodesy.to_plane(at, math.radians(position[0]), math.radians(position[1]))

    if zones.keep_in:
        yield polygon(f"{whose}keep-in zone", True, [plane(corner) for corner in zones.keep_in])
    for number, zone in enumerate(zones.keep_out, 1):
        name = zone.name or f"{whose}keep-out zone {number}"
        if zone.polygon:
            yield polygon(name, False, [plane(corner) for corner in zone.polygon])
        else:
            yield Zone(name, False, (), *plane(zone.centre[0]), zone.radius_m)


def clearance_m(zone: Zone, north_m: float, east_m: float) -> float:
    """Distance of a point to the zone's edge; negative where the boat may not be."""
    if not zone.sides:
        return math.hypot(north_m - zone.north_m, east_m - zone.east_m) - zone.radius_m
    nearest, inside = math.inf, False
    for n, e, by_n, by_e, to_n, _ in zone.sides:
        off_n, off_e = north_m - n, east_m - e
        t = (off_n * by_n + off_e * by_e) / (by_n * by_n + by_e * by_e)
        t = 0.0 if t < 0.0 else 1.0 if t > 1.0 else t
        away_n, away_e = off_n - t * by_n, off_e - t * by_e
        squared = away_n * away_n + away_e * away_e
        if squared < nearest:
            nearest = squared
        # The half-line east of the point crosses this side: an odd number of crossings is inside.
        if (n > north_m) != (to_n > north_m) and off_e < by_e * off_n / by_n:
            inside = not inside
    return math.sqrt(nearest) if inside is zone.keep_in else -math.sqrt(nearest)


def least_m(zone: Zone, a: Point, b: Point) -> float:
    """Smallest clearance on the way from a to b in a straight line. Exact where it is positive; where the way leads through
    what is forbidden it is not positive.
    """
    least = min(clearance_m(zone, *a), clearance_m(zone, *b))
    by = b[0] - a[0], b[1] - a[1]
    if not zone.sides:
        return min(least, _from_segment(a, by, (zone.north_m, zone.east_m)) - zone.radius_m)
    if least <= 0.0:
        return least
    for n, e, _, _, to_n, to_e in zone.sides:
        if geodesy.segments_meet(a, b, (n, e), (to_n, to_e)):
            return 0.0
        least = min(least, _from_segment(a, by, (n, e)))
    return least


def _from_segment(a: Point, by: Point, p: Point) -> float:
    """Distance of p from the segment that begins in a and goes `by` so much."""
    off_n, off_e = p[0] - a[0], p[1] - a[1]
    length2 = by[0] * by[0] + by[1] * by[1]
    t = min(max((off_n * by[0] + off_e * by[1]) / length2, 0.0), 1.0) if length2 else 0.0
    return math.hypot(off_n - t * by[0], off_e - t * by[1])


def stopping_m(limits: config.Fence, speed_mps: float) -> float:
    """How far the boat goes on when it is told to stop."""
    return speed_mps * limits.reaction_s + speed_mps * speed_mps / (2.0 * limits.deceleration_mps2)


def ahead(fence: Fence, motion: Motion) -> str | None:
    """Why the boat must stop now, in words: on its course it could not stop `margin_m` from a zone any more. None: it could, or
    it goes away from that zone, or lies still where it may be. A boat of unknown velocity goes wherever it is worst.
    """
    limits, north_m, east_m = fence.limits, motion.north_m, motion.east_m
    known = "velocity" in motion.has
    speed_mps = math.hypot(motion.north_mps, motion.east_mps) if known else 0.0
    room_m = stopping_m(limits, speed_mps)
    reach_m = limits.margin_m + room_m
    for zone in fence.zones:
        here_m = clearance_m(zone, north_m, east_m)
        if here_m > reach_m:
            continue
        if not known:
            return f"{zone.name} {here_m:.1f} m away, velocity unknown"
        if speed_mps == 0.0:
            continue
        end = north_m + motion.north_mps * room_m / speed_mps, east_m + motion.east_mps * room_m / speed_mps
        least = least_m(zone, (north_m, east_m), end)
        if least < limits.margin_m and least < here_m - RECEDES_M:
            return f"{zone.name} {max(here_m, 0.0):.1f} m away at {speed_mps:.1f} m/s"
    return None


def outside(fence: Fence, north_m: float, east_m: float) -> str | None:
    """Where the boat is that it may not be, in words."""
    for zone in fence.zones:
        clear_m = clearance_m(zone, north_m, east_m)
        if clear_m < 0.0:
            return f"{-clear_m:.1f} m {'outside the' if zone.keep_in else 'inside'} {zone.name}"
    return None


def place_to_hold(fence: Fence, here: Point, track: Sequence[Point], radius_m: float) -> Point:
    """Where to hold so that drifting about within `radius_m` keeps the margin: here, or else at the newest place of the driven
    track, oldest first, that has this room; here again where none has.
    """
    room_m = radius_m + fence.limits.margin_m
    for point in (here, *reversed(track)):
        if all(clearance_m(zone, *point) >= room_m for zone in fence.zones):
            return point
    return here


def crossing(fence: Fence, mode: Mode, motion: Motion, setpoint: Setpoint) -> str | None:
    """What the fence has against the straight way to where a mode first goes, in words. Within the margin it may lead away."""
    waypoints = setpoint.plan.waypoints if setpoint.plan is not None else ()
    to = waypoints[setpoint.leg] if mode is Mode.PLAY else setpoint.target or waypoints[0] if mode is Mode.GOTO else None
    if to is None:
        return None
    here = motion.north_m, motion.east_m
    for zone in fence.zones:
        least = least_m(zone, here, (to.north_m, to.east_m))
        if least < fence.limits.margin_m and least < clearance_m(zone, *here) - RECEDES_M:
            return f"the way leads {_through(zone, least)}"
    return None


def complaint(fence: Fence, plan: Plan, radius_m: float) -> str | None:
    """What the fence has against a mission, in words: a leg or path nearer than `mission_margin_m`; a corner where the boat,
    whichever way it points while it turns, has less than the stopping distance and `margin_m` ahead; or a place to wait at
    without room to drift about within `radius_m`.
    """
    limits = fence.limits
    for number, to in enumerate(plan.waypoints, 1):
        for zone in fence.zones if to.hold_s else ():
            if clearance_m(zone, to.north_m, to.east_m) < radius_m + limits.margin_m:
                return f"no room to wait at waypoint {number}: {zone.name} is nearer than {radius_m + limits.margin_m:g} m"
    for ways in _ways(plan):
        for number, (text, a, b, speed_mps) in enumerate(ways):
            onwards = ways[number + 1] if number + 1 < len(ways) else ways[number]
            ends = tuple(_stops(a, b, onwards, stopping_m(limits, speed_mps)))
            for zone in fence.zones:
                least = least_m(zone, a, b)
                if least < limits.mission_margin_m:
                    return f"{text} leads {_through(zone, least)}; missions keep {limits.mission_margin_m:g} m away"
                if any(least_m(zone, b, end) < limits.margin_m for end in ends):
                    return f"{text} ends at {speed_mps:.1f} m/s without room to stop before {zone.name}"
    return None


def _stops(a: Point, b: Point, onwards: Way, room_m: float) -> Iterator[Point]:
    """Where a boat that came from a and turns in b could come to rest."""
    came_rad = math.atan2(b[1] - a[1], b[0] - a[0])
    turn_rad = geodesy.wrap(math.atan2(onwards.b[1] - onwards.a[1], onwards.b[0] - onwards.a[0]) - came_rad)
    steps = math.ceil(abs(turn_rad) / TURN_STEP_RAD)
    for step in range(steps + 1):
        heading_rad = came_rad + (turn_rad * step / steps if steps else 0.0)
        yield b[0] + room_m * math.cos(heading_rad), b[1] + room_m * math.sin(heading_rad)


def _through(zone: Zone, least: float) -> str:
    return f"{least:.1f} m past {zone.name}" if least > 0.0 else f"{'out of the' if zone.keep_in else 'through'} {zone.name}"


def _ways(plan: Plan) -> tuple[list[Way], list[Way]]:
    """The straight pieces of the waypoints to play and of the path to follow. At its last point the boat has stopped."""
    legs, pieces = [], []
    at = [(to.north_m, to.east_m) for to in plan.waypoints]
    if len(at) == 1:
        legs.append(Way("waypoint 1", at[0], at[0], 0.0))
    for number, (a, b) in enumerate(pairwise(at), 2):
        legs.append(Way(f"the leg to waypoint {number}", a, b, plan.waypoints[number - 1].speed_mps))
    for number, piece in enumerate(plan.path, 1):
        name = f"piece {number} of the path"
        if isinstance(piece, Line):
            pieces.append(Way(name, (piece.north_m, piece.east_m), (piece.to_north_m, piece.to_east_m), piece.speed_mps))
            continue
        chords = max(1, math.ceil(abs(piece.turn_rad) / CHORD_RAD))
        points = [arc_point(piece, piece.turn_rad * i / chords) for i in range(chords + 1)]
        pieces += [Way(name, a, b, piece.speed_mps) for a, b in pairwise(points)]
    for ways in (legs, pieces):
        ways[-1:] = [way._replace(speed_mps=0.0) for way in ways[-1:]]
    return legs, pieces
