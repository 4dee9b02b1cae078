"""SBUS of Futaba and others: 100,000 baud, 8 data bits, even parity, 2 stop bits, inverted on the wire.

25 bytes every 6 to 14 ms: 0x0F, 22 of channels, flags, end. There is no checksum: form alone tells a frame from noise, and a
frame with one wrong bit is mostly taken. So after anything that is no frame, two in a row must fit before one counts again.
When the radio is lost most receivers go on sending the last or preset positions, and only a flag tells.
"""

from typing import Final

from delfim.lines.radiocontrol.channels import PACKED, Pulses, unpack

BAUD: Final = 100_000
LENGTH: Final = 25
HEAD: Final = 0x0F
ENDS: Final = frozenset((0x00, 0x04, 0x14, 0x24, 0x34))  # of SBUS, and of SBUS2's four slots
FLAGS: Final = 0x0F  # the bits that have a meaning; the two lowest are switches
FRAME_LOST: Final = 0x04
FAILSAFE: Final = 0x08


class Sbus:
    """The `Decoder` of SBUS."""

    quality_pct: int | None = None  # SBUS does not tell it

    def __init__(self) -> None:
        self.lost, self._rest, self._in_step = "", b"", False

    def feed(self, data: bytes) -> list[Pulses]:
        """Decode the channels. Frames that the receiver repeats because one was lost on the air are not fresh, and are left
        out."""
        data, found, at = self._rest + data, list[Pulses](), 0
        needed = LENGTH if self._in_step else 2 * LENGTH
        while len(data) - at >= needed:
            if _is_frame(data, at) and (self._in_step or _is_frame(data, at + LENGTH)):
                self._in_step, needed = True, LENGTH
                flags = data[at + LENGTH - 2]
                self.lost = "the receiver's failsafe flag" if flags & FAILSAFE else ""
                if not flags & (FAILSAFE | FRAME_LOST):
                    found.append(unpack(data[at + 1 : at + 1 + PACKED]))
                at += LENGTH
            else:
                self._in_step, needed = False, 2 * LENGTH
                at += 1
        self._rest = data[at:]
        return found


def _is_frame(data: bytes, at: int) -> bool:
    return data[at] == HEAD and data[at + LENGTH - 1] in ENDS and not data[at + LENGTH - 2] & ~FLAGS
