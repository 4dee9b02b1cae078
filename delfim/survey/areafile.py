"""Areas drawn in other programs: GeoJSON, KML, GPX, the plans of QGroundControl, shapefiles. Corners in degrees come out.

A file is from anybody: its size, its depth and the number of its corners are bounded before it is understood.
`python -m delfim.survey.areafile FILE` prints its `areas`, or why it is refused, as JSON, in bounded time and memory.
"""

import math
import struct
import sys
from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.base.input import shapefile
from delfim.base.input.bounded import printed
from delfim.base.input.elements import Elements
from delfim.base.input.geojson import geometries
from delfim.base.input.untrusted import parse_json, read_file

BYTES: Final = 1 << 23
CORNERS: Final = 10_000  # of all polygons together
MEMORY_BYTES, CPU_S = 1 << 30, 20  # of the process that reads
LATITUDE_DEG: Final = 89.0
ROUND: Final = 32  # corners of a circle, which lies within them

Corner = tuple[float, float]
"""Latitude and longitude, degrees."""
Ring = list[Corner]


class Shape(NamedTuple):
    """A polygon with its holes. One without an outline is holes alone, in whatever polygons there are."""

    outline: Ring
    holes: list[Ring]


def read_area(path: str | Path) -> list[Shape]:
    """Read the polygons of a file; the end of its name says which kind it is. Raises OSError, FormatError in words."""
    kind = Path(path).suffix.lower()
    if kind not in KINDS:
        raise FormatError(f"{path}: not a file of areas: {', '.join(KINDS)}")
    data = read_file(path, BYTES)
    try:
        shapes = [Shape(_ring(outline), [_ring(hole) for hole in holes]) for outline, holes in KINDS[kind](data)]
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from None
    except (AttributeError, KeyError, TypeError, ValueError, IndexError, OverflowError, struct.error):
        raise FormatError(f"{path}: an area is not written as {kind} has it") from None
    if not any(shape.outline for shape in shapes):
        raise FormatError(f"{path}: there is no area in it: draw a polygon, or a closed route")
    if (count := sum(len(ring) for shape in shapes for ring in (shape.outline, *shape.holes))) > CORNERS:
        raise FormatError(f"{path}: {count} corners: simplify it to {CORNERS}")
    return shapes


def _ring(corners: Iterable[Any]) -> Ring:
    """The corners of a ring, each once. Raises FormatError."""
    ring = Ring()
    for latitude, longitude in corners:
        place = float(latitude), float(longitude)
        if not (abs(place[0]) <= LATITUDE_DEG and abs(place[1]) <= 180.0):  # what is not a number is neither
            raise FormatError(f"no place of the Earth that boats sail, in degrees of WGS 84: {place[0]}, {place[1]}")
        if not ring or place != ring[-1]:
            ring.append(place)
    if len(ring) > 1 and ring[0] == ring[-1]:
        ring.pop()
    if 0 < len(ring) < 3:
        raise FormatError(f"a polygon of {len(ring)} corners: it needs three")
    return ring


Found = Iterator[tuple[Iterable[Any], list[Any]]]
"""Outlines with their holes, as their file has them."""


def _geojson(data: bytes) -> Found:
    """Points and lines are nothing to survey."""
    for it in geometries(data):
        if it.kind == "Polygon":
            outline, *holes = ([(place[1], place[0]) for place in ring] for ring in it.coordinates)
            yield outline, holes


def _plan(data: bytes) -> Found:
    """QGroundControl: the areas of its surveys, or else the fences to stay in; fences to stay out of are holes."""
    told = parse_json(data)
    outlines = [item["polygon"] for item in told["mission"]["items"] if item.get("complexItemType") == "survey"]
    fence = told.get("geoFence") or {}
    fences = [(each.get("inclusion", True), each["polygon"]) for each in fence.get("polygons", ())]
    fences += [(each.get("inclusion", True), _circle(each["circle"])) for each in fence.get("circles", ())]
    for outline in outlines or [ring for stays_in, ring in fences if stays_in]:
        yield outline, []
    yield [], [ring for stays_in, ring in fences if not stays_in]


def _circle(told: dict[str, Any]) -> Ring:
    (latitude, longitude), radius_m = map(float, told["center"]), float(told["radius"])
    north_deg = radius_m / math.cos(math.pi / ROUND) / 110_570.0  # no degree is shorter
    east_deg = north_deg / max(math.cos(math.radians(latitude)), 0.01)
    turns = [math.tau * step / ROUND for step in range(ROUND)]
    return [(latitude + north_deg * math.cos(turn), longitude + east_deg * math.sin(turn)) for turn in turns]


def _kml(data: bytes) -> Found:
    """Polygons of Google Earth and others: longitude,latitude,height with spaces between corners."""
    found, within = list[tuple[Ring, list[Ring]]](), list[str]()  # elements that are open, of those that count

    def begin(name: str, keys: dict[str, str]) -> None:
        if name == "Polygon":
            found.append(([], []))
        if name in ("Polygon", "outerBoundaryIs", "innerBoundaryIs"):
            within.append(name)

    def end(name: str, text: str) -> None:
        if name == "coordinates" and within[-2:-1] == ["Polygon"]:
            corners = (each.split(",") for each in text.split())
            ring = [(float(corner[1]), float(corner[0])) for corner in corners]
            if within[-1] == "outerBoundaryIs":
                found[-1][0].extend(ring)
            else:
                found[-1][1].append(ring)
        elif within and name == within[-1]:
            within.pop()

    Elements(begin, end).read(data)
    yield from found


def _gpx(data: bytes) -> Found:
    """Each route and each piece of a track is an outline; GPX has no holes."""
    found = list[Ring]()

    def begin(name: str, keys: dict[str, str]) -> None:
        if name in ("rte", "trkseg"):
            found.append([])
        elif name in ("rtept", "trkpt"):
            found[-1].append((float(keys["lat"]), float(keys["lon"])))

    Elements(begin, lambda name, text: None).read(data)
    yield from ((ring, []) for ring in found)


def _shapefile(data: bytes) -> Found:
    """The polygons of a shapefile. Outlines go clockwise, holes the other way."""
    for _, rings in shapefile.records(data, shapefile.POLYGONS):
        yield from ((ring, []) if len(rings) == 1 or _is_clockwise(ring) else ([], [ring]) for ring in rings)


def _is_clockwise(ring: Ring) -> bool:
    return sum((to_east - east) * (to_north + north) for (north, east), (to_north, to_east) in pairwise(ring)) > 0.0


KINDS: Final[dict[str, Callable[[bytes], Found]]] = {
    ".geojson": _geojson,
    ".json": _geojson,
    ".kml": _kml,
    ".gpx": _gpx,
    ".plan": _plan,
    ".shp": _shapefile,
}

if __name__ == "__main__":
    sys.exit(printed(lambda path: {"areas": read_area(path)}, sys.argv[1], MEMORY_BYTES, CPU_S))
