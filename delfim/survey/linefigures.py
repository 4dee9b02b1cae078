"""How well each line was sailed: by where the boat was, or believed to be."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Final, NamedTuple

from delfim.base.errors import DelfimError
from delfim.base.geodesy import Origin, origin
from delfim.logging.ashore.table import Columns
from delfim.survey.ground import Place, Segment, in_plane
from delfim.vehicle.plans.mission import Mission, PathPoint, Waypoint

GAP_M: Final = 5.0  # along a line, between two places: more is not sailed
BEYOND_M: Final = 5.0  # just before a line and behind it: so far off at most


class LineFigures(NamedTuple):
    """Of one line; NaN where the boat never was on it. Distances from the line are in m, in the plane."""

    line: int  # from 1
    length_m: float
    sailed: float  # part of its length that was sailed, 0..1
    rms_m: float
    p95_m: float  # 95 % of its places are nearer than this
    most_m: float


def figures(lines: Mapping[int, Segment], track: Iterable[tuple[int, Place]], within_m: float = math.inf) -> list[LineFigures]:
    """The figures of lines by their numbers. `track`: places (east, north in m), each with the line that the boat was on, as
    the log's field `line` has it; `within_m`: farther off, a line is not sailed.

    Where a line begins and ends the boat knows as well as where it is: what it sailed of the line just before and just behind
    counts, too."""
    rows, places = dict[int, list[tuple[float, float]]](), list(track)
    for number, place in (*places, *_besides(lines, places), *_besides(lines, reversed(places))):
        if number in lines:
            rows.setdefault(number, []).append(beside(lines[number], place))
    return [_of_line(number, math.dist(*segment), rows.get(number, []), within_m) for number, segment in lines.items()]


def _besides(lines: Mapping[int, Segment], track: Iterable[tuple[int, Place]]) -> Iterator[tuple[int, Place]]:
    """Places of no line, with the line that came before them, as far as they lie along it."""
    on = 0
    for number, place in track:
        on = number or on
        if number or on not in lines:
            continue
        along_m, across_m = beside(lines[on], place)
        if 0.0 <= along_m <= math.dist(*lines[on]) and abs(across_m) <= BEYOND_M:
            yield on, place
        else:
            on = 0


def lines_of(mission: Mission) -> tuple[Origin, dict[int, Segment]]:
    """The lines of a mission by their numbers, in the plane of the origin. Raises DelfimError where it has none."""
    rows: Sequence[Waypoint | PathPoint] = mission.waypoint
    if not any(row.line for row in rows) and mission.path:
        rows = mission.path
    at = origin(math.radians(rows[0].latitude_deg), math.radians(rows[0].longitude_deg))
    places = [in_plane(at, row.latitude_deg, row.longitude_deg) for row in rows]
    lines = dict[int, Segment]()
    for number, row in enumerate(rows):
        if number and row.line:
            lines[row.line] = lines.get(row.line, (places[number - 1], places[number]))[0], places[number]
    if not lines:
        raise DelfimError(f"{mission.name}: its legs have no numbers of lines: make it with delfim survey lines")
    return at, lines


def track_of(columns: Columns, at: Origin) -> Iterator[tuple[int, Place]]:
    """The places of a state log, each with the line that the boat was on."""
    if "line" not in columns:
        raise DelfimError("the log is of a boat that did not tell lines yet")
    names = "line", "latitude", "longitude"
    for line, latitude_rad, longitude_rad in zip(*(columns[name].tolist() for name in names), strict=True):
        if math.isfinite(latitude_rad + longitude_rad):
            yield line, in_plane(at, math.degrees(latitude_rad), math.degrees(longitude_rad))


def told(rows: Sequence[LineFigures]) -> Iterator[str]:
    """The figures as a table for people, and all lines together."""
    yield "LINE    LENGTH   SAILED     RMS    95 %    MOST"
    for row in rows:
        off = "".join("       -" if math.isnan(each) else f"{each:6.2f} m" for each in (row.rms_m, row.p95_m, row.most_m))
        yield f"{row.line:4} {row.length_m:7.1f} m {100.0 * row.sailed:6.1f} %{off}"
    length_m = sum(row.length_m for row in rows)
    sailed_m, known = sum(row.sailed * row.length_m for row in rows), [row for row in rows if not math.isnan(row.rms_m)]
    rms_m = math.sqrt(sum(row.rms_m**2 * row.length_m for row in known) / max(sum(row.length_m for row in known), 1e-9))
    yield f" all {length_m:7.1f} m {100.0 * sailed_m / length_m:6.1f} %{rms_m:6.2f} m"


def beside(line: Segment, place: Place) -> tuple[float, float]:
    """(along, across) of a place: m from the line's beginning, and m to starboard of it."""
    (x, y), (to_x, to_y) = line
    length_m = math.dist(*line)
    ux, uy, dx, dy = (to_x - x) / length_m, (to_y - y) / length_m, place[0] - x, place[1] - y
    return dx * ux + dy * uy, dx * uy - dy * ux


def _of_line(number: int, length_m: float, row: Sequence[tuple[float, float]], within_m: float) -> LineFigures:
    off = sorted(abs(across) for along, across in row if 0.0 <= along <= length_m)
    if not off:
        return LineFigures(number, length_m, 0.0, math.nan, math.nan, math.nan)
    sailed_m, reached_m = 0.0, 0.0
    good = sorted(along for along, across in row if abs(across) <= within_m)
    for a, b in pairwise(good):
        if b - a <= GAP_M:
            low, high = max(a, reached_m), min(b, length_m)
            sailed_m += max(high - low, 0.0)
            reached_m = max(reached_m, high)
    rms_m = math.sqrt(sum(each * each for each in off) / len(off))
    p95_m = off[min(math.ceil(0.95 * len(off)), len(off)) - 1]
    return LineFigures(number, length_m, sailed_m / length_m, rms_m, p95_m, off[-1])
