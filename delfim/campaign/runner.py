"""Runs a campaign from its first batch to its verdict, and prints the progress."""

import sys
import time
from pathlib import Path
from typing import Any, Final

from delfim.base.errors import DelfimError
from delfim.campaign import pairtable, queries, shrinking
from delfim.campaign.runplan import CampaignFile, Plan
from delfim.campaign.sailing import VERSION, TooLong
from delfim.campaign.store import Store
from delfim.campaign.workers import by_cluster, by_processes

TELL_S: Final = 2.0  # between two lines of progress on a terminal; elsewhere ten times as much
SHRUNK: Final = 3  # kinds of failures of which a run is shrunken without being asked
YEAR_S: Final = 365.25 * 86400.0


class Progress:
    """Prints lines of progress."""

    def __init__(self, plan: Plan, store: Store) -> None:
        self._plan, self._store, self._began_s = plan, store, time.monotonic()
        self._first, self._told_s = store.runs, self._began_s
        self._sailed_s = self._worked_s = 0.0
        self._terminal = sys.stdout.isatty()

    def add(self, rows: list[dict[str, Any]]) -> None:
        """Add rows that came."""
        self._sailed_s += sum(row.get("sailed_s") or 0.0 for row in rows)
        self._worked_s += sum(row["wall_s"] for row in rows)
        now_s = time.monotonic()
        if now_s - self._told_s >= TELL_S * (1 if self._terminal else 10):
            self._told_s = now_s
            self._print(now_s, "" if self._terminal else "\n")

    def _print(self, now_s: float, end: str) -> None:
        sailed, since_s = self._store.runs - self._first, max(now_s - self._began_s, 1e-9)
        left_s = (self._plan.runs - self._store.runs) * since_s / max(sailed, 1)
        years = self._sailed_s / YEAR_S * 86400.0 / since_s
        words = f"{sailed / since_s:.1f} runs/s, {years:.2f} boat-years a day, {_clock(left_s)} to go"
        line = f"{self._store.runs} of {self._plan.runs} runs, {self._store.failed} failed, {words}"
        print(f"\r{line:90}" if self._terminal else line, end=end, flush=True)

    def end(self, workers: int) -> None:
        """Print the figures of the whole. `workers`: 0 for a cluster."""
        now_s = time.monotonic()
        self._print(now_s, "\n")
        if workers and self._store.runs > self._first:
            part = self._worked_s / (workers * (now_s - self._began_s))
            print(f"delfim: runs took {part:.0%} of the time of {workers} workers")


def sail(plan: Plan, folder: Path, size: int, workers: int, cluster: str | None) -> None:
    """Sail what the folder lacks, in batches of this size, by so many processes or by the cluster at this address. Raises
    DelfimError; what was sailed until then is kept."""
    store = Store(folder, plan, size, VERSION)
    print(f"delfim: {plan.runs} runs at {len(plan.points)} points, results in {folder}", flush=True)
    if store.runs:
        print(f"delfim: {store.runs} of them are there already", flush=True)
    missing = (each for each in plan.batches(size) if not store.has(each.number))
    progress = Progress(plan, store)
    sailing = by_cluster(plan, missing, cluster) if cluster else by_processes(plan, missing, workers)
    try:
        for number, rows in sailing:
            store.add(number, rows)
            progress.add(rows)
    except KeyboardInterrupt:
        print(f"\ndelfim: ended after {store.runs} of {plan.runs} runs; the same command goes on", file=sys.stderr)
        raise
    finally:
        store.flush()
        sailing.close()
    progress.end(0 if cluster else workers)


def tell(file: CampaignFile, plan: Plan, folder: Path, command: str, against: Path | None) -> int:
    """Print verdicts, why runs failed and the tables of the file, and write the page. `command` is the campaign's own, to which
    --again is added. Returns 0 where all that must hold does. Raises DelfimError."""
    database = queries.connect(folder)
    verdicts = queries.verdicts(database, file.must)
    for name, holds, where in verdicts:
        print(f"  {'holds' if holds else 'FAILS':6} {name}" + (f" (points {', '.join(map(str, where[:10]))})" if where else ""))
    for number, (words, many, point, seed) in enumerate(queries.failed(database)[:10]):
        print(f"  {many:6} failed: {words}; again: {command} --again {point}:{seed}", flush=True)
        if number < SHRUNK and not words.startswith(TooLong.__name__):
            try:
                shrinking.run(plan, folder, point, seed)
            except DelfimError as error:
                print(f"  not shrunken: {error}")
    answers = queries.answered(database, file.answers)
    for name, columns, rows in answers:
        print(f"\n  {name}\n", *(f"  {line}" for line in queries.shown(columns, rows).splitlines()), "", sep="\n")
    searched = not file.pairs or pairtable.tell(database, file.pairs, folder)
    if file.page or against:
        from delfim.campaign import report  # its pictures take half a second to import: nobody waits before the first run

        earlier = queries.connect(against) if against else None
        print(f"  report {report.write(folder, plan, database, verdicts, answers, command, earlier)}")
    if database.execute("select count(distinct (point, seed)) from runs").fetchone() != (plan.runs,):
        raise DelfimError("runs are missing")
    return int(not (searched and all(holds for _, holds, _ in verdicts)))


def _clock(seconds: float) -> str:
    return f"{int(seconds) // 3600}:{int(seconds) // 60 % 60:02}:{int(seconds) % 60:02}"
