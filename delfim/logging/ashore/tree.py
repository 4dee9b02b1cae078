"""The content of a log tree: files, runs, and the choice among them. Nothing is read but names, sizes and sidecars.

A run is the log of one program from its start to its end, of one id. It begins with the sidecar's `start`, or after a pause
for logs that have none, and it ended in order when its last sidecar says `end`.
"""

import calendar
import contextlib
import glob
import os
import re
import time
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

from delfim.base.errors import DelfimError, FormatError
from delfim.base.input.untrusted import parse_json
from delfim.logging import chain
from delfim.logging.reading import read_events

PLACES: Final = ("/log", "run/sim*/log")  # searched for logs if no path is named
DEPTH: Final = 2  # folders below the named one in which a tree may lie
PAUSE_S: Final = 60  # between the files of one run
LATE_S: Final = 2  # a file may hold records so much older or younger than its name and its time say
RUNNING_S: Final = 5  # a log is written at least this often
_NAME: Final = re.compile(r"([0-9]{2})([0-9]{2})([0-9]{2})(?:-([0-9]+))?(-repaired)?(\.[a-z0-9.]+)")
_ID: Final = re.compile(r"(?!\.)[A-Za-z0-9_.-]{1,128}(?<!\.)")
_DAY: Final = re.compile(r"[0-9]{4}(0[1-9]|1[0-2])(0[1-9]|[12][0-9]|3[01])")
_META: Final = ".meta.jsonl"
_SECOND: Final = 1_000_000_000


End = Literal["clean", "cut", "running"]


class LogFile(NamedTuple):
    """One log file. Files sort by the time when they were made."""

    begin_ns: int  # as its name says
    number: int  # among the files of that second
    id: str
    suffix: str  # ".state.gz", ".log"
    path: str
    size: int
    end_ns: int  # when it was written last
    sidecar: str  # its path; "" where there is none


class Span(NamedTuple):
    """A range of time, ns since 1970, both ends included."""

    from_ns: int = 0
    to_ns: int = (1 << 63) - 1

    def has(self, t_ns: int) -> bool:
        return self.from_ns <= t_ns <= self.to_ns


ALWAYS: Final = Span()


