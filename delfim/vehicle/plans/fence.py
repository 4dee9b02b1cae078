"""The fence: where the boat may be (docs/failsafe.md). Pure, in metres of the local plane; no clock, no state.

Zones are not merged into one shape: each is checked by itself, so a gap between two keeps its width. A fence has up to 202
zones, two of them of up to 20 areas to stay in, so the check done ten times a second gives up after LOOKS comparisons, with the
safe answer.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from delfim import config
from delfim.base import geodesy
from delfim.base.cooperative import Work
from delfim.vehicle.plans import clearance
from delfim.vehicle.plans.zones import LOOKS, Point, Zone, charted, circle, clearance_m, cost, least, may, polygon, together
from delfim.vehicle.state import Motion

BOXES: Final = 4  # boxes that are compared in the time of one comparison
PARTS: Final = 1.0, 0.4  # of the radius to hold within, the next where no place has room for the one before
BACK_MPS: Final = 0.1  # a boat outside comes back if it is so much nearer each second
FAR_M: Final = 10.0  # from the place to hold, farther than a boat drifts that nobody leads away
RECEDES_M = 0.01  # a boat whose clearance shrinks by no more than this leaves a zone, or goes along it


class Fence(NamedTuple):
    """All zones in force, and the figures needed to obey them."""

    zones: tuple[Zone, ...]
    limits: config.FenceTable
    own: int = 0  # how many of the zones, the first ones, are the boat's own
    is_laid: bool = True  # False: the zones are not in the plane yet


def unlaid(limits: config.FenceTable, mission: config.Zones) -> Fence | None:
    """The fence before there is a local plane to lay it into. None: there is no fence."""
    if not (limits.keep_in or limits.keep_out or limits.chart or mission.keep_in or mission.keep_out):
        return None
    return Fence((), limits, is_laid=False)


def survey(
    limits: config.FenceTable,
    mission: config.Zones,
    at: geodesy.Origin,
    before: Fence | None = None,
    water: clearance.Water | None = None,
) -> Work[Fence | None]:
    """The boat's own zones, the mission's, and what the chart forbids, laid into the local plane. None: no fence. `before`: a
    fence in this plane, from which the boat's own are taken.
    """
    if unlaid(limits, mission) is None:
        return None
    zones = list(before.zones[: before.own]) if before is not None and before.is_laid else []
    if not zones:
        zones = yield from _laid("", limits, at)
    own = len(zones)
    zones += yield from _laid("mission's ", mission, at)
    if water is not None:
        zones.append(charted(water.name, clearance.laid(water, at)))
    return Fence(tuple(zones), limits, own)


def shut(around: Fence, water: clearance.Water, at: geodesy.Origin) -> Fence:
    """The same fence with this chart: the band is closed that the mission had opened."""
    kept = [zone for zone in around.zones if zone.field is None]
    return around._replace(zones=(*kept, charted(water.name, clearance.laid(water, at))))


def _laid(whose: str, zones: config.Zones, at: geodesy.Origin) -> Work[list[Zone]]:
    """The zones in the plane, those to stay in as one."""
    laid: dict[bool, list[Zone]] = {True: [], False: []}
    for keep_in, areas in ((True, zones.keep_in), (False, zones.keep_out)):
        for number, area in enumerate(areas, 1):
            name = area.name or f"{whose}keep-{'in' if keep_in else 'out'} zone {number}"
            zone = _zone(f"{whose}keep-in zone" if keep_in and len(areas) == 1 else name, keep_in, area, at)
            yield 1 + 2 * len(zone.sides)
            laid[keep_in].append(zone)
    inside = [together(f"{whose}keep-in zones", laid[True])] if laid[True] else []
    return [*inside, *laid[False]]


def _zone(name: str, keep_in: bool, area: config.Area, at: geodesy.Origin) -> Zone:
    places = (geodesy.to_plane(at, math.radians(north), math.radians(east)) for north, east in (*area.polygon, *area.centre))
    return polygon(name, keep_in, list(places)) if area.polygon else circle(name, keep_in, next(places), area.radius_m)


def stopping_m(limits: config.FenceTable, speed_mps: float) -> float:
    """The boat's stopping distance."""
    return speed_mps * limits.reaction_s + speed_mps * speed_mps / (2.0 * limits.deceleration_mps2)


def ahead(fence: Fence, motion: Motion) -> str | None:
    """Why the boat must stop now, in words: on its course it could no longer stop `margin_m` from a zone. None: it could, or
    it leaves that zone, or lies still where it may be. An unknown velocity is taken as the worst possible.
    """
    limits, here = fence.limits, (motion.north_m, motion.east_m)
    known = "velocity" in motion.has
    speed_mps = math.hypot(motion.north_mps, motion.east_mps) if known else 0.0
    if known and speed_mps == 0.0:
        return None
    room_m = stopping_m(limits, speed_mps)
    course = (motion.north_mps / speed_mps, motion.east_mps / speed_mps) if known else (0.0, 0.0)
    end = here[0] + course[0] * room_m, here[1] + course[1] * room_m
    left = LOOKS
    for zone in fence.zones:
        smallest, looked = least(zone, here, end, limits.margin_m)
        left -= looked
        if smallest < limits.margin_m:
            here_m = clearance_m(zone, *here)
            if not known:
                return f"{zone.name} {here_m:.1f} m away, velocity unknown"
            if smallest < here_m - RECEDES_M:
                return f"{zone.name} {max(here_m, 0.0):.1f} m away at {speed_mps:.1f} m/s"
            left -= cost(zone, here)
        if left < 0:
            return f"too many corners of zones close by to watch, {zone.name} among them: simplify the zones"
    return None


