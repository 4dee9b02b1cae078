"""`delfim log`: works with logs afterwards. One verb, one function; the work is done in delfim.logging and, for a replay, in
delfim.simulator.

Without a path the tree is /log, or that of the simulation; without a range it is the last run.
"""

import argparse
import heapq
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from delfim.base.errors import DelfimError
from delfim.base.frames import Frame
from delfim.commands import Formatter, shipped
from delfim.commands.operation import _logproof
from delfim.logging.ashore import systemlines, tree
from delfim.logging.ashore.progress import progress, tracked
from delfim.logging.ashore.tree import LogFile, Run, Span

STATE_FORMATS = ("csv", "parquet", "gpx", "kml", "mcap", "mat", "soundings")
BOX_FORMATS = ("log", "asc", "blf", "mf4")

SINCE_S = 120.0  # for a look at hull and motors after a fetch
SYSTEM = "system"  # the id of the words of the programs
WRITTEN_NS = 60_000_000_000  # a file on the boat that was changed so recently, by our clock, is being written


class Selection(NamedTuple):
    """The logs that the command line selects."""

    runs: list[Run]
    files: list[LogFile]
    span: Span

    @property
    def name(self) -> str:
        return self.runs[0].name if self.runs else "nothing"

    def state(self) -> list[LogFile]:
        return [file for file in self.files if file.suffix.startswith(".state")]

    def black_box(self) -> list[LogFile]:
        return [file for file in self.files if file.suffix in (".log", ".log.gz")]


def run(asked: argparse.Namespace) -> int:
    code: int = asked.verb(asked)
    return code


def _selection(asked: argparse.Namespace) -> Selection:
    paths = asked.path or [_default()]
    found = [file for file in tree.files(paths) if not asked.id or file.id in asked.id]
    if not found:
        raise DelfimError(f"no logs{' of ' + ', '.join(asked.id) if asked.id else ''} in {', '.join(paths)}")
    ranged = any(word and not word.startswith("+") for word in (asked.from_, asked.to))
    name = asked.run or (None if ranged or asked.all or all(map(os.path.isfile, paths)) else "last")
    chosen = tree.choose(found, name, time.time_ns())
    main = next((each for each in chosen if each.id == "state"), chosen[0])
    span = tree.span(asked.from_, asked.to, main.begin_ns)
    here = [each for each in chosen if each.end_ns >= span.from_ns and tree.within([each], span)]
    if not here and not asked.all:
        raise _nothing(chosen)
    return Selection(here, tree.within(here, span), span)


def _default() -> str:
    place = tree.default_place()
    print(f"delfim: the logs of {place}", file=sys.stderr)
    return place


def _nothing(chosen: Sequence[Run]) -> DelfimError:
    """The refusal for an empty range of time."""
    from delfim.logging.ashore.summary import utc

    begin_ns, end_ns = min(run.begin_ns for run in chosen), max(run.end_ns for run in chosen)
    return DelfimError(f"nothing was logged in this time; the logs are from {utc(begin_ns)} to {utc(end_ns)} UTC")


def _ls(asked: argparse.Namespace) -> int:
    asked.all = True
    rows = _selection(asked).runs
    if asked.json:
        for row in rows:
            told = {"run": row.name, "id": row.id, "files": len(row.files), "bytes": row.size, "end": row.end}
            print(json.dumps(told | {"duration_s": round((row.end_ns - row.begin_ns) / 1e9, 1)}))
        return 0
    wide = max([10, *(len(row.id) for row in rows)]) + 2
    print(f"{'RUN (UTC)':17}{'ID':{wide}}{'FILES':>6}{'DURATION':>10}{'SIZE':>10}  END")
    for row in rows:
        lasted = _duration((row.end_ns - row.begin_ns) / 1e9)
        print(f"{row.name:17}{row.id:{wide}}{len(row.files):6}{lasted:>10}{_size(row.size):>10}  {row.end}")
    return 0


def _cat(asked: argparse.Namespace) -> int:
    if asked.path[:1] == [SYSTEM] and not os.path.exists(SYSTEM):
        asked.id, asked.path = [SYSTEM], asked.path[1:]
    asked.id = asked.id or ([] if asked.events else ["state"])
    chosen = _selection(asked)
    if asked.id == [SYSTEM] and not asked.events:
        for line in systemlines.texts(chosen.runs, chosen.span, asked.level):
            print(line)
        return 0
    if not asked.events and not chosen.black_box() and chosen.state():
        _cat_state(chosen, asked.fields)
        return 0
    is_empty = True
    if asked.json and not asked.events:
        raise DelfimError("--json is for --events; `delfim log export` writes the rest for programs")
    for line in _cat_lines(chosen, events=asked.events, as_json=asked.json):
        is_empty = False
        sys.stdout.write(line)
    if is_empty and (asked.from_ or asked.to):
        raise _nothing(chosen.runs)
    return 0


