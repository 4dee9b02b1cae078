"""A plan of the page as files of other programs: KML, GPX, GeoJSON, a shapefile, QGroundControl's plan, Mission Planner's list.

Places alone are in KML, GPX and shapefiles; speed, acceptance and stay are in GeoJSON, too; the lists of items have all that
MAVLink's items have. `delfim.console.plans.planfile` reads them.
"""

import io
import json
import math
import struct
import zipfile
from collections.abc import Callable, Mapping
from itertools import chain
from typing import Any, Final, NamedTuple
from xml.sax.saxutils import escape

from delfim.base.errors import FormatError
from delfim.base.input.shapefile import MAGIC
from delfim.console.link.mavlink import Item, plans
from delfim.console.plans.plan import checked_tables, items_of
from delfim.console.plans.planfile import OF_POINTS, WPL
from delfim.vehicle.plans.mission import Mission

XML: Final = '<?xml version="1.0" encoding="UTF-8"?>'
WGS_84: Final = (
    'GEOGCS["GCS_WGS_1984",DATUM["D_WGS_1984",SPHEROID["WGS_1984",6378137.0,298.257223563]],'
    'PRIMEM["Greenwich",0.0],UNIT["Degree",0.0174532925199433]]'
)
POLYLINE: Final = 3
ROVER: Final = (3, 10)  # ArduPilot's; a surface vehicle: MAV_AUTOPILOT, MAV_TYPE
CRUISE_MPS: Final = 1.0  # that QGroundControl reckons with


class Planned(NamedTuple):
    """What is written."""

    name: str
    mission: Mission
    groups: list[list[Item]]  # of mission, fence and rally points

    @property
    def places(self) -> list[tuple[float, float]]:
        """Of the waypoints: latitude and longitude, degrees."""
        return [(each.latitude_deg, each.longitude_deg) for each in self.mission.waypoint]


def written(kind: str, plan: Mapping[str, Any]) -> tuple[str, bytes]:
    """The end of the file's name, and what is in it. Raises FormatError, ConfigError for a plan that is none."""
    if kind not in WRITERS:
        raise FormatError(f"{kind!r:.20} is no kind of plan: {', '.join(WRITERS)}")
    told = Planned(str(plan.get("name", "")), checked_tables(plan), items_of(plan))
    return ".zip" if kind == ".shp" else kind, WRITERS[kind](told)


def _gpx(plan: Planned) -> bytes:
    rows = [f'<rtept lat="{at[0]:.8f}" lon="{at[1]:.8f}"><name>{n}</name></rtept>' for n, at in enumerate(plan.places, 1)]
    head = '<gpx xmlns="http://www.topografix.com/GPX/1/1" version="1.1" creator="delfim">'
    return "\n".join([XML, head, f"<rte><name>{escape(plan.name)}</name>", *rows, "</rte>", "</gpx>\n"]).encode()


def _kml(plan: Planned) -> bytes:
    def placemark(name: str, kind: str, places: list[tuple[float, float]]) -> str:
        corners = " ".join(f"{east:.8f},{north:.8f}" for north, east in places)
        return f"<Placemark><name>{escape(name)}</name><{kind}><coordinates>{corners}</coordinates></{kind}></Placemark>"

    rows = [placemark(plan.name, "LineString", plan.places)] if len(plan.places) > 1 else []
    rows += [placemark(str(n), "Point", [at]) for n, at in enumerate(plan.places, 1)]
    return "\n".join([XML, '<kml xmlns="http://www.opengis.net/kml/2.2"><Document>', *rows, "</Document></kml>\n"]).encode()


def _geojson(plan: Planned) -> bytes:
    def feature(kind: str, coordinates: Any, **says: Any) -> dict[str, Any]:
        return {"type": "Feature", "properties": says, "geometry": {"type": kind, "coordinates": coordinates}}

    def east_first(places: Any) -> list[list[float]]:
        return [[east, north] for north, east in places]

    stops = plan.mission.waypoint
    found = [feature("LineString", east_first(plan.places), name=plan.name)] if len(stops) > 1 else []
    for number, (stop, at) in enumerate(zip(stops, east_first(plan.places), strict=True), 1):
        found.append(feature("Point", at, waypoint=number, **{key: getattr(stop, key) for key in OF_POINTS}))
    for area in plan.mission.fence.keep_in:
        if area.polygon:
            ring = east_first(area.polygon)
            found.append(feature("Polygon", [[*ring, ring[0]]], fence="keep in"))
    return json.dumps({"type": "FeatureCollection", "features": found}, indent=1).encode()


