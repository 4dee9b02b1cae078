"""The way past things that stand, and swimmers: the shortest one round circles about them.

A thing has no course that a rule could speak of, so it bends the route, and ships are judged along the bent one. The search is
A* over the tangents of the circles (visibility graph, made as it is needed), with those nodes alone that something in the way
asks for; a way over the fence is none. Where there is no way at the full distance, one at half of it is taken, slowly; where
there is none either the boat stops before it, and says so. Pure; in slices; bounded by SPENT comparisons.
"""

import math
from collections.abc import Collection, Sequence
from heapq import heappop, heappush
from typing import Final, NamedTuple

from delfim.base.cooperative import Work
from delfim.base.geodesy import wrap
from delfim.parts.traffic.encounter import Own
from delfim.parts.traffic.trialways import Caution, RouteAhead, clear_m, core, swept
from delfim.vehicle.plans.fence import RECEDES_M, Fence
from delfim.vehicle.plans.zones import Point, clearance_m, cost, least
from delfim.vehicle.target import CourseOrder, Target

PARTS: Final = (1.0, 0.5, 0.2)  # of the distance to keep
SLOW: Final = 0.5  # of the speed, where it is less
SOON_S, SOON_M = 120.0, 60.0  # what is farther along the route, by time and at least, does not matter yet
ROOM_M, KEEPS_M = 1.0, 0.5  # a way keeps so much farther off; one that is sailed may be so much nearer, within that
STOPS_M, STOPS_S = 8.0, 4.0  # so far before a place without a way past it the boat stops, and so long before
ROUND_RAD: Final = math.pi / 8.0  # half the angle of one tangent to the next on a circle
SWITCH_M: Final = 8.0  # another side of a thing than before must be nearer by so much
NARROW_M: Final = 60.0  # so much longer a way may be that keeps the full distance
TURNS, TURNS_RAD = 0.1, math.radians(50.0)  # part of the speed, near a thing, while the boat has to turn by more than this
IN_M: Final = 2.0  # so far inside of a circle the boat goes slowly
STAYS_M: Final = 20.0  # so near to a narrow place it is gone through
EXIT_M: Final = 5.0  # beyond what is in the way a survey's line is taken again
NEAR_M: Final = 2.0  # a point of the way so near is passed
SPENT: Final = 8000  # comparisons of the searches of one decision, ...
LEAST: Final = 1000  # ... and of each
CIRCLES: Final = 6  # that take the time of one comparison
ZONES: Final = 5  # far ones, likewise

Circle = tuple[float, float, float]  # north_m, east_m, radius_m
Label = tuple[int, int]  # a circle, and the side on which it is left: 1 to port, -1 to starboard of the boat


class Passage(NamedTuple):
    """The way past what is in the way."""

    points: tuple[Point, ...]  # from the boat on, past the things and along the rest of the route; empty: there is none
    key: str  # of the thing that is met first
    words: str
    part: float  # of the speed that is asked for; 0: it stops
    sides: frozenset[tuple[str, int]] = frozenset()  # of the things that it rounds
    is_narrow: bool = False  # it does not keep the full distance

    def route(self, route: RouteAhead) -> RouteAhead:
        """The route that leads along it."""
        return route._replace(points=self.points or route.points, speed_mps=max(self.part, SLOW) * route.speed_mps)

    def order(self, own: Own, speed_mps: float, now_s: float) -> CourseOrder:
        """The course along it, of a boat that is asked for this speed."""
        north_m, east_m = next((each for each in self.points if math.dist(each, own[:2]) > NEAR_M), (own[0], own[1]))
        is_on = (north_m, east_m) != (own.north_m, own.east_m)
        course_rad = math.atan2(east_m - own.east_m, north_m - own.north_m) if is_on else own.course_rad
        part = min(self.part, TURNS if abs(wrap(course_rad - own.course_rad)) > TURNS_RAD and self.part < 1.0 else 1.0)
        return CourseOrder(course_rad, part, part * speed_mps, self.words, self.key, 1.0, now_s)


