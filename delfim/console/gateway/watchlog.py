"""The log of the watch: what boats and console said, who ordered what, what was refused, who has taken note of which alarm.

The last lines are kept here for the pages; all of them are in a table (CSV) beside the session's frames, of the same name.
"""

import csv
import io
import time
from collections import deque
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final, NamedTuple

KEPT_MAX: Final = 5000
PENDING_MAX: Final = 5000  # lines beyond that, as when the disk is full, are not in the file


class WatchLine(NamedTuple):
    """A line. `what`: a priority of alerts, "notice", "over", "order", "refused", "acknowledged", "silenced", "command",
    "page"."""

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
        at = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(line.at_s)) + f".{int(line.at_s % 1 * 1000):03d}Z"
        words = (each if each[:1] not in ("=", "+", "-", "@", "\t", "\r") else f"'{each}" for each in line[2:])
        rows.writerow((at, "" if line.boat is None else line.boat, *words))
    return out.getvalue()
