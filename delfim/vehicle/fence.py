"""The fence: where the boat may be. Pure geometry in metres of the local plane; no clock, no state (docs/failsafe.md).

A clearance is the distance to the edge of a zone, positive where the boat may be, negative where it may not. Zones do not add
up to one shape: each is asked by itself, so a gap between two of them is as narrow as it is.

A zone has up to 100 corners, and a fence up to 202 zones. So what is asked ten times a second looks at the parts of zones that
are near, and gives up with the safe answer after LOOKS comparisons; what looks at a whole mission is work in slices.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final, NamedTuple

from delfim import config, geodesy
from delfim.modes import Mode
from delfim.slices import Work
from delfim.vehicle.control.path import arc_point
from delfim.vehicle.state import Line, Motion, Plan, Setpoint

Point = tuple[float, float]  # north_m, east_m
Box = tuple[float, float, float, float]  # south_m, west_m, north_m, east_m

LOOKS: Final = 200  # comparisons, about a microsecond each, of one question
PART: Final = 8  # sides of a zone that are looked at together
BOXES: Final = 4  # boxes that are looked at in the time of one comparison
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


class Part(NamedTuple):
    """Some sides of a polygon, one after the other, and what they lie in."""

    box: Box
    sides: tuple[Side, ...]


class Zone(NamedTuple):
    """A polygon to stay in or out of; or, without sides, a circle to stay out of."""

    name: str
    keep_in: bool
    sides: tuple[Side, ...]
    north_m: float = 0.0  # centre of the circle
    east_m: float = 0.0
    radius_m: float = 0.0
    box: Box = (-math.inf, -math.inf, math.inf, math.inf)  # that it lies in
    parts: tuple[Part, ...] = ()


class Way(NamedTuple):
    """A straight piece of a mission, the speed at its end, and what the leg or the arc that it belongs to lies in."""

    name: str
    a: Point
    b: Point
    speed_mps: float
    around: Box


class Fence(NamedTuple):
    """All zones that are obeyed, and what the boat needs to obey them."""

    zones: tuple[Zone, ...]
    limits: config.Fence
    own: int = 0  # of the zones, the first: the boat's
    is_laid: bool = True  # False: the zones are not in the plane yet


def polygon(name: str, keep_in: bool, corners: Sequence[Point]) -> Zone:
    """A zone from the corners of a polygon, in either direction."""
    ends = [*corners[1:], corners[0]]
    sides = tuple(Side(*a, b[0] - a[0], b[1] - a[1], *b) for a, b in zip(corners, ends, strict=True))
    around = [*corners, corners[0]]
    parts = [Part(_box(around[at : at + PART + 1]), sides[at : at + PART]) for at in range(0, len(sides), PART)]
    return Zone(name, keep_in, sides, box=_box(corners), parts=tuple(parts))


def circle(name: str, centre: Point, radius_m: float) -> Zone:
    """A zone to stay out of."""
    (n, e), r = centre, radius_m
    return Zone(name, False, (), n, e, r, (n - r, e - r, n + r, e + r))


def _box(points: Sequence[Point]) -> Box:
    norths, easts = [point[0] for point in points], [point[1] for point in points]
    return min(norths), min(easts), max(norths), max(easts)


def unlaid(limits: config.Fence, mission: config.Zones) -> Fence | None:
    """The fence while there is no plane to lay it into. None: there is none."""
    if not (limits.keep_in or limits.keep_out or mission.keep_in or mission.keep_out):
        return None
    return Fence((), limits, is_laid=False)


def survey(limits: config.Fence, mission: config.Zones, at: geodesy.Origin, before: Fence | None = None) -> Work[Fence | None]:
    """The boat's own zones and the mission's, laid into the local plane. None: no fence. `before`: a fence in this plane, from
    which the boat's own are taken.
    """
    if unlaid(limits, mission) is None:
        return None
    zones = list(before.zones[: before.own]) if before is not None and before.is_laid else []
    for zone in _zones("", limits, at) if not zones else ():
        yield 1 + 2 * len(zone.sides)
        zones.append(zone)
    own = len(zones)
    for zone in _zones("mission's ", mission, at):
        yield 1 + 2 * len(zone.sides)
        zones.append(zone)
    return Fence(tuple(zones), limits, own)


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
            yield circle(name, plane(zone.centre[0]), zone.radius_m)


def clearance_m(zone: Zone, north_m: float, east_m: float) -> float:
    """Distance of a point to the zone's edge; negative where the boat may not be."""
    if not zone.sides:
        return math.hypot(north_m - zone.north_m, east_m - zone.east_m) - zone.radius_m
    away_m = _edge_m(zone.sides, north_m, east_m)
    return away_m if _may(zone, north_m, east_m) else -away_m


