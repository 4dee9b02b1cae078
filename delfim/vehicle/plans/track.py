"""The driven track, remembered for the way home: bounded, with its loops cut."""

import math

from delfim import config

Point = tuple[float, float]  # north_m, east_m
SWEPT = 32  # squares of removed points that one call clears
BACK = 16  # older points that one search for a harbour examines


def back(points: tuple[Point, ...], far_m: float) -> tuple[Point, ...]:
    """Points of a track, oldest first, up to the place that is so far back along it, or to its beginning."""
    last = len(points) - 1
    while last > 0 and far_m > 0.0:
        far_m -= math.dist(points[last], points[last - 1])
        last -= 1
    return points[: last + 1]


class Track:
    """Points of the driven track, `spacing_m` apart, oldest first, and where on it the way home ends.

    Loops are cut: where the boat comes back to within half a spacing of an older point, the points between are removed. All
    the rest was driven, and driving home along it shortens it. (Half a spacing is not more than a beam: no wall fits between.)
    When there are `points` of them, every second one is dropped and the spacing doubles. The cost of a call does not grow with
    the track except for that rare thinning, which the vehicle's file bounds by `points`.

    A piece is the straight way from a point to the one before it. Where a chart is aboard each is looked at (`piece`), and
    mended where nobody may sail it: with turns between its ends (`mend`), or without one of them (`drop`).
    """

    def __init__(self, home: config.HomeTable) -> None:
        self._spacing_m, self._cut_m, self._most = home.spacing_m, home.spacing_m / 2.0, home.points
        self._points: list[Point] = []
        self._cells: dict[tuple[int, int], int] = {}  # newest point in each square of side _cut_m; some were removed
        self._forgotten: list[Point] = []
        self._harbours, self._near_m = tuple[Point, ...](), 0.0
        self._end, self._unseen = 0, 0  # where the way home ends; how many old points were not searched
        self._low, self._top = 0, 1  # pieces are numbered as their newer points; looked at are those between these two

    def add(self, north_m: float, east_m: float) -> None:
        """Add the boat's present place; metres in the local plane."""
        self._cut(north_m, east_m)
        if self._forgotten:
            self._sweep()
        if self._points and math.dist(self._points[-1], (north_m, east_m)) < self._spacing_m:
            return
        if len(self._points) >= self._most:
            self._thin()
        self._cells[self._cell(north_m, east_m)] = len(self._points)
        self._points.append((north_m, east_m))
        if self._passes(self._points[-1]):
            self._end, self._unseen = len(self._points) - 1, 0

    def points(self) -> tuple[Point, ...]:
        """(north_m, east_m) of each remembered point, oldest first."""
        return tuple(self._points)

    def remembered(self) -> tuple[tuple[Point, ...], float]:
        """The points, and their spacing now."""
        return tuple(self._points), self._spacing_m

    def restore(self, points: tuple[Point, ...], spacing_m: float) -> None:
        """Go on with a track that was remembered; it replaces the present one."""
        self._points, self._spacing_m, self._forgotten = list(points), spacing_m, []
        self._cells = {self._cell(*point): index for index, point in enumerate(points)}
        self._end, self._unseen = 0, len(points)
        self.look_again()

    def way_home(self) -> tuple[Point, ...]:
        """The track from the last harbour that it passed, as far as the search has come."""
        return tuple(self._points[self._end :])

    def end(self) -> Point | None:
        """The points of the way home."""
        return self._points[self._end] if self._points else None

    def look_again(self) -> None:
        """Forget which pieces were looked at."""
        self._low = max(len(self._points) - 1, 0)
        self._top = self._low + 1

    def piece(self) -> tuple[Point, Point] | None:
        """A piece of the way home that nobody looked at, its newer point first; None: all were."""
        at = self._at()
        return (self._points[at], self._points[at - 1]) if self._end < at < len(self._points) else None

    def mend(self, turns: tuple[Point, ...]) -> None:
        """The piece is looked at, and leads by these turns, newest first."""
        at, many = self._at(), len(turns)
        if len(self._points) + many > self._most:
            self._thin()
            return
        if at == self._low:
            self._low, self._top = at - 1, self._top + many
        else:
            self._top += 1 + many
        self._points[at:at] = turns[::-1]
        self._shift(at, many)

    def drop(self, *, older: bool) -> bool:
        """The piece leads past one of its points, which is no place to go by. False: that is the newest point of all, or where
        the way home ends."""
        piece = self._at()
        at = piece - older
        if at == len(self._points) - 1 or at <= self._end:
            return False
        if piece == self._low:
            self._low -= older
            self._top = max(self._top - 1, self._low + 1)
        elif older:
            self._low, self._top = min(self._low, at - 1), at
        self._forgotten.append(self._points.pop(at))
        self._shift(at, -1)
        return True

    def call_at(self, harbours: tuple[Point, ...], near_m: float) -> None:
        """Set other harbours. `look_back` finds which of them the track passed."""
        self._harbours, self._near_m, self._end, self._unseen = harbours, near_m, 0, len(self._points)

    def look_back(self) -> None:
        """Search some of the older points, newest first, for a harbour nearby. Call it now and then."""
        if not (self._unseen and self._harbours):
            return
        for _ in range(min(BACK, self._unseen)):
            self._unseen -= 1
            if self._passes(self._points[self._unseen]):
                self._end, self._unseen = self._unseen, 0
                return

    def _passes(self, point: Point) -> bool:
        return any(math.dist(point, harbour) <= self._near_m for harbour in self._harbours)

    def _cut(self, north_m: float, east_m: float) -> None:
        """Remove the points after the oldest one that the boat stands on."""
        (row, column), newest = self._cell(north_m, east_m), self._cells.get
        columns = column - 1, column, column + 1
        last = len(self._points) - 1
        keep = last
        for i in (row - 1, row, row + 1):
            for j in columns:
                index = newest((i, j), last)
                if index < keep and math.dist(self._points[index], (north_m, east_m)) < self._cut_m:
                    keep = index
        if keep == last:
            return
        self._forgotten += self._points[keep + 1 :]
        del self._points[keep + 1 :]
        self._unseen = min(self._unseen, keep + 1)
        self._low, self._top = min(self._low, keep), min(self._top, keep + 1)
        if self._end > keep:
            self._end, self._unseen = 0, keep + 1

    def _sweep(self) -> None:
        """Clear squares of removed points, few at a time: a loop may have been long."""
        for _ in range(min(SWEPT, len(self._forgotten))):
            cell = self._cell(*self._forgotten.pop())
            index = self._cells.get(cell, -1)
            if index >= len(self._points) or (index >= 0 and self._cell(*self._points[index]) != cell):
                del self._cells[cell]

    def _thin(self) -> None:
        del self._points[1::2]
        self._spacing_m *= 2.0
        side_m, floor = self._cut_m, math.floor
        self._cells = {(floor(n / side_m), floor(e / side_m)): index for index, (n, e) in enumerate(self._points)}
        self._forgotten = []
        self._end, self._unseen = self._end // 2, (self._unseen + 1) // 2
        self.look_again()

    def _at(self) -> int:
        """The number of the piece that comes next."""
        if self._top <= self._end:  # a harbour was reached before they were looked at
            self._low, self._top = self._end, self._end + 1
        return self._low if self._low > self._end else self._top

    def _shift(self, at: int, many: int) -> None:
        """The points from here on have other numbers, by so many."""
        if at < self._unseen:
            self._unseen += many
        for index in range(at, len(self._points)) if many else ():
            self._cells[self._cell(*self._points[index])] = index

    def _cell(self, north_m: float, east_m: float) -> tuple[int, int]:
        return math.floor(north_m / self._cut_m), math.floor(east_m / self._cut_m)