def past(
    limits: Caution, own: Own, route: RouteAhead, things: Sequence[Target], around: Fence | None, was: Passage | None
) -> Work[Passage | None]:
    """The way past the things that are soon met on the route; None: it is clear. `was`: that of the decision before."""
    if not (things and route.points and route.speed_mps > 0.05):
        return None
    things = [swept(own, route.speed_mps, each) for each in things]
    yield len(things)
    here, soon_m = (own.north_m, own.east_m), max(SOON_S * route.speed_mps, SOON_M)
    less_m, sides = (0.0, frozenset[tuple[str, int]]()) if was is None else (KEEPS_M, was.sides)
    kept = {(i, side) for i, each in enumerate(things) for side in (1, -1) if (each.key, side) in sides}
    circles = _circles(limits, here, things, PARTS[0], less_m)
    yield len(things)
    first = yield from _met(here, route.points, circles, 2.0 * less_m, soon_m)
    if first is None:
        return None
    leg, along_m, number = first
    if leg and not (route.is_line and along_m < STAYS_M):
        return None  # that leg is not sailed yet
    found, thing, left = list[tuple[float, Passage]](), things[number], SPENT
    is_in = any(_is_ahead(own, each, core(limits, each) + clear_m(limits, each.kind) - IN_M) for each in things)
    is_late = was is not None and was.is_narrow and along_m < STAYS_M  # there is no other way any more
    for part in PARTS[is_late:]:
        if part < 1.0:
            circles = _circles(limits, here, things, part, less_m)
            yield len(things)
        goal = (yield from _beyond((here, *route.points), leg, circles)) if route.is_line else None
        rest = route.points[leg + (goal is None) :]
        goal = goal or route.points[leg]
        way, spent = yield from _way(here, goal, _about(limits, things, circles, goal), around, kept, max(left, LEAST))
        left -= spent
        if way is None:
            continue
        long_m, points, labels = way
        labels = labels or [each for each in kept if each[0] == number]  # it is nearly past
        side = next((side for i, side in labels if i == number), labels[0][1] if labels else 1)
        long_m += NARROW_M if part < 1.0 else 0.0
        is_slow = is_in or (part < 1.0 and along_m < NARROW_M)
        passage = _passage((*points, *rest), thing, side, part < 1.0, is_slow)
        found.append((long_m, passage._replace(sides=frozenset((things[i].key, side) for i, side in labels))))
        if part < 1.0 or left <= 0 or long_m < 1.2 * math.dist(here, goal) + NARROW_M:
            break
    if found:
        return min(found)[1]
    if along_m > STOPS_M + STOPS_S * own.speed_mps:
        return None
    return Passage((), thing.key, f"keeping clear of {thing.name}{_what(thing)}, no way past it, stopped", 0.0)


def _passage(points: tuple[Point, ...], thing: Target, side: int, is_narrow: bool, is_slow: bool) -> Passage:
    """A way past a thing that is left on this side."""
    how = "where it is narrow" if is_narrow else f"leaving it to {'port' if side > 0 else 'starboard'}"
    words = f"keeping clear of {thing.name}{_what(thing)}, {how}{', at half speed' if is_slow else ''}"
    return Passage(points, thing.key, words, SLOW if is_slow else 1.0, is_narrow=is_narrow)


def _what(thing: Target) -> str:
    if thing.kind == "person":
        return ", a swimmer"
    return ", which drifts" if thing.speed_mps else ", which stands"


def _is_ahead(own: Own, thing: Target, within_m: float) -> bool:
    """Whether a thing is so near, and not left behind: what moves may be faster than the boat is slowly."""
    north_m, east_m = thing.north_m - own.north_m, thing.east_m - own.east_m
    if math.hypot(north_m, east_m) >= within_m:
        return False
    return thing.speed_mps == 0.0 or north_m * math.cos(own.course_rad) + east_m * math.sin(own.course_rad) >= 0.0


