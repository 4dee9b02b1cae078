"""The records of each input of the loop in the logs of a day at sea, by time (`rerun.py` repeats them)."""

import heapq
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import Any, Final, NamedTuple

from delfim.base.errors import DelfimError
from delfim.base.frames import Frame
from delfim.logging.ashore.table import frames
from delfim.logging.ashore.tree import LogFile
from delfim.logging.linelog import SUFFIX, pieces

TICK_S: Final = 0.1  # of the watchdog; checks without a recorded time are put in between
NEVER_S: Final = -1e8
SILENT_MAX_S: Final = 3.0 * 3600.0  # without a record, in all


class BusInput(NamedTuple):
    """A frame of a bus, or the data of one read of a serial line."""

    name: str  # of the bus or line, as in its log's name
    t_ns: int
    what: Frame | bytes


class Due(NamedTuple):
    """A recorded event of the loop."""

    t_ns: int
    kind: str  # "command", "navigation", "watchdog", "guess"
    at_s: float  # monotonic
    what: Any = None
    source: int = 0  # of a cycle: its place in `navigation.sources`
    sent: tuple[tuple[int, str, float], ...] = ()  # of a cycle: thrusters by their rows, "command" or "angle", and its value
    heard_ns: int = 0  # of a cycle: stamp of its message, after `t_ns` where a busy machine let a line wait to be read


class GuestReference(NamedTuple):
    """The guest's set point; NaN before its first."""

    heading_rad: float
    speed_mps: float


class Contact(NamedTuple):
    """A message of the console, the guest, or a payload program."""

    at_s: float  # monotonic
    key: str  # of the state: "console_s", "guest_s"; of the log: "payload_NAME_s"
    asked: GuestReference | None  # None: from the console


def heard(boxes: Sequence[LogFile], files: Sequence[LogFile]) -> Iterator[BusInput]:
    """Read all entries of the black boxes of buses and lines, by time."""
    of_buses = (BusInput(name, frame.t_ns, frame) for name, frame in frames(boxes))
    of_lines = (BusInput(*piece) for piece in pieces(file for file in files if file.suffix.startswith(SUFFIX)))
    return heapq.merge(of_buses, sorted(of_lines, key=_when), key=_when)


def _when(heard: BusInput) -> int:
    return heard.t_ns


def cycles(columns: Any, rows: Sequence[tuple[int, str]]) -> Iterator[Due]:
    """Read the cycles. `rows`: the thrusters, by place in the vehicle's file and name, whose commands are taken from the
    records."""
    told = [
        (index, what, columns[f"{name}_{what}"].tolist())
        for index, name in rows
        for what in ("command", "angle")
        if f"{name}_{what}" in columns
    ]
    moments = (columns[key].tolist() for key in ("t1", "monotonic_s", "t0"))
    for i, (t1, at_s, t0, asked, source) in enumerate(zip(*moments, _asked(columns), _sources(columns), strict=True)):
        yield Due(t1, "navigation", at_s, asked, source, tuple((index, what, values[i]) for index, what, values in told), t0)


def first_ns(columns: Any) -> dict[int, int]:
    """The stamp of the first message of each source."""
    return dict(reversed(list(zip(_sources(columns), columns["t0"].tolist(), strict=True))))


def _sources(columns: Any) -> list[int]:
    """The source of each cycle; the log of a boat with one source does not name it."""
    return columns["source"].tolist() if "source" in columns else [0] * len(columns["t1"])


def _asked(columns: Any) -> Iterator[GuestReference]:
    return map(GuestReference, columns["guest_heading"].tolist(), columns["guest_speed"].tolist())


def words_of(columns: Any) -> Iterator[Contact]:
    """The times when a console, a guest, or a payload program was heard, with the guest's set point in the following cycle."""
    payloads = (name for name in columns if name.startswith("payload_") and name.endswith("_s"))
    for key in ("console_s", "guest_s", *payloads):
        before_s = NEVER_S
        for at_s, asked in zip(columns[key].tolist(), _asked(columns), strict=True):
            if at_s > before_s:
                yield Contact(at_s, key, asked if key == "guest_s" else None)
            before_s = at_s


def commands(told: Iterable[dict[str, Any]]) -> Iterator[Due]:
    for event in told:
        if event["event"] == "command":
            yield Due(_wall_ns(event), "command", event["at_s"], event)


def looks(columns: Any, told: Iterable[dict[str, Any]]) -> Iterator[Due]:
    """The checks of the watchdog: those with a recorded time, and between them those that must have happened."""
    events = {event["at_s"]: event for event in told if event["event"] == "watchdog"}
    known = {at_s: _wall_ns(event) for at_s, event in events.items()}
    for t1, now_s, at_s in zip(*(columns[key].tolist() for key in ("t1", "monotonic_s", "watchdog_s")), strict=True):
        known.setdefault(at_s, t1 - round((now_s - at_s) * 1e9))
    times = sorted(at_s for at_s in known if at_s > NEVER_S)
    silent_s = sum(gap_s for a, b in pairwise(times) if (gap_s := b - a) > 10.0 * TICK_S)
    if silent_s > SILENT_MAX_S:
        raise DelfimError(f"the logs do not cover {silent_s / 3600.0:.3g} hours of this run: it cannot be repeated")
    for i, at_s in enumerate(times):
        yield Due(known[at_s], "watchdog", at_s, events.get(at_s))
        between = round((times[i + 1] - at_s) / TICK_S) if i + 1 < len(times) else 0
        for k in range(1, between):
            later_s = k * (times[i + 1] - at_s) / between
            yield Due(known[at_s] + round(later_s * 1e9), "guess", at_s + later_s)


def _wall_ns(event: dict[str, Any]) -> int:
    at_ns: int = event["t_ns"] - round((event["monotonic_s"] - event["at_s"]) * 1e9)
    return at_ns
