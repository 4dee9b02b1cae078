"""The page of a campaign: verdicts, figures and pictures in one HTML file, which needs neither network nor server."""

import math
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

import duckdb
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from delfim.campaign.queries import (
    Holding,
    Printed,
    failed,
    numeric,
    quantities,
    selected,
    sensitivity,
    share,
    worst,
)
from delfim.campaign.runplan import Plan
from delfim.campaign.sailing import sailed_run
from delfim.campaign.store import head_of
from delfim.desk.htmlpage import picture, shown, table, whole
from delfim.simulator.lockstep import Lockstep

PAGE: Final = "report.html"
POINTS_SHOWN: Final = 50
TRACKS: Final = 6
BINS: Final = 40
CELLS: Final = 12  # of a heat map along an axis


def write(
    folder: Path,
    plan: Plan,
    database: duckdb.DuckDBPyConnection,
    verdicts: Sequence[Holding],
    answers: Sequence[Printed],
    command: str,
    earlier: duckdb.DuckDBPyConnection | None,
) -> Path:
    """Write the page into the folder and return its path. `earlier`: the results of a campaign to compare with."""
    keys = list(dict.fromkeys([*(key for _, values in plan.points for key in values), *plan.draw]))
    body = [
        *_head(folder, plan, database, verdicts),
        *(f"<h2>{escape(name)}</h2>{table(columns, rows)}" for name, columns, rows in answers),
        *_failures(database, command),
        *([] if earlier is None else _compared(database, earlier)),
        *_points(plan, database),
        *_measured(database),
        *_moved(database, keys),
        *_heat(database, keys),
        *_ends(database),
        *_worst(plan, database, command),
    ]
    page = folder / PAGE
    page.write_text(whole(plan.name, body), encoding="utf-8")
    return page


def _head(folder: Path, plan: Plan, database: duckdb.DuckDBPyConnection, verdicts: Sequence[Holding]) -> Iterator[str]:
    sql = "select count(*), count_if(not ok), sum(sailed_s), sum(cpu_s), string_agg(distinct version, '; ') from runs"
    runs, bad, sailed_s, cpu_s, versions = selected(database, sql)[1][0]
    low, high = share(bad, runs)
    head = head_of(folder)
    beside = ", ".join(f"{name} {version}" for name, version in head["packages"].items())
    told = f"{versions}; campaign {plan.digest}; evaluated on {head['platform']} with {beside}"
    yield f"<h1>{escape(plan.name)}</h1><p class=soft>{escape(told)}</p>"
    for name, holds, where in verdicts:
        at = f" (points {', '.join(map(str, where[:10]))})" if where else ""
        yield f"<p class={'holds' if holds else 'fails'}>{'Holds' if holds else 'Fails'}: {escape(name)}{at}</p>"
    hours = f"{(sailed_s or 0.0) / 3600.0:.1f} hours at sea in {cpu_s / 3600.0:.2f} hours of a processor"
    yield f"<p>{runs} runs at {len(plan.points)} points, {hours}. "
    yield f"{bad} failed: {bad / runs:.3%}, 95 % confidence {low:.3%} to {high:.3%}.</p>"


def _failures(database: duckdb.DuckDBPyConnection, command: str) -> Iterator[str]:
    rows = failed(database)
    if rows:
        told = [(many, words, f"{command} --again {point}:{seed}") for words, many, point, seed in rows[:20]]
        yield "<h2>What failed</h2>" + table(("runs", "why", "one of them again"), told)


def _points(plan: Plan, database: duckdb.DuckDBPyConnection) -> Iterator[str]:
    """A row for each point: how many passed, with the interval, and the median of the measures that people want first."""
    wanted = [
        each.name
        for each in quantities(database)
        if each.name in ("cross_rms_m", "cross_max_m", "noticed_s", "energy_j", "sailed_s")
    ]
    middles = "".join(f", median({name})" for name in wanted)
    rows = selected(
        database,
        f"select point, count(*), count_if(ok){middles} from runs group by point order by count_if(ok) / count(*), point",
    )[1]
    told = list[tuple[object, ...]]()
    for point, runs, good, *values in rows[:POINTS_SHOWN]:
        story, what = plan.stories[plan.points[point][0]], plan.points[point][1]
        low, high = share(good, runs)
        words = ", ".join(f"{key} = {shown(value)}" for key, value in what.items()) or "the vehicle's file"
        told.append(
            (point, f"{story.boat}, {story.name}: {words}", runs, f"{good / runs:.2%}", f"{low:.2%} to {high:.2%}", *values)
        )
    yield "<h2>Points</h2>" + table(
        ("point", "what", "runs", "passed", "95 % confidence", *(f"{name}, median" for name in wanted)), told
    )
    if len(rows) > POINTS_SHOWN:
        yield f"<p class=soft>The {POINTS_SHOWN} worst of {len(rows)} points.</p>"


