"""`delfim log`: what people do with logs afterwards. One verb, one function; the work is done in delfim.logging and, where a
boat is needed to repeat something, in delfim.simulator.

Without a path the tree is /log, or that of the simulation; without a range it is the last run.
"""

import argparse
import heapq
import json
import os
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from delfim.errors import DelfimError
from delfim.frames import Frame
from delfim.logging import tree
from delfim.logging.progress import progress, tracked
from delfim.logging.tree import LogFile, Run, Span


class Selection(NamedTuple):
    """What was asked for."""

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
    """The command. Returns the exit code; raises DelfimError for what a person can mend."""
    parser = _parser()
    words, rest = parser.parse_known_args(asked.words)
    if "path" not in words or any(word.startswith("-") for word in rest):
        parser.parse_args(asked.words)  # says what is wrong
    else:
        words.path += rest  # argparse does not take them behind an option
    code: int = words.verb(words)
    return code


def _selection(asked: argparse.Namespace) -> Selection:
    paths = asked.path or [tree.default_place()]
    found = [file for file in tree.files(paths) if not asked.id or file.id in asked.id]
    if not found:
        raise DelfimError(f"no logs{' of ' + ', '.join(asked.id) if asked.id else ''} in {', '.join(paths)}")
    ranged = any(word and not word.startswith("+") for word in (asked.from_, asked.to))
    name = asked.run or (None if ranged or asked.all or all(map(os.path.isfile, paths)) else "last")
    chosen = tree.choose(found, name, time.time_ns())
    main = next((each for each in chosen if each.id == "state"), chosen[0])
    span = tree.span(asked.from_, asked.to, main.begin_ns)
    chosen = [each for each in chosen if each.end_ns >= span.from_ns and tree.within([each], span)]
    return Selection(chosen, tree.within(chosen, span), span)


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
    asked.id = asked.id or ([] if asked.events else ["state"])
    chosen = _selection(asked)
    if asked.events:
        for event in sorted(tree.events(chosen.files, chosen.span), key=lambda each: each["t_ns"]):
            print(json.dumps(event))
    elif boxes := chosen.black_box():
        from delfim.logging.table import lines

        its = [[file for file in boxes if file.id == id_] for id_ in sorted({file.id for file in boxes})]
        streams: list[Iterator[str]] = [lines(each, chosen.span) for each in its]
        for line in heapq.merge(*streams, key=lambda line: line[1:18]) if len(its) > 1 else streams[0]:
            sys.stdout.write(line)
    elif chosen.state():
        _cat_state(chosen, asked.fields)
    else:
        _cat_lines(chosen)
    return 0


def _cat_lines(chosen: Selection) -> None:
    """What nodes said: lines of JSON that begin with their time."""
    from delfim.logging.liblog import read_log

    for file in chosen.files:
        for line in read_log(file.path)[0].splitlines(keepends=True):
            match = re.match(rb'\{"t_ns": ([0-9]+)', line)
            if match and line.endswith(b"\n") and chosen.span.has(int(match[1])):
                sys.stdout.write(line.decode(errors="replace"))


def _cat_state(chosen: Selection, fields: str | None) -> None:
    """Tab-separated, names first."""
    from delfim.logging.table import table

    columns, _ = table(chosen.state(), chosen.span)
    names = fields.split(",") if fields else list(columns)
    if unknown := [name for name in names if name not in columns]:
        raise DelfimError(f"no field {', '.join(unknown)}; there are {', '.join(columns)}")
    print("\t".join(names))
    for values in zip(*(columns[name].tolist() for name in names), strict=True):
        print("\t".join(map(str, values)))


def _info(asked: argparse.Namespace) -> int:
    from delfim.logging.summary import summary, text

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
    from delfim.logging import plot
    from delfim.logging.table import table

    chosen = _selection(asked)
    columns, schema = table(chosen.state(), chosen.span)
    folder = Path(asked.output or chosen.name)
    folder.mkdir(parents=True, exist_ok=True)
    for file in plot.draw(columns, _waypoints(chosen), f"{schema.boat}, {chosen.name}", folder, asked.format):
        print(file)
    return 0


