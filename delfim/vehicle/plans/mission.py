"""Mission files: TOML, versioned, checked before anything moves (`docs/missions.md`).

A mission gives places; speeds and radii are the vehicle's unless the mission gives them. `digest` identifies the content, so
that an upload can be read back and compared.
"""

import contextlib
import hashlib
import itertools
import json
import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from delfim import config
from delfim.base import geodesy, tables
from delfim.base.cooperative import Sliced, Work
from delfim.base.errors import ConfigError, FormatError
from delfim.base.input.untrusted import parse_toml
from delfim.vehicle.state import Arc, Line, Plan
from delfim.vehicle.state import Waypoint as PlanWaypoint

LEG_MIN_M, LEG_MAX_M = 0.5, 20_000.0
FAR_MAX_M = LEG_MAX_M  # a mission's places from the boat, and the point that any mode goes to first
RADIUS_MIN_M, RADIUS_MAX_M = 2.0, 5_000.0
HOLD_MAX_S = 86_400.0  # at a waypoint
ROW = 4  # time for a waypoint or a piece of the path, counted in comparisons
ROWS = 1000  # waypoints, pieces of the path, and actions, at most
AT_ONCE = 20  # actions at one place
LINES_MAX = 9999  # of a survey
TRIES_MAX = 9  # of a sample
STATION_S = 5.0  # that the boat stays at a station beyond the time of all tries: their end is told before it goes on
# Commands of MAVLink (MAV_CMD) that a mission carries for payloads; the boat itself does not move by them.
CARRIED = frozenset(
    {
        *range(181, 185),  # DO_SET_RELAY, DO_REPEAT_RELAY, DO_SET_SERVO, DO_REPEAT_SERVO
        *(195, 196, 197, 201),  # DO_SET_ROI_LOCATION, DO_SET_ROI_WPNEXT_OFFSET, DO_SET_ROI_NONE, DO_SET_ROI
        *range(200, 207),  # DO_CONTROL_VIDEO, ROI, DO_DIGICAM_..., DO_MOUNT_..., DO_SET_CAM_TRIGG_DIST
        *(211, 214, 1000, 1001),  # DO_GRIPPER, DO_SET_CAM_TRIGG_INTERVAL, DO_GIMBAL_MANAGER_...
        *range(530, 535),  # SET_CAMERA_MODE, _ZOOM, _FOCUS, ...
        *(2000, 2001, 2003, 2500, 2501, 42600),  # IMAGE_..., DO_TRIGGER_CONTROL, VIDEO_..., DO_WINCH
    }
)
JOINT_M = 1.0  # an arc's stated radius and the distance from its beginning to its centre agree within this

Latitude = Annotated[float, msgspec.Meta(ge=-89.0, le=89.0)]
Longitude = Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)]
MissionSpeed = Annotated[float, msgspec.Meta(ge=0.0, le=30.0)]
Stay = Annotated[float, msgspec.Meta(ge=0.0, le=HOLD_MAX_S)]
SurveyLine = Annotated[int, msgspec.Meta(ge=0, le=LINES_MAX)]  # of the survey, from 1; 0: none
Count = Annotated[int, msgspec.Meta(ge=0, le=ROWS)]
Opens = Annotated[str, tables.text(r"[^\x00-\x1f\x7f]{0,64}", "a band of delfim charts, as 0-1.8 m, or empty")]
Title = Annotated[str, tables.text(r"[^\x00-\x1f\x7f]{1,64}", "1 to 64 characters")]


class Waypoint(tables.Table, frozen=True):
    """A place to go to, and to stay at for a while. Speed or acceptance radius 0: the value of the vehicle's file."""

    latitude_deg: Latitude
    longitude_deg: Longitude
    speed_mps: MissionSpeed = 0.0  # on the way to it
    acceptance_m: Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)] = 0.0
    hold_s: Stay = 0.0
    line: SurveyLine = 0  # that the leg to it sails
    tries: Annotated[int, msgspec.Meta(ge=0, le=TRIES_MAX)] = 0  # of a sample, each for hold_s; 0: none is taken


Number = Annotated[float, msgspec.Meta(ge=-3.5e38, le=3.5e38)] | Literal["nan"]  # of an action; "nan": not given


