"""The way round zones, for goto: the shortest way along their corners on which each straight piece keeps its room.

A graph of what sees what (T. Lozano-Perez, M. A. Wesley, Communications of the ACM 22(10), 1979), searched by A*. Whether a
zone lies between two points is looked at only when the search comes to them, and corners count only of zones that were in the
way: a fence of a hundred zones costs little where two of them are. What a chart forbids has no corners: with one aboard the way
is found by `waterway.py`. Pure, in slices, in metres of the local plane.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from heapq import heappop, heappush
from typing import Final, NamedTuple

from delfim.base.cooperative import Sliced, Work
from delfim.vehicle.helm.setpoints import too_far
from delfim.vehicle.helm.waterway import Shut, way_through
from delfim.vehicle.plans import fence
from delfim.vehicle.plans.fence import RECEDES_M, Fence
from delfim.vehicle.plans.zones import LOOKS, Point, Zone, clearance_m, cost, least
from delfim.vehicle.state import Motion, Setpoint

FAN_RAD: Final = math.radians(60.0)
FAN: Final = 1.25  # radius of the points around a corner, in room: the way between two of them keeps the room
SHARP: Final = 2.0 * math.sin(math.radians(35.0))  # corners that turn by less have one point
ROUND: Final = 8  # points around a circle
SLICE: Final = 200  # comparisons of one step
MOST: Final = 100_000  # of one search: nobody waits longer than a minute
CHARTED_MOST: Final = 1_000_000  # with a chart of 10 km


class Detour(NamedTuple):
    """A search under way. `why`: what forbids the straight way, `who`: who asked for it, both in words."""

    work: Sliced[tuple[Point, ...] | Shut | None]
    setpoint: Setpoint
    why: str
    who: str
    most: int  # comparisons
    held: list[Iterable[object]]  # what the search is made of: whoever drops it lets it go bit by bit

    def step(self) -> tuple[Setpoint, str] | None:
        """A slice. The set points of goto, and how it came to them; without a target where there is no way. None: not yet."""
        is_done, to = self.work.step(SLICE), self.setpoint.target
        if not is_done and self.work.spent < self.most:
            return None
        by = self.work.result if is_done else Shut("the search took too long") if self.most > MOST else None
        if isinstance(by, Shut):
            return self.setpoint._replace(target=None), f"no way leads there, {by.why} ({self.why}): waits for another point"
        if by is None or to is None:
            return self.setpoint._replace(target=None), f"no way round is found ({self.why}): waits for another point"
        via = tuple(to._replace(north_m=north_m, east_m=east_m) for north_m, east_m in by)
        return self.setpoint._replace(via=via), f"{self.who}; by {len(via)} points, as {self.why}"


def begun(around: Fence | None, motion: Motion, setpoint: Setpoint, who: str, wide: Fence | None = None) -> Detour | None:
    """A search for goto. None: the straight way is free, or the target itself is refused. `wide`: the fence with the room that
    the straight way must have, if more than its margin."""
    to = setpoint.target
    if around is None or to is None or "position" not in motion.has:
        return None
    target = to.north_m, to.east_m
    why = fence.crossing(wide or around, motion, target)
    if why is None or too_far(target, motion):
        return None
    open_m, held = _open_m(around, target, to.speed_mps), list[Iterable[object]]()
    here = motion.north_m, motion.east_m
    return (
        Detour(Sliced(_widest(around, here, target, open_m, held)), setpoint, why, who, most(around), held) if open_m else None
    )


def most(around: Fence) -> int:
    """Comparisons of one search at most."""
    return MOST if all(zone.field is None for zone in around.zones) else CHARTED_MOST


def way_kept(
    around: Fence, a: Point, b: Point, speed_mps: float, held: list[Iterable[object]]
) -> Work[tuple[Point, ...] | Shut]:
    """The turns of a way for a boat at this speed, or why there is none. What the search is made of goes to `held`."""
    open_m = _open_m(around, b, speed_mps)
    yield sum(cost(zone, b) + 1 for zone in around.zones) * 3
    found = yield from _widest(around, a, b, open_m, held)
    return Shut("no way round is found") if found is None else found


def _open_m(around: Fence, to: Point, speed_mps: float) -> list[float]:
    """The rooms that a place has, of those to stop before what is ahead at each corner, of missions, and the least that the
    fence lets a boat keep."""
    limits = around.limits
    rooms_m = limits.margin_m + fence.stopping_m(limits, speed_mps), limits.mission_margin_m, limits.margin_m
    return [each for each in rooms_m if each >= limits.margin_m and _has_room(around, to, each)]


def _widest(
    around: Fence, a: Point, b: Point, rooms_m: Sequence[float], held: list[Iterable[object]]
) -> Work[tuple[Point, ...] | Shut | None]:
    """The way with the first of these rooms that there is one with."""
    field = next((zone.field for zone in around.zones if zone.field is not None), None)
    found: tuple[Point, ...] | Shut | None = None
    for room_m in rooms_m:
        if field is None:
            found = yield from way_round(around, a, b, room_m)
        else:
            found = yield from way_through(around, field, a, b, room_m, held)
        if isinstance(found, tuple):
            return found
    return found


def _has_room(around: Fence, at: Point, room_m: float) -> bool:
    """False, too, where that takes too many comparisons."""
    left = LOOKS
    for zone in around.zones:
        smallest, looked = least(zone, at, at, room_m)
        left -= looked
        if smallest < room_m or left < 0:
            return False
    return True


def way_round(around: Fence, a: Point, b: Point, room_m: float) -> Work[tuple[Point, ...] | None]:
    """The points between a and b; None: no way is found. From within the room around a zone the way may lead out."""
    points, sums, before, near = [a, b], dict[int, float](), dict[int, int](), set[int]()
    heap = [(math.dist(a, b), 0.0, 1, 0)]  # length of the way by here, length to here, point, point before
    sums[0] = 0.0
    while heap:
        _, length_m, at, came = heappop(heap)
        yield 1
        if at in sums:
            continue
        blocking = yield from _blocking(around, points[came], points[at], room_m, is_first=came == 0)
        if blocking is None:
            sums[at], before[at] = length_m, came
            if at == 1:
                return tuple(points[each] for each in _chain(before, came))
            links = [(at, to) for to in range(1, len(points)) if to not in sums]
        elif blocking not in near:
            near.add(blocking)
            first = len(points)
            for point in _corners(around.zones[blocking], room_m):
                yield 1 + cost(around.zones[blocking], point)
                if clearance_m(around.zones[blocking], *point) >= room_m:
                    points.append(point)
            links = [(done, to) for done in sums for to in range(first, len(points))]
        else:
            continue
        for begin, to in links:
            so_far_m = sums[begin] + math.dist(points[begin], points[to])
            heappush(heap, (so_far_m + math.dist(points[to], b), so_far_m, to, begin))
            yield 4  # so that what is left over stays small
    return None


def _chain(before: dict[int, int], at: int) -> list[int]:
    """The points before this one, from the first on, without the start."""
    found = list[int]()
    while at:
        found.append(at)
        at = before[at]
    return found[::-1]


def _blocking(around: Fence, a: Point, b: Point, room_m: float, is_first: bool) -> Work[int | None]:
    """The number of a zone that a straight way comes too near to; None: it keeps its room."""
    for number, zone in enumerate(around.zones):
        smallest, looked = least(zone, a, b, room_m)
        yield 1 + looked
        if looked > LOOKS or (smallest < room_m and not (is_first and smallest >= clearance_m(zone, *a) - RECEDES_M)):
            return number
    return None


def _corners(zone: Zone, room_m: float) -> Iterator[Point]:
    """Points to go by, around each corner that stands out into the water, some of them not in it."""
    for area in zone.areas or (zone,):
        if not area.sides:
            reach_m = FAN * room_m + area.radius_m / math.cos(math.pi / ROUND)
            for i in range(0 if area.keep_in else ROUND):
                turn = math.tau * i / ROUND
                yield area.north_m + reach_m * math.cos(turn), area.east_m + reach_m * math.sin(turn)
        after = (*area.sides[1:], *area.sides[:1])
        for (_, _, back_n, back_e, corner_n, corner_e), (_, _, on_n, on_e, _, _) in zip(area.sides, after, strict=True):
            back, on = math.hypot(back_n, back_e), math.hypot(on_n, on_e)
            out_n, out_e = back_n / back - on_n / on, back_e / back - on_e / on
            sharp = math.hypot(out_n, out_e)  # twice the sine of half the turn
            for turn in () if sharp < 1e-3 else (0.0,) if sharp < SHARP else (0.0, -FAN_RAD, FAN_RAD):
                bearing = math.atan2(out_e, out_n) + turn
                yield corner_n + FAN * room_m * math.cos(bearing), corner_e + FAN * room_m * math.sin(bearing)
