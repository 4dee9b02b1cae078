"""Zones that the boat stays in or out of: plane geometry in metres, no clock, no state.

A clearance is the distance to the edge of a zone, positive where the boat may be, negative where it may not. A zone has up to
100 corners, so it is checked in parts: those that are far away cost one comparison with their box. Several areas to stay in
are one zone: the boat is in any of them, and has the clearance that the best of them gives it.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final, NamedTuple

from delfim.base import geodesy
from delfim.base.cooperative import Sliced, Work
from delfim.vehicle.plans.clearance import ClearanceField

Point = tuple[float, float]  # north_m, east_m
Box = tuple[float, float, float, float]  # south_m, west_m, north_m, east_m

Stretch = tuple[float, float]  # of a straight way, as parts of its length: 0 to 1

PART: Final = 8  # sides of a zone that share a box
LOOKS: Final = 200  # comparisons for one answer, about a microsecond each
OVERLAP: Final = 4  # areas at one point whose clearance is compared; of more, the others could only give more room
SLICE: Final = 20  # looks at a chart in one slice
ANYWHERE_M: Final = 1e8
BARE: Final = 8  # stretches of a way that no area covers; a way with more leads through forbidden water


# A side of a polygon: north and east of its start, its step and its end, in m. (Start and step do not add up to the end, to the
# last bit.) A bare tuple, which a loop takes apart in half the time.
Side = tuple[float, float, float, float, float, float]


class Facet(NamedTuple):
    """Some consecutive sides of a polygon, and the box around them."""

    box: Box
    sides: tuple[Side, ...]


class Zone(NamedTuple):
    """A polygon to stay in or out of; without sides, a circle, or the field of a chart; or several areas to stay in."""

    name: str
    keep_in: bool
    sides: tuple[Side, ...]
    box: Box  # around the zone
    north_m: float = 0.0  # centre of the circle
    east_m: float = 0.0
    radius_m: float = 0.0
    parts: tuple[Facet, ...] = ()
    areas: tuple["Zone", ...] = ()
    field: ClearanceField | None = None  # of what a chart forbids: instead of sides


def polygon(name: str, keep_in: bool, corners: Sequence[Point]) -> Zone:
    """A zone from the corners of a polygon, in either direction."""
    around = [*corners, corners[0]]
    sides = tuple((*a, b[0] - a[0], b[1] - a[1], *b) for a, b in pairwise(around))
    parts = [Facet(box_of(around[at : at + PART + 1]), sides[at : at + PART]) for at in range(0, len(sides), PART)]
    return Zone(name, keep_in, sides, box_of(corners), parts=tuple(parts))


def circle(name: str, keep_in: bool, centre: Point, radius_m: float) -> Zone:
    (n, e), r = centre, radius_m
    return Zone(name, keep_in, (), (n - r, e - r, n + r, e + r), n, e, r)


def together(name: str, areas: Sequence[Zone]) -> Zone:
    """Areas to stay in as one zone; a single one is itself."""
    if len(areas) == 1:
        return areas[0]
    around = box_of([corner for area in areas for corner in (area.box[:2], area.box[2:])])
    return Zone(name, True, (), around, areas=tuple(areas))


def charted(name: str, field: ClearanceField) -> Zone:
    """A zone to stay out of: all water that a chart forbids, and all beyond it."""
    return Zone(name, False, (), (-ANYWHERE_M, -ANYWHERE_M, ANYWHERE_M, ANYWHERE_M), field=field)


def box_of(points: Sequence[Point]) -> Box:
    norths, easts = [point[0] for point in points], [point[1] for point in points]
    return min(norths), min(easts), max(norths), max(easts)


def clearance_m(zone: Zone, north_m: float, east_m: float) -> float:
    """Distance of a point to the zone's edge; negative where the boat may not be."""
    if zone.areas:
        holding = [area for area in zone.areas if may(area, north_m, east_m)]
        inside = holding[:OVERLAP] or [min(zone.areas, key=lambda area: _box_m(area.box, north_m, east_m))]
        return max(clearance_m(area, north_m, east_m) for area in inside)
    if not zone.sides:
        if zone.field is not None:
            return zone.field.clear_m(north_m, east_m)
        away_m = math.hypot(north_m - zone.north_m, east_m - zone.east_m) - zone.radius_m
        return -away_m if zone.keep_in else away_m
    away_m = _edge_m(zone.sides, north_m, east_m)
    return away_m if may(zone, north_m, east_m) else -away_m