class PayloadItem(tables.Table, frozen=True, kw_only=True):
    """An item of MAVLink for payloads, which the boat carries as it came, and announces at its place."""

    after: Count | None = None  # so many waypoints; 0: as the boat sets out for the first
    after_piece: Count | None = None  # or so many pieces of the path; 0: as it sets out on the first
    command: Annotated[int, msgspec.Meta(ge=0, le=0xFFFF)]  # one of CARRIED
    params: tuple[Number, Number, Number, Number] = (0.0, 0.0, 0.0, 0.0)  # 1 to 4
    x: Annotated[int, msgspec.Meta(ge=-(1 << 31), le=(1 << 31) - 1)] = 0  # 5; a latitude in 1e-7 degrees
    y: Annotated[int, msgspec.Meta(ge=-(1 << 31), le=(1 << 31) - 1)] = 0  # 6; a longitude
    z: Number = 0.0  # 7
    frame: Annotated[int, msgspec.Meta(ge=0, le=255)] = 2  # MAV_FRAME; 2: no place


class PathPoint(tables.Table, frozen=True):
    """A piece of the path. The first says where the path begins; one without `turn_deg` is the end of a line from the end of
    the piece before; one with it is the centre of an arc that begins there.
    """

    latitude_deg: Latitude
    longitude_deg: Longitude
    speed_mps: MissionSpeed = 0.0
    turn_deg: Annotated[float, msgspec.Meta(ge=-3600.0, le=3600.0)] = 0.0  # positive to starboard
    radius_m: Annotated[float, msgspec.Meta(ge=0.0, le=RADIUS_MAX_M)] = 0.0  # of an arc
    hold_s: Stay = 0.0  # at its end
    line: SurveyLine = 0  # that it sails


class Mission(tables.Table, frozen=True):
    """A mission file."""

    version: Literal[1]
    name: Title
    waypoint: Annotated[tuple[Waypoint, ...], msgspec.Meta(min_length=1, max_length=ROWS)]
    path: Annotated[tuple[PathPoint, ...], msgspec.Meta(max_length=ROWS)] = ()
    action: Annotated[tuple[PayloadItem, ...], msgspec.Meta(max_length=ROWS)] = ()  # in the order of their places
    then: Literal["hold", "home"] = "hold"  # at the end of waypoints or path
    opens: Opens = ""  # a band of depths of the boat's chart, as "0-1.8 m", that this mission may sail in
    fence: config.Zones = config.Zones()


def load_mission(path: str | Path) -> Mission:
    """The mission in a file, checked. Raises ConfigError with file, key and reason."""
    return _checked(tables.decode(tables.read_toml(path), Mission, str(path)), str(path))


def parse_mission(text: str, file: str = "mission") -> Mission:
    """The mission in a file's text, checked; `file` names it in a refusal. Raises ConfigError."""
    return _checked(read_mission(text, file), file)


def read_mission(text: str, file: str = "mission") -> Mission:
    """The mission in a file's text, before the checks of `fault`. Raises ConfigError."""
    try:
        tree = parse_toml(text)
    except FormatError as error:
        raise ConfigError(file, "file", str(error)) from None
    with contextlib.suppress(msgspec.ValidationError):  # checking the whole tree gives the better message
        for key, kind in (("waypoint", Waypoint), ("path", PathPoint), ("action", PayloadItem)):
            rows = tree.get(key)
            if isinstance(rows, list) and len(rows) <= ROWS:  # row by row: other threads wait only for one row
                tree[key] = [msgspec.convert(row, kind) for row in rows]
    return tables.decode(tree, Mission, file)


def _checked(mission: Mission, file: str) -> Mission:
    Sliced(checked(mission, file)).finish()
    return mission


def save_mission(mission: Mission, path: str | Path) -> None:
    """Write the mission's canonical text. Raises OSError."""
    Path(path).write_text(canonical(mission), encoding="utf-8", newline="\n")


def canonical(mission: Mission) -> str:
    """The one text of a mission: keys that are not at their default, in a fixed order, numbers as short as they round-trip."""
    lines = [f"version = {mission.version}", f"name = {json.dumps(mission.name, ensure_ascii=False)}"]
    if mission.then != "hold":
        lines.append(f"then = {json.dumps(mission.then)}")
    if mission.opens:
        lines.append(f"opens = {json.dumps(mission.opens, ensure_ascii=False)}")
    for title, rows in (("waypoint", mission.waypoint), ("action", mission.action), ("path", mission.path)):
        for row in rows:
            lines += _canonical_table(title, row)
    return "\n".join([*lines, *_canonical_fence(mission.fence)]) + "\n"


