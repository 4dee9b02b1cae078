"""Missions, fences and harbours as MAVLink's items, and back: pure functions, for both ends of the link.

A mission is the same at both ends when the checksum of its items is: MISSION_CHECKSUM tells it. An item that cannot be
translated is refused by its number, never left out in silence.
"""

import math
import struct
import zlib
from bisect import bisect_left
from collections import deque
from collections.abc import Iterable, Iterator
from typing import Final, Literal, NamedTuple, TypeVar

import msgspec

from delfim import config
from delfim.base import tables
from delfim.base.cooperative import Work
from delfim.base.errors import ConfigError, FormatError
from delfim.parts.mavlink.codec.wire import dialect
from delfim.vehicle.plans.mission import (
    CARRIED,
    HOLD_MAX_S,
    LINES_MAX,
    ROWS,
    TRIES_MAX,
    Mission,
    Number,
    PathPoint,
    PayloadItem,
    Waypoint,
)

MISSION, FENCE, RALLY, ALL = 0, 1, 2, 255  # MAV_MISSION_TYPE
ITEMS: Final = 2000  # of a plan, at most
HARBOURS: Final = 100
BLOCK_BYTES, BLOCK = 8192, 50  # summed up at a time, and their cost in comparisons
ITEM: Final = 4  # the cost of one item, in comparisons
WAYPOINT: Final = int(dialect.MAV_CMD_NAV_WAYPOINT)
WAIT: Final = int(dialect.MAV_CMD_NAV_LOITER_TIME)  # another item for a waypoint to wait at
STAY: Final = int(dialect.MAV_CMD_NAV_LOITER_UNLIM)
HOME: Final = int(dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH)
DELAY: Final = int(dialect.MAV_CMD_NAV_DELAY)  # wait where the boat is
SPEED: Final = int(dialect.MAV_CMD_DO_CHANGE_SPEED)
PATH: Final = int(dialect.MAV_CMD_WAYPOINT_USER_1)  # a piece of the path: turn_deg, radius_m, speed_mps, line; z: hold_s
KEEP_IN: Final = int(dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION)
KEEP_OUT: Final = int(dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION)
CIRCLE_IN: Final = int(dialect.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION)
CIRCLE_OUT: Final = int(dialect.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION)
HARBOUR: Final = int(dialect.MAV_CMD_NAV_RALLY_POINT)
GLOBAL: Final = frozenset({0, 3, 5, 6, 10, 11})  # frames with latitude and longitude; a boat ignores the height
PLACED: Final = int(dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)  # frame of items that no console sent: every program knows it
USUAL_SPEED: Final = -2.0  # of SPEED: the vehicle's own
_CHECKED: Final = struct.Struct("<BHB4fiif")

T = TypeVar("T", bound=tables.Table)


class Unsupported(FormatError):
    """A valid item that this boat cannot do."""


class Item(NamedTuple):
    """One item, without its number. Positions are 1e-7 degrees."""

    command: int
    p1: float = 0.0
    p2: float = 0.0
    p3: float = 0.0
    p4: float = 0.0
    x: int = 0  # latitude
    y: int = 0  # longitude
    z: float = 0.0
    frame: int = PLACED


def mission_items(tables: Mission) -> Iterator[Item]:
    """Waypoints, with a change of speed before those that have another one, and the actions between them; the way home, if it
    ends the mission; then the pieces of the path, if any, and the actions between them."""
    speed_mps, actions = 0.0, deque(each for each in tables.action if each.after is not None)
    for number, waypoint in enumerate(tables.waypoint):
        while actions and (actions[0].after or 0) <= number:
            yield _carried(actions.popleft())
        if waypoint.speed_mps != speed_mps:
            speed_mps = waypoint.speed_mps
            yield Item(SPEED, 1.0, speed_mps or USUAL_SPEED, -1.0, frame=int(dialect.MAV_FRAME_MISSION))
        place = _e7(waypoint.latitude_deg), _e7(waypoint.longitude_deg)
        yield Item(WAYPOINT, waypoint.hold_s, waypoint.acceptance_m, float(waypoint.line), float(waypoint.tries), *place)
    yield from map(_carried, actions)
    if tables.then == "home":
        yield Item(HOME, frame=int(dialect.MAV_FRAME_MISSION))
    actions = deque(each for each in tables.action if each.after_piece is not None)
    for number, piece in enumerate(tables.path):
        place = _e7(piece.latitude_deg), _e7(piece.longitude_deg)
        yield Item(PATH, piece.turn_deg, piece.radius_m, piece.speed_mps, float(piece.line), *place, piece.hold_s)
        while actions and (actions[0].after_piece or 0) <= number:
            yield _carried(actions.popleft())


