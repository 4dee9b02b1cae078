"""candump's filters and texts: which frames to show, and how a frame looks on a terminal or in a log.

    can0,123:7FF,400~700,#FFFFFFFF      interface, then filters: match, match not, error frames of these classes

Not supported: CAN FD, colours, binary and swapped data. Facts from can-utils (candump.c, lib.c).
"""

import re
import time
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from delfim.base.errors import DelfimError, FormatError
from delfim.base.frames import CAN_ERR, CAN_IDE, CAN_RTR, Frame, identifier, to_can_id
from delfim.logging.candump import parse_line

_ERR, _EFF = 1 << 29, 1 << 31  # linux/can.h
_TERM: Final = re.compile(r"([0-9A-Fa-f]{1,8})([:~])([0-9A-Fa-f]{1,8})")
_ERRORS: Final = re.compile(r"#([0-9A-Fa-f]{1,8})")


class Filter(NamedTuple):
    """Which frames pass: those that one of the terms lets through (all of them, where they are joined)."""

    terms: tuple[tuple[int, int, bool], ...] = ()  # can_id, mask, whether it is to differ
    joined: bool = False
    errors: int = 0  # classes of error frames

    def passes(self, frame: Frame) -> bool:
        number = to_can_id(frame.arb)
        if number & _ERR:
            return bool(number & self.errors)
        verdicts = [bool((number ^ can_id) & mask) == differs for can_id, mask, differs in self.terms]
        return (all(verdicts) if self.joined else any(verdicts)) if verdicts else True


def parse_filter(text: str) -> tuple[str, Filter]:
    """Interface and filter of "can0,123:7FF". Raises FormatError."""
    interface, *parts = text.split(",")
    terms, joined, errors = [], False, 0
    for part in parts:
        if match := _TERM.fullmatch(part):
            number, mask = int(match[1], 16), int(match[3], 16) & ~_ERR
            terms.append((number | (_EFF if len(match[1]) == 8 else 0), mask, match[2] == "~"))
        elif match := _ERRORS.fullmatch(part):
            errors = int(match[1], 16) & 0x1FFFFFFF
        elif part in ("j", "J"):
            joined = True
        else:
            raise FormatError(f"not a filter: {part!r}; write ID:MASK, ID~MASK, #ERRORMASK or j, all hexadecimal")
    return interface, Filter(tuple(terms), joined, errors)


def parse_frame(text: str) -> Frame:
    """The frame in cansend's notation: 123#11.22, 12345678#, 123#R4. Raises FormatError."""
    number, sign, data = text.partition("#")
    if any(character.isspace() for character in text) or "_" in data:
        raise FormatError(f"not a frame: {text!r}; write ID#DATA, as 123#11223344 or 123#R4")
    try:
        return parse_line(f"(0.000000) - {number}{sign}{data.replace('.', '')}")[1]._replace(t_ns=0)
    except FormatError:
        raise FormatError(f"not a frame: {text!r}; write ID#DATA, as 123#11223344 or 123#R4") from None


class Stamps:
    """candump's -t: "a" absolute, "d" since the frame before, "z" since the first frame, "A" with the date, "" none."""

    def __init__(self, kind: str) -> None:
        self._kind, self._since_ns = kind, 0

    def text(self, t_ns: int) -> str:
        if self._kind == "a":
            return f"({t_ns // 1_000_000_000:010}.{t_ns // 1000 % 1_000_000:06}) "
        if self._kind == "A":
            day = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(t_ns // 1_000_000_000))
            return f"({day}.{t_ns // 1000 % 1_000_000:06}) "
        if not self._kind:
            return ""
        self._since_ns = self._since_ns or t_ns
        passed_us = max(t_ns // 1000 - self._since_ns // 1000, 0)
        if self._kind == "d":
            self._since_ns = t_ns
        return f"({passed_us // 1_000_000:03}.{passed_us % 1_000_000:06}) "


def long_text(frame: Frame, *, wide: bool, ascii_too: bool) -> str:
    """Identifier, length and data as on a terminal; `wide`: standard identifiers are indented below extended ones."""
    number, length = to_can_id(frame.arb), len(frame.data)
    if frame.arb & CAN_ERR:
        name = f"{number & 0x1FFFFFFF | _ERR:08X}"
    else:
        name = f"{identifier(frame.arb):08X}" if frame.arb & CAN_IDE else f"{identifier(frame.arb):03X}".rjust(8 if wide else 3)
    if frame.arb & CAN_RTR:
        return f"{name}   [{length}]  remote request"
    text = f"{name}   [{length}] " + "".join(f" {byte:02X}" for byte in frame.data)
    if frame.arb & CAN_ERR:
        return text + "ERRORFRAME".rjust(3 * (8 - length) + 13)
    if ascii_too:
        letters = "".join(chr(byte) if 0x1F < byte < 0x7F else "." for byte in frame.data)
        return text + "'".rjust(3 * (8 - length) + 4) + letters + "'"
    return text


def decoder(file: str) -> Callable[[Frame], str]:
    """Describes a frame by a CAN database; "" if it is not in there. Raises DelfimError."""
    import cantools  # of the extra "ground": a boat does without

    try:
        database: Any = cantools.database.load_file(file)
    except (OSError, ValueError, cantools.Error) as error:
        raise DelfimError(f"{file}: {error}") from None
    messages: dict[tuple[bool, int], Any] = {(each.is_extended_frame, each.frame_id): each for each in database.messages}

    def decoded(frame: Frame) -> str:
        message = messages.get((frame.extended, identifier(frame.arb)))
        if message is None or frame.arb & (CAN_RTR | CAN_ERR):
            return ""
        try:
            values = message.decode(frame.data)
        except (ValueError, KeyError, cantools.Error) as error:
            return f"{message.name}: {error}"
        units = {signal.name: signal.unit for signal in message.signals}
        return " ".join([message.name, *(_signal(name, value, units[name]) for name, value in values.items())])

    return decoded


def _signal(name: str, value: object, unit: str | None) -> str:
    if not isinstance(value, int | float):
        return f"{name}={value}"
    return f"{name}={value:.10g}{unit or ''}"
