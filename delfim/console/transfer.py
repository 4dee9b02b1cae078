"""Missions to a boat and back: MAVLink's mission protocol, the console's half, and what a mission is in its items.

Both directions repeat what gets no answer; a boat that says nothing for TIMEOUT_S ends the transfer with a reason. Nothing that
arrives twice or out of order does any harm.
"""

import hashlib
import json
import math
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

from delfim.console.mavlink import mavlink
from delfim.errors import FormatError

REPEAT_S: Final = 1.5
TIMEOUT_S: Final = 60.0
ITEMS_MAX: Final = 2000
WAYPOINTS, FENCE, HOME = 0, 1, 2  # MAV_MISSION_TYPE
ORDER: Final = (FENCE, HOME, WAYPOINTS)  # a mission that a new fence cuts is forgotten aboard: it comes after
OWN_SPEED: Final = -2.0  # the boat's
PIECE: Final = ("turn_deg", "radius_m", "speed_mps")  # what an item says of a piece of the path


class Item(NamedTuple):
    """An item of a mission. `words`: its four parameters; x, y: latitude and longitude in 1e-7 degrees."""

    command: int
    words: tuple[float, float, float, float]
    x: int = 0
    y: int = 0
    z: float = 0.0


def item_in(m: Any) -> Item:
    """Of a MISSION_ITEM_INT. A number that is not finite stands for "as usual", which is 0 here."""
    one, two, three, four, z = (each if math.isfinite(each) else 0.0 for each in (m.param1, m.param2, m.param3, m.param4, m.z))
    return Item(m.command, (one, two, three, four), m.x, m.y, z)


def items_of(mission: dict[str, Any]) -> list[list[Item]]:
    """The items of a mission of the page (docs/console.md), for each type: waypoints, fence and obstacles, home. Raises
    FormatError."""
    try:
        return [_waypoints(mission), _zones(mission), _home(mission)]
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(f"no mission: {error}") from None


def mission_of(name: str, items: Sequence[Sequence[Item]]) -> dict[str, Any]:
    """The inverse."""
    waypoints: list[dict[str, Any]] = []
    speed_mps = 0.0
    for item in items[WAYPOINTS]:
        if item.command == mavlink.MAV_CMD_DO_CHANGE_SPEED:
            speed_mps = max(item.words[1], 0.0)
        elif item.command == mavlink.MAV_CMD_NAV_WAYPOINT:
            place = {"latitude_deg": item.x / 1e7, "longitude_deg": item.y / 1e7}
            waypoints.append(
                place | {"speed_mps": speed_mps, "acceptance_m": item.words[1], "hold_s": item.words[0], "turn": None}
            )
    path = [
        {"latitude_deg": i.x / 1e7, "longitude_deg": i.y / 1e7} | dict(zip(PIECE, i.words, strict=False))
        for i in items[WAYPOINTS]
        if i.command == mavlink.MAV_CMD_WAYPOINT_USER_1
    ]
    fence = [(i.x / 1e7, i.y / 1e7) for i in items[FENCE] if i.command == mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION]
    obstacles = [
        {"latitude_deg": i.x / 1e7, "longitude_deg": i.y / 1e7, "radius_m": i.words[0]}
        for i in items[FENCE]
        if i.command == mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION
    ]
    home = [{"latitude_deg": i.x / 1e7, "longitude_deg": i.y / 1e7} for i in items[HOME]]
    zones = {"fence": fence, "obstacles": obstacles, "home": home[0] if home else None}
    return with_digest({"name": name, "waypoints": waypoints, "path": path} | zones)


def with_digest(mission: dict[str, Any]) -> dict[str, Any]:
    """A mission that is kept: it is compared often, and a long one takes 30 ms."""
    return mission | {"digest": digest(mission)}


