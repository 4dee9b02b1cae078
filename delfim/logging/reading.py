"""Reading log files, on any computer: the writers need Linux, the readers do not."""

import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

import msgspec

from delfim.errors import FormatError
from delfim.outside import parse_json, read_file

LOG_BYTES: Final = 1 << 27  # of a log that is read, inflated or not: a larger one was made to exhaust memory
STEP: Final = 1 << 12  # bytes of a member that are inflated at a time
MOMENT_MAX_S: Final = 1e10  # of a clock


class Member(NamedTuple):
    """The readable part of a gzip member."""

    content: bytes
    end: int  # where the next one begins, or the damage of this one
    trouble: str  # "": whole; "cut", "damaged"


def raw(path: str | Path) -> bytes:
    """A file of a log as it is. Raises OSError."""
    return read_file(path, LOG_BYTES)


def member(data: bytes, at: int, before: int = 0) -> Member:
    """The gzip member that begins there, up to its end or its damage: in large steps, then byte by byte. `before` is the
    content of the members before it."""
    stream, content, step = zlib.decompressobj(wbits=31), bytearray(), STEP
    content_max = LOG_BYTES - before
    while at < len(data):
        untouched = stream.copy()
        try:
            content += stream.decompress(data[at : at + step], content_max - len(content) + 1)
        except zlib.error:
            if step == 1:
                return Member(bytes(content), at, "damaged")
            stream, step = untouched, 1
            continue
        if len(content) > content_max:
            return Member(bytes(content), at, "damaged")
        at += min(step, len(data) - at) - len(stream.unused_data)
        if stream.eof:
            return Member(bytes(content), at, "")
    return Member(bytes(content), at, "cut")


def read_log(path: str | Path) -> tuple[bytes, str]:
    """The content of a log file, deflated or not, and its damage in words; empty if there is none. Raises OSError.

    A file that a power cut left without its end gives everything up to the last flush.
    """
    data = raw(path)
    if data[:2] != b"\x1f\x8b":
        return data, ""
    parts, size, at = [], 0, 0
    while at < len(data):
        content, at, trouble = member(data, at, size)
        parts.append(content)
        size += len(content)
        if trouble:
            return b"".join(parts), f"{path}: {trouble} after {size} bytes of content"
    return b"".join(parts), ""


Degrees = Annotated[float, msgspec.Meta(ge=0.0, le=360.0)]
Count = Annotated[float, msgspec.Meta(ge=0.0, le=1e6)]


class LoggedVessel(msgspec.Struct):
    """Another vessel, as a sidecar has it (docs/log-format.md)."""

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


def read_events(path: str | Path) -> Iterator[dict[str, Any]]:
    """The events of a sidecar, a line each; unreadable lines are left out: the power may have failed in the middle of one.
    Raises OSError."""
    for line in raw(path).splitlines():
        try:
            told = parse_json(line)
        except FormatError:
            continue
        if isinstance(told, dict) and _is_event(told):
            yield told


def _is_event(told: dict[str, Any]) -> bool:
    """Whether it has its time and name, and known fields only of the types that readers understand."""
    moments = [told[key] for key in ("monotonic_s", "at_s") if key in told]
    words = [told.get("event")] + [told[key] for key in ("refused",) if key in told]
    if not all(isinstance(word, str) for word in words):
        return False
    if not all(isinstance(moment, int | float) and abs(moment) < MOMENT_MAX_S for moment in moments):
        return False
    if told["event"] == "command":
        value = told.get("value")
        if not isinstance(value, dict) or not isinstance(value.get("command"), str) or "refused" not in told:
            return False
    if told["event"] == "vessels" and not _are_vessels(told.get("value")):
        return False
    return type(told.get("t_ns")) is int and 0 <= told["t_ns"] < 1 << 63


def _are_vessels(value: object) -> bool:
    try:
        msgspec.convert(value, list[LoggedVessel])
    except msgspec.ValidationError:
        return False
    return True


def in_order(paths: Iterable[Path]) -> list[Path]:
    """Log files in the order in which they were made; plain sorting puts hhmmss-1 before hhmmss."""

    def key(path: Path) -> tuple[str, str, int]:
        time_, _, number = path.name.partition(".")[0].partition("-")
        return path.parts[-3] if len(path.parts) > 2 else "", time_, int(number) if number.isdecimal() else 0

    return sorted(paths, key=key)
