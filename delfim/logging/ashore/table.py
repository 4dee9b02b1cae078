"""State logs as columns of numbers, and the black box as frames, both between two times. Needs numpy.

Columns are numpy arrays of shape (records,), by field name, in the order of the files. Where a file lacks a field that another
one has, floating-point columns hold NaN and integers become floating-point.
"""

import heapq
import logging
import time
from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from delfim.base.errors import DelfimError, FormatError
from delfim.base.frames import Frame
from delfim.logging.ashore.tree import ALWAYS, LogFile, Span, is_running
from delfim.logging.candump import parse_line
from delfim.logging.reading import read_lines, read_log
from delfim.logging.statelog import Schema

if TYPE_CHECKING:
    from numpy.typing import NDArray

TIME: Final = "t1"  # the column of a record's time: navigation readable, wall clock, ns

logger = logging.getLogger(__name__)


class Columns(dict[str, "NDArray[Any]"]):
    """Columns by the names of their fields. A field that no file has is refused in words."""

    def __missing__(self, name: str) -> "NDArray[Any]":
        raise FormatError(f"these state logs have no field {name}")


def table(files: Iterable[LogFile], span: Span = ALWAYS) -> tuple[Columns, Schema]:
    """The records of state logs in this time, and the schema of the newest file. Damage to a file is logged.

    Raises DelfimError if there is no record at all.
    """
    import numpy as np

    parts: list[NDArray[Any]] = []
    newest: Schema | None = None
    for file in files:
        part = _part(file)
        if part is not None:
            newest, records = part
            if TIME in (records.dtype.names or ()):
                records = records[(records[TIME] >= span.from_ns) & (records[TIME] <= span.to_ns)]
            parts.append(records)
    if newest is None or not sum(map(len, parts)):
        raise DelfimError("no state was logged in this time")
    names = dict.fromkeys(name for part in parts for name in part.dtype.names or ())
    return Columns((name, np.concatenate([_column(part, name) for part in parts])) for name in names), newest


def units(schema: Schema) -> Mapping[str, str]:
    """The unit of each field, by name."""
    return {name: unit for name, _, unit, _ in schema.rows}


def frames(files: Iterable[LogFile], span: Span = ALWAYS) -> Iterator[tuple[str, Frame]]:
    """The frames of black boxes in this time with the names of their devices, those of several buses merged by time."""
    by_id: dict[str, list[LogFile]] = {}
    for file in files:
        by_id.setdefault(file.id, []).append(file)
    return heapq.merge(*(_frames(its, span) for its in by_id.values()), key=lambda each: each[1].t_ns)


def lines(files: Iterable[LogFile], span: Span = ALWAYS) -> Iterator[str]:
    """The lines of black boxes in this time, bus after bus, as they were written."""
    low, high = (f"{t_ns // 1000:016}" for t_ns in span)  # stamps have microseconds
    for file in files:
        for each in read_lines(file.path, partial(_complain, file)):
            line = each.decode("ascii", "replace")
            if low <= line[1:18].replace(".", "").zfill(16) <= high:
                yield line + "\n"


def _part(file: LogFile) -> tuple[Schema, "NDArray[Any]"] | None:
    import numpy as np

    content, complaint = read_log(file.path)
    try:
        schema, start = Schema.parse(content)
    except FormatError as error:
        logger.warning("left out: %s: %s", file.path, error)
        return None
    _complain(file, complaint)
    whole = (len(content) - start) // schema.struct.size
    kind = np.dtype([(name, "<" + code) for name, code, _, _ in schema.rows])
    return schema, np.frombuffer(content, kind, whole, start)


def _column(part: "NDArray[Any]", name: str) -> "NDArray[Any]":
    import numpy as np

    if name in (part.dtype.names or ()):
        return part[name]
    return np.full(len(part), np.nan)


def _frames(files: Iterable[LogFile], span: Span) -> Iterator[tuple[str, Frame]]:
    wrong = 0
    for line in lines(files, span):
        try:
            yield parse_line(line)
        except FormatError:
            wrong += 1
    if wrong:
        logger.warning("%d lines of the black box are not frames and were left out", wrong)


def _complain(file: LogFile, complaint: str) -> None:
    if complaint and not is_running(file, time.time_ns()):  # a file being written has no end yet
        logger.warning("%s (delfim log repair puts it right)", complaint)