def cost(zone: Zone, at: Point) -> int:
    """What `clearance_m` costs here, in comparisons."""
    return (len(zone.sides) + sum(len(area.sides) for area in zone.areas if not _box_m(area.box, *at))) // 4


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
    """Whether a zone permits the boat at a point."""
    if zone.areas:
        return any(may(area, north_m, east_m) for area in zone.areas)
    if not zone.sides:
        if zone.field is not None:
            return zone.field.clear_m(north_m, east_m) >= 0.0
        return (math.hypot(north_m - zone.north_m, east_m - zone.east_m) < zone.radius_m) is zone.keep_in
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
    positive and less than `within_m`, else infinite; not positive if the way leads through forbidden water. Of several areas,
    see `searched`; a search that takes more than LOOKS is given up, which the number of comparisons shows.
    """
    if zone.areas:
        search = Sliced(_in_areas(zone, a, b, within_m))
        return (search.result, search.spent) if search.step(LOOKS) else (math.inf, LOOKS + 1)
    by = b[0] - a[0], b[1] - a[1]
    if not zone.keep_in and apart(zone.box, a, b, within_m):
        return math.inf, 0
    if not zone.sides:
        if zone.field is not None:
            return zone.field.least_m(a, b, within_m)
        centre = zone.north_m, zone.east_m
        if zone.keep_in:
            return zone.radius_m - max(math.dist(a, centre), math.dist(b, centre)), 1
        return from_segment(a, by, centre) - zone.radius_m, 1
    looked = len(zone.parts)
    if not (may(zone, *a) and may(zone, *b)):
        return min(clearance_m(zone, *a), clearance_m(zone, *b)), looked + len(zone.sides) // 2
    smallest = math.inf
    (a_n, a_e), (b_n, b_e) = a, b
    south, north = (a_n - within_m, b_n + within_m) if a_n < b_n else (b_n - within_m, a_n + within_m)
    west, east = (a_e - within_m, b_e + within_m) if a_e < b_e else (b_e - within_m, a_e + within_m)
    for part in zone.parts:
        if apart(part.box, a, b, within_m):
            continue
        looked += 2 * len(part.sides)
        near = [
            side
            for side in part.sides
            if (side[0] <= north or side[4] <= north)
            and (side[0] >= south or side[4] >= south)
            and (side[1] <= east or side[5] <= east)
            and (side[1] >= west or side[5] >= west)
        ]
        smallest = min(smallest, _edge_m(near, *a), _edge_m(near, *b))
        for n, e, _, _, to_n, to_e in near:
            if geodesy.segments_meet(a, b, (n, e), (to_n, to_e)):
                return 0.0, looked
            smallest = min(smallest, from_segment(a, by, (n, e)), from_segment(a, by, (to_n, to_e)))
    return smallest if smallest < within_m else math.inf, looked


def searched(zone: Zone, a: Point, b: Point, within_m: float) -> Work[float]:
    """`least`, in slices however many areas there are. Of several areas it is the clearance in the middle and at the ends of
    each stretch that no area covers with `within_m`: exact in whether it is less than that, which is finite."""
    if zone.areas:
        return (yield from _in_areas(zone, a, b, within_m))
    if zone.field is not None:
        return (yield from _charted(zone.field, a, b, within_m))
    smallest, looked = least(zone, a, b, within_m)
    yield looked
    return smallest


def _charted(field: ClearanceField, a: Point, b: Point, within_m: float) -> Work[float]:
    smallest, far_m = math.inf, 0.0
    while far_m < math.inf:
        clear_m, looked, far_m = field.along(a, b, within_m, far_m, SLICE)
        yield 2 * looked
        smallest = min(smallest, clear_m)
    return smallest


def _in_areas(zone: Zone, a: Point, b: Point, within_m: float) -> Work[float]:
    bare: list[Stretch] = [(0.0, 1.0)]
    for area in zone.areas if a != b else ():
        yield 1
        if not apart(area.box, a, b, 0.0):
            near = [side for part in area.parts if not apart(part.box, a, b, within_m) for side in part.sides]
            yield len(area.parts) + 2 * len(near)
            for good in _covered(area, near, a, b, within_m):
                bare = [rest for each in bare for rest in ((each[0], min(each[1], good[0])), (max(each[0], good[1]), each[1]))]
                bare = [each for each in bare if each[0] < each[1]]
            if not bare:
                return math.inf
    if len(bare) > BARE:
        return 0.0
    smallest = math.inf
    for t in {t for first, last in bare for t in (first, (first + last) / 2.0, last)}:
        at = _on_way(a, b, t)
        yield 1 + cost(zone, at)
        smallest = min(smallest, clearance_m(zone, *at))
    return smallest if smallest < within_m else math.inf


def _covered(area: Zone, near: Sequence[Side], a: Point, b: Point, room_m: float) -> Iterator[Stretch]:
    """The stretches of a way on which one area gives this much room; `near`: its sides that are not surely farther away."""
    if not area.sides:
        good = _in_disc(a, b, (area.north_m, area.east_m), area.radius_m - room_m)
        return iter([good] if good is not None else [])
    bad = sorted(each for side in near if (each := _near_side(a, b, side, room_m)) is not None)
    free, at = list[Stretch](), 0.0
    for first, last in [*bad, (1.0, 1.0)]:
        if first > at:
            free.append((at, first))
        at = max(at, last)
    return (each for each in free if may(area, *_on_way(a, b, (each[0] + each[1]) / 2.0)))  # the edge is in none of them


def _near_side(a: Point, b: Point, side: Side, room_m: float) -> Stretch | None:
    """The stretch of a way that is nearer than this to a side: a disc at each end, and a rectangle between them."""
    n, e, by_n, by_e, to_n, to_e = side
    length_m = math.hypot(by_n, by_e)
    along, across = (by_n / length_m, by_e / length_m), (-by_e / length_m, by_n / length_m)
    found = [each for end in ((n, e), (to_n, to_e)) if (each := _in_disc(a, b, end, room_m)) is not None]
    first, last = 0.0, 1.0
    for (axis_n, axis_e), least_m, most_m in ((along, 0.0, length_m), (across, -room_m, room_m)):
        start = (a[0] - n) * axis_n + (a[1] - e) * axis_e
        step = (b[0] - a[0]) * axis_n + (b[1] - a[1]) * axis_e
        if step:
            enter, leave = sorted(((least_m - start) / step, (most_m - start) / step))
            first, last = max(first, enter), min(last, leave)
        elif not least_m <= start <= most_m:
            last = -1.0
    if first < last:
        found.append((first, last))
    return (min(each[0] for each in found), max(each[1] for each in found)) if found else None


def _in_disc(a: Point, b: Point, centre: Point, radius_m: float) -> Stretch | None:
    """The stretch of a way inside a disc."""
    by_n, by_e, off_n, off_e = b[0] - a[0], b[1] - a[1], a[0] - centre[0], a[1] - centre[1]
    squared, half = by_n * by_n + by_e * by_e, by_n * off_n + by_e * off_e
    root2 = half * half - squared * (off_n * off_n + off_e * off_e - radius_m * radius_m)
    if radius_m <= 0.0 or root2 <= 0.0:
        return None
    first, last = max((-half - math.sqrt(root2)) / squared, 0.0), min((-half + math.sqrt(root2)) / squared, 1.0)
    return (first, last) if first < last else None


def _on_way(a: Point, b: Point, t: float) -> Point:
    return a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])


def _box_m(box: Box, north_m: float, east_m: float) -> float:
    """Distance of a point from a box; 0 in it."""
    south, west, north, east = box
    return math.hypot(max(south - north_m, 0.0, north_m - north), max(west - east_m, 0.0, east_m - east))


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


def from_segment(a: Point, by: Point, p: Point) -> float:
    """Distance of p from the segment that begins at a and extends by `by`."""
    off_n, off_e = p[0] - a[0], p[1] - a[1]
    length2 = by[0] * by[0] + by[1] * by[1]
    t = min(max((off_n * by[0] + off_e * by[1]) / length2, 0.0), 1.0) if length2 else 0.0
    return math.hypot(off_n - t * by[0], off_e - t * by[1])
