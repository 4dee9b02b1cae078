"""The socketcand protocol: text in, actions out, and the text of frames. No sockets, no time: see cantcpd for those.

    server  < hi >    client  < open can0 >    server  < ok >    client  < rawmode >    server  < ok >
    server  < frame 123 1262304000.000123 1122AABB >             client  < send 123 4 11 22 AA BB >

One connection has one bus. It begins without, `open` leads into BCM mode, and from there it changes between BCM, RAW and
CONTROL. Beyond the reference server (socketcand, linux-can) it accepts the input of real clients: elements
split, merged or with newlines between, and SavvyCAN's hexadecimal numbers, which come as wide as a signed 64-bit integer.
CAN FD, remote frames and ISO-TP are not supported. docs/cantcpd.md lists every command and the clients that use it.
"""

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

from delfim.base.errors import FormatError
from delfim.base.frames import CAN_IDE, Frame, extended, standard

ELEMENT_BYTES: Final = 8290  # the longest command, a muxfilter with 257 rows, takes 6.2 kB
WORD_CHARACTERS: Final = 20  # of a decimal number
INTERVAL_S_MIN: Final = 0.001  # between two cyclic transmissions of one frame
INTERVAL_S_MAX: Final = 86_400.0

HI: Final = b"< hi >"
OK: Final = b"< ok >"
ECHO: Final = b"< echo >"
UNKNOWN: Final = b"< error unknown command >"
NO_SUCH_BUS: Final = b"< error could not open bus >"

Mode = Literal["closed", "bcm", "raw", "control"]


class Reply(NamedTuple):
    text: bytes


class Open(NamedTuple):
    """Open the bus and answer OK, or answer NO_SUCH_BUS and end the connection."""

    bus: str


class Enter(NamedTuple):
    """Change the mode: jobs and subscriptions of the old one end. The answer OK is a write of its own."""

    mode: Mode


class Close(NamedTuple):
    """Close the bus, not the connection."""


class Transmit(NamedTuple):
    arb: int
    data: bytes


class Cycle(NamedTuple):
    """Transmit a frame now and each `interval_s` until deleted."""

    arb: int
    data: bytes
    interval_s: float


class Update(NamedTuple):
    """Replace the data of a cycle; no effect without one."""

    arb: int
    data: bytes


class Delete(NamedTuple):
    arb: int


class Subscribe(NamedTuple):
    """Subscribe to the frames of one identifier, at most one each `interval_s` (0: all). `masks`: see
    delfim.canproxy.cantcp.bcm."""

    arb: int
    interval_s: float
    masks: tuple[int, ...] = ()


class Unsubscribe(NamedTuple):
    arb: int


class TellTraffic(NamedTuple):
    """Report the traffic each `period_s`; 0: stop."""

    period_s: float


class TellUnsent(NamedTuple):
    """Report how many frames of this client were not sent, and why the last one was not. The reference server does not have
    it."""


class Hangup(NamedTuple):
    """End the connection once the text is out."""

    text: bytes


Action = (
    Reply
    | Open
    | Enter
    | Close
    | Transmit
    | Cycle
    | Update
    | Delete
    | Subscribe
    | Unsubscribe
    | TellTraffic
    | TellUnsent
    | Hangup
)


@dataclass(slots=True)
class Splitter:
    """Splits a stream that is cut anywhere into elements `< ... >`. Only blanks may stand between them."""

    malformed: int = 0
    _rest: bytes = b""

    def feed(self, data: bytes) -> Iterator[list[str]]:
        """The words of each element that these bytes complete."""
        *elements, self._rest = (self._rest + data).split(b">")
        if len(self._rest) > ELEMENT_BYTES:
            self._rest = b""
            self.malformed += 1
        for element in elements:
            before, bracket, inside = element.rpartition(b"<")
            self.malformed += bool(before.strip())
            if words := bracket and inside.decode("ascii", "replace").split():
                yield words
            else:
                self.malformed += 1


def _head(frame: Frame) -> str:
    """The text of a frame up to the data, with the blank before it. The stamp is cut to microseconds."""
    arb, stamp = frame.arb, str(frame.t_ns).zfill(10)
    identifier = f"{arb >> 3:08X}" if arb & CAN_IDE else f"{arb >> 21:03X}"
    return f"< frame {identifier} {stamp[:-9]}.{stamp[-9:-3]} "


def raw_text(frame: Frame) -> bytes:
    """The text of a data frame in RAW mode: data without blanks; without data there are two blanks, and clients insist on
    both."""
    return f"{_head(frame)}{frame.data.hex().upper()} >".encode()


class SocketcandSession:
    """One connection as the server sees it. `buses` are the names that may be opened."""

    greeting, accepted, refused = HI, OK, NO_SUCH_BUS
    opens_late = False  # clients open a bus as soon as they are greeted
    text = staticmethod(raw_text)

    def __init__(self, buses: Collection[str]) -> None:
        self.mode: Mode = "closed"
        self._buses = buses
        self._splitter = Splitter()
        self._malformed = 0

    @property
    def malformed(self) -> int:
        """The number of unknown elements, and of commands with wrong arguments. These get no answer."""
        return self._malformed + self._splitter.malformed

    def feed(self, data: bytes) -> Iterator[Action]:
        """The actions that these bytes ask for, in order. Never raises; a Hangup is the last."""
        for words in self._splitter.feed(data):
            try:
                action = self._closed(words) if self.mode == "closed" else self._opened(words)
            except FormatError:
                self._malformed += 1
                continue
            yield action
            if isinstance(action, Hangup):
                return

    def _closed(self, words: list[str]) -> Action:
        if words[0] == "open" and len(words) == 2 and words[1] in self._buses:
            self.mode = "bcm"
            return Open(words[1])
        if words[0] in self._buses:  # bit timing and controller modes belong to the vehicle, not to a client
            return Reply(UNKNOWN)
        return Hangup(NO_SUCH_BUS)

    def _opened(self, words: list[str]) -> Action:
        name, *arguments = words
        mode = _MODES.get(name)
        if mode and mode != self.mode and not arguments:
            self.mode = mode
            return Enter(mode)
        if name == "echo" and not arguments:
            return Reply(ECHO)
        if name == "unsent" and not arguments:
            return TellUnsent()
        command = _COMMANDS[self.mode].get(name)
        return command(arguments) if command else Reply(UNKNOWN)


