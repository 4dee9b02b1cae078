"""liblog: logs that never hold up the program that writes them (thesis 2.10).

    DIRECTORY/YYYYMMDD/id/hhmmss.suffix            UTC of creation; hhmmss-1, -2, ... where the name is taken; .gz if deflated
    DIRECTORY/YYYYMMDD/id/hhmmss.meta.jsonl        its sidecar: what happened and is no record

Three ways to write, one interface:

    write     a system call a record, in the caller, who waits for the disk
    zwrite    deflated, in the caller, who waits for the disk: tests, tools, services in processes of their own
    zpipe     through a pipe to a niced child (delfim.logging.writer) that deflates, writes and syncs; the caller never waits

A file is ended past a size or an age, and whenever writing failed; none is ever opened twice. A log that cannot write drops
and counts what it is given, says why, tries again about once a second, and is itself again when the disk is. No method raises.
"""

import contextlib
import errno
import fcntl
import json
import math
import os
import select
import struct
import subprocess
import sys
import time
import zlib
from typing import Any, Final, Literal, NamedTuple, Protocol

from delfim.clock import Clock
from delfim.logging import guard
from delfim.logging.reading import in_order as in_order  # reading needs no Linux and is told here too, beside the writing
from delfim.logging.reading import read_log as read_log

FLUSH_S: Final = 0.6  # with the writer's rhythm and a slow disk's own time a power cut costs less than a second
UNPOLLED_S: Final = 1.0  # so late a `put` does what a `poll` should have done: who has a critical path polls beside it
MEMBER_S: Final = 10.0  # of log in a gzip member: what is behind a damaged one can be found again
PENDING_BYTES: Final = 1 << 18  # deflated and not yet written
SAME_SECOND: Final = 1000  # files of one name and second
PIPE_BYTES: Final = (4 << 20, 1 << 20)  # asked for in this order: the privileged may exceed pipe-max-size, 1 MiB
SILENT_S: Final = 5.0  # a writer that does not report for so long hangs on its disk
LENGTH: Final = struct.Struct("=I")  # before each message in the pipe; the highest bit marks a line for the sidecar
NOTE: Final = 1 << 31

Method = Literal["write", "zwrite", "zpipe"]
WhenFull = Literal["delete-oldest", "stop"]


class LogStatus(NamedTuple):
    """How a log fares. The numbers count from its opening: what was put is in `records`, in `dropped`, or under way."""

    writable: bool
    reason: str  # why it is not, in words; empty while it is
    file: str  # being written, or written last
    bytes: int  # on disk
    records: int  # on disk
    dropped: int


class Log(Protocol):
    """A log. Records go to disk whole and in order, or are dropped and counted."""

    def put(self, record: bytes) -> bool:
        """Take a record. False: it was dropped."""

    def note(self, line: bytes) -> bool:
        """Append a line, with its end, to the sidecar of the current file; seldom, it costs an open and a close."""

    def status(self) -> LogStatus: ...

    def poll(self) -> None:
        """Call about once a second: flushes, reads the writer's reports, starts it again after it died."""

    def status_fileno(self) -> int:
        """Readable when `poll` has something to read; -1 where there is no writer."""

    def close(self, timeout_s: float = 2.0) -> None:
        """Flush and end. A writer that takes longer is killed, and what it had not written counts as dropped."""


def event_line(clock: Clock, event: str, **what: object) -> bytes:
    """A line for a sidecar: what happened, when, and more words about it (JSON-ready)."""
    return json.dumps({"t_ns": clock.time_ns(), "monotonic_s": clock.monotonic_s(), "event": event} | what).encode() + b"\n"


class Settings(NamedTuple):
    """Of a log and its files, as a writer is told them; delfim.logging.openlog says what they mean."""

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


