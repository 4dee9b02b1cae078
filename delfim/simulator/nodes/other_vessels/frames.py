"""AIS as a receiver sends it over NMEA 2000: the inverse of `delfim.canproxy.nmea2000.ais`, with the same layouts.

PGN 129038 and 129039 are positions of class A and B, 129794, 129809 and 129810 names and sizes. What is None is sent as not
available.
"""

import math
import struct
from collections.abc import Iterator
from typing import Final

from delfim.base.frames import Frame, extended
from delfim.base.vessels import VesselFacts, VesselPosition
from delfim.canproxy.nmea2000.ais import NAME_B, POSITION_A, POSITION_B, SIZE_B, STATIC_A
from delfim.canproxy.nmea2000.fastpacket import split

AIS_RECEIVER: Final = 60  # its address
_U16, _U8 = 0xFFFF, 0xFF
_NOWHERE: Final = 0x7FFFFFFF
_OWN, _CHANNEL_A = 4, 0  # of the transceiver: own information, not broadcast; or heard on channel A
_PRIORITY: Final = {POSITION_A: 4, POSITION_B: 4}  # all others: 6
_POSITION: Final = struct.Struct("<BIiiBHHHBH")
_A_REST: Final = struct.Struct("<hBBB")
_B_REST: Final = bytes((_U8, 0x04, 0, _U8))  # a unit of class B "CS"
_STATIC_A: Final = struct.Struct("<BII7s20sBHHHHHIH20sBBB")
_NAME_B: Final = struct.Struct("<BI20sBB")
_SIZE_B: Final = struct.Struct("<BIB7s7sHHHHIBBB")


def position(told: VesselPosition, status: int | None, second: int, *, is_own: bool = False) -> tuple[int, bytes]:
    """PGN and data of a position. A `status`, 0..15 of ITU-R M.1371, makes it one of class A. `second`: of UTC, 0..59."""
    transceiver = (_OWN if is_own else _CHANNEL_A) << 3
    heading = _angle(told.heading_rad)
    head = _POSITION.pack(
        1 if status is not None else 18,
        told.mmsi,
        _place(told.longitude_rad),
        _place(told.latitude_rad),
        second << 2,
        _angle(told.course_rad),
        _U16 if told.speed_mps is None else round(told.speed_mps * 100.0),
        0,
        transceiver,
        heading,
    )
    if status is None:
        return POSITION_B, head + _B_REST
    rate = 0x7FFF if told.rate_radps is None else max(min(round(told.rate_radps / 3.125e-5), 0x7FF0), -0x7FF0)
    return POSITION_A, head + _A_REST.pack(rate, 0xF0 | status, _U8, _U8)


def facts(told: VesselFacts, is_class_a: bool) -> Iterator[tuple[int, bytes]]:
    """PGN and data of each message of name and size; class B has two."""
    size = [_tenths(each) for each in (told.length_m, told.beam_m, told.from_starboard_m, told.from_bow_m)]
    name, sign, kind = _text(told.name, 20), _text(told.call_sign, 7), told.kind or 0
    if is_class_a:
        rest = (_U16, 0xFFFFFFFF, _U16, _text(None, 20), 0, 0, _U8)
        yield STATIC_A, _STATIC_A.pack(5, told.mmsi, 0, sign, name, kind, *size, *rest)
    else:
        yield NAME_B, _NAME_B.pack(24, told.mmsi, name, 0, _U8)
        yield SIZE_B, _SIZE_B.pack(24, told.mmsi, kind, _text(None, 7), sign, *size, 0, 0, 0, _U8)


def framed(pgn: int, data: bytes, sequence: int) -> list[Frame]:
    """The frames of a fast packet. `sequence` counts the messages of this PGN."""
    arb = extended(_PRIORITY.get(pgn, 6) << 26 | pgn << 8 | AIS_RECEIVER)
    return [Frame(arb, part) for part in split(data, sequence)]


def _place(angle_rad: float | None) -> int:
    return _NOWHERE if angle_rad is None else round(math.degrees(angle_rad) * 1e7)


def _angle(angle_rad: float | None) -> int:
    return _U16 if angle_rad is None else round(angle_rad % math.tau * 1e4) % 62_832


def _tenths(length_m: float | None) -> int:
    return _U16 if length_m is None else round(length_m * 10.0)


def _text(words: str | None, width: int) -> bytes:
    return (words or "").upper().encode("ascii", "replace")[:width].ljust(width, b"@")
