"""The page of a chart: what the bed looks like, how good the soundings are, what was corrected and what was refused."""

import math
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from delfim.desk.htmlpage import picture, table, whole
from delfim.survey.chart.making import CROSSED, SurveyChart, uncertain
from delfim.survey.chart.passes import ORDERS, within
from delfim.survey.chart.reduction import REASONS
from delfim.survey.chart.takehome import utc

COLOURS: Final = "viridis_r"  # the shoal is bright
INK, REFUSED, TRACK = "#1b2a33", "#b4232f", "#8797a0"
SHOWN: Final = 20_000  # soundings in a picture
CONTOURS: Final = 400  # in a picture; of more, the longest


def page(chart: SurveyChart, files: Sequence[Path], command: str) -> str:
    """The text of the page. `command` makes the chart again."""
    body = [
        *_head(chart, command),
        *_map(chart),
        *_figures(chart),
        *_crossings(chart),
        *_tests(chart),
        *_time(chart),
        *_corrected(chart),
        *_files(files),
    ]
    return whole(f"{chart.boat}: the chart of a survey", body)


def _head(chart: SurveyChart, command: str) -> Iterator[str]:
    at, its = utc(chart.its.at_s[[0, -1]]), chart.its
    yield f"<h1>The chart of a survey by {escape(chart.boat)}</h1>"
    yield f"<p class=soft>{escape(chart.soundings.source)}; {at[0][:16]} to {at[1][:16]} UTC. "
    yield f"Again: <code>{escape(command)}</code></p>"
    order, one_m = chart.order(), chart.uncertainty.sounding_m
    if math.isnan(one_m):
        yield "<p class=fails>No lines cross: nothing says how good the soundings are. Sail cross lines (--cross).</p>"
    else:
        words = f"as far as depths go, they keep to S-44 order {order}" if order else "they keep to no order of S-44"
        yield f"<p class={'holds' if order else 'fails'}>A sounding is good to {one_m:.2f} m (95 %), as {len(chart.crossings)} "
        yield f"crossings say; {words}.</p>"
    if its.tide_m.any():
        yield "<p>Depths are below the datum of the tide's table.</p>"
    else:
        yield "<p class=fails>No tide was taken off: depths are below the water as it stood. Give --tide FILE.</p>"
    yield "<p class=soft>A single beam measures lines. What lies between them was not seen, whatever the surface shows: "
    yield "boulders may be missing. Not for navigation.</p>"