def _canonical_fence(fence: config.Zones) -> list[str]:
    if fence == config.Zones():
        return []
    lines = ["", "[fence]", f"version = {fence.version}"]
    for key, areas in (("keep_in", fence.keep_in), ("keep_out", fence.keep_out)):
        for area in areas:
            lines += _canonical_table(f"fence.{key}", area)
    return lines


def _canonical_table(title: str, row: msgspec.Struct) -> list[str]:
    given = ((field.name, getattr(row, field.name), field.default) for field in msgspec.structs.fields(row))
    told = (f"{name} = {json.dumps(value, ensure_ascii=False)}" for name, value, default in given if value != default)
    return ["", f"[[{title}]]", *told]


def digest(mission: Mission) -> str:
    """16 hexadecimal digits that name the mission's content: the first 8 bytes of the SHA-256 of its canonical text."""
    return hashlib.sha256(canonical(mission).encode()).hexdigest()[:16]


def plan(mission: Mission, origin: geodesy.Origin, control: config.ControlTable) -> Work[Plan]:
    """The mission in the local plane, speeds and radii filled in. A mission without a path gets the one that connects its
    waypoints (thesis chapter 4, key P). Raises ConfigError where the boat cannot do it from here.
    """
    for key, row in _rows(mission):
        yield ROW
        if row.speed_mps > control.speed.max_mps:
            raise ConfigError(mission.name, f"{key}.speed_mps", "faster than this boat goes", f"up to {control.speed.max_mps}")
        far_m = math.hypot(*_plane(origin, row))
        if far_m > FAR_MAX_M:
            raise ConfigError(mission.name, key, f"{far_m / 1000.0:.1f} km from the boat", f"up to {FAR_MAX_M / 1000.0:.0f} km")
    waypoints: list[PlanWaypoint] = []
    for stop in mission.waypoint:
        yield ROW
        speed_mps, reach_m = stop.speed_mps or control.speed.cruise_mps, stop.acceptance_m or control.path.acceptance_m
        hold_s = stop.tries * stop.hold_s + STATION_S if stop.tries else stop.hold_s
        waypoints.append(PlanWaypoint(*_plane(origin, stop), speed_mps, reach_m, hold_s, stop.line, stop.tries))
    path: list[Line | Arc] = []
    if mission.path:
        pieces: Iterator[Line | Arc] = _pieces(mission.path, origin, control.speed.cruise_mps)
    else:
        pieces = (
            Line(start.north_m, start.east_m, end.north_m, end.east_m, end.speed_mps, end.hold_s, end.line)
            for start, end in itertools.pairwise(waypoints)
        )
    for piece in pieces:
        yield ROW
        path.append(piece)
    lines = max(each.line for each in (*waypoints, *path))
    return Plan(mission.name, tuple(waypoints), tuple(path), mission.then == "home", lines=lines)


def checked(mission: Mission, file: str = "mission") -> Work[None]:
    """Whether the mission's legs, pieces and zones make sense. Raises ConfigError."""
    first = mission.waypoint[0]
    origin = geodesy.origin(math.radians(first.latitude_deg), math.radians(first.longitude_deg))
    before = _plane(origin, first)
    for index, row in enumerate(mission.waypoint):
        if row.tries and not row.hold_s:
            raise ConfigError(file, f"waypoint[{index}].tries", "a sample needs its time, hold_s")
    for index, row in enumerate(mission.waypoint[1:], 1):
        yield ROW
        place = _plane(origin, row)
        _check_length(file, f"waypoint[{index}]", math.dist(before, place))
        before = place
    if mission.path:
        yield from _check_path(mission.path, origin, file)
    yield from _check_actions(mission, file)
    yield from config.polygons(mission.fence, file)