def outside(fence: Fence, north_m: float, east_m: float) -> str | None:
    """Which zone the boat violates now, in words."""
    left = LOOKS
    for zone in fence.zones:
        south, west, north, east = zone.box
        near = south <= north_m <= north and west <= east_m <= east
        if not near and not zone.keep_in:
            continue
        if may(zone, north_m, east_m):
            left -= len(zone.parts) + len(zone.areas)
            if left < 0:
                return f"in more zones than can be watched, {zone.name} among them: use fewer zones"
            continue
        clear_m = clearance_m(zone, north_m, east_m)
        if clear_m < 0.0:
            return f"{-clear_m:.1f} m {'outside the' if zone.keep_in else 'inside'} {zone.name}"
    return None


def left(fence: Fence, motion: Motion) -> str | None:
    """Which zone the boat violates by more than the margin without coming nearer to where it may be, in words."""
    here, looked = (motion.north_m, motion.east_m), 0
    for zone in fence.zones:
        south, west, north, east = zone.box
        if not zone.keep_in and not (south <= here[0] <= north and west <= here[1] <= east):
            continue
        looked += len(zone.parts) + len(zone.areas)
        if not may(zone, *here):
            out_m = -clearance_m(zone, *here)
            soon_m = -clearance_m(zone, here[0] + motion.north_mps, here[1] + motion.east_mps)
            comes_back = "velocity" in motion.has and soon_m < out_m - BACK_MPS
            if out_m > fence.limits.margin_m and not comes_back:
                return f"{out_m:.1f} m {'outside the' if zone.keep_in else 'inside'} {zone.name} and not coming back"
            looked += 2 * cost(zone, here)
        if looked > LOOKS:
            break
    return None


def place_to_hold(fence: Fence, at: Point, here: Point, track: Sequence[Point], radius_m: float) -> Work[tuple[Point, float]]:
    """Where to hold so that drifting within `radius_m` keeps the margin: here, or else at the newest place of the
    driven track (oldest first) with this room; where no place has it, the same within a smaller part of the radius, which is
    the second part of the answer, and at last here. The boat goes there in a straight line from `at`, which must not lead
    nearer to a zone: the track may have led around it.
    """
    for part in PARTS:
        for point in (here, *reversed(track)):
            roomy, looked = has_room(fence, point, part * radius_m + fence.limits.margin_m)
            if roomy:
                leads, more = is_clear(fence, at, point)
                if leads:
                    return point, part
                looked += more
            yield 2 * looked  # an expensive one has a slice to itself
    return here, PARTS[-1]


def is_clear(fence: Fence, at: Point, to: Point) -> tuple[bool, int]:
    """Whether the straight way keeps the margin, or where `at` is nearer leads away; and how many comparisons it took. False
    when it takes too many."""
    looked = 0
    for number, zone in enumerate(fence.zones, 1):
        smallest, more = least(zone, at, to, fence.limits.margin_m)
        looked += more
        leads_nearer = smallest < fence.limits.margin_m and smallest < clearance_m(zone, *at) - RECEDES_M
        if leads_nearer or looked > LOOKS:
            return False, looked + number // BOXES + 1
    return True, looked


def has_room(fence: Fence, point: Point, room_m: float) -> tuple[bool, int]:
    """Whether all zones are this far away, and how many comparisons it took. False when it takes too many."""
    looked = 0
    for number, zone in enumerate(fence.zones, 1):
        smallest, more = least(zone, point, point, room_m)
        looked += more
        if smallest < room_m or looked > LOOKS:
            return False, looked + number // BOXES + 1
    return True, looked


def crossing(fence: Fence, motion: Motion, to: Point | None) -> str | None:
    """Why the fence forbids the straight way to where a mode first goes, in words. Within the margin it may lead away."""
    if to is None:
        return None
    here, left = (motion.north_m, motion.east_m), LOOKS
    for zone in fence.zones:
        smallest, looked = least(zone, here, to, fence.limits.margin_m)
        if smallest < fence.limits.margin_m and smallest < clearance_m(zone, *here) - RECEDES_M:
            return f"the way leads {through(zone, smallest)}"
        left -= looked
        if left < 0:
            return f"the way passes too many corners of zones, {zone.name} among them: go there in shorter stretches"
    return None


def cuts_off(fence: Fence | None, motion: Motion, place: Point) -> bool:
    """Whether a zone is on the straight way back to a place that the boat is far away from."""
    is_far = math.dist(place, (motion.north_m, motion.east_m)) > FAR_M
    return fence is not None and is_far and crossing(fence, motion, place) is not None


def through(zone: Zone, least: float) -> str:
    return f"{least:.1f} m past {zone.name}" if least > 0.0 else f"{'out of the' if zone.keep_in else 'through'} {zone.name}"
