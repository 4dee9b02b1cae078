"""MAVLink 2 on the wire: a datagram cut into frames, a frame into a message, and back.

The codec is pymavlink's generated dialect only. Its parser is not used: it keeps bytes from one datagram to the next, and it
remembers the time stamp of a signed frame before it knows that the signature is right, so that a forgery would silence the
console. Both are done here and in `signing.py`.
"""

from collections.abc import Callable
from typing import Any, Final, NamedTuple

from pymavlink.dialects.v20 import development

from delfim.errors import FormatError

MARKER: Final = 0xFD
SIGNED: Final = 0x01  # the one incompatibility flag that exists
GUEST: Final = 191  # component of a computer on board: it commands nothing, and is the guest by its own door alone
DATAGRAM_BYTES: Final = 2048  # the socket cuts longer ones, which makes them malformed
_LEAST, _SIGNATURE = 12, 13

dialect: Final[Any] = development
Message = Any  # pymavlink generates a class for each message, without types


Address = tuple[str, int]


class Speaker(NamedTuple):
    """The sender of a frame. Two programs may use the same numbers, but their links differ."""

    system: int
    component: int
    link: int | Address  # of a signed frame its link number, otherwise its address

    @property
    def party(self) -> tuple[int, int]:
        """The addressee of an answer."""
        return self.system, self.component

    @property
    def name(self) -> str:
        return f"console {self.system}"


def frames(datagram: bytes) -> tuple[list[bytes], bool]:
    """The frames of a datagram, in order, and whether nothing was left over."""
    found: list[bytes] = []
    at, size = 0, len(datagram)
    while at < size:
        if size - at < _LEAST or datagram[at] != MARKER or datagram[at + 2] & ~SIGNED:
            return found, False
        end = at + _LEAST + datagram[at + 1] + (_SIGNATURE if datagram[at + 2] & SIGNED else 0)
        if end > size:
            return found, False
        found.append(datagram[at:end])
        at = end
    return found, True


def link_of(frame: bytes) -> int:
    """The number of the link in a signed frame."""
    return frame[-13]


def decode(frame: bytes) -> Message | None:
    """The message in a frame; None for an unknown message number. Raises FormatError for a wrong checksum."""
    try:
        message = _codec.decode(bytearray(frame))
    except dialect.MAVError as error:
        raise FormatError(f"MAVLink frame: {error}") from None
    return None if message.get_type().startswith("UNKNOWN") else message


class Sender:
    """One direction of one link: numbers frames and, with a key, signs them. `stamp` gives the time stamp of a signature."""

    def __init__(self, system: int, component: int, key: bytes | None, stamp: Callable[[], int]) -> None:
        self._codec = dialect.MAVLink(None, system, component)
        self._signing, self._stamp = self._codec.signing, stamp
        self._signing.secret_key, self._signing.sign_outgoing = key, key is not None

    def pack(self, message: Message) -> bytes:
        """The frame of a message. Raises struct.error if a field does not fit: a defect of the caller."""
        if self._signing.sign_outgoing:
            self._signing.timestamp = self._stamp()
        frame: bytes = message.pack(self._codec)
        self._codec.seq = (self._codec.seq + 1) & 0xFF
        return frame


_codec = dialect.MAVLink(None)