def _check_actions(mission: Mission, file: str) -> Work[None]:
    last, before = {"after": len(mission.waypoint), "after_piece": len(mission.path) - 1}, {"after": 0, "after_piece": 0}
    here = Counter[tuple[str, int]]()
    for index, action in enumerate(mission.action):
        yield ROW
        key, places = f"action[{index}]", {"after": action.after, "after_piece": action.after_piece}
        if action.command not in CARRIED:
            raise ConfigError(file, f"{key}.command", "not a command that a mission carries for payloads", "docs/missions.md")
        told = [(name, place) for name, place in places.items() if place is not None]
        if len(told) != 1:
            raise ConfigError(file, key, "it needs its place", "after or after_piece")
        ((name, place),) = told
        if last[name] < 0:
            raise ConfigError(file, f"{key}.{name}", "the mission has no [[path]]: say after")
        if not before[name] <= place <= last[name]:
            raise ConfigError(file, f"{key}.{name}", "not in the order of the mission", f"{before[name]} to {last[name]}")
        here[name, place] += 1
        if here[name, place] > AT_ONCE:
            raise ConfigError(file, key, "too many actions at one place", f"up to {AT_ONCE}")
        before[name] = place


def _check_path(path: tuple[PathPoint, ...], origin: geodesy.Origin, file: str) -> Work[None]:
    """Pieces of sensible length, arcs that begin where the piece before them ends."""
    if len(path) == 1:
        raise ConfigError(file, "path", "a single point is only the beginning: add a line or an arc")
    if path[0].turn_deg:
        raise ConfigError(file, "path[0].turn_deg", "an arc cannot be the first: the first point says where the path begins")
    if path[0].line or path[0].hold_s:
        raise ConfigError(file, "path[0]", "the first point says where the path begins: it is no line, and nobody stays there")
    for index, (row, piece) in enumerate(zip(path[1:], _pieces(path, origin, 1.0), strict=True), 1):
        yield ROW
        key = f"path[{index}]"
        if isinstance(piece, Line):
            if row.radius_m:
                raise ConfigError(file, f"{key}.radius_m", "a radius without turn_deg: lines have none")
            _check_length(file, key, math.hypot(piece.to_north_m - piece.north_m, piece.to_east_m - piece.east_m))
            continue
        if row.radius_m < RADIUS_MIN_M:
            raise ConfigError(file, f"{key}.radius_m", "an arc needs its radius", f"{RADIUS_MIN_M} to {RADIUS_MAX_M}")
        if abs(piece.radius_m - row.radius_m) > JOINT_M:
            raise ConfigError(
                file, key, f"the arc begins {piece.radius_m:.2f} m from its centre, not {row.radius_m} m", f"within {JOINT_M} m"
            )
        _check_length(file, key, abs(piece.turn_rad) * piece.radius_m)


def _check_length(file: str, key: str, length_m: float) -> None:
    if not LEG_MIN_M <= length_m <= LEG_MAX_M:
        raise ConfigError(file, key, f"{length_m:.2f} m from the one before", f"{LEG_MIN_M} to {LEG_MAX_M} m")


def _pieces(path: tuple[PathPoint, ...], origin: geodesy.Origin, cruise_mps: float) -> Iterator[Line | Arc]:
    north_m, east_m = _plane(origin, path[0])
    for row in path[1:]:
        to_north_m, to_east_m = _plane(origin, row)
        speed_mps = row.speed_mps or cruise_mps
        if not row.turn_deg:
            yield Line(north_m, east_m, to_north_m, to_east_m, speed_mps, row.hold_s, row.line)
            north_m, east_m = to_north_m, to_east_m
            continue
        radius_m = math.hypot(north_m - to_north_m, east_m - to_east_m)
        start_rad = math.atan2(east_m - to_east_m, north_m - to_north_m)
        turn_rad = math.radians(row.turn_deg)
        yield Arc(to_north_m, to_east_m, radius_m, start_rad, turn_rad, speed_mps, row.hold_s, row.line)
        north_m = to_north_m + radius_m * math.cos(start_rad + turn_rad)
        east_m = to_east_m + radius_m * math.sin(start_rad + turn_rad)


def _rows(mission: Mission) -> Iterator[tuple[str, Waypoint | PathPoint]]:
    for index, waypoint in enumerate(mission.waypoint):
        yield f"waypoint[{index}]", waypoint
    for index, point in enumerate(mission.path):
        yield f"path[{index}]", point


def _plane(origin: geodesy.Origin, row: Waypoint | PathPoint) -> tuple[float, float]:
    return geodesy.to_plane(origin, math.radians(row.latitude_deg), math.radians(row.longitude_deg))
