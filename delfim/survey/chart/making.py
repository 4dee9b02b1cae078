"""From a boat's log to a chart of depths: read, reduce, clean, lay into cells, compare where lines cross, write for others."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from delfim import __version__, config
from delfim.base.errors import DelfimError
from delfim.base.projection import plane
from delfim.logging.ashore.tree import Span
from delfim.survey.chart import reduction, takehome
from delfim.survey.chart.passes import ORDERS as S44
from delfim.survey.chart.passes import (
    Crossing,
    FoundLatency,
    StraightPass,
    crossings,
    one_sounding_m,
    passes,
    patch_test,
    within,
)
from delfim.survey.chart.reduction import PlacedTrack, Reduced, SoundingCorrections, placed, reduced
from delfim.survey.chart.soundings import Array, Soundings, joined, read
from delfim.survey.chart.surface import CELL_M, Surface, contours, interval_of, misses, surface
from delfim.survey.chart.tide import Tide, by_rtk

REACH: Final = 2.2  # spacings: the longest side of a triangle between lines
SPACING_M: Final = 10.0  # where there are no two lines beside each other
FARTHEST_M: Final = 200.0  # of a spacing that is looked for
HALF: Final = 0.5  # of how far the surface misses lines that were left out: they are twice as far apart
CROSSED: Final = 95.0  # percent of the crossings that must keep to an order

Said = Callable[[str], object]


class Bar(NamedTuple):
    """A plate was hung at this depth below the water line, from one time to another."""

    depth_m: float
    from_s: float
    to_s: float


class BarFound(NamedTuple):
    """What a bar check says of the sounder."""

    draught_m: float
    sound: float  # speed of sound of the water by that which the sounder takes; 1: one depth alone does not tell
    left_m: float  # the most that a depth of the bar is off then


class Uncertainty(NamedTuple):
    """95 %, m; NaN where nothing tells it."""

    sounding_m: float  # of one, by crossings
    between_m: float  # of the surface between lines, by lines that were left out


class SurveyChart(NamedTuple):
    """A chart with all that it was made of."""

    boat: str
    soundings: Soundings
    tracks: list[PlacedTrack]
    by: SoundingCorrections
    its: Reduced
    passes: list[StraightPass]
    crossings: list[Crossing]
    surface: Surface
    spacing_m: float
    interval_m: float
    contours: list[tuple[float, Array]]
    uncertainty: Uncertainty
    latency: FoundLatency | None
    bar: BarFound | None

    def order(self) -> str:
        """The strictest order of S-44 that CROSSED percent of the crossings keep to, as far as depths go; "" for none."""
        return next((name for name in S44 if self.keeping(name) >= CROSSED), "")

    def keeping(self, order: str) -> float:
        """The crossings, percent, whose two depths differ by no more than two of this order may; NaN without any."""
        if not self.crossings:
            return math.nan
        kept = [abs(each.off_m) <= math.sqrt(2.0) * within(order, max(each.depth_m, 0.0)) for each in self.crossings]
        return 100.0 * sum(kept) / len(kept)


def read_part(
    log: str,
    span: Span,
    sounder: config.SounderTable | None,
    sound_mps: float | None,
    tide: Tide | None,
    rtk_datum_m: float | None,
) -> tuple[Soundings, SoundingCorrections]:
    """A log between two times, with what is known of its sounder: by a vehicle's file, or as it was logged. `sound_mps` is the
    speed of sound in the water; `rtk_datum_m` the datum's height above the ellipsoid, by which the antenna tells the tide.
    Each log is read by itself: of two boats, times overlap. Raises DelfimError, OSError."""
    found = read(log, span)
    its = sounder or found.sounder or config.SounderTable()
    if rtk_datum_m is not None:
        tide = by_rtk(found.track, its.antenna_m, rtk_datum_m)
    sound = 1.0 if sound_mps is None else sound_mps / its.sound_mps
    known = SoundingCorrections(its.ahead_m, its.starboard_m, its.draught_m, its.latency_s, sound, its.beam_deg, tide)
    return found, known._replace(confidence=its.confidence)


def made(
    boat: str,
    parts: Sequence[tuple[Soundings, SoundingCorrections]],
    *,
    cell_m: float = CELL_M,
    spacing_m: float | None = None,
    interval_m: float | None = None,
    find_latency: bool = False,
    bars: Sequence[Bar] = (),
    say: Said = lambda words: None,
) -> SurveyChart:
    """Make the chart of the soundings of one boat or of several, each with its corrections. `find_latency`: by lines to and
    fro, and use it. Raises DelfimError in words where there is none."""
    say("places")
    bar, latency, tracks = None, None, list[PlacedTrack]()
    for part, _ in parts:
        tracks.append(placed(part.track, tracks[0].epsg if tracks else 0))
    if bars:
        bar = bar_check(joined([part for part, _ in parts]), bars)
        parts = [
            (_without(part, bars), by._replace(draught_m=bar.draught_m, sound=by.sound if bar.sound == 1.0 else bar.sound))
            for part, by in parts
        ]

    def again(late_s: float | None) -> Reduced:
        rows = ((row, track, by) for (row, by), track in zip(parts, tracks, strict=True))
        moved = ((row, track, by if late_s is None else by._replace(latency_s=late_s)) for row, track, by in rows)
        return reduction.joined([reduced(*each) for each in moved])

    if find_latency:
        say("latency")
        latency = patch_test(again)
    say("depths")
    its = again(None if latency is None else latency.latency_s)
    by = parts[0][1] if latency is None else parts[0][1]._replace(latency_s=latency.latency_s)
    every = joined([part for part, _ in parts])
    if not its.good.any():
        raise DelfimError("no sounding is left: none has both an echo and a place")
    found = passes(its)
    say("crossings")
    crossed = crossings(found, its)
    spacing_m = spacing_m or spacing_of(found)
    say("surface")
    good = its.good
    whole = surface(its.east_m[good], its.north_m[good], its.depth_m[good], cell_m, REACH * spacing_m)
    interval_m = interval_m or interval_of(whole.whole_m)
    between_m = _left_out(its, found, whole.cell_m, spacing_m)
    uncertainty = Uncertainty(one_sounding_m(crossed), between_m)
    lines = contours(whole, interval_m)
    return SurveyChart(
        boat, every, tracks, by, its, found, crossed, whole, spacing_m, interval_m, lines, uncertainty, latency, bar
    )


def spacing_of(found: Sequence[StraightPass]) -> float:
    """The spacing of lines: the median way across from a pass to the next one beside it."""
    lines = [each for each in found if each.long_m > 2.0 * SPACING_M]
    if len(lines) < 2:
        return SPACING_M
    begins, ends = np.array([each.begin for each in lines]), np.array([each.end for each in lines])
    middles, ways = (begins + ends) / 2.0, ends - begins
    ways /= np.hypot(*ways.T)[:, None]
    nearest = list[float]()
    for number, (middle, way) in enumerate(zip(middles, ways, strict=True)):
        off = middles - middle
        across, along = np.abs(off[:, 0] * way[1] - off[:, 1] * way[0]), np.abs(off @ way)
        beside = (np.abs(ways @ way) > 0.95) & (across > 1.0) & (along < lines[number].long_m)
        if beside.any():
            nearest.append(float(across[beside].min()))
    found_m = float(np.median(nearest)) if nearest else SPACING_M
    return min(max(found_m, 1.0), FARTHEST_M)


def _left_out(its: Reduced, found: Sequence[StraightPass], cell_m: float, spacing_m: float) -> float:
    """How far the surface is off between lines, 95 %: each second line is left out, and the surface of the others is compared
    with it; it bridges twice the spacing."""
    along = [each for each in found if each.long_m > 2.0 * spacing_m]
    if len(along) < 4:
        return math.nan
    longest = max(along, key=lambda each: each.long_m)
    way = np.subtract(longest.end, longest.begin) / longest.long_m
    beside = [each for each in along if abs(np.subtract(each.end, each.begin) @ way) > 0.95 * each.long_m]
    beside.sort(key=lambda each: float(np.subtract(each.begin, longest.begin) @ np.array([way[1], -way[0]])))
    if len(beside) < 4:
        return math.nan
    kept, left = (np.concatenate([each.numbers for each in beside[first::2]]) for first in (0, 1))
    thin = surface(its.east_m[kept], its.north_m[kept], its.depth_m[kept], cell_m, 2.0 * REACH * spacing_m)
    off = misses(thin, its.east_m[left], its.north_m[left], its.depth_m[left])
    off = off[np.isfinite(off)]
    return HALF * float(np.percentile(np.abs(off), 95)) if len(off) > 20 else math.nan


def bar_check(soundings: Soundings, bars: Sequence[Bar]) -> BarFound:
    """The draught of the transducer by a plate that was hung below it, and with two depths or more the speed of sound. Raises
    DelfimError where a time has no soundings."""
    told = list[float]()
    for bar in bars:
        during = soundings.range_m[(soundings.at_s >= bar.from_s) & (soundings.at_s <= bar.to_s)]
        if len(during) < 3:
            raise DelfimError(f"no soundings of the bar at {bar.depth_m:g} m in that time")
        told.append(float(np.median(during)))
    depths, ranges = np.array([bar.depth_m for bar in bars]), np.array(told)
    sound = 1.0
    if np.ptp(depths) > 0.5:
        sound = float(np.polyfit(ranges, depths, 1)[0])
    off = depths - sound * ranges
    draught_m = float(off.mean())
    if not (0.9 < sound < 1.1 and -0.05 <= draught_m <= 20.0):
        raise DelfimError(
            f"no bar is where it is said to be: it makes a draught of {draught_m:.2f} m, and sound {sound:.2f} of it"
        )
    return BarFound(max(draught_m, 0.0), sound, float(np.abs(off - draught_m).max()))


def _without(soundings: Soundings, bars: Sequence[Bar]) -> Soundings:
    kept = np.ones(len(soundings.at_s), bool)
    for bar in bars:
        kept &= (soundings.at_s < bar.from_s) | (soundings.at_s > bar.to_s)
    return soundings._replace(**{name: getattr(soundings, name)[kept] for name in Soundings._fields[:5]})


def uncertain(chart: SurveyChart) -> Array:
    """The uncertainty of each cell, 95 %, m: of a sounded one that of soundings, else with what lies between lines."""
    one_m, between_m = chart.uncertainty
    its = chart.surface
    found = np.where(its.sounded, one_m, math.hypot(one_m, between_m))
    return np.where(np.isfinite(its.whole_m), found, np.nan)


def write(
    chart: SurveyChart, folder: Path, provider: takehome.CsbProvider | None, say: Said = lambda words: None
) -> list[Path]:
    """Write all files of a chart but the report into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    its, grid = chart.its, chart.surface
    say("GeoTIFF")
    made_of = f"depth below datum, m, positive down; Delfim {__version__}"
    takehome.geotiff(folder / "depth.tif", grid.whole_m, grid, its.epsg, made_of)
    takehome.geotiff(folder / "shoalest.tif", grid.least_m, grid, its.epsg, f"the shoalest sounding of a cell: {made_of}")
    files = [folder / "depth.tif", folder / "shoalest.tif"]
    if math.isfinite(chart.uncertainty.sounding_m):
        takehome.geotiff(folder / "uncertainty.tif", uncertain(chart), grid, its.epsg, "of the depth, 95 %, m")
        files.append(folder / "uncertainty.tif")
    say("GeoPackage")
    takehome.geopackage(folder / "survey.gpkg", _layers(chart))
    say("soundings")
    takehome.xyz(folder / "soundings.xyz", its)
    takehome.csv(folder / "soundings.csv", chart.soundings, its)
    files += [folder / "survey.gpkg", folder / "soundings.xyz", folder / "soundings.csv"]
    if provider is not None:
        takehome.crowd_sourced(folder / "csb.geojson", its, provider, chart.boat, __version__)
        files.append(folder / "csb.geojson")
    return files