def _export(asked: argparse.Namespace) -> int:
    from delfim.logging import canexport, export
    from delfim.logging.table import table

    chosen = _selection(asked)
    file = Path(asked.output or f"{chosen.name}.{asked.format}")
    if asked.format in canexport.FORMATS:
        count = canexport.write(_frames(chosen, str(file)), file, asked.format)
    else:
        columns, schema = table(tracked(str(file), chosen.state(), *_sizes(chosen.state())), chosen.span)
        told = list(tree.events(chosen.state(), chosen.span))
        export.FORMATS[asked.format](columns, schema, told, file)
        count = len(columns["t1"])
    print(f"{file}: {count} {'frames' if asked.format in canexport.FORMATS else 'records'}, {_size(file.stat().st_size)}")
    return 0


def _replay(asked: argparse.Namespace) -> int:
    if asked.bus:
        from delfim.simulator.playback import play

        count, late_s = play(_frames(_selection(asked), f"onto {asked.bus}"), asked.bus, asked.speed, asked.only)
        print(f"{count} frames onto {asked.bus}, at most {late_s * 1e3:.1f} ms late")
        return 0
    from delfim.simulator.rerun import rerun

    chosen = _selection(asked)
    result = rerun(sorted(file for run in chosen.runs for file in run.files), asked.vehicle, chosen.span)
    print(result.text())
    return 0 if result.exact else 1


def _repair(asked: argparse.Namespace) -> int:
    from delfim.logging.repair import repair

    asked.all = not asked.run
    chosen = _selection(asked)
    now_ns, mended = time.time_ns(), 0
    for file in tracked("repair", chosen.files, *_sizes(chosen.files)):
        if now_ns - file.end_ns < tree.RUNNING_S * 1e9:
            print(f"{file.path}: left alone, it is being written")
            continue
        for result in repair(file, in_place=asked.in_place):
            if result.complaint:
                mended += 1
                print(f"{result.path}: {result.complaint} -> {result.target}")
    print(f"{len(chosen.files)} files checked, {mended} mended")
    return 0


def _fetch(asked: argparse.Namespace) -> int:
    from delfim.logging.fetch import fetch

    folder = Path(asked.directory)
    if any(word and word.startswith("+") for word in (asked.from_, asked.to)):
        raise DelfimError(
            "a time since the beginning of a run means nothing before the run is here: write 09:30, today, or a date"
        )
    span = tree.span(asked.from_, asked.to, time.time_ns())
    for summary in (True, False)[: 1 if asked.summary else 2]:
        outcome, seconds = fetch(asked.url, folder, asked.id, span, summary=summary)
        print(f"{len(outcome.fetched)} files, {_size(outcome.bytes)} in {seconds:.1f} s")
        for path in outcome.cut:
            print(f"{path}: cut on the boat already; delfim log repair mends it")
        if summary and any("/state/" in path for path in outcome.fetched):
            run(argparse.Namespace(words=["info", str(folder)]))
    return 0


def _frames(chosen: Selection, what: str) -> Iterator[tuple[str, Frame]]:
    """Those of the black boxes. Raises DelfimError where there is none."""
    from delfim.logging.table import frames

    boxes = chosen.black_box()
    if not boxes:
        raise DelfimError("no black box in this time")
    return _watched(frames(boxes, chosen.span), boxes, what)


def _modes() -> dict[int, str]:
    from delfim.vehicle.state import Mode

    return {int(mode): mode.name.lower() for mode in Mode}


def _waypoints(chosen: Selection) -> list[tuple[float, float, float]]:
    """Of the mission that was loaded last, as the commands in the sidecar tell."""
    from delfim.config import PathTable
    from delfim.vehicle.mission import parse_mission

    missions = [
        str(event["value"]["text"])
        for event in tree.events(chosen.state())
        if event["event"] == "command" and event["value"]["command"] == "mission" and not event["refused"]
    ]
    if not missions:
        return []
    radius_m = PathTable().acceptance_m
    points = parse_mission(missions[-1], "the mission in the log").waypoint
    return [(each.latitude_deg, each.longitude_deg, each.acceptance_m or radius_m) for each in points]


