"""Reads log files, on any computer: the writers need Linux, the readers do not."""

import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

import msgspec

from delfim.base.errors import FormatError
from delfim.base.input.untrusted import parse_json, read_file

LOG_BYTES: Final = 1 << 27  # of a log that is read, inflated or not: a larger one was made to exhaust memory
LINE_BYTES: Final = 1 << 24  # of a line
STEP: Final = 1 << 12  # bytes of a member that are inflated at a time
FLUSHED: Final = b"\0\0\xff\xff"  # ends what Z_SYNC_FLUSH wrote (RFC 1951, 3.2.4: an empty stored block)
NO_SECTOR: Final = bytes(512)  # of a disk, that was not written; no deflated log has so many zeros
EMPTY_LAST_BLOCK: Final = b"\3\0"  # in fixed Huffman codes (RFC 1951, 3.2.6)
MOMENT_MAX_S: Final = 1e10  # of a clock


class Member(NamedTuple):
    """A gzip member, or what was flushed of one that is cut or damaged."""

    content: bytes
    end: int  # where the next one begins; of a cut or damaged one where its last flush ends
    trouble: str  # "": whole; "cut", "damaged"


def raw(path: str | Path) -> bytes:
    """Read a file of a log as it is. Raises OSError."""
    return read_file(path, LOG_BYTES)


class Inflating:
    """Inflates the gzip member that begins at `at`, in pieces: whole, or up to the last flush before it is cut or damaged.

    What follows that flush is not told: gzip has a checksum for the whole member alone, and where a power cut left sectors of
    zeros or of an older file, inflating goes on for a while and makes records that never were. A flush ends a block at a whole
    byte, so what came before is as it was written. More than `bytes_max` is damage. `end`, `trouble`: of a `Member`, after the
    last piece.
    """

    def __init__(self, data: bytes, at: int, bytes_max: int) -> None:
        self.end, self.trouble = at, "cut"
        self._data, self._bytes_max = data, bytes_max

    def __iter__(self) -> Iterator[bytes]:
        stream, left, crc, at = zlib.decompressobj(wbits=31), self._bytes_max, 0, self.end
        held, has_hole = bytearray(), False  # since the last flush
        while at < len(self._data):
            mark = self._data.find(FLUSHED, at, at + STEP)
            step = STEP if mark < 0 else mark + len(FLUSHED) - at
            try:
                piece = stream.decompress(self._data[at : at + step], left + 1)
            except zlib.error:
                self.trouble = "damaged"
                return
            left -= len(piece)
            if left < 0:
                self.trouble = "damaged"
                return
            crc = zlib.crc32(piece, crc)
            held += piece
            was, at = at, at + min(step, len(self._data) - at) - len(stream.unused_data)
            has_hole = has_hole or NO_SECTOR in self._data[max(self.end, was - len(NO_SECTOR)) : at]
            is_flushed = mark >= 0 and not has_hole and _is_flushed(stream, crc, self._bytes_max - left)
            if stream.eof or is_flushed or len(held) > LINE_BYTES:
                yield bytes(held)
                held.clear()
                self.end, has_hole = at, False
            if stream.eof:
                self.trouble = ""
                return


def _is_flushed(stream: Any, crc: int, size: int) -> bool:
    """Whether a stream stands at the end of a flush: there and only there a member could end by an empty last block."""
    ending = stream.copy()
    try:
        ending.decompress(EMPTY_LAST_BLOCK + struct.pack("<II", crc, size & 0xFFFFFFFF))
    except zlib.error:
        return False
    return bool(ending.eof)


def member(data: bytes, at: int) -> Member:
    """Inflate the gzip member that begins at `at`."""
    its = Inflating(data, at, LOG_BYTES)
    return Member(b"".join(its), its.end, its.trouble)