def _circles(limits: Caution, here: Point, things: Sequence[Target], part: float, less_m: float) -> list[Circle]:
    """The circles to keep out of. From within one the boat may go on, but no farther in, and not into that of the next part."""
    found, least = list[Circle](), {PARTS[0]: PARTS[1], PARTS[1]: PARTS[2]}.get(part, 0.0)
    for each in things:
        core_m, keeps_m = core(limits, each) - less_m, clear_m(limits, each.kind, part)
        away_m = math.hypot(each.north_m - here[0], each.east_m - here[1]) - 0.1
        radius_m = min(core_m + keeps_m, max(away_m, core_m + clear_m(limits, each.kind, least) if least else 0.0))
        found.append((each.north_m, each.east_m, radius_m))
    return found


def _about(limits: Caution, things: Sequence[Target], circles: Sequence[Circle], goal: Point) -> list[Circle]:
    """The circles, made smaller where the goal lies in one and the boat can be there without touching."""
    found = list[Circle]()
    for thing, (north_m, east_m, radius_m) in zip(things, circles, strict=True):
        away_m = math.hypot(north_m - goal[0], east_m - goal[1]) - 0.1
        found.append((north_m, east_m, away_m if core(limits, thing) <= away_m < radius_m else radius_m))
    return found


def _met(
    here: Point, points: Sequence[Point], circles: Sequence[Circle], more_m: float, until_m: float
) -> Work[tuple[int, float, int] | None]:
    """(leg, m along the route, circle): where the route first enters a circle, before this many metres; None: nowhere."""
    a, sailed_m = here, 0.0
    for leg, b in enumerate(points):
        if sailed_m >= until_m:
            break
        far_m = math.dist(a, b)
        first = (until_m - sailed_m, -1)
        for number, each in enumerate(circles):
            into = _chord(a, b, each, more_m)
            if into is not None and into[0] < first[0]:
                first = into[0], number
        yield len(circles) // CIRCLES + 1
        if first[1] >= 0:
            return leg, sailed_m + first[0], first[1]
        a, sailed_m = b, sailed_m + far_m
    return None


def _chord(a: Point, b: Point, circle: Circle, more_m: float = 0.0) -> tuple[float, float] | None:
    """From where to where on the way from a to b, m, it is in a circle; leading away from one it is not."""
    far_m = math.dist(a, b)
    if far_m < 0.01:
        return None
    by_n, by_e = (b[0] - a[0]) / far_m, (b[1] - a[1]) / far_m
    n, e, radius_m = circle[0] - a[0], circle[1] - a[1], circle[2] + more_m
    along_m, across_m = n * by_n + e * by_e, n * by_e - e * by_n
    if along_m <= 0.0 or abs(across_m) >= radius_m:
        return None
    half_m = math.sqrt(radius_m * radius_m - across_m * across_m)
    return (max(along_m - half_m, 0.0), min(along_m + half_m, far_m)) if along_m - half_m < far_m else None


def _beyond(points: Sequence[Point], leg: int, circles: Sequence[Circle]) -> Work[Point | None]:
    """Where a route, from the boat on, is clear again that enters a circle on this leg; None: before its end nowhere."""
    at_m = math.inf
    for i in range(leg, len(points) - 1):
        a, b = points[i], points[i + 1]
        chords = sorted(each for circle in circles if (each := _chord(a, b, circle)) is not None)
        yield len(circles) // CIRCLES + 1
        at_m = (chords[0][0] if chords else 0.0) if i == leg else 0.0
        for first_m, last_m in chords:
            if first_m <= at_m + EXIT_M:
                at_m = max(at_m, last_m)
        far_m = math.dist(a, b)
        if at_m + EXIT_M < far_m:
            part = (at_m + EXIT_M) / far_m
            return a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1])
    return None


def _blocks(a: Point, b: Point, circles: Sequence[Circle]) -> int:
    """The circle that the straight way from a to b meets first; -1: none."""
    (a_n, a_e), by_n, by_e = a, b[0] - a[0], b[1] - a[1]
    far2 = by_n * by_n + by_e * by_e
    found, first = -1, math.inf
    if far2 < 1e-6:
        return found
    for number, (n, e, radius_m) in enumerate(circles):
        n, e = n - a_n, e - a_e
        along, across = n * by_n + e * by_e, n * by_e - e * by_n
        if along <= 0.0 or across * across >= radius_m * radius_m * far2:
            continue
        along /= far2
        if along < first and (along <= 1.0 or math.hypot(n - by_n, e - by_e) < radius_m):
            found, first = number, along
    return found