def _sizes(files: Sequence[LogFile]) -> tuple[float, Callable[[LogFile], float]]:
    return sum(file.size for file in files), lambda file: file.size


def _watched(frames: Iterable[tuple[str, Frame]], files: Sequence[LogFile], what: str) -> Iterator[tuple[str, Frame]]:
    """Frames, with a progress bar by their time."""
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


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="delfim log", description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    verbs = parser.add_subparsers(title="verbs", required=True, metavar="VERB")

    def verb(name: str, function: Callable[[argparse.Namespace], int], text: str) -> argparse.ArgumentParser:
        one = verbs.add_parser(name, help=text, description=text)
        one.set_defaults(verb=function)
        one.add_argument("--from", dest="from_", metavar="TIME", help="UTC, as 2010-01-01T09:30:00 or 09:30, or +SECONDS")
        one.add_argument("--to", metavar="TIME", help="the same; seconds count from the beginning of the run")
        one.add_argument("--id", action="append", default=[], metavar="ID", help="only these logs: state, can0, ...")
        return one

    def reader(name: str, function: Callable[[argparse.Namespace], int], text: str) -> argparse.ArgumentParser:
        one = verb(name, function, text)
        one.add_argument("--run", metavar="NAME", help="a run as `delfim log ls` names it, or how its name begins (last)")
        one.add_argument("--all", action="store_true", help="all runs")
        return one

    def paths(one: argparse.ArgumentParser) -> None:
        one.add_argument("path", nargs="*", metavar="PATH", help=f"trees, days, folders or files ({' or '.join(tree.PLACES)})")

    ls = reader("ls", _ls, "List the runs: day, id, files, duration, size, and whether they ended in order.")
    cat = reader("cat", _cat, "Print a log as text: state as a table, the black box as candump's lines, or the events.")
    cat.add_argument("--fields", metavar="NAME,...", help="of the state log")
    cat.add_argument("--events", action="store_true", help="what the sidecars tell, a JSON object a line")
    info = reader("info", _info, "Sum up a run: track, modes, warnings, latency.")
    for one in (ls, info):
        one.add_argument("--json", action="store_true", help="for programs")
    plot = reader("plot", _plot, "Draw a run: track, speeds, propellers, references, latency.")
    plot.add_argument("--format", choices=["png", "svg"], default="png", help="(%(default)s)")
    plot.add_argument("--output", metavar="DIRECTORY", help="for the pictures (named after the run)")
    export = reader("export", _export, "Write a run in another format: state as the first six, the black box as the others.")
    export.add_argument("format", choices=["csv", "parquet", "gpx", "kml", "mcap", "mat", "log", "asc", "blf", "mf4"])
    export.add_argument("--output", metavar="FILE", help="(named after the run)")
    words = "Through the vehicle's loop, the whole run, comparing its commands bit by bit in this time; or onto a bus (--bus)."
    replay = reader("replay", _replay, words)
    replay.add_argument("--vehicle", metavar="FILE", help="the vehicle's file instead of the settings in the log")
    replay.add_argument("--bus", metavar="INTERFACE", help="send the black box onto this bus, as vcan0 or canloop:can0")
    replay.add_argument("--speed", type=float, default=1.0, help="times real time; 0: as fast as the bus takes it (1)")
    replay.add_argument("--only", choices=["received", "sent"], help="of the frames, as the recording computer saw them")
    repair = reader(
        "repair", _repair, "Make whole what a power cut left: copies beside the originals. Without --run, everything."
    )
    repair.add_argument("--in-place", action="store_true", help="replace the originals")
    for one in (ls, cat, info, plot, export, replay, repair):
        paths(one)
    fetch = verb(
        "fetch", _fetch, "Fetch logs from a boat, resuming and verifying; ftp://user@boat/log or sftp://user@boat/log."
    )
    fetch.add_argument("--summary", action="store_true", help="only state logs and sidecars, and the summary of the last run")
    fetch.add_argument("url", metavar="URL")
    fetch.add_argument("directory", metavar="DIRECTORY")
    return parser
