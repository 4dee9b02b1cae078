"""A rule of the auditor, and its findings."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

from delfim.audit.evidence import Evidence


class Finding(NamedTuple):
    """A promise that was broken: when (time since boot), and how."""

    t_s: float
    words: str


class Rule(NamedTuple):
    """A check: its name, what must hold, and the document that promises it."""

    name: str
    sentence: str
    source: str
    check: Callable[[Evidence], Iterator[Finding]]  # raises Unjudged where the log does not have what it needs