def _measured(database: duckdb.DuckDBPyConnection) -> Iterator[str]:
    told = quantities(database)
    yield "<h2>Measures</h2>" + table(("measure", "runs", "5 %", "median", "95 %"), [tuple(each) for each in told])
    drawn = [each.name for each in told if each.high > each.low and not each.name.startswith("end_")]
    if drawn:
        figure, places = _grid(len(drawn))
        for axes, name in zip(places, drawn, strict=False):
            values = _column(database, name)
            axes.stairs(*np.histogram(values, BINS), fill=True, color="#0a5fa8")
            axes.set_title(name, fontsize=9)
        yield picture(figure, "Distributions")


def _moved(database: duckdb.DuckDBPyConnection, keys: Sequence[str]) -> Iterator[str]:
    rows = sensitivity(database, keys)
    if rows:
        told = [(key, name, f"{value:+.2f}") for key, name, value in rows[:15]]
        yield "<h2>What moves what</h2><p class=soft>Rank correlation over all runs, the strongest first.</p>" + table(
            ("key", "measure", ""), told
        )


def _heat(database: duckdb.DuckDBPyConnection, keys: Sequence[str]) -> Iterator[str]:
    """Draw the share of passed runs and the median of the first measure, over each pair of keys that are numbers."""
    known = numeric(database, keys)[:4]
    pairs = [(a, b) for i, a in enumerate(known) for b in known[i + 1 :]]
    names = {each.name for each in quantities(database)}
    name = next((each for each in ("cross_rms_m", "noticed_s", "sailed_s") if each in names), "")
    if not pairs:
        return
    figure, places = _grid(2 * len(pairs), columns=2, height=3.4)
    for number, (a, b) in enumerate(pairs):
        _map(figure, places[2 * number], database, (a, b), "cast(ok as double)", "share that passed", 0.0, 1.0)
        _map(figure, places[2 * number + 1], database, (a, b), name, f"{name}, mean")
    yield "<h2>Pairs of keys</h2>" + picture(figure, "Heat maps")


def _map(
    figure: Figure,
    axes: Axes,
    database: duckdb.DuckDBPyConnection,
    keys: tuple[str, str],
    sql: str,
    title: str,
    low: float | None = None,
    high: float | None = None,
) -> None:
    """Draw a map over two keys. `low` and `high`: ends of the scale of colours, where those of the values do not serve."""
    rows = np.array(
        selected(database, f'select "{keys[0]}", "{keys[1]}", {sql} from runs where {sql} is not null')[1], dtype=float
    ).reshape(-1, 3)
    edges = [_edges(rows[:, i]) for i in (0, 1)]
    sums = np.histogram2d(rows[:, 0], rows[:, 1], bins=edges, weights=rows[:, 2])[0]
    counts = np.histogram2d(rows[:, 0], rows[:, 1], bins=edges)[0]
    with np.errstate(invalid="ignore"):
        drawn = axes.pcolormesh(edges[0], edges[1], (sums / counts).T, cmap="viridis", vmin=low, vmax=high)
    figure.colorbar(drawn, ax=axes)
    axes.set(xlabel=keys[0], ylabel=keys[1])
    axes.set_title(title, fontsize=9)


def _edges(values: Any) -> Any:
    """The edges of cells: around each value where there are few, else evenly spaced."""
    known = np.unique(values)
    if len(known) > CELLS:
        return np.linspace(known[0], known[-1], CELLS + 1)
    middles = (known[1:] + known[:-1]) / 2 if len(known) > 1 else np.array([])
    half = (known[1] - known[0]) / 2 if len(known) > 1 else 0.5
    return np.concatenate([[known[0] - half], middles, [known[-1] + half]])


def _ends(database: duckdb.DuckDBPyConnection) -> Iterator[str]:
    rows = selected(
        database,
        "select end_east_m, end_north_m, ok from runs where end_north_m is not null using sample 20000 rows (reservoir, 1)",
    )[1]
    if not rows:
        return
    figure = Figure(figsize=(6, 6))
    axes = figure.subplots()
    for good, colour, words in ((True, "#0a5fa8", "passed"), (False, "#b4232f", "failed")):
        some = [(east, north) for east, north, ok in rows if ok is good]
        if some:
            east, north = zip(*some, strict=True)
            axes.scatter(east, north, s=4, c=colour, label=words, alpha=0.5)
    axes.set(xlabel="east, m", ylabel="north, m", aspect="equal")
    axes.legend()
    yield "<h2>Where boats ended</h2>" + picture(figure, "Ends")