def _cat_lines(chosen: Selection, *, events: bool, as_json: bool) -> Iterator[str]:
    """Print the events, or the frames of the black boxes by time, or the nodes' messages: lines of JSON that begin with the
    time."""
    if events:
        from delfim.logging.ashore.eventtable import table

        told = sorted(tree.events(chosen.files, chosen.span), key=lambda each: each["t_ns"])
        lines_of = map(json.dumps, told) if as_json else table(told)
        yield from (f"{line}\n" for line in (lines_of if told else ()))
        return
    if boxes := chosen.black_box():
        from delfim.logging.ashore.table import lines

        streams = [
            lines([file for file in boxes if file.id == id_], chosen.span) for id_ in sorted({file.id for file in boxes})
        ]
        yield from heapq.merge(*streams, key=lambda line: line[1:18]) if len(streams) > 1 else streams[0]
        return
    from delfim.logging.reading import read_lines

    for file in chosen.files:
        for line in read_lines(file.path):
            match = re.match(rb'\{"t_ns": ?([0-9]+)', line)
            if match and chosen.span.has(int(match[1])):
                yield line.decode(errors="replace") + "\n"


def _cat_state(chosen: Selection, fields: str | None) -> None:
    """Print records, tab-separated, names first."""
    from delfim.logging.ashore.table import table

    columns, _ = table(chosen.state(), chosen.span)
    names = fields.split(",") if fields else list(columns)
    if unknown := [name for name in names if name not in columns]:
        raise DelfimError(f"no field {', '.join(unknown)}; there are {', '.join(columns)}")
    print("\t".join(names))
    for values in zip(*(columns[name].tolist() for name in names), strict=True):
        print("\t".join(map(str, values)))


def _info(asked: argparse.Namespace) -> int:
    from delfim.logging.ashore.summary import summary, text

    chosen = _selection(asked)
    told = summary(chosen.files, chosen.span, _modes())
    told["ends"] = {each.id: each.end for each in chosen.runs}
    if asked.json:
        print(json.dumps(told))
    else:
        print(text(told))
        print(f"{'ended':14} {', '.join(f'{id_} {end}' for id_, end in told['ends'].items())}")
    return 0


def _plot(asked: argparse.Namespace) -> int:
    from delfim.logging.ashore import plot
    from delfim.logging.ashore.table import table

    chosen = _selection(asked)
    columns, schema = table(chosen.state(), chosen.span)
    folder = Path(asked.output or chosen.name)
    folder.mkdir(parents=True, exist_ok=True)
    for file in plot.draw(columns, _waypoints(chosen), f"{schema.boat}, {chosen.name}", folder, asked.format):
        print(file)
    return 0


def _export(asked: argparse.Namespace) -> int:
    from delfim.logging.ashore import canexport, export
    from delfim.logging.ashore.table import table

    chosen = _selection(asked)
    is_depth = asked.format == "soundings"
    file = Path(asked.output or f"{chosen.name}.{asked.format}{'.csv' if is_depth else ''}")
    if asked.format in canexport.FORMATS:
        count = canexport.write(_frames(chosen, str(file)), file, asked.format)
    else:
        columns, schema = table(tracked(str(file), chosen.state(), *_sizes(chosen.state())), chosen.span)
        told = list(tree.events(chosen.state(), chosen.span))
        export.FORMATS[asked.format](columns, schema, told, file)
        count = sum(each["event"] == "sounding" for each in told) if is_depth else len(columns["t1"])
    what = "frames" if asked.format in canexport.FORMATS else "soundings" if is_depth else "records"
    print(f"{file}: {count} {what}, {_size(file.stat().st_size)}")
    return 0


def _replay(asked: argparse.Namespace) -> int:
    if asked.bus:
        from delfim.simulator.replay.playback import play

        count, late_s = play(_frames(_selection(asked), f"onto {asked.bus}"), asked.bus, asked.speed, asked.only)
        print(f"{count} frames onto {asked.bus}, at most {late_s * 1e3:.1f} ms late")
        return 0
    from delfim.simulator.replay.rerun import rerun

    chosen = _selection(asked)
    result = rerun(sorted(file for run in chosen.runs for file in run.files), asked.vehicle, chosen.span)
    print(result.text())
    return 0 if result.exact else 1


def _audit(asked: argparse.Namespace) -> int:
    from delfim.audit import auditor

    asked.all = not asked.run
    chosen = _selection(asked)
    verdicts = auditor.audit(chosen.runs, chosen.span)
    print(*auditor.text(verdicts), sep="\n")
    return int(any(each.findings for each in verdicts))


