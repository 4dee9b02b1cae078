"""Selects the vessels that the guard judges, where there are more than it has time for: those that the boat would meet, the
first of them first, and then those that could be met. Pure; in slices."""

import math
from collections.abc import Sequence
from heapq import nsmallest
from typing import Final

from delfim.base.cooperative import Work
from delfim.parts.traffic.cpa import passing_by
from delfim.parts.traffic.encounter import Own
from delfim.parts.traffic.keepclear import MOST, PASS, SLOWEST_MPS, SOFT, Choice, measured, plausible
from delfim.parts.traffic.trialways import Caution, RouteAhead, route_legs, trial_legs
from delfim.vehicle.target import Target

ASKED: Final = 2 * PASS  # comparisons that one vessel costs


def judged(
    limits: Caution, own: Own, route: RouteAhead, choice: Choice | None, targets: Sequence[Target]
) -> Work[tuple[Sequence[Target], str]]:
    """Select MOST vessels at most; and report in words if the boat would meet more than that, along its route or on the course
    that it was given. Harmless ones about hide nobody."""
    if len(targets) <= MOST or not plausible(*own, *(each for point in route.points for each in point)):
        return targets, ""
    ways, ranked = [route_legs(own, route)], list[tuple[float, float, int]]()
    if choice is not None:
        ways.append([*trial_legs(limits, own, choice.course_rad, choice.part * route.speed_mps)])
    for number, target in enumerate(targets):
        yield ASKED
        if not plausible(*target[2:6], target.length_m):
            continue
        around, look_s, _, _ = measured(limits, own, route.speed_mps, target)
        met_s = math.inf
        for way in ways:
            nearness, at_s, _, _ = passing_by(around, way, 2.0 * look_s)
            if nearness < SOFT and at_s < met_s:
                met_s = at_s
        far_m = math.hypot(target.north_m - own.north_m, target.east_m - own.east_m)
        ranked.append((met_s, far_m / (target.speed_mps + own.speed_mps + SLOWEST_MPS), number))
    first, met = [targets[number] for _, _, number in nsmallest(MOST, ranked)], sum(met_s < math.inf for met_s, _, _ in ranked)
    return first, f"{met} vessels in the way at once: the boat heeds the {MOST} that it meets first" if met > MOST else ""