def read_log(path: str | Path) -> tuple[bytes, str]:
    """Read a log file, deflated or not: its content, and its damage in words; empty if there is none. Raises OSError.

    A file that a power cut left without its end gives everything up to the last flush.
    """
    troubles = list[str]()
    content = b"".join(_pieces(path, troubles.append))
    return content, "".join(troubles)


def read_lines(path: str | Path, tell: Callable[[str], object] = lambda trouble: None) -> Iterator[bytes]:
    """Read the lines of a log file, deflated or not, without their ends; the last one may be torn. A piece of it is in memory
    at a time: a small file may hold a hundred megabytes of nothing. `tell` gets its damage in words. Raises OSError."""
    rest = b""
    for piece in _pieces(path, tell):
        *lines, rest = (rest + piece).split(b"\n")
        yield from lines
        if len(rest) > LINE_BYTES:
            return
    if rest:
        yield rest


def _pieces(path: str | Path, tell: Callable[[str], object]) -> Iterator[bytes]:
    """Read the content of a log file in pieces; `tell` gets its damage in words."""
    data = raw(path)
    if data[:2] != b"\x1f\x8b":
        yield data
        return
    size, at = 0, 0
    while at < len(data):
        its = Inflating(data, at, LOG_BYTES - size)
        for piece in its:
            size += len(piece)
            yield piece
        at = its.end
        if its.trouble:
            tell(f"{path}: {its.trouble} after {size} bytes of content")
            return


Degrees = Annotated[float, msgspec.Meta(ge=0.0, le=360.0)]
Count = Annotated[float, msgspec.Meta(ge=0.0, le=1e6)]


class LoggedVessel(msgspec.Struct):
    """Another vessel, as a sidecar records it (docs/log-format.md)."""

    key: str
    name: str
    latitude_deg: Annotated[float, msgspec.Meta(ge=-89.0, le=89.0)]
    longitude_deg: Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)]
    course_deg: Degrees | None
    speed_mps: Count
    heading_deg: Degrees | None
    length_m: Count
    beam_m: Count
    size_known: bool
    kind: str
    status: int
    age_s: Count
    lost: bool


Second = Annotated[float, msgspec.Meta(gt=-MOMENT_MAX_S, lt=MOMENT_MAX_S)]


class LoggedSounding(msgspec.Struct, frozen=True):
    """A sounding, with the fields that readers understand."""

    monotonic_s: Second
    measured_s: Second
    depth_m: float
    offset_m: float = 0.0
    source: str = ""
    confidence: float | None = None  # 0..1
    number: int | None = None


def read_events(path: str | Path) -> Iterator[dict[str, Any]]:
    """Read the events of a sidecar, one a line; unreadable lines are left out: the power may have failed in the middle of one.
    Raises OSError."""
    for line in raw(path).splitlines():
        try:
            told = parse_json(line)
        except FormatError:
            continue
        if isinstance(told, dict) and _is_event(told):
            yield told


def _is_event(told: dict[str, Any]) -> bool:
    """Whether an event has its time and name, and known fields only of the types that readers understand."""
    moments = [told[key] for key in ("monotonic_s", "at_s", "jumping_s", "jumped_s") if key in told]
    words = [told.get("event")] + [told[key] for key in ("refused",) if key in told]
    if not all(isinstance(word, str) for word in words):
        return False
    if not all(isinstance(moment, int | float) and abs(moment) < MOMENT_MAX_S for moment in moments):
        return False
    if told["event"] == "command":
        value = told.get("value")
        if not isinstance(value, dict) or not isinstance(value.get("command"), str) or "refused" not in told:
            return False
    if told["event"] == "vessels" and not _is_of(list[LoggedVessel], told.get("value")):
        return False
    if told["event"] == "sounding" and not _is_of(LoggedSounding, told):
        return False
    return type(told.get("t_ns")) is int and 0 <= told["t_ns"] < 1 << 63


def _is_of(kind: Any, value: object) -> bool:
    try:
        msgspec.convert(value, kind)
    except msgspec.ValidationError:
        return False
    return True
