"""A plan of the page (docs/console.md) as the tables of a mission file and as MAVLink's items, and back.

`delfim.parts.mavlink.codec.plans` defines the items for both ends of the link.
"""

import contextlib
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, TypeVar

import msgspec

from delfim import config
from delfim.base import tables
from delfim.base.errors import FormatError
from delfim.console.link.mavlink import Item, plans
from delfim.vehicle.plans.mission import CARRIED, Mission, PathPoint, PayloadItem, Waypoint

LATITUDE_MAX_DEG, LONGITUDE_MAX_DEG = 89.0, 180.0
Row = TypeVar("Row", Waypoint, PathPoint)
KINDS: Final = (plans.MISSION, plans.FENCE, plans.RALLY)


def page_of(mission: Mission) -> dict[str, Any]:
    """A mission as the page has it, without a home. The page edits one polygon to stay in and the circles to stay out of; it
    shows the other `zones`, and carries them and the path along; actions lie at the waypoint that they follow."""
    zones, actions = mission.fence, dict[int, list[dict[str, Any]]]()
    for action in (each for each in mission.action if each.after is not None):
        row = {name: value for name, value in msgspec.to_builtins(action).items() if name != "after_piece"}
        actions.setdefault(row.pop("after"), []).append(row)
    fence = next((area for area in zones.keep_in if area.polygon), None)
    circles = [area for area in zones.keep_out if area.centre]
    others = [("keep_in", area) for area in zones.keep_in if area is not fence]
    others += [("keep_out", area) for area in zones.keep_out if area.polygon]
    return {
        "name": mission.name,
        "waypoints": [
            msgspec.to_builtins(each) | {"turn": None} | ({"actions": actions[number]} if number in actions else {})
            for number, each in enumerate(mission.waypoint, 1)
        ],
        "actions": actions.get(0, []),
        "then": mission.then,
        "path": [msgspec.to_builtins(each) for each in mission.path],
        "path_actions": [msgspec.to_builtins(each) for each in mission.action if each.after_piece is not None],
        "fence": [list(corner) for corner in fence.polygon] if fence is not None else [],
        "obstacles": [_named(each.centre[0]) | {"radius_m": each.radius_m} for each in circles],
        "zones": [{"kind": kind} | msgspec.to_builtins(area) for kind, area in others],
        "home": None,
    }


def tables_of(plan: Mapping[str, Any]) -> Mission:
    """The tables of a mission file, without home; ranges are not checked. Raises FormatError."""
    try:
        circles = ((_place(each), float(each["radius_m"])) for each in plan.get("obstacles") or ())
        keep_out = [config.Area(centre=(place,), radius_m=radius_m) for place, radius_m in circles]
        corners = tuple((float(latitude_deg), float(longitude_deg)) for latitude_deg, longitude_deg in plan.get("fence") or ())
        keep_in = [config.Area(polygon=corners)] if corners else []
        for zone in plan.get("zones") or ():
            area = {name: zone[name] for name in config.Area.__struct_fields__ if name in zone}
            (keep_in if zone["kind"] == "keep_in" else keep_out).append(msgspec.convert(area, config.Area))
        stops = plan["waypoints"]
        actions = (
            {"after": after} | dict(each) for after, stop in enumerate((plan, *stops)) for each in stop.get("actions") or ()
        )
        return Mission(
            version=1,
            name=str(plan.get("name", "")),
            action=tuple(msgspec.convert(each, PayloadItem) for each in (*actions, *(plan.get("path_actions") or ()))),
            then="home" if plan.get("then") == "home" else "hold",
            waypoint=tuple(_row(Waypoint, each) for each in stops),
            path=tuple(_row(PathPoint, each) for each in plan.get("path") or ()),
            fence=config.Zones(keep_in=tuple(keep_in), keep_out=tuple(keep_out)),
        )
    except (KeyError, TypeError, ValueError, msgspec.ValidationError) as error:
        raise FormatError(f"not a mission: {error}") from None


def checked_tables(plan: Mapping[str, Any]) -> Mission:
    """The tables of a mission file, with all numbers in their ranges. Raises FormatError, ConfigError."""
    return tables.decode(msgspec.to_builtins(tables_of(plan)), Mission, str(plan.get("name", "")))