def _edge_m(sides: Sequence[Side], north_m: float, east_m: float) -> float:
    """Distance to the nearest of some sides."""
    nearest = math.inf
    for n, e, by_n, by_e, _, _ in sides:
        off_n, off_e = north_m - n, east_m - e
        t = (off_n * by_n + off_e * by_e) / (by_n * by_n + by_e * by_e)
        t = 0.0 if t < 0.0 else 1.0 if t > 1.0 else t
        away_n, away_e = off_n - t * by_n, off_e - t * by_e
        squared = away_n * away_n + away_e * away_e
        if squared < nearest:
            nearest = squared
    return math.sqrt(nearest)


def _may(zone: Zone, north_m: float, east_m: float) -> bool:
    """Whether the boat may be there, as far as a polygon is concerned."""
    south, west, north, east = zone.box
    inside = False
    if south <= north_m <= north and west <= east_m <= east:
        for (south, _, north, east), sides in zone.parts:
            if not (south <= north_m <= north and east_m <= east):
                continue
            for n, e, by_n, by_e, to_n, _ in sides:
                # The half-line east of the point crosses this side: an odd number of crossings is inside.
                if (n > north_m) != (to_n > north_m) and east_m - e < by_e * (north_m - n) / by_n:
                    inside = not inside
    return inside is zone.keep_in


def least(zone: Zone, a: Point, b: Point, within_m: float = math.inf) -> tuple[float, int]:
    """Smallest clearance on the way from a to b in a straight line, and how many comparisons it took. Exact where it is
    positive and less than `within_m`, else infinite; not positive where the way leads through what is forbidden.
    """
    by = b[0] - a[0], b[1] - a[1]
    if not zone.keep_in and _apart(zone.box, a, b, within_m):
        return math.inf, 0
    if not zone.sides:
        return _from_segment(a, by, (zone.north_m, zone.east_m)) - zone.radius_m, 1
    looked = len(zone.parts)
    if not (_may(zone, *a) and _may(zone, *b)):
        return min(clearance_m(zone, *a), clearance_m(zone, *b)), looked + len(zone.sides) // 2
    smallest = math.inf
    for part in zone.parts:
        if _apart(part.box, a, b, within_m):
            continue
        looked += 2 * len(part.sides)
        smallest = min(smallest, _edge_m(part.sides, *a), _edge_m(part.sides, *b))
        for n, e, _, _, to_n, to_e in part.sides:
            if geodesy.segments_meet(a, b, (n, e), (to_n, to_e)):
                return 0.0, looked
            smallest = min(smallest, _from_segment(a, by, (n, e)))
        smallest = min(smallest, _from_segment(a, by, part.sides[-1][4:]))
    return smallest if smallest < within_m else math.inf, looked


