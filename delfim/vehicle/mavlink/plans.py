"""Missions, fences and harbours as MAVLink's items, and back: pure functions, for both ends of the link.

A mission is the same at both ends when the checksum of its items is: MISSION_CHECKSUM tells it. What an item cannot say is
refused by the number of the item, and never left out in silence.
"""

import math
import struct
import zlib
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple, TypeVar

import msgspec

from delfim import config
from delfim.errors import FormatError
from delfim.vehicle.mavlink.wire import dialect
from delfim.vehicle.mission import Mission, PathPoint, Waypoint

MISSION, FENCE, RALLY, ALL = 0, 1, 2, 255  # MAV_MISSION_TYPE
ITEMS: Final = 2000  # of a plan, at most
WAYPOINT: Final = int(dialect.MAV_CMD_NAV_WAYPOINT)
WAIT: Final = int(dialect.MAV_CMD_NAV_LOITER_TIME)  # a waypoint to wait at, in other words
DELAY: Final = int(dialect.MAV_CMD_NAV_DELAY)  # wait where the boat is
SPEED: Final = int(dialect.MAV_CMD_DO_CHANGE_SPEED)
PATH: Final = int(dialect.MAV_CMD_WAYPOINT_USER_1)  # a piece of the path: turn_deg, radius_m, speed_mps
KEEP_IN: Final = int(dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION)
KEEP_OUT: Final = int(dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION)
CIRCLE_OUT: Final = int(dialect.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION)
HARBOUR: Final = int(dialect.MAV_CMD_NAV_RALLY_POINT)
GLOBAL: Final = frozenset({0, 3, 5, 6, 10, 11})  # frames with latitude and longitude; height means nothing to a boat
USUAL_SPEED: Final = -2.0  # of SPEED: the vehicle's own
_CHECKED: Final = struct.Struct("<BHB4fiif")

T = TypeVar("T", bound=config.Table)


class Unsupported(FormatError):
    """An item for something that this boat does not do."""


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
    frame: int = int(dialect.MAV_FRAME_GLOBAL_INT)


def mission_items(tables: Mission) -> list[Item]:
    """Waypoints with a change of speed before those that have another one; then the pieces of the path, where there is one."""
    items: list[Item] = []
    speed_mps = 0.0
    for waypoint in tables.waypoint:
        if waypoint.speed_mps != speed_mps:
            speed_mps = waypoint.speed_mps
            items.append(Item(SPEED, 1.0, speed_mps or USUAL_SPEED, -1.0, frame=int(dialect.MAV_FRAME_MISSION)))
        place = _e7(waypoint.latitude_deg), _e7(waypoint.longitude_deg)
        items.append(Item(WAYPOINT, waypoint.hold_s, waypoint.acceptance_m, 0.0, 0.0, *place))
    for piece in tables.path:
        place = _e7(piece.latitude_deg), _e7(piece.longitude_deg)
        items.append(Item(PATH, piece.turn_deg, piece.radius_m, piece.speed_mps, 0.0, *place))
    return items


def fence_items(zones: config.Zones) -> list[Item]:
    items = [Item(KEEP_IN, float(len(zones.keep_in)), x=_e7(at[0]), y=_e7(at[1])) for at in zones.keep_in]
    for zone in zones.keep_out:
        items += [Item(KEEP_OUT, float(len(zone.polygon)), x=_e7(at[0]), y=_e7(at[1])) for at in zone.polygon]
        items += [Item(CIRCLE_OUT, zone.radius_m, x=_e7(at[0]), y=_e7(at[1])) for at in zone.centre]
    return items


def rally_items(points: Iterable[tuple[float, float]]) -> list[Item]:
    return [Item(HARBOUR, x=_e7(latitude_deg), y=_e7(longitude_deg)) for latitude_deg, longitude_deg in points]


def home_item(latitude_rad: float, longitude_rad: float) -> Item:
    return Item(WAYPOINT, x=_e7(math.degrees(latitude_rad)), y=_e7(math.degrees(longitude_rad)))


def mission(items: Sequence[Item], name: str, zones: config.Zones, first: int = 0) -> Mission:
    """What a mission file would say; `first` is the number of the first item. Raises FormatError with the number of the item
    that makes no sense, Unsupported where it makes sense and is nothing for this boat."""
    waypoints: list[Waypoint] = []
    path: list[PathPoint] = []
    speed_mps = 0.0
    for number, item in enumerate(items, first):
        if item.command == SPEED:
            speed_mps = _asked_mps(number, item)
        elif item.command in (WAYPOINT, WAIT):
            waypoints.append(_waypoint(number, item, speed_mps))
        elif item.command == DELAY:
            if not waypoints:
                raise FormatError(f"item {number}: a delay before the first waypoint")
            waypoints[-1] = _delayed(number, item, waypoints[-1])
        elif item.command == PATH:
            path.append(_piece(number, item))
        else:
            raise Unsupported(f"item {number}: {_name(item.command)} is not something this boat does")
    if not waypoints:
        raise FormatError("a mission without a waypoint")
    return Mission(version=1, name=name, waypoint=tuple(waypoints), path=tuple(path), fence=zones)


