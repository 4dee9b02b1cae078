"""The AT commands of an Iridium SBD modem, one session with the satellite: a message out, a message in. No line and no clock.

By Iridium's ISU AT Command Reference (MAN0009): +SBDWB, +SBDIX, +SBDRB and +SBDD0, as the 9602 and 9603 have them. A message
out has up to 340 bytes, one in up to 270; each is followed by the sum of its bytes, two of them, the high one first.
"""

import re
from collections.abc import Callable, Generator
from functools import partial
from typing import Any, Final, NamedTuple

from delfim.base.errors import FormatError

OUT_MAX, IN_MAX = 340, 270  # bytes of a message
HEARD_MAX: Final = 1024  # bytes that are kept of an answer
SENT_MAX: Final = 4  # the greatest status of a session by which the message has left
READ: Final = 2  # times at most: the modem keeps a message that the line has damaged
_OK: Final = re.compile(rb"(?:^|\r|\n)OK\r\n")
_READY: Final = re.compile(rb"READY\r\n")
_CODE: Final = re.compile(rb"(?:^|\r|\n)(\d)\r\n\r?\n?OK\r\n")
_SESSION: Final = re.compile(rb"\+SBDIX: *(\d{1,3}), *(\d{1,5}), *(\d), *(-?\d{1,5}), *(\d{1,3}), *(\d{1,3})\r\n\r?\n?OK\r\n")
_ERROR: Final = re.compile(rb"(?:^|\r|\n)ERROR\r\n")


class Ask(NamedTuple):
    """What is written, and what ends the answer: `found` returns it, or None as long as it is not whole."""

    data: bytes
    found: Callable[[bytes], Any]
    within_s: float


class SbdSession(NamedTuple):
    """What came of a session: whether the message left, the modem's number for that, what came in, and how many wait there."""

    is_sent: bool
    status: int
    heard: bytes
    queued: int


def summed(message: bytes) -> bytes:
    """A message with its sum."""
    return message + (sum(message) & 0xFFFF).to_bytes(2)


def session(message: bytes) -> Generator[Ask, Any, SbdSession]:
    """All of a session; empty: only look for a message. Raises FormatError where the modem refuses."""
    yield Ask(b"ATE0\r", partial(_matched, _OK), 5.0)
    yield Ask(b"AT&K0\r", partial(_matched, _OK), 5.0)
    yield Ask(b"AT+SBDD0\r", partial(_matched, _CODE), 5.0)  # what was not sent then is old now
    if message:
        yield Ask(b"AT+SBDWB=%d\r" % len(message), partial(_matched, _READY), 5.0)
        code = yield Ask(summed(message), partial(_matched, _CODE), 10.0)
        if int(code[1]):
            raise FormatError(f"the modem does not take the message: {code[1].decode()}")
    told = yield Ask(b"AT+SBDIX\r", partial(_matched, _SESSION), 90.0)
    status, _, has_message, _, length, queued = map(int, told.groups())
    heard = b""
    if status <= SENT_MAX and has_message == 1 and 0 < length <= IN_MAX:
        for _ in range(READ):
            heard = heard or (yield Ask(b"AT+SBDRB\r", partial(_binary, length), 10.0))
        if not heard:
            raise FormatError("the message from the modem is damaged")
    return SbdSession(status <= SENT_MAX, status, heard, queued)


def _matched(pattern: re.Pattern[bytes], heard: bytes) -> re.Match[bytes] | None:
    if (found := pattern.search(heard)) is None and _ERROR.search(heard):
        raise FormatError("the modem says ERROR")
    return found


def _binary(length: int, heard: bytes) -> bytes | None:
    """The message of this length, which is before it; its sum is behind it. Empty: it is damaged."""
    at = heard.find(length.to_bytes(2))
    if at < 0 or len(heard) < at + 2 + length + 2:
        return None
    message, told = heard[at + 2 : at + 2 + length], heard[at + 2 + length : at + 4 + length]
    return message if summed(message)[-2:] == told else b""


class SbdLine:
    """One modem's line: `write` takes bytes for it. `reason`: why the last session came to nothing, or empty."""

    def __init__(self, write: Callable[[bytes], object]) -> None:
        self.reason = "no session yet"
        self._write, self._heard = write, bytearray()
        self._session: Generator[Ask, Any, SbdSession] | None = None
        self._ask: Ask | None = None
        self._until_s = 0.0

    @property
    def is_busy(self) -> bool:
        return self._session is not None

    def begin(self, message: bytes, now_s: float) -> None:
        """`message`: OUT_MAX bytes at most; empty: only look for one."""
        self._session = session(message[:OUT_MAX])
        self._go_on(None, now_s)

    def feed(self, data: bytes, now_s: float) -> SbdSession | None:
        """Takes what the modem says; returns the session when it is over."""
        if self._session is None or self._ask is None:
            return None  # as SBDRING, or the rest of an answer
        self._heard += data
        del self._heard[:-HEARD_MAX]
        try:
            answer = self._ask.found(bytes(self._heard))
        except FormatError as error:
            return self._fail(str(error))
        return None if answer is None else self._go_on(answer, now_s)

    def tick(self, now_s: float) -> bool:
        """Whether a session has failed now, because the modem does not answer."""
        if self._session is None or now_s < self._until_s:
            return False
        assert self._ask is not None
        command = self._ask.data.partition(b"\r")[0] if self._ask.data.startswith(b"AT") else b"the message"
        self._fail(f"no answer to {command.decode()}")
        return True

    def _go_on(self, answer: Any, now_s: float) -> SbdSession | None:
        assert self._session is not None
        self._heard.clear()
        try:
            self._ask = self._session.send(answer)
        except StopIteration as end:
            self._session, self._ask = None, None
            over: SbdSession = end.value
            self.reason = "" if over.is_sent else f"no session with the satellite: {over.status}"
            return over
        except FormatError as error:
            return self._fail(str(error))
        self._until_s = now_s + self._ask.within_s
        self._write(self._ask.data)
        return None

    def _fail(self, why: str) -> SbdSession:
        self._session, self._ask, self.reason = None, None, why
        return SbdSession(False, -1, b"", 0)
