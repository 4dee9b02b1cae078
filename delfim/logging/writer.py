"""The niced child of a `zpipe` log: `python -m delfim.logging.writer ID`, pipe on standard input, reports on standard output.

In the pipe, byte order of the machine: length u32, then so many bytes. The first message is JSON, the log's settings; every
other one is a record, or with the length's highest bit set a line for the sidecar. A report is a line of JSON, a LogStatus.

It ends when the pipe does: even if the parent has died, its records are written first. So it ignores the signals by which
terminals and init scripts end programs.
"""

import contextlib
import json
import os
import signal
import struct
import sys
import time
from collections.abc import Iterator
from typing import Final

from delfim.base.clock import SystemClock
from delfim.logging.filelog import FLUSH_S, FileLog
from delfim.logging.liblog import LogSettings, LogStatus

LENGTH: Final = struct.Struct("=I")  # before each message in the pipe; the highest bit marks a line for the sidecar
NOTE: Final = 1 << 31
TICK_S: Final = 0.05  # between two looks into the pipe
READ_BYTES: Final = 1 << 16
REPORT_S: Final = 1.0  # reports come at least so often
NOTES_BYTES: Final = 1 << 22  # kept while the log cannot be written
REASON_MAX: Final = 1000  # characters; a report fits into PIPE_BUF and is written whole or not at all


class PipeMessages:
    """Cuts the bytes from the pipe into messages, however they were split on the way."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[tuple[bool, bytes]]:
        """Take bytes; return the messages that are now complete, each with whether it is for the sidecar."""
        buffer, at = self._buffer, 0
        buffer += data
        while len(buffer) - at >= LENGTH.size:
            word = LENGTH.unpack_from(buffer, at)[0]
            end = at + LENGTH.size + (word & ~NOTE)
            if end > len(buffer):
                break
            yield bool(word & NOTE), bytes(buffer[at + LENGTH.size : end])
            at = end
        del buffer[:at]


def step_back(nice: int) -> None:
    """Leave the processor to the parent: no real-time policy, no pinning inherited from it, at least this nice value."""
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))  # does not preempt when it wakes up
    with contextlib.suppress(OSError):
        os.sched_setaffinity(0, range(os.cpu_count() or 1))
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, max(nice, os.getpriority(os.PRIO_PROCESS, 0)))


class Writer:
    """One log: messages in, reports out."""

    def __init__(self) -> None:
        self._messages = PipeMessages()
        self._clock = SystemClock()
        self._log: FileLog | None = None
        self._notes, self._notes_s = bytearray(), 0.0  # lines for the sidecar; when they are written: a note costs two syncs
        self._reported, self._report_s = LogStatus(False, "", "", 0, 0, 0), 0.0

    def feed(self, data: bytes) -> None:
        for is_note, message in self._messages.feed(data):
            if self._log is None:
                self._log = self._opened(message)
            elif is_note:
                self._notes += message
            else:
                self._log.put(message)

    def poll(self) -> None:
        if self._log:
            self._log.poll()
            if self._notes and self._clock.monotonic_s() >= self._notes_s:
                self._write_notes(self._log)
            self._report(self._log.status())

    def close(self) -> None:
        if self._log:
            self._write_notes(self._log)
            self._log.close()
            self._report(self._log.status())

    def _write_notes(self, log: FileLog) -> None:
        if self._notes and log.note(bytes(self._notes)):
            self._notes.clear()
        del self._notes[:-NOTES_BYTES]
        self._notes_s = self._clock.monotonic_s() + FLUSH_S

    def _opened(self, message: bytes) -> FileLog:
        told = json.loads(message)
        step_back(told.pop("nice"))
        settings = LogSettings(**told | {"header": told["header"].encode("latin-1")})
        return FileLog(settings, self._clock, deflate=True, durable=True)

    def _report(self, status: LogStatus) -> None:
        now_s = self._clock.monotonic_s()
        if status == self._reported and now_s < self._report_s:
            return
        line = json.dumps(status._replace(reason=status.reason[:REASON_MAX])._asdict()) + "\n"
        with contextlib.suppress(OSError):  # nobody reads reports: the next one repeats it all
            os.write(sys.stdout.fileno(), line.encode())
            self._reported, self._report_s = status, now_s + REPORT_S


def main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    pipe = sys.stdin.fileno()
    os.set_blocking(pipe, False)
    os.set_blocking(sys.stdout.fileno(), False)
    writer = Writer()
    while True:
        try:
            data = os.read(pipe, READ_BYTES)
        except BlockingIOError:
            data = None
        if data == b"":
            break
        if data:
            writer.feed(data)
        writer.poll()
        if data is None or len(data) < READ_BYTES:
            time.sleep(TICK_S)
    writer.close()


if __name__ == "__main__":
    main()
