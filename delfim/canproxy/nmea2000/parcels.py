"""Whole messages that are to be sent on an NMEA 2000 bus, and the identifiers of those that have a destination."""

from typing import Final, NamedTuple

from delfim.base.frames import CAN_IDE, extended
from delfim.canproxy.nmea2000.fastpacket import split

EVERYBODY: Final = 255
NOBODY: Final = 254  # the source of a device that has no address

ACKNOWLEDGE: Final = 59392
REQUEST: Final = 59904
CLAIM: Final = 60928
GROUP_FUNCTION: Final = 126208
PGN_LIST: Final = 126464
ALERT: Final = 126983
ALERT_TEXT: Final = 126985
HEARTBEAT: Final = 126993
PRODUCT: Final = 126996
CONFIGURATION: Final = 126998
RUDDER: Final = 127245
ENGINE_RAPID: Final = 127488
ENGINE: Final = 127489
DC_STATUS: Final = 127506
BATTERY: Final = 127508
CROSS_TRACK: Final = 129283
ROUTE: Final = 129284

# Those that are fast packets, however short they are. Of the ones in `pgns` only 129029.
_FAST: Final = {GROUP_FUNCTION, PGN_LIST, ALERT, ALERT_TEXT, PRODUCT, CONFIGURATION, ENGINE, DC_STATUS, ROUTE, 129029}
_ADDRESSED: Final = 240  # PDU formats below this carry a destination in place of the low byte of their PGN


class Parcel(NamedTuple):
    """One whole message; `source` is the address of the sender."""

    pgn: int
    data: bytes
    source: int
    priority: int = 6
    destination: int = EVERYBODY  # matters to PGNs that have one


ROLL_CALL: Final = Parcel(REQUEST, CLAIM.to_bytes(3, "little"), NOBODY)  # all devices are to say which address they have


def frames(parcel: Parcel, sequence: int) -> list[tuple[int, bytes]]:
    """(arbitration field, data) of each frame, in their order. `sequence` counts the messages of this PGN."""
    low = parcel.destination if parcel.pgn >> 8 & 0xFF < _ADDRESSED else parcel.pgn & 0xFF
    arb = extended(parcel.priority << 26 | (parcel.pgn & 0x3FF00 | low) << 8 | parcel.source)
    return [(arb, part) for part in (split(parcel.data, sequence) if parcel.pgn in _FAST else [parcel.data])]


def addressed(arb: int) -> tuple[int, int, int]:
    """PGN, source and destination of an extended frame whose PGN has a destination."""
    return arb >> 11 & 0x3FF00, arb >> 3 & 0xFF, arb >> 11 & 0xFF


def any_of(*pgns: int) -> tuple[tuple[int, int], ...]:
    """The filters (arb, mask) to bind a socket to, set mask bits = don't care: these PGNs that have a destination, from and to
    anybody."""
    return tuple((extended(pgn << 8), extended(7 << 26 | 0xFFFF) & ~CAN_IDE) for pgn in pgns)
