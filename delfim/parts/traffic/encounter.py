"""The duties of two vessels to each other by the rules of the road (COLREG 13 to 15 and 18), from bearings and speeds alone."""

import math
from typing import Final, Literal, NamedTuple

from delfim.base.geodesy import wrap
from delfim.vehicle.target import Target

Duty = Literal["overtaking", "overtaken", "head-on", "give-way", "stand-on", "at rest"]

ABAFT_RAD: Final = math.radians(112.5)  # from this bearing aft the one that comes up overtakes (rule 13 b)
RECIPROCAL_RAD: Final = math.radians(165.0)
AHEAD_RAD: Final = math.radians(15.0)
AT_REST_MPS: Final = 0.25
PRIVILEGED: Final = {  # navigational status of those that power-driven vessels keep clear of (rule 18 a)
    2: "not under command",
    3: "restricted in her ability to manoeuvre",
    7: "fishing",
    8: "under sail",
}
SMALL_M: Final = 20.0


class Own(NamedTuple):
    """The own boat: in the local plane, over ground."""

    north_m: float
    east_m: float
    course_rad: float
    speed_mps: float


def duty(own: Own, target: Target) -> Duty:
    """The own boat's duty to a target. In doubt two vessels meet head-on (rule 14 c). A vessel of rule 18 is never one that has
    to give way, but where she overtakes (13 a)."""
    bearing_rad = math.atan2(target.east_m - own.east_m, target.north_m - own.north_m)
    seen_rad, seen_by_it_rad = wrap(bearing_rad - own.course_rad), wrap(bearing_rad + math.pi - target.course_rad)
    if target.speed_mps < AT_REST_MPS:
        return "at rest"
    if abs(seen_by_it_rad) >= ABAFT_RAD and own.speed_mps > target.speed_mps:
        return "overtaking"
    if abs(seen_rad) >= ABAFT_RAD and target.speed_mps > own.speed_mps:
        return "overtaken"
    if abs(wrap(target.course_rad - own.course_rad)) > RECIPROCAL_RAD and abs(seen_rad) < AHEAD_RAD:
        return "head-on"
    return "give-way" if seen_rad >= 0.0 else "stand-on"


def stands_on(owed: Duty, target: Target, stand_on: str) -> bool:
    """Whether the own boat keeps course and speed for a target at first (rule 17). `stand_on` is the owner's choice: "never",
    "small" (for vessels below 20 m) or "always"."""
    if owed not in ("stand-on", "overtaken") or target.status in PRIVILEGED:
        return False
    return stand_on == "always" or (stand_on == "small" and target.length_m < SMALL_M)


BEGINNINGS: Final = ("giving way to ", "keeping clear of ", "overtaking ")  # of what `words` says


def words(owed: Duty, target: Target, is_late: bool) -> str:
    """The words for what the boat does for a target. `is_late`: the target ought to have given way."""
    name, privileged = target.name, PRIVILEGED.get(target.status)
    if owed == "at rest":
        return f"keeping clear of {name}, which lies still"
    if owed == "overtaking":
        return f"overtaking {name}"
    if privileged is not None:
        return f"giving way to {name}, {privileged}"
    if owed == "overtaken":
        return f"keeping clear of {name}, which overtakes"
    if owed == "stand-on":
        return f"{'keeping clear of' if is_late else 'giving way to'} {name}, crossing from port" + (
            " and not giving way" if is_late else ""
        )
    return f"giving way to {name}, {'head-on' if owed == 'head-on' else 'crossing from starboard'}"


def passing(owed: Duty, ahead: float, starboard: float) -> str:
    """The words for how the boat passes: where it is, seen from the target, when they are nearest."""
    if owed == "head-on":
        return "port to port" if starboard < 0.0 else "starboard to starboard"
    if owed in ("overtaking", "overtaken", "at rest"):
        return f"passing on its {'port' if starboard < 0.0 else 'starboard'} side"
    return "passing ahead" if ahead > 0.0 else "passing astern"
