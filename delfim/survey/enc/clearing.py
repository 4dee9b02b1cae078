"""Makes the field of clearances of charted dangers, which goes aboard (delfim/vehicle/plans/clearancefile.py)."""

import math
from collections.abc import Collection, Sequence
from typing import Final, NamedTuple

import numpy
import shapely
from numpy.typing import NDArray
from shapely.geometry import box
from shapely.geometry.base import BaseGeometry

from delfim.base.errors import FormatError
from delfim.base.geodesy import Origin
from delfim.survey.enc.dangers import LEAST_M, Charted
from delfim.survey.enc.plane import Array, flat
from delfim.vehicle.plans.clearance import BYTES, METRES, ClearanceHead, GridHead
from delfim.vehicle.plans.clearancefile import packed

NEAR_M, FAR_M = 4.0, 10.0  # cells about the middle, and beyond
KNOTS: Final = 1024  # a side of a grid: 4 km and 10 km
SEEN_M: Final = float(METRES[-1])  # farther dangers are not looked for
DEEP_M: Final = -float(METRES[0])  # nor how far it is out of a danger from deeper in it
BLOCK: Final = 16  # knots a side that are judged by one of them
_METRES = numpy.array(METRES)


class Growing(NamedTuple):
    """Dangers with the same margin, in the plane of the field, m."""

    margin_m: float
    shapes: list[BaseGeometry]


def half_m() -> float:
    """How far the field reaches from its middle, m."""
    return FAR_M * (KNOTS - 1) / 2.0


def growing(chart: Charted, at: Origin, opened: Collection[str] = ()) -> list[Growing]:
    """The dangers about a place by their margins, those of opened bands left out, and the water without a chart. All that lies
    beyond the field is taken as such."""
    by = dict[float, list[BaseGeometry]]()
    reach_m = half_m()
    window, far_m = box(-reach_m, -reach_m, reach_m, reach_m), reach_m + SEEN_M + chart.need.margin_m
    frame = box(-far_m, -far_m, far_m, far_m)
    for danger in chart.dangers:
        if danger.band and danger.band in opened:
            continue
        shape = flat(danger.shape, at)
        if shape.intersects(frame):
            by.setdefault(danger.margin_m, []).append(shape)
    bare = frame.difference(flat(chart.covered, at).intersection(window))
    by.setdefault(min(by, default=LEAST_M), []).append(bare)
    return [Growing(margin_m, by[margin_m]) for margin_m in sorted(by)]


def made(chart: Charted, at: Origin, opened: Sequence[str] = ()) -> bytes:
    """The file of clearances about a place: with no band opened, and with each of these opened. Raises FormatError."""
    grids, fields = list[GridHead](), list[list[bytes]]()
    least_m = min((danger.margin_m for danger in chart.dangers), default=LEAST_M)
    for cell_m in (NEAR_M, FAR_M):
        first_m = -cell_m * (KNOTS - 1) / 2.0
        grids.append(GridHead(first_m, first_m, cell_m, KNOTS, KNOTS, overstated_m(cell_m, least_m)))
    for band in ("", *opened):
        dangers = growing(chart, at, {band} - {""})
        fields.append([coded(clearances(dangers, grid)) for grid in grids])
    need, middle = chart.need, (math.degrees(at.latitude_rad), math.degrees(at.longitude_rad))
    name = ", ".join(chart.names)
    words = name if len(name) <= 100 else f"{name[:97]}..."
    head = ClearanceHead(words, *middle, need.draught_m, need.air_draught_m, tuple(grids), ("", *opened), ())
    data = packed(head, fields)
    if len(data) > BYTES:
        raise FormatError(f"the field of clearances is {len(data)} bytes: up to {BYTES}; open fewer bands")
    return data


def overstated_m(cell_m: float, margin_m: float) -> float:
    """By how much interpolation between knots may say too much at a place that is not in danger, m, rounded up to centimetres.

    Distance from a set bends by at most 1/d at the distance d from it (it is semiconcave), so between four knots the
    interpolation is at most cell_m^2 / (4 d) above it, where d is the least distance in their square; and never more than
    half of the diagonal, because distance changes by no more than the way. Here d is the margin that the field begins at,
    less a diagonal. Within the margin the field is below 0 by as much as d is less.
    """
    diagonal_m = cell_m * math.sqrt(2.0)
    worst = 0.0
    for within_m in numpy.arange(0.0, diagonal_m, 0.001):
        left_m = margin_m - diagonal_m - within_m
        over_m = min(diagonal_m / 2.0, cell_m**2 / (4.0 * left_m) if left_m > 0.0 else math.inf)
        worst = max(worst, over_m - float(within_m))
    return math.ceil(worst * 100.0) / 100.0