def _map(chart: SurveyChart) -> Iterator[str]:
    its = chart.its
    yield f"<h2>Depths</h2>{picture(depths(chart), 'Depths by colour, with contours')}"
    figure = Figure(figsize=(10, 4.4), layout="tight")
    axes = _plane(figure, chart, 121)
    step = max(1, len(its.at_s) // SHOWN)
    axes.plot(its.east_m[::step], its.north_m[::step], ".", color=TRACK, ms=1)
    bad = np.flatnonzero(~its.good & np.isfinite(its.east_m))
    axes.plot(its.east_m[bad], its.north_m[bad], "x", color=REFUSED, ms=3, label="refused")
    axes.plot(
        [each.east_m for each in chart.crossings],
        [each.north_m for each in chart.crossings],
        "+",
        color=INK,
        ms=4,
        label="crossing",
    )
    axes.legend(fontsize=7)
    axes.set_title("soundings", fontsize=9)
    if math.isnan(chart.uncertainty.sounding_m):
        yield picture(figure, "Where soundings were taken")
        return
    axes = _plane(figure, chart, 122)
    shade = axes.imshow(uncertain(chart), origin="lower", extent=_extent(chart), cmap="cividis_r", vmin=0.0)
    figure.colorbar(shade, ax=axes, label="m, 95 %", shrink=0.8)
    axes.set_title("uncertainty", fontsize=9)
    yield picture(figure, "Where soundings were taken, and how sure each cell is")


def depths(chart: SurveyChart) -> Figure:
    """The map of depths with contours."""
    grid, figure = chart.surface, Figure(figsize=(10, 7), layout="tight")
    low, high = np.nanpercentile(grid.whole_m, [0.5, 99.5])
    axes = _plane(figure, chart)
    shade = axes.imshow(grid.whole_m, origin="lower", extent=_extent(chart), cmap=COLOURS, vmin=low, vmax=high)
    figure.colorbar(shade, ax=axes, label="depth, m", shrink=0.8).ax.invert_yaxis()
    for depth_m, places in sorted(chart.contours, key=lambda each: -len(each[1]))[:CONTOURS]:
        axes.plot(places[:, 0], places[:, 1], color=INK, lw=0.5)
        if len(places) > 30:
            middle = places[len(places) // 2]
            axes.annotate(f"{depth_m:g}", middle, fontsize=6, color=INK, ha="center", va="center")
    return figure


def _extent(chart: SurveyChart) -> tuple[float, float, float, float]:
    its = chart.surface
    rows, columns = its.whole_m.shape
    return its.west_m, its.west_m + columns * its.cell_m, its.south_m, its.south_m + rows * its.cell_m


def _plane(figure: Figure, chart: SurveyChart, place: int = 111) -> Axes:
    axes = figure.add_subplot(place)
    axes.set_aspect("equal")
    axes.set_xlabel(f"east, m (EPSG:{chart.its.epsg})", fontsize=8)
    axes.set_ylabel("north, m", fontsize=8)
    axes.tick_params(labelsize=7)
    axes.ticklabel_format(useOffset=False, style="plain")
    axes.tick_params(axis="x", rotation=20)
    return axes


def _figures(chart: SurveyChart) -> Iterator[str]:
    its, grid = chart.its, chart.surface
    good = its.good
    sounded, whole_cells = int(grid.sounded.sum()), int(np.isfinite(grid.whole_m).sum())
    low, high = (float(each) for each in (its.depth_m[good].min(), its.depth_m[good].max()))
    lines = sum(each.long_m for each in chart.passes)
    accuracy = np.concatenate([each.track.accuracy_m for each in chart.tracks])
    rows: list[tuple[str, object]] = [
        ("soundings that are believed", int(good.sum())),
        *((f"refused: {reason}", int((its.why == number).sum())) for number, reason in enumerate(REASONS) if number),
        ("depths, m", f"{low:.2f} to {high:.2f}, mean {float(its.depth_m[good].mean()):.2f}"),
        ("straight passes", f"{len(chart.passes)}, {lines:,.0f} m"),
        ("from line to line, m", round(chart.spacing_m, 1)),
        ("cells", f"{grid.cell_m:g} m; {sounded} sounded, {100.0 * sounded / whole_cells:.0f} % of the {whole_cells} charted"),
        ("contours, each", f"{chart.interval_m:g} m"),
        ("a sounding is good to, m (95 %)", chart.uncertainty.sounding_m),
        ("between lines, more, m (95 %)", chart.uncertainty.between_m),
    ]
    rows = [(what, "not known" if isinstance(value, float) and math.isnan(value) else value) for what, value in rows]
    if np.isfinite(accuracy).any():
        rows.append(("position, as the receiver states it, m (median)", float(np.nanmedian(accuracy))))
    yield "<h2>Figures</h2>" + table(("", ""), rows)
    yield "<p class=soft>Crossings tell what differs from pass to pass: position, waves, sounder. What is the same for all of "
    yield "them, a wrong draught, tide or speed of sound, they do not show. "
    yield "The figure between lines is by lines that were left out.</p>"


def _crossings(chart: SurveyChart) -> Iterator[str]:
    if not chart.crossings:
        return
    off = np.array([each.off_m for each in chart.crossings])
    mean_m = max(float(np.mean([each.depth_m for each in chart.crossings])), 0.0)
    yield f"<h2>Crossings</h2><p>{len(off)} of them: mean {off.mean():+.3f} m, standard deviation {off.std():.3f} m, "
    yield f"95 % within {np.percentile(np.abs(off), 95):.3f} m.</p>"
    rows = [
        (
            name,
            f"±{within(name, mean_m):.2f}",
            f"{chart.keeping(name):.1f} %",
            "holds" if chart.keeping(name) >= CROSSED else "",
        )
        for name in ORDERS
    ]
    yield table(("S-44 order", f"allowed at {mean_m:.1f} m (95 %)", "crossings that keep to it", ""), rows)
    figure = Figure(figsize=(7, 2.6), layout="tight")
    axes = figure.subplots()
    axes.hist(off, bins=min(60, 8 + len(off) // 4), color="#0a5fa8")
    axes.set(xlabel="later less earlier depth, m")
    _quiet(axes)
    yield picture(figure, "Histogram of the differences where lines cross")


def _tests(chart: SurveyChart) -> Iterator[str]:
    if (late := chart.latency) is not None:
        yield f"<h2>Patch test</h2><p>Depths come {late.latency_s:.2f} s ±{late.spread_s:.2f} late, by {late.pairs} pairs of "
        yield f"lines to and fro: <code>latency_s = {late.latency_s:.2f}</code> in <code>[sounder]</code>.</p>"
    if (bar := chart.bar) is not None:
        yield f"<h2>Bar check</h2><p>The transducer is {bar.draught_m:.2f} m below the water line: "
        yield f"<code>draught_m = {bar.draught_m:.2f}</code> in <code>[sounder]</code>"
        if bar.sound != 1.0:
            yield f"; sound goes {bar.sound:.4f} of what the sounder takes; the bar is off by {bar.left_m:.3f} m at most"
        yield ".</p>"


def _time(chart: SurveyChart) -> Iterator[str]:
    its = chart.its
    step = max(1, len(its.at_s) // SHOWN)
    hours = (its.at_s - its.at_s[0]) / 3600.0
    figure = Figure(figsize=(10, 3.4), layout="tight")
    axes = figure.subplots()
    good = np.flatnonzero(its.good)[::step]
    axes.plot(hours[good], its.depth_m[good], ".", ms=1, color="#0a5fa8", label="depth")
    bad = np.flatnonzero(~its.good)[:SHOWN]
    axes.plot(hours[bad], its.depth_m[bad], "x", ms=3, color=REFUSED, label="refused")
    if its.tide_m.any():
        axes.plot(hours[::step], its.tide_m[::step], color="#0f7a4d", lw=1.2, label="tide")
    axes.invert_yaxis()
    axes.set(xlabel="hours", ylabel="m")
    axes.legend(fontsize=7)
    _quiet(axes)
    yield f"<h2>In the order of time</h2>{picture(figure, 'Depths, refused echoes and the tide over time')}"


def _corrected(chart: SurveyChart) -> Iterator[str]:
    by, tide = chart.by, chart.its.tide_m
    words = "none" if by.tide is None else f"{by.tide.source}: {float(tide.min()):.2f} to {float(tide.max()):.2f} m"
    rows: list[tuple[str, object]] = [
        ("tide", words),
        ("draught of the transducer, m", by.draught_m or "as the sounder tells it"),
        ("speed of sound, by what the sounder takes", round(by.sound, 5)),
        ("transducer ahead and to starboard, m", f"{by.ahead_m:g}, {by.starboard_m:g}"),
        ("latency, s", round(by.latency_s, 3)),
        ("beam, within which a tilt changes nothing, deg", by.beam_deg),
    ]
    yield "<h2>Corrected</h2>" + table(("", ""), rows)


def _files(files: Sequence[Path]) -> Iterator[str]:
    rows = [(file.name, f"{file.stat().st_size / 1000.0:,.0f} kB") for file in files]
    yield "<h2>Files</h2>" + table(("", ""), rows)


def _quiet(axes: Axes) -> None:
    axes.grid(color="#dde5ea", lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8)
