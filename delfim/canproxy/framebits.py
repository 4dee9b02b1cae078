"""How many bits a CAN 2.0 frame takes on the bus, stuff bits included (Bosch, CAN Specification 2.0, parts A and B)."""

import re
from typing import Final

from delfim.base.frames import CAN_ERR, CAN_IDE, CAN_RTR, Frame

_POLYNOMIAL: Final = 0x4599  # CRC-15, without its highest bit
_UNSTUFFED_BITS: Final = 13  # CRC delimiter, acknowledge slot and its delimiter, end of frame (7), interframe space (3)
# After five equal bits a bit of the other kind is stuffed in, and counts with the bits that follow it.
_STUFFED: Final = re.compile("0{5}(?:1{4}0{4})*(?:1{4})?|1{5}(?:0{4}1{4})*(?:0{4})?")


def _crc_of_byte(byte: int) -> int:
    crc = byte << 7
    for _ in range(8):
        crc = (crc << 1 ^ (_POLYNOMIAL if crc & 0x4000 else 0)) & 0x7FFF
    return crc


_CRC: Final = tuple(map(_crc_of_byte, range(256)))


def frame_bits(frame: Frame) -> int:
    """Bits from the start of the frame to the end of the interframe space. An error frame was never on the bus: 0."""
    arb, data = frame.arb, frame.data
    if arb & CAN_ERR:
        return 0
    remote = bool(arb & CAN_RTR)
    if arb & CAN_IDE:  # start, 11 bits, SRR and IDE recessive, 18 bits, RTR, r1, r0, length
        head, length = (arb >> 21) << 27 | 0b11 << 25 | (arb >> 3 & 0x3FFFF) << 7 | remote << 6 | len(data), 39
    else:  # start, 11 bits, RTR, IDE, r0, length
        head, length = (arb >> 21) << 7 | remote << 6 | len(data), 19
    body = head if remote else head << 8 * len(data) | int.from_bytes(data, "big")
    length += 0 if remote else 8 * len(data)
    crc = 0
    for byte in body.to_bytes(13, "big"):  # zeros in front do not change it
        crc = (crc << 8 ^ _CRC[(crc >> 7 ^ byte) & 0xFF]) & 0x7FFF
    bits = f"{body << 15 | crc:0{length + 15}b}"
    stuffed = sum(1 + (len(run) - 5) // 4 for run in _STUFFED.findall(bits))
    return len(bits) + stuffed + _UNSTUFFED_BITS