def _carried(action: PayloadItem) -> Item:
    one, two, three, four, z = (math.nan if isinstance(each, str) else each for each in (*action.params, action.z))
    return Item(action.command, one, two, three, four, action.x, action.y, z, action.frame)


def places(waypoints: Iterable[tuple[float, int]]) -> Iterator[int]:
    """The numbers of the waypoint items, derived from the waypoints' speeds and the number of actions before each."""
    number, before_mps = 0, 0.0
    for speed_mps, actions in waypoints:
        number += actions + (speed_mps != before_mps)
        yield number
        number, before_mps = number + 1, speed_mps


def fence_items(zones: config.Zones) -> Iterator[Item]:
    """Each area to stay in is an inclusion group by itself: the boat must be in one of them."""
    kinds = (zones.keep_in, KEEP_IN, CIRCLE_IN), (zones.keep_out, KEEP_OUT, CIRCLE_OUT)
    for areas, corner, circle in kinds:
        for number, area in enumerate(areas):
            group = float(number) if corner == KEEP_IN else 0.0
            for at in area.polygon:
                yield Item(corner, float(len(area.polygon)), group, x=_e7(at[0]), y=_e7(at[1]))
            for at in area.centre:
                yield Item(circle, area.radius_m, group, x=_e7(at[0]), y=_e7(at[1]))


def rally_items(points: Iterable[tuple[float, float]]) -> Iterator[Item]:
    return (Item(HARBOUR, x=_e7(latitude_deg), y=_e7(longitude_deg)) for latitude_deg, longitude_deg in points)


def home_item(latitude_rad: float, longitude_rad: float) -> Item:
    return Item(WAYPOINT, x=_e7(math.degrees(latitude_rad)), y=_e7(math.degrees(longitude_rad)))


class MissionDraft:
    """A mission, item by item as they come. A bad item is refused at once, before the next is requested: FormatError with its
    number, or Unsupported for a valid item that this boat cannot do."""

    def __init__(self) -> None:
        self.waypoints: list[Waypoint] = []
        self.path: list[PathPoint] = []
        self.actions: list[PayloadItem] = []
        self.then: Literal["hold", "home"] = "hold"
        self._speed_mps = 0.0
        self._stays = False  # at the last waypoint, for ever

    def add(self, number: int, item: Item) -> None:
        if self.then == "home" and item.command not in (SPEED, PATH) and not self.path:
            raise FormatError(f"item {number}: the mission ends with NAV_RETURN_TO_LAUNCH before it")
        if item.command == SPEED:
            self._speed_mps = _asked_mps(number, item)
        elif item.command in (WAYPOINT, WAIT, STAY):
            self.waypoints.append(_waypoint(number, item, self._speed_mps))
            self._stays = item.command == STAY
        elif item.command == HOME:
            self.then = "home"
        elif item.command in CARRIED:
            place = {"after_piece": len(self.path) - 1} if self.path else {"after": len(self.waypoints)}
            self.actions.append(_action(number, item, place))
        elif item.command == DELAY:
            if not self.waypoints:
                raise FormatError(f"item {number}: a delay before the first waypoint")
            self.waypoints[-1] = _delayed(number, item, self.waypoints[-1])
        elif item.command == PATH:
            self.path.append(_piece(number, item))
        else:
            raise Unsupported(f"item {number}: {command_name(item.command)} is not something this boat does")
        if max(len(self.waypoints), len(self.path), len(self.actions)) > ROWS:
            raise FormatError(f"item {number}: more than {ROWS} waypoints, pieces of the path, or actions")

    def done(self, name: str, zones: config.Zones) -> Mission:
        """The mission as its file would have it."""
        if not self.waypoints:
            raise FormatError("a mission needs a waypoint")
        if self._stays and self.then == "hold":  # which is for ever
            self.waypoints[-1] = msgspec.structs.replace(self.waypoints[-1], hold_s=0.0)
        return self.so_far(name, zones)

    def so_far(self, name: str, zones: config.Zones) -> Mission:
        """The mission of the items that came, which may be none."""
        stops, path, actions = tuple(self.waypoints), tuple(self.path), tuple(self.actions)
        return Mission(version=1, name=name, waypoint=stops, path=path, action=actions, then=self.then, fence=zones)


