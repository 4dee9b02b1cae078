"""MAVLink 2 on the wire: a datagram or a stream of bytes cut into frames, a frame into a message, and back.

The codec is pymavlink's generated dialect only. Its parser is not used: it keeps bytes from one datagram to the next, and it
remembers the time stamp of a signed frame before it knows that the signature is right, so that a forgery would silence the
console. Both are done here and in `signing.py`.
"""

import re
from binascii import crc_hqx
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from pymavlink.dialects.v20 import development

from delfim.base.errors import FormatError
from delfim.parts.mavlink.codec import ardupilot

MARKER, MARKER_1 = 0xFD, 0xFE  # of MAVLink 2; of MAVLink 1, in which a SiK radio reports about itself
SIGNED: Final = 0x01  # the one incompatibility flag that exists
GUEST: Final = 191  # component of a computer on board: it commands nothing, and is the guest by its own door alone
DATAGRAM_BYTES: Final = 2048  # the socket cuts longer ones, which makes them malformed
_LEAST, _LEAST_1, _SIGNATURE = 12, 8, 13
_markers: Final = re.compile(b"[\xfd\xfe]")
_MIRRORED: Final = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))

dialect: Final[Any] = development
dialect.mavlink_map.update({each.id: each for each in ardupilot.MESSAGES})
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


class Cutter:
    """Cuts a stream, which may be interrupted anywhere, into frames of MAVLink 1 and 2 whose checksum is right. Other bytes are
    skipped one by one, and no frame waits for the rest of a broken one before it: a stop must not."""

    def __init__(self) -> None:
        self.rest = b""  # the beginning of a frame, up to 279 bytes

    def cut(self, data: bytes) -> list[bytes]:
        """The frames that are whole with these bytes."""
        stream, found, at, begun = self.rest + data, list[bytes](), 0, -1
        while (marker := _markers.search(stream, at)) is not None:
            at = marker.start()
            end = at + _size(stream, at)
            if end > len(stream):
                begun, at = at if begun < 0 else begun, at + 1
            elif end > at and _is_whole(stream[at:end]):
                found.append(stream[at:end])
                signed = stream[at] == MARKER and stream[at + 2] & SIGNED
                begun, at = -1, end - _SIGNATURE * signed  # a torn signature has the next frame's beginning in it
            else:
                at += 1
        self.rest = stream[begun:] if begun >= 0 else b""
        return found


def _size(stream: bytes, at: int) -> int:
    """The length of a frame that begins here; 0: none does. A header that is not whole yet counts as a frame that is not."""
    if len(stream) - at < 3:
        return _LEAST
    if stream[at] == MARKER_1:
        return _LEAST_1 + stream[at + 1]
    return 0 if stream[at + 2] & ~SIGNED else _LEAST + stream[at + 1] + _SIGNATURE * (stream[at + 2] & SIGNED)


def _is_whole(frame: bytes) -> bool:
    """Whether it is a known message with the right checksum: CRC-16/MCRF4XX, which is CRC-CCITT with mirrored bits."""
    old = frame[0] == MARKER_1
    known = dialect.mavlink_map.get(frame[5] if old else int.from_bytes(frame[7:10], "little"))
    if known is None:
        return False
    end = len(frame) - 2 if old or not frame[2] & SIGNED else len(frame) - 2 - _SIGNATURE
    crc = crc_hqx((frame[1:end] + bytes((known.crc_extra,))).translate(_MIRRORED), 0xFFFF)
    return frame[end : end + 2] == bytes((_MIRRORED[crc >> 8], _MIRRORED[crc & 0xFF]))


def link_of(frame: bytes) -> int:
    """The number of the link in a signed frame."""
    return frame[-13]


def stamp_of(frame: bytes) -> int:
    """The time stamp of a signed frame: one sequence of its sender, on whichever links he speaks."""
    return int.from_bytes(frame[-12:-6], "little")


def decode(frame: bytes) -> Message | None:
    """The message in a frame; None for an unknown message number. Raises FormatError for a wrong checksum."""
    try:
        message = _codec.decode(bytearray(frame))
    except dialect.MAVError as error:
        raise FormatError(f"MAVLink frame: {error}") from None
    return None if message.get_type().startswith("UNKNOWN") else message


class Sender:
    """One direction of one link: numbers frames and, with a key, signs them. `stamp` gives the time stamp of a signature, and
    `link` is its link number: that of the sender, the same on all of his links."""

    def __init__(self, system: int, component: int, key: bytes | None, stamp: Callable[[], int], link: int = 0) -> None:
        self._codec = dialect.MAVLink(None, system, component)
        self._signing, self._stamp = self._codec.signing, stamp
        self._signing.secret_key, self._signing.sign_outgoing, self._signing.link_id = key, key is not None, link

    def pack(self, message: Message) -> bytes:
        """The frame of a message. Raises struct.error if a field does not fit: a defect of the caller."""
        if self._signing.sign_outgoing:
            self._signing.timestamp = self._stamp()
        frame: bytes = message.pack(self._codec)
        self._codec.seq = (self._codec.seq + 1) & 0xFF
        return frame


_codec = dialect.MAVLink(None)
