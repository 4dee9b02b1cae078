"""A DSOR identifier taken apart, for tests of what was sent."""

from typing import NamedTuple

from delfim.base.errors import FormatError
from delfim.base.frames import CAN_ERR, CAN_IDE, CAN_RTR
from delfim.canproxy.dsor.protocol import Kind


class Fields(NamedTuple):
    """What the 29-bit identifier says."""

    priority: int
    kind: Kind
    source: int
    destination: int
    sequence: int  # message number or segment index, modulo 32


def dsor_fields(arb: int) -> Fields:
    """The inverse of `dsor_arb`. Raises FormatError for what is no extended format data frame."""
    if arb & (CAN_IDE | CAN_RTR | CAN_ERR) != CAN_IDE:
        raise FormatError(f"arbitration field {arb:#010x} is not of an extended format data frame")
    return Fields(
        arb >> 24 & 0xFF,
        Kind(arb >> 22 & 3),
        arb >> 15 & 0x7F,
        arb >> 8 & 0x7F,
        arb >> 3 & 31,
    )