class ZonesDraft:
    """Zones, item by item. Raises FormatError with the number of the item that cannot be understood. It does not check
    whether a polygon crosses itself."""

    def __init__(self) -> None:
        self._keep_in, self._keep_out = list[config.Area](), list[config.Area]()
        self._first, self._begun, self._corners = Item(0), 0, list[tuple[float, float]]()  # of the polygon that is coming

    def add(self, number: int, item: Item) -> None:
        if not self._corners:
            self._begin(number, item)
        elif (item.command, item.p1) != (self._first.command, self._first.p1):
            raise self._torn()
        areas = self._keep_in if item.command in (KEEP_IN, CIRCLE_IN) else self._keep_out
        if item.command in (CIRCLE_IN, CIRCLE_OUT):
            areas.append(_row(number, config.Area, centre=(_place(number, item),), radius_m=_number(number, item.p1)))
            return
        self._corners.append(_place(number, item))
        if len(self._corners) < int(item.p1):
            return
        corners, self._corners = tuple(self._corners), []
        areas.append(config.Area(polygon=corners))

    def _begin(self, number: int, item: Item) -> None:
        """The first item of a zone: lengths before anything else."""
        if item.command not in (CIRCLE_IN, CIRCLE_OUT, KEEP_IN, KEEP_OUT):
            raise Unsupported(f"item {number}: {command_name(item.command)} is not a zone that this boat knows")
        self._first, self._begun = item, number
        if item.command in (KEEP_IN, CIRCLE_IN) and len(self._keep_in) >= config.AREAS:
            raise FormatError(f"item {number}: more than {config.AREAS} areas to stay in")
        if item.command in (KEEP_OUT, CIRCLE_OUT) and len(self._keep_out) >= config.ZONES:
            raise FormatError(f"item {number}: more than {config.ZONES} zones to stay out of")
        if item.command in (CIRCLE_IN, CIRCLE_OUT):
            return
        if int(_number(number, item.p1)) < 3:
            raise self._torn()
        if item.p1 > config.CORNERS:
            raise FormatError(f"item {number}: a polygon of {item.p1:g} corners: up to {config.CORNERS} are understood")

    def _torn(self) -> FormatError:
        return FormatError(f"item {self._begun}: a polygon of {self._first.p1:g} corners that does not have them")

    def done(self) -> config.Zones:
        if self._corners:
            raise self._torn()
        return config.Zones(keep_in=tuple(self._keep_in), keep_out=tuple(self._keep_out))


class RallyDraft:
    """Harbours, item by item. Raises FormatError with the number of the item that cannot be understood."""

    def __init__(self) -> None:
        self._places: list[tuple[float, float]] = []

    def add(self, number: int, item: Item) -> None:
        if item.command != HARBOUR:
            raise Unsupported(f"item {number}: {command_name(item.command)} is not a rally point")
        if len(self._places) >= HARBOURS:
            raise FormatError(f"item {number}: more than {HARBOURS} rally points")
        self._places.append(_place(number, item))

    def done(self) -> tuple[tuple[float, float], ...]:
        return tuple(self._places)


Draft = MissionDraft | ZonesDraft | RallyDraft


class Told(NamedTuple):
    """A plan as it is told: its items, the numbers of its waypoint items, and its bytes for the checksum."""

    plan: object
    items: list[Item]
    waypoints: list[int]
    packed: bytearray
    checksum: int  # of this plan alone

    def leg_of(self, number: int) -> int:
        """The leg that leads to an item, or to the first waypoint after it. Raises FormatError where there is none."""
        if not self.waypoints:
            raise FormatError("no mission is aboard")
        leg = bisect_left(self.waypoints, number)
        if leg == len(self.waypoints):
            raise FormatError(f"no waypoint at item {number} or after it")
        return leg

    def item_of(self, leg: int) -> int:
        """The number of the item that a leg leads to; that of the last one where there is no such leg."""
        return self.waypoints[min(leg, len(self.waypoints) - 1)] if self.waypoints else 0


NOTHING: Final = Told(None, [], [], bytearray(), 0)


def told(plan: object, items: Iterable[Item], frame: int) -> Work[Told]:
    """A plan to be told, item by item, with its places in this frame."""
    told_items, waypoints, packed = list[Item](), list[int](), bytearray()
    for number, item in enumerate(items):
        yield ITEM
        i = item._replace(frame=frame) if item.frame in GLOBAL and item.command not in CARRIED else item
        told_items.append(i)
        packed.extend(_CHECKED.pack(i.frame, i.command, 1, i.p1, i.p2, i.p3, i.p4, i.x, i.y, i.z))
        if i.command == WAYPOINT:
            waypoints.append(number)
    return Told(plan, told_items, waypoints, packed, (yield from checksum([packed])))


