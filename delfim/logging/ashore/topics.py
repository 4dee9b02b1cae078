"""Topics and schemas by which Foxglove, Lichtblick and other readers show a boat. A recording (MCAP) and the live console
(`delfim console --foxglove`) have the same, so that one layout shows both: /BOAT/location, /BOAT/state, /BOAT/plan, /BOAT/log,
and /BOAT/targets with other vessels.
"""

import json
import math
import re
from collections.abc import Iterable, Mapping
from typing import Any, Final

_NUMBER: Final = {"type": "number"}
_TEXT: Final = {"type": "string"}
_STAMP: Final = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
LOCATION: Final = "location"
STATE: Final = "state"
PLAN: Final = "plan"
TARGETS: Final = "targets"
AHEAD_S: Final = 180.0  # of a vessel's course on the map
M_PER_DEG: Final = 111_200.0
LOG: Final = "log"
STATE_SCHEMA: Final = "delfim.State"
INFORMATION, WARNING, FAILURE = 2, 3, 4  # levels of foxglove.Log
_SCHEMAS: Final[dict[str, tuple[str, dict[str, Any]]]] = {
    LOCATION: (
        "foxglove.LocationFix",
        {"timestamp": _STAMP, "frame_id": _TEXT, "latitude": _NUMBER, "longitude": _NUMBER, "altitude": _NUMBER},
    ),
    PLAN: ("foxglove.GeoJSON", {"geojson": _TEXT}),
    TARGETS: ("foxglove.GeoJSON", {"geojson": _TEXT}),
    LOG: ("foxglove.Log", {"timestamp": _STAMP, "level": {"type": "integer"}, "message": _TEXT, "name": _TEXT}),
}


def topic(boat: str, of: str) -> str:
    """The topic of a boat: its name in small letters, with "-" for whatever is no letter or digit."""
    return f"/{re.sub(r'[^a-z0-9]+', '-', boat.lower()).strip('-') or 'boat'}/{of}"


def schema(of: str, state: Mapping[str, Mapping[str, str]] | None = None) -> tuple[str, bytes]:
    """Name and JSON schema of a topic; `state`: the properties of /state by name, which each boat has its own of."""
    name, properties = (STATE_SCHEMA, dict(state or {})) if of == STATE else _SCHEMAS[of]
    return name, json.dumps({"type": "object", "title": name, "properties": properties}).encode()


def location(t_ns: int, boat: str, latitude_deg: float, longitude_deg: float) -> dict[str, object]:
    """The message of a position for the map."""
    return {"timestamp": _stamp(t_ns), "frame_id": boat, "latitude": latitude_deg, "longitude": longitude_deg, "altitude": 0.0}


def line(t_ns: int, boat: str, level: int, words: str) -> dict[str, object]:
    """The message of a line of the log."""
    return {"timestamp": _stamp(t_ns), "level": level, "name": boat, "message": words}


def targets(vessels: Iterable[Mapping[str, Any]]) -> dict[str, object]:
    """The messages of other vessels (docs/traffic.md) for the map: each a point with its name and age, and a line to where it
    sails."""
    features = []
    for each in vessels:
        at = [each["longitude_deg"], each["latitude_deg"]]  # GeoJSON has the longitude first (RFC 7946)
        told = {key: each[key] for key in _TOLD if each.get(key) is not None}
        grave = any(near.get("danger", "none") != "none" for near in (each, *each.get("boats", ())))
        colour = "#808080" if each.get("lost") else "#b4232f" if grave else "#0d2230"
        features.append(_feature("Point", at, told | {"style": {"color": colour}}))
        if each.get("course_deg") is not None and not each.get("lost"):
            course, way_deg = math.radians(each["course_deg"]), each["speed_mps"] * AHEAD_S / M_PER_DEG
            east_deg = way_deg * math.sin(course) / max(math.cos(math.radians(at[1])), 0.01)
            line = [at, [at[0] + east_deg, at[1] + way_deg * math.cos(course)]]
            features.append(_feature("LineString", line, {"name": each["name"], "style": {"color": colour}}))
    return {"geojson": json.dumps({"type": "FeatureCollection", "features": features})}


_TOLD: Final = ("name", "kind", "speed_mps", "course_deg", "length_m", "size_known", "age_s", "lost", "cpa_m", "tcpa_s")


def _feature(kind: str, coordinates: object, properties: Mapping[str, object]) -> dict[str, object]:
    return {"type": "Feature", "properties": properties, "geometry": {"type": kind, "coordinates": coordinates}}


def _stamp(t_ns: int) -> dict[str, int]:
    return dict(zip(("sec", "nsec"), divmod(t_ns, 1_000_000_000), strict=True))