def _tangent(p: Point, circle: Circle, side: int) -> Point:
    """The point behind a circle on its tangent from p, where the next tangent begins. `side` 1: the circle is to port."""
    north_m, east_m, radius_m = circle[0] - p[0], circle[1] - p[1], circle[2] + ROOM_M
    away_m = math.hypot(north_m, east_m)
    is_in = away_m <= radius_m
    turn_rad = math.radians(100.0) if is_in else math.asin(radius_m / away_m)
    long_m = (0.0 if is_in else math.sqrt(away_m * away_m - radius_m * radius_m)) + radius_m * math.tan(ROUND_RAD)
    course_rad = math.atan2(east_m, north_m) + side * turn_rad
    return p[0] + long_m * math.cos(course_rad), p[1] + long_m * math.sin(course_rad)


def _way(
    start: Point, goal: Point, circles: Sequence[Circle], around: Fence | None, kept: Collection[Label], most: int
) -> Work[tuple[tuple[float, list[Point], list[Label]] | None, int]]:
    """(m, points, circles rounded): the shortest way; None: there is none. And what the search cost. `kept`: on which sides the
    boat went before. Where it takes more than `most`, the way to the most hopeful place, and from there straight on."""
    nodes = [(start, -1, (-1, 0))]
    ends: Label = (-1, 1)
    heap, best, spent = [(math.dist(start, goal), 0, 0.0)], dict[tuple[int, int, int], float](), 0
    while heap:
        _, i, long_m = heappop(heap)
        p, _, label = nodes[i]
        if label == ends or spent > most:
            return (long_m + math.dist(p, goal), *_back(nodes, i)), spent
        aims, seen = [(goal, ends)], set[Label]()
        while aims:
            to, its = aims.pop()
            number, looked = _blocks(p, to, circles), len(circles) // CIRCLES + 2
            if number >= 0:
                both = [(number, side) for side in (1, -1) if (number, side) not in seen]
                seen.update(both)
                aims += [(_tangent(p, circles[number], side), (number, side)) for number, side in both]
            else:
                is_clear, more = _keeps(around, p, to)
                looked += more
                if is_clear:
                    far_m = long_m + math.dist(p, to)
                    if i == 0 and kept and its != ends and its not in kept:
                        far_m += SWITCH_M
                    place = (*its, _octant(to, circles[its[0]]) if its != ends else 0)
                    if far_m < best.get(place, math.inf) - 1e-6:
                        best[place] = far_m
                        nodes.append((to, i, its))
                        heappush(heap, (far_m + math.dist(to, goal), len(nodes) - 1, far_m))
            spent += looked
            yield looked
    return None, spent


def _octant(at: Point, circle: Circle) -> int:
    return int((wrap(math.atan2(at[1] - circle[1], at[0] - circle[0])) + math.pi) / (math.pi / 4.0))


def _back(nodes: Sequence[tuple[Point, int, Label]], i: int) -> tuple[list[Point], list[Label]]:
    """The points of the way to a node, without its start, and the circles that it rounds."""
    points, labels = list[Point](), list[Label]()
    while nodes[i][1] >= 0:
        point, before, label = nodes[i]
        points.append(point)
        if label[0] >= 0:
            labels.append(label)
        i = before
    return points[::-1], labels[::-1]


def _keeps(around: Fence | None, a: Point, b: Point) -> tuple[bool, int]:
    """Whether a straight way keeps the fence's margin for missions, or leads away from where it does not; and the comparisons
    that it took."""
    if around is None:
        return True, 0
    margin_m, looked = max(around.limits.mission_margin_m, around.limits.margin_m), 0
    for zone in around.zones:
        smallest, more = least(zone, a, b, margin_m)
        looked += more
        if smallest < margin_m:
            looked += cost(zone, a)
            if smallest < clearance_m(zone, *a) - RECEDES_M:
                return False, looked + 1
    return True, looked + len(around.zones) // ZONES
