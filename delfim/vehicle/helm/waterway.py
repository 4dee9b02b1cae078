"""The way through water that a chart leaves free, among the zones of a fence: the shortest that straight pieces can make.

The water is cut into squares, smaller ones near to what is forbidden, each looked at when the search first comes to it. The
search goes from square to square and looks back to the last turn that can be seen (Lazy Theta*: A. Nash, S. Koenig, C. Tovey,
AAAI 2010); then the way is pulled tight. Two waters that the chart parts are told at once; zones may part them, so the water
about the target is filled at the same time: where it is a pond the search would look at all the sea before it says so. Pure, in
slices, in metres of the local plane.
"""

import math
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from typing import Final

from delfim.base.cooperative import Work
from delfim.vehicle.plans.clearance import ClearanceField
from delfim.vehicle.plans.fence import RECEDES_M, Fence
from delfim.vehicle.plans.zones import Point, apart, clearance_m, cost, least

SMALLEST: Final = 1.25  # side of a square, in cells of the chart's field, at most
LEVELS: Final = 12  # how often the field is halved at most
LOOK_M: Final = 2.0  # between two looks along a way
SEEN: Final = 20  # looks in one slice
REACH: Final = 12  # smallest squares, from a place to the first square that is free
PULLS: Final = 4  # times that each turn is pulled
HALVINGS: Final = 5
PONDS: Final = 400  # squares: a greater water about the target is no pond
SLACK: Final = 0.03  # of a clearance, by which its neighbours may be told too small

Square = tuple[int, int, int]  # level, row, column, from the south and west of the field
A: Final[Square] = (-1, 0, 0)
B: Final[Square] = (-1, 0, 1)


@dataclass(frozen=True, slots=True)
class Shut:
    """There is no way: why, in words."""

    why: str