def clearances(dangers: Sequence[Growing], grid: GridHead) -> Array:
    """(rows, columns) at the knots of a grid: the distance from the nearest danger beyond its margin, m; negative in it. Beyond
    what a code can say it is only as far."""
    east = grid.west_m + grid.cell_m * numpy.arange(grid.columns, dtype=numpy.float64)
    north = grid.south_m + grid.cell_m * numpy.arange(grid.rows, dtype=numpy.float64)
    found = numpy.full((grid.rows, grid.columns), SEEN_M)
    for margin_m, shapes in dangers:
        seen_m = SEEN_M + margin_m
        tree, inside = shapely.STRtree(_sides(shapes)), _inside(shapes, east, north)
        away = numpy.full(found.shape, seen_m)
        rows, columns = numpy.nonzero(_looked_at(tree, east, north, grid.cell_m, numpy.where(inside, DEEP_M, seen_m)))
        knots = shapely.points(east[columns], north[rows])
        (at, _), far = tree.query_nearest(knots, max_distance=seen_m, return_distance=True, all_matches=False)
        away[rows[at], columns[at]] = far
        away[inside] *= -1.0
        numpy.minimum(found, away - margin_m, out=found)
    return found


def _looked_at(tree: shapely.STRtree, east: Array, north: Array, cell_m: float, as_far_m: Array) -> NDArray[numpy.bool_]:
    """Which knots may be as near to a side as that: one of each block is asked, and the others lie within the block's width."""
    middle = BLOCK // 2
    x, y = numpy.meshgrid(east[middle::BLOCK], north[middle::BLOCK])
    within_m = cell_m * BLOCK / math.sqrt(2.0)
    most_m = float(as_far_m.max()) + within_m
    near = numpy.full(x.size, math.inf)
    (at, _), far = tree.query_nearest(
        shapely.points(x.ravel(), y.ravel()), max_distance=most_m, return_distance=True, all_matches=False
    )
    near[at] = far
    return near.reshape(x.shape).repeat(BLOCK, axis=0).repeat(BLOCK, axis=1) <= as_far_m + within_m


def _sides(shapes: Sequence[BaseGeometry]) -> NDArray[numpy.object_]:
    """The sides of polygons and lines, and points, as geometries of two corners at most."""
    parts = shapely.get_parts(numpy.array(shapes, dtype=object))
    areas = shapely.get_type_id(parts) == 3
    rings = shapely.get_rings(parts[areas])
    lines = numpy.concatenate([rings, parts[~areas]])
    corners, of = shapely.get_coordinates(lines, return_index=True)
    joined = of[1:] == of[:-1]
    ends = numpy.stack([corners[:-1][joined], corners[1:][joined]], axis=1)
    single = lines[shapely.get_type_id(lines) == 0]
    return numpy.concatenate([shapely.linestrings(ends), single])


def _inside(shapes: Sequence[BaseGeometry], east: Array, north: Array) -> NDArray[numpy.bool_]:
    """(rows, columns): which knots lie in one of the shapes."""
    found = numpy.zeros((len(north), len(east)), dtype=bool)
    for shape in shapes:
        if shape.area == 0.0:
            continue
        west, south, to_east, to_north = shape.bounds
        columns = slice(*numpy.searchsorted(east, (west, to_east)))
        rows = slice(*numpy.searchsorted(north, (south, to_north)))
        part = found[rows, columns]
        if part.size:
            sound = shape if shape.is_valid else shapely.make_valid(shape)
            shapely.prepare(sound)
            x, y = numpy.meshgrid(east[columns], north[rows])
            part |= shapely.contains_xy(sound, x, y)
    return found


def coded(clear_m: Array) -> bytes:
    """Each knot's code, never more than true."""
    return numpy.clip(numpy.searchsorted(_METRES, clear_m.ravel(), side="right") - 1, 0, 255).astype(numpy.uint8).tobytes()