def _repair(asked: argparse.Namespace) -> int:
    from delfim.logging.ashore.repair import repair

    asked.all = not asked.run
    chosen = _selection(asked)
    now_ns, mended = time.time_ns(), 0
    for file in tracked("repair", chosen.files, *_sizes(chosen.files)):
        if tree.is_running(file, now_ns):
            print(f"{file.path}: skipped, it was written less than {tree.RUNNING_S} s ago")
            continue
        for result in repair(file, in_place=asked.in_place):
            if result.complaint:
                mended += 1
                print(f"{result.path}: {result.complaint} -> {result.target}")
    print(f"{len(chosen.files)} files checked, {mended} repaired")
    return 0


def _fetch(asked: argparse.Namespace) -> int:
    from delfim.logging.ashore.fetch import fetch

    folder = Path(asked.directory)
    if any(word and word.startswith("+") for word in (asked.from_, asked.to)):
        raise DelfimError("+SECONDS count from the beginning of a run, which is not here yet: write 09:30, today, or a date")
    began_ns = time.time_ns()
    span = tree.span(asked.from_, asked.to, began_ns)
    for summary in (True, False)[: 1 if asked.summary else 2]:
        outcome, seconds = fetch(asked.url, folder, asked.id, span, summary=summary)
        print(f"{len(outcome.fetched)} files, {_size(outcome.bytes)} in {seconds:.1f} s")
        for path in outcome.cut:
            if abs((folder / path).stat().st_mtime_ns - began_ns) < WRITTEN_NS:
                print(f"{path}: still being written on the boat; run the same command again for the rest")
            else:
                print(f"{path}: incomplete on the boat, too; run delfim log repair on it")
        if summary and any("/state/" in path for path in outcome.fetched):
            _info(argparse.Namespace(path=[str(folder)], id=[], run=None, all=False, from_=None, to=None, json=False))
            _since(folder)
    return 0


def _since(folder: Path) -> None:
    """Print in a line what has changed of hull and motors, where the boat was adopted: a fit in a process of its own."""
    if find_spec("numpy") is None:
        return
    from delfim.adoption.identify import vehicle_of

    try:
        found = [file for file in tree.files([str(folder)]) if file.id == "state"]
        if not vehicle_of(found).adopted.on:
            return
        words = [sys.executable, "-m", "delfim", "identify", str(folder), "--since"]
        told = subprocess.run(words, capture_output=True, text=True, timeout=SINCE_S, check=False)
    except (DelfimError, OSError, subprocess.SubprocessError):
        return  # a voyage that nothing can be learned from is no fault of fetching
    print(told.stdout, end="")


def _frames(chosen: Selection, what: str) -> Iterator[tuple[str, Frame]]:
    """The frames of the black boxes. Raises DelfimError where there is none."""
    from delfim.logging.ashore.table import frames

    boxes = chosen.black_box()
    if not boxes:
        raise DelfimError("no black box in this time")
    return _watched(frames(boxes, chosen.span), boxes, what)


def _modes() -> dict[int, str]:
    from delfim.base.modes import Mode

    return {int(mode): mode.name.lower() for mode in Mode}


def _waypoints(chosen: Selection) -> list[tuple[float, float, float]]:
    """The waypoints of the mission that was sailed last, from the sidecar."""
    from delfim.config import PathTable
    from delfim.console.tapes.loggedmissions import sailed

    mission, radius_m = sailed(tree.events(chosen.state())), PathTable().acceptance_m
    points = mission.waypoint if mission is not None else ()
    return [(each.latitude_deg, each.longitude_deg, each.acceptance_m or radius_m) for each in points]


def _sizes(files: Sequence[LogFile]) -> tuple[float, Callable[[LogFile], float]]:
    return sum(file.size for file in files), lambda file: file.size


def _watched(frames: Iterable[tuple[str, Frame]], files: Sequence[LogFile], what: str) -> Iterator[tuple[str, Frame]]:
    """Pass frames on with a progress bar by their time."""
    begin_ns, end_ns = min(file.begin_ns for file in files), max(file.end_ns for file in files)
    told = progress(what, (end_ns - begin_ns) / 1e9)
    for count, each in enumerate(frames):
        if count % 1000 == 0:
            told(min(each[1].t_ns - begin_ns, end_ns - begin_ns - 1) / 1e9)
        yield each
    told((end_ns - begin_ns) / 1e9)


def _duration(seconds: float) -> str:
    minutes, second = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02}:{second:02}"


def _size(count: float) -> str:
    for unit in ("B", "kB", "MB"):
        if count < 1000:
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1000
    return f"{count:.1f} GB"


