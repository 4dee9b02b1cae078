"""The exit of the system log: it writes the lines of the pipe of delfim.logging.systemlog to the disk, and to two small files
for the page.

Lines that come while the disk takes nothing wait in memory, the newest WAITING_BYTES of them.
"""

import contextlib
import os
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Final

from delfim.base.clock import Clock
from delfim.logging.filelog import FileLog
from delfim.logging.liblog import LogSettings, event_line
from delfim.logging.systemlog import RECENT, RECENT_BYTES

ID: Final = "system"
SUFFIX: Final = ".jsonl"
READ_BYTES: Final = 1 << 16
READS: Final = 32  # at a look: as much as the pipe holds
WAITING_BYTES: Final = 1 << 18


class SystemWriter:
    """Takes the lines of all programs. `turn` is called a few times a second, `close` at the end; both may wait for the disk.

    start: what is noted at the beginning of the log, JSON-ready.
    warn: is told in words when the log cannot be written, when it can again, and how many lines were lost.
    """

    def __init__(
        self,
        pipe: int,
        settings: LogSettings,
        directory: str,
        clock: Clock,
        start: dict[str, object],
        warn: Callable[[str], object],
    ) -> None:
        self._pipe, self._directory, self._clock, self._warn = pipe, Path(directory), clock, warn
        self._log = FileLog(settings, clock, deflate=True, durable=True)
        self._start: dict[str, object] | None = start  # until it is noted
        self._partial = b""  # a line that one read cut
        self._waiting, self._waiting_bytes = deque[bytes](), 0
        self._forgotten = self._told_lost = 0  # lines that did not find room in memory; lost lines that were told
        self._reason = ""  # told last

    def turn(self) -> None:
        lines = self._read()
        self._keep(lines)
        self._waiting += lines
        self._waiting_bytes += sum(map(len, lines))
        if self._log.status().writable:
            self._write()
        self._log.poll()
        while self._waiting_bytes > WAITING_BYTES:
            self._waiting_bytes -= len(self._waiting.popleft())
            self._forgotten += 1
        self._tell()

    def figures(self) -> dict[str, object]:
        """Figures, JSON-ready: lines and bytes on disk, lines lost, lines that wait; why it is not written."""
        status = self._log.status()
        shown = {"lines": status.records, "bytes": status.bytes, "lost": self._lost(), "waiting": len(self._waiting)}
        return shown | ({"trouble": status.reason} if status.reason else {})

    def close(self) -> None:
        self.turn()
        self._log.note(event_line(self._clock, "end"))
        self._log.close()

    def _read(self) -> list[bytes]:
        data = self._partial
        with contextlib.suppress(BlockingIOError):  # empty
            for _ in range(READS):
                data += os.read(self._pipe, READ_BYTES)
        *lines, self._partial = data.split(b"\n")
        return [line + b"\n" for line in lines if line.startswith(b'{"t_ns": ') and line.endswith(b"}")]

    def _write(self) -> None:
        if self._start is not None and self._log.note(event_line(self._clock, "start", **self._start)):
            self._start = None
        while self._waiting and self._log.status().writable:
            line = self._waiting.popleft()
            self._waiting_bytes -= len(line)
            self._log.put(line)

    def _keep(self, lines: list[bytes]) -> None:
        """Append to the files of the last lines. They are in memory on a boat, and lost without regret elsewhere."""
        if not lines:
            return
        newest, older = (self._directory / name for name in RECENT)
        with contextlib.suppress(OSError), open(newest, "ab") as file:
            file.write(b"".join(lines)[-RECENT_BYTES:])
            if file.tell() > RECENT_BYTES:
                newest.replace(older)

    def _tell(self) -> None:
        reason, lost = self._log.status().reason, self._lost()
        if reason != self._reason:
            self._reason = reason
            self._warn(reason or "is written again")
        if lost != self._told_lost and not reason:
            self._warn(f"{lost - self._told_lost} lines were lost on their way to the disk")
            self._told_lost = lost

    def _lost(self) -> int:
        return self._log.status().dropped + self._forgotten