def zones(items: Sequence[Item]) -> config.Zones:
    """Raises FormatError with the number of the item that cannot be understood."""
    keep_in: tuple[tuple[float, float], ...] = ()
    keep_out: list[config.KeepOut] = []
    at = 0
    try:
        while at < len(items):
            item = items[at]
            if item.command == CIRCLE_OUT:
                keep_out.append(config.KeepOut(centre=(_place(at, item),), radius_m=_number(at, item.p1)))
                at += 1
                continue
            if item.command not in (KEEP_IN, KEEP_OUT):
                raise Unsupported(f"item {at}: {_name(item.command)} is no zone that this boat knows")
            corners = _polygon(items, at)
            if item.command == KEEP_OUT:
                keep_out.append(config.KeepOut(polygon=corners))
            elif keep_in:
                raise FormatError(f"item {at}: a second polygon to stay in")
            else:
                keep_in = corners
            at += len(corners)
        return config.Zones(keep_in=keep_in, keep_out=tuple(keep_out))
    except FormatError:
        raise
    except ValueError as error:
        raise FormatError(f"item {at}: {error}") from None


def harbours(items: Sequence[Item]) -> tuple[tuple[float, float], ...]:
    """Raises FormatError with the number of the item that cannot be understood."""
    for number, item in enumerate(items):
        if item.command != HARBOUR:
            raise Unsupported(f"item {number}: {_name(item.command)} is no rally point")
    return tuple(_place(number, item) for number, item in enumerate(items))


def checksum(items: Iterable[Item]) -> int:
    """Of MISSION_CHECKSUM: the CRC-32 of MAVLink FTP (no inversion) over frame, command, autocontinue (1) and the parameters
    as they travel in MISSION_ITEM_INT, little endian."""
    data = b"".join(_CHECKED.pack(i.frame, i.command, 1, i.p1, i.p2, i.p3, i.p4, i.x, i.y, i.z) for i in items)
    return ~zlib.crc32(data, 0xFFFFFFFF) & 0xFFFFFFFF


def leg_of(items: Sequence[Item], number: int) -> int:
    """The leg that leads to an item, or to the first waypoint after it. Raises FormatError where there is none."""
    if not any(item.command == WAYPOINT for item in items[number:]):
        raise FormatError(f"no item {number} that can be gone to")
    return sum(item.command == WAYPOINT for item in items[:number])


def item_of(items: Sequence[Item], leg: int) -> int:
    """The number of the item that a leg leads to; that of the last one where there is no such leg."""
    numbers = [number for number, item in enumerate(items) if item.command == WAYPOINT]
    return numbers[min(leg, len(numbers) - 1)] if numbers else 0


def _polygon(items: Sequence[Item], at: int) -> tuple[tuple[float, float], ...]:
    first = items[at]
    count = int(_number(at, first.p1))
    corners = items[at : at + count]
    if count < 3 or len(corners) < count or any(i.command != first.command or i.p1 != first.p1 for i in corners):
        raise FormatError(f"item {at}: a polygon of {first.p1:g} corners that does not have them")
    return tuple(_place(number, item) for number, item in enumerate(corners, at))


def _waypoint(number: int, item: Item, speed_mps: float) -> Waypoint:
    hold_s, reach_m = _number(number, item.p1), _number(number, item.p2) if item.command == WAYPOINT else 0.0
    place = _fields(number, item)
    return _row(number, Waypoint, **place, speed_mps=speed_mps, acceptance_m=reach_m, hold_s=hold_s)


def _delayed(number: int, item: Item, waypoint: Waypoint) -> Waypoint:
    """The waypoint with a delay behind it."""
    if item.p1 < 0.0:
        raise Unsupported(f"item {number}: to wait for a time of day is not something this boat does")
    fields = msgspec.structs.asdict(waypoint)
    return _row(number, Waypoint, **fields | {"hold_s": round(waypoint.hold_s + _number(number, item.p1), 3)})


def _piece(number: int, item: Item) -> PathPoint:
    turn_deg, radius_m, speed_mps = (_number(number, value) for value in (item.p1, item.p2, item.p3))
    return _row(number, PathPoint, **_fields(number, item), speed_mps=speed_mps, turn_deg=turn_deg, radius_m=radius_m)


def _name(command: int) -> str:
    """As the protocol's documents name it."""
    known = dialect.enums["MAV_CMD"].get(command)
    return f"{known.name.removeprefix('MAV_CMD_')} ({command})" if known else f"command {command}"


def _asked_mps(number: int, item: Item) -> float:
    if item.p2 == USUAL_SPEED or item.p2 == 0.0:
        return 0.0
    return round(_number(number, item.p2), 3)


def _number(number: int, value: float) -> float:
    """As a person would write it: what travelled as a float has seven digits. Raises FormatError for what is not finite."""
    if not math.isfinite(value):
        raise FormatError(f"item {number}: {value} is no number")
    return round(value, 3)


def _place(number: int, item: Item) -> tuple[float, float]:
    if item.frame not in GLOBAL:
        raise FormatError(f"item {number}: frame {item.frame} has no latitude and longitude")
    if not (abs(item.x) <= 890_000_000 and abs(item.y) <= 1_800_000_000) or (item.x == 0 and item.y == 0):
        raise FormatError(f"item {number}: no such place")
    return item.x / 1e7, item.y / 1e7


def _fields(number: int, item: Item) -> dict[str, float]:
    return dict(zip(("latitude_deg", "longitude_deg"), _place(number, item), strict=True))


def _row(number: int, kind: type[T], **fields: float) -> T:
    """A row of a mission file, in range. Raises FormatError."""
    try:
        return msgspec.convert(fields, kind)
    except msgspec.ValidationError as error:
        raise FormatError(f"item {number}: {error}") from None


def _e7(angle_deg: float) -> int:
    return round(angle_deg * 1e7)
