"""The lines between the boat and a payload program: what it is told, and what it may say and order, within bounds."""

import math
import re
from collections.abc import Iterator
from typing import Final

import msgspec

from delfim.base.errors import FormatError
from delfim.base.input.unreadable import UNREADABLE
from delfim.vehicle import console
from delfim.vehicle.orders.entrusting import RIGHTS
from delfim.vehicle.report import BoatReport

LINE_BYTES: Final = 1024  # longer lines of values are refused
ORDER_BYTES: Final = 16_384  # the same of orders, of which a mission is the longest
VALUES: Final = 16  # names of one program
TEXT: Final = 64  # characters of a value that is text
NUMBER_MAX: Final = 1e15
REASON: Final = 200  # characters of a reason that is told
ORDERS: Final = 5.0, 10  # orders a second in the long run, and at once
SIGHTS: Final = 20.0, 40  # the same of vessels that it sees
_ORDER: Final = re.compile(rb'"command"\s*:(?:\s*"([a-z]{1,16})")?')  # in a text its quotation marks would be escaped
_NAME: Final = re.compile("[A-Za-z][A-Za-z0-9_]{0,31}")

Value = bool | int | float | str | None
_decode: Final = msgspec.json.Decoder(dict[str, Value]).decode
_encode: Final = msgspec.json.Encoder().encode


# What it is told.


def lines(now: BoatReport, before: BoatReport | None) -> Iterator[bytes]:
    """The lines that programs get of a state: events since the one before, then navigation as the guest gets it, with the
    mission, the leg and the line of a survey."""
    if before is None or (now.mode, now.helmsman) != (before.mode, before.helmsman):
        yield _line({"event": "mode", "mode": now.mode, "helmsman": now.helmsman, "reason": now.reason[:REASON]})
    if before is not None and (now.mission, now.reference.leg) != (before.mission, before.reference.leg):
        yield _line({"event": "leg", "mission": now.mission, "leg": now.reference.leg})
    if before is not None and now.reference.line != before.reference.line:
        yield _line({"event": "line", "mission": now.mission, "line": now.reference.line})
    heard = max((each.number for each in before.announced), default=0) if before is not None else 0
    for action in now.announced if before is not None else ():
        if action.number > heard:
            yield _line({"event": "action", "command": action.command, "params": action.params})
    if now.sample.number and (before is None or now.sample.number != before.sample.number):
        number, leg, attempt, tries = msgspec.structs.astuple(now.sample)
        asked = {"event": "sample", "mission": now.mission, "leg": leg, "number": number, "try": attempt, "tries": tries}
        yield _line(asked)
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
            "helmsman": now.helmsman,
            "mission": now.mission,
            "leg": now.reference.leg,
            "line": now.reference.line,
        }
    )


def answered(word: str, refused: str | None) -> bytes:
    """The answer to an order of a program."""
    return _line({"event": "answer", "command": word, "ok": refused is None, "reason": (refused or "")[:REASON]})


def _line(what: dict[str, object]) -> bytes:
    return _encode(what) + b"\n"


# What it says.


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


def word_of(line: bytes) -> str | None:
    """The word of the order in a line of a program, empty where it has none; None: the line is not meant as an order."""
    found = _ORDER.search(line)
    return None if found is None else (found[1] or b"").decode()


def ordered(line: bytes) -> console.Commands:
    """The order in a line of a program, in the words of the console. Raises FormatError in words."""
    if len(line) > ORDER_BYTES:
        raise FormatError(f"an order is a line of up to {ORDER_BYTES} bytes")
    command = console.parse(line)
    if type(command) not in RIGHTS and not isinstance(command, console.Alive):
        raise FormatError(f"{command.__struct_config__.tag} is for operators alone")
    if isinstance(command, console.Goto) and command.end is None:  # the vehicle's file may say idle, which is for operators
        return msgspec.structs.replace(command, end="hold")
    return command


class Budget:
    """So many a second in the long run, and so many at once."""

    def __init__(self, per_s: float, burst: int) -> None:
        self._per_s, self._burst = per_s, burst
        self._left, self._at_s = float(burst), -math.inf

    def grant(self, asked: int, now_s: float) -> int:
        """How many of those asked for are granted."""
        self._left = min(self._left + (now_s - self._at_s) * self._per_s, self._burst)
        self._at_s = now_s
        granted = min(asked, int(self._left))
        self._left -= granted
        return granted


class OrderBudget:
    """How often a program may order. Who sees much can still steer: vessels have a budget of their own."""

    def __init__(self) -> None:
        self._orders, self._sights = Budget(*ORDERS), Budget(*SIGHTS)

    def exceeded(self, command: console.Commands, now_s: float) -> str:
        """Why this is too often, in words; empty: it is not."""
        if isinstance(command, console.Sight):
            return "" if self._sights.grant(1, now_s) else f"more than {SIGHTS[0]:.0f} vessels a second"
        return "" if self._orders.grant(1, now_s) else f"more than {ORDERS[0]:.0f} orders a second"


class BoundedLines:
    """Whole lines out of a stream, within a budget; the others are counted. A line that is longer than `most` bytes is cut to
    one byte more."""

    def __init__(self, per_s: float, burst: int, most: int = LINE_BYTES) -> None:
        self._budget, self._most = Budget(per_s, burst), most
        self._rest = b""
        self.dropped = 0

    def feed(self, data: bytes, now_s: float) -> list[bytes]:
        """The lines that are let through."""
        *found, rest = (self._rest + data).split(b"\n")
        self._rest = rest[: self._most + 1]
        granted = self._budget.grant(len(found), now_s)
        self.dropped += len(found) - granted
        return [line[: self._most + 1] for line in found[:granted]]
