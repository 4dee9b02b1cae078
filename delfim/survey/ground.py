"""The plane of a survey: the area, and the water in which lines and ways may lie. Metres, x to the east and y to the north.

A union of polygons is made on a grid and then looked at part by part: without both, GEOS leaves polygons out and says nothing.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Final, NamedTuple

import shapely
from shapely.geometry import MultiPolygon, Point, Polygon, box
from shapely.geometry.base import BaseGeometry

from delfim import config
from delfim.base.errors import DelfimError, FormatError
from delfim.base.geodesy import Origin, from_plane, origin, to_plane
from delfim.survey.areafile import Ring, Shape

Place = tuple[float, float]
"""A point of the plane: east and north, m."""
Segment = tuple[Place, Place]
GRID_M: Final = 1e-3
LOST_M2: Final = 0.05  # of a part, by the grid
WIDE_M: Final = 20_000.0  # an area and its boat are in one plane, as a mission is
LEAST_M2: Final = 1.0
CORNERS_ARC: Final = 8  # of a quarter circle about a corner


class Ground(NamedTuple):
    """What is to be surveyed, and what lies in it."""

    at: Origin
    area: MultiPolygon  # without the holes
    holes: MultiPolygon


def polygons(shape: BaseGeometry) -> Iterator[Polygon]:
    """The polygons of any shape; lines and points, where two only touch, are none."""
    for part in getattr(shape, "geoms", [shape]):
        if part.geom_type == "Polygon" and not part.is_empty:
            yield part
        elif part.geom_type == "MultiPolygon":
            yield from part.geoms


def union(parts: Sequence[Polygon]) -> MultiPolygon:
    """All parts as one, none of them lost. Raises DelfimError."""
    whole = shapely.union_all(parts, grid_size=GRID_M)
    grown = whole.buffer(2.0 * GRID_M)
    shapely.prepare(grown)
    for number, part in enumerate(parts, 1):
        if not grown.covers(part) and part.difference(grown).area > LOST_M2:
            raise DelfimError(
                f"polygon {number} of {len(parts)} would be lost where it touches others: move its corners a little"
            )
    return MultiPolygon(list(polygons(whole)))


def laid(shapes: Sequence[Shape]) -> Ground:
    """The shapes of a file in the plane about their first corner. Raises FormatError, DelfimError."""
    first = next(shape.outline[0] for shape in shapes if shape.outline)
    at = origin(*map(math.radians, first))
    outlines = [_polygon(at, shape.outline, f"area {number}") for number, shape in enumerate(shapes, 1) if shape.outline]
    rings = [ring for shape in shapes for ring in shape.holes]
    holes = union([_polygon(at, ring, f"hole {number}") for number, ring in enumerate(rings, 1)])
    area = MultiPolygon(list(polygons(union(outlines).difference(holes))))
    if area.area < LEAST_M2:
        raise FormatError("nothing is left to survey: the holes fill the area, or its corners lie on one line")
    west, south, east, north = area.bounds
    if max(-west, -south, east, north) > WIDE_M:
        raise FormatError(f"an area that reaches more than {WIDE_M / 1000.0:.0f} km from its first corner")
    return Ground(at, area, holes)


def _polygon(at: Origin, ring: Ring, name: str) -> Polygon:
    places = [in_plane(at, *corner) for corner in ring]
    found = Polygon(places)
    if not found.is_valid:
        told = shapely.is_valid_reason(found).partition("[")
        try:
            there = ", ".join(f"{each:.6f}" for each in in_degrees(at, *map(float, told[2].rstrip("]").split())))
        except (TypeError, ValueError):
            there = "its corners"
        raise FormatError(f"{name} crosses or touches itself at {there}")
    return found


def in_plane(at: Origin, latitude_deg: float, longitude_deg: float) -> Place:
    north_m, east_m = to_plane(at, math.radians(latitude_deg), math.radians(longitude_deg))
    return east_m, north_m


def in_degrees(at: Origin, x: float, y: float) -> tuple[float, float]:
    latitude_rad, longitude_rad = from_plane(at, y, x)
    return math.degrees(latitude_rad), math.degrees(longitude_rad)


def water(ground: Ground, fence: config.Zones, room_m: float, around_m: float) -> BaseGeometry:
    """Where lines and ways may lie: so far around the area, so far from holes, and from the zones of the boat's fence."""
    west, south, east, north = ground.area.bounds
    free = box(west - around_m, south - around_m, east + around_m, north + around_m)
    if fence.keep_in:
        free = free.intersection(union([_zone(ground.at, zone) for zone in fence.keep_in]).buffer(-room_m, CORNERS_ARC))
    closed = [Polygon(part.exterior) for part in ground.holes.geoms] + [_zone(ground.at, zone) for zone in fence.keep_out]
    if closed:
        free = free.difference(union([each for part in closed for each in polygons(part.buffer(room_m, CORNERS_ARC))]))
    return free


def _zone(at: Origin, zone: config.Area) -> Polygon:
    if zone.polygon:
        return Polygon([in_plane(at, *corner) for corner in zone.polygon])
    return Point(in_plane(at, *zone.centre[0])).buffer(zone.radius_m, 16)


def simplified(hole: Polygon, corners: int) -> Polygon:
    """A polygon of at most so many corners that holds the hole, as a zone of a fence."""
    outline, by_m = Polygon(hole.exterior), 0.25
    found = outline
    while len(found.exterior.coords) - 1 > corners or not found.covers(outline):
        found = Polygon(outline.buffer(by_m, 2).simplify(0.9 * by_m).exterior)
        by_m *= 1.4
    return found


def swaths(lines: Iterable[Segment], wide_m: float, side: int = 0) -> BaseGeometry:
    """What lines cover, to both sides together, or to one: 1 starboard, -1 port."""
    strips = [_swath(shapely.LineString(line), wide_m, side) for line in lines]
    return union([each for strip in strips for each in polygons(strip)])


def _swath(line: BaseGeometry, wide_m: float, side: int) -> BaseGeometry:
    if side:
        return line.buffer(-side * wide_m, cap_style="flat", single_sided=True)
    return line.buffer(wide_m / 2.0, cap_style="flat")
