"""An area cut into lines at one heading: strips of one spacing, each with a line in its middle as far as the strip goes.

A line goes on where its middle has left the area and the strip about it has not, so that the edges are covered. Where the
middle of a strip is blocked, by a hole or a fence, and the strip beside it is not, that part has a line of its own.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import Final, NamedTuple

import shapely
from shapely import affinity
from shapely.geometry import LineString, Polygon, box
from shapely.geometry.base import BaseGeometry

from delfim.base.errors import DelfimError
from delfim.survey.ground import Place, Segment, polygons
from delfim.vehicle.plans.mission import ROWS

STRIPS: Final = ROWS // 2  # a line is two places of a mission
LEAST_M: Final = 2.0  # a line is no shorter
HARDLY: Final = 0.004  # of a spacing: what an area is wider, as by the digits of its corners, gets no line
IGNORED: Final = 0.02  # of the square of the spacing: a part of a strip that is no larger gets no line
ROUNDS: Final = 3  # of lines for what the lines before have left
LOOKS: Final = 7  # places across such a part where its line may lie
STEP_DEG: Final = 15
SIDES: Final = 24  # of the area, the longest, whose headings are tried
Span = tuple[float, float]
"""From where to where, along a line."""


class Cut(NamedTuple):
    """How an area is cut."""

    spacing_m: float  # from line to line
    wide_m: float  # what a line covers
    edges: bool  # lines go as far as their strip; False: as far as they are in the area
    joined_m: float  # lines in one are joined over a gap that is no longer, because a turn is
    side: int = 0  # of the line that its sensor looks to: 1 starboard, -1 port, 0 both


class Strip(NamedTuple):
    """A line as it lies in its strip, from one end to the other."""

    number: int  # of the strip
    is_middle: bool  # or of a part beside it
    line: Segment
    sense: int = 0  # 1, -1: sailed as it is written, which is along the heading or against it; 0: either way


class LaidLine(NamedTuple):
    """A line in its strip."""

    sense: int  # as that of the strip
    y: float  # the middle of what it covers
    span: Span


class AlongLines:
    """The area with its lines along x, and the way back."""

    def __init__(self, heading_deg: float) -> None:
        self._by_deg = heading_deg - 90.0
        back_rad = math.radians(-self._by_deg)
        self._c, self._s = math.cos(back_rad), math.sin(back_rad)

    def of(self, shape: BaseGeometry) -> BaseGeometry:
        return affinity.rotate(shape, self._by_deg, origin=(0.0, 0.0))

    def back(self, x: float, y: float) -> Place:
        return self._c * x - self._s * y, self._s * x + self._c * y


def strips(area: BaseGeometry, water: BaseGeometry, heading_deg: float, cut: Cut) -> list[Strip]:
    """The lines of the area, strip by strip. Raises DelfimError where there are too many."""
    turned = AlongLines(heading_deg)
    land, free = turned.of(area), turned.of(water)
    shapely.prepare(land)
    shapely.prepare(free)
    west, south, east, north = land.bounds
    half_m, found = cut.wide_m / 2.0, list[Strip]()
    for number, middle_y in enumerate(rows(south, north, cut)):
        inside = [*polygons(land.intersection(box(west - 1.0, middle_y - half_m, east + 1.0, middle_y + half_m)))]
        sense = cut.side if number % 2 else -cut.side  # the first one looks inwards from the edge
        at = min(max(middle_y + _aside_m(sense, cut), south), north)  # the outermost lines of one side lie on the edge
        y = at - _aside_m(sense, cut)
        if cut.edges:
            spans = [each for part in inside for each in _reach(free, at, part.bounds[0], part.bounds[2])]
        else:
            spans = [each for span in _reach(land, y, west - 1.0, east + 1.0) for each in _reach(free, at, *span)]
        middle = [_long(free, at, span) for span in _joined(spans, free, at, cut.joined_m)]
        laid = [LaidLine(sense, y, span) for span in middle]
        beside = list(_beside(inside, laid, free, cut)) if cut.edges else []
        for is_middle, (its, level, (begin, end)) in [*((True, each) for each in laid), *((False, each) for each in beside)]:
            if end - begin >= LEAST_M / 2.0:
                ends = turned.back(begin, level + _aside_m(its, cut)), turned.back(end, level + _aside_m(its, cut))
                found.append(Strip(number, is_middle, ends if its >= 0 else ends[::-1], its))
        if len(found) > STRIPS:
            raise DelfimError(
                f"more than {STRIPS} lines, and each is two of the {ROWS} places of a mission: take the area in parts"
            )
    return found


def _aside_m(sense: int, cut: Cut) -> float:
    """How far beside the middle of what it covers a line lies that is sailed along the heading, or against it (-1)."""
    return sense * cut.side * cut.wide_m / 2.0


def rows(south: float, north: float, cut: Cut) -> list[float]:
    """Where lines lie across an area, centred. Raises DelfimError where there are too many."""
    count = max(1, math.ceil((north - south - cut.wide_m) / cut.spacing_m - HARDLY) + 1)
    if count > STRIPS:
        raise DelfimError(
            f"{count} lines {cut.spacing_m:g} m apart, and more than {STRIPS} are no survey: take the area in parts"
        )
    first = (south + north - (count - 1) * cut.spacing_m) / 2.0
    return [first + number * cut.spacing_m for number in range(count)]


def _reach(free: BaseGeometry, y: float, begin: float, end: float) -> list[Span]:
    """The water of a line between two places."""
    along = free.intersection(LineString([(begin, y), (end, y)]))
    return [
        (part.bounds[0], part.bounds[2])
        for part in getattr(along, "geoms", [along])
        if part.geom_type == "LineString" and part.length
    ]


def _joined(spans: Iterable[Span], free: BaseGeometry, y: float, gap_m: float) -> list[Span]:
    """Spans that overlap, or have a short gap of water between them, as one."""
    found = list[Span]()
    for begin, end in sorted(spans):
        last = found[-1] if found else None
        if last and (begin <= last[1] or (begin - last[1] <= gap_m and free.covers(LineString([(last[1], y), (begin, y)])))):
            found[-1] = last[0], max(last[1], end)
        else:
            found.append((begin, end))
    return found


def _long(free: BaseGeometry, y: float, span: Span) -> Span:
    """A span that is too short for a line, as long as a line where there is water."""
    begin, end = span
    if end - begin >= LEAST_M:
        return span
    middle = (begin + end) / 2.0
    around = _reach(free, y, middle - LEAST_M / 2.0, middle + LEAST_M / 2.0)
    return next((each for each in around if each[0] <= middle <= each[1]), span)


def _beside(inside: Sequence[Polygon], middle: Sequence[LaidLine], free: BaseGeometry, cut: Cut) -> Iterator[LaidLine]:
    """Lines for the parts of a strip along which its middle is no water, or where a line that looks to one side is none."""
    half_m, left = cut.wide_m / 2.0, [*inside]
    taken = [box(begin, y - half_m, end, y + half_m) for _, y, (begin, end) in middle]
    for _ in range(ROUNDS):
        for each in taken:
            left = [part for whole in left for part in polygons(whole.difference(each))]
        left = [part for part in left if part.area > IGNORED * cut.spacing_m**2]
        taken = []
        for part in left:
            west, south, east, north = part.bounds
            levels = [south + (north - south) * (look + 0.5) / LOOKS for look in range(LOOKS)]
            ways = [(sense, y) for sense in ((1, -1) if cut.side else (0,)) for y in levels]
            reaches = [(way, _through(free, *way, (west, east), cut)) for way in ways]
            (sense, y), spans = max(reaches, key=lambda reach: sum(end - begin for begin, end in reach[1]))
            for span in spans:
                taken.append(box(span[0], y - half_m, span[1], y + half_m))
                yield LaidLine(sense, y, _long(free, y + _aside_m(sense, cut), span))
        if not taken:
            return


def _through(free: BaseGeometry, sense: int, y: float, span: Span, cut: Cut) -> list[Span]:
    """The water of the line that covers a level."""
    at = y + _aside_m(sense, cut)
    return _joined(_reach(free, at, *span), free, at, cut.joined_m)


def headings(area: BaseGeometry, spacing_m: float) -> list[float]:
    """Headings worth a look, degrees: all around, and along the area's longest sides."""
    found = {float(each) for each in range(0, 180, STEP_DEG)}
    sides = list[tuple[float, float]]()
    for ring in rings(area):
        for (x, y), (to_x, to_y) in pairwise(ring):
            if (long_m := math.hypot(to_x - x, to_y - y)) > 2.0 * spacing_m:
                sides.append((long_m, math.degrees(math.atan2(to_x - x, to_y - y)) % 180.0))
    return sorted(found | {round(heading, 3) for _, heading in sorted(sides, reverse=True)[:SIDES]})


