"""What of a survey is done: of each line the parts along which there are good soundings close to it, however they came there.

It is kept by line and not by area, in a file beside the mission, and what is left are lines again. So a survey goes on after
an empty battery, a power cut or a lost link, by whichever boat.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Annotated, Final, Literal

import msgspec
import numpy as np
import shapely
from shapely import STRtree
from shapely.geometry import LineString, MultiPolygon

from delfim.base.errors import DelfimError, FormatError
from delfim.base.geodesy import origin
from delfim.base.input.unreadable import UNREADABLE
from delfim.base.input.untrusted import read_file
from delfim.base.wholefile import replace_file
from delfim.survey.areafile import Corner, Shape
from delfim.survey.ground import Ground, Place, Segment, in_degrees, in_plane, polygons, union
from delfim.survey.lines import AlongLines
from delfim.survey.planning import SurveyPlan

VERSION: Final = 1
BYTES: Final = 1 << 23
LIMIT: Final = 0.25  # of the spacing: what is no farther from its line is on it
APART_M: Final = 5.0  # between soundings along a line; at least LEAST_M, else half of the spacing
LEAST_M: Final = 3.0  # a gap that is no longer is none; nor is one up to LIMIT
OVERLAP_M: Final = 3.0  # a line that goes on begins so far in what is done
WHOLE: Final = 0.8  # of a line; of a longer one a spacing: what is shorter was sailed across
CELL_M: Final = 3.6  # from the middle of a cell of the page's chart to its corner
STRETCH_M: Final = 10.0  # of a gap that is looked at in one
MOST_M: Final = 100_000.0  # of a line
AMONG_DEG: Final = 45.0  # a line that lies farther off the heading of the longest one lies across
BESIDE_M: Final = 0.5  # lines that lie no farther apart are one
LONG: Final = 0.5  # of the longest line: shorter ones may be of a part beside their strip
ALONE_M: Final = 10.0  # the spacing of a survey of one line

Span = tuple[float, float]
"""From where to where along a line, m."""
Degrees = Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)]
Ends = tuple[tuple[Degrees, Degrees], tuple[Degrees, Degrees]]
"""Latitude and longitude of where a line begins and ends."""
Announced = tuple[float, float, float, float, float]
"""A number of MAVLink, and four of its own."""
Metres = Annotated[float, msgspec.Meta(ge=0.0, le=MOST_M)]
Wish = Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)]


class SurveyWishes(msgspec.Struct, forbid_unknown_fields=True):
    """What is asked of the lines: a key is one of LinesWanted; where it is None, what suits each boat."""

    spacing_m: Annotated[float, msgspec.Meta(gt=0.0, le=1000.0)]
    swath_m: Wish = 0.0
    heading_deg: Annotated[float, msgspec.Meta(ge=-720.0, le=720.0)] | None = None
    edges: bool = True
    cross_m: Wish = 0.0
    start: Literal["", "nw", "ne", "sw", "se"] = ""
    run_in_m: Wish | None = None
    room_m: Wish | None = None
    side: Literal["", "port", "starboard"] = ""
    radius_m: Wish | None = None
    speed_mps: Annotated[float, msgspec.Meta(gt=0.0, le=50.0)] | None = None


class KeptSurvey(msgspec.Struct, forbid_unknown_fields=True):
    """The file of a survey: what was asked for, its lines, numbered from 1 as they stand here, and what is done of each."""

    version: Annotated[int, msgspec.Meta(ge=VERSION, le=VERSION)]
    name: str
    areas: Annotated[list[Shape], msgspec.Meta(min_length=1)]
    asked: SurveyWishes
    heading_deg: Degrees
    across: Annotated[int, msgspec.Meta(ge=0)]  # so many of the lines, the last ones, lie across
    lines: Annotated[list[Ends], msgspec.Meta(min_length=1, max_length=10_000)]
    done: list[list[tuple[Metres, Metres]]]
    begin: Annotated[list[Announced], msgspec.Meta(max_length=100)] = []  # to payloads, where each line begins ...
    end: Annotated[list[Announced], msgspec.Meta(max_length=100)] = []  # ... and ends

    def __post_init__(self) -> None:
        if len(self.done) != len(self.lines) or self.across > len(self.lines):
            raise ValueError("its lines do not fit to what is done of them")

    def segments(self, ground: Ground) -> list[Segment]:
        """The lines in the plane of the survey."""
        return [(in_plane(ground.at, *a), in_plane(ground.at, *b)) for a, b in self.lines]


def kept(plans: Sequence[SurveyPlan], name: str, areas: list[Shape], asked: SurveyWishes) -> KeptSurvey:
    """The file of a survey that begins, by one boat or by several."""
    at = plans[0].ground.at
    heading = math.remainder(plans[0].heading_deg, 360.0)
    main = [line for plan in plans for line in plan.lines[: len(plan.lines) - plan.across]]
    across = [line for plan in plans for line in plan.lines[len(plan.lines) - plan.across :]]
    lines = [(in_degrees(at, *a), in_degrees(at, *b)) for a, b in (*main, *across)]
    return KeptSurvey(VERSION, name, areas, asked, heading, len(across), lines, [[] for _ in lines])


def by_lines(
    name: str, lines: Sequence[tuple[Corner, Corner]], spacing_m: float = 0.0, speed_mps: float | None = None
) -> KeptSurvey:
    """The survey of which only the lines are known, as from a mission that another operator sent; its area is what they cover.
    `spacing_m` 0: as they lie. Raises DelfimError."""
    at = origin(*map(math.radians, lines[0][0]))
    ends = [(in_plane(at, *begin), in_plane(at, *end)) for begin, end in lines]
    if min(math.dist(*each) for each in ends) < BESIDE_M:
        raise DelfimError(f"a line of less than {BESIDE_M} m")
    longest = max(ends, key=lambda line: math.dist(*line))
    turned = AlongLines(math.degrees(heading := _heading_rad(longest)))
    off = [abs(math.sin(_heading_rad(each) - heading)) > math.sin(math.radians(AMONG_DEG)) for each in ends]
    among = [
        LineString(each)
        for each, is_off in zip(ends, off, strict=True)
        if not is_off and math.dist(*each) > LONG * math.dist(*longest)
    ]
    sides = sorted(turned.of(each).centroid.y for each in among)
    steps = [after - before for before, after in pairwise(sides) if after - before > BESIDE_M]
    spacing_m = spacing_m or (median(steps) if steps else ALONE_M)
    swaths = [LineString(each).buffer(spacing_m / 2.0, cap_style="flat") for each in ends]
    areas = [
        Shape([in_degrees(at, *place) for place in part.exterior.coords[:-1]], [])
        for part in polygons(union([each for swath in swaths for each in polygons(swath)]))
    ]
    order = sorted(range(len(lines)), key=lambda number: off[number])
    wishes = SurveyWishes(spacing_m=spacing_m, speed_mps=speed_mps)
    heading_deg = math.remainder(math.degrees(heading), 360.0)
    its = [lines[number] for number in order]
    return KeptSurvey(VERSION, name, areas, wishes, heading_deg, sum(off), its, [[] for _ in its])


def _heading_rad(line: Segment) -> float:
    (x, y), (to_x, to_y) = line
    return math.atan2(to_x - x, to_y - y)


def read_survey(path: str | Path) -> KeptSurvey:
    """Read the file of a survey. Raises OSError, FormatError."""
    try:
        return msgspec.json.decode(read_file(path, BYTES), type=KeptSurvey)
    except UNREADABLE as error:
        raise FormatError(f"{path}: not the file of a survey: {error}") from None


def write_survey(survey: KeptSurvey, path: Path) -> None:
    """Write it, all or nothing."""
    replace_file(path, msgspec.json.encode(survey))


def sailed(lines: Sequence[Segment], places: Iterable[Place], spacing_m: float, one_way: bool = False) -> list[list[Span]]:
    """Of each line the parts that have a good sounding each few metres, no farther off than a quarter of the spacing. `places`:
    of soundings, in any order; where a boat has no sounder, of the boat. Parts shorter than a spacing are of who crossed it.
    `one_way`: places are in the order of time, and count for a line where the boat sailed it as it is written."""
    its = np.array([*places], float).reshape(-1, 2)
    limit_m, apart_m = LIMIT * spacing_m, max(LEAST_M, min(APART_M, spacing_m / 2.0))
    found = list[list[Span]]()
    for (x, y), (to_x, to_y) in lines:
        long_m = math.hypot(to_x - x, to_y - y)
        if not long_m:
            found.append([])
            continue
        ux, uy = (to_x - x) / long_m, (to_y - y) / long_m
        off = its - (x, y)
        along, aside = off[:, 0] * ux + off[:, 1] * uy, off[:, 0] * uy - off[:, 1] * ux
        is_on = (np.abs(aside) <= limit_m) & (along > -apart_m) & (along < long_m + apart_m)
        if one_way and len(along) > 1:
            is_on &= np.gradient(along) > 0.0
        on = np.sort(along[is_on])
        ends = np.flatnonzero(np.diff(on) > apart_m)
        begins = np.concatenate([[0], ends + 1]).astype(int)
        spans = zip(on[begins], on[np.append(ends, len(on) - 1)], strict=True) if len(on) else ()
        clipped = ((max(float(a), 0.0), min(float(b), long_m)) for a, b in spans)
        found.append([(a, b) for a, b in clipped if b - a > min(spacing_m, WHOLE * long_m)])
    return found


def merged(one: Iterable[Span], other: Iterable[Span]) -> list[Span]:
    """What is done by either; parts that touch are one."""
    found = list[Span]()
    for begin, end in sorted([*one, *other]):
        if found and begin <= found[-1][1] + 1e-6:
            found[-1] = found[-1][0], max(found[-1][1], end)
        else:
            found.append((begin, end))
    return found


def parts(line: Segment, spans: Iterable[Span]) -> list[Segment]:
    """These parts of a line."""
    (x, y), (to_x, to_y) = line
    long_m = math.hypot(to_x - x, to_y - y)
    ux, uy = (to_x - x) / long_m, (to_y - y) / long_m
    return [((x + a * ux, y + a * uy), (x + b * ux, y + b * uy)) for a, b in spans]


def least_m(spacing_m: float) -> float:
    """A gap that is no longer is none."""
    return max(LEAST_M, LIMIT * spacing_m)


def left(line: Segment, done: Iterable[Span], least_m: float = LEAST_M, joined_m: float = 0.0) -> list[Segment]:
    """The parts of a line that are not done, each a little longer than its gap; gaps of up to `least_m` are none. Parts
    that lie no farther apart than `joined_m` are sailed in one."""
    long_m, found = math.dist(*line), list[Span]()
    for begin, end in gaps(long_m, done):
        if end - begin > least_m:
            gap = max(begin - OVERLAP_M, 0.0), min(end + OVERLAP_M, long_m)
            is_near = found and gap[0] - found[-1][1] <= joined_m
            found[-1:] = [(found[-1][0], gap[1])] if is_near else [*found[-1:], gap]
    return parts(line, found)


def gaps(long_m: float, done: Iterable[Span]) -> Iterator[Span]:
    """What is not done of a line that is so long."""
    at = 0.0
    for begin, end in [*merged(done, ()), (long_m, long_m)]:
        if begin > at:
            yield at, begin
        at = max(at, end)


def with_covered(line: Segment, done: list[Span], places: STRtree, area: MultiPolygon, spacing_m: float) -> list[Span]:
    """What is done, and gaps about which the area is covered all the same: the boat went beside its line for a while.
    `places`: of all good soundings."""
    return merged(done, [gap for gap in gaps(math.dist(*line), done) if _is_covered(line, gap, places, area, spacing_m)])


def _is_covered(line: Segment, gap: Span, places: STRtree, area: MultiPolygon, spacing_m: float) -> bool:
    """Whether all of the area up to half a spacing beside this part of a line has a sounding no farther away than that, as the
    page sees it."""
    (x, y), (to_x, to_y) = line
    long_m = math.dist(*line)
    ux, uy = (to_x - x) / long_m, (to_y - y) / long_m
    reach_m = spacing_m / 2.0 + min(CELL_M, LIMIT * spacing_m)  # less than to the next line
    aside = np.linspace(-0.5, 0.5, 9) * spacing_m
    for begin in np.arange(gap[0], gap[1], STRETCH_M):
        end = min(begin + STRETCH_M, gap[1])
        a, b = np.meshgrid(np.append(np.arange(begin, end, spacing_m / 8.0), end), aside)
        asked = shapely.points(x + a * ux - b * uy, y + a * uy + b * ux).ravel()
        asked = asked[shapely.covers(area, asked)]
        if places.query_nearest(asked, max_distance=reach_m, all_matches=False).shape[1] < len(asked):
            return False
    return True


def told(survey: KeptSurvey, lines: Sequence[Segment]) -> list[str]:
    """How far a survey is, in lines: the lines that are done in part one by one."""
    longs, dones = [math.dist(*line) for line in lines], [done_m(done) for done in survey.done]
    short_m = least_m(survey.asked.spacing_m)
    rest = [left(line, done, short_m) for line, done in zip(lines, survey.done, strict=True)]
    begun = [number for number, done in enumerate(dones) if done and rest[number]]
    whole = sum(not each for each in rest)
    counts = f"{whole} of {len(lines)} lines done, {len(begun)} in part, {len(lines) - whole - len(begun)} not begun"
    said = [f"{survey.name}: {counts}; {sum(dones):,.0f} of {sum(longs):,.0f} m"]
    return said + [f"  line {number + 1}: {dones[number]:.0f} of {longs[number]:.0f} m" for number in begun]


def done_m(done: Iterable[Span]) -> float:
    return sum(end - begin for begin, end in merged(done, ()))