def _apart(box: Box, a: Point, b: Point, room_m: float) -> bool:
    """Whether the way from a to b keeps that far away from all that lies in a box. False, at worst, where it does."""
    south, west, north, east = box
    (a_n, a_e), (b_n, b_e) = a, b
    if (a_n if a_n > b_n else b_n) < south - room_m or (a_n if a_n < b_n else b_n) > north + room_m:
        return True
    if (a_e if a_e > b_e else b_e) < west - room_m or (a_e if a_e < b_e else b_e) > east + room_m:
        return True
    by_n, by_e = b_n - a_n, b_e - a_e
    off = abs(by_n * (west + east - 2.0 * a_e) - by_e * (south + north - 2.0 * a_n))
    return off > abs(by_n) * (east - west) + abs(by_e) * (north - south) + 2.0 * room_m * math.hypot(by_n, by_e)


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
    limits, here = fence.limits, (motion.north_m, motion.east_m)
    known = "velocity" in motion.has
    speed_mps = math.hypot(motion.north_mps, motion.east_mps) if known else 0.0
    if known and speed_mps == 0.0:
        return None
    room_m = stopping_m(limits, speed_mps)
    course = (motion.north_mps / speed_mps, motion.east_mps / speed_mps) if known else (0.0, 0.0)
    end = here[0] + course[0] * room_m, here[1] + course[1] * room_m
    left = LOOKS
    for zone in fence.zones:
        smallest, looked = least(zone, here, end, limits.margin_m)
        left -= looked
        if smallest < limits.margin_m:
            here_m = clearance_m(zone, *here)
            if not known:
                return f"{zone.name} {here_m:.1f} m away, velocity unknown"
            if smallest < here_m - RECEDES_M:
                return f"{zone.name} {max(here_m, 0.0):.1f} m away at {speed_mps:.1f} m/s"
            left -= len(zone.sides) // 4
        if left < 0:
            return f"too many corners of zones near to be watched: {zone.name} is one of those"
    return None


def outside(fence: Fence, north_m: float, east_m: float) -> str | None:
    """Where the boat is that it may not be, in words."""
    left = LOOKS
    for zone in fence.zones:
        south, west, north, east = zone.box
        near = south <= north_m <= north and west <= east_m <= east
        if not near and not zone.keep_in:
            continue
        if zone.sides and _may(zone, north_m, east_m):
            left -= len(zone.parts)
            if left < 0:
                return f"in more zones than can be watched: {zone.name} is one of them"
            continue
        clear_m = clearance_m(zone, north_m, east_m)
        if clear_m < 0.0:
            return f"{-clear_m:.1f} m {'outside the' if zone.keep_in else 'inside'} {zone.name}"
    return None


def place_to_hold(fence: Fence, here: Point, track: Sequence[Point], radius_m: float) -> Work[Point]:
    """Where to hold so that drifting about within `radius_m` keeps the margin: here, or else at the newest place of the driven
    track, oldest first, that has this room; here again where none has.
    """
    for point in (here, *reversed(track)):
        has_room, looked = _has_room(fence, point, radius_m + fence.limits.margin_m)
        if has_room:
            return point
        yield 2 * looked  # one that is dear has a slice to itself
    return here


def _has_room(fence: Fence, point: Point, room_m: float) -> tuple[bool, int]:
    """Whether all zones are so far away, and how many comparisons it took. Where it takes too many, they are not."""
    looked = 0
    for number, zone in enumerate(fence.zones, 1):
        smallest, more = least(zone, point, point, room_m)
        looked += more
        if smallest < room_m or looked > LOOKS:
            return False, looked + number // BOXES + 1
    return True, looked


def crossing(fence: Fence, mode: Mode, motion: Motion, setpoint: Setpoint) -> str | None:
    """What the fence has against the straight way to where a mode first goes, in words. Within the margin it may lead away."""
    waypoints = setpoint.plan.waypoints if setpoint.plan is not None else ()
    to = waypoints[setpoint.leg] if mode is Mode.PLAY else setpoint.target if mode is Mode.GOTO else None
    if to is None:
        return None
    here, left = (motion.north_m, motion.east_m), LOOKS
    for zone in fence.zones:
        smallest, looked = least(zone, here, (to.north_m, to.east_m), fence.limits.margin_m)
        if smallest < fence.limits.margin_m and smallest < clearance_m(zone, *here) - RECEDES_M:
            return f"the way leads {_through(zone, smallest)}"
        left -= looked
        if left < 0:
            return f"the way passes too many corners of zones, {zone.name} among them: go there by shorter ways"
    return None


