"""The content of /logs: a directory as rows, a file as ranges of bytes. All but `byte_range` blocks on the disk: call it in a
worker."""

import os
import re
import stat
from calendar import month_name
from contextlib import ExitStack
from typing import Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.services.files.jail import Jail

ENTRIES_MAX: Final = 2000
_DAY: Final = re.compile(r"20\d\d(0[1-9]|1[0-2])\d\d")
_TIME: Final = re.compile(r"([0-2]\d)([0-5]\d)([0-5]\d)\.")
_MONTHS: Final = tuple(month_name)[1:]
_KINDS: Final = {
    ".state": "state log",
    ".state.gz": "state log, compressed",
    ".meta.jsonl": "events beside the log",
    ".chain": "by which a change of log and events shows",
    ".log": "frames, as candump writes them",
    ".log.gz": "frames, as candump writes them, compressed",
    ".jsonl.gz": "messages, as lines of JSON, compressed",
}
_RANGE: Final = re.compile(r"bytes=(\d{0,18})-(\d{0,18})")


class Entry(NamedTuple):
    name: str
    is_directory: bool
    bytes: int
    mtime_s: float


def meaning(path: str, entry: Entry) -> str:
    """The meaning of a name in the logs (docs/log-format.md), in words; empty for any other name."""
    if entry.is_directory:
        if _DAY.fullmatch(entry.name):
            return f"{int(entry.name[6:])} {_MONTHS[int(entry.name[4:6]) - 1]} {entry.name[:4]}"
        if _DAY.fullmatch(path.strip("/")) is None:
            return ""
        return {"state": "each cycle of the boat’s state", "system": "the words of the programs"}.get(
            entry.name, "each frame of this bus"
        )
    time = _TIME.match(entry.name)
    kind = next((words for ending, words in _KINDS.items() if entry.name.endswith(ending)), "")
    began = f"from {time[1]}:{time[2]}:{time[3]}" if time else ""
    return " ".join(filter(None, (kind, began)))


class OpenFile(NamedTuple):
    """A plain file that is being sent, as long as it was when it was opened: a log that is being written grows."""

    fd: int
    bytes: int
    mtime_ns: int

    @property
    def tag(self) -> str:
        return f'"{self.mtime_ns:x}-{self.bytes:x}"'


def opened(closing: ExitStack, jail: Jail, path: str) -> OpenFile:
    """Open a plain file, which `closing` closes. Raises DelfimError, OSError."""
    fd = jail.open(path)
    closing.callback(os.close, fd)
    status = os.fstat(fd)
    return OpenFile(fd, status.st_size, status.st_mtime_ns)


def is_directory(jail: Jail, path: str) -> bool:
    """Whether there is a directory. Raises DelfimError for a path that leads out."""
    try:
        return stat.S_ISDIR(jail.status(path).st_mode)
    except OSError:
        return False


def entries(jail: Jail, path: str) -> tuple[list[Entry], bool]:
    """The entries of a directory, newest names first, directories before files; and whether that is all. Links out of the
    jail are not listed. Raises DelfimError, OSError."""
    found = []
    with jail.folder(path) as fd, os.scandir(fd) as scan:
        for each in scan:
            if each.is_symlink() or each.name.startswith("."):
                continue
            status = each.stat(follow_symlinks=False)
            found.append(Entry(each.name, each.is_dir(follow_symlinks=False), status.st_size, status.st_mtime))
            if len(found) > ENTRIES_MAX:
                break
    found.sort(key=lambda entry: entry.name, reverse=True)
    found.sort(key=lambda entry: not entry.is_directory)
    return found[:ENTRIES_MAX], len(found) <= ENTRIES_MAX


def byte_range(header: str | None, length: int) -> tuple[int, int] | None:
    """(first byte, byte after the last) of a Range header for so many bytes; None: all of them, also for a header that asks for
    several ranges, which a server may ignore (RFC 9110, 14.2). Raises FormatError where nothing can be sent."""
    match = _RANGE.fullmatch(header.strip()) if header else None
    if match is None or match.group(1) == match.group(2) == "":
        return None
    first, last = match.groups()
    start, stop = (int(first), int(last) + 1 if last else length) if first else (max(length - int(last), 0), length)
    if start >= length or stop <= start:
        raise FormatError(f"there are only {length} bytes")
    return start, min(stop, length)
