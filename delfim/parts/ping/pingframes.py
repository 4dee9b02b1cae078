"""The frames of the Ping protocol (github.com/bluerobotics/ping-protocol, `ping1d.json`), as much as an echo sounder needs.

A frame is "BR", the length of the payload, the number of the message, source and destination, the payload, and the sum of all
bytes before; little endian. A message that is longer than it is known here is read as far as that.
"""

import struct
from typing import Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.lines.binaryframes import Framing

BEGIN: Final = b"BR"
HEAD: Final = struct.Struct("<2sHHBB")
SUM: Final = struct.Struct("<H")
PAYLOAD_MAX: Final = 2048  # bytes; a profile of 1,200 points is the longest that a sounder sends
SET_SOUND: Final = 1002  # speed of sound, mm/s
SET_INTERVAL: Final = 1004  # between two pings, ms
SIMPLE: Final = 1211  # distance in mm, confidence in per cent
DISTANCE: Final = 1212  # the same, length of the pulse, number of the ping, scanned range, gain
PROFILE: Final = 1300  # as DISTANCE, with the strength of the echo
START: Final = 1400  # send a message after each ping
_DISTANCE: Final = struct.Struct("<IHHIIII")
_SIMPLE: Final = struct.Struct("<IB")
_U16: Final = struct.Struct("<H")
_U32: Final = struct.Struct("<I")
PER_CENT: Final = 100


class PingFrame(NamedTuple):
    message: int
    payload: bytes
    source: int = 0  # a host is 0, a sounder 1
    destination: int = 0


class PingDistance(NamedTuple):
    """What a ping found."""

    range_m: float  # from the transducer to what the echo is of
    confidence: float  # 0..1
    number: int | None = None  # of the ping since the sounder started


def packed(frame: PingFrame) -> bytes:
    """The bytes of a frame. Raises struct.error for numbers that do not fit."""
    data = HEAD.pack(BEGIN, len(frame.payload), frame.message, frame.source, frame.destination) + frame.payload
    return data + SUM.pack(sum(data) & 0xFFFF)


def asked(rate_hz: float, sound_mps: float | None) -> bytes:
    """What makes a sounder tell the distance of each ping: speed of sound where one is given, interval, start."""
    sound = [] if sound_mps is None else [PingFrame(SET_SOUND, _U32.pack(round(sound_mps * 1e3)))]
    interval = PingFrame(SET_INTERVAL, _U16.pack(min(round(1e3 / rate_hz), 0xFFFF)))
    return b"".join(map(packed, (*sound, interval, PingFrame(START, _U16.pack(DISTANCE)))))


def told(distance: PingDistance, scan_m: float = 30.0) -> bytes:
    """A sounder's frame of a ping."""
    mm, per_cent = round(distance.range_m * 1e3), round(distance.confidence * PER_CENT)
    return packed(PingFrame(DISTANCE, _DISTANCE.pack(mm, per_cent, 100, distance.number or 0, 0, round(scan_m * 1e3), 3), 1))


def distance(frame: PingFrame) -> PingDistance | None:
    """What a frame says of a ping; None: it is of something else. Raises FormatError."""
    kind = _SIMPLE if frame.message == SIMPLE else _DISTANCE
    if frame.message not in (SIMPLE, DISTANCE, PROFILE):
        return None
    if len(frame.payload) < kind.size:
        raise FormatError(f"Ping message {frame.message} of {len(frame.payload)} bytes, not {kind.size}")
    mm, per_cent, *more = kind.unpack_from(frame.payload)
    if per_cent > PER_CENT:
        raise FormatError(f"a confidence of {per_cent} %")
    return PingDistance(mm / 1e3, per_cent / PER_CENT, more[1] if more else None)


def _size(head: bytes) -> int | None:
    if len(head) < HEAD.size:
        return None
    length = HEAD.unpack_from(head)[1]
    return HEAD.size + length + SUM.size if length <= PAYLOAD_MAX else 0


def _sound(frame: bytes) -> bool:
    return sum(frame[: -SUM.size]) & 0xFFFF == int.from_bytes(frame[-SUM.size :], "little")


FRAMING: Final = Framing(BEGIN, _size, _sound)


def unpacked(frame: bytes) -> PingFrame:
    """Of the bytes of a whole frame."""
    _, _, message, source, destination = HEAD.unpack_from(frame)
    return PingFrame(message, frame[HEAD.size : -SUM.size], source, destination)