def complaint(fence: Fence, plan: Plan, radius_m: float) -> Work[str | None]:
    """What the fence has against a mission, in words: a leg or path nearer than `mission_margin_m`; a corner where the boat,
    whichever way it points while it turns, has less than the stopping distance and `margin_m` ahead; or a place to wait at
    without room to drift about within `radius_m`.
    """
    room_m = radius_m + fence.limits.margin_m
    for number, to in enumerate(plan.waypoints, 1):
        for zone in fence.zones if to.hold_s else ():
            smallest, looked = least(zone, (to.north_m, to.east_m), (to.north_m, to.east_m), room_m)
            if smallest < room_m:
                return f"no room to wait at waypoint {number}: {zone.name} is nearer than {room_m:g} m"
            if looked:
                yield looked
        yield 1 + len(fence.zones) // BOXES if to.hold_s else 0
    for ways in (_legs(plan), _pieces(plan)):
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


def _near(fence: Fence, way: Way) -> tuple[Zone, ...]:
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


def _fault(fence: Fence, way: Way, onwards: Way) -> Work[str | None]:
    """What the fence has against one straight piece of a mission and the turn at its end."""
    limits, (text, a, b, speed_mps, _) = fence.limits, way
    yield 1 + len(fence.zones) // BOXES
    room_m = stopping_m(limits, speed_mps)
    ends = tuple(_stops(a, b, onwards, room_m))
    for zone in fence.zones:
        if not zone.keep_in and _apart(zone.box, a, b, max(limits.mission_margin_m, limits.margin_m + room_m)):
            continue
        smallest, looked = least(zone, a, b, limits.mission_margin_m)
        if smallest < limits.mission_margin_m:
            return f"{text} leads {_through(zone, smallest)}; missions keep {limits.mission_margin_m:g} m away"
        yield looked
        for end in ends:
            smallest, looked = least(zone, b, end, limits.margin_m)
            if smallest < limits.margin_m:
                return f"{text} ends at {speed_mps:.1f} m/s without room to stop before {zone.name}"
            yield looked
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


def _legs(plan: Plan) -> Iterator[Way]:
    """The straight pieces of the waypoints to play. At the last one the boat has stopped."""
    at = [(to.north_m, to.east_m) for to in plan.waypoints]
    if len(at) == 1:
        yield Way("waypoint 1", at[0], at[0], 0.0, _box(at))
    for number, (a, b) in enumerate(pairwise(at), 2):
        end_mps = 0.0 if number == len(at) else plan.waypoints[number - 1].speed_mps
        yield Way(f"the leg to waypoint {number}", a, b, end_mps, _box((a, b)))


def _pieces(plan: Plan) -> Iterator[Way]:
    """The straight pieces of the path to follow, arcs in chords; the same circle is not gone round twice."""
    for number, piece in enumerate(plan.path, 1):
        name = f"piece {number} of the path"
        end_mps = 0.0 if number == len(plan.path) else piece.speed_mps
        if isinstance(piece, Line):
            a, b = (piece.north_m, piece.east_m), (piece.to_north_m, piece.to_east_m)
            yield Way(name, a, b, end_mps, _box((a, b)))
            continue
        around = circle("", (piece.north_m, piece.east_m), piece.radius_m).box
        round_rad = math.copysign(min(abs(piece.turn_rad), math.tau), piece.turn_rad)
        from_rad, chords = piece.turn_rad - round_rad, max(1, math.ceil(abs(round_rad) / CHORD_RAD))
        points = (arc_point(piece, from_rad + round_rad * i / chords) for i in range(chords + 1))
        for i, (a, b) in enumerate(pairwise(points), 1):
            yield Way(name, a, b, end_mps if i == chords else piece.speed_mps, around)