def rings(area: BaseGeometry) -> list[list[Place]]:
    return [list(ring.coords) for part in polygons(area) for ring in (part.exterior, *part.interiors)]


def rough_s(area: list[list[Place]], heading_deg: float, cut: Cut, speed_mps: float, turn_s: float) -> float:
    """The time of the lines of a heading, each with a turn, by where their middles cross the area's sides."""
    along = math.radians(heading_deg)
    c, s = math.cos(along), math.sin(along)
    turned = [[(x * s + y * c, y * s - x * c) for x, y in ring] for ring in area]
    across = [y for ring in turned for _, y in ring]
    try:
        at = rows(min(across), max(across), cut)
    except DelfimError:
        return math.inf
    crossed = [list[float]() for _ in at]
    for ring in turned:
        for (x, y), (to_x, to_y) in pairwise(ring):
            if y == to_y:
                continue
            low, high = min(y, to_y), max(y, to_y)
            first, last = math.ceil((low - at[0]) / cut.spacing_m), math.floor((high - at[0]) / cut.spacing_m)
            for number in range(max(first, 0), min(last, len(at) - 1) + 1):
                if low < at[number] <= high:
                    crossed[number].append(x + (at[number] - y) * (to_x - x) / (to_y - y))
    long_m, count = 0.0, 0
    for places in crossed:
        places.sort()
        pieces = [end - begin for begin, end in zip(places[::2], places[1::2], strict=False)]
        long_m, count = long_m + sum(pieces), count + len(pieces)
    return long_m / speed_mps + count * turn_s