class Run(NamedTuple):
    id: str
    files: tuple[LogFile, ...]
    end: End
    end_ns: int

    @property
    def begin_ns(self) -> int:
        return self.files[0].begin_ns

    @property
    def size(self) -> int:
        return sum(file.size for file in self.files)

    @property
    def name(self) -> str:
        """The run's name for people: 20100101-093000."""
        return time.strftime("%Y%m%d-%H%M%S", time.gmtime(self.begin_ns // _SECOND))


def files(paths: Iterable[str | Path]) -> list[LogFile]:
    """The log files under these paths (a tree, a day, an id's folder, or files), in order; of a repaired file its copy.

    Raises DelfimError if there is no such path, or if it is not a log file.
    """
    found: list[LogFile] = []
    for path in map(str, paths):
        place = os.path.abspath(path)
        try:
            found += _folder(os.path.dirname(place), os.path.basename(place)) if os.path.isfile(place) else _walk(place)
        except OSError as error:
            raise DelfimError(f"{path}: {error.strerror}") from None
    return sorted(set(found))


def readable(name: str) -> str:
    """Make a file's name readable: bytes that are no UTF-8 as \\xff, and nothing that steers a terminal."""
    text = os.fsencode(name).decode("utf-8", "backslashreplace")
    return "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text)


def runs(files: Iterable[LogFile], now_ns: int) -> list[Run]:
    """Group these files into runs, in order."""
    by_id: dict[str, list[LogFile]] = {}
    for file in sorted(files):
        by_id.setdefault(file.id, []).append(file)
    result = []
    for id_, its in by_id.items():
        first = 0
        for i in range(1, len(its) + 1):
            if i == len(its) or _starts(its[i], max(file.end_ns for file in its[max(first, i - 2) : i])):
                result.append(Run(id_, tuple(its[first:i]), *_end(its[i - 1], now_ns)))
                first = i
    return sorted(result, key=lambda run: (run.begin_ns, run.id))


def choose(found: Sequence[LogFile], name: str | None, now_ns: int) -> list[Run]:
    """Choose the runs of one time by a name or its beginning; "last" is the newest one, None all.

    To a state log belong the logs of other ids from the same time. Raises DelfimError where there is none.
    """
    every = runs(found, now_ns)
    if name is None:
        return every
    chosen = [run for run in every if run.name.startswith(name)] if name != "last" else every
    chosen = [run for run in chosen if run.id == "state"] or chosen
    if not chosen:
        raise DelfimError(f"no run {name}; there are {', '.join(run.name for run in every[-5:]) or 'none'}")
    if name != "last" and len({run.begin_ns // _SECOND // 60 for run in chosen}) > 1:
        raise DelfimError(f"{name} may be one of {', '.join(sorted({run.name for run in chosen}))}")
    main = chosen[-1]
    return [run for run in every if run is main or (run.id != main.id and meet(run, main))]


def within(chosen: Iterable[Run], span: Span) -> list[LogFile]:
    """The files of these runs that may hold something of this time."""
    margin = LATE_S * _SECOND
    its = (file for run in chosen for file in run.files)
    return sorted(f for f in its if f.begin_ns - margin <= span.to_ns and f.end_ns + margin >= span.from_ns)


def events(files: Iterable[LogFile], span: Span = ALWAYS) -> Iterator[dict[str, Any]]:
    """The events in the sidecars of these files, each with its file's `id`, file by file. Unreadable lines are left out."""
    for file in sorted(files):
        if not file.sidecar:
            continue
        yield from ({"id": file.id} | told for told in read_events(file.sidecar) if span.has(told["t_ns"]))


def span(begin: str | None, end: str | None, zero_ns: int) -> Span:
    """Parse the range between two times as people write them. Raises FormatError."""
    from_ns = 0 if begin is None else instant(begin, zero_ns, "--from")
    result = Span(from_ns, ALWAYS.to_ns if end is None else instant(end, zero_ns, "--to"))
    if result.to_ns < result.from_ns:
        raise FormatError(f"--to {end} is before --from {begin}")
    return result


def instant(text: str, zero_ns: int, option: str = "time") -> int:
    """Parse a time to ns since 1970: "2010-01-01T09:30:00", "20100101-093000", "09:30" or "09:30:05.5" (UTC, of the day of
    `zero_ns`), or "+90" (seconds after `zero_ns`). Raises FormatError."""
    try:
        if text.startswith("+"):
            return zero_ns + round(float(text) * _SECOND)
        if re.fullmatch(r"[0-9]{8}-[0-9]{6}", text):
            text = text.replace("-", "T")
        if re.match(r"[0-9]{1,2}:", text):
            text = f"{datetime.fromtimestamp(zero_ns // _SECOND, UTC):%Y-%m-%d}T{text.zfill(len(text) + (text[1] == ':'))}"
        when = datetime.fromisoformat(text)
        since = (when if when.tzinfo else when.replace(tzinfo=UTC)) - datetime(1970, 1, 1, tzinfo=UTC)
        return since // timedelta(microseconds=1) * 1000
    except (ValueError, OverflowError):
        raise FormatError(
            f"{option} {text!r} is not a time: write 2010-01-01T09:30:00 or 09:30:00 (UTC), or +90 (seconds)"
        ) from None


def default_place() -> str:
    """The default tree: the boat's, or else the newest of a simulation. Raises DelfimError."""
    for pattern in PLACES:
        ends_ns = {place: [file.end_ns for file in _walk(place)] for place in glob.glob(pattern) if os.access(place, os.R_OK)}
        held = {place: max(ends) for place, ends in ends_ns.items() if ends}
        if held:
            return max(held, key=held.__getitem__)
    raise DelfimError(f"no logs in {' or '.join(PLACES)}: name their folder")


def is_log(day: str, name: str) -> bool:
    """Whether files of such a name in a folder of such a day are log files or sidecars."""
    return bool(_DAY.fullmatch(day) and _NAME.fullmatch(name)) and not name.endswith(".part")


def is_day(name: str) -> bool:
    return bool(_DAY.fullmatch(name))


def is_id(name: str) -> bool:
    """Whether a boat's program names its logs so. No such name leads elsewhere, on any system."""
    return bool(_ID.fullmatch(name))


def begins(day: str, name: str) -> int:
    """The time when a log file was made, ns since 1970, from its name."""
    moment = calendar.timegm((int(day[:4]), int(day[4:6]), int(day[6:]), int(name[:2]), int(name[2:4]), int(name[4:6])))
    return moment * _SECOND


def _walk(place: str, depth: int = DEPTH) -> Iterator[LogFile]:
    if _DAY.fullmatch(os.path.basename(os.path.dirname(place))):
        yield from _folder(place)
    elif _DAY.fullmatch(os.path.basename(place)):
        for id_ in os.scandir(place):
            if id_.is_dir():
                yield from _folder(id_.path)
    else:
        folders = [each for each in os.scandir(place) if each.is_dir()]
        for day in (each for each in folders if _DAY.fullmatch(each.name)):
            yield from _walk(day.path)
        if depth and not any(_DAY.fullmatch(each.name) for each in folders):
            for below in folders:
                with contextlib.suppress(PermissionError):
                    yield from _walk(below.path, depth - 1)


def _folder(folder: str, only: str = "") -> Iterator[LogFile]:
    """The files in an id's folder, or one of them. Raises FormatError for a file that is not a log."""
    day, id_ = Path(folder).parts[-2:]
    entries = {entry.name: entry for entry in os.scandir(folder)}
    if only and not (_NAME.fullmatch(only) and _DAY.fullmatch(day)):
        raise FormatError(f"{os.path.join(folder, only)} is not a log file: they are named YYYYMMDD/id/hhmmss.suffix")
    midnight_ns = begins(day, "000000") if _DAY.fullmatch(day) else 0
    for name in [only] if only else entries:
        match = _NAME.fullmatch(name)
        if not match or name.endswith((_META, chain.SUFFIX, ".part")):
            continue
        hour, minute, second, number, repaired, suffix = match.groups()
        stem = name[: -len(suffix) - len(repaired or "")]
        if not repaired and f"{stem}-repaired{suffix}" in entries and not only:
            continue
        begin_ns = midnight_ns + (int(hour) * 3600 + int(minute) * 60 + int(second)) * _SECOND
        sidecar = next((n for n in (f"{stem}-repaired{_META}", stem + _META) if n in entries), "")
        status = entries[name].stat()
        yield LogFile(
            begin_ns,
            int(number or 0),
            readable(id_),
            suffix,
            os.path.join(folder, name),
            status.st_size,
            max(status.st_mtime_ns, begin_ns),
            os.path.join(folder, sidecar) if sidecar else "",
        )


def _starts(file: LogFile, before_ns: int) -> bool:
    """Whether a run begins with this file; the file before it was last written at `before_ns`."""
    if file.begin_ns - before_ns > PAUSE_S * _SECOND:
        return True
    if not file.sidecar:
        return False
    with open(file.sidecar, "rb") as sidecar:
        return b'"event": "start"' in sidecar.readline(200)


def _end(last: LogFile, now_ns: int) -> tuple[End, int]:
    """The end of the run with this last file, and how it ended."""
    if last.sidecar:
        with open(last.sidecar, "rb") as sidecar:
            sidecar.seek(-min(200, os.fstat(sidecar.fileno()).st_size), os.SEEK_END)
            line = sidecar.read().rstrip(b"\n").rpartition(b"\n")[2]
        with contextlib.suppress(FormatError, ValueError, TypeError, KeyError, OverflowError):
            told = parse_json(line)
            if told["event"] == "end":
                return "clean", int(told["t_ns"])
    return "running" if is_running(last, now_ns) else "cut", last.end_ns


def is_running(file: LogFile, now_ns: int) -> bool:
    """Whether it was written just now. After a step of the clock its time may lie in the future."""
    return abs(now_ns - file.end_ns) < RUNNING_S * _SECOND


def meet(one: Run, other: Run) -> bool:
    """Whether two runs share a moment."""
    return one.begin_ns <= other.end_ns and other.begin_ns <= one.end_ns
