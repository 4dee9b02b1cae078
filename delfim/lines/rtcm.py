"""RTCM 3 frames in a stream of bytes (RTCM 10403.3, "transport layer"): found, checked and counted; their content is for the
receiver.

A frame is D3, six bits of zero, a length of ten bits, the payload, and a CRC-24Q over all before it. The first twelve bits of
the payload are the message's number, 1005 for the base's place, 1074 to 1127 for observations.
"""

from pathlib import Path
from typing import Final, NamedTuple

PREAMBLE: Final = 0xD3
FRAME_MAX: Final = 3 + 1023 + 3
NUMBERS_MAX: Final = 64  # message numbers that are counted one by one; the others together, as number 0
_POLYNOMIAL: Final = 0x1864CFB


def _table() -> tuple[int, ...]:
    rows = []
    for value in range(256):
        value <<= 16
        for _ in range(8):
            value = value << 1 ^ (_POLYNOMIAL if value & 0x800000 else 0)
        rows.append(value)
    return tuple(rows)


_TABLE: Final = _table()


def crc24q(data: bytes) -> int:
    value = 0
    for byte in data:
        value = (value << 8 & 0xFFFFFF) ^ _TABLE[value >> 16 ^ byte]
    return value


def framed(payload: bytes) -> bytes:
    """Frame a payload of up to 1,023 bytes."""
    body = bytes((PREAMBLE, len(payload) >> 8, len(payload) & 0xFF)) + payload
    return body + crc24q(body).to_bytes(3, "big")


def doorstep(run_directory: str) -> Path:
    """The path of the socket where the service `corrections` takes what came by radio."""
    return Path(run_directory) / "corrections"


class RtcmFrame(NamedTuple):
    number: int  # of the message, 0 where the payload is too short for one
    data: bytes  # the whole frame


class RtcmFrames:
    """The frames of one stream. `heard` counts sound frames by their number, `noise` the bytes that belong to none; both since
    the start."""

    def __init__(self) -> None:
        self.heard, self.noise = dict[int, int](), 0
        self._rest = b""

    def feed(self, data: bytes) -> list[RtcmFrame]:
        """The frames that end in these bytes, in their order. Never raises. No more than a frame is kept."""
        data, found, at = self._rest + data, list[RtcmFrame](), 0
        while (start := data.find(PREAMBLE, at)) >= 0:
            self.noise += start - at
            at = start
            if len(data) < start + 3:
                break  # the rest comes later
            length = int.from_bytes(data[start + 1 : start + 3], "big")
            end = start + 6 + length
            if length > 1023:
                self.noise, at = self.noise + 1, start + 1
            elif len(data) < end:
                break
            elif crc24q(data[start : end - 3]) == int.from_bytes(data[end - 3 : end], "big"):
                frame = RtcmFrame(data[start + 3] << 4 | data[start + 4] >> 4 if length > 1 else 0, data[start:end])
                self._count(frame.number)
                found.append(frame)
                at = end
            else:  # perhaps no frame began here, and one begins within it
                self.noise, at = self.noise + 1, start + 1
        else:
            self.noise, start = self.noise + len(data) - at, len(data)
        self._rest = data[start:]
        return found

    def reset(self) -> None:
        """Begin anew after the stream was cut: what comes next does not continue what came before."""
        self.noise, self._rest = self.noise + len(self._rest), b""

    def _count(self, number: int) -> None:
        known = number if number in self.heard or len(self.heard) < NUMBERS_MAX else 0
        self.heard[known] = self.heard.get(known, 0) + 1
