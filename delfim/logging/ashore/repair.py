"""Repairs log files after a power cut, for readers that need whole files. Nothing that was flushed is lost, nothing made up.

A file keeps, byte by byte, every gzip member that is whole. What was flushed of a cut or damaged one follows as a member of
its own, up to its last whole record, and so does the data behind the damage. The original stays, unless told otherwise.
"""

import os
import zlib
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.base.wholefile import replace_file
from delfim.logging.ashore.tree import LogFile
from delfim.logging.candump import parse_line
from delfim.logging.reading import LOG_BYTES, Inflating, member, raw
from delfim.logging.statelog import Schema

MEMBER: Final = b"\x1f\x8b\x08" + bytes(5)  # how a member of ours begins: no name, no time


class Repair(NamedTuple):
    path: str
    complaint: str  # the damage in words; empty if there is none
    target: str  # where the whole file is now; empty where none was needed


class GzipPiece(NamedTuple):
    """A part of a gzip file: a whole member, the readable part of another, or unreadable bytes."""

    raw: bytes
    content: bytes  # of one that is not whole: what was flushed
    trouble: str  # empty: a whole member


def repair(file: LogFile, *, in_place: bool = False) -> list[Repair]:
    """Check a log file and its sidecar and make them whole where they are not: beside the original, as hhmmss-repaired.suffix,
    or in its place. Raises OSError."""
    results = []
    for path in (file.path, file.sidecar):
        if not path:
            continue
        data = raw(path)
        whole, complaint = mended(data, ".jsonl" if path == file.sidecar else file.suffix)
        target = ""
        if complaint:
            target = path if in_place else _beside(path)
            like = os.stat(path)
            replace_file(target, whole, (like.st_atime_ns, like.st_mtime_ns))
        results.append(Repair(path, complaint, target))
    return results


def mended(data: bytes, suffix: str) -> tuple[bytes, str]:
    """Make a log file's bytes whole; returns them and their damage in words, empty if there was none."""
    if not suffix.endswith(".gz"):
        kept = _records(suffix)(data)
        return kept, "" if kept == data else f"{len(data) - len(kept)} bytes at its end are an incomplete record"
    trim = _records(suffix.removesuffix(".gz"))
    parts, troubles = [], []
    for piece in pieces(data):
        if not piece.trouble:
            trim(piece.content)  # the first one tells how long a record is
            parts.append(piece.raw)
            continue
        troubles.append(piece.trouble)
        if kept := trim(piece.content):
            parts.append(_deflated(kept))
    if not data:
        troubles.append("empty")
    return b"".join(parts) or _deflated(b""), "; ".join(troubles)


def pieces(data: bytes) -> Iterator[GzipPiece]:
    """Cut a gzip file into pieces, in order. Whole members are verified by their checksums."""
    at = 0
    while at < len(data):
        content, end, how = member(data, at)
        if not how:
            yield GzipPiece(data[at:end], content, "")
        else:
            following = data.find(MEMBER, at + 1)
            end, how = (following, "damaged") if following >= 0 else (len(data), how)
            if end < len(data):  # data beyond the next one's head is not its content
                content, _, _ = member(data[at:end], 0)
            yield GzipPiece(data[at:end], content, f"{how} after {len(content)} bytes of the member at {at}")
        at = end


def condition(data: bytes) -> str:
    """The condition of a gzip file as `pieces` finds it: "damaged", "cut", or "" for whole. No more of its content than a piece
    is kept."""
    size, at = 0, 0
    while at < len(data):
        its = Inflating(data, at, LOG_BYTES - size)
        size += sum(map(len, its))
        if its.trouble:
            return "damaged" if data.find(MEMBER, at + 1) >= 0 else its.trouble
        at = its.end
    return ""


def _records(suffix: str) -> Callable[[bytes], bytes]:
    """Make a function that keeps the whole records of its input, called with one part of a file after the other."""
    if suffix != ".state":
        return _frames if suffix == ".log" else _lines
    size = 0

    def records(content: bytes) -> bytes:
        nonlocal size
        start = 0
        if not size:
            try:
                schema, start = Schema.parse(content)
            except FormatError:
                return b""
            size = schema.struct.size
        return content[: len(content) - (len(content) - start) % size]

    return records


def _frames(content: bytes) -> bytes:
    """Keep the whole lines of candump. Just before a damage some may be garbled; they are dropped."""
    return b"".join(line for line in content.splitlines(keepends=True) if _is_frame(line))


def _is_frame(line: bytes) -> bool:
    try:
        parse_line(line.decode())
    except (FormatError, UnicodeDecodeError):
        return False
    return line.endswith(b"\n")


def _lines(content: bytes) -> bytes:
    return content[: content.rfind(b"\n") + 1]


def _deflated(content: bytes) -> bytes:
    stream = zlib.compressobj(wbits=31)
    return stream.compress(content) + stream.flush()


def _beside(path: str) -> str:
    folder, name = os.path.split(path)
    stem, dot, suffix = name.partition(".")
    return os.path.join(folder, f"{stem.removesuffix('-repaired')}-repaired{dot}{suffix}")
