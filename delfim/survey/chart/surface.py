"""The bed as a surface: cells of UTM that were sounded, and between them triangles, of which those with a long side are left
out; its contours.

Rows go from the south to the north. What is not known is NaN.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from contourpy import LineType, contour_generator
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from delfim.base.errors import DelfimError
from delfim.survey.chart.soundings import Array

CELLS: Final = 4_000_000  # at most
SOUNDED: Final = 400_000  # cells at most: triangles take time
CELL_M: Final = 2.0
EDGE: Final = 1e-9  # of a triangle's sides: cells on them belong to both
ON_A_LINE: Final = 1.0 - 1e-12  # correlation of cells that have no triangles
REACH: Final = 100.0  # cells: the longest side of a triangle
LEVELS: Final = 200  # contours at most


class Surface(NamedTuple):
    """Cells of `cell_m`, from the corner in the south-west. Each array has the shape (rows, columns)."""

    west_m: float
    south_m: float
    cell_m: float
    mean_m: Array  # of the soundings in a cell
    least_m: Array  # the shoalest of them
    whole_m: Array  # with what lies between

    @property
    def sounded(self) -> Array:
        return np.isfinite(self.mean_m)

    @property
    def centres(self) -> tuple[Array, Array]:
        """East of each column, north of each row."""
        rows, columns = self.whole_m.shape
        return self.west_m + (np.arange(columns) + 0.5) * self.cell_m, self.south_m + (np.arange(rows) + 0.5) * self.cell_m


def surface(east_m: Array, north_m: Array, depth_m: Array, cell_m: float, reach_m: float) -> Surface:
    """The surface of soundings, each of the shape (n,); `reach_m` is the longest side of a triangle. Cells are
    made larger where there would be too many. Raises DelfimError where there is none."""
    if not len(depth_m):
        raise DelfimError("no sounding is left to make a chart of")
    while (float(np.ptp(east_m)) / cell_m + 2.0) * (float(np.ptp(north_m)) / cell_m + 2.0) > CELLS:
        cell_m *= 2.0
    while True:
        west, south = (cell_m * math.floor(float(each.min()) / cell_m) for each in (east_m, north_m))
        column, row = (np.floor((each - low) / cell_m).astype(np.int64) for each, low in ((east_m, west), (north_m, south)))
        columns, rows = int(column.max()) + 1, int(row.max()) + 1
        cell, total = row * columns + column, columns * rows
        count = np.bincount(cell, minlength=total)
        if np.count_nonzero(count) <= SOUNDED:
            break
        cell_m *= 2.0
    with np.errstate(invalid="ignore"):
        mean = np.bincount(cell, depth_m, total) / count
    least = np.full(total, np.inf)
    np.minimum.at(least, cell, depth_m)
    shape = rows, columns
    sounded = mean.reshape(shape)
    whole = _filled(sounded, min(reach_m / cell_m, REACH))
    return Surface(west, south, cell_m, sounded, np.where(count > 0, least, np.nan).reshape(shape), whole)


def _filled(mean: Array, reach: float) -> Array:
    """Cells between sounded ones by triangles of sides up to `reach` cells."""
    row, column = np.nonzero(np.isfinite(mean))
    if not (np.ptp(row) and np.ptp(column)) or abs(np.corrcoef(row, column)[0, 1]) > ON_A_LINE:
        return mean.copy()
    corners = Triangulation(column.astype(float), row.astype(float)).triangles
    x, y = column[corners], row[corners]
    longest = np.max([np.hypot(x[:, a] - x[:, b], y[:, a] - y[:, b]) for a, b in ((0, 1), (1, 2), (2, 0))], axis=0)
    short = longest <= reach
    return _laid(mean, x[short], y[short])


def _laid(mean: Array, x: NDArray[np.int64], y: NDArray[np.int64]) -> Array:
    """The plane of each triangle in the cells whose centres lie in it; its corners, of the shape (n, 3), are cells."""
    found, z = mean.copy(), mean[y, x]
    west, south = x.min(1), y.min(1)
    wide, high = x.max(1) - west, y.max(1) - south
    (ax, bx, cx), (ay, by, cy) = x.T, y.T
    twice = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    here = np.flatnonzero(twice)
    for right in range(int(wide.max(initial=0)) + 1):  # all triangles at once, a cell of the box about each
        for up in range(int(high.max(initial=0)) + 1):
            its = here[(wide[here] >= right) & (high[here] >= up)]
            px, py = west[its] + right, south[its] + up
            b = ((px - ax[its]) * (cy - ay)[its] - (cx - ax)[its] * (py - ay[its])) / twice[its]
            c = ((bx - ax)[its] * (py - ay[its]) - (px - ax[its]) * (by - ay)[its]) / twice[its]
            inside = (b >= -EDGE) & (c >= -EDGE) & (b + c <= 1.0 + EDGE)
            its, px, py, b, c = its[inside], px[inside], py[inside], b[inside], c[inside]
            found[py, px] = (1.0 - b - c) * z[its, 0] + b * z[its, 1] + c * z[its, 2]
    return np.where(np.isfinite(mean), mean, found)


def interval_of(depth_m: Array) -> float:
    """An interval of contours that suits depths: ten to twenty of them."""
    low, high = np.nanpercentile(depth_m, [1, 99])
    wanted = max(float(high - low) / 10.0, 0.05)
    power = 10.0 ** math.floor(math.log10(wanted))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= wanted * 0.999)


def contours(its: Surface, interval_m: float) -> list[tuple[float, Array]]:
    """Each contour: its depth, and its places, of the shape (n, 2), east and north."""
    east, north = its.centres
    if min(its.whole_m.shape) < 2:
        return []
    low, high = float(np.nanmin(its.whole_m)), float(np.nanmax(its.whole_m))
    interval_m = max(interval_m, (high - low) / LEVELS)
    maker = contour_generator(east, north, np.ma.masked_invalid(its.whole_m), line_type=LineType.Separate)
    levels = np.arange(math.ceil(low / interval_m), math.floor(high / interval_m) + 1) * interval_m
    every = ((round(float(level), 6), np.asarray(line)) for level in levels for line in maker.lines(float(level)))
    return [(level, line) for level, line in every if len(line) > 2]


def misses(its: Surface, east_m: Array, north_m: Array, depth_m: Array) -> Array:
    """How far a surface is off soundings, of the shape (n,); NaN beyond it."""
    rows, columns = its.whole_m.shape
    column, row = (
        np.floor((east_m - its.west_m) / its.cell_m).astype(int),
        np.floor((north_m - its.south_m) / its.cell_m).astype(int),
    )
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    found = np.full(len(depth_m), np.nan)
    found[inside] = its.whole_m[row[inside], column[inside]] - depth_m[inside]
    return found
