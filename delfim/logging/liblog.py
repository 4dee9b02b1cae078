"""liblog: logs that never hold up the program that writes them (thesis 2.10).

    DIRECTORY/YYYYMMDD/id/hhmmss.suffix            UTC of creation; hhmmss-1, -2, ... where the name is taken; .gz if deflated
    DIRECTORY/YYYYMMDD/id/hhmmss.meta.jsonl        its sidecar: events beside the records

Three ways to write, one interface:

    write     a system call a record, in the caller, who waits for the disk
    zwrite    deflated, in the caller, who waits for the disk: tests, tools, services in processes of their own
    zpipe     through a pipe to a niced child (delfim.logging.writer) that deflates, writes and syncs; the caller never waits

A file is ended past a size or an age, and whenever writing failed; none is ever opened twice. A log that cannot write drops
and counts its records, says why, retries about once a second, and recovers when the disk does. No method raises.
"""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Literal, NamedTuple, Protocol

from delfim.base.clock import Clock

Method = Literal["write", "zwrite", "zpipe"]
WhenFull = Literal["delete-oldest", "stop"]


class LogStatus(NamedTuple):
    """The status of a log. The numbers count from its opening: every record put is in `records`, in `dropped`, or under way."""

    writable: bool
    reason: str  # why it is not, in words; empty while it is
    file: str  # being written, or written last
    bytes: int  # on disk
    records: int  # on disk
    dropped: int


class Log(Protocol):
    """A log, whose records go to disk whole and in order, or are dropped and counted."""

    def put(self, record: bytes) -> bool:
        """Take a record; False: it was dropped."""

    def note(self, line: bytes) -> bool:
        """Append a line, with its end, to the sidecar of the current file; seldom, it costs an open and a close."""

    def status(self) -> LogStatus: ...

    def poll(self) -> None:
        """Flush, read the writer's reports, and start it again after it died; call it about once a second."""

    def status_fileno(self) -> int:
        """The descriptor that is readable when `poll` has something to read; -1 where there is no writer."""

    def close(self, timeout_s: float = 2.0) -> None:
        """Flush and end. A writer that takes longer is killed, and its unwritten records count as dropped."""


def event_line(clock: Clock, event: str, **what: object) -> bytes:
    """Format a line for a sidecar: the event, its time, and details (JSON-ready)."""
    return json.dumps({"t_ns": clock.time_ns(), "monotonic_s": clock.monotonic_s(), "event": event} | what).encode() + b"\n"


class LogSettings(NamedTuple):
    """The settings of a log and its files, as given to a writer; delfim.logging.openlog explains them."""

    directory: str
    id: str
    suffix: str
    header: bytes
    file_bytes: int
    file_s: float
    free_bytes_min: int
    when_full: WhenFull
    upload_folder: str = ""  # in `directory`
    upload_bytes_max: int = 0


def in_order(paths: Iterable[Path]) -> list[Path]:
    """Sort log files by the time when they were made; plain sorting puts hhmmss-1 before hhmmss."""

    def key(path: Path) -> tuple[str, str, int]:
        time_, _, number = path.name.partition(".")[0].partition("-")
        return path.parts[-3] if len(path.parts) > 2 else "", time_, int(number) if number.isdecimal() else 0

    return sorted(paths, key=key)
