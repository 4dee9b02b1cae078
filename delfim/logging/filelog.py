"""A log that the caller writes itself: the methods `write` and `zwrite` of delfim.logging.liblog."""

import contextlib
import errno
import math
import os
import time
import zlib
from collections.abc import Callable
from typing import Any, Final

from delfim.base.clock import Clock
from delfim.base.wholefile import sync_directory
from delfim.logging import free_space
from delfim.logging.chain import Chain
from delfim.logging.liblog import LogSettings, LogStatus

FLUSH_S: Final = 0.6  # with the writer's rhythm and a slow disk's own time a power cut costs less than a second
UNPOLLED_S: Final = 1.0  # after this a `put` does the work of a missing `poll`: code with a critical path polls beside it
MEMBER_S: Final = 10.0  # of log in a gzip member: the log after a damaged one can be found again
PENDING_BYTES: Final = 1 << 18  # deflated and not yet written
SAME_SECOND: Final = 1000  # files of one name and second
MISNAMED_S: Final = 3600.0  # a wall clock that steps by more makes the file's name wrong
PLAIN: Final = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)  # Windows would end lines otherwise, and never inherits
_META: Final = ".meta.jsonl"


class FileLog:
    """A log by `write` or `zwrite`. With `durable`, for the child, flushed data is on the disk, and so is the file's name, and
    a chain is beside each file.

    On ext2 a synced file whose directory is not synced is lost to its name after a power cut, so both are.
    """

    def __init__(self, settings: LogSettings, clock: Clock, *, deflate: bool, durable: bool = False) -> None:
        self._settings, self._clock, self._deflate, self._durable = settings, clock, deflate, durable
        self._fd = self._day_fd = -1
        self._stem = self._day = self._reason = ""
        self._suffix = settings.suffix + (".gz" if deflate else "")
        self._stream: Any = None  # the open gzip member
        self._member_s = self._end_s = 0.0  # when it was opened; when the file is too old
        self._pending, self._waiting = bytearray(), 0  # bytes for the file; records since the last flush
        self._size = self._kept = 0  # of the file, in whole records: bytes, records
        self._bytes = self._records = self._dropped = 0  # of the files before it: bytes, records; of all
        self._chain = Chain(settings.directory, settings.id) if durable else None
        self._due_s = -math.inf
        self._wall_s = clock.time_ns() / 1e9 - clock.monotonic_s()  # UTC minus monotonic time
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
        path = self._stem + _META
        is_whole = self._appended(path, line)
        if self._chain:
            self._chain.noted(path, line, whole=is_whole)
            self._chain.link(self._clock.time_ns(), kept=self._kept > 0)
        return is_whole

    def _appended(self, path: str, line: bytes) -> bool:
        try:
            fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | PLAIN, 0o644)
            try:
                _write_all(fd, line)
                if self._durable:
                    os.fsync(fd)
                    sync_directory(os.path.dirname(path))
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
        """Writes waiting records to the file, ends a file that is too old, and retries after a failure."""
        self._due_s = now_s + FLUSH_S
        was_s, self._wall_s = self._wall_s, self._clock.time_ns() / 1e9 - now_s
        if abs(self._wall_s - was_s) > MISNAMED_S and self._fd >= 0:
            self._rename()
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
            self._create(self._clock.time_ns(), _new)
            if self._chain:
                self._chain.begin(self._stem)
            self._reason = ""
        except OSError as error:
            self._fail(error)
            return
        self._end_s = now_s + self._settings.file_s
        self._pending += self._deflated(self._settings.header, now_s) if self._deflate else self._settings.header
        self._flush(now_s)

    def _rename(self) -> None:
        """Give the file the name that it would have if the clock had been right when it began, and its sidecar too. Where that
        fails, it keeps its name: a name is not worth a record."""
        fd, day_fd, stem, day, file = self._fd, self._day_fd, self._stem, self._day, self._file()

        def moved(path: str) -> int:
            os.close(_new(path))
            os.replace(file, path)
            return fd

        try:
            self._create(round((self._wall_s + self._end_s - self._settings.file_s) * 1e9), moved)
        except OSError:
            if self._stem == stem:
                if self._day_fd != day_fd:
                    with contextlib.suppress(OSError):
                        os.close(self._day_fd)
                self._day_fd, self._day = day_fd, day
                return
        with contextlib.suppress(OSError):  # nothing was noted yet
            os.replace(stem + _META, self._stem + _META)
        if self._chain:
            self._chain.moved(self._stem)
        with contextlib.suppress(OSError):
            os.close(day_fd)
        folder = os.path.dirname(file)
        with contextlib.suppress(OSError):  # others are still in it
            if self._durable:
                sync_directory(folder)
            os.rmdir(folder)
            os.rmdir(os.path.dirname(folder))

    def _create(self, time_ns: int, make: Callable[[str], int]) -> None:
        """Create a file of a new name, in the day of this time. `make` makes it, unless it exists, and returns its
        descriptor."""
        directory, id_ = self._settings.directory, self._settings.id
        utc = time.gmtime(time_ns // 1_000_000_000)
        self._day = time.strftime("%Y%m%d", utc)
        day = os.path.join(directory, self._day)
        folder = os.path.join(day, id_)
        os.makedirs(folder, exist_ok=True)
        self._day_fd = free_space.hold(day)
        name = os.path.join(folder, time.strftime("%H%M%S", utc))
        for number in range(SAME_SECOND):
            stem = f"{name}-{number}" if number else name
            try:
                self._fd = make(stem + self._suffix)
            except FileExistsError:
                continue
            self._stem = stem
            break
        else:
            raise OSError(errno.EEXIST, "all names of this second are taken", name)
        if self._durable:
            for path in (folder, day, directory):
                sync_directory(path)

    def _deflated(self, data: bytes, now_s: float) -> bytes:
        if self._stream is None:
            self._stream, self._member_s = zlib.compressobj(wbits=31), now_s
        deflated: bytes = self._stream.compress(data)
        return deflated

    def _written(self, record: bytes, now_s: float) -> bool:
        """Write a plain record: nothing but its system call, for a caller that waits."""
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
        """Write everything put so far to the file, which then ends with a whole record."""
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
        if self._chain:
            self._chain.wrote(self._pending)
            if finish:
                self._chain.link(self._clock.time_ns(), kept=self._kept > 0, sync=True)
        self._waiting = 0
        self._pending.clear()
        if self._kept and self._size >= self._settings.file_bytes:
            self._end(now_s)
        return True

    def _look(self, now_s: float) -> None:
        """Notice what writing does not show: that the file was deleted, or that the disk is filling up."""
        try:
            if os.fstat(self._fd).st_nlink == 0:
                raise OSError(errno.ENOENT, "the file was deleted", self._file())
            self._make_room()
        except OSError as error:
            self._end(now_s)
            self._fail(error)

    def _make_room(self) -> None:
        """Free space on the disk. Raises OSError if less is free than the settings demand."""
        directory, free_bytes_min = self._settings.directory, self._settings.free_bytes_min
        words = f"less than {free_bytes_min} bytes are free"
        if self._settings.when_full == "delete-oldest":
            words += ", and no day of logs may be deleted"
            wanted = free_bytes_min + self._upload_room()
            if free_space.free_bytes(directory) < wanted:
                today = time.strftime("%Y%m%d", time.gmtime(self._clock.time_ns() // 1_000_000_000))
                free_space.make_room(directory, wanted, {today, self._day})
        if free_space.free_bytes(directory) < free_bytes_min:
            raise OSError(errno.ENOSPC, words, directory)

    def _upload_room(self) -> int:
        """The bytes that uploads may still take. They are only counted when the disk is so full that it matters."""
        settings = self._settings
        if free_space.free_bytes(settings.directory) >= settings.free_bytes_min + settings.upload_bytes_max:
            return 0
        return free_space.upload_room(os.path.join(settings.directory, settings.upload_folder), settings.upload_bytes_max)

    def _end(self, now_s: float) -> None:
        """End the file; the next record opens another."""
        if self._fd >= 0 and (not self._stream or self._flush(now_s, finish=True)):
            self._link_end(kept=True)
            self._close()

    def _link_end(self, *, kept: bool) -> None:
        if self._chain and self._fd >= 0:
            self._chain.link(self._clock.time_ns(), kept=kept, end=True, sync=True)

    def _fail(self, error: OSError) -> None:
        """Give the file up at the end of its last whole record. Waiting records are lost."""
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
                self._link_end(kept=self._kept > 0)
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


def _new(path: str) -> int:
    return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | PLAIN, 0o644)


def _write_all(fd: int, data: bytes | bytearray) -> None:
    written = os.write(fd, data)
    while written < len(data):  # the disk is about to be full: the next call says so
        data = data[written:]
        written = os.write(fd, data)
