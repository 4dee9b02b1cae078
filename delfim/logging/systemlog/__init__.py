"""The entrance of the system log: it puts the records of every program of the suite, from Python's `logging`, into one pipe.

    logging -> SystemHandler -> a line of JSON, one write -> RUN-DIRECTORY/system.pipe -> syslogd -> DIRECTORY/YYYYMMDD/system/
                             -> from warnings on, as text -> standard error

Nobody waits. A line is shorter than PIPE_BUF, so the kernel takes it whole or not at all, from many programs at once. The pipe
is the bounded queue: lines stay in it when their program is killed, and while syslogd is started again. Lines that come too
fast or find no room are dropped, counted and told. Standard library only: the supervisor logs, too.
"""

import errno
import json
import logging
import os
import select
import stat
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from types import TracebackType
from typing import Final

with suppress(ImportError):  # Windows has none, and no boat whose programs write into it
    import fcntl

from delfim.base.clock import Clock, SystemClock
from delfim.base.errors import one_line

PIPE: Final = "system.pipe"
RECENT: Final = ("system.jsonl", "system.1.jsonl")  # the last lines, for the page; newest file first
RECENT_BYTES: Final = 1 << 18  # of each
PIPE_BYTES: Final = 1 << 20
RATE_HZ: Final = 100.0  # lines that a program may log for long ...
BURST: Final = 1000.0  # ... and at once, ...
RESERVES: Final = {logging.DEBUG: 500.0, logging.INFO: 200.0}  # ... of which so many are for what is worse
MESSAGE_MAX: Final = 1 << 15  # characters of a message ...
PIECES: Final = 40  # ... and lines: the loop has half a millisecond
TEXT_MAX: Final = 900  # characters of a line; with four bytes each it is still shorter than PIPE_BUF
MORE: Final = "  | "  # begins the second line of a message and those after it, so that no name can pretend to be a line

log = logging.getLogger(__name__)


class SystemHandler(logging.Handler):
    """Writes records into the pipe and onto standard error. Neither waits, and nothing raises.

    pipe: non-blocking descriptor; -1: there is none.
    levels: the least level of a service, by its name; "" is for all others.
    service: the name of the service that speaks, "" where it is the program itself.
    """

    def __init__(
        self,
        pipe: int,
        program: str,
        clock: Clock,
        *,
        levels: Mapping[str, int],
        service: Callable[[], str] = str,
        terminal: int = 2,
    ) -> None:
        super().__init__()
        self._pipe, self._program, self._clock = pipe, program, clock
        self._levels, self._service = levels, service
        self._terminal, self._terminal_room = terminal, select.poll()
        self._terminal_room.register(terminal, select.POLLOUT)
        self._room, self._room_s = BURST, clock.monotonic_s()  # lines that may come at once, and since when
        self._lost = 0

    def emit(self, record: logging.LogRecord) -> None:
        service = self._service() or self._program
        level = self._levels.get(service)
        if record.levelno < (self._levels[""] if level is None else level):
            return
        if not self._has_room(record.levelno):
            self._lost += 1
            return
        try:
            text = self.format(record)[:MESSAGE_MAX]
        except Exception:  # as all handlers of the standard library: a wrong call must not end its program
            self.handleError(record)
            return
        first, *more = text.split("\n")
        pieces = [_printable(first), *(MORE + _printable(each) for each in more[:PIECES] if each)]
        if record.levelno >= logging.WARNING:
            self._show(pieces)
        self._tell_lost(service)
        pieces[0] = pieces[0].removeprefix(f"{service}: ")
        for piece in pieces:
            if not self._put(record.levelname, service, piece):
                self._lost += 1

    def close(self) -> None:
        self._tell_lost(self._program)
        super().close()

    def _has_room(self, level: int) -> bool:
        now_s = self._clock.monotonic_s()
        self._room, self._room_s = min(self._room + (now_s - self._room_s) * RATE_HZ, BURST), now_s
        if self._room < RESERVES.get(level, 1.0):
            return False
        self._room -= 1.0
        return True

    def _tell_lost(self, service: str) -> None:
        words = f"{self._lost} lines of this program were lost: too many at once"
        if self._lost and self._put("WARNING", service, words):
            self._lost = 0

    def _put(self, level: str, service: str, text: str) -> bool:
        line = (
            f'{{"t_ns": {self._clock.time_ns()}, "monotonic_s": {self._clock.monotonic_s():.6f}, "level": "{level.lower()}", '
            f'"pid": {os.getpid()}, "service": "{service}", "text": {json.dumps(text[:TEXT_MAX], ensure_ascii=False)}}}\n'
        )
        try:
            return self._pipe < 0 or os.write(self._pipe, line.encode()) > 0
        except OSError:  # it is full
            return False

    def _show(self, pieces: list[str]) -> None:
        """Write to standard error, a terminal or wherever it leads. A serial console that is behind must not hold up the
        boat."""
        for piece in pieces:
            with suppress(OSError):
                if self._terminal_room.poll(0):
                    os.write(self._terminal, f"{piece}\n".encode())


def _printable(text: str) -> str:
    return one_line(text if text.isprintable() else repr(text)[1:-1])


def begin(directory: str, program: str, levels: Mapping[str, str], service: Callable[[], str] = str) -> None:
    """Make this program's `logging` part of the system log of this run directory. `levels` is as in SystemHandler, by their
    names. Failures go to standard error, and the program goes on."""
    path, reason = os.path.join(directory, PIPE), ""
    try:
        pipe = open_pipe(path)
    except OSError as error:
        pipe, reason = -1, f"{path}: {error.strerror}"
    numbers = {"": logging.INFO} | {name: getattr(logging, level.upper()) for name, level in levels.items()}
    logging.getLogger().handlers = [SystemHandler(pipe, program, SystemClock(), levels=numbers, service=service)]
    logging.getLogger("delfim").setLevel(min(numbers.values()))
    sys.excepthook = _defect
    if reason:
        log.warning("no system log: %s; warnings are on standard error alone", reason)


def recent(directory: str) -> list[bytes]:
    """The last lines in a run directory, newest first. It reads files."""
    lines: list[bytes] = []
    for name in RECENT:
        with suppress(OSError), open(os.path.join(directory, name), "rb") as file:
            lines += file.read(2 * RECENT_BYTES).splitlines()[::-1]
    return lines


def open_pipe(path: str) -> int:
    """Open both ends of the pipe. Opening never waits, and a pipe that somebody holds keeps what is in it. Raises OSError."""
    with suppress(FileExistsError):
        os.mkfifo(path, 0o600)
    pipe = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOFOLLOW)
    if not stat.S_ISFIFO(os.fstat(pipe).st_mode):
        os.close(pipe)
        raise OSError(errno.EEXIST, "this is no pipe")
    with suppress(OSError):
        fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
    return pipe


def _defect(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    log.critical("defect in the program", exc_info=(kind, error, trace))