class Waters:
    """The squares about a field, for one room."""

    def __init__(self, around: Fence, field: ClearanceField, room_m: float) -> None:
        self._zones = [zone for zone in around.zones if zone.field is not field]
        self.field, self.room_m = field, room_m
        grid = max(field.grids, key=lambda each: each.rows / each.by_north)
        self.side_m = max(grid.rows / grid.by_north, grid.columns / grid.by_east)
        self._south_m, self._west_m = -grid.from_north / grid.by_north, -grid.from_east / grid.by_east
        self._small_m = SMALLEST * max(1.0 / grid.by_north, 1.0 / grid.by_east)
        fine = field.grids[0]
        south_m, west_m = -fine.from_north / fine.by_north, -fine.from_east / fine.by_east
        self._fine = south_m, west_m, south_m + fine.rows / fine.by_north, west_m + fine.columns / fine.by_east
        self._fine_m = SMALLEST * max(1.0 / fine.by_north, 1.0 / fine.by_east)
        self.deepest = min(max(math.ceil(math.log2(self.side_m / self._fine_m)), 0), LEVELS)
        self.squares = dict[Square, bool | None]()  # None: it is divided
        self.spent = 0

    def middle(self, square: Square) -> Point:
        level, row, column = square
        side_m = self.side_m / (1 << level)
        return self._south_m + (row + 0.5) * side_m, self._west_m + (column + 0.5) * side_m

    def free(self, square: Square) -> bool | None:
        """Whether the boat may be anywhere in it, or nowhere; None: look at its quarters."""
        if square in self.squares:
            return self.squares[square]
        side_m, at = self.side_m / (1 << square[0]), self.middle(square)
        half_m, (south, west, north, east) = side_m * math.sqrt(0.5), self._fine
        is_fine = south <= at[0] <= north and west <= at[1] <= east
        deepest = side_m <= (self._fine_m if is_fine else self._small_m) or square[0] >= self.deepest
        clear_m = self._clear_m(at, self.room_m + half_m)
        if clear_m >= self.room_m + (0.0 if deepest else half_m + SLACK * clear_m):
            found = True
        elif deepest or clear_m < self.room_m - side_m - SLACK * abs(clear_m):
            found = False
        else:
            found = None
        self.squares[square] = found
        return found

    def _clear_m(self, at: Point, within_m: float) -> float:
        smallest = self.field.clear_m(*at)
        self.spent += 3
        for zone in self._zones:
            if zone.keep_in or not apart(zone.box, at, at, within_m):
                smallest = min(smallest, clearance_m(zone, *at))
                self.spent += 1 + cost(zone, at)
        return smallest

    def holding(self, at: Point) -> Square | None:
        """The undivided square about a place."""
        up, right = (at[0] - self._south_m) / self.side_m, (at[1] - self._west_m) / self.side_m
        if not (0.0 <= up < 1.0 and 0.0 <= right < 1.0):
            return None
        return self.undivided((self.deepest, int(up * (1 << self.deepest)), int(right * (1 << self.deepest))))

    def undivided(self, within: Square) -> Square:
        """The undivided square about one of the smallest, or about any other that is not divided."""
        deepest, row, column = within
        for level in range(deepest + 1):
            square = level, row >> (deepest - level), column >> (deepest - level)
            if self.free(square) is not None:
                break
        return square

    def beside(self, square: Square) -> Iterator[Square]:
        """The free squares that touch one by a side."""
        level, row, column = square
        most = 1 << level
        for up, right in ((1, 0), (0, 1), (-1, 0), (0, -1)):
            if not (0 <= row + up < most and 0 <= column + right < most):
                continue
            found = self.undivided((level, row + up, column + right))
            if self.free(found) is not None:
                if self.free(found):
                    yield found
                continue
            left = [found]
            while left:
                deep, south, west = left.pop()
                south, west = 2 * south, 2 * west
                rows = (south,) if up > 0 else (south + 1,) if up < 0 else (south, south + 1)
                columns = (west,) if right > 0 else (west + 1,) if right < 0 else (west, west + 1)
                for part in ((deep + 1, a, b) for a in rows for b in columns):
                    state = self.free(part)
                    if state is None:
                        left.append(part)
                    elif state:
                        yield part

    def sees(self, a: Point, b: Point, is_first: bool = False) -> Work[bool]:
        """Whether the straight way keeps its room; at the beginning of all ways it may lead out of what is nearer."""
        for zone in self._zones:
            smallest, looked = least(zone, a, b, self.room_m)
            yield 1 + looked
            if smallest < self.room_m and not (is_first and smallest >= clearance_m(zone, *a) - RECEDES_M):
                return False
        length_m, floor_m = math.dist(a, b), self.room_m
        north, east = ((b[0] - a[0]) / length_m, (b[1] - a[1]) / length_m) if length_m else (0.0, 0.0)
        if is_first:
            floor_m = min(floor_m, self.field.clear_m(*a) - RECEDES_M)
        far_m, looks = 0.0, 0
        while True:
            spare_m = self.field.clear_m(a[0] + far_m * north, a[1] + far_m * east) - floor_m
            looks += 1
            if spare_m < 0.0 or far_m >= length_m:
                yield 2 * looks
                return spare_m >= 0.0
            far_m = min(far_m + max(spare_m, LOOK_M), length_m)
            if looks == SEEN:
                yield 2 * looks
                looks = 0

    def gates(self, at: Point, is_first: bool) -> Work[list[Square]]:
        """The free square about a place, or the nearest ones about it to which the straight way is free."""
        here = self.holding(at)
        if here is not None and self.free(here):
            return [here]
        side_m = self.side_m / (1 << self.deepest)
        for ring in range(1, REACH + 1):
            found = list[Square]()
            for up in range(-ring, ring + 1):
                for right in range(-ring, ring + 1) if abs(up) == ring else (-ring, ring):
                    square = self.holding((at[0] + up * side_m, at[1] + right * side_m))
                    yield 2
                    if square is None or square in found or not self.free(square):
                        continue
                    to, back = self.middle(square), not is_first
                    if (yield from self.sees(to if back else at, at if back else to, is_first)):
                        found.append(square)
            if found:
                return found
        return []


