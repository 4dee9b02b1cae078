"""Where the boat may be by a chart, as a field: at the knots of a grid, a byte each, how far the nearest danger is beyond its
margin, negative within it. `delfim charts` makes it ashore; aboard it is asked in a time that no coast makes longer.

Between four knots the field is interpolated, less what that may say too much: never more than true. A mission may open a band
of depths by its name: such a band has a field of its own. Pure, in metres of the local plane.
"""

import math
from bisect import bisect_right
from typing import Annotated, Final, NamedTuple

import msgspec

from delfim.base import geodesy
from delfim.base.errors import Refused

BYTES: Final = 250_000  # of a file: a field takes 20 to 100 kB, and each opened band as much again
BANDS: Final = 8
INSIDE: Final = 64  # codes below this one are within a danger or its margin
STEP_M: Final = 0.5  # of a look along a way, at least
LOOKS: Final = 200  # of one answer, as zones have
OUTSIDE_M: Final = -100.0  # beyond the grids: there is no chart
# Metres of each code, rising: steps of 0.1 m at the edge, of 2 % far from it, so that a look may go far where there is room.
METRES: Final = tuple(
    (4.0 if code >= INSIDE else -1.6) * math.expm1(0.022 * (code - INSIDE) if code >= INSIDE else 0.06 * (INSIDE - code))
    for code in range(256)
)

Size = Annotated[int, msgspec.Meta(ge=2, le=4096)]
Words = Annotated[str, msgspec.Meta(max_length=100)]


class GridHead(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A grid: its first knot, from the middle of the field, and its knots by rows from the south."""

    south_m: Annotated[float, msgspec.Meta(ge=-1e5, le=1e5)]
    west_m: Annotated[float, msgspec.Meta(ge=-1e5, le=1e5)]
    cell_m: Annotated[float, msgspec.Meta(gt=0.1, le=1000.0)]
    rows: Size
    columns: Size
    over_m: Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)]  # that interpolation may say too much


class ClearanceHead(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a file of clearances says of itself. For each band its grids are packed, the finest first; no band comes first."""

    chart: Words  # "US5OH10M edition 25"
    latitude_deg: Annotated[float, msgspec.Meta(ge=-89.0, le=89.0)]  # of the middle
    longitude_deg: Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)]
    draught_m: Annotated[float, msgspec.Meta(ge=0.0, le=100.0)]  # of the boat that it is for
    air_draught_m: Annotated[float, msgspec.Meta(ge=0.0, le=100.0)]
    grids: Annotated[tuple[GridHead, ...], msgspec.Meta(min_length=1, max_length=4)]
    bands: Annotated[tuple[Words, ...], msgspec.Meta(min_length=1, max_length=BANDS)]  # "" first
    sizes: Annotated[tuple[Annotated[int, msgspec.Meta(ge=1, le=BYTES)], ...], msgspec.Meta(max_length=4 * BANDS)]  # packed


class Grid(NamedTuple):
    """A grid with its knots, a code each, row by row."""

    head: GridHead
    codes: bytes


Stretches = tuple[list[int], list[int], list[int]]  # of a row of squares: first, end, number of the basin


class Basins(NamedTuple):
    """Which squares between knots hang together for a boat that keeps this room (`basins.py`)."""

    room_m: float
    rows: tuple[tuple[Stretches, ...], ...]  # of each grid
    area_m2: dict[int, float]

    def at(self, grid: int, row: int, column: int) -> int | None:
        """The number of the basin that a square lies in; None: it is closed."""
        first, end, number = self.rows[grid][row]
        at = bisect_right(first, column) - 1
        return number[at] if at >= 0 and column < end[at] else None


class Water(NamedTuple):
    """A chart with one band opened, or none."""

    name: str
    head: ClearanceHead
    grids: tuple[Grid, ...]
    basins: tuple[Basins, ...] = ()


class Chart(NamedTuple):
    """A file of clearances."""

    head: ClearanceHead
    fields: dict[str, tuple[Grid, ...]]  # by band
    digest: str  # 16 hexadecimal digits that name its content
    closed: str = ""  # why this boat opens no band, in words
    basins: dict[str, tuple[Basins, ...]] = {}  # by band; never changed  # noqa: RUF012

    def water(self, band: str) -> Water:
        """The chart with this band opened; "": with none. Raises Refused."""
        if band and self.closed:
            raise Refused(f"the mission opens water of {band}: {self.closed}")
        if band not in self.fields:
            there = ", ".join(self.head.bands[1:]) or "none"
            raise Refused(f"the mission opens water of {band}, and the chart aboard has been made for {there}")
        return Water(f"no-go water of chart {self.head.chart}", self.head, self.fields[band], self.basins.get(band, ()))


