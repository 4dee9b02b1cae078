"""The order in which lines are sailed. Lines of neighbouring strips that lie beside each other, one to one, are a cell, and
sailed to and fro; cells are put in an order, each begun at one of its four corners, so that the ways between them are short.

No chance is in it: the same lines come in the same order.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Final, NamedTuple

from delfim.survey.ground import Place, Segment
from delfim.survey.lines import Strip

FIRSTS: Final = 6  # cells that an order is begun with, and improved; the shortest is kept ...
CELLS: Final = 150  # ... and fewer of many cells, so many in all
LOOKS: Final = 60_000  # comparisons of two orders at most, of each
LONG: Final = 3  # cells that are moved together at most
LESS_M: Final = 1e-6  # what is not shorter by so much is not shorter


class Cell(NamedTuple):
    """Lines to and fro, from each of its four corners: those of 0 and 1 are each other's reverse, and those of 2 and 3. Lines
    that are sailed one way alone have two: 0 and 2 begin with the first strip, 1 and 3 with the last one."""

    ways: tuple[list[Segment], list[Segment], list[Segment], list[Segment]]

    def ends(self, way: int) -> Segment:
        """Where it begins and ends."""
        return self.ways[way][0][0], self.ways[way][-1][1]


def ordered(strips: Sequence[Strip], apart: int, start: Place | None) -> list[Segment]:
    """The lines, each in the direction in which it is sailed. `apart`: so many strips the boat needs for a turn, if the lines
    between can be taken later. `start`: where the boat comes from."""
    cells = [_cell(lines, apart) for lines in _beside(strips)]
    if not cells:
        return []
    tries = max(1, min(FIRSTS, CELLS // len(cells)))
    firsts = range(0, len(cells), math.ceil(len(cells) / tries))
    found = [_improved(cells, _nearest(cells, start, first), start) for first in firsts]
    orders = [[line for number, way in order for line in cells[number].ways[way]] for order in found]
    return min(orders, key=lambda lines: _between_m(lines, start))


def _between_m(lines: Sequence[Segment], start: Place | None) -> float:
    come_m = math.dist(start, lines[0][0]) if start is not None else 0.0
    return come_m + sum(math.dist(before[1], after[0]) for before, after in pairwise(lines))


def _beside(strips: Sequence[Strip]) -> list[list[Strip]]:
    """Lines that hang together one to one, strip by strip."""
    by_strip = dict[int, list[list[Strip]]]()
    found = list[list[Strip]]()
    for number in sorted({strip.number for strip in strips}):
        here = [strip for strip in strips if strip.number == number and strip.is_middle]
        before = by_strip.get(number - 1, [])
        nexts = [[line for line in here if _overlap(cell[-1].line, line.line)] for cell in before]
        cells = list[list[Strip]]()
        for line in here:
            mine = [cell for cell, its in zip(before, nexts, strict=True) if line in its]
            if len(mine) == 1 and sum(line in its for its in nexts) == 1 and len(nexts[before.index(mine[0])]) == 1:
                mine[0].append(line)
                cells.append(mine[0])
            else:
                cells.append([line])
                found.append(cells[-1])
        by_strip[number] = cells
        found += [[strip] for strip in strips if strip.number == number and not strip.is_middle]
    return found


def _overlap(line: Segment, other: Segment) -> bool:
    (x, y), (to_x, to_y) = line
    along_x, along_y, long2 = to_x - x, to_y - y, math.dist(*line) ** 2
    low, high = sorted((px - x) * along_x + (py - y) * along_y for px, py in other)
    return low < long2 and high > 0.0


def _cell(strips: list[Strip], apart: int) -> Cell:
    if strips[0].sense:
        there, back = ([its[number].line for number in _by_turns(its, apart)] for its in (strips, strips[::-1]))
        return Cell((there, back, there, back))
    taken = [strips[number].line for number in alternating(len(strips), apart)]
    one, other = ([line[::-1] if number % 2 == first else line for number, line in enumerate(taken)] for first in (1, 0))
    return Cell((one, _reversed(one), other, _reversed(other)))


def _by_turns(strips: Sequence[Strip], apart: int) -> list[int]:
    """The numbers of lines that are sailed one way alone in an order in which the next one is sailed the other way, and lies so
    many strips away, as far as there is such a one."""
    left, order = list(range(len(strips))), list[int]()
    while left:
        here = strips[order[-1]] if order else None
        order.append(
            min(
                left,
                key=lambda number: (
                    here is not None and strips[number].sense == here.sense,
                    here is not None and apart > 1 and abs(strips[number].number - here.number) < apart,
                    number,
                ),
            )
        )
        left.remove(order[-1])
    return order


def _reversed(lines: list[Segment]) -> list[Segment]:
    return [line[::-1] for line in reversed(lines)]


def alternating(count: int, apart: int) -> list[int]:
    """The numbers of lines side by side in an order in which the next one is at least so many away, where there is such a one:
    with 2, lines are taken by two and three."""
    left, order = list(range(count)), list[int]()
    while left:
        here = order[-1] if order else -apart
        far = next((number for number in left if abs(number - here) >= apart), None)
        order.append(min(left, key=lambda number: -abs(number - here)) if far is None else far)
        left.remove(order[-1])
    return order


Order = list[tuple[int, int]]
"""The numbers of cells with the way in which each is sailed."""


def _nearest(cells: Sequence[Cell], start: Place | None, first: int) -> Order:
    """From this cell, always the nearest end that is left."""
    left, order = set(range(len(cells))) - {first}, [(first, 0)]
    if start is not None:
        order = [min(((first, way) for way in range(4)), key=lambda each: math.dist(start, cells[first].ends(each[1])[0]))]
    while left:
        here = cells[order[-1][0]].ends(order[-1][1])[1]
        there = ((math.dist(here, cells[number].ends(way)[0]), number, way) for number in left for way in range(4))
        order.append(min(there)[1:])
        left.discard(order[-1][0])
    return order


def _improved(cells: Sequence[Cell], order: Order, start: Place | None) -> Order:
    """Turn parts round, move parts elsewhere, and begin cells at other corners, as long as a way becomes shorter."""
    looks, better, dist = 0, True, math.dist
    one_way = any(cell.ways[0] is cell.ways[2] for cell in cells)
    begins, ends = ([[cell.ends(way)[end] for way in range(4)] for cell in cells] for end in (0, 1))

    def gap(before: tuple[int, int] | None, after: tuple[int, int] | None) -> float:
        if after is None or (before is None and start is None):
            return 0.0
        begin = start if before is None else ends[before[0]][before[1]]
        assert begin is not None
        return dist(begin, begins[after[0]][after[1]])

    def at(number: int) -> tuple[int, int] | None:
        return order[number] if 0 <= number < len(order) else None

    def turned(part: Order) -> Order:
        return [(number, way ^ 1) for number, way in reversed(part)]

    def elsewhere(i: int, long: int) -> Order | None:
        """The order with a part moved to where the way is shorter, either way round; None: nowhere. Lines that are sailed one
        way alone are not turned round together: the ways between them would be others."""
        part, rest = order[i : i + long], order[:i] + order[i + long :]
        saved = gap(at(i - 1), part[0]) + gap(part[-1], at(i + long)) - gap(at(i - 1), at(i + long)) - LESS_M
        both = (part,) if one_way and long > 1 else (part, turned(part))
        for k in range(len(rest) + 1):
            before, after = rest[k - 1] if k else None, rest[k] if k < len(rest) else None
            for moved in both:
                if gap(before, moved[0]) + gap(moved[-1], after) - gap(before, after) < saved:
                    return rest[:k] + moved + rest[k:]
        return None

    while better and looks < LOOKS:
        better = False
        for i in range(len(order)):
            for way in range(4):  # another corner
                now, other = order[i], (order[i][0], way)
                if gap(at(i - 1), other) + gap(other, at(i + 1)) < gap(at(i - 1), now) + gap(now, at(i + 1)) - LESS_M:
                    order[i], better = other, True
            for j in range(i, i + 1 if one_way else len(order)):
                first, last = order[i], order[j]
                old_m = gap(at(i - 1), first) + gap(last, at(j + 1))
                if gap(at(i - 1), (last[0], last[1] ^ 1)) + gap((first[0], first[1] ^ 1), at(j + 1)) < old_m - LESS_M:
                    order[i : j + 1], better = turned(order[i : j + 1]), True
            for long in range(1, min(LONG + 1, len(order) - i)):
                looks += 2 * len(order)
                if (moved := elsewhere(i, long)) is not None:
                    order[:], better = moved, True
    return order
