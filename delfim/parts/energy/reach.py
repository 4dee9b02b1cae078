"""What a way costs, and how far the boat can go, by direction: the current makes one way cheap and the other dear."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Final, NamedTuple

from delfim.base.cooperative import Work
from delfim.parts.energy.consumption import Consumption
from delfim.parts.energy.drift import DriftFound, Six, over_ground_mps, still_mps, unsure
from delfim.vehicle.state import Arc, Line, Plan, Waypoint

DIRECTIONS: Final = 36  # of the shape on the map, from north clockwise
SLOW_MPS: Final = 0.1  # a way on which the boat is slower over ground is none
STEP_MPS: Final = 0.02  # of the slope of the power
NEVER: Final = 0.03  # of a way: currents that turn, sides that draw unlike

Point = tuple[float, float]  # north_m, east_m


class Metre(NamedTuple):
    """The energy of a metre over ground, J/m; how it changes with each of the six of the drift; and which part of it the
    learnt power is off by, as a standard deviation."""

    joules: float
    by: Six = (0.0,) * 6
    off: float = 0.0


def metre(power: Consumption, drift: DriftFound, most_mps: float, speed_mps: float, course_rad: float) -> Metre:
    """A metre on this course at this speed over ground, or at what is left of it where the push for `most_mps` in still water
    is all that the boat has. Infinite where it makes no way."""
    still, heading_rad = still_mps(drift, speed_mps, course_rad)
    is_short = still > most_mps
    if is_short:
        still = most_mps
        speed_mps = min(speed_mps, over_ground_mps(drift, still, course_rad))
    if speed_mps < SLOW_MPS:
        return Metre(math.inf)
    watts = power.watts(still)
    if is_short:  # a slower boat takes longer ...
        per = -watts / speed_mps**2
    else:  # ... and another pushes more
        rise = (power.watts(still + STEP_MPS) - watts) / STEP_MPS
        per = -rise / (speed_mps * max(drift.factor + drift.slope, 0.2))
    a, b, c, d, e, f = unsure(drift, still, heading_rad)
    return Metre(watts / speed_mps, (per * a, per * b, per * c, per * d, per * e, per * f), power.off(still))


def costs(power: Consumption, drift: DriftFound, most_mps: float, speed_mps: float) -> Work[tuple[Metre, ...]]:
    """The same for each of DIRECTIONS."""
    found = list[Metre]()
    for index in range(DIRECTIONS):
        found.append(metre(power, drift, most_mps, speed_mps, 2.0 * math.pi * index / DIRECTIONS))
        yield 20
    return tuple(found)


def ahead_of(plan: Plan, leg: int) -> Work[tuple[tuple[Point, ...], float]]:
    """The places of a plan from this leg or piece on, and the mean of their speeds, m/s; an arc is two chords."""
    places, speeds_mps, all_of = list[Point](), 0.0, plan.waypoints or plan.path
    left = range(min(leg, len(all_of) - 1), len(all_of)) if all_of else range(0)
    for index in left:
        each = all_of[index]
        places += ((each.north_m, each.east_m),) if isinstance(each, Waypoint) else _ends(each)
        speeds_mps += each.speed_mps
        yield 1
    return tuple(places), speeds_mps / max(len(left), 1)


def _ends(piece: Line | Arc) -> tuple[Point, ...]:
    """The places of a piece of a path that its length is taken from."""
    if isinstance(piece, Line):
        return (piece.north_m, piece.east_m), (piece.to_north_m, piece.to_east_m)
    bearings = [piece.start_rad + part * piece.turn_rad for part in (0.0, 0.5, 1.0)]
    north_m, east_m, radius_m = piece.north_m, piece.east_m, piece.radius_m
    return tuple([(north_m + radius_m * math.cos(each), east_m + radius_m * math.sin(each)) for each in bearings])


def metres(way: tuple[Point, ...]) -> Work[tuple[float, ...]]:
    """The length of a way in each of DIRECTIONS, m, from its first point to its last."""
    lengths_m, per_rad = [0.0] * DIRECTIONS, DIRECTIONS / (2.0 * math.pi)
    for (north_m, east_m), (to_north_m, to_east_m) in pairwise(way):
        n, e = to_north_m - north_m, to_east_m - east_m
        if length_m := math.hypot(n, e):
            lengths_m[round(math.atan2(e, n) * per_rad) % DIRECTIONS] += length_m
        yield 1
    return tuple(lengths_m)


def joules(lengths_m: Sequence[float], by_direction: Sequence[Metre]) -> float:
    """The energy of a way, J."""
    return sum(length_m * each.joules for length_m, each in zip(lengths_m, by_direction, strict=True) if length_m)


def doubt(lengths_m: Sequence[float], by_direction: Sequence[Metre], drift: DriftFound) -> float:
    """The standard deviation of the energy of a way, J: what is not known of boat, water and wind, together along it."""
    known = [(m, each) for m, each in zip(lengths_m, by_direction, strict=True) if m and math.isfinite(each.joules)]
    by = [sum(m * each.by[index] for m, each in known) for index in range(6)]
    ways = [sum(a * b for a, b in zip(row, by, strict=True)) for row in drift.covariance]
    off_j, never_j = sum(m * each.joules * each.off for m, each in known), NEVER * sum(m * each.joules for m, each in known)
    return math.sqrt(max(sum(a * b for a, b in zip(ways, by, strict=True)), 0.0) + off_j * off_j + never_j * never_j)
