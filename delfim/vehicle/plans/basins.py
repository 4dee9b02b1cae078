"""Which waters of a chart hang together, so that "there is no way" is known before anybody looks for one.

A square between four knots is open where one of them has the room: more than is free. Open squares that touch, by a corner too,
are one basin. So places in two basins have no way between them; places in one may have none, which only a search can tell.
Made once, when the file is read: a row is a number whose bytes are its knots, and its open stretches are joined with those of
the row before.
"""

import re
from collections.abc import Sequence
from typing import Final

from delfim.vehicle.plans.clearance import METRES, Basins, Grid, GridHead, Stretches

OPEN: Final = re.compile(b"\1+")
OUTWARD_M: Final = 0.01  # from the edge of a grid into the next


def basins_of(grids: Sequence[Grid], room_m: float) -> Basins:
    """The basins of these grids, the finest first, where a boat keeps this room."""
    joined, areas_m2, rows = list[int](), list[float](), list[tuple[Stretches, ...]]()
    for number, (head, codes) in enumerate(grids):
        before: Stretches = [], [], []
        found = list[Stretches]()
        for row, open_ in enumerate(_opened(head, codes, room_m, [each.head for each in grids[:number]])):
            stretches: Stretches = [], [], []
            for each in OPEN.finditer(open_):
                stretches[0].append(each.start())
                stretches[1].append(each.end())
                stretches[2].append(len(joined))
                joined.append(len(joined))
                areas_m2.append((each.end() - each.start()) * head.cell_m**2)
            if row:
                _touch(before, stretches, joined)
            found.append(stretches)
            before = stretches
        rows.append(tuple(found))
    found_basins = Basins(room_m, tuple(rows), {})
    for number in range(len(grids)):
        for wider in range(number + 1, len(grids)):
            _meet(found_basins, [each.head for each in grids], number, wider, joined)
    area_m2 = dict[int, float]()
    for row_of in (each for grid in rows for each in grid):
        for at, basin in enumerate(row_of[2]):
            row_of[2][at] = root = _root(joined, basin)
            area_m2[root] = area_m2.get(root, 0.0) + areas_m2[basin]
    return found_basins._replace(area_m2=area_m2)


def _opened(head: GridHead, codes: bytes, room_m: float, finer: Sequence[GridHead]) -> list[bytearray]:
    """The squares of each row, 1 where one is open; squares that lie in a finer grid are closed here."""
    least_m = room_m + head.over_m
    is_open, width = bytes(METRES[code] >= least_m for code in range(256)), head.columns
    rows, opened, below = codes.translate(is_open), list[bytearray](), 0
    for row in range(head.rows):
        knots = int.from_bytes(rows[row * width : (row + 1) * width], "little")
        knots |= knots >> 8
        if row:
            opened.append(bytearray((below | knots).to_bytes(width, "little")[: width - 1]))
        below = knots
    for other in finer:
        south, west = (other.south_m - head.south_m) / head.cell_m, (other.west_m - head.west_m) / head.cell_m
        per = other.cell_m / head.cell_m
        first, last = max(int(-(-south // 1)), 0), min(int(south + (other.rows - 1) * per), head.rows - 1)
        begin, end = max(int(-(-west // 1)), 0), min(int(west + (other.columns - 1) * per), head.columns - 1)
        if begin < end:
            for row in range(first, last):
                opened[row][begin:end] = bytes(end - begin)
    return opened


def _touch(a: Stretches, b: Stretches, joined: list[int]) -> None:
    """Join the stretches of two rows that touch."""
    i = j = 0
    while i < len(a[0]) and j < len(b[0]):
        if a[0][i] <= b[1][j] and b[0][j] <= a[1][i]:
            _join(joined, a[2][i], b[2][j])
        if a[1][i] < b[1][j]:
            i += 1
        else:
            j += 1


def _meet(found: Basins, heads: Sequence[GridHead], number: int, wider: int, joined: list[int]) -> None:
    """Join the squares along the edge of a grid with those of a wider one that lie beside them."""
    head, wide = heads[number], heads[wider]
    last, end = head.rows - 2, head.columns - 2
    edge = [(row, column, up, 0) for row, up in ((0, -1), (last, 1)) for column in range(end + 1)]
    edge += [(row, column, 0, right) for column, right in ((0, -1), (end, 1)) for row in range(last + 1)]
    for row, column, up, right in edge:
        if (basin := found.at(number, row, column)) is None:
            continue
        for side in (0, 1):
            north_m = head.south_m + (row + (up > 0 if up else side)) * head.cell_m + up * OUTWARD_M
            east_m = head.west_m + (column + (right > 0 if right else side)) * head.cell_m + right * OUTWARD_M
            at_row, at_column = (north_m - wide.south_m) / wide.cell_m, (east_m - wide.west_m) / wide.cell_m
            if 0.0 <= at_row < wide.rows - 1 and 0.0 <= at_column < wide.columns - 1:
                other = found.at(wider, int(at_row), int(at_column))
                if other is not None:
                    _join(joined, basin, other)


def _root(joined: list[int], at: int) -> int:
    while joined[at] != at:
        joined[at] = at = joined[joined[at]]
    return at


def _join(joined: list[int], a: int, b: int) -> None:
    a, b = _root(joined, a), _root(joined, b)
    joined[max(a, b)] = min(a, b)
