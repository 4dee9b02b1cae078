"""The boats in Foxglove, live (`delfim console --foxglove`): what the pages of the console show, by the topics of recordings.

foxglove-sdk serves it from threads of its own. It is for looking only, on this computer only; a client that is slow loses
messages, and the console waits for none.
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from delfim.base.errors import ConfigError
from delfim.base.modes import Mode
from delfim.logging.ashore import topics

if TYPE_CHECKING:
    from foxglove import Channel

HOST: Final = "127.0.0.1"  # whoever reaches the port sees everything
BACKLOG: Final = 256  # messages that a client may be behind
ERROR_MAX: Final = 3  # the severities of MAVLink up to here are errors, WARNING_MAX warnings
WARNING_MAX: Final = 4
AGAIN_NS: Final = 2_000_000_000  # a plan is sent so often: who connects late must see it, too
_TURN_CORNERS: Final = 36  # of a circle on the map
_M_PER_DEG: Final = 111_200.0
_MODES: Final = {mode.name.lower(): int(mode) for mode in Mode}


class FoxgloveView:
    """Takes the messages to the pages. Raises ConfigError where the package is missing or the port is taken."""

    def __init__(self, port: int) -> None:
        try:
            import foxglove
        except ImportError:
            raise ConfigError("--foxglove", str(port), "it needs: pip install 'delfim[foxglove]'") from None
        self._foxglove, self._context = foxglove, foxglove.Context()
        try:
            self._server = foxglove.start_server(
                name="Delfim", host=HOST, port=port, message_backlog_size=BACKLOG, context=self._context
            )
        except Exception as error:  # the SDK says no closer what it raises
            raise ConfigError("--foxglove", str(port), f"cannot be served: {error}") from None
        self.url = f"ws://{HOST}:{self._server.port}"
        self._channels: dict[str, Channel] = {}
        self._names: dict[int, str] = {}
        self._plans: dict[int, tuple[int, str]] = {}  # by boat: when it was sent last, and its GeoJSON

    def close(self) -> None:
        self._server.stop()

    def tell(self, message: Mapping[str, Any]) -> None:
        """A message to the pages (docs/console.md): those that show boats or text are passed on."""
        if message["t"] == "boats":
            t_ns = round(message["at_s"] * 1e9)
            for boat in message["boats"]:
                self._show(boat, t_ns)
        elif message["t"] == "vessels":
            vessels, t_ns = topics.targets(message["vessels"]), round(message["at_s"] * 1e9)
            for name in self._names.values():
                self._put(name, topics.TARGETS, vessels, t_ns)
        elif message["t"] == "text":
            name, t_ns = self._names.get(message["boat"], "console"), round(message["at_s"] * 1e9)
            level = topics.FAILURE if message["severity"] <= ERROR_MAX else topics.WARNING
            level = level if message["severity"] <= WARNING_MAX else topics.INFORMATION
            self._put(name, topics.LOG, topics.line(t_ns, name, level, message["text"]), t_ns)
        elif message["t"] == "mission":
            self._plans[message["boat"]] = 0, json.dumps(geojson(message["mission"]))

    def _show(self, boat: Mapping[str, Any], t_ns: int) -> None:
        """State and place. A boat that has not told its name yet is not shown: topics are called by it."""
        number, name = boat["id"], boat["name"]
        if name == f"boat {number}":
            return
        if self._names.get(number) != name:
            self._names[number] = name
            for of in (topics.STATE, topics.LOCATION, topics.PLAN, topics.TARGETS, topics.LOG):
                self._channel(name, of)  # offered before anything is said: a client hears from then on
        self._put(name, topics.STATE, state(boat), t_ns)
        if boat["latitude_deg"] is not None and boat["longitude_deg"] is not None:
            place = topics.location(t_ns, name, boat["latitude_deg"], boat["longitude_deg"])
            self._put(name, topics.LOCATION, place, t_ns)
        sent_ns, plan = self._plans.get(number, (0, ""))
        if plan and not 0 <= t_ns - sent_ns < AGAIN_NS:
            self._plans[number] = t_ns, plan
            self._put(name, topics.PLAN, {"geojson": plan}, t_ns)

    def _put(self, name: str, of: str, message: dict[str, Any], t_ns: int) -> None:
        self._channel(name, of).log(message, log_time=t_ns)

    def _channel(self, name: str, of: str) -> "Channel":
        topic = topics.topic(name, of)
        if topic not in self._channels:
            title, told = topics.schema(of, STATE_FIELDS)
            schema = self._foxglove.Schema(name=title, encoding="jsonschema", data=told)
            self._channels[topic] = self._foxglove.Channel(topic, schema=schema, message_encoding="json", context=self._context)
        return self._channels[topic]


STATE_FIELDS: Final = {
    name: {"type": "number", "description": words}
    for name, words in (
        ("mode", "mode number of the console's link []"),
        ("latitude", "WGS 84 [rad]"),
        ("longitude", "WGS 84 [rad]"),
        ("north_speed", "over ground [m/s]"),
        ("east_speed", "over ground [m/s]"),
        ("heading", "true [rad]"),
        ("roll", "positive to starboard [rad]"),
        ("pitch", "positive bow up [rad]"),
        ("reference_heading", "heading set point of control [rad]"),
        ("cross_track", "positive: boat to starboard of the line [m]"),
        ("distance", "to the point steered for [m]"),
        ("leg", "leg of the mission []"),
        ("port_rpm_measured", "reported [1/min]"),
        ("starboard_rpm_measured", "reported [1/min]"),
        ("voltage", "batteries [V]"),
        ("charge", "batteries, 0..1 []"),
        ("satellites", "in use []"),
        ("link_rtt", "there and back on the link [s]"),
        ("link_loss", "of the boat's messages, 0..1 []"),
        ("heard", "time since the boat's last message [s]"),
    )
}


def state(boat: Mapping[str, Any]) -> dict[str, float]:
    """What the link tells of a boat, with the names and units of its state log; what is not known is left out."""
    aims, link = boat["reference"], boat["link"]
    course_rad, speed_mps = _rad(boat["course_deg"]), boat["speed_mps"]
    port_rpm, starboard_rpm = boat["rpm"]
    told = {
        "mode": _MODES.get(boat["mode"] or ""),
        "latitude": _rad(boat["latitude_deg"]),
        "longitude": _rad(boat["longitude_deg"]),
        "north_speed": None if course_rad is None else speed_mps * math.cos(course_rad),
        "east_speed": None if course_rad is None else speed_mps * math.sin(course_rad),
        "heading": _rad(boat["heading_deg"]),
        "roll": _rad(boat["roll_deg"]),
        "pitch": _rad(boat["pitch_deg"]),
        "reference_heading": _rad(aims["heading_deg"]),
        "cross_track": aims["cross_track_m"],
        "distance": aims["distance_m"],
        "leg": aims["leg"],
        "port_rpm_measured": port_rpm,
        "starboard_rpm_measured": starboard_rpm,
        "voltage": boat["battery_v"],
        "charge": boat["battery_pct"] / 100.0 if boat["battery_pct"] is not None else None,
        "satellites": boat["satellites"],
        "link_rtt": link["rtt_ms"] / 1e3 if link["rtt_ms"] is not None else None,
        "link_loss": link["loss_pct"] / 100.0,
        "heard": boat["age_s"]["heard"],
        **{name: each["value"] for name, each in boat["measured"].items()},
    }
    return {name: value for name, value in told.items() if value is not None and math.isfinite(value)}


def _rad(angle_deg: float | None) -> float | None:
    return None if angle_deg is None else math.radians(angle_deg)


def geojson(mission: Mapping[str, Any]) -> dict[str, Any]:
    """A plan of the page (docs/console.md) for the map: its legs, waypoints, fence and the places to stay out of."""
    stops = [(each["latitude_deg"], each["longitude_deg"]) for each in mission["waypoints"]]
    found = [_feature("Point", _turned(stop), f"waypoint {number}") for number, stop in enumerate(stops, 1)]
    if len(stops) > 1:
        found.append(_feature("LineString", [_turned(stop) for stop in stops], mission.get("name") or "mission"))
    found += [_feature("Polygon", [ring], words) for words, ring in _areas(mission)]
    return {"type": "FeatureCollection", "features": found}


def _areas(mission: Mapping[str, Any]) -> Iterator[tuple[str, list[list[float]]]]:
    if mission.get("fence"):
        yield "fence", _ring(mission["fence"])
    for each in mission.get("obstacles") or ():
        yield "keep out", _circle(each["latitude_deg"], each["longitude_deg"], each["radius_m"])
    for zone in mission.get("zones") or ():
        words = zone["kind"].replace("_", " ")
        if zone.get("polygon"):
            yield words, _ring(zone["polygon"])
        else:
            latitude_deg, longitude_deg = zone["centre"][0]
            yield words, _circle(latitude_deg, longitude_deg, zone["radius_m"])


def _circle(latitude_deg: float, longitude_deg: float, radius_m: float) -> list[list[float]]:
    north_deg = radius_m / _M_PER_DEG
    east_deg = north_deg / max(math.cos(math.radians(latitude_deg)), 0.01)
    around = [math.tau * corner / _TURN_CORNERS for corner in range(_TURN_CORNERS)]
    return _ring([(latitude_deg + north_deg * math.cos(each), longitude_deg + east_deg * math.sin(each)) for each in around])


def _ring(corners: Sequence[Sequence[float]]) -> list[list[float]]:
    return [_turned(corner) for corner in (*corners, corners[0])]


def _turned(place: Sequence[float]) -> list[float]:
    """GeoJSON has the longitude first (RFC 7946)."""
    return [place[1], place[0]]


def _feature(kind: str, coordinates: object, name: str) -> dict[str, Any]:
    return {"type": "Feature", "properties": {"name": name}, "geometry": {"type": kind, "coordinates": coordinates}}


def layout(boats: Sequence[str]) -> dict[str, Any]:
    """A layout of Foxglove for these boats: map, plots of heading and speed, state, log."""
    panels: dict[str, Any] = {}

    def panel(kind: str, name: str, **settings: object) -> str:
        panels[f"{kind}!{name}"] = settings
        return f"{kind}!{name}"

    def lines(*fields: str) -> list[dict[str, Any]]:
        return [
            {"timestampMethod": "receiveTime", "value": f"{topics.topic(boat, topics.STATE)}.{field}", "enabled": True}
            for boat in boats
            for field in fields
        ]

    first = boats[0] if boats else "delfimx"
    chart = panel("map", "boats", followTopic=topics.topic(first, topics.LOCATION), zoomLevel=16)
    heading = panel("Plot", "heading", paths=lines("heading", "reference_heading"))
    speed = panel("Plot", "speed", paths=lines("north_speed", "east_speed"))
    raw = panel("RawMessages", "state", topicPath=topics.topic(first, topics.STATE))
    said = panel("RosOut", "log", topicToRender=topics.topic(first, topics.LOG))
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "layout": {
            "direction": "row",
            "first": {"direction": "column", "first": chart, "second": said, "splitPercentage": 70},
            "second": {
                "direction": "column",
                "first": {"direction": "column", "first": heading, "second": speed},
                "second": raw,
                "splitPercentage": 66,
            },
            "splitPercentage": 55,
        },
    }
