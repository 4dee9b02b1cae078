"""The program that grabs and encodes a camera's pictures, a child of ours: the system's ffmpeg, or the played camera.

It writes the pictures in three sizes, each to a pipe of its own. One that ends, hangs or floods is started again after a pause,
and what it said last is the reason that people read.
"""

import logging
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final, NamedTuple, Protocol

from delfim.base.clock import Clock
from delfim.base.errors import FormatError, in_words
from delfim.base.input.untrusted import read_credentials
from delfim.parts.camera import jpegblocks
from delfim.parts.camera.table import CameraTable
from delfim.parts.camera.wire import PICTURE_MAX

LEVELS: Final = 3  # sizes: whole, half, quarter
START_S: Final = 20.0  # until the first picture: an RTSP camera takes some seconds
HANG_S: Final = 5.0  # and five pictures' time without another one
PAUSES_S: Final = (1.0, 2.0, 5.0, 10.0, 30.0)  # until it is started again
FLOOD: Final = 4  # times the pictures a second that are asked for
HEAD_MAX: Final = 512
READ_BYTES: Final = 1 << 18
WORDS_MAX: Final = 200

log = logging.getLogger(__name__)


class Picture(NamedTuple):
    """A JPEG of a camera."""

    jpeg: bytes
    taken_s: float  # when its last byte came, by the monotonic clock
    taken_ms: int  # since 1970


class Watching(Protocol):
    """Of the runtime."""

    def reader(self, fd: int, handler: Callable[[], object]) -> None: ...
    def remove_reader(self, fd: int) -> None: ...


class PictureStream:
    """Cuts pictures out of what ffmpeg writes as `mpjpeg`: no more is kept than one picture. Raises FormatError."""

    def __init__(self) -> None:
        self._data = bytearray()

    def feed(self, data: bytes) -> list[bytes]:
        self._data += data
        found = list[bytes]()
        while (at := self._data.find(b"\r\n\r\n")) >= 0:
            if at > HEAD_MAX:
                break
            length = _length(bytes(self._data[:at]))
            if len(self._data) < at + 4 + length:
                return found
            picture = bytes(self._data[at + 4 : at + 4 + length])
            jpegblocks.size_of(picture)
            found.append(picture)
            del self._data[: at + 4 + length]
            if self._data.startswith(b"\r\n"):
                del self._data[:2]
        if len(self._data) > HEAD_MAX:
            raise FormatError("it writes no pictures")
        return found


def _length(head: bytes) -> int:
    for line in head.split(b"\r\n"):
        name, _, value = line.partition(b":")
        if name.strip().lower() == b"content-length" and value.strip().isdigit() and len(value) < 12:
            length = int(value)
            if 0 < length <= PICTURE_MAX:
                return length
            raise FormatError(f"a picture of {length} bytes; {PICTURE_MAX} are allowed")
    raise FormatError("it writes no pictures")


def sizes(table: CameraTable) -> list[tuple[int, int]]:
    """Of the pictures, each half of the one before, in multiples of 8 pixels."""
    return [(max(table.width_px >> level & ~7, 16), max(table.height_px >> level & ~7, 16)) for level in range(LEVELS)]


def command(table: CameraTable, fds: Sequence[int]) -> list[str]:
    """The program with its words. Raises ConfigError for wrong credentials, FormatError where ffmpeg is not installed."""
    if table.source == "test":
        outs = (f"{width}x{height}:{fd}" for (width, height), fd in zip(sizes(table), fds, strict=True))
        return [sys.executable, "-m", "delfim.parts.camera.played", str(table.rate_hz), *outs]
    if table.source.startswith("/dev/"):
        source = ["-f", "v4l2", "-i", table.source]
    else:
        login = f"{read_credentials(table.credentials)}@" if table.credentials else ""
        scheme, _, place = table.source.partition("://")
        source = ["-rtsp_transport", "tcp", "-timeout", "5000000", "-i", f"{scheme}://{login}{place}"]
    return [*_ffmpeg(), *source, *encoding(table, fds)]


def _ffmpeg() -> list[str]:
    program = shutil.which("ffmpeg")
    if program is None:
        raise FormatError("ffmpeg is not installed: apt install ffmpeg")
    return [program, "-nostdin", "-hide_banner", "-loglevel", "error", "-fflags", "nobuffer", "-flags", "low_delay"]


def encoding(table: CameraTable, fds: Sequence[int]) -> list[str]:
    """The words that make ffmpeg write the sizes: each picture at once, none waits for the next. So the first one of each
    period is taken, where its filter `fps` waits for the one behind, and one thread encodes, where each other one keeps a
    picture back."""
    first = f"select='isnan(prev_t)+gt(floor(t*{table.rate_hz}),floor(prev_t*{table.rate_hz}))'"
    chains = [f"[0:v]{first},split={LEVELS}" + "".join(f"[s{level}]" for level in range(LEVELS))]
    outs = list[str]()
    for level, ((width, height), fd) in enumerate(zip(sizes(table), fds, strict=True)):
        chains.append(f"[s{level}]scale={width}:{height}:flags=bilinear,format=yuvj420p[o{level}]")
        outs += ["-map", f"[o{level}]", "-fps_mode", "passthrough", "-c:v", "mjpeg", "-threads", "1", "-q:v", "6"]
        outs += ["-flush_packets", "1", "-f", "mpjpeg", f"pipe:{fd}"]
    return ["-filter_complex", ";".join(chains), *outs]


