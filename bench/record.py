"""The record of encounters: sails DNV's set and Imazu's 22 cases with and without the guard, and writes what came of them.

    python -m bench.record [--first N] [--seeds N] [--real N] [--bare N] [--workers N] [--output FOLDER]
                                                         sails, and prints the tables
    python -m bench.record --tell [--left FILE.png]      prints them of what is there, and draws who entered a domain
    python -m bench.record --tell --keep FILE.parquet    adds what is there to that file: a row for each run
    python -m bench.record --tell --output docs/record.parquet                     prints the tables of such a file
    python -m bench.record --picture FILE.png [--tracks FILE.json]                 draws Imazu's 22 cases with real ships

The runs are those of etc/campaigns/encounters.toml, through the whole program in lock step, one seed after the other, so that
what is there is a record of all encounters however early it is ended; the same command goes on. First N seeds of the sets in
the boat's scale, then N of those with real ships. Without the guard it does not matter how others are heard: those runs, of
the first few seeds, are of one kind. docs/encounters.md has the tables, docs/record.parquet the runs that they are made of.
"""

import argparse
import json
import math
import os
import signal
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import duckdb

from delfim.campaign import queries, runner
from delfim.campaign.colreg import Instant
from delfim.campaign.runplan import Plan, Seeds, read
from delfim.campaign.sailing import sailed_run
from delfim.campaign.store import parts
from delfim.simulator.nodes.other_vessels import axes_m

CAMPAIGN: Final = Path(__file__).parents[1] / "etc/campaigns/encounters.toml"
HEARD, GUARD = "simulation.traffic.heard", "traffic.guard.enabled"
TABLE: Final = f"""
select split_part(story, ':', 1) as encounters, case when "{GUARD}" then "{HEARD}" else '' end as heard,
    case when "{GUARD}" then 'on' else 'off' end as guard,
    count(*) as runs, sum(vessels) as vessels, sum(collisions) as collisions, sum(entered) as entered,
    round(min(nearest), 2) as nearest, round(median(nearest), 2) as median, round(min(nearest_m)) as "least m",
    median(alterations) as alterations, round(median(off_m)) as "off m", sum(rules_asked) as asked, sum(rules_asked) -
    sum(case when rules_broken = '' or rules_broken is null then 0 else len(string_split(rules_broken, '; ')) end) as kept
from runs where error = '' group by all order by 1, 2 desc, 3 desc"""
RULES: Final = f"""
select split_part(each, ':', 1) as rule, count(*) as broken, count(distinct story) as encounters from
    (select story, unnest(string_split(rules_broken, '; ')) as each from runs where "{GUARD}" and rules_broken != '')
group by all order by 1"""
LEFT: Final = f"""
select story, "{HEARD}" as heard, seed, round(nearest, 2) as nearest, round(nearest_m) as "m", entered, "end", error
from runs where "{GUARD}" and (entered > 0 or error != '') order by nearest"""
WORSE: Final = f"""
select g.story, g."{HEARD}" as heard, g.seed, g.entered, b.entered as "entered without", g.collisions, b.collisions as "without"
from runs g join runs b on g.story = b.story and g.seed = b.seed and g."{GUARD}" and not b."{GUARD}"
where g.entered > b.entered or g.collisions > b.collisions"""
KEPT: Final = f"""story, "{HEARD}", "{GUARD}", seed, vessels, collisions, entered, nearest, nearest_m, alterations, off_m,
    rules_asked, rules_broken, "end", error, digest, version"""
RUN: Final = f'story, "{HEARD}", "{GUARD}", seed'  # the columns that say what was sailed
BARE: Final = 3  # seeds that are sailed without the guard, too
SIMILAR, REAL = "-similar:", "-real:"  # the scale, in the name of a story
COLUMNS: Final = 6
IMAZU: Final = "imazu22-real:"
TITLE: Final = "Imazu's 22 cases, ships of 90 m: the boat (blue) goes north at 1.5 m/s; domains: nearest moment"


def plan_of(seed: int, *, guarded: bool, scale: str = "") -> Plan:
    """All encounters of a scale, or of both, with one seed of sea and noise."""
    _, plan = read(CAMPAIGN)
    points = tuple(
        (story, values)
        for story, values in plan.points
        if scale in plan.stories[story].name and values[GUARD] is guarded and (guarded or values[HEARD] == "perfect")
    )
    digest = f"{plan.digest}-{scale}{seed}-{'on' if guarded else 'off'}"
    return plan._replace(points=points, seeds=Seeds(first=seed, count=1), digest=digest)


def sail(first: int, seeds: int, real: int, bare: int, output: Path, workers: int) -> None:
    """The seeds from `first` on; `seeds`, `real` and `bare` are the last of their kind."""
    for scale, last in ((SIMILAR, seeds), (REAL, real)):
        for seed in range(first, last + 1):
            for guarded in (True, False) if seed <= bare else (True,):
                folder = output / f"seed{scale[:-1]}-{seed:03}-{'on' if guarded else 'off'}"
                runner.sail(plan_of(seed, guarded=guarded, scale=scale), folder, 2, workers, None)


def connect(output: Path) -> duckdb.DuckDBPyConnection:
    """All that was sailed, as the table `runs`; of a folder, or of a file that `keep` wrote. Ends where nothing was."""
    if not output.is_file() and not any(output.glob("seed-*")):
        sys.exit(f"bench.record: nothing was sailed into {output}; what is kept: --tell --output docs/record.parquet")
    database = duckdb.connect()
    place = f"'{output}'" if output.is_file() else parts(output / "seed-*")
    database.execute(f"create view runs as select * from {place}")
    return database


