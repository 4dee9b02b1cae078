"""Plans of other programs (KML, GPX, GeoJSON, shapefiles, QGroundControl, Mission Planner) as a plan of the page.

A file is from anybody: its size and its depth are bounded before it is understood, and a process of its own reads it:
`python -m delfim.console.plans.planfile FILE` prints the plan, or why it is refused, as JSON.
"""

import struct
import sys
from collections.abc import Callable, Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import msgspec

from delfim import config
from delfim.base.errors import FormatError
from delfim.base.input import shapefile
from delfim.base.input.bounded import printed
from delfim.base.input.elements import Elements
from delfim.base.input.geojson import geometries
from delfim.base.input.untrusted import parse_json, read_file
from delfim.console.link.mavlink import Item, plans
from delfim.console.plans.plan import page_of
from delfim.vehicle.plans.mission import Mission, Waypoint

BYTES: Final = 1 << 23
POINTS: Final = 10_000  # of a line; more than a mission has are thinned by the page
MEMORY_BYTES, CPU_S = 1 << 30, 20  # of the process that reads
WORDS: Final = 5  # items that are left out and named
PLACED: Final = 3  # MAV_FRAME_GLOBAL_RELATIVE_ALT, of an item that says none
WPL: Final = "QGC WPL 110"  # what Mission Planner's files begin with

Place = tuple[float, float]
"""Latitude and longitude, degrees."""
Found = dict[str, Any]
"""A plan of the page, and `left`: what is not in it, in words."""


def read_plan(path: str | Path) -> Found:
    """Read the plan of a file; the end of its name says which kind it is. Raises OSError, FormatError in words."""
    kind = Path(path).suffix.lower()
    if kind not in KINDS:
        raise FormatError(f"{path}: not a plan: {', '.join(KINDS)}")
    data = read_file(path, BYTES)
    try:
        found = KINDS[kind](data)
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from None
    except (AttributeError, KeyError, TypeError, ValueError, IndexError, OverflowError, struct.error):
        raise FormatError(f"{path}: a plan is not written as {kind} has it") from None
    if not (found["waypoints"] or found["fence"] or found["obstacles"] or found["zones"] or found["home"]):
        raise FormatError(f"{path}: there is no way in it: draw a line, a route or waypoints")
    return found


# Items, as MAVLink numbers them.


def _of_items(groups: tuple[list[Item], list[Item], list[Item]]) -> Found:
    """The plan of the items of mission, fence and rally points. What this boat cannot do is left out, in words."""
    mission, zones, rally = plans.MissionDraft(), plans.ZonesDraft(), plans.RallyDraft()
    drafts: tuple[plans.Draft, ...] = mission, zones, rally
    left = list[str]()
    for draft, items in zip(drafts, groups, strict=True):
        for number, item in enumerate(items, 1):
            try:
                draft.add(number, item)
            except FormatError as error:
                left.append(str(error))
    try:
        fence = zones.done()
    except FormatError as error:
        fence = config.Zones()
        left.append(str(error))
    home = [{"latitude_deg": north, "longitude_deg": east} for north, east in rally.done()[:1]]
    told = "; ".join(left[:WORDS]) + (f"; and {len(left) - WORDS} more" if len(left) > WORDS else "")
    return page_of(mission.so_far("", fence)) | {"home": home[0] if home else None, "left": told}


def _item(command: int, params: list[Any], frame: int) -> Item:
    """Of a file, where places are degrees, and what is not said stands as null. A waypoint's third and fourth number mean
    something else to other programs: they are left out."""
    told = [0.0 if each is None else float(each) for each in params]
    told += [0.0] * (7 - len(told))
    scale = 1e7 if frame in plans.GLOBAL else 1.0
    if command in (plans.WAYPOINT, plans.WAIT, plans.STAY):
        told[2] = told[3] = 0.0
    one, two, three, four, x, y, z = told[:7]
    return Item(command, one, two, three, four, round(x * scale), round(y * scale), z, frame)


def _qgroundcontrol(data: bytes) -> Found:
    """A plan of QGroundControl: its items, those that its surveys are made of, its fence and its rally points."""
    told = parse_json(data)
    mission = [
        _item(int(each["command"]), each["params"], int(each.get("frame", PLACED)))
        for item in told["mission"]["items"]
        for each in ([item] if item.get("type") == "SimpleItem" else _parts(item))
    ]
    fence, zones = told.get("geoFence") or {}, list[Item]()
    group = 0
    for each in fence.get("polygons", ()):
        corner = plans.KEEP_IN if (stays_in := each.get("inclusion", True)) else plans.KEEP_OUT
        corners = each["polygon"]
        zones += [_item(corner, [len(corners), group if stays_in else 0, 0, 0, *at[:2]], PLACED) for at in corners]
        group += stays_in
    for each in fence.get("circles", ()):
        corner = plans.CIRCLE_IN if (stays_in := each.get("inclusion", True)) else plans.CIRCLE_OUT
        numbers = [each["circle"]["radius"], group if stays_in else 0, 0, 0, *each["circle"]["center"][:2]]
        zones.append(_item(corner, numbers, PLACED))
        group += stays_in
    points = (told.get("rallyPoints") or {}).get("points", ())
    return _of_items((mission, zones, [_item(plans.HARBOUR, [0, 0, 0, 0, *at[:2]], PLACED) for at in points]))