def items_of(plan: Mapping[str, Any]) -> list[list[Item]]:
    """The items of each type: waypoints and path, fence and obstacles, home. Raises FormatError."""
    mission, home = tables_of(plan), plan.get("home")
    harbours = [_place(home)] if home else []
    return [list(plans.mission_items(mission)), list(plans.fence_items(mission.fence)), list(plans.rally_items(harbours))]


def mission_of(name: str, groups: Sequence[Sequence[Item]]) -> dict[str, Any]:
    """The inverse, with its digest. Items that the page cannot show are left out."""
    mission, zones, rally = plans.MissionDraft(), plans.ZonesDraft(), plans.RallyDraft()
    drafts: tuple[plans.Draft, ...] = mission, zones, rally
    for draft, items in zip(drafts, groups, strict=True):
        for number, item in enumerate(items):
            with contextlib.suppress(FormatError):
                draft.add(number, item)
    fence = config.Zones()
    with contextlib.suppress(FormatError):  # a polygon that is not whole
        fence = zones.done()
    home = [_named(place) for place in rally.done()[:1]]
    return with_digest(page_of(mission.so_far(name, fence)) | {"home": home[0] if home else None})


def item_in(m: Any) -> Item:
    """The item of a MISSION_ITEM_INT. A number that is not finite means "default", which is 0 here."""
    numbers = m.param1, m.param2, m.param3, m.param4, m.z
    one, two, three, four, z = (each if math.isfinite(each) or m.command in CARRIED else 0.0 for each in numbers)
    return Item(m.command, one, two, three, four, m.x, m.y, z, m.frame)


def with_digest(plan: dict[str, Any]) -> dict[str, Any]:
    """A plan with its digest, because it is compared often, and the digest of a long one takes 30 ms."""
    return plan | {"digest": digest(plan)}


def digest(plan: Mapping[str, Any]) -> str:
    """A hash of a plan without its title."""
    said = [
        [(i.command, *(round(p, 3) for p in (i.p1, i.p2, i.p3, i.p4, *_hold_s(i))), i.x, i.y) for i in items]
        for items in items_of(plan)
    ]
    return hashlib.sha256(json.dumps(said).encode()).hexdigest()[:12]


def _hold_s(item: Item) -> tuple[float, ...]:
    """The stay at the end of a piece of the path, where there is one."""
    return (item.z,) if item.command == plans.PATH and item.z else ()


def item_of(plan: Mapping[str, Any], waypoint: int) -> int:
    """The number of a waypoint's item, from 0. Raises FormatError if there is no such waypoint."""
    places = _places(plan)
    if not 0 <= waypoint < len(places):
        raise FormatError(f"no waypoint {waypoint}: the mission has {len(places)}")
    return places[waypoint]


def waypoint_of(plan: Mapping[str, Any], item: int) -> int:
    """The waypoint that an item is or belongs to, from 0; a change of speed belongs to the waypoint behind it."""
    return sum(place < item for place in _places(plan))


def _places(plan: Mapping[str, Any]) -> list[int]:
    stops = plan["waypoints"]
    before = [len(each.get("actions") or ()) for each in (plan, *stops[:-1])]
    speeds_mps = [float(each.get("speed_mps") or 0.0) for each in stops]
    return list(plans.places(zip(speeds_mps, before, strict=False)))


def _row(kind: type[Row], each: Mapping[str, Any]) -> Row:
    latitude_deg, longitude_deg = _place(each)
    numbers: dict[str, Any] = {name: float(each.get(name) or 0.0) for name in kind.__struct_fields__}
    whole = {name: int(numbers[name]) for name in ("line", "tries") if name in numbers}
    return kind(**numbers | whole | {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg})


def _place(where: Mapping[str, Any]) -> tuple[float, float]:
    latitude_deg, longitude_deg = float(where["latitude_deg"]), float(where["longitude_deg"])
    if not (abs(latitude_deg) <= LATITUDE_MAX_DEG and abs(longitude_deg) <= LONGITUDE_MAX_DEG):
        raise ValueError(f"{latitude_deg}, {longitude_deg} is no position on Earth")
    return latitude_deg, longitude_deg


def _named(place: tuple[float, float]) -> dict[str, float]:
    return {"latitude_deg": place[0], "longitude_deg": place[1]}
