"""slcan over TCP: the text protocol of serial CAN adapters (Lawicel's CANUSB), for programs without another one.

    client  O             \\r   open                        server  \\r
    client  t12321122     \\r   send 123 with 11 22         server  \\r, or \\a for an unknown line
    server  T1FFFFFFF0    \\r   an extended frame without data

The same text in, actions out as in delfim.canproxy.socketcand, whose actions these are. A connection has the one bus that its
port stands for. Bit rates are the vehicle's: they are accepted and ignored. No remote frames, CAN FD or time stamps.
"""

from collections.abc import Iterator
from typing import Final

from delfim.base.errors import FormatError
from delfim.base.frames import CAN_IDE, Frame, extended, standard
from delfim.canproxy.socketcand import Action, Close, Enter, Mode, Open, Reply, Transmit

LINE_BYTES: Final = 32  # the longest line that means something, T and 26 digits, is shorter
DONE: Final = b"\r"
REFUSED: Final = b"\a"
VERSION: Final = b"V1013\r"
SERIAL: Final = b"NDELF\r"
STATUS: Final = b"F00\r"
_TOLD: Final = {"V": VERSION, "N": SERIAL, "F": STATUS}
_IGNORED: Final = frozenset("SsMmXUQWZ")  # bit rate, filters, automatic polling, start, stamps off


def raw_text(frame: Frame) -> bytes:
    """The text of a data frame, with its end."""
    arb, data = frame.arb, frame.data
    head = f"T{arb >> 3:08X}" if arb & CAN_IDE else f"t{arb >> 21:03X}"
    return f"{head}{len(data)}{data.hex().upper()}\r".encode()


class SlcanSession:
    """One connection as the server sees it, to the bus of this name."""

    greeting, accepted, refused = b"", b"", REFUSED  # `O` is answered as every command
    opens_late = True  # a bridge to a serial port connects before a program opens the port
    text = staticmethod(raw_text)

    def __init__(self, bus: str) -> None:
        self.mode: Mode = "closed"
        self.malformed = 0  # unknown lines
        self._bus, self._rest, self._is_too_long = bus, b"", False

    def feed(self, data: bytes) -> Iterator[Action]:
        """The actions that these bytes ask for, in order. Never raises."""
        *lines, self._rest = (self._rest + data.replace(b"\n", b"")).split(b"\r")
        for line in lines:
            try:
                if self._is_too_long or len(line) > LINE_BYTES:
                    raise FormatError("too long")
                yield from self._actions(line.decode("ascii", "replace"))
            except FormatError:
                self.malformed += 1
                yield Reply(REFUSED)
            self._is_too_long = False
        if len(self._rest) > LINE_BYTES:
            self._rest, self._is_too_long = b"", True

    def _actions(self, line: str) -> Iterator[Action]:
        """The actions that one line asks for. Raises FormatError."""
        command = line[:1]
        if command in ("t", "T"):
            if self.mode == "closed":
                raise FormatError("not open")
            yield Transmit(*_frame(line))
        elif command in ("O", "L"):
            if self.mode == "closed":
                self.mode = "raw"
                yield Open(self._bus)
                yield Enter("raw")
        elif command == "C":
            if self.mode != "closed":
                self.mode = "closed"
                yield Close()
        elif command in _TOLD:
            yield Reply(_TOLD[command])
            return
        elif (command and command not in _IGNORED) or line == "Z1":
            raise FormatError(f"not a command: {line!r}")
        yield Reply(DONE)  # to an empty line too: clients begin with some of them


def _frame(line: str) -> tuple[int, bytes]:
    """Parse arbitration field and data from "t", three digits, a length and that many bytes, or "T" and eight digits. Raises
    FormatError."""
    digits = 8 if line[0] == "T" else 3
    try:
        number, length, data = int(line[1 : 1 + digits], 16), int(line[1 + digits]), bytes.fromhex(line[2 + digits :])
    except (ValueError, IndexError):
        raise FormatError(f"not a frame: {line!r}") from None
    if len(data) != length or length > 8 or not line.isalnum():
        raise FormatError(f"not a frame: {line!r}")
    return (extended if digits == 8 else standard)(number), data