class WaySearch:
    """The search from one place to another. `lengths_m` of the way to each square that it came to, and the turn before it."""

    def __init__(self, water: Waters, a: Point, b: Point) -> None:
        self.water, self.a, self.b = water, a, b
        self.lengths_m, self.turns, self.done = {A: 0.0}, {A: A}, {A}
        self.heap, self.pond = list[tuple[float, float, Square]](), set[Square]()  # the pond: found from the target on

    def at(self, square: Square) -> Point:
        return self.a if square == A else self.b if square == B else self.water.middle(square)

    def reach(self, square: Square, turn: Square) -> None:
        """Come to a square from this turn, where that is shorter."""
        length_m = self.lengths_m[turn] + math.dist(self.at(turn), self.at(square))
        if length_m < self.lengths_m.get(square, math.inf):
            self.lengths_m[square], self.turns[square] = length_m, turn
            heappush(self.heap, (length_m + math.dist(self.at(square), self.b), length_m, square))

    def found(self) -> Work[tuple[Point, ...] | Shut]:
        """The turns between the two places."""
        starts = yield from self.water.gates(self.a, is_first=True)
        ends = yield from self.water.gates(self.b, is_first=False)
        if not starts:
            return Shut("no free water is near the boat")
        if not ends:
            return Shut("no free water is near the target")
        if why := self._parted([self.at(square) for square in starts], [self.at(square) for square in ends]):
            return Shut(why)
        for square in starts:
            self.reach(square, A)
        is_joined = False
        pond, shore = self.pond, deque(ends)
        pond.update(ends)
        while self.heap:
            _, length_m, square = heappop(self.heap)
            if square in self.done or length_m != self.lengths_m.get(square):
                yield 1
                continue
            beside = ends if square == B else (yield from self._beside(square))
            if not (yield from self._is_seen(square, beside, starts)):
                continue
            self.done.add(square)
            if square == B:
                return self._way()
            for each in beside:
                if each not in self.done:
                    self.reach(each, self.turns[square])
            if any(each in ends for each in (square, *beside)):
                self.reach(B, self.turns[square])
            is_joined = is_joined or square in pond
            if not is_joined and len(pond) < PONDS:
                if not shore:
                    return Shut("no-go water is all about the target")
                for each in (yield from self._beside(shore.popleft())):
                    if each not in pond:
                        pond.add(each)
                        shore.append(each)
        return Shut("no-go water is all about the boat")

    def _parted(self, starts: Sequence[Point], ends: Sequence[Point]) -> str:
        """Why no way is between these places of free water, as far as the chart alone tells; empty: it does not."""
        field, room_m = self.water.field, self.water.room_m
        of = max((each for each in field.basins if each.room_m <= room_m), key=lambda each: each.room_m, default=None)
        if of is None:
            return ""
        here, there = ({field.basin(place, of) for place in places} - {None} for places in (starts, ends))
        if not here or not there or here & there:
            return ""
        shut = sum(of.area_m2[each or 0] for each in there) < sum(of.area_m2[each or 0] for each in here)
        return f"no-go water is all about the {'target' if shut else 'boat'}"

    def _beside(self, square: Square) -> Work[list[Square]]:
        """The free squares that touch one."""
        found = list[Square]()
        for each in self.water.beside(square):
            found.append(each)
            if self.water.spent > SEEN:
                yield self.water.spent
                self.water.spent = 0
        yield self.water.spent + 4
        self.water.spent = 0
        return found

    def _is_seen(self, square: Square, beside: Sequence[Square], starts: Sequence[Square]) -> Work[bool]:
        """Whether the turn before a square sees it; else the best square beside it becomes that turn. False: it comes later."""
        turn, at = self.turns[square], self.at(square)
        if (yield from self.water.sees(self.at(turn), at, is_first=turn == A)):
            return True
        there = [each for each in beside if each in self.done]
        near = {self.turns[each] for each in there} | set(there) | ({A} if square in starts else set())
        others = sorted((self.lengths_m[each] + math.dist(self.at(each), at), each) for each in near - {turn})
        del self.lengths_m[square]
        for _, each in others:
            if (yield from self.water.sees(self.at(each), at, is_first=each == A)):
                self.reach(square, each)
                break
        return False

    def _way(self) -> tuple[Point, ...]:
        way, square = list[Point](), self.turns[B]
        while square != A:
            way.append(self.at(square))
            square = self.turns[square]
        return tuple(way[::-1])


def way_through(
    around: Fence, field: ClearanceField, a: Point, b: Point, room_m: float, held: list[Iterable[object]]
) -> Work[tuple[Point, ...] | Shut]:
    """The turns between a and b, or why there is no way. From within the room around a zone the way may lead out. What the
    search is made of goes to `held`, for it is too much to be freed at once."""
    water = Waters(around, field, room_m)
    voyage = WaySearch(water, a, b)
    held += water.squares, voyage.lengths_m, voyage.turns, voyage.done, voyage.pond, voyage.heap
    found = yield from voyage.found()
    return found if isinstance(found, Shut) else (yield from _tight(water, (a, *found, b)))


def _tight(water: Waters, way: Sequence[Point]) -> Work[tuple[Point, ...]]:
    """The same way pulled tight: turns that it does without left out, the others cut as far as there is room."""
    for _ in range(PULLS):
        at, tight = 1, list(way[:1])
        while at < len(way) - 1:
            turn, after = way[at], way[at + 1]
            if not (yield from water.sees(tight[-1], after, is_first=len(tight) == 1)):
                tight += yield from _cut(water, tight[-1], turn, after)
            at += 1
        way = (*tight, way[-1])
    return tuple(way[1:-1])


def _cut(water: Waters, before: Point, turn: Point, after: Point) -> Work[tuple[Point, Point]]:
    """The two turns that take the place of one."""
    good, bad, cut = 0.0, 1.0, (turn, turn)
    for _ in range(HALVINGS):
        part = (good + bad) / 2.0
        tried = _between(turn, before, part), _between(turn, after, part)
        if (yield from water.sees(*tried)):
            good, cut = part, tried
        else:
            bad = part
    return cut


def _between(a: Point, b: Point, part: float) -> Point:
    return a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1])