def told(chart: SurveyChart) -> list[str]:
    """What is to be known of a chart, in lines."""
    its, one_m, order = chart.its, chart.uncertainty.sounding_m, chart.order()
    good = its.good
    low, high = (float(each) for each in (its.depth_m[good].min(), its.depth_m[good].max()))
    refused = f"{len(good) - int(good.sum())} refused" if not good.all() else "none refused"
    lines = [f"{int(good.sum()):,} soundings, {refused}; {low:.2f} to {high:.2f} m deep"]
    if (late := chart.latency) is not None:
        lines.append(
            f"depths come {late.latency_s:.2f} s ±{late.spread_s:.2f} late: [sounder] latency_s = {late.latency_s:.2f}"
        )
    if (bar := chart.bar) is not None:
        sound = f", and sound goes {bar.sound:.4f} of what the sounder takes" if bar.sound != 1.0 else ""
        lines.append(
            f"the transducer is {bar.draught_m:.2f} m below the water: [sounder] draught_m = {bar.draught_m:.2f}{sound}"
        )
    if math.isnan(one_m):
        lines.append("no lines cross: nothing says how good the soundings are")
    else:
        kept = f"S-44 order {order}" if order else "no order of S-44"
        lines.append(
            f"{len(chart.crossings)} crossings: a sounding is good to {one_m:.2f} m (95 %); {kept}, as far as depths go"
        )
    if not its.tide_m.any():
        lines.append("no tide was taken off: depths are below the water as it stood")
    return lines


