"""Ways through the water of a real chart, judged by the shortest way that there is: along the corners of what is forbidden."""

import heapq
import itertools
import lzma
import math
import random
import statistics
from pathlib import Path
from typing import Any

import contourpy
import numpy
import pytest
import shapely

from delfim import config
from delfim.base.cooperative import Sliced
from delfim.base.geodesy import origin
from delfim.vehicle.helm.detour import CHARTED_MOST
from delfim.vehicle.helm.waterway import Shut, way_through
from delfim.vehicle.plans.basins import basins_of
from delfim.vehicle.plans.clearance import ClearanceField, laid
from delfim.vehicle.plans.clearancefile import read
from delfim.vehicle.plans.fence import Fence
from delfim.vehicle.plans.zones import Point, charted, may

pytest.importorskip("pyogrio", reason="it comes with make formats")

from delfim.survey.enc.clearing import half_m, made
from delfim.survey.enc.dangers import LAYERS, Need
from delfim.survey.enc.dangers import charted as dangers
from delfim.survey.enc.reading import read_cell

LAKE = Path(__file__).parents[1] / "data/charts/US5OH10M.000.xz"
PLACES = {"Pelee": (41.76, -82.68), "Sandusky": (41.48, -82.76)}
ROOM_M = 6.0
PAIRS = 30  # at each place
KEPT_BACK = 20261128  # pairs that nobody has looked at while the search was made
STEP_M, TOLERANCE_M = 5.0, 2.0


class WayJudge:
    """The shortest ways, by what sees what (T. Lozano-Perez, M. A. Wesley, 1979), in water that is a little wider than it is:
    its answers are never longer than the shortest. x is east."""

    def __init__(self, field: ClearanceField) -> None:
        side = numpy.arange(-half_m(), half_m() + STEP_M, STEP_M)
        clear_m = numpy.array([[field.clear_m(north, east) for east in side] for north in side])
        areas, offsets = contourpy.contour_generator(side, side, clear_m, fill_type="OuterOffset").filled(ROOM_M, math.inf)
        self.waters = [_area(*each) for each in zip(areas, offsets, strict=True)]
        wide = shapely.union_all(self.waters).buffer(TOLERANCE_M).simplify(0.97 * TOLERANCE_M)
        self._wide = wide.buffer(0.02)  # so that the ways along its sides lie in it
        shapely.prepare(self._wide)
        self.corners = numpy.concatenate([_standing(each) for each in shapely.get_parts(wide)])
        self._links = [self._seen(corner) for corner in self.corners]

    def _seen(self, place: Any) -> list[tuple[int, float]]:
        ways = shapely.linestrings(numpy.stack([numpy.broadcast_to(place, self.corners.shape), self.corners], axis=1))
        seen = numpy.nonzero(shapely.covers(self._wide, ways))[0]
        return [(int(at), math.dist(place, self.corners[at])) for at in seen]

    def water(self, at: Point) -> int | None:
        """The number of the water that a place lies in."""
        place = shapely.Point(at[1], at[0])
        return next((number for number, each in enumerate(self.waters) if each.covers(place)), None)

    def shortest_m(self, a: Point, b: Point) -> float:
        begin, end = numpy.array(a[::-1]), numpy.array(b[::-1])
        if shapely.covers(self._wide, shapely.LineString([begin, end])):
            return math.dist(a, b)
        to_end = dict(self._seen(end))
        heap, done, best_m = [(far_m, at) for at, far_m in self._seen(begin)], set[int](), math.inf
        heapq.heapify(heap)
        while heap:
            far_m, at = heapq.heappop(heap)
            if at in done or far_m >= best_m:
                continue
            done.add(at)
            best_m = min(best_m, far_m + to_end.get(at, math.inf))
            for to, more_m in self._links[at]:
                heapq.heappush(heap, (far_m + more_m, to))
        return best_m


def _area(corners: Any, offsets: Any) -> Any:
    rings = [corners[first:last] for first, last in itertools.pairwise(offsets)]
    return shapely.make_valid(shapely.Polygon(rings[0], rings[1:]))


def _standing(area: Any) -> Any:
    """The corners of what is forbidden that stand out into the water."""
    found = [numpy.empty((0, 2))]
    for is_hole, ring in ((False, area.exterior), *((True, each) for each in area.interiors)):
        here = numpy.asarray(ring.coords)[:-1]
        back, on = here - numpy.roll(here, 1, axis=0), numpy.roll(here, -1, axis=0) - here
        turn = back[:, 0] * on[:, 1] - back[:, 1] * on[:, 0]
        found.append(here[turn < 0.0] if ring.is_ccw != is_hole else here[turn > 0.0])
    return numpy.concatenate(found)


@pytest.mark.long
@pytest.mark.parametrize("name", PLACES)
def test_ways_are_found_where_there_are_any_and_are_the_shortest_within_2_percent(name: str, tmp_path: Path) -> None:
    file = tmp_path / "US5OH10M.000"
    file.write_bytes(lzma.decompress(LAKE.read_bytes()))
    at = origin(*map(math.radians, PLACES[name]))
    water = read(made(dangers([read_cell(file, LAYERS)], Need(0.5)), at)).water("")
    field = laid(water._replace(basins=(basins_of(water.grids, ROOM_M),)), at)
    around, judge, drawn = Fence((charted("no-go", field),), config.FenceTable()), WayJudge(field), random.Random(KEPT_BACK)
    ratios, spent, apart, tried = list[float](), list[int](), list[int](), 0
    while len(ratios) < PAIRS:
        a, b = ((drawn.uniform(-5000.0, 5000.0), drawn.uniform(-5000.0, 5000.0)) for _ in range(2))
        waters = judge.water(a), judge.water(b)
        if None in waters or not all(field.clear_m(*place) >= ROOM_M for place in (a, b)):
            continue
        if field.least_m(a, b, ROOM_M)[0] == math.inf:
            continue  # the straight way is free
        work = Sliced(way_through(around, field, a, b, ROOM_M, []))
        by, tried = work.finish(), tried + 1
        assert work.spent < CHARTED_MOST
        if waters[0] != waters[1]:
            assert isinstance(by, Shut), (a, b)
            apart.append(work.spent)
            continue
        assert not isinstance(by, Shut), (a, b, by)
        way = [a, *by, b]
        assert all(may(around.zones[0], *place) for place in by)
        ratios.append(sum(itertools.starmap(math.dist, itertools.pairwise(way))) / judge.shortest_m(a, b))
        spent.append(work.spent)
    print(
        f"\n{name}: {len(ratios)} of {len(ratios)} ways found, {statistics.median(ratios):.4f} of the shortest (median), "
        f"{max(ratios):.4f} (most); comparisons {statistics.median(spent):,.0f} (median), {max(spent):,} (most); "
        f"no way {len(apart)} of {len(apart)} times, told after {max(apart, default=0):,} comparisons at most; "
        f"judged by {len(judge.corners)} corners"
    )
    assert max(ratios) <= 1.02
