"""The fence by plane geometry that is slow and obvious, as docs/failsafe.md defines it, from the zones as files have them."""

import math
from collections.abc import Sequence
from typing import Final

from delfim import config
from delfim.base import geodesy
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle.state import Motion

Point = tuple[float, float]
LEAVES_M: Final = 0.01  # a boat whose clearance shrinks by no more leaves a zone, or goes along it
BACK_MPS: Final = 0.1  # "as long as it comes nearer"
ROUNDING_M: Final = 1e-6


def to_side_m(p: Point, a: Point, b: Point) -> float:
    """Distance of a point from a straight stretch."""
    by_n, by_e = b[0] - a[0], b[1] - a[1]
    square = by_n * by_n + by_e * by_e
    t = ((p[0] - a[0]) * by_n + (p[1] - a[1]) * by_e) / square if square else 0.0
    t = min(max(t, 0.0), 1.0)
    return math.hypot(p[0] - a[0] - t * by_n, p[1] - a[1] - t * by_e)


class OneZone:
    """A polygon, or a circle of a centre and a radius, to stay in or out of."""

    def __init__(self, keep_in: bool, corners: Sequence[Point], radius_m: float) -> None:
        self.keep_in, self.radius_m, self.corners = keep_in, radius_m, tuple(corners)
        self.sides = list(zip(corners, [*corners[1:], corners[0]], strict=True)) if not radius_m else []

    def clear_m(self, p: Point) -> float:
        """Distance to the edge, negative where the boat may not be."""
        if self.radius_m:
            inside_m = self.radius_m - math.dist(p, self.corners[0])
            return inside_m if self.keep_in else -inside_m
        away_m = min([to_side_m(p, a, b) for a, b in self.sides])
        return away_m if self.holds(p) is self.keep_in else -away_m

    def holds(self, p: Point) -> bool:
        """Whether a point is inside a polygon: an odd number of its sides pass east of the point."""
        crossed = [
            a[1] + (b[1] - a[1]) * (p[0] - a[0]) / (b[0] - a[0]) for a, b in self.sides if (a[0] > p[0]) is not (b[0] > p[0])
        ]
        return sum(east > p[1] for east in crossed) % 2 == 1

    def least_m(self, a: Point, b: Point) -> float:
        """The smallest clearance on a straight way; not positive where it leads through forbidden water."""
        ends_m = min(self.clear_m(a), self.clear_m(b))
        if self.radius_m:
            return ends_m if self.keep_in else to_side_m(self.corners[0], a, b) - self.radius_m
        if ends_m <= 0.0:
            return ends_m
        if any(geodesy.segments_meet(a, b, *side) for side in self.sides):
            return 0.0
        return min(ends_m, *(to_side_m(corner, a, b) for corner in self.corners))


class PlainFence:
    """The zones in force."""

    def __init__(self, run: Lockstep) -> None:
        self._run, self.limits = run, run.settings.fence
        self._basis: tuple[object, ...] = ()
        self._zones: list[OneZone] | None = None
        self._clear: tuple[Point, float] | None = None  # a place, and its clearance

    def zones(self) -> list[OneZone] | None:
        """The zones; None: not known here, because several areas to stay in apply, of which any will do, or a chart."""
        plans, origin = self._run.vehicle.helm.plans, self._run.state.origin
        basis = plans.fence, origin, plans.zones
        if self._basis and all(one is other for one, other in zip(basis, self._basis, strict=True)):
            return self._zones
        self._basis, self._zones, self._clear = basis, [], None
        if plans.fence is None or not plans.fence.is_laid or origin is None:
            return self._zones
        for whose in (self.limits, plans.zones):
            if len(whose.keep_in) > 1 or self.limits.chart:
                self._zones = None
                return None
            self._zones += [_laid(True, area, origin) for area in whose.keep_in]
            self._zones += [_laid(False, area, origin) for area in whose.keep_out]
        return self._zones

    def is_near(self, motion: Motion) -> bool | None:
        """Whether the boat can no longer stop at the margin from a zone that it does not leave; None: not known here."""
        zones, limits = self.zones(), self.limits
        if zones is None or "velocity" not in motion.has:
            return None
        speed_mps, here = math.hypot(motion.north_mps, motion.east_mps), (motion.north_m, motion.east_m)
        if not zones or not speed_mps:
            return False
        room_m = speed_mps * limits.reaction_s + speed_mps**2 / (2.0 * limits.deceleration_mps2)
        if self._surely_m(here, zones) > room_m + limits.margin_m:
            return False
        end = here[0] + motion.north_mps / speed_mps * room_m, here[1] + motion.east_mps / speed_mps * room_m
        for zone in zones:
            least_m = zone.least_m(here, end)
            if least_m < limits.margin_m and least_m < zone.clear_m(here) - LEAVES_M:
                return True
        return False

    def is_outside(self, motion: Motion) -> bool | None:
        zones, here = self.zones(), (motion.north_m, motion.east_m)
        if zones is None:
            return None
        return bool(zones) and self._surely_m(here, zones) <= 0.0 and any(zone.clear_m(here) < 0.0 for zone in zones)

    def is_left(self, motion: Motion) -> bool | None:
        """Whether the boat is farther outside than the margin, and comes no nearer."""
        zones, here = self.zones(), (motion.north_m, motion.east_m)
        if zones is None:
            return None
        if not zones or self._surely_m(here, zones) > 0.0:
            return False
        soon = here[0] + motion.north_mps, here[1] + motion.east_mps
        for zone in zones:
            out_m = -zone.clear_m(here)
            if out_m > self.limits.margin_m and not ("velocity" in motion.has and -zone.clear_m(soon) < out_m - BACK_MPS):
                return True
        return False

    def blocks(self, motion: Motion, to: Point) -> bool | None:
        """Whether a straight way comes nearer to a zone than the margin and does not lead away from it."""
        zones, here, margin_m = self.zones(), (motion.north_m, motion.east_m), self.limits.margin_m
        if zones is None:
            return None
        least_m = [(zone.least_m(here, to), zone.clear_m(here)) for zone in zones]
        return any(least < margin_m and least < now - LEAVES_M for least, now in least_m)

    def _surely_m(self, here: Point, zones: Sequence[OneZone]) -> float:
        """A clearance that the boat certainly has: it loses no more than the distance that it sails."""
        if self._clear is not None and (least_m := self._clear[1] - math.dist(here, self._clear[0]) - ROUNDING_M) > 12.0:
            return least_m
        clear_m = min(zone.clear_m(here) for zone in zones)
        self._clear = here, clear_m
        return clear_m


def _laid(keep_in: bool, area: config.Area, at: geodesy.Origin) -> OneZone:
    places = area.polygon or area.centre
    corners = [geodesy.to_plane(at, math.radians(north), math.radians(east)) for north, east in places]
    return OneZone(keep_in, corners, area.radius_m)
