"""The fence for trial manoeuvres: whether a way leads too near to a zone. Bounded: with too many corners about, a way is taken
to lead there."""

import math
from collections.abc import Sequence
from typing import Final

from delfim.parts.traffic.cpa import Leg
from delfim.parts.traffic.encounter import Own
from delfim.vehicle.plans.fence import RECEDES_M, Fence, stopping_m
from delfim.vehicle.plans.zones import apart, clearance_m, cost, least

LOOKS: Final = 600  # comparisons for all trials of a decision, about a microsecond each


class Shoreline:
    """The zones within reach of the boat, for one decision."""

    def __init__(self, around: Fence, own: Own, reach_m: float) -> None:
        self.limits, self.name = around.limits, ""  # of the zone that a way met last
        self._left = LOOKS
        here = own.north_m, own.east_m
        room_m = reach_m + stopping_m(around.limits, own.speed_mps) + around.limits.mission_margin_m
        zones = (zone for zone in around.zones if zone.keep_in or not apart(zone.box, here, here, room_m))
        self._zones = [(zone, clearance_m(zone, *here)) for zone in zones]

    def meets(self, legs: Sequence[Leg], until_s: float, is_route: bool) -> bool:
        """Whether the boat, with the way that it needs to stop, comes nearer to a zone than the margin: on a route that of the
        fence, on a trial that of missions. From within the margin it may lead away."""
        limits = self.limits
        margin_m = limits.margin_m if is_route else max(limits.mission_margin_m, limits.margin_m)
        for from_s, to_s, north_m, east_m, north_mps, east_mps in legs:
            if from_s >= until_s or not self._zones:
                break
            for_s, speed_mps = min(to_s, until_s) - from_s, math.hypot(north_mps, east_mps)
            if speed_mps and not is_route:
                for_s += stopping_m(limits, speed_mps) / speed_mps
            a, b = (north_m, east_m), (north_m + north_mps * for_s, east_m + east_mps * for_s)
            for zone, here_m in self._zones:
                if here_m > margin_m + math.dist(a, b) + math.dist(a, legs[0][2:4]):
                    continue
                smallest, looked = least(zone, a, b, margin_m)
                self._left -= looked + cost(zone, a)
                if self._left < 0 or (smallest < margin_m and smallest < here_m - RECEDES_M):
                    self.name = zone.name
                    return True
        return False