def _plot_options(plot: argparse.ArgumentParser) -> None:
    plot.add_argument("--format", choices=["png", "svg"], default="png", help="Plot in this format.")
    plot.add_argument("--output", metavar="DIRECTORY", help="Put the pictures here (default: a folder named after the run).")


def _replay_options(replay: argparse.ArgumentParser) -> None:
    replay.add_argument(
        "--vehicle", metavar="FILE", type=shipped, help="Use this vehicle's file instead of the settings in the log."
    )
    replay.add_argument("--bus", metavar="INTERFACE", help="Send the black box onto this bus, as vcan0 or canloop:can0.")
    replay.add_argument("--speed", type=float, default=1.0, help="Multiple of real time; 0 is as fast as the bus takes it.")
    replay.add_argument("--only", choices=["received", "sent"], help="Send only frames that the computer received, or sent.")


def options(parser: argparse.ArgumentParser) -> None:
    verbs = parser.add_subparsers(title="verbs", required=True, metavar="VERB")

    def verb(name: str, function: Callable[[argparse.Namespace], int], text: str) -> argparse.ArgumentParser:
        one = verbs.add_parser(name, help=text, description=text, formatter_class=Formatter)
        one.set_defaults(verb=function)
        one.add_argument(
            "--from", dest="from_", metavar="TIME", help="From this time on: UTC, as 2010-01-01T09:30:00 or 09:30, or +SECONDS."
        )
        one.add_argument("--to", metavar="TIME", help="Up to this time; +SECONDS count from the beginning of the run.")
        one.add_argument("--id", action="append", default=[], metavar="ID", help="Use only these logs: state, can0, ...")
        return one

    def reader(name: str, function: Callable[[argparse.Namespace], int], text: str) -> argparse.ArgumentParser:
        one = verb(name, function, text)
        one.add_argument(
            "--run",
            metavar="NAME",
            help="Use this run, by its name in `delfim log ls` or the beginning of it (default: the last).",
        )
        one.add_argument("--all", action="store_true", help="Use all runs.")
        return one

    ls = reader("ls", _ls, "List the runs: day, id, files, duration, size, and whether they ended in order.")
    cat = reader("cat", _cat, "Print a log as text: state, black box, events (--events), or, as `cat system`, the system log.")
    cat.add_argument("--level", choices=systemlines.LEVELS, default="debug", help="Print the system log from this level on.")
    cat.add_argument("--fields", metavar="NAME,...", help="Print only these fields of the state.")
    cat.add_argument("--events", action="store_true", help="Print commands, changes of mode and losses, as a table.")
    cat.add_argument("--json", action="store_true", help="With --events: print lines of JSON with all they have, for programs.")
    info = reader("info", _info, "Sum up a run: track, modes, warnings, latency.")
    for one in (ls, info):
        one.add_argument("--json", action="store_true", help="Print JSON, for programs.")
    plot = reader("plot", _plot, "Plot a run: track, speeds, propellers, references, latency.")
    _plot_options(plot)
    export = reader("export", _export, "Write a run in a format of other programs.")
    told = f"{', '.join(STATE_FORMATS)}: the state; {', '.join(BOX_FORMATS)}: the black box."
    export.add_argument("format", choices=[*STATE_FORMATS, *BOX_FORMATS], metavar="FORMAT", help=told)
    export.add_argument("--output", metavar="FILE", help="Write this file (default: one named after the run).")
    words = "Replay a run through the vehicle's program and compare its commands bit by bit; or send its frames (--bus)."
    replay = reader("replay", _replay, words)
    _replay_options(replay)
    audit = reader(
        "audit", _audit, "Judge logs by what the documents promise, all without --run; exit code 1: something is broken."
    )
    text = "Repair logs that a power cut left incomplete: writes whole copies beside the originals. Without --run, all of them."
    repair = reader("repair", _repair, text)
    repair.add_argument("--in-place", action="store_true", help="Replace the originals.")
    told = f"Trees, days, folders or files (default: {' or '.join(tree.PLACES)})."
    for one in (ls, cat, info, plot, export, replay, audit, repair):  # after the verb's own options
        one.add_argument("path", nargs="*", metavar="PATH", help=told)
        one.set_defaults(many="path")
    _logproof.verbs(verbs)
    text = "Fetch logs from a boat (ftp://user@boat/log, sftp://user@boat/log): verified, and resumed after a lost link."
    fetch = verb("fetch", _fetch, text)
    fetch.add_argument("--summary", action="store_true", help="Fetch only state logs and sidecars, and sum up the last run.")
    fetch.add_argument("url", metavar="URL", help="The logs on the boat.")
    fetch.add_argument("directory", metavar="DIRECTORY", help="Put them in this folder.")