def _shapefile(plan: Planned) -> bytes:
    """A line with its name, as the four files of a shapefile, in a ZIP file."""
    east, north = [each[1] for each in plan.places], [each[0] for each in plan.places]
    box = struct.pack("<4d", min(east), min(north), max(east), max(north))
    numbers = list(chain.from_iterable((each[1], each[0]) for each in plan.places))
    count = len(plan.places)
    line = struct.pack("<i", POLYLINE) + box + struct.pack("<3i", 1, count, 0) + struct.pack(f"<{2 * count}d", *numbers)

    def head(size: int) -> bytes:
        words = struct.pack(">7i", MAGIC, 0, 0, 0, 0, 0, (100 + size) // 2)
        return words + struct.pack("<2i", 1000, POLYLINE) + box + struct.pack("<4d", 0.0, 0.0, 0.0, 0.0)

    name = plan.name.encode()[:80].ljust(80)
    table = struct.pack("<4BIHH20x", 3, 110, 1, 1, 1, 65, 81) + struct.pack("<11sc4xBB14x", b"NAME", b"C", 80, 0) + b"\r "
    files = {
        "plan.shp": head(8 + len(line)) + struct.pack(">2i", 1, len(line) // 2) + line,
        "plan.shx": head(8) + struct.pack(">2i", 50, len(line) // 2),
        "plan.dbf": table + name + b"\x1a",
        "plan.prj": WGS_84.encode(),
        "plan.cpg": b"UTF-8",
    }
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as into:
        for file, data in files.items():
            into.writestr(zipfile.ZipInfo(file, (1980, 1, 1, 0, 0, 0)), data)
    return whole.getvalue()


def _degrees(item: Item) -> list[float]:
    """The last three numbers of an item: places are degrees."""
    scale = 1e7 if item.frame in plans.GLOBAL else 1.0
    return [item.x / scale, item.y / scale, item.z]


def _of_others(item: Item) -> Item:
    """An item as other programs have it: what this boat says in numbers that mean something else to them is left out."""
    return item._replace(p3=0.0, p4=0.0) if item.command == plans.WAYPOINT else item


def _items(plan: Planned) -> list[Item]:
    """Of the mission; pieces of a path are known to nobody else."""
    return [_of_others(each) for each in plan.groups[0] if each.command != plans.PATH]


def _waypoints(plan: Planned) -> bytes:
    home = plan.groups[2][0] if plan.groups[2] else None
    north, east = (home.x / 1e7, home.y / 1e7) if home is not None else plan.places[0]
    rows = [WPL, "\t".join(["0", "1", "0", "16", "0", "0", "0", "0", f"{north:.8f}", f"{east:.8f}", "0", "1"])]
    for number, item in enumerate(_items(plan), 1):
        numbers = [f"{0.0 if math.isnan(each) else each:.8f}" for each in (*item[1:5], *_degrees(item))]
        rows.append("\t".join([str(number), "0", str(item.frame), str(item.command), *numbers, "1"]))
    return ("\n".join(rows) + "\n").encode()


def _qgroundcontrol(plan: Planned) -> bytes:
    def simple(number: int, item: Item) -> dict[str, Any]:
        numbers = [None if math.isnan(each) else each for each in (*item[1:5], *_degrees(item))]
        its = {"autoContinue": True, "command": item.command, "doJumpId": number, "frame": item.frame, "params": numbers}
        return its | {"type": "SimpleItem"}

    zones = plan.mission.fence
    kinds = [(True, area) for area in zones.keep_in] + [(False, area) for area in zones.keep_out]
    polygons = [
        {"inclusion": way, "polygon": [list(at) for at in area.polygon], "version": 1} for way, area in kinds if area.polygon
    ]
    circles = [
        {"circle": {"center": list(area.centre[0]), "radius": area.radius_m}, "inclusion": way, "version": 1}
        for way, area in kinds
        if area.centre
    ]
    points = [[item.x / 1e7, item.y / 1e7, 0] for item in plan.groups[2]]
    told = {
        "fileType": "Plan",
        "groundStation": "QGroundControl",
        "version": 1,
        "mission": {
            "cruiseSpeed": CRUISE_MPS,
            "firmwareType": ROVER[0],
            "globalPlanAltitudeMode": 1,
            "hoverSpeed": CRUISE_MPS,
            "items": [simple(number, item) for number, item in enumerate(_items(plan), 1)],
            "plannedHomePosition": [*plan.places[0], 0],
            "vehicleType": ROVER[1],
            "version": 2,
        },
        "geoFence": {"circles": circles, "polygons": polygons, "version": 2},
        "rallyPoints": {"points": points, "version": 2},
    }
    return json.dumps(told, indent=1).encode()


WRITERS: Final[dict[str, Callable[[Planned], bytes]]] = {
    ".gpx": _gpx,
    ".kml": _kml,
    ".geojson": _geojson,
    ".shp": _shapefile,
    ".waypoints": _waypoints,
    ".plan": _qgroundcontrol,
}
