"""A chart for tests: a field of clearances about a place, with round shoals in it."""

import math
from bisect import bisect_right
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from delfim.base.geodesy import Origin
from delfim.vehicle.plans.clearance import METRES, ClearanceHead, GridHead
from delfim.vehicle.plans.clearancefile import packed

KNOTS, CELL_M = 300, 2.0
Shoal = tuple[float, float, float]
"""North and east of the middle, and the radius, m."""


def code(clear_m: float) -> int:
    """The largest code that says no more."""
    return bisect_right(METRES, max(clear_m, METRES[0])) - 1


def field(shoals: Sequence[Shoal], knots: int = KNOTS) -> bytes:
    side = CELL_M * (np.arange(knots) - (knots - 1) / 2.0)
    north_m, east_m = side[:, None], side[None, :]
    clear_m = CELL_M * (knots - 1) / 2.0 - np.maximum(abs(north_m), abs(east_m))
    for n, e, radius_m in shoals:
        clear_m = np.minimum(clear_m, np.hypot(north_m - n, east_m - e) - radius_m)
    return (np.searchsorted(METRES, np.maximum(clear_m, METRES[0]), side="right") - 1).astype(np.uint8).tobytes()


def chart(
    at: Origin, shoals: Sequence[Shoal], opened: Sequence[Shoal] | None = None, draught_m: float = 0.5, knots: int = KNOTS
) -> bytes:
    """The file. `opened`: the shoals that are left when the band "0-2 m" is opened."""
    first_m = -CELL_M * (knots - 1) / 2.0
    grid = GridHead(first_m, first_m, CELL_M, knots, knots, 0.1)
    fields = [[field(shoals, knots)], *([[field(opened, knots)]] if opened is not None else [])]
    bands = ("", "0-2 m") if opened is not None else ("",)
    middle = math.degrees(at.latitude_rad), math.degrees(at.longitude_rad)
    return packed(ClearanceHead("XX5TEST1 edition 2", *middle, draught_m, 3.0, (grid,), bands, ()), fields)


def written(folder: Path, data: bytes) -> str:
    """An override of a vehicle's file that names the chart."""
    file = folder / "harbour.clearance"
    file.write_bytes(data)
    return f'fence.chart="{file}"'