class FileLog:
    """`write` and `zwrite`. With `durable` it is the child's: what is flushed is on the disk, and so is the file's name.

    On ext2 a synced file whose directory is not synced is lost to its name after a power cut, so both are.
    """

    def __init__(self, settings: Settings, clock: Clock, *, deflate: bool, durable: bool = False) -> None:
        self._settings, self._clock, self._deflate, self._durable = settings, clock, deflate, durable
        self._fd = self._day_fd = -1
        self._stem = self._day = self._reason = ""
        self._suffix = settings.suffix + (".gz" if deflate else "")
        self._stream: Any = None  # the open gzip member
        self._member_s = self._end_s = 0.0  # when it was opened; when the file is too old
        self._pending, self._waiting = bytearray(), 0  # bytes for the file; records since the last flush
        self._size = self._kept = 0  # of the file, in whole records: bytes, records
        self._bytes = self._records = self._dropped = 0  # of the files before it: bytes, records; of all
        self._due_s = -math.inf
        self._open(clock.monotonic_s())

    def put(self, record: bytes) -> bool:
        now_s = self._clock.monotonic_s()
        if now_s >= self._due_s + (UNPOLLED_S if self._fd >= 0 else 0.0):
            self._attend(now_s)
        if self._fd < 0 and not self._reason:
            self._open(now_s)
        if self._fd < 0:
            self._dropped += 1
            return False
        if not self._deflate:
            return self._written(record, now_s)
        self._waiting += 1
        self._pending += self._deflated(record, now_s)
        return len(self._pending) < PENDING_BYTES or self._flush(now_s)

    def note(self, line: bytes) -> bool:
        if self._fd < 0 and not self._reason:
            self._open(self._clock.monotonic_s())
        if self._fd < 0:
            return False
        path = self._stem + ".meta.jsonl"
        try:
            fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
            try:
                _write_all(fd, line)
                if self._durable:
                    os.fsync(fd)
                    _sync_directory(os.path.dirname(path))
            finally:
                os.close(fd)
        except OSError:
            return False
        return True

    def status(self) -> LogStatus:
        written, records = self._bytes + self._size, self._records + self._kept
        return LogStatus(not self._reason, self._reason, self._file(), written, records, self._dropped)

    def poll(self) -> None:
        now_s = self._clock.monotonic_s()
        if now_s >= self._due_s:
            self._attend(now_s)

    def status_fileno(self) -> int:
        return -1

    def close(self, timeout_s: float = 2.0) -> None:
        self._end(self._clock.monotonic_s())
        self._reason, self._due_s = "closed", math.inf

    def _file(self) -> str:
        return self._stem + self._suffix if self._stem else ""

    def _attend(self, now_s: float) -> None:
        """What was put reaches the file; a file that is too large or too old ends; what went wrong is tried again."""
        self._due_s = now_s + FLUSH_S
        if self._fd < 0:
            if self._reason:
                self._open(now_s)
        elif self._flush(now_s) and self._fd >= 0:
            if now_s >= self._end_s:
                self._end(now_s)
            else:
                self._look(now_s)

    def _open(self, now_s: float) -> None:
        self._due_s = now_s + FLUSH_S
        try:
            os.makedirs(self._settings.directory, exist_ok=True)
            self._make_room()
            self._create()
            self._reason = ""
        except OSError as error:
            self._fail(error)
            return
        self._end_s = now_s + self._settings.file_s
        self._pending += self._deflated(self._settings.header, now_s) if self._deflate else self._settings.header
        self._flush(now_s)

    def _create(self) -> None:
        """A new file of a new name, in the day that the wall clock shows."""
        directory, id_ = self._settings.directory, self._settings.id
        utc = time.gmtime(self._clock.time_ns() // 1_000_000_000)
        self._day = time.strftime("%Y%m%d", utc)
        day = os.path.join(directory, self._day)
        folder = os.path.join(day, id_)
        os.makedirs(folder, exist_ok=True)
        self._day_fd = os.open(day, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        fcntl.flock(self._day_fd, fcntl.LOCK_SH | fcntl.LOCK_NB)  # the guard leaves this day alone
        name = os.path.join(folder, time.strftime("%H%M%S", utc))
        for number in range(SAME_SECOND):
            stem = f"{name}-{number}" if number else name
            try:
                self._fd = os.open(stem + self._suffix, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
            except FileExistsError:
                continue
            self._stem = stem
            break
        else:
            raise OSError(errno.EEXIST, "all names of this second are taken", name)
        if self._durable:
            for path in (folder, day, directory):
                _sync_directory(path)

    def _deflated(self, data: bytes, now_s: float) -> bytes:
        if self._stream is None:
            self._stream, self._member_s = zlib.compressobj(wbits=31), now_s
        deflated: bytes = self._stream.compress(data)
        return deflated

    def _written(self, record: bytes, now_s: float) -> bool:
        """A plain record to the file: nothing but its system call, for a caller who waits."""
        try:
            _write_all(self._fd, record)
        except OSError as error:
            self._dropped += 1
            self._fail(error)
            return False
        self._size += len(record)
        self._kept += 1
        if self._size >= self._settings.file_bytes:
            self._end(now_s)
        return True

    def _flush(self, now_s: float, *, finish: bool = False) -> bool:
        """Everything put so far to the file, which then ends with a whole record."""
        if not (self._waiting or self._pending or (self._stream and finish)):
            return True
        try:
            if self._stream:
                finish = finish or now_s - self._member_s >= MEMBER_S
                self._pending += self._stream.flush(zlib.Z_FINISH if finish else zlib.Z_SYNC_FLUSH)
                if finish:
                    self._stream = None
            _write_all(self._fd, self._pending)
            if self._durable:
                os.fsync(self._fd)
        except OSError as error:
            self._fail(error)
            return False
        self._size += len(self._pending)
        self._kept += self._waiting
        self._waiting = 0
        self._pending.clear()
        if self._kept and self._size >= self._settings.file_bytes:
            self._end(now_s)
        return True

    def _look(self, now_s: float) -> None:
        """What the file itself does not show: somebody deleted it, or the disk is filling up."""
        try:
            if os.fstat(self._fd).st_nlink == 0:
                raise OSError(errno.ENOENT, "the file was deleted", self._file())
            self._make_room()
        except OSError as error:
            self._end(now_s)
            self._fail(error)

    def _make_room(self) -> None:
        """Raises OSError when less is free than must be."""
        directory, free_bytes_min = self._settings.directory, self._settings.free_bytes_min
        words = f"less than {free_bytes_min} bytes are free"
        if self._settings.when_full == "delete-oldest":
            words += ", and no day of logs may be deleted"
            wanted = free_bytes_min + self._upload_room()
            if guard.free_bytes(directory) < wanted:
                today = time.strftime("%Y%m%d", time.gmtime(self._clock.time_ns() // 1_000_000_000))
                guard.make_room(directory, wanted, {today, self._day})
        if guard.free_bytes(directory) < free_bytes_min:
            raise OSError(errno.ENOSPC, words, directory)

    def _upload_room(self) -> int:
        """Bytes that uploads may still take. They are only counted when the disk is so full that it matters."""
        settings = self._settings
        if guard.free_bytes(settings.directory) >= settings.free_bytes_min + settings.upload_bytes_max:
            return 0
        return guard.upload_room(os.path.join(settings.directory, settings.upload_folder), settings.upload_bytes_max)

    def _end(self, now_s: float) -> None:
        """End the file; the next record opens another."""
        if self._fd >= 0 and (not self._stream or self._flush(now_s, finish=True)):
            self._close()

    def _fail(self, error: OSError) -> None:
        """Give the file up where its last whole record ends. What waited is lost."""
        self._reason = f"{error.filename or self._file() or self._settings.directory}: {error.strerror}"
        self._dropped += self._waiting
        self._waiting, self._stream = 0, None
        self._pending.clear()
        if self._fd >= 0:
            with contextlib.suppress(OSError):
                if self._kept:
                    os.ftruncate(self._fd, self._size)
                else:
                    os.unlink(self._file())
        self._close()

    def _close(self) -> None:
        for fd in (self._fd, self._day_fd):
            if fd >= 0:
                with contextlib.suppress(OSError):
                    os.close(fd)
        self._fd = self._day_fd = -1
        self._bytes += self._size
        self._records += self._kept
        self._size = self._kept = 0


class PipeLog:
    """`zpipe`. The pipe is the bounded buffer: a record that it has no room for is dropped. Nobody waits at its other end, the
    child looks into it every now and then, so a `put` wakes nobody and costs one short system call."""

    def __init__(self, settings: Settings, clock: Clock, nice: int) -> None:
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
            reason = f"the writer has not reported for {silent_s:.0f} s: its disk hangs"
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
        self._sent, self._rest, self._fd = 0, b"", -1  # records this child was sent; what the pipe did not take of the last one
        self._said = LogStatus(False, self._reason or "the writer is starting", "", 0, 0, 0)
        self._child: subprocess.Popen[bytes] | None = None
        command = [sys.executable, "-m", "delfim.logging.writer", self._id]
        try:
            # A session of its own: what ends the parent's group ends the parent, and then the pipe lets the child finish.
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
        """A message into the pipe, its end later if need be; False when there is no room even for its beginning."""
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
        """The last of the child's reports counts; they hold sums."""
        try:
            lines = os.read(self._reports, 1 << 16).splitlines()
            self._said = LogStatus(**json.loads(lines[-1]))
        except (OSError, ValueError):  # nothing new; a torn line
            return
        self._heard_s = self._clock.monotonic_s()

    def _bury(self) -> None:
        """The child is dead: what it had not reported as written is lost."""
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


def _write_all(fd: int, data: bytes | bytearray) -> None:
    written = os.write(fd, data)
    while written < len(data):  # the disk is about to be full: the next call says so
        data = data[written:]
        written = os.write(fd, data)


def _sync_directory(path: str) -> None:
    fd = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
