"""The ways that a decision compares, as straight legs: on along the route, and trials of another course and speed."""

import math
from typing import Final, NamedTuple

from delfim.base.geodesy import wrap
from delfim.parts.traffic.cpa import Leg
from delfim.parts.traffic.encounter import Own
from delfim.vehicle.plans.zones import Point
from delfim.vehicle.target import Target

LOOK_MAX_S: Final = 900.0
SWEPT_S: Final = 20.0  # the way of what moves is reckoned on for so long at most, until the boat is there
STOP_MORE_M: Final = 6.0  # a way past a swimmer, however narrow, keeps so much farther off than where the propellers stop


class Caution(NamedTuple):
    """The boat, and how cautious it is."""

    length_m: float
    turn_radps: float  # how fast it turns
    ramp_mps2: float  # how fast it changes its speed
    look_s: float = 180.0  # a vessel that is met later does not matter yet, unless leaving its domain takes long
    stand_on: str = "small"  # to which vessels that must give way: "never", "small" (below 20 m), "always"
    thing_clear_m: float = 10.0  # from its side to what stands
    person_clear_m: float = 30.0  # and to a swimmer
    person_stop_m: float = 8.0  # so near to one the propellers stop


class RouteAhead(NamedTuple):
    """The way ahead without other vessels."""

    points: tuple[Point, ...]  # nearest first; none: the boat stays where it is
    speed_mps: float  # asked for; of a boat that stays, what it may use
    has_end: bool = True  # False: a course, which a fence ends and does not bend
    place: Point | None = None  # where a boat stays that does not go on
    is_line: bool = False  # a line to be followed, which the boat takes again as soon as it can


def clear_m(limits: Caution, kind: str, part: float = 1.0) -> float:
    """How far the boat's side keeps from a thing of this kind, m, where there is room for this part of the distance."""
    if kind == "person":
        return max(part * limits.person_clear_m, limits.person_stop_m + STOP_MORE_M)
    return part * limits.thing_clear_m


def core(limits: Caution, thing: Target) -> float:
    """Where the middle of the boat cannot be: this near to the middle of a thing, m."""
    return thing.length_m / 2.0 + thing.margin_m + limits.length_m / 2.0


def swept(own: Own, speed_mps: float, thing: Target) -> Target:
    """What moves, as a circle about all places where it will be until a boat of this speed can be there."""
    if thing.speed_mps == 0.0:
        return thing
    far_m = math.hypot(thing.north_m - own.north_m, thing.east_m - own.east_m)
    half_m = thing.speed_mps * min(far_m / max(speed_mps, 0.1), SWEPT_S) / 2.0
    north_m = thing.north_m + half_m * math.cos(thing.course_rad)
    east_m = thing.east_m + half_m * math.sin(thing.course_rad)
    return thing._replace(north_m=north_m, east_m=east_m, margin_m=thing.margin_m + half_m)


def route_legs(own: Own, route: RouteAhead) -> list[Leg]:
    """The way along the route at the speed asked for; then the boat stays."""
    at, from_s, legs, speed_mps = (own.north_m, own.east_m), 0.0, list[Leg](), route.speed_mps
    for to in route.points if speed_mps > 0.05 else ():
        far_m = math.dist(at, to)
        if far_m < 0.1:
            continue
        to_s = from_s + far_m / speed_mps
        scale = speed_mps / far_m
        legs.append((from_s, to_s, *at, (to[0] - at[0]) * scale, (to[1] - at[1]) * scale))
        at, from_s = to, to_s
        if from_s > 2.0 * LOOK_MAX_S:
            break
    legs.append((from_s, math.inf, *at, 0.0, 0.0))
    return legs


def trial_legs(limits: Caution, own: Own, course_rad: float, speed_mps: float) -> tuple[Leg, Leg]:
    """Turning is a wait on the old course, half as long as the turn takes; so is a change of speed."""
    turn_s = abs(wrap(course_rad - own.course_rad)) / limits.turn_radps
    wait_s = 0.5 * max(turn_s, abs(speed_mps - own.speed_mps) / limits.ramp_mps2)
    vn, ve = own.speed_mps * math.cos(own.course_rad), own.speed_mps * math.sin(own.course_rad)
    first = (0.0, wait_s, own.north_m, own.east_m, vn, ve)
    there = own.north_m + vn * wait_s, own.east_m + ve * wait_s
    return first, (wait_s, math.inf, *there, speed_mps * math.cos(course_rad), speed_mps * math.sin(course_rad))