def keep(database: duckdb.DuckDBPyConnection, place: Path) -> None:
    """Adds the runs to this file, in place of those of the same story, reports, guard and seed."""
    rows = f"select {KEPT} from runs"
    if place.exists():
        rows += f" union all by name select {KEPT} from '{place}' anti join runs using ({RUN})"
    new = place.with_suffix(".new")
    database.execute(f"copy ({rows} order by {RUN}) to '{new}' (format parquet, compression zstd)")
    new.replace(place)


def markdown(names: list[str], rows: list[tuple[Any, ...]]) -> str:
    words = [[f"{each:g}" if isinstance(each, float) else str(each) for each in row] for row in rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in [names, ["---"] * len(names), *words])


def tell(database: duckdb.DuckDBPyConnection) -> None:
    """The tables, from the results."""
    tables = ("All runs", TABLE), ("Rules not kept, guard on", RULES), ("Domains entered, guard on", LEFT)
    for title, sql in (*tables, ("Worse than without the guard", WORSE)):
        names, rows = queries.selected(database, sql)
        print(f"\n{title}\n\n{markdown(names, rows) if rows else 'none'}")


def tracks(runs: Iterable[tuple[str, str, int]]) -> list[dict[str, Any]]:
    """Where everybody was, once a second, in these runs with the guard: story, reports, seed."""
    found = list[dict[str, Any]]()
    for story, heard, seed in runs:
        plan = plan_of(seed, guarded=True)
        stories = [(plan.stories[number].name, values[HEARD]) for number, values in plan.points]
        sailed, _ = sailed_run(plan, stories.index((story, heard)), seed)
        vessels = [(each.row.length_m, each.row.beam_m, each.row.meeting, each.nearest) for each in sailed.run.nodes.vessels]
        name = story.partition(":")[2] if story.startswith(IMAZU) else f"{story}, {heard}, {seed}"
        found.append({"name": name, "vessels": vessels, "instants": sailed.truth.rules.instants})
        print(name, *(f"{each[2]} {each[3]:.2f}" for each in vessels), file=sys.stderr, flush=True)
    return found


def draw(cases: list[dict[str, Any]], place: Path, title: str) -> None:
    """A page of tracks, each with the domains of the vessels when the boat was nearest to them."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.patches import Ellipse

    columns = min(COLUMNS, len(cases))
    lines, wide_in = math.ceil(len(cases) / columns), 3.0 if columns == COLUMNS else 6.0
    figure, frames = plt.subplots(lines, columns, figsize=(wide_in * columns, (wide_in + 0.3) * lines), squeeze=False)
    for axes in frames.flat[len(cases) :]:
        axes.set_visible(False)
    for axes, case in zip(frames.flat, cases, strict=False):
        instants = [Instant(*each) for each in case["instants"]]
        axes.plot([each.east_m for each in instants], [each.north_m for each in instants], color="#1f5fa8", linewidth=1.6)
        for i, (length_m, _, _, _) in enumerate(case["vessels"]):
            way = [each.vessels[i] for each in instants]
            nearest = min(instants, key=lambda each, i=i: math.dist(each[1:3], each.vessels[i][:2]))  # type: ignore[misc]
            north_m, east_m, course_rad = nearest.vessels[i]
            (line,) = axes.plot([each[1] for each in way], [each[0] for each in way], linewidth=0.8, color=f"C{i + 1}")
            ahead_m, abeam_m = axes_m(length_m)
            angle_deg = 90.0 - math.degrees(course_rad)
            around = Ellipse((east_m, north_m), 2 * ahead_m, 2 * abeam_m, angle=angle_deg, alpha=0.25, color=line.get_color())
            axes.add_patch(around)
            axes.plot(nearest.east_m, nearest.north_m, "o", markersize=3.0, color=line.get_color())
        middle_m = instants[-1].north_m / 2.0
        half_m = max(1100.0, middle_m)
        axes.set_xlim(-half_m, half_m)
        axes.set_ylim(middle_m - half_m, middle_m + half_m)
        axes.set_aspect("equal")
        axes.set_title(f"{case['name']}: {min(each[3] for each in case['vessels']):.3g} domains", fontsize=8)
        axes.tick_params(labelsize=6)
    figure.suptitle(title)
    figure.tight_layout(rect=(0.0, 0.0, 1.0, 0.985))
    figure.savefig(place, dpi=75)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--seeds", type=int, default=1, help="The last of those that are sailed in the boat's scale.")
    parser.add_argument("--real", type=int, default=1, help="The same, with real ships.")
    parser.add_argument("--bare", type=int, default=BARE, help="Of these, how many without the guard, too.")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--output", type=Path, default=Path("run/campaign/record"))
    parser.add_argument("--tell", action="store_true", help="Sail nothing.")
    parser.add_argument("--left", type=Path)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--tracks", type=Path)
    asked = parser.parse_args()
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # `... | head`
    if asked.picture is None:
        if not asked.tell:
            sail(asked.first, asked.seeds, asked.real, asked.bare, asked.output, asked.workers)
        database = connect(asked.output)
        tell(database)
        if asked.keep:
            keep(database, asked.keep)
        _, rows = queries.selected(database, LEFT)
        if asked.left and rows:
            draw(tracks((story, heard, seed) for story, heard, seed, *_ in rows), asked.left, "Domains entered")
        return
    names = [story.name for story in plan_of(1, guarded=True).stories if story.name.startswith(IMAZU)]
    cases = tracks((name, "perfect", 1) for name in names)
    if asked.tracks:
        asked.tracks.write_text(json.dumps(cases))
    draw(cases, asked.picture, TITLE)


if __name__ == "__main__":
    main()
