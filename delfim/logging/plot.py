"""Pictures of a run from its state log: the track, and the latency figures 3-10 and 3-11 of the thesis. Needs matplotlib."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Columns = Mapping[str, Sequence[Any]]  # of the state log, by field name
INK, SEA, LINE, BOAT = "#1b2a33", "#f3f7f9", "#c9d6dd", "#d1495b"


def track(columns: Columns, waypoints: Sequence[tuple[float, float, float]], title: str, file: Path) -> None:
    """The driven track over the mission, north up, metres. Waypoints are (latitude_deg, longitude_deg, acceptance_m)."""
    figure, axes = _sheet((8, 8))
    latitude, longitude = columns["latitude"], columns["longitude"]
    known = [i for i, value in enumerate(latitude) if math.isfinite(value)]
    if not known:
        axes.set_title(f"{title}: no position was logged")
        _save(figure, file)
        return
    zero = latitude[known[0]], longitude[known[0]]

    def metres(latitude_rad: float, longitude_rad: float) -> tuple[float, float]:
        return (longitude_rad - zero[1]) * 6.378e6 * math.cos(zero[0]), (latitude_rad - zero[0]) * 6.367e6

    points = [metres(latitude[i], longitude[i]) for i in known]
    speeds = [math.hypot(columns["north_speed"][i], columns["east_speed"][i]) for i in known]
    marks = [(*metres(math.radians(la), math.radians(lo)), radius) for la, lo, radius in waypoints]
    axes.plot([p[0] for p in marks], [p[1] for p in marks], "--", color=LINE, lw=1.2, zorder=1)
    for number, (east_m, north_m, radius) in enumerate(marks, 1):
        axes.add_patch(_circle(east_m, north_m, radius))
        twins = [str(other) for other, mark in enumerate(marks, 1) if mark[:2] == (east_m, north_m)]
        label = "" if twins[0] != str(number) else ", ".join(twins)
        axes.annotate(label, (east_m, north_m), (9, 9), textcoords="offset points", color=INK, fontsize=10, weight="bold")
    dots = axes.scatter([p[0] for p in points], [p[1] for p in points], c=speeds, s=4, cmap="viridis", zorder=3)
    axes.plot(*points[0], "o", color=BOAT, ms=8, zorder=4)
    axes.annotate("start", points[0], (-9, 9), textcoords="offset points", ha="right", color=BOAT)
    figure.colorbar(dots, ax=axes, label="speed over ground, m/s", location="bottom", shrink=0.6, aspect=40, pad=0.02)
    axes.set(aspect="equal", xlabel="east, m", ylabel="north, m", title=title)
    axes.margins(0.08)
    _save(figure, file)


def latency(columns: Columns, title: str, file: Path) -> None:
    """Histogram of the critical path t0 to t4 (figure 3-10) above the stage means (figure 3-11)."""
    t0, t1, t2, t3, t4 = (columns[name] for name in ("t0", "t1", "t2", "t3", "t4"))
    path_us = sorted((b - a) / 1e3 for a, b in zip(t0, t4, strict=True) if 0 < a <= b)
    figure, (above, below) = _sheet((8, 8), 2)
    if path_us:
        edges = [10 ** (k / 20) for k in range(20, 101)]
        above.hist(path_us, bins=edges, color="#2e86ab", edgecolor="white", lw=0.4)
        above.set(xscale="log", yscale="log", xlabel="latency, µs", ylabel="samples")
        n = len(path_us)
        figures = {"p50": path_us[n // 2], "p99": path_us[int(n * 0.99)], "worst": path_us[-1]}
        for height, (name, value) in zip((0.97, 0.85, 0.73), figures.items(), strict=True):
            above.axvline(value, color=BOAT, lw=1, ls=":")
            at = {"xycoords": ("data", "axes fraction"), "fontsize": 9, "color": BOAT}
            above.annotate(f" {name} {value:.0f} µs", (value, height), **at)
        within = sum(value <= 100 for value in path_us) / n
        above.set_title(f"{title}\n{n} cycles, {within:.2%} within 100 µs")
    t5 = columns["previous_t5"][1:]
    spans = [(t0, t1), (t1, t2), (t2, t3), (t3, t4), (t4[:-1], t5)]
    means = [_mean([(b - a) / 1e3 for a, b in zip(*span, strict=True) if 0 < a <= b]) for span in spans]
    bars = below.bar(["poll", "navigation", "control", "propulsion", "log"], means, color="#2e86ab")
    below.bar_label(bars, fmt="%.1f", padding=2)
    below.set(ylabel="mean, µs", title="stages of the critical path, and the log after it")
    _save(figure, file)


def _mean(values: list[float]) -> float:
    return sum(values) / len(values) if values else 0.0


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
