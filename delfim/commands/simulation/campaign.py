"""`delfim campaign`: sails all runs of a campaign's file, reports their results, and queries them by SQL."""

import argparse
import os
import shlex
import signal
from pathlib import Path
from typing import Final

from delfim.base.errors import DelfimError
from delfim.commands import shipped

FOLDER: Final = Path("run/campaign")


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", type=shipped, help='The campaign\'s file (docs/campaigns.md), or "query".')
    parser.add_argument("sql", metavar="SQL", nargs="?", help="With query: SQL of DuckDB over the table `runs`.")
    kept = "Keep the results here (default: run/campaign/NAME-DIGEST; of query: the newest there)."
    parser.add_argument("--output", metavar="DIRECTORY", help=kept)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, metavar="N", help="Processes of this machine.")
    parser.add_argument("--cluster", metavar="ADDRESS", help="Sail on this Dask cluster instead, as tcp://host:8786.")
    parser.add_argument("--batch", type=int, default=20, metavar="RUNS", help="Runs that are handed out together.")
    parser.add_argument("--again", metavar="POINT:SEED", help="Sail one run here once more, with its log and a picture.")
    shrunk = "Leave out of a run that failed all without which it fails as well, and write the rest as a scenario."
    parser.add_argument("--shrink", metavar="POINT:SEED", help=shrunk)
    parser.add_argument("--against", metavar="DIRECTORY", help="Compare with the results of an earlier campaign.")


def run(asked: argparse.Namespace) -> int:
    if asked.file == "query":
        return _query(asked)
    if asked.sql is not None:
        raise DelfimError("SQL is for delfim campaign query")
    if not 1 <= asked.workers <= 1024 or not 1 <= asked.batch <= 10_000:
        raise DelfimError("--workers is 1 to 1024, --batch 1 to 10000")
    from delfim.campaign import queries, repeat, runner, shrinking
    from delfim.campaign.runplan import read

    file, plan = read(asked.file)
    folder = Path(asked.output) if asked.output else FOLDER / f"{_slug(plan.name)}-{plan.digest[:8]}"
    if asked.again:
        return repeat.sail(plan, folder, *_run(asked.again, len(plan.points)))
    if asked.shrink:
        return shrinking.run(plan, folder, *_run(asked.shrink, len(plan.points)))
    queries.rehearse(file, plan)
    if asked.against:
        queries.connect(Path(asked.against)).close()  # a slip of the pen is told before the first run, not after the last
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C, which a shell keeps from what runs in the background
    runner.sail(plan, folder, asked.batch, asked.workers, asked.cluster)
    words = ["delfim", "campaign", asked.file, *(["--output", asked.output] if asked.output else [])]
    return runner.tell(file, plan, folder, shlex.join(words), Path(asked.against) if asked.against else None)


def _slug(name: str) -> str:
    return "-".join("".join(letter if letter.isalnum() else " " for letter in name.lower()).split())[:40] or "campaign"


def _run(text: str, points: int) -> tuple[int, int]:
    point, colon, seed = text.partition(":")
    if not (colon and point.isdecimal() and seed.isdecimal() and int(point) < points):
        raise DelfimError(f"{text}: not POINT:SEED with a point up to {points - 1}")
    return int(point), int(seed)


def _query(asked: argparse.Namespace) -> int:
    from delfim.campaign import queries

    if asked.sql is None:
        raise DelfimError('say what to ask, as delfim campaign query "select count(*) from runs"')
    newest = sorted(FOLDER.glob("*/campaign.json"), key=os.path.getmtime)[-1:]
    folders = [Path(asked.output)] if asked.output else [each.parent for each in newest]
    if not folders:
        raise DelfimError(f"no campaign in {FOLDER}; name its folder with --output")
    print(queries.shown(*queries.selected(queries.connect(folders[0]), asked.sql)))
    return 0