def _parts(item: dict[str, Any]) -> Iterable[dict[str, Any]]:
    """The items that a survey, a corridor or a structure of QGroundControl stands for, where the file has them."""
    within = item.get("TransectStyleComplexItem") or {}
    return [each for each in within.get("Items", ()) if each.get("type") == "SimpleItem"]


def _waypoints(data: bytes) -> Found:
    """A list of Mission Planner's: a row for each item, the first of which is where it was planned from."""
    first, *rows = data.decode("utf-8-sig", errors="replace").splitlines()
    if first.strip() != WPL:
        raise FormatError(f"it does not begin with {WPL!r}")
    told = [row.split() for row in rows if row.strip()]
    items = [_item(int(row[3]), list(row[4:11]), int(row[2])) for row in told]
    return _of_items((items[1:] if told and told[0][0] == "0" else items, [], []))


# Lines and points.


def _of_places(lines: list[list[Place]], points: list[Place], told: dict[int, dict[str, float]] | None = None) -> Found:
    """The plan of the lines, one behind the other, or else of the points. `told`: what points say of themselves."""
    along = [place for line in lines for place in line]
    places = [each for before, each in pairwise([None, *along]) if each is not None and each != before] or points
    if len(places) > POINTS:
        raise FormatError(f"{len(places)} points: simplify it to {POINTS}")
    for latitude, longitude in places:
        if not (abs(latitude) <= 89.0 and abs(longitude) <= 180.0):  # what is not a number is neither
            raise FormatError(f"no place of the Earth that boats sail, in degrees of WGS 84: {latitude}, {longitude}")
    stops = [Waypoint(latitude_deg=north, longitude_deg=east) for north, east in places]
    rows = [msgspec.structs.replace(each, **(told or {}).get(number, {})) for number, each in enumerate(stops)]
    return page_of(Mission(version=1, name="", waypoint=tuple(rows))) | {"left": ""}


def _geojson(data: bytes) -> Found:
    """Lines; or else points, of which our own say speed, acceptance and stay; polygons are areas, and no way."""
    lines, points, told = list[list[Place]](), list[Place](), dict[int, dict[str, float]]()
    fence = list[Place]()
    for kind, places, says in geometries(data):
        if kind == "LineString":
            lines.append([(float(at[1]), float(at[0])) for at in places])
        elif kind == "Point":
            if says.get("waypoint"):
                told[len(points)] = {key: float(says.get(key, 0.0)) for key in OF_POINTS}
            points.append((float(places[1]), float(places[0])))
        elif says.get("fence"):
            fence = [(float(at[1]), float(at[0])) for at in places[0][:-1]]
    found = _of_places([], points, told) if told and len(told) == len(points) else _of_places(lines, points)
    return found | {"fence": [list(corner) for corner in fence]}


def _kml(data: bytes) -> Found:
    """Lines of Google Earth and others, or else their points."""
    lines, points, within = list[list[Place]](), list[Place](), list[str]()

    def begin(name: str, keys: dict[str, str]) -> None:
        within.append(name)

    def end(name: str, text: str) -> None:
        within.pop()
        if name == "coordinates" and within[-1:] in (["LineString"], ["Point"]):
            corners = (each.split(",") for each in text.split())
            places = [(float(corner[1]), float(corner[0])) for corner in corners]
            if within[-1] == "Point":
                points.extend(places)
            else:
                lines.append(places)

    Elements(begin, end).read(data)
    return _of_places(lines, points)


def _gpx(data: bytes) -> Found:
    """The routes; or else the tracks, or else the waypoints."""
    kinds: dict[str, list[Place]] = {"rtept": [], "trkpt": [], "wpt": []}

    def begin(name: str, keys: dict[str, str]) -> None:
        if name in kinds:
            kinds[name].append((float(keys["lat"]), float(keys["lon"])))

    Elements(begin, lambda name, text: None).read(data)
    return _of_places([kinds["rtept"] or kinds["trkpt"]], kinds["wpt"])


def _shapefile(data: bytes) -> Found:
    """The lines of a shapefile in degrees, or else its points."""
    lines, points = list[list[Place]](), list[Place]()
    for kind, parts in shapefile.records(data, shapefile.POINTS + shapefile.LINES):
        if kind in shapefile.POINTS:
            points += parts[0]
        else:
            lines += parts
    return _of_places(lines, points)


OF_POINTS: Final = ("speed_mps", "acceptance_m", "hold_s")  # what our own points say of themselves
KINDS: Final[dict[str, Callable[[bytes], Found]]] = {
    ".geojson": _geojson,
    ".json": _geojson,
    ".kml": _kml,
    ".gpx": _gpx,
    ".plan": _qgroundcontrol,
    ".waypoints": _waypoints,
    ".txt": _waypoints,
    ".shp": _shapefile,
}


if __name__ == "__main__":
    sys.exit(printed(read_plan, sys.argv[1], MEMORY_BYTES, CPU_S))
