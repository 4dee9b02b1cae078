"""The closest point of approach of two vessels, in closed form. Pure functions; no clock.

The own boat sails straight legs; the other vessel keeps course and speed. Its domain is an ellipse along its course that moves
with it. Stretch the plane until the ellipse is the unit circle: the approach on a leg is then that of two points, and nearness
is the distance in domains, 1 at its edge.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from delfim.vehicle.target import Target

Leg = tuple[float, float, float, float, float, float]  # from_s, to_s, north_m and east_m at from_s, north_mps, east_mps

STILL = 1e-12  # square of a relative speed, in domains per second, that is none

_new = tuple.__new__  # a third of the time of Approach(...)


class Domain(NamedTuple):
    """The water around another vessel that the own boat keeps out of."""

    north_m: float  # its middle, now
    east_m: float
    north_mps: float
    east_mps: float
    ahead_n: float  # domains ahead of the vessel, for a metre to the north and ...
    ahead_e: float  # ... to the east
    starboard_n: float
    starboard_e: float


class Approach(NamedTuple):
    """The passage of a boat on its legs by a vessel."""

    nearness: float  # least distance, in domains
    at_s: float  # when the boat enters the domain, or, where it does not, is nearest
    ahead: float  # where it is when it is nearest, in half axes of the domain
    starboard: float


def domain(target: Target, ahead_m: float, abeam_m: float) -> Domain:
    """The domain with these half axes, which are greater than zero."""
    cos, sin = math.cos(target.course_rad), math.sin(target.course_rad)
    north_mps, east_mps = target.speed_mps * cos, target.speed_mps * sin
    place = target.north_m, target.east_m, north_mps, east_mps
    return _new(Domain, (*place, cos / ahead_m, sin / ahead_m, -sin / abeam_m, cos / abeam_m))


def approach(around: Domain, legs: Sequence[Leg], until_s: float, after_s: float = 0.0) -> Approach:
    """The nearest approach from `after_s` to `until_s`. Infinitely far where no leg lies between them."""
    return _new(Approach, passing_by(around, legs, until_s, after_s))


def passing_by(around: Domain, legs: Sequence[Leg], until_s: float, after_s: float = 0.0) -> tuple[float, float, float, float]:
    """The fields of `approach`, which a decision asks for some hundred times."""
    north_m, east_m, north_mps, east_mps, ahead_n, ahead_e, starboard_n, starboard_e = around
    least2, nearest_s, ahead, starboard, entered_s = math.inf, until_s, 0.0, 0.0, math.inf
    for from_s, to_s, n, e, vn, ve in legs:
        if from_s >= until_s:
            break
        to_s = to_s if to_s < until_s else until_s
        if to_s <= after_s:
            continue
        n, e = n - north_m - north_mps * from_s, e - east_m - east_mps * from_s
        vn, ve = vn - north_mps, ve - east_mps
        x, y = n * ahead_n + e * ahead_e, n * starboard_n + e * starboard_e
        ux, uy = vn * ahead_n + ve * ahead_e, vn * starboard_n + ve * starboard_e
        u2, begin_s = ux * ux + uy * uy, after_s - from_s if after_s > from_s else 0.0
        passed_s = -(x * ux + y * uy) / u2 if u2 > STILL else begin_s
        last_s = to_s - from_s
        s = begin_s if passed_s < begin_s else last_s if passed_s > last_s else passed_s
        nx, ny = x + ux * s, y + uy * s
        near2 = nx * nx + ny * ny
        if near2 < 1.0 and entered_s == math.inf:
            by_s = s
            if u2 > STILL:  # the vertex of the parabola, then back to its edge
                px, py = x + ux * passed_s, y + uy * passed_s
                by_s = passed_s - math.sqrt(max(1.0 - px * px - py * py, 0.0) / u2)
            entered_s = from_s + (by_s if by_s > begin_s else begin_s)
        if near2 < least2:
            least2, nearest_s, ahead, starboard = near2, from_s + s, nx, ny
    return math.sqrt(least2), entered_s if least2 < 1.0 else nearest_s, ahead, starboard


def into(north_m: float, east_m: float, radius_m: float, target: Target, within_s: float) -> float | None:
    """When a target comes nearest to the middle of a circle, s, if it, or a place where it may be, comes into it by then."""
    _, tcpa_s = closest(north_m, east_m, 0.0, 0.0, target)
    at_s = min(max(tcpa_s, 0.0), within_s)
    n = target.north_m + at_s * target.speed_mps * math.cos(target.course_rad) - north_m
    e = target.east_m + at_s * target.speed_mps * math.sin(target.course_rad) - east_m
    return at_s if math.hypot(n, e) < radius_m + target.margin_m + target.length_m else None


def closest(north_m: float, east_m: float, north_mps: float, east_mps: float, target: Target) -> tuple[float, float]:
    """(CPA m, TCPA s) of the own boat, which keeps its velocity, and a target. TCPA is negative where they draw apart, and zero
    where neither gains on the other."""
    n, e = target.north_m - north_m, target.east_m - east_m
    un = target.speed_mps * math.cos(target.course_rad) - north_mps
    ue = target.speed_mps * math.sin(target.course_rad) - east_mps
    u2 = un * un + ue * ue
    tcpa_s = -(n * un + e * ue) / u2 if u2 > 1e-4 else 0.0
    ahead_s = max(tcpa_s, 0.0)
    return math.hypot(n + un * ahead_s, e + ue * ahead_s), tcpa_s
