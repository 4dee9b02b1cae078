"""The chain of a log: beside each file `hhmmss.chain`, by which a change of the file or of its sidecar shows afterwards.

A line is a link: JSON with `t_ns`, `log` and `meta`, the bytes of the log and of its sidecar at that moment, and `link`, which
is SHA-256 of the link before it and of both files up to there. The first line of a file has `before` in place of all but the
time: the last link of the file before it, or "" where there was none. The last line of a file that was ended has `end`.

Who may write all files may make the whole chain anew: what is kept elsewhere, a head or the files themselves, shows that.
"""

import contextlib
import hashlib
import json
import os
from pathlib import Path
from typing import Final

from delfim.base.errors import FormatError
from delfim.base.input.untrusted import parse_json
from delfim.base.wholefile import sync_directory
from delfim.logging.liblog import in_order

SUFFIX: Final = ".chain"
LAST_BYTES: Final = 1 << 16  # of a chain, in which its last link is looked for
APPENDED: Final = os.O_WRONLY | os.O_CREAT | os.O_APPEND | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)


def link_of(before: str, t_ns: int, sizes: tuple[int, int], digests: tuple[bytes, bytes], *, end: bool) -> str:
    """The link that follows `before`: 64 hexadecimal digits. `digests`: SHA-256 of log and sidecar up to `sizes`."""
    words = f"{before} {t_ns} {sizes[0]} {sizes[1]} {int(end)} {digests[0].hex()} {digests[1].hex()}"
    return hashlib.sha256(words.encode()).hexdigest()


def newest(directory: str, id_: str) -> str:
    """The last link of the newest file of a log; "": none has one."""
    with contextlib.suppress(OSError):
        for day in sorted((day for day in os.listdir(directory) if day.isdecimal()), reverse=True):
            for file in reversed(in_order(Path(directory, day, id_).glob(f"*{SUFFIX}"))):
                with open(file, "rb") as chain:
                    chain.seek(-min(LAST_BYTES, os.fstat(chain.fileno()).st_size), os.SEEK_END)
                    lines = chain.read().splitlines()
                for line in reversed(lines):  # the last one may be torn
                    with contextlib.suppress(FormatError, TypeError, KeyError):
                        return str(parse_json(line)["link"])
    return ""


class Chain:
    """The links of one log, file by file. A link that cannot be written is left to the next: no method raises."""

    def __init__(self, directory: str, id_: str) -> None:
        self._place = directory, id_
        self._head: str | None = None  # the last link; None: not looked for yet
        self.begin("")

    def begin(self, stem: str) -> None:
        """A new file, by its path without a suffix."""
        self._stem, self._aside, self._begun, self._torn = stem, "", False, False
        self._log, self._meta = hashlib.sha256(), hashlib.sha256()
        self._log_bytes = self._meta_bytes = 0
        self._linked = 0, 0

    def moved(self, stem: str) -> None:
        """The file has another name; the chain has it before the next link."""
        self._aside, self._stem = self._aside or self._stem, stem
        self._is_beside()

    def _is_beside(self) -> bool:
        """Whether the chain lies beside its file, or does now."""
        try:
            if self._aside and self._begun:
                os.replace(self._aside + SUFFIX, self._stem + SUFFIX)
                with contextlib.suppress(OSError):
                    sync_directory(os.path.dirname(self._stem))
        except OSError:
            return False
        self._aside = ""
        return True

    def wrote(self, data: bytes | bytearray) -> None:
        """These bytes follow in the log's file."""
        self._log.update(data)
        self._log_bytes += len(data)

    def noted(self, path: str, line: bytes, *, whole: bool) -> None:
        """This line follows in the sidecar; not whole: some of it, perhaps, and the file itself says how much."""
        if whole:
            self._meta.update(line)
            self._meta_bytes += len(line)
            return
        with contextlib.suppress(OSError):
            content = Path(path).read_bytes()
            self._meta, self._meta_bytes = hashlib.sha256(content), len(content)

    def link(self, t_ns: int, *, kept: bool, end: bool = False, sync: bool = False) -> None:
        """Write a link, if something is new. `kept`: the log's file stays, with a record or ended. `sync`: onto the disk."""
        sizes = (self._log_bytes if kept else 0), self._meta_bytes
        if sizes == (0, 0) or (sizes == self._linked and not end) or not self._is_beside():
            return
        if self._head is None:
            self._head = newest(*self._place)
        told = "\n" if self._torn else ""
        told += "" if self._begun else json.dumps({"t_ns": t_ns, "before": self._head}) + "\n"
        digests = (self._log.digest() if kept else hashlib.sha256().digest()), self._meta.digest()
        head = link_of(self._head, t_ns, sizes, digests, end=end)
        line = {"t_ns": t_ns, "log": sizes[0], "meta": sizes[1], "link": head} | ({"end": True} if end else {})
        if self._appended((told + json.dumps(line) + "\n").encode(), sync=sync):
            self._head, self._linked, self._begun = head, sizes, True

    def _appended(self, data: bytes, *, sync: bool) -> bool:
        """Append a link, and say whether it is in the file, be it on the disk or not."""
        is_there = False
        with contextlib.suppress(OSError):
            fd = os.open(self._stem + SUFFIX, APPENDED, 0o644)
            self._torn = True
            try:
                is_there = os.write(fd, data) == len(data)
                self._torn = not is_there
                if sync or not self._begun:
                    os.fsync(fd)
                if not self._begun:  # ext2 loses the name of a file that was synced alone: a human would be asked for
                    sync_directory(os.path.dirname(self._stem))
            finally:
                os.close(fd)
        return is_there