def _worst(plan: Plan, database: duckdb.DuckDBPyConnection, command: str) -> Iterator[str]:
    rows = worst(database)
    told = [(point, seed, why, f"{command} --again {point}:{seed}") for point, seed, why in rows]
    yield "<h2>The worst ten</h2>" + table(("point", "seed", "why", "again, to the last byte"), told)
    figure, places = _grid(min(len(rows), TRACKS), columns=3, height=3.2)
    for axes, (point, seed, _) in zip(places, rows[:TRACKS], strict=False):
        track = _track(plan, point, seed)
        if track:
            north, east = zip(*track, strict=True)
            axes.plot(east, north, color="#0a5fa8", linewidth=1)
            axes.plot(east[-1:], north[-1:], "o", color="#b4232f", markersize=4)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_title(f"point {point}, seed {seed}", fontsize=9)
    yield picture(figure, "Tracks of the worst")


def _track(plan: Plan, point: int, seed: int) -> list[tuple[float, float]]:
    """The track, north and east, of the run, which is sailed once more; of one that cannot be sailed, what there is."""
    places = list[tuple[float, float]]()

    def look(run: Lockstep) -> None:
        if (origin := run.state.origin) is not None:
            model = run.nodes.model
            north_m = (model.latitude_rad - origin.latitude_rad) * origin.north_m_per_rad
            places.append((north_m, (model.longitude_rad - origin.longitude_rad) * origin.east_m_per_rad))

    try:
        sailed_run(plan, point, seed, look)
    except Exception as error:  # the run's own error, which its row tells
        places = places or [(0.0, 0.0)]
        error.add_note(f"point {point}, seed {seed}")
    return places


def _compared(database: duckdb.DuckDBPyConnection, earlier: duckdb.DuckDBPyConnection) -> Iterator[str]:
    """Compare runs of the same point and seed, before and now."""
    yield "<h2>Compared with the earlier campaign</h2>"
    now, was = (
        {(point, seed): rest for point, seed, *rest in selected(each, "select point, seed, ok, digest from runs")[1]}
        for each in (database, earlier)
    )
    both = now.keys() & was.keys()
    if not both:
        yield "<p>They have no run in common.</p>"
        return
    same = sum(now[each][1] == was[each][1] for each in both)
    worse, better = sum(was[e][0] and not now[e][0] for e in both), sum(now[e][0] and not was[e][0] for e in both)
    yield f"<p>{len(both)} runs in common, {same} of them the same to the last byte. "
    yield f"{worse} failed that had passed, {better} passed that had failed.</p>"
    told = list[tuple[object, ...]]()
    for name in sorted({each.name for each in quantities(database)} & {each.name for each in quantities(earlier)}):
        sql = f"select point, seed, {name} from runs where {name} is not null"
        then, today = ({(p, s): value for p, s, value in selected(each, sql)[1]} for each in (earlier, database))
        steps = np.array([today[each] - then[each] for each in today.keys() & then.keys()])
        if len(steps) > 1:
            half = 1.96 * float(steps.std(ddof=1)) / math.sqrt(len(steps))
            told.append((name, len(steps), float(steps.mean()), f"±{half:.3g}", float(np.median(np.abs(steps)))))
    yield table(("measure", "runs", "mean change", "95 %", "median of its size"), told)


def _column(database: duckdb.DuckDBPyConnection, name: str) -> Any:
    return np.array([row[0] for row in selected(database, f"select {name} from runs where {name} is not null")[1]], dtype=float)


def _grid(count: int, columns: int = 4, height: float = 2.2) -> tuple[Figure, list[Axes]]:
    rows = max(1, math.ceil(count / columns))
    figure = Figure(figsize=(11, height * rows))  # laid out by hand: matplotlib's layout takes a second
    figure.subplots_adjust(0.07, 0.5 / (height * rows), 0.98, 1.0 - 0.3 / (height * rows), 0.26, 1.2 / height)
    places = list(np.array(figure.subplots(rows, columns, squeeze=False)).flat)
    for axes in places[count:]:
        axes.set_axis_off()
    return figure, places