class LaidGrid(NamedTuple):
    """A grid in the boat's plane: knots are numbered from 0 by north_m * by_north + from_north, and so to the east."""

    by_north: float
    from_north: float
    by_east: float
    from_east: float
    rows: int  # of squares between the knots
    columns: int
    width: int
    over_m: float
    codes: bytes


class ClearanceField(NamedTuple):
    """The grids of a chart in the boat's plane, the finest first."""

    grids: tuple[LaidGrid, ...]
    shrink: float  # metres of the boat's plane for one of the chart's, where they are shorter
    basins: tuple[Basins, ...] = ()

    def clear_m(self, north_m: float, east_m: float) -> float:
        """How far a place surely is from dangers and their margins, m; negative within them, and beyond the chart."""
        for by_north, from_north, by_east, from_east, rows, columns, width, over_m, codes in self.grids:
            up, right = north_m * by_north + from_north, east_m * by_east + from_east
            if 0.0 <= up < rows and 0.0 <= right < columns:
                row, column = int(up), int(right)
                up -= row
                right -= column
                at = row * width + column
                below = METRES[codes[at]]
                below += right * (METRES[codes[at + 1]] - below)
                at += width
                above = METRES[codes[at]]
                above += right * (METRES[codes[at + 1]] - above)
                return (below + up * (above - below) - over_m) * self.shrink
        return OUTSIDE_M

    def basin(self, at: tuple[float, float], of: Basins) -> int | None:
        """The number of the basin that a place lies in."""
        for number, grid in enumerate(self.grids):
            up, right = at[0] * grid.by_north + grid.from_north, at[1] * grid.by_east + grid.from_east
            if 0.0 <= up < grid.rows and 0.0 <= right < grid.columns:
                return of.at(number, int(up), int(right))
        return None

    def least_m(self, a: tuple[float, float], b: tuple[float, float], within_m: float) -> tuple[float, int]:
        """The smallest clearance on the straight way, if it is less than `within_m`, else infinite; and how many looks it
        took. More than LOOKS: it was given up."""
        smallest, looks, _ = self.along(a, b, within_m, 0.0, LOOKS)
        return smallest, looks

    def along(
        self, a: tuple[float, float], b: tuple[float, float], within_m: float, from_m: float, most: int
    ) -> tuple[float, int, float]:
        """The same from so far on, in at most so many looks; and how far it looked, infinite where that is the end."""
        length_m = math.dist(a, b)
        by_n, by_e = ((b[0] - a[0]) / length_m, (b[1] - a[1]) / length_m) if length_m else (0.0, 0.0)
        smallest, looks, far_m = math.inf, 0, from_m
        while looks < most:
            clear_m = self.clear_m(a[0] + far_m * by_n, a[1] + far_m * by_e)
            looks += 1
            if clear_m < smallest:
                smallest = clear_m
                if clear_m <= 0.0:
                    return clear_m, looks, math.inf
            if far_m >= length_m:
                return (smallest if smallest < within_m else math.inf), looks, math.inf
            step_m = clear_m - (smallest if smallest < within_m else within_m)  # nothing nearer can be within it
            far_m += step_m if step_m > STEP_M else STEP_M
            if far_m > length_m:
                far_m = length_m
        return (smallest if smallest < within_m else math.inf), looks + 1, far_m


def laid(water: Water, at: geodesy.Origin) -> ClearanceField:
    """The field in the boat's plane."""
    head = water.head
    middle = geodesy.origin(math.radians(head.latitude_deg), math.radians(head.longitude_deg))
    north, east = middle.north_m_per_rad / at.north_m_per_rad, middle.east_m_per_rad / at.east_m_per_rad
    here_n, here_e = geodesy.to_plane(middle, at.latitude_rad, at.longitude_rad)
    return ClearanceField(
        tuple(
            LaidGrid(
                north / grid.cell_m,
                (here_n - grid.south_m) / grid.cell_m,
                east / grid.cell_m,
                (here_e - grid.west_m) / grid.cell_m,
                grid.rows - 1,
                grid.columns - 1,
                grid.columns,
                grid.over_m,
                codes,
            )
            for grid, codes in water.grids
        ),
        min(1.0, 1.0 / max(north, east)),
        water.basins,
    )
