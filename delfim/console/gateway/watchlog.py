"""The log of the watch: what boats and console said, who ordered what, what was refused, who has taken note of which alarm.

The last lines are kept here for the pages, those of the sessions before among them; all are in tables (CSV) beside the frames
of the sessions, of the same names.
"""

import csv
import io
import re
import time
from collections import deque
from collections.abc import Iterable, Iterator
from datetime import datetime
from pathlib import Path
from typing import Any, Final, NamedTuple

KEPT_MAX: Final = 5000
PENDING_MAX: Final = 5000  # lines beyond that, as when the disk is full, are not in the file
FILE_BYTES: Final = 1 << 27  # of one table, at its end: weeks
READ_BYTES: Final = 1 << 21  # of the sessions before, the newest
MS: Final = 0.001  # the step of the times in a table
_SESSION: Final = re.compile(r"\d{8}-\d{6}(-\d+)?\.csv")
_FORMULA: Final = "=", "+", "-", "@", "\t", "\r"


class WatchLine(NamedTuple):
    """A line. `what`: a priority of alerts, "notice", "over", "order", "refused", "acknowledged", "silenced", "command",
    "page", "note" of an operator."""

    at_s: float  # since 1970
    boat: int | None
    name: str
    who: str
    what: str
    text: str


HEADER: Final = "time", "boat", "name", "who", "what", "text"


class WatchLog:
    """`reason` says why nothing is written, or is empty."""

    def __init__(self) -> None:
        self.lines = deque[WatchLine](maxlen=KEPT_MAX)
        self.reason = ""
        self._pending = deque[WatchLine](maxlen=PENDING_MAX)

    def put(self, line: WatchLine) -> None:
        self.lines.append(line)
        self._pending.append(line)

    def resume(self, sessions: Path) -> None:
        """Pages see the last lines of the sessions before, too."""
        try:
            lines, left = list[WatchLine](), READ_BYTES
            for file in reversed(tables(sessions)):
                if left > 0 and len(lines) < KEPT_MAX:
                    lines = [*kept_lines(file, left), *lines]
                    left -= file.stat().st_size
            lines.sort(key=lambda line: line.at_s)  # a note on a replay is later in its file than it was
            self.lines.extendleft(reversed(lines[-KEPT_MAX:]))
        except OSError as error:
            self.reason = str(error)

    def recall(self, sessions: Path, from_s: float, to_s: float) -> None:
        """The lines of that time, for a replay. Raises OSError."""
        self.lines.extend(line for line in since(sessions, from_s - MS) if line.at_s <= to_s)

    def told(self, count: int) -> list[dict[str, Any]]:
        """The last lines, for a page."""
        return [line._asdict() for line in list(self.lines)[-count:]]

    def write(self, file: Path) -> None:
        """Appends what is new."""
        if not self._pending:
            return
        try:
            with file.open("a", encoding="utf-8", newline="") as out:
                out.write(table(self._pending, header=out.tell() == 0))
        except OSError as error:
            self.reason = str(error)
            return
        self._pending.clear()
        self.reason = ""


def table(lines: Iterable[WatchLine], *, header: bool = True) -> str:
    """As CSV, with times in UTC. No spreadsheet takes a word of a boat for a formula."""
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    if header:
        rows.writerow(HEADER)
    for line in lines:
        seconds, ms = divmod(round(line.at_s * 1000.0), 1000)  # to the nearest: a note at the start of a replay is in it
        at = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(seconds)) + f".{ms:03d}Z"
        words = (each if each[:1] not in _FORMULA else f"'{each}" for each in line[2:])
        rows.writerow((at, "" if line.boat is None else line.boat, *words))
    return out.getvalue()


def tables(sessions: Path) -> list[Path]:
    """The tables of all sessions, the oldest first."""
    found = (file for file in sessions.glob("*.csv") if _SESSION.fullmatch(file.name))
    return sorted(found, key=lambda file: file.stem)


def since(sessions: Path, at_s: float) -> list[WatchLine]:
    """The lines of all sessions from this time on, s since 1970. Raises OSError."""
    found = (line for file in tables(sessions) for line in kept_lines(file, FILE_BYTES))
    return sorted((line for line in found if line.at_s >= at_s), key=lambda line: line.at_s)


def kept_lines(file: Path, bytes_max: int) -> Iterator[WatchLine]:
    """The lines at the end of a table; a row that is damaged is left out. Raises OSError."""
    with file.open("rb") as its:
        start = its.seek(max(file.stat().st_size - bytes_max, 0))
        text = its.read(bytes_max).decode(errors="replace")
    rows = csv.reader(line for line in text.splitlines(keepends=True)[start > 0 :] if "\0" not in line)
    while True:
        try:
            time_, boat, *words = next(rows)
            at_s, number = datetime.fromisoformat(time_).timestamp(), int(boat) if boat else None
            name, who, what, said = (each[each[1:2] in _FORMULA and each[0] == "'" :] for each in words)
        except StopIteration:
            return
        except (ValueError, OverflowError, csv.Error):
            continue
        yield WatchLine(at_s, number, name, who, what, said)
