"""AIS over NMEA 2000: other vessels, as a receiver or transponder reports them. Whole fast packets in, values out.

PGN 129038 and 129039 are positions of class A and B, 129794, 129809 and 129810 names and sizes. Layouts are those that the
canboat project documents. A value that the vessel does not tell is None.
"""

import math
import struct
from typing import Final

from delfim.base.errors import FormatError
from delfim.base.vessels import MMSI_MAX, STATUS_UNKNOWN, Report, VesselFacts, VesselPosition, readable

POSITION_A: Final = 129038
POSITION_B: Final = 129039
STATIC_A: Final = 129794
NAME_B: Final = 129809
SIZE_B: Final = 129810
PGNS: Final = frozenset({POSITION_A, POSITION_B, STATIC_A, NAME_B, SIZE_B})
_U16, _CIRCLE = 0xFFFD, 62_832  # the first reserved value; 2 pi in 1e-4 rad
_RATE_RADPS: Final = 3.125e-5
_POSITION: Final = struct.Struct("<BIiiBHH3sHh")
_STATIC_A: Final = struct.Struct("<BII7s20sBHHHH")
_NAME_B: Final = struct.Struct("<BI20s")
_SIZE_B: Final = struct.Struct("<BIB7s7sHHHH")
_OWN_AT: Final = {STATIC_A: 74, NAME_B: 25, SIZE_B: 33}  # byte of the transceiver information
_OWN: Final = frozenset({2, 3, 4})  # transceiver information: sent on channel A, on B, not broadcast; 0 and 1 are received

_Sizes = tuple[float | None, float | None, float | None, float | None]


def decode(pgn: int, data: bytes) -> Report:
    """Decode one complete message. Raises FormatError where it is too short, or is about a vessel without a number."""
    try:
        match pgn:
            case 129038 | 129039:
                told: Report = _position(pgn, data)
            case 129794:
                _, mmsi, _imo, call_sign, name, kind, *size = _STATIC_A.unpack_from(data)
                told = VesselFacts(mmsi, _text(name), _text(call_sign), _kind(kind), *_sizes(*size))
            case 129809:
                _, mmsi, name = _NAME_B.unpack_from(data)
                told = VesselFacts(mmsi, _text(name), None, None, None, None, None, None)
            case 129810:
                _, mmsi, kind, _vendor, call_sign, *size = _SIZE_B.unpack_from(data)
                told = VesselFacts(mmsi, None, _text(call_sign), _kind(kind), *_sizes(*size))
            case _:
                raise FormatError(f"PGN {pgn} is not of AIS")
    except struct.error:
        raise FormatError(f"{len(data)} bytes are too few") from None
    if not 0 < told.mmsi <= MMSI_MAX:
        raise FormatError("no vessel has such a number")
    return told._replace(is_own=True) if (at := _OWN_AT.get(pgn)) is not None and _is_own(data, at) else told


def _position(pgn: int, data: bytes) -> VesselPosition:
    """Decode a position. Latitude 91 and longitude 181 degrees, course and heading of a turn or more mean unknown."""
    _, mmsi, longitude, latitude, taken, course, speed, radio, heading, rate = _POSITION.unpack_from(data)
    is_a, second = pgn == POSITION_A, taken >> 2
    return VesselPosition(
        mmsi,
        math.radians(latitude * 1e-7) if abs(latitude) <= 900_000_000 else None,
        math.radians(longitude * 1e-7) if abs(longitude) <= 1_800_000_000 else None,
        course * 1e-4 if course < _CIRCLE else None,
        speed * 0.01 if speed < _U16 else None,
        heading * 1e-4 if heading < _CIRCLE else None,
        rate * _RATE_RADPS if is_a and rate < 0x7FFD else None,
        "A" if is_a else "B",
        data[_POSITION.size] & 0xF if is_a and len(data) > _POSITION.size else STATUS_UNKNOWN,
        second if second < 60 else None,
        radio[2] >> 3 in _OWN,
    )


def _is_own(data: bytes, at: int) -> bool:
    """Whether a message is about the boat itself; old receivers leave this field out."""
    return len(data) > at and data[at] & 0x1F in _OWN


def _sizes(length: int, beam: int, from_starboard: int, from_bow: int) -> _Sizes:
    return _tenths(length), _tenths(beam), _tenths(from_starboard), _tenths(from_bow)


def _tenths(raw: int) -> float | None:
    return raw * 0.1 if raw < _U16 else None


def _kind(raw: int) -> int | None:
    return raw if raw < 0xFD else None


def _text(raw: bytes) -> str | None:
    return readable(raw.decode("latin-1"))
