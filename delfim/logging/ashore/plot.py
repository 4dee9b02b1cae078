"""Pictures of a run from its state log: track, speeds, propellers, references, and the latency figures 3-10 and 3-11 of the
thesis. PNG or SVG, as the file's name says. Needs matplotlib."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from delfim.logging.ashore.summary import STAGES, critical_path_us, stages_us

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

Columns = Mapping[str, Any]  # of the state log, by field name
Waypoint = tuple[float, float, float]  # latitude, longitude, degrees; acceptance radius, m

POINTS_MAX: Final = 20_000  # drawn of a line
INK, SEA, LINE, BOAT, WATER, SAND = "#1b2a33", "#f3f7f9", "#c9d6dd", "#d1495b", "#2e86ab", "#e8b04a"


def draw(columns: Columns, waypoints: Sequence[Waypoint], title: str, folder: Path, form: str = "png") -> list[Path]:
    """Draw all pictures of a run into a folder, as "png" or "svg"."""
    files = {name: folder / f"{name}.{form}" for name in ("track", "speeds", "rpm", "references", "latency")}
    track(columns, waypoints, title, files["track"])
    speeds(columns, f"{title}: speeds", files["speeds"])
    rpm(columns, f"{title}: propellers", files["rpm"])
    references(columns, f"{title}: references and response", files["references"])
    latency(columns, f"{title}: critical path, t0 to t4", files["latency"])
    return list(files.values())


def track(columns: Columns, waypoints: Sequence[Waypoint], title: str, file: Path) -> None:
    """Draw the track over the mission, north up, metres."""
    figure, axes = _sheet((8, 8))
    its = _arrays(columns, "latitude", "longitude", "north_speed", "east_speed")
    latitude, longitude, north, east = (column[np.isfinite(its[0] + its[1])] for column in its)
    if not len(latitude):
        axes.set_title(f"{title}: no position was logged")
        _save(figure, file)
        return
    zero = float(latitude[0]), float(longitude[0])

    def metres(latitude_rad: Any, longitude_rad: Any) -> tuple[Any, Any]:
        return (longitude_rad - zero[1]) * 6.378e6 * math.cos(zero[0]), (latitude_rad - zero[0]) * 6.367e6

    marks = [(*metres(math.radians(la), math.radians(lo)), radius) for la, lo, radius in waypoints]
    axes.plot([p[0] for p in marks], [p[1] for p in marks], "--", color=LINE, lw=1.2, zorder=1)
    for number, (east_m, north_m, radius) in enumerate(marks, 1):
        axes.add_patch(_circle(east_m, north_m, radius))
        twins = [str(other) for other, mark in enumerate(marks, 1) if mark[:2] == (east_m, north_m)]
        label = "" if twins[0] != str(number) else ", ".join(twins)
        axes.annotate(label, (east_m, north_m), (9, 9), textcoords="offset points", color=INK, fontsize=10, weight="bold")
    some = slice(None, None, len(latitude) // POINTS_MAX + 1)
    x, y = metres(latitude[some], longitude[some])
    dots = axes.scatter(x, y, c=np.hypot(north, east)[some], s=4, cmap="viridis", zorder=3, rasterized=True)
    axes.plot(0, 0, "o", color=BOAT, ms=8, zorder=4)
    axes.annotate("start", (0, 0), (-9, 9), textcoords="offset points", ha="right", color=BOAT)
    figure.colorbar(dots, ax=axes, label="speed over ground, m/s", location="bottom", shrink=0.6, aspect=40, pad=0.02)
    place = f"of {math.degrees(zero[0]):.5f}, {math.degrees(zero[1]):.5f}"
    axes.set(aspect="equal", xlabel=f"east {place}, m", ylabel="north, m", title=title)
    axes.margins(0.08)
    _save(figure, file)


def speeds(columns: Columns, title: str, file: Path) -> None:
    """Draw speed over ground with its parts, and the rate of turn, over time."""
    figure, (above, below) = _sheet((10, 6), 2)
    north, east, yaw_rate = _arrays(columns, "north_speed", "east_speed", "yaw_rate")
    _lines(above, columns, {"over ground": np.hypot(north, east), "north": north, "east": east}, "m/s")
    _lines(below, columns, {"rate of turn, positive to starboard": np.degrees(yaw_rate)}, "deg/s")
    above.set_title(title, loc="left")
    _save(figure, file)


def rpm(columns: Columns, title: str, file: Path) -> None:
    """Draw the revolutions of each propeller, commanded and measured, or the command alone where they are not measured; and
    angles."""
    names = [name.removesuffix("_command") for name in columns if name.endswith("_command")] or ["starboard", "port"]
    turning = [name for name in names if f"{name}_angle" in columns]
    count = len(names) + len(turning)
    figure, sheets = _sheet((10, 1.0 + 2.5 * count), count)
    sheets = np.atleast_1d(sheets)
    for axes, name in zip(sheets, names, strict=False):
        commanded, measured, part = _arrays(columns, f"{name}_rpm", f"{name}_rpm_measured", f"{name}_command")
        if f"{name}_rpm" in columns or name + "_command" not in columns:
            _lines(axes, columns, {f"{name}, measured": measured, f"{name}, commanded": commanded}, "1/min")
        else:
            _lines(axes, columns, {f"{name}, commanded": part}, "of full command")
    for axes, name in zip(sheets[len(names) :], turning, strict=True):
        commanded, measured = map(np.degrees, _arrays(columns, f"{name}_angle", f"{name}_angle_measured"))
        _lines(axes, columns, {f"{name}, measured": measured, f"{name}, commanded": commanded}, "deg")
    sheets[0].set_title(title, loc="left")
    _save(figure, file)


def references(columns: Columns, title: str, file: Path) -> None:
    """Draw heading and speed, set points and actual values, and the cross-track error."""
    figure, (above, middle, below) = _sheet((10, 8), 3)
    heading, asked, speed, off = _arrays(columns, "heading", "reference_heading", "reference_speed", "cross_track")
    north, east = _arrays(columns, "north_speed", "east_speed")
    _lines(above, columns, {"heading": _compass(heading), "reference": _compass(asked)}, "deg")
    _lines(middle, columns, {"speed over ground": np.hypot(north, east), "reference": speed}, "m/s")
    _lines(below, columns, {"cross track, positive to starboard of the line": off}, "m")
    above.set_title(title, loc="left")
    above.set(ylim=(0, 360), yticks=range(0, 361, 90))
    _save(figure, file)


def latency(columns: Columns, title: str, file: Path) -> None:
    """Draw a histogram of the critical path t0 to t4 (figure 3-10) above the stage means (figure 3-11)."""
    stamps = ("t0", "t1", "t2", "t3", "t4", "previous_t5")
    arrays = dict(zip(stamps, _arrays(columns, *stamps), strict=True))
    path_us = critical_path_us(arrays)
    figure, (above, below) = _sheet((8, 8), 2)
    if len(path_us):
        above.hist(path_us, bins=10 ** (np.arange(20, 101) / 20), color=WATER, edgecolor="white", lw=0.4)
        above.set(xscale="log", yscale="log", xlabel="latency, µs", ylabel="samples")
        figures = {"p50": np.percentile(path_us, 50), "p99": np.percentile(path_us, 99), "worst": path_us.max()}
        for height, (name, value) in zip((0.97, 0.85, 0.73), figures.items(), strict=True):
            above.axvline(value, color=BOAT, lw=1, ls=":")
            side = "right" if value > 1e4 else "left"
            at = {"xycoords": ("data", "axes fraction"), "fontsize": 9, "color": BOAT, "ha": side}
            above.annotate(f" {name} {value:.0f} µs ", (value, height), **at)
        above.set_title(f"{title}\n{len(path_us)} cycles, {np.mean(path_us <= 100):.2%} within 100 µs")
    else:
        above.set_title(f"{title}\nnot measured: the clock stood still, as in lock step")
    bars = below.bar(STAGES, stages_us(arrays), color=WATER)
    below.bar_label(bars, fmt="%.1f", padding=2)
    below.margins(y=0.12)
    below.set(ylabel="mean, µs", title="stages of the critical path, and the log after it")
    _save(figure, file)


def _arrays(columns: Columns, *names: str) -> "list[NDArray[Any]]":
    """These columns as arrays; NaN for those that are not there."""
    length = len(columns["t1"])
    return [np.asarray(columns[name]) if name in columns else np.full(length, np.nan) for name in names]


def _lines(axes: "Axes", columns: Columns, lines: "Mapping[str, NDArray[Any]]", unit: str) -> None:
    """Draw values over UTC; of many points only a part."""
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    (stamps,) = _arrays(columns, "t1")
    some = slice(None, None, len(stamps) // POINTS_MAX + 1)
    times = stamps[some].astype("datetime64[ns]")
    for (name, values), color in zip(lines.items(), (WATER, BOAT, SAND), strict=False):
        axes.plot(times, values[some], color=color, lw=1.1, label=name)
    locator = AutoDateLocator()  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    axes.set(ylabel=unit)
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=3, fontsize=8, frameon=False)  # beside the data


def _compass(heading_rad: "NDArray[Any]") -> "NDArray[Any]":
    """Headings in degrees, 0..360, broken where a line would cross the whole picture."""
    degrees: NDArray[Any] = np.degrees(heading_rad).astype(float) % 360.0
    degrees[1:][np.abs(np.diff(degrees)) > 180.0] = np.nan
    return degrees


def _sheet(size: tuple[float, float], rows: int = 1) -> "tuple[Figure, Any]":
    from matplotlib.figure import Figure  # a quarter of a second; only pictures pay it

    figure = Figure(figsize=size, layout="constrained", facecolor="white")
    axes = figure.subplots(rows)
    for one in [axes] if rows == 1 else axes:
        _quiet(one)
    return figure, axes


def _quiet(axes: "Axes") -> None:
    axes.set_facecolor(SEA)
    axes.grid(color=LINE, lw=0.5)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _circle(x: float, y: float, radius: float) -> Any:
    from matplotlib.patches import Circle

    return Circle((x, y), radius, facecolor="#e8b04a33", edgecolor="#e8b04a", lw=1, zorder=2)


def _save(figure: "Figure", file: Path) -> None:
    figure.savefig(file, dpi=120, bbox_inches="tight")