def _layers(chart: SurveyChart) -> list[takehome.Layer]:
    its, back = chart.its, plane(chart.its.epsg, np)[1]
    latitude, longitude = its.degrees()
    placed_ = np.isfinite(its.east_m)
    box = (
        float(longitude[placed_].min()),
        float(latitude[placed_].min()),
        float(longitude[placed_].max()),
        float(latitude[placed_].max()),
    )
    lines = [(takehome.line(*back(places[:, 0], places[:, 1])), depth_m) for depth_m, places in chart.contours]
    good, bad = np.flatnonzero(its.good), np.flatnonzero(placed_ & ~its.good)
    at = takehome.utc
    return [
        takehome.Layer("contours", "LINESTRING", {"depth_m": "REAL"}, lines, box),
        takehome.Layer(
            "soundings",
            "POINT",
            {"depth_m": "REAL", "line": "INTEGER", "utc": "TEXT"},
            zip(
                takehome.points(longitude[good], latitude[good]),
                np.round(its.depth_m[good], 3).tolist(),
                chart.soundings.line[good].astype(int).tolist(),
                at(its.at_s[good]),
                strict=True,
            ),
            box,
        ),
        takehome.Layer(
            "refused",
            "POINT",
            {"depth_m": "REAL", "utc": "TEXT"},
            zip(
                takehome.points(longitude[bad], latitude[bad]),
                np.round(its.depth_m[bad], 3).tolist(),
                at(its.at_s[bad]),
                strict=True,
            ),
            box,
        ),
    ]
