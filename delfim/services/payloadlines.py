"""The lines between the boat and a payload program: what it is told, and what it may say, within bounds."""

import math
import re
from collections.abc import Iterator
from typing import Final

import msgspec

from delfim.outside import UNREADABLE
from delfim.services.web.api import State

LINE_BYTES: Final = 1024  # longer lines are refused
VALUES: Final = 16  # names of one program
TEXT: Final = 64  # characters of a value that is text
NUMBER_MAX: Final = 1e15
REASON: Final = 200  # characters of a reason that is told
_NAME: Final = re.compile("[A-Za-z][A-Za-z0-9_]{0,31}")

Value = bool | int | float | str | None
_decode: Final = msgspec.json.Decoder(dict[str, Value]).decode
_encode: Final = msgspec.json.Encoder().encode


def lines(now: State, before: State | None) -> Iterator[bytes]:
    """The lines that programs get of a state: events since the one before, then navigation as the guest gets it, with the
    mission and the leg."""
    if before is None or now.mode != before.mode:
        yield _line({"event": "mode", "mode": now.mode, "reason": now.reason[:REASON]})
    if before is not None and (now.mission, now.reference.leg) != (before.mission, before.reference.leg):
        yield _line({"event": "leg", "mission": now.mission, "leg": now.reference.leg})
    heard = max((each.number for each in before.announced), default=0) if before is not None else 0
    for action in now.announced if before is not None else ():
        if action.number > heard:
            yield _line({"event": "action", "command": action.command, "params": action.params})
    if before is not None and now.cycle == before.cycle:
        return
    north_mps = east_mps = None
    if now.speed_mps is not None and now.course_deg is not None:
        course = math.radians(now.course_deg)
        north_mps, east_mps = round(now.speed_mps * math.cos(course), 3), round(now.speed_mps * math.sin(course), 3)
    yield _line(
        {
            "utc_ns": now.utc_ns,
            "latitude_deg": now.latitude_deg,
            "longitude_deg": now.longitude_deg,
            "heading_deg": now.heading_deg,
            "north_mps": north_mps,
            "east_mps": east_mps,
            "mode": now.mode,
            "mission": now.mission,
            "leg": now.reference.leg,
        }
    )


def _line(what: dict[str, object]) -> bytes:
    return _encode(what) + b"\n"


def values(line: bytes) -> dict[str, Value] | None:
    """The values in a line of a program; None if it is not one object of a few bounded values with names."""
    try:
        found = _decode(line if len(line) <= LINE_BYTES else b"")
    except UNREADABLE:
        return None
    fit = 0 < len(found) <= VALUES and all(_NAME.fullmatch(name) and _fits(value) for name, value in found.items())
    return found if fit else None


def _fits(value: Value) -> bool:
    if isinstance(value, str):
        return len(value) <= TEXT and value.isprintable()
    return value is None or abs(value) <= NUMBER_MAX  # not a number is never smaller


class BoundedLines:
    """Whole lines out of a stream: `burst` at once, `per_s` in the long run; the others are counted. A line that is longer than
    LINE_BYTES is cut to one byte more."""

    def __init__(self, per_s: float, burst: int) -> None:
        self._per_s, self._burst = per_s, burst
        self._left, self._at_s = float(burst), -math.inf
        self._rest = b""
        self.dropped = 0

    def feed(self, data: bytes, now_s: float) -> list[bytes]:
        """The lines that are let through."""
        *found, rest = (self._rest + data).split(b"\n")
        self._rest = rest[: LINE_BYTES + 1]
        self._left = min(self._left + (now_s - self._at_s) * self._per_s, self._burst)
        self._at_s = now_s
        taken = found[: int(self._left)]
        self._left -= len(taken)
        self.dropped += len(found) - len(taken)
        return [line[: LINE_BYTES + 1] for line in taken]
