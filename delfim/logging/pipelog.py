"""A log that a child writes: the method `zpipe` of delfim.logging.liblog."""

import contextlib
import json
import os
import select
import subprocess
import sys
from typing import Final

with contextlib.suppress(ImportError):  # Windows has none, and no log with a writer
    import fcntl

from delfim.base.clock import Clock
from delfim.logging.liblog import LogSettings, LogStatus
from delfim.logging.writer import LENGTH, NOTE

PIPE_BYTES: Final = (4 << 20, 1 << 20)  # asked for in this order: the privileged may exceed pipe-max-size, 1 MiB
SILENT_S: Final = 5.0  # a writer without a report for this long hangs on its disk


class PipeLog:
    """A log by `zpipe`. The pipe is the bounded buffer: a record that it has no room for is dropped. Nobody waits at its other
    end, the child looks into it every now and then, so a `put` wakes nobody and costs one short system call."""

    def __init__(self, settings: LogSettings, clock: Clock, nice: int) -> None:
        self._id, self._clock, self._refused = settings.id, clock, 0
        told = settings._asdict() | {"header": settings.header.decode("latin-1"), "nice": nice}
        self._settings = json.dumps(told).encode()
        self._reports, self._report_end = os.pipe()  # one for all children: its number stays the same
        os.set_blocking(self._reports, False)
        self._before = LogStatus(False, "", "", 0, 0, 0)  # of the children that are no more
        self._reason = ""  # why there is no child
        self._closed = False
        self._start()

    def put(self, record: bytes) -> bool:
        if self._send(LENGTH.pack(len(record)) + record):
            self._sent += 1
            return True
        self._refused += 1
        return False

    def note(self, line: bytes) -> bool:
        return self._send(LENGTH.pack(len(line) | NOTE) + line)

    def status(self) -> LogStatus:
        said, before = self._said, self._before
        silent_s = self._clock.monotonic_s() - self._heard_s
        reason = said.reason
        if self._reason or self._closed:
            reason = self._reason or "closed"
        elif silent_s > SILENT_S:
            reason = f"the log's writer has not reported for {silent_s:.0f} s: the disk hangs"
        return LogStatus(
            not reason,
            reason,
            said.file or before.file,
            before.bytes + said.bytes,
            before.records + said.records,
            before.dropped + said.dropped + self._refused,
        )

    def poll(self) -> None:
        self._listen()
        if self._closed:
            return
        self._send_rest()
        code = self._child.poll() if self._child else 0
        if code is not None:
            if self._child:
                self._bury()
                self._reason = f"the writer ended ({f'signal {-code}' if code < 0 else f'exit status {code}'})"
            if self._clock.monotonic_s() >= self._again_s:
                self._start()

    def status_fileno(self) -> int:
        return self._reports

    def close(self, timeout_s: float = 2.0) -> None:
        if self._closed:
            return
        self._closed = True
        if self._child:
            room = select.poll()
            room.register(self._fd, select.POLLOUT)
            while self._rest and room.poll(timeout_s * 1000):
                self._send_rest()
            self._close_pipe()
            try:
                self._child.wait(timeout_s)
            except subprocess.TimeoutExpired:
                self._child.kill()
                with contextlib.suppress(subprocess.TimeoutExpired):  # a hanging disk does not even let go of the dead
                    self._child.wait(timeout_s)
            self._bury()
        os.close(self._reports)
        os.close(self._report_end)
        self._reports = -1

    def _start(self) -> None:
        now_s = self._clock.monotonic_s()
        self._again_s, self._heard_s = now_s + 1.0, now_s
        self._sent, self._rest, self._fd = 0, b"", -1  # records this child was sent; the unsent end of the last
        self._said = LogStatus(False, self._reason or "the writer is starting", "", 0, 0, 0)
        self._child: subprocess.Popen[bytes] | None = None
        command = [sys.executable, "-m", "delfim.logging.writer", self._id]
        try:
            # A session of its own: a signal to the parent's group ends the parent alone, and the child finishes the pipe.
            child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=self._report_end, bufsize=0, start_new_session=True)
        except OSError as error:
            self._reason = f"the writer cannot be started: {error.strerror}"
            return
        assert child.stdin is not None
        self._child, self._reason, self._fd = child, "", child.stdin.fileno()
        os.set_blocking(self._fd, False)
        for size in PIPE_BYTES:
            with contextlib.suppress(OSError):
                fcntl.fcntl(self._fd, fcntl.F_SETPIPE_SZ, size)
                break
        self._send(LENGTH.pack(len(self._settings)) + self._settings)

    def _send(self, message: bytes) -> bool:
        """Write a message into the pipe, its end later if need be; False when there is no room even for its beginning."""
        if self._rest:
            self._send_rest()
            if self._rest:
                return False
        try:
            written = os.write(self._fd, message)
        except OSError:  # full, or the child is dead
            return False
        if written < len(message):
            self._rest = message[written:]
        return True

    def _send_rest(self) -> None:
        try:
            if self._rest:
                self._rest = self._rest[os.write(self._fd, self._rest) :]
        except BlockingIOError:
            pass
        except OSError:  # the child is dead
            self._rest = b""

    def _listen(self) -> None:
        """Read the child's reports. The last one counts; they hold sums."""
        try:
            lines = os.read(self._reports, 1 << 16).splitlines()
            self._said = LogStatus(**json.loads(lines[-1]))
        except (OSError, ValueError):  # nothing new; a torn line
            return
        self._heard_s = self._clock.monotonic_s()

    def _bury(self) -> None:
        """Clean up after the child died: records that it had not reported as written are lost."""
        self._listen()
        self._close_pipe()
        said, before = self._said, self._before
        lost = self._sent - said.records
        self._before = LogStatus(
            False, "", said.file or before.file, before.bytes + said.bytes, before.records + said.records, before.dropped + lost
        )
        self._said = LogStatus(False, said.reason, "", 0, 0, 0)
        self._sent, self._rest, self._child = 0, b"", None

    def _close_pipe(self) -> None:
        if self._child and self._child.stdin:
            self._child.stdin.close()
        self._fd = -1
