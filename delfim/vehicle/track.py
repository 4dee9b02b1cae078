"""The driven track, remembered for the way home: bounded, and without the loops."""

import math

from delfim import config


class Track:
    """Points of the driven track, `spacing_m` apart, oldest first.

    Loops are cut: where the boat comes back to within half a spacing of an older point, what lies between is forgotten. What
    remains was driven, and driving home along it shortens it. (Half a spacing is not more than a beam: no wall fits between.)
    When there are `points` of them, every second one is dropped and the spacing doubles. `add` takes constant time but for that
    rare thinning.
    """

    def __init__(self, home: config.HomeTable) -> None:
        self._spacing_m, self._cut_m, self._most = home.spacing_m, home.spacing_m / 2.0, home.points
        self._points: list[tuple[float, float]] = []
        self._cells: dict[tuple[int, int], int] = {}  # newest point in each square of side _cut_m

    def add(self, north_m: float, east_m: float) -> None:
        """The boat is here now; metres in the local plane."""
        self._cut(north_m, east_m)
        if self._points and math.dist(self._points[-1], (north_m, east_m)) < self._spacing_m:
            return
        if len(self._points) >= self._most:
            self._thin()
        self._cells[self._cell(north_m, east_m)] = len(self._points)
        self._points.append((north_m, east_m))

    def points(self) -> tuple[tuple[float, float], ...]:
        """(north_m, east_m) of each remembered point, oldest first."""
        return tuple(self._points)

    def _cut(self, north_m: float, east_m: float) -> None:
        """Forget what lies after the oldest point that the boat stands on."""
        row, column = self._cell(north_m, east_m)
        last = len(self._points) - 1
        keep = last
        for i in (row - 1, row, row + 1):
            for j in (column - 1, column, column + 1):
                index = self._cells.get((i, j), last)
                if index < keep and math.dist(self._points[index], (north_m, east_m)) < self._cut_m:
                    keep = index
        for point in self._points[keep + 1 :]:
            self._cells.pop(self._cell(*point), None)
        del self._points[keep + 1 :]

    def _thin(self) -> None:
        del self._points[1::2]
        self._spacing_m *= 2.0
        self._cells = {self._cell(*point): index for index, point in enumerate(self._points)}

    def _cell(self, north_m: float, east_m: float) -> tuple[int, int]:
        return math.floor(north_m / self._cut_m), math.floor(east_m / self._cut_m)