def checksum(packed: Iterable[bytearray]) -> Work[int]:
    """MISSION_CHECKSUM's value: the CRC-32 of MAVLink FTP (no inversion) over frame, command, autocontinue (1) and the
    parameters as they travel in MISSION_ITEM_INT, little endian."""
    crc = 0xFFFFFFFF
    for data in packed:
        for at in range(0, len(data), BLOCK_BYTES):
            yield BLOCK
            crc = zlib.crc32(data[at : at + BLOCK_BYTES], crc)
    return ~crc & 0xFFFFFFFF


def _waypoint(number: int, item: Item, speed_mps: float) -> Waypoint:
    hold_s = HOLD_MAX_S if item.command == STAY else _number(number, item.p1)
    reach_m = _number(number, item.p2) if item.command == WAYPOINT else 0.0
    place = _fields(number, item)
    line, tries = (_whole(item.p3, LINES_MAX), _whole(item.p4, TRIES_MAX)) if item.command == WAYPOINT else (0, 0)
    more = {"line": line, "tries": tries if hold_s else 0}
    return _row(number, Waypoint, **place, speed_mps=speed_mps, acceptance_m=reach_m, hold_s=hold_s, **more)


def _whole(value: float, most: int) -> int:
    """The line of a survey, or the tries of a sample, in a number that other programs use otherwise: what is none is 0."""
    return int(value) if math.isfinite(value) and 0.0 < value <= most and value == int(value) else 0


def _action(number: int, item: Item, where: dict[str, int]) -> PayloadItem:
    """As it came, to the last bit."""
    numbers = list[Number]()
    for value in (item.p1, item.p2, item.p3, item.p4, item.z):
        if math.isinf(value):
            raise FormatError(f"item {number}: {value} is not a number")
        numbers.append("nan" if math.isnan(value) else value)
    place = {"x": item.x, "y": item.y, "z": numbers[4], "frame": item.frame}
    return _row(number, PayloadItem, **where, command=item.command, params=numbers[:4], **place)


def _delayed(number: int, item: Item, waypoint: Waypoint) -> Waypoint:
    """The waypoint with a delay behind it."""
    if item.p1 < 0.0:
        raise Unsupported(f"item {number}: this boat cannot wait for a time of day")
    fields = msgspec.structs.asdict(waypoint)
    return _row(number, Waypoint, **fields | {"hold_s": round(waypoint.hold_s + _number(number, item.p1), 3)})


def _piece(number: int, item: Item) -> PathPoint:
    turn_deg, radius_m, speed_mps = (_number(number, value) for value in (item.p1, item.p2, item.p3))
    hold_s, line = _number(number, item.z) if item.z > 0.0 else 0.0, _whole(item.p4, LINES_MAX)
    more = {"speed_mps": speed_mps, "turn_deg": turn_deg, "radius_m": radius_m, "hold_s": hold_s, "line": line}
    return _row(number, PathPoint, **_fields(number, item), **more)


def command_name(command: int) -> str:
    """The command's name in the protocol's documents."""
    known = dialect.enums["MAV_CMD"].get(command)
    return f"{known.name.removeprefix('MAV_CMD_')} ({command})" if known else f"command {command}"


def _asked_mps(number: int, item: Item) -> float:
    if item.p2 == USUAL_SPEED or item.p2 == 0.0:
        return 0.0
    return round(_number(number, item.p2), 3)


def _number(number: int, value: float) -> float:
    """Rounded as a person would write it: a float has seven digits. Raises FormatError for values that are not finite."""
    if not math.isfinite(value):
        raise FormatError(f"item {number}: {value} is not a number")
    return round(value, 3)


def _place(number: int, item: Item) -> tuple[float, float]:
    if item.frame not in GLOBAL:
        raise FormatError(f"item {number}: frame {item.frame} has no latitude and longitude")
    if not (abs(item.x) <= 890_000_000 and abs(item.y) <= 1_800_000_000) or (item.x == 0 and item.y == 0):
        raise FormatError(f"item {number}: no such latitude and longitude")
    return item.x / 1e7, item.y / 1e7


def _fields(number: int, item: Item) -> dict[str, float]:
    return dict(zip(("latitude_deg", "longitude_deg"), _place(number, item), strict=True))


def _row(number: int, kind: type[T], **fields: object) -> T:
    """A row of a mission file, checked. Raises FormatError."""
    try:
        return tables.decode({**fields}, kind, f"item {number}")
    except ConfigError as error:
        raise FormatError(f"item {number}: {f'{error.key} must be {error.allowed}' if error.key else error.reason}") from None


def _e7(angle_deg: float) -> int:
    return round(angle_deg * 1e7)
