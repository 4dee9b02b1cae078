"""AIS over NMEA 2000: other vessels, as a receiver or transponder tells them. Fast packets, put together: bytes in, values out.

PGN 129038 and 129039 are positions of class A and B, 129794, 129809 and 129810 names and sizes. Layouts are those that the
canboat project documents. What the vessel does not tell is None.
"""

import math
import struct
from typing import Final, NamedTuple

from delfim.errors import FormatError

POSITION_A: Final = 129038
POSITION_B: Final = 129039
STATIC_A: Final = 129794
NAME_B: Final = 129809
SIZE_B: Final = 129810
PGNS: Final = frozenset({POSITION_A, POSITION_B, STATIC_A, NAME_B, SIZE_B})
MMSI_MAX: Final = 999_999_999
_U16, _CIRCLE = 0xFFFD, 62_832  # the first reserved value; 2 pi in 1e-4 rad
_RATE_RADPS: Final = 3.125e-5
_POSITION: Final = struct.Struct("<BIiiBHH3sHh")
_STATIC_A: Final = struct.Struct("<BII7s20sBHHHH")
_NAME_B: Final = struct.Struct("<BI20s")
_SIZE_B: Final = struct.Struct("<BIB7s7sHHHH")


class VesselPosition(NamedTuple):
    """Where a vessel is, and how it moves."""

    mmsi: int
    latitude_rad: float | None
    longitude_rad: float | None
    course_rad: float | None  # over ground, 0..2 pi, true
    speed_mps: float | None  # over ground
    heading_rad: float | None  # 0..2 pi, true
    rate_radps: float | None  # positive to starboard; class A alone


class VesselFacts(NamedTuple):
    """What a vessel is. A part of them comes in each message of class B."""

    mmsi: int
    name: str | None
    call_sign: str | None
    kind: int | None  # of ITU-R M.1371: 30 fishing, 36 sailing, 70 cargo, 80 tanker, ...
    length_m: float | None
    beam_m: float | None
    from_starboard_m: float | None  # of the antenna
    from_bow_m: float | None


def decode(pgn: int, data: bytes) -> VesselPosition | VesselFacts:
    """One complete message. Raises FormatError where it is too short, or of a vessel that has no number."""
    try:
        match pgn:
            case 129038 | 129039:
                told: VesselPosition | VesselFacts = _position(pgn, data)
            case 129794:
                _, mmsi, _imo, call_sign, name, kind, *size = _STATIC_A.unpack_from(data)
                told = VesselFacts(mmsi, _text(name), _text(call_sign), _kind(kind), *map(_tenths, size))
            case 129809:
                _, mmsi, name = _NAME_B.unpack_from(data)
                told = VesselFacts(mmsi, _text(name), *[None] * 6)
            case 129810:
                _, mmsi, kind, _vendor, call_sign, *size = _SIZE_B.unpack_from(data)
                told = VesselFacts(mmsi, None, _text(call_sign), _kind(kind), *map(_tenths, size))
            case _:
                raise FormatError(f"PGN {pgn} is not of AIS")
    except struct.error:
        raise FormatError(f"{len(data)} bytes are too few") from None
    if not 0 < told.mmsi <= MMSI_MAX:
        raise FormatError("no vessel has such a number")
    return told


def _position(pgn: int, data: bytes) -> VesselPosition:
    """Latitude 91 and longitude 181 degrees, course and heading of a turn or more mean that they are not known."""
    _, mmsi, longitude, latitude, _, course, speed, _, heading, rate = _POSITION.unpack_from(data)
    return VesselPosition(
        mmsi,
        math.radians(latitude * 1e-7) if abs(latitude) <= 900_000_000 else None,
        math.radians(longitude * 1e-7) if abs(longitude) <= 1_800_000_000 else None,
        course * 1e-4 if course < _CIRCLE else None,
        speed * 0.01 if speed < _U16 else None,
        heading * 1e-4 if heading < _CIRCLE else None,
        rate * _RATE_RADPS if pgn == POSITION_A and rate < 0x7FFD else None,
    )


def _tenths(raw: int) -> float | None:
    return raw * 0.1 if raw < _U16 else None


def _kind(raw: int) -> int | None:
    return raw if raw < 0xFD else None


def _text(raw: bytes) -> str | None:
    """Up to the first unused character; whatever no AIS has is left out."""
    used = raw.split(b"\x00")[0].split(b"@")[0].split(b"\xff")[0]
    return "".join(chr(each) for each in used if 32 <= each < 127).strip() or None
