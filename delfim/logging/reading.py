"""Reading log files, on any computer: the writers need Linux, those who look at logs afterwards do not."""

import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

from delfim.errors import FormatError
from delfim.outside import parse_json, read_file

LOG_BYTES: Final = 1 << 27  # of a log that is read, inflated or not: what is larger was made to fill a memory
STEP: Final = 1 << 12  # bytes of a member that are inflated at a time
MOMENT_MAX_S: Final = 1e10  # of a clock


class Member(NamedTuple):
    """What can be read of a part of a gzip file."""

    content: bytes
    end: int  # where the next one begins, or this one makes no sense any more
    trouble: str  # "": whole; "cut", "damaged"


def raw(path: str | Path) -> bytes:
    """A file of a log as it is. Raises OSError."""
    return read_file(path, LOG_BYTES)


def member(data: bytes, at: int, before: int = 0) -> Member:
    """The gzip member that begins there, up to its end or its damage: in large steps, then byte by byte. `before` is what the
    members before it held."""
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
    """What a log file holds, deflated or not, and what is wrong with it, in words; empty when nothing is. Raises OSError.

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


def read_events(path: str | Path) -> Iterator[dict[str, Any]]:
    """What a sidecar tells, a line each; lines that mean nothing are left out: the power may have gone in the middle of one.
    Raises OSError."""
    for line in raw(path).splitlines():
        try:
            told = parse_json(line)
        except FormatError:
            continue
        if isinstance(told, dict) and _is_event(told):
            yield told


def _is_event(told: dict[str, Any]) -> bool:
    """Whether it has its time and name, and of what is known only what its readers understand."""
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
    return type(told.get("t_ns")) is int and 0 <= told["t_ns"] < 1 << 63


def in_order(paths: Iterable[Path]) -> list[Path]:
    """Log files in the order in which they were made; plain sorting puts hhmmss-1 before hhmmss."""

    def key(path: Path) -> tuple[str, str, int]:
        time_, _, number = path.name.partition(".")[0].partition("-")
        return path.parts[-3] if len(path.parts) > 2 else "", time_, int(number) if number.isdecimal() else 0

    return sorted(paths, key=key)