class Grabber:
    """One camera. `took` is told each picture with its size: 0 the largest. Its pipes never fill: they are read at once."""

    def __init__(
        self, name: str, table: CameraTable, clock: Clock, watching: Watching, took: Callable[[int, Picture], None]
    ) -> None:
        self._name, self._table, self._clock, self._watching, self._took = name, table, clock, watching, took
        self._child: subprocess.Popen[bytes] | None = None
        self._fds = dict[int, PictureStream]()
        self._said = ""
        self.why, self.starts, self.pictures = "starting", 0, 0
        self._due_s, self._failed, self._heard_s = clock.monotonic_s(), 0, 0.0
        self._second_s, self._in_second = 0.0, 0

    def tick(self) -> None:
        """Due some times a second: starts the program, and ends one that hangs."""
        now_s = self._clock.monotonic_s()
        if self._child is None:
            if now_s >= self._due_s:
                self._start(now_s)
            return
        code = self._child.poll()
        patience_s = START_S if not self._in_second else max(HANG_S, 5.0 / self._table.rate_hz)
        if code is not None:
            self._hear_words()
            self._end(self._said or f"the program ended with code {code}")
        elif now_s - self._heard_s > patience_s:
            self._end(f"no picture for {patience_s:.0f} s")

    def report(self) -> dict[str, object]:
        """JSON-ready."""
        return {"why": self.why, "starts": self.starts, "pictures": self.pictures}

    def close(self) -> None:
        if self._child is not None:
            self._end("ended")

    def _start(self, now_s: float) -> None:
        pipes = [os.pipe() for _ in range(LEVELS)]
        writing = [out for _, out in pipes]
        try:
            words = command(self._table, writing)
            self._child = subprocess.Popen(
                words,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                pass_fds=writing,
                start_new_session=True,
            )
        except (FormatError, OSError) as error:
            for back, _ in pipes:
                os.close(back)
            self._waits(in_words(error))
            return
        finally:
            for out in writing:
                os.close(out)
        assert self._child.stderr is not None
        os.set_blocking(self._child.stderr.fileno(), False)
        self._watching.reader(self._child.stderr.fileno(), self._hear_words)
        for level, (back, _) in enumerate(pipes):
            os.set_blocking(back, False)
            self._fds[back] = PictureStream()
            self._watching.reader(back, partial(self._hear, level, back))
        self.starts += 1
        self._said, self._heard_s, self._in_second, self._second_s = "", now_s, 0, now_s

    def _hear(self, level: int, fd: int) -> None:
        try:
            data = os.read(fd, READ_BYTES)
            pictures = self._fds[fd].feed(data)
        except BlockingIOError:
            return
        except FormatError as error:
            self._end(in_words(error))
            return
        if not data:
            self._watching.remove_reader(fd)  # the next tick finds that the program has ended
            return
        now_s = self._clock.monotonic_s()
        for each in pictures:
            if level == 0:
                self._count(now_s)
            if self._child is None:
                return
            self._took(level, Picture(each, now_s, self._clock.time_ns() // 1_000_000))

    def _count(self, now_s: float) -> None:
        """A program that floods is ended: nobody asked for so many."""
        self.pictures += 1
        self._heard_s, self._failed = now_s, 0
        if now_s - self._second_s >= 1.0:
            self._second_s, self._in_second = now_s, 0
        self._in_second += 1
        if self.why:
            log.warning("camera %s: pictures come", self._name)
            self.why = ""
        if self._in_second > FLOOD * self._table.rate_hz + 10:
            self._end(f"more than {self._in_second - 1} pictures a second")

    def _hear_words(self) -> None:
        """Keeps the last line that it said, without its password."""
        assert self._child is not None
        assert self._child.stderr is not None
        fd = self._child.stderr.fileno()
        try:
            data = os.read(fd, READ_BYTES)
        except BlockingIOError:
            return
        if not data:
            self._watching.remove_reader(fd)
        lines = [line for line in data.decode(errors="replace").splitlines() if line.strip()]
        if lines:
            self._said = self._without_password(lines[-1].strip())[:WORDS_MAX]

    def _without_password(self, words: str) -> str:
        if not self._table.credentials:
            return words
        try:
            login = read_credentials(self._table.credentials)
        except FormatError:
            return "the program said something that may hold the password"
        return words.replace(login, "...").replace(login.partition(":")[2] or login, "...")

    def _end(self, why: str) -> None:
        """Ends the program and all that it started."""
        child = self._child
        assert child is not None
        assert child.stderr is not None
        self._child = None
        for fd in (*self._fds, child.stderr.fileno()):
            self._watching.remove_reader(fd)
        for fd in self._fds:
            os.close(fd)
        self._fds.clear()
        child.stderr.close()
        child.kill()
        child.wait()
        self._waits(why)

    def _waits(self, why: str) -> None:
        if why != self.why:
            log.warning("camera %s: %s", self._name, why)
        self.why = why
        self._due_s = self._clock.monotonic_s() + PAUSES_S[min(self._failed, len(PAUSES_S) - 1)]
        self._failed += 1
