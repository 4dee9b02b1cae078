"""Basins of a chart: places in two of them have no way between them, and where there is a way they are one."""

import math
import random
from collections import deque

import pytest

from delfim.vehicle.plans.basins import basins_of
from delfim.vehicle.plans.clearance import METRES, ClearanceField, Grid, GridHead, Water, laid
from delfim.vehicle.plans.clearancefile import read
from tests.vehicle.charted import chart, code
from tests.vehicle.test_charted import AT

STEP_M = 1.0


def field_of(seed: int) -> tuple[ClearanceField, float]:
    """Random codes on a fine grid within a wide one, which do not agree where they meet, and a room."""
    drawn = random.Random(seed)
    low, high, room_m = code(-3.0), code(drawn.choice((4.0, 8.0))), 2.0
    grids = tuple(
        Grid(GridHead(-first_m, -first_m, cell_m, size, size, 0.2), bytes(drawn.randint(low, high) for _ in range(size * size)))
        for first_m, cell_m, size in ((20.0, 4.0, 11), (50.0, 10.0, 11))
    )
    head = read(chart(AT, ())).head
    return laid(Water("", head, grids, (basins_of(grids, room_m),)), AT), room_m


@pytest.mark.parametrize("seed", range(20))
def test_places_between_which_there_is_a_way_are_in_one_basin(seed: int) -> None:
    field, room_m = field_of(seed)
    of = field.basins[0]
    free = {
        (row, column)
        for row in range(-50, 50)
        for column in range(-50, 50)
        if field.clear_m((row + 0.5) * STEP_M, (column + 0.5) * STEP_M) >= room_m
    }
    while free:
        shore = deque([free.pop()])
        names = set[int | None]()
        while shore:
            row, column = shore.popleft()
            names.add(field.basin(((row + 0.5) * STEP_M, (column + 0.5) * STEP_M), of))
            for each in ((row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)):
                if each in free:
                    free.remove(each)
                    shore.append(each)
        assert len(names) == 1
        assert None not in names


def test_a_ring_of_shoals_parts_two_basins_and_their_areas_are_told() -> None:
    ring = [(150.0 + 40.0 * math.cos(t / 4.0), 40.0 * math.sin(t / 4.0), 12.0) for t in range(26)]
    head, fields, _, _, _ = read(chart(AT, ring))
    of = basins_of(fields[""], 6.0)
    field = laid(Water("", head, fields[""], (of,)), AT)
    pond, sea = field.basin((150.0, 0.0), of), field.basin((-150.0, 0.0), of)
    assert pond is not None
    assert sea is not None
    assert pond != sea
    assert of.area_m2[pond] == pytest.approx(math.pi * 22.0**2, rel=0.3)
    assert field.basin((150.0, 40.0), of) is None, "a shoal"
    assert field.basin((1e4, 0.0), of) is None, "no chart"
    assert METRES[0] < -1.0
