"""`delfim identify`: fits a boat's log, says what she is beside what her file says, and writes it there if asked."""

import argparse
import shlex
import time
from pathlib import Path

from delfim.base.errors import DelfimError
from delfim.commands import shipped


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("log", nargs="+", metavar="LOG", help="Trees, days, folders or files of a state log.")
    told = "The vehicle's file that the boat sailed with (default: what the log says of it)."
    parser.add_argument("--vehicle", metavar="FILE", type=shipped, help=told)
    since = "Print one line: what has changed since the hull in the file was found. No report."
    parser.add_argument("--since", action="store_true", help=since)
    parser.add_argument("--run", metavar="NAME", help="Use this run, by its name in `delfim log ls` (default: the last).")
    parser.add_argument("--all", action="store_true", help="Use all runs.")
    parser.add_argument("--output", metavar="FILE", help="Write the report here (default: identify-RUN.html).")
    kept = "Write what was found into the vehicle's file, each with its uncertainty and the old value beside it."
    parser.add_argument("--write", action="store_true", help=kept)


def run(asked: argparse.Namespace) -> int:
    from delfim import config
    from delfim.adoption import identify
    from delfim.console.tapes.loggedmissions import sailed
    from delfim.logging.ashore import tree

    if asked.write and not asked.vehicle:
        raise DelfimError("--write needs the vehicle's file: --vehicle FILE")
    found = [file for file in tree.files(asked.log) if file.id == "state"]
    if not found:
        raise DelfimError(f"no state log in {', '.join(asked.log)}")
    chosen = tree.choose(found, None if asked.all else asked.run or "last", time.time_ns())
    files = [file for each in chosen for file in each.files]
    vehicle = config.load(asked.vehicle) if asked.vehicle else identify.vehicle_of(files)
    if asked.since:
        print(identify.since(files, vehicle))
        return 0
    result = identify.of_log(files, vehicle)
    if asked.vehicle and not result.fit.refusal and (mission := sailed(tree.events(files))) is not None:
        result = identify.with_twin(result, files, mission, asked.vehicle)
    print(*identify.told(result), sep="\n")
    place = Path(asked.output or f"identify-{chosen[-1].name}.html")
    named = ["--vehicle", asked.vehicle] if asked.vehicle else []
    words = ["delfim", "identify", *asked.log, *named, *(["--all"] if asked.all else [])]
    identify.report(result, vehicle, place, shlex.join([*words, *(["--run", asked.run] if asked.run else [])]))
    print(f"{place}: the report, with measured and modelled motion")
    if result.fit.refusal:
        return 1
    if asked.write:
        identify.write(result, Path(asked.vehicle))
        print(f"{asked.vehicle}: {len(result.found.keys)} keys written; run delfim check on it")
    return 0
