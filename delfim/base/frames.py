"""CAN frames and the 32-bit arbitration field of thesis figure 5-5, and their image in Linux' `struct can_frame`.

Arbitration field, most significant bit first, host byte order, numerically ordered as frames win the bus:

    31          21 20                    3   2     1     0
    | 11 bit id   | 18 bit extended id    | IDE | RTR | ERR |

IDE is set in extended format frames, RTR in remote frames. The thesis leaves the last bit unused; here it marks the error
frames by which a controller reports its own state: such a frame was never on the bus.
"""

import struct
from typing import Final, NamedTuple

from delfim.base.errors import FormatError

CAN_IDE: Final = 1 << 2
CAN_RTR: Final = 1 << 1
CAN_ERR: Final = 1 << 0
CAN_ID: Final = 0x1FFFFFFF << 3  # all 29 identifier bits of the arbitration field
CAN_ANY: Final = 0xFFFFFFFE  # as a mask: every data and remote frame, both formats, is accepted

# linux/can.h
_EFF: Final = 1 << 31
_RTR: Final = 1 << 30
_ERR: Final = 1 << 29

CAN_FRAME: Final = struct.Struct("=IB3x8s")  # struct can_frame: identifier and flags, length, data


class Frame(NamedTuple):
    """One CAN 2.0 frame. A remote frame carries its data length code as that many zero bytes of `data`."""

    arb: int
    data: bytes = b""
    t_ns: int = 0  # kernel's receive time, CLOCK_REALTIME; 0 if it was never received
    ifindex: int = 0  # interface it came by; 0 where unknown
    sent_here: bool = False  # sent by a socket of this computer (MSG_DONTROUTE)

    @property
    def extended(self) -> bool:
        return bool(self.arb & CAN_IDE)

    @property
    def remote(self) -> bool:
        return bool(self.arb & CAN_RTR)

    @property
    def error(self) -> bool:
        return bool(self.arb & CAN_ERR)

    @property
    def identifier(self) -> int:
        return identifier(self.arb)


def standard(identifier: int, remote: bool = False) -> int:
    """Arbitration field of a standard format frame. Raises FormatError outside 0..0x7FF."""
    if not 0 <= identifier <= 0x7FF:
        raise FormatError(f"standard identifier {identifier:#x} is outside 0..0x7FF")
    return identifier << 21 | (CAN_RTR if remote else 0)


def extended(identifier: int, remote: bool = False) -> int:
    """Arbitration field of an extended format frame. Raises FormatError outside 0..0x1FFFFFFF."""
    if not 0 <= identifier <= 0x1FFFFFFF:
        raise FormatError(f"extended identifier {identifier:#x} is outside 0..0x1FFFFFFF")
    return identifier << 3 | CAN_IDE | (CAN_RTR if remote else 0)


def identifier(arb: int) -> int:
    """The 29-bit identifier of an extended frame, the 11-bit one of a standard frame."""
    return arb >> 3 if arb & CAN_IDE else arb >> 21


def to_can_id(arb: int) -> int:
    """The kernel's `can_id` word for an arbitration field."""
    flags = (_RTR if arb & CAN_RTR else 0) | (_ERR if arb & CAN_ERR else 0)
    return arb >> 3 | _EFF | flags if arb & CAN_IDE else arb >> 21 | flags


def from_can_id(can_id: int) -> int:
    """The arbitration field for a kernel `can_id` word. The class of an error frame stands where the 29-bit identifier does."""
    if can_id & _ERR:
        return (can_id & 0x1FFFFFFF) << 3 | CAN_IDE | CAN_ERR
    flags = CAN_RTR if can_id & _RTR else 0
    return (can_id & 0x1FFFFFFF) << 3 | CAN_IDE | flags if can_id & _EFF else (can_id & 0x7FF) << 21 | flags


def to_can_frame(arb: int, data: bytes) -> bytes:
    """The 16 bytes of `struct can_frame`. Raises FormatError beyond 8 bytes of data."""
    if len(data) > 8:
        raise FormatError(f"{len(data)} bytes of data do not fit a CAN frame of 8")
    return CAN_FRAME.pack(to_can_id(arb), len(data), data)
