"""The PGN of an arbitration field, for tests."""

from delfim.base.errors import FormatError
from delfim.base.frames import CAN_IDE

BROADCAST = 255


def pgn_of(arb: int) -> tuple[int, int, int, int]:
    """(priority 0..7, pgn, source, destination) of an arbitration field; the destination of a broadcast PGN is 255.
    Raises FormatError for anything but an extended format data frame: NMEA 2000 has no others."""
    if arb & 7 != CAN_IDE:
        raise FormatError(f"arbitration field {arb:#010x} is not that of an extended data frame")
    pgn, source = arb >> 11 & 0x3FFFF, arb >> 3 & 0xFF
    if pgn & 0xFF00 < 0xF000:
        return arb >> 29, pgn & 0x3FF00, source, pgn & 0xFF
    return arb >> 29, pgn, source, BROADCAST