def digest(mission: dict[str, Any]) -> str:
    """A name of what a mission says, its title apart."""
    said = [[(i.command, *(round(w, 3) for w in i.words), i.x, i.y) for i in group] for group in items_of(mission)]
    return hashlib.sha256(json.dumps(said).encode()).hexdigest()[:12]


def item_of(mission: dict[str, Any], waypoint: int) -> int:
    """The number of a waypoint's item, from 0. Raises FormatError where there is no such waypoint."""
    places = _places(mission)
    if not 0 <= waypoint < len(places):
        raise FormatError(f"no waypoint {waypoint}: the mission has {len(places)}")
    return places[waypoint]


def waypoint_of(mission: dict[str, Any], item: int) -> int:
    """The waypoint that an item is or belongs to, from 0; a change of speed belongs to the waypoint behind it."""
    return sum(place < item for place in _places(mission))


def _places(mission: dict[str, Any]) -> list[int]:
    return [n for n, item in enumerate(_waypoints(mission)) if item.command == mavlink.MAV_CMD_NAV_WAYPOINT]


def _waypoints(mission: dict[str, Any]) -> list[Item]:
    items, speed_mps = [], 0.0
    for each in mission["waypoints"]:
        wanted_mps = float(each.get("speed_mps") or 0.0)
        if wanted_mps != speed_mps:  # holds from here on
            speed_mps = wanted_mps
            items.append(Item(mavlink.MAV_CMD_DO_CHANGE_SPEED, (1.0, speed_mps or OWN_SPEED, -1.0, 0.0)))
        words = (float(each.get("hold_s") or 0.0), float(each.get("acceptance_m") or 0.0), 0.0, 0.0)
        items.append(Item(mavlink.MAV_CMD_NAV_WAYPOINT, words, *_place(each)))
    for piece in mission.get("path") or []:
        one, two, three = (float(piece.get(key) or 0.0) for key in PIECE)
        items.append(Item(mavlink.MAV_CMD_WAYPOINT_USER_1, (one, two, three, 0.0), *_place(piece)))
    return items


def _zones(mission: dict[str, Any]) -> list[Item]:
    corners = mission.get("fence") or []
    items = [
        Item(
            mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
            (float(len(corners)), 0.0, 0.0, 0.0),
            round(latitude_deg * 1e7),
            round(longitude_deg * 1e7),
        )
        for latitude_deg, longitude_deg in corners
    ]
    circle = mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION
    items += [Item(circle, (float(each["radius_m"]), 0.0, 0.0, 0.0), *_place(each)) for each in mission.get("obstacles") or []]
    return items


def _home(mission: dict[str, Any]) -> list[Item]:
    home = mission.get("home")
    return [Item(mavlink.MAV_CMD_NAV_RALLY_POINT, (0.0, 0.0, 0.0, 0.0), *_place(home))] if home else []


def _place(where: dict[str, Any]) -> tuple[int, int]:
    latitude, longitude = round(where["latitude_deg"] * 1e7), round(where["longitude_deg"] * 1e7)
    if not (abs(latitude) <= 890_000_000 and abs(longitude) <= 1_800_000_000):
        raise ValueError(f"{where['latitude_deg']}, {where['longitude_deg']} is nowhere")
    return latitude, longitude


Ended = Callable[[str], None]  # with the reason, empty when all went well