def _send(words: list[str]) -> Action:
    return Transmit(*_frame(words))


def _add(words: list[str]) -> Action:
    arb, data = _frame(words[2:])
    return Cycle(arb, data, min(max(_interval_s(words), INTERVAL_S_MIN), INTERVAL_S_MAX))


def _update(words: list[str]) -> Action:
    return Update(*_frame(words))


def _delete(words: list[str]) -> Action:
    return Delete(_only_identifier(words))


def _subscribe(words: list[str]) -> Action:
    return Subscribe(_only_identifier(words[2:]), _interval_s(words))


def _unsubscribe(words: list[str]) -> Action:
    return Unsubscribe(_only_identifier(words))


def _filter(words: list[str]) -> Action:
    arb, mask = _frame(words[2:])
    return Subscribe(arb, _interval_s(words), (_content(mask),))


def _muxfilter(words: list[str]) -> Action:
    if len(words) < 4 or not 2 <= (rows := _decimal(words[3])) <= 257 or len(words) != 4 + 8 * rows:
        raise FormatError("a muxfilter has 2 to 257 rows of 8 bytes")
    data = bytes(map(_byte, words[4:]))
    masks = tuple(_content(data[start : start + 8]) for start in range(0, len(data), 8))
    return Subscribe(_identifier(words[2]), _interval_s(words), masks)


def _statistics(words: list[str]) -> Action:
    if len(words) != 1:
        raise FormatError("statistics needs a period in ms")
    return TellTraffic(_decimal(words[0]) / 1000)


_MODES: Final[dict[str, Mode]] = {"rawmode": "raw", "bcmmode": "bcm", "controlmode": "control"}
_COMMANDS: Final[dict[Mode, dict[str, Callable[[list[str]], Action]]]] = {
    "raw": {"send": _send},
    "control": {"statistics": _statistics},
    "bcm": {
        "send": _send,
        "add": _add,
        "update": _update,
        "delete": _delete,
        "subscribe": _subscribe,
        "unsubscribe": _unsubscribe,
        "filter": _filter,
        "muxfilter": _muxfilter,
    },
}


def _frame(words: list[str]) -> tuple[int, bytes]:
    """Parse arbitration field and data from "ID dlc b0 b1 ..."."""
    if len(words) < 2 or (length := _decimal(words[1])) > 8 or len(words) != 2 + length:
        raise FormatError("a frame needs an identifier, a length and that many bytes")
    return _identifier(words[0]), bytes(map(_byte, words[2:]))


def _only_identifier(words: list[str]) -> int:
    if len(words) != 1:
        raise FormatError("the command needs one identifier")
    return _identifier(words[0])


def _identifier(word: str) -> int:
    """Parse an identifier. Eight digits or more are an extended one, of which only the low 29 bits count."""
    number = _hexadecimal(word)
    return extended(number & 0x1FFFFFFF) if len(word) >= 8 else standard(number)


def _byte(word: str) -> int:
    return _hexadecimal(word) & 0xFF


def _hexadecimal(word: str) -> int:
    if not word.isalnum():
        raise FormatError(f"not hexadecimal: {word[:WORD_CHARACTERS]!r}")
    try:
        return int(word, 16)
    except ValueError:
        raise FormatError(f"not hexadecimal: {word[:WORD_CHARACTERS]!r}") from None


def _decimal(word: str) -> int:
    if not word.isdecimal() or len(word) > WORD_CHARACTERS:
        raise FormatError(f"not a number: {word[:WORD_CHARACTERS]!r}")
    return int(word)


def _interval_s(words: list[str]) -> float:
    """The interval, s, of the seconds and microseconds with which words begin."""
    if len(words) < 2:
        raise FormatError("an interval needs seconds and microseconds")
    return min(_decimal(words[0]) + _decimal(words[1]) / 1e6, INTERVAL_S_MAX)


def _content(data: bytes) -> int:
    return int.from_bytes(data.ljust(8, b"\0"), "big")


def bcm_text(frame: Frame) -> bytes:
    """The text of a data frame in BCM mode: a blank after each byte."""
    return f"{_head(frame)}{''.join(f'{byte:02X} ' for byte in frame.data)} >".encode()


def parse_frame(words: list[str]) -> Frame | None:
    """Parse the frame of an element that a server sent, in either mode; None for another element. Raises FormatError."""
    if words[0] != "frame":
        return None
    try:
        seconds, _, fraction = words[2].partition(".")
        data = bytes.fromhex("".join(words[3:]))
        if len(data) > 8:
            raise ValueError
        t_ns = int(seconds) * 1_000_000_000 + int(fraction.ljust(9, "0")[:9])
        arb = _identifier(words[1])
    except (ValueError, IndexError):
        raise FormatError(f"not a frame of socketcand: {' '.join(words)[:80]!r}") from None
    return Frame(arb, data, t_ns)


def send_text(arb: int, data: bytes) -> bytes:
    """The command that sends a data frame."""
    identifier = f"{arb >> 3:08X}" if arb & CAN_IDE else f"{arb >> 21:03X}"
    return f"< send {identifier} {len(data)} {data.hex(' ')} >".encode()
