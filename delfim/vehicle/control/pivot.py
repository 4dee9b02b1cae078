"""The gear that turns a thruster: where it should point for a force, and how far it comes in a time."""

import math
from typing import Final, NamedTuple

from delfim.base.geodesy import wrap

EDGE_RAD: Final = 1e-9  # an edge of a forbidden sector is allowed


class Pivot(NamedTuple):
    """The gear that turns a thruster. A rudder turns the stream of a propeller that pushes ahead, and does nothing astern."""

    angle_max_rad: float  # to either side; pi is all round
    rate_radps: float
    forbidden: tuple[tuple[float, float], ...] = ()  # from, to, clockwise: there it may pass without thrust, and not stay
    is_rudder: bool = False


def goes_astern(pivot: Pivot, along_n: float, aside_n: float) -> bool:
    """Whether a thruster pushes astern for a force along its middle and across it. What turns by a quarter or more turns round;
    what turns by less goes astern where that gives the force across it, too, and otherwise ahead, so that it steers."""
    is_narrow = pivot.angle_max_rad < 0.5 * math.pi
    return is_narrow and along_n < 0.0 and abs(aside_n) <= -along_n * math.tan(pivot.angle_max_rad)


def aim(pivot: Pivot, along_n: float, aside_n: float, most_n: float, is_astern: bool) -> float:
    """The angle at which a thruster should point for a force along its middle and across it."""
    if is_astern:
        return 0.0 if pivot.is_rudder else math.atan2(-aside_n, -along_n)
    if pivot.angle_max_rad < 0.5 * math.pi:  # the force across it steers: it is kept, and the one along it gives way
        along_n = min(along_n, math.sqrt(max(most_n * most_n - aside_n * aside_n, 0.0)))
    return math.atan2(aside_n, along_n)


def turn(pivot: Pivot, angle_rad: float, to_rad: float, dt_s: float) -> float:
    """The angle after `dt_s` on the way to another one, or to the nearest that is allowed."""
    widest_rad = pivot.angle_max_rad
    to_rad = min(max(to_rad, -widest_rad), widest_rad)
    if (sector := forbidden(pivot, to_rad)) is not None:
        edges = [edge for edge in map(wrap, sector) if abs(edge) <= widest_rad] or [angle_rad]
        to_rad = min(edges, key=lambda edge: abs(wrap(edge - to_rad)))
    left_rad = wrap(to_rad - angle_rad) if widest_rad >= math.pi else to_rad - angle_rad
    most_rad = pivot.rate_radps * dt_s
    return to_rad if abs(left_rad) <= most_rad else wrap(angle_rad + math.copysign(most_rad, left_rad))


def forbidden(pivot: Pivot, angle_rad: float) -> tuple[float, float] | None:
    """The forbidden sector in which an angle lies; None: it lies in none."""
    for begin_rad, end_rad in pivot.forbidden:
        if EDGE_RAD < (angle_rad - begin_rad) % math.tau < (end_rad - begin_rad) % math.tau - EDGE_RAD:
            return begin_rad, end_rad
    return None
