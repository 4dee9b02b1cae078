"""A mission that changes while it is sailed: what is behind the boat and the leg under way stay where they are, what is ahead
may change. Pure.
"""

from typing import Final, NamedTuple

from delfim.base.cooperative import Work
from delfim.base.modes import Mode
from delfim.vehicle.control.memory import Memory
from delfim.vehicle.control.modes.path import piece_of
from delfim.vehicle.plans import fence
from delfim.vehicle.plans.legs import Behind
from delfim.vehicle.state import Arc, Line, Motion, Plan, Waypoint

SAME_M: Final = 0.1  # MAVLink rounds places to a centimetre, and an arc begins where the one before it ended
ROW: Final = 2  # time to compare two rows, counted in comparisons
SAILS: Final = (Mode.PLAY, Mode.PATH)  # modes that sail the mission
SAILING: Final = "the boat sails the mission: change only what is ahead, or hold first"


class Paused(NamedTuple):
    """A mode that a hold interrupted."""

    mode: Mode
    memory: Memory
    number: int  # of the plan


class UnderWay(NamedTuple):
    """How the mission is sailed: the mode that does it, or that a hold interrupted, and the present leg or piece."""

    mode: Mode
    leg: int
    is_paused: bool = False


class Same(NamedTuple):
    """How many waypoints, and pieces of the path, from the first on, two plans have at the same places."""

    waypoints: int
    pieces: int


def under_way(mode: Mode, leg: int, paused: Paused | None, plan: Plan | None) -> UnderWay | None:
    """How a plan is sailed. None: it is not, and was not interrupted."""
    if mode in SAILS:
        return UnderWay(mode, piece_of(leg))
    if paused is None or paused.mode not in SAILS or plan is None or plan.number != paused.number:
        return None
    return UnderWay(paused.mode, piece_of(paused.memory.leg), is_paused=True)


def same(was: Plan, new: Plan) -> Work[Same]:
    """What two plans have in common."""
    waypoints = yield from _same(was.waypoints, new.waypoints)
    return Same(waypoints, (yield from _same(was.path, new.path)))


def _same(was: tuple[Waypoint | Line | Arc, ...], new: tuple[Waypoint | Line | Arc, ...]) -> Work[int]:
    for number, (one, other) in enumerate(zip(was, new, strict=False)):
        yield ROW
        if type(one) is not type(other):
            return number
        if any(abs(a - b) > SAME_M for a, b in zip(_places(one), _places(other), strict=True)):
            return number
    return min(len(was), len(new))


def _places(row: Waypoint | Line | Arc) -> tuple[float, ...]:
    """What tells where a row is, in metres. Speeds, radii of acceptance and times to stay are free."""
    if isinstance(row, Arc):
        return *row[:3], row.start_rad * row.radius_m, row.turn_rad * row.radius_m
    return row[:4] if isinstance(row, Line) else row[:2]


def differs(now: UnderWay, kept: Same, new: Plan) -> str | None:
    """Why the boat cannot go on with another plan, in words."""
    is_play = now.mode is Mode.PLAY
    count, rows = (kept.waypoints, len(new.waypoints)) if is_play else (kept.pieces, len(new.path))
    if now.leg < count:
        return None
    name = "waypoint {}" if is_play else "piece {} of the path"
    fault = "is at another place" if count < rows else "is missing"
    here = f"{'the leg to ' if is_play else ''}{name.format(now.leg + 1)}"
    return f"{name.format(count + 1)} {fault}, and the boat is on {here}"


def behind(now: UnderWay, is_joined: bool) -> Behind:
    """What is behind the boat. `is_joined`: the path is the one that connects the waypoints."""
    if now.mode is Mode.PLAY:
        return Behind(now.leg, max(now.leg - 1, 0) if is_joined else 0)
    return Behind(now.leg + 1 if is_joined and now.leg else 0, now.leg)


def obstructed(around: fence.Fence, now: UnderWay, plan: Plan, motion: Motion) -> str | None:
    """Why the fence forbids the boat to be where it is, or to go on straight to the end of its leg, in words."""
    if "position" not in motion.has:
        return "no position"
    if (why := fence.outside(around, motion.north_m, motion.east_m)) is not None:
        return f"the boat is {why}"
    if now.mode is Mode.PLAY:
        return fence.crossing(around, motion, plan.waypoints[now.leg][:2])
    piece = plan.path[now.leg]  # an arc is checked as it is
    return fence.crossing(around, motion, (piece.to_north_m, piece.to_east_m)) if isinstance(piece, Line) else None