class Upload:
    """Items of one type to one boat."""

    def __init__(self, boat: int, kind: int, items: Sequence[Item], send: Callable[[Any], None], ended: Ended) -> None:
        self.boat, self.kind = boat, kind
        self.part = 0.0  # of it done, 0..1
        self._items, self._send, self._ended = items, send, ended
        self._asked_for = -1
        self._heard_s: float | None = None
        self._due_s = 0.0

    def tick(self, now_s: float) -> None:
        """Announce, or repeat what was not answered."""
        if self._heard_s is None:
            self._heard_s = now_s
        if now_s - self._heard_s > TIMEOUT_S:
            self._ended("no answer from the boat")
        elif now_s >= self._due_s:
            self._say(now_s)

    def receive(self, message: Any, now_s: float) -> None:
        """MISSION_REQUEST, MISSION_REQUEST_INT or MISSION_ACK of this boat and type."""
        self._heard_s = now_s
        if message.get_type() == "MISSION_ACK":
            well = message.type == mavlink.MAV_MISSION_ACCEPTED
            if well and self._asked_for < len(self._items) - 1:
                return  # it was overtaken: of an upload before this one
            self._ended("" if well else f"refused: {_result(message.type)}")
        elif 0 <= message.seq < len(self._items):
            self._asked_for = message.seq
            self.part = message.seq / len(self._items)
            self._say(now_s)

    def _say(self, now_s: float) -> None:
        self._due_s = now_s + REPEAT_S
        component = mavlink.MAV_COMP_ID_AUTOPILOT1
        if self._asked_for < 0:
            self._send(mavlink.MAVLink_mission_count_message(self.boat, component, len(self._items), self.kind))
            return
        n, item = self._asked_for, self._items[self._asked_for]
        frame = mavlink.MAV_FRAME_GLOBAL_INT
        words = (self.boat, component, n, frame, item.command, int(n == 0), 1, *item.words, item.x, item.y, item.z, self.kind)
        self._send(mavlink.MAVLink_mission_item_int_message(*words))


class Download:
    """Items of one type from one boat: `items` when it has ended well."""

    def __init__(self, boat: int, kind: int, send: Callable[[Any], None], ended: Ended) -> None:
        self.boat, self.kind = boat, kind
        self.items: list[Item] = []
        self.part = 0.0
        self._send, self._ended = send, ended
        self._count = -1
        self._heard_s: float | None = None
        self._due_s = 0.0

    def tick(self, now_s: float) -> None:
        if self._heard_s is None:
            self._heard_s = now_s
        if now_s - self._heard_s > TIMEOUT_S:
            self._ended("no answer from the boat")
        elif now_s >= self._due_s:
            self._ask(now_s)

    def receive(self, message: Any, now_s: float) -> None:
        """MISSION_COUNT, MISSION_ITEM_INT or MISSION_ACK of this boat and type."""
        self._heard_s = now_s
        kind = message.get_type()
        if kind == "MISSION_ACK":
            if message.type != mavlink.MAV_MISSION_ACCEPTED:  # which is of an upload, and was overtaken
                self._ended(f"refused: {_result(message.type)}")
        elif kind == "MISSION_COUNT" and self._count < 0:
            if message.count > ITEMS_MAX:
                self._ended(f"{message.count} items are more than {ITEMS_MAX}")
                return
            self._count = message.count
            self._go_on(now_s)
        elif kind == "MISSION_ITEM_INT" and message.seq == len(self.items) < self._count:
            self.items.append(item_in(message))
            self.part = len(self.items) / self._count
            self._go_on(now_s)

    def _go_on(self, now_s: float) -> None:
        if len(self.items) < self._count:
            self._ask(now_s)
            return
        component = mavlink.MAV_COMP_ID_AUTOPILOT1
        self._send(mavlink.MAVLink_mission_ack_message(self.boat, component, mavlink.MAV_MISSION_ACCEPTED, self.kind))
        self._ended("")

    def _ask(self, now_s: float) -> None:
        self._due_s = now_s + REPEAT_S
        component = mavlink.MAV_COMP_ID_AUTOPILOT1
        if self._count < 0:
            self._send(mavlink.MAVLink_mission_request_list_message(self.boat, component, self.kind))
        else:
            self._send(mavlink.MAVLink_mission_request_int_message(self.boat, component, len(self.items), self.kind))


def _result(number: int) -> str:
    entry = mavlink.enums["MAV_MISSION_RESULT"].get(number)
    return entry.name.removeprefix("MAV_MISSION_").lower().replace("_", " ") if entry else f"result {number}"
