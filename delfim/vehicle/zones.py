"""Zones that the boat stays in or out of: plane geometry in metres, no clock, no state.

A clearance is the distance to the edge of a zone, positive where the boat may be, negative where it may not. A zone has up to
100 corners, so it is checked in parts: those that are far away cost one comparison with their box.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from delfim import geodesy

Point = tuple[float, float]  # north_m, east_m
Box = tuple[float, float, float, float]  # south_m, west_m, north_m, east_m

PART: Final = 8  # sides of a zone that share a box


class Side(NamedTuple):
    """A side of a polygon: start, step and end. (Start and step do not add up to the end, to the last bit.)"""

    north_m: float
    east_m: float
    by_north_m: float
    by_east_m: float
    to_north_m: float
    to_east_m: float


class Part(NamedTuple):
    """Some consecutive sides of a polygon, and the box around them."""

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
    box: Box = (-math.inf, -math.inf, math.inf, math.inf)  # around the zone
    parts: tuple[Part, ...] = ()


def polygon(name: str, keep_in: bool, corners: Sequence[Point]) -> Zone:
    """A zone from the corners of a polygon, in either direction."""
    ends = [*corners[1:], corners[0]]
    sides = tuple(Side(*a, b[0] - a[0], b[1] - a[1], *b) for a, b in zip(corners, ends, strict=True))
    around = [*corners, corners[0]]
    parts = [Part(box_of(around[at : at + PART + 1]), sides[at : at + PART]) for at in range(0, len(sides), PART)]
    return Zone(name, keep_in, sides, box=box_of(corners), parts=tuple(parts))


def circle(name: str, centre: Point, radius_m: float) -> Zone:
    """A zone to stay out of."""
    (n, e), r = centre, radius_m
    return Zone(name, False, (), n, e, r, (n - r, e - r, n + r, e + r))


def box_of(points: Sequence[Point]) -> Box:
    norths, easts = [point[0] for point in points], [point[1] for point in points]
    return min(norths), min(easts), max(norths), max(easts)


def clearance_m(zone: Zone, north_m: float, east_m: float) -> float:
    """Distance of a point to the zone's edge; negative where the boat may not be."""
    if not zone.sides:
        return math.hypot(north_m - zone.north_m, east_m - zone.east_m) - zone.radius_m
    away_m = _edge_m(zone.sides, north_m, east_m)
    return away_m if may(zone, north_m, east_m) else -away_m


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


def may(zone: Zone, north_m: float, east_m: float) -> bool:
    """Whether a polygon permits the boat at a point."""
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
    """Smallest clearance on the way from a to b in a straight line, and how many comparisons it took. Exact if it is
    positive and less than `within_m`, else infinite; not positive if the way leads through forbidden water.
    """
    by = b[0] - a[0], b[1] - a[1]
    if not zone.keep_in and apart(zone.box, a, b, within_m):
        return math.inf, 0
    if not zone.sides:
        return _from_segment(a, by, (zone.north_m, zone.east_m)) - zone.radius_m, 1
    looked = len(zone.parts)
    if not (may(zone, *a) and may(zone, *b)):
        return min(clearance_m(zone, *a), clearance_m(zone, *b)), looked + len(zone.sides) // 2
    smallest = math.inf
    for part in zone.parts:
        if apart(part.box, a, b, within_m):
            continue
        looked += 2 * len(part.sides)
        smallest = min(smallest, _edge_m(part.sides, *a), _edge_m(part.sides, *b))
        for n, e, _, _, to_n, to_e in part.sides:
            if geodesy.segments_meet(a, b, (n, e), (to_n, to_e)):
                return 0.0, looked
            smallest = min(smallest, _from_segment(a, by, (n, e)))
        smallest = min(smallest, _from_segment(a, by, part.sides[-1][4:]))
    return smallest if smallest < within_m else math.inf, looked


def apart(box: Box, a: Point, b: Point, room_m: float) -> bool:
    """Whether the way from a to b surely keeps this far from everything in a box; False where that is uncertain."""
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
    """Distance of p from the segment that begins at a and extends by `by`."""
    off_n, off_e = p[0] - a[0], p[1] - a[1]
    length2 = by[0] * by[0] + by[1] * by[1]
    t = min(max((off_n * by[0] + off_e * by[1]) / length2, 0.0), 1.0) if length2 else 0.0
    return math.hypot(off_n - t * by[0], off_e - t * by[1])
