"""Reads the system log, on any computer."""

import contextlib
import logging
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from typing import Any, Final

from delfim.base.errors import FormatError, one_line
from delfim.base.input.untrusted import parse_json
from delfim.logging.ashore.tree import Run, Span
from delfim.logging.reading import read_lines

LEVELS: Final = {name: getattr(logging, name.upper()) for name in ("debug", "info", "warning", "error", "critical")}


def texts(runs: Iterable[Run], span: Span, level: str) -> Iterator[str]:
    """The lines of this level and worse, for people. Within a run they are in the order of the monotonic clock: the wall clock
    may have been set meanwhile. Lines that are damaged are left out. Raises OSError."""
    for run in runs:
        told = []
        for file in run.files:
            for line in read_lines(file.path):
                with contextlib.suppress(FormatError, LookupError, TypeError, ValueError, OverflowError):
                    found = parse_json(line)
                    if span.has(found["t_ns"]) and LEVELS[found["level"]] >= LEVELS[level]:
                        told.append((float(found["monotonic_s"]), as_text(found)))
        yield from (text for _, text in sorted(told, key=lambda each: each[0]))


def as_text(told: Mapping[str, Any]) -> str:
    """Format a line for people; `told` is one of the log, parsed. Raises LookupError, TypeError, ValueError for anything
    else."""
    at = datetime.fromtimestamp(told["t_ns"] // 10**9, UTC)
    micros = told["t_ns"] // 1000 % 10**6
    return one_line(f"{at:%Y-%m-%d %H:%M:%S}.{micros:06} {told['level']:8} {told['service']}[{told['pid']}]: {told['text']}")
