"""What a way costs, and how far the boat can go, by direction: the current makes one way cheap and the other dear."""

import math
from itertools import pairwise
from typing import Final

from delfim.base.cooperative import Work
from delfim.parts.energy.consumption import Consumption
from delfim.parts.energy.drift import DriftFound, over_ground_mps, still_mps
from delfim.vehicle.state import Arc, Line, Plan, Waypoint

DIRECTIONS: Final = 36  # of the shape on the map, from north clockwise
SLOW_MPS: Final = 0.1  # a way on which the boat is slower over ground is none

Point = tuple[float, float]  # north_m, east_m


def joules_per_m(power: Consumption, drift: DriftFound, most_mps: float, speed_mps: float, course_rad: float) -> float:
    """The energy of a metre over ground on this course, J/m, at this speed over ground, or at what is left of it where the push
    for `most_mps` in still water is all that the boat has. Infinite where it makes no way."""
    still = still_mps(drift, speed_mps, course_rad)
    if still > most_mps:
        still = most_mps
        speed_mps = min(speed_mps, over_ground_mps(drift, still, course_rad))
    return power.watts(still) / speed_mps if speed_mps >= SLOW_MPS else math.inf


def costs(power: Consumption, drift: DriftFound, most_mps: float, speed_mps: float) -> Work[tuple[float, ...]]:
    """The same for each of DIRECTIONS."""
    found = list[float]()
    for index in range(DIRECTIONS):
        found.append(joules_per_m(power, drift, most_mps, speed_mps, 2.0 * math.pi * index / DIRECTIONS))
        yield 10
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


def along(way: tuple[Point, ...], by_direction: tuple[float, ...]) -> Work[float]:
    """The energy of a way, J, from its first point to its last."""
    joules, per_rad = 0.0, DIRECTIONS / (2.0 * math.pi)
    for (north_m, east_m), (to_north_m, to_east_m) in pairwise(way):
        n, e = to_north_m - north_m, to_east_m - east_m
        if length_m := math.hypot(n, e):
            joules += length_m * by_direction[round(math.atan2(e, n) * per_rad) % DIRECTIONS]
        yield 1
    return joules
