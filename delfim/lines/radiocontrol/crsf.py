"""CRSF of TBS Crossfire and ExpressLRS: 416,666 or 420,000 baud, 8N1, not inverted (the specification of TBS).

A frame is an address, a length of 2 to 62, a type, the payload, and a checksum of type and payload. 0x16 has the channels.
0x14 has the quality of the radio, and goes on while the radio is lost: it says 0 % then, and 0x16 stops.
"""

from typing import Final

from delfim.lines.radiocontrol.channels import PACKED, Pulses, unpack

BAUD: Final = 420_000
ADDRESSES: Final = frozenset((0xC8, 0x00, 0xEA, 0xEC, 0xEE))  # flight controller; others that receivers use
CHANNELS, LINK = 0x16, 0x14
LINK_LENGTH: Final = 10
POLYNOMIAL: Final = 0xD5


def _remainder(byte: int) -> int:
    for _ in range(8):
        byte = (byte << 1 ^ POLYNOMIAL if byte & 0x80 else byte << 1) & 0xFF
    return byte


_TABLE: Final = bytes(map(_remainder, range(256)))


def checksum(body: bytes) -> int:
    """The checksum of a body, CRC-8/DVB-S2."""
    crc = 0
    for byte in body:
        crc = _TABLE[crc ^ byte]
    return crc


class Crsf:
    """The `Decoder` of CRSF."""

    def __init__(self) -> None:
        self.lost, self._rest = "", b""
        self.quality_pct: int | None = None

    def feed(self, data: bytes) -> list[Pulses]:
        """Channels that come while the quality is 0 % are not fresh, and are left out."""
        data, found, at = self._rest + data, list[Pulses](), 0
        while len(data) - at >= 2:
            end = at + 2 + data[at + 1]  # of the frame
            fits = data[at] in ADDRESSES and 4 <= end - at <= 64
            if fits and end > len(data):
                break
            if fits and checksum(data[at + 2 : end - 1]) == data[end - 1]:
                found += self._taken(data[at + 2 : end - 1])
                at = end
            else:
                at += 1
        self._rest = data[at:]
        return found

    def _taken(self, body: bytes) -> list[Pulses]:
        kind, payload = body[0], body[1:]
        if kind == LINK and len(payload) >= LINK_LENGTH:
            self.quality_pct = payload[2]
            self.lost = "" if self.quality_pct else "the quality of its radio is 0 %"
        return [unpack(payload)] if kind == CHANNELS and len(payload) == PACKED and not self.lost else []
