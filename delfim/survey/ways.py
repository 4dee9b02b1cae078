"""Ways through the water between two places, round what is between: the shortest by the corners that see each other
(Lozano-Perez and Wesley 1979), searched by A*."""

import math
from collections.abc import Sequence
from functools import cached_property
from heapq import heappop, heappush
from itertools import pairwise
from typing import Final

import shapely
from shapely.geometry import LineString, MultiLineString, Point
from shapely.geometry.base import BaseGeometry
from shapely.ops import nearest_points

from delfim.base.errors import DelfimError
from delfim.survey.ground import Place, polygons
from delfim.vehicle.plans.mission import LEG_MIN_M

OFF_M: Final = 0.5  # a way turns so far from what it goes round
CORNERS: Final = 300  # of all that ways go round
PARTS: Final = 1.0, 0.75, 0.5, 1.0 / 3.0, 0.25, 0.0  # of a run-in, the longest for which there is water
SAME_M: Final = 0.005  # of the water: a line ends where it ends


class OpenWater:
    """Ways through one water."""

    def __init__(self, water: BaseGeometry, turning: BaseGeometry | None = None) -> None:
        """`turning`: where arcs may lie, if that is more."""
        self._inner, self._water = water, water.buffer(SAME_M)
        shapely.prepare(self._water)
        self._seen = dict[tuple[Place, Place], bool]()
        self.turning = self if turning is None else OpenWater(turning)

    @cached_property
    def _corners(self) -> list[Place]:
        return _corners(self._inner)

    def covers(self, ways: Sequence[Sequence[Place]]) -> bool:
        return bool(self._water.covers(MultiLineString(ways)))

    def beyond(self, begin: Place, end: Place, far_m: float) -> Place:
        """The place so far beyond the end of a line, or as far as there is water."""
        part = far_m / math.dist(begin, end)
        places = ((end[0] + each * part * (end[0] - begin[0]), end[1] + each * part * (end[1] - begin[1])) for each in PARTS)
        return next((place for place in places if self.free(end, place)), end)

    def out_to(self, come: Place | None, begin: Place, room_m: float) -> list[Place]:
        """The places where the way from the boat turns; none where it is not known, or where there is no way: the boat says so.
        A boat that lies nearer to a hole than lines are goes straight away from it first."""
        if come is None or self.free(come, begin):
            return []
        out = self.nearest(come)
        if math.dist(come, out) > room_m:
            return []
        try:
            places = [out, *self.between(out, begin)]
        except DelfimError:
            return []
        turns = places if math.dist(come, out) >= LEG_MIN_M else places[1:]
        return [here for here, after in pairwise([*turns, begin]) if math.dist(here, after) >= LEG_MIN_M]

    def free(self, a: Place, b: Place) -> bool:
        """Whether the straight way is water."""
        if (a, b) not in self._seen:
            self._seen[a, b] = self._seen[b, a] = math.dist(a, b) < SAME_M or self._water.covers(LineString([a, b]))
        return self._seen[a, b]

    def shores_m(self, places: Sequence[Place]) -> list[float]:
        """How far the water's edge is from each."""
        return list(map(float, shapely.distance(self._inner.boundary, shapely.points(places))))

    def nearest(self, place: Place) -> Place:
        """The place of the water that is nearest: the same, where it is water."""
        near = nearest_points(self._inner, Point(place))[0]
        return near.x, near.y

    def between(self, a: Place, b: Place) -> list[Place]:
        """The places where the shortest way turns. Raises DelfimError where there is none."""
        if self.free(a, b):
            return []
        far, came, done = {a: 0.0}, dict[Place, Place](), set[Place]()
        ahead = [(math.dist(a, b), a)]
        while ahead:
            _, here = heappop(ahead)
            if here == b:
                found = [here]
                while (here := came[here]) != a:
                    found.append(here)
                return found[:0:-1]
            if here in done:
                continue
            done.add(here)
            for there in (b, *self._corners):
                long_m = far[here] + math.dist(here, there)
                if there not in done and long_m < far.get(there, math.inf) and self.free(here, there):
                    far[there], came[there] = long_m, here
                    heappush(ahead, (long_m + math.dist(there, b), there))
        raise DelfimError(
            "holes or the fence part the area, and there is no way from one line to the next: survey its parts one by one"
        )


def _corners(water: BaseGeometry) -> list[Place]:
    """The corners that ways may turn at: those that stand out into the water, a little off, so that their sides are free."""
    off_m = OFF_M
    while True:
        open_water = water.buffer(-2.0 * off_m, join_style="mitre").simplify(off_m)
        found = list[Place]()
        for part in polygons(open_water):
            for ring in (part.exterior, *part.interiors):
                places = list(ring.coords)[:-1] if ring.is_ccw == (ring is part.exterior) else list(ring.coords)[:0:-1]
                for before, here, after in zip(places[-1:] + places[:-1], places, places[1:] + places[:1], strict=True):
                    turn = (here[0] - before[0]) * (after[1] - here[1]) - (here[1] - before[1]) * (after[0] - here[0])
                    if turn < 0.0:  # to the right, with the water to the left
                        found.append(here)
        if len(found) <= CORNERS or off_m > 50.0:
            return found[:CORNERS]
        off_m *= 2.0
