"""The UBX messages that are read here, as values in SI units (u-blox F9 HPG 1.32 interface description). Unknown is None.

A reader takes a payload and raises FormatError, whose text is a reason without numbers from outside.
"""

import math
import struct
from collections.abc import Callable
from typing import Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.lines.utc import utc_ns

NAV_DOP, NAV_PVT, NAV_RELPOSNED = 0x0104, 0x0107, 0x013C
NAMES: Final = {
    NAV_DOP: "NAV-DOP",
    NAV_PVT: "NAV-PVT",
    NAV_RELPOSNED: "NAV-RELPOSNED",
    0x0103: "NAV-STATUS",
    0x0135: "NAV-SAT",
    0x0500: "ACK-NAK",
    0x0501: "ACK-ACK",
}
_CORRECTION_AGES: Final = (None, 1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 90.0, 120.0)  # the upper end of each
CORRECTIONS_OLD_S: Final = 121.0  # stands for "more than 120 s"
_ACCURACY_MAX_M: Final = 10_000.0  # a receiver without a fix tells 4,294,967 m
_SPEED_MAX_MPS: Final = 200.0
_CARRIER: Final = {1: 6, 2: 5}  # float and fixed, as Navigation.fix
_WEEK_MS: Final = 7 * 86_400_000


class Solution(NamedTuple):
    """NAV-PVT: position, velocity and time of one instant."""

    week_ms: int  # GPS time of week
    utc_ns: int | None  # since 1970
    fix: int  # as delfim.canproxy.dsor.messages.Navigation.fix
    satellites: int
    latitude_rad: float | None
    longitude_rad: float | None
    north_mps: float | None
    east_mps: float | None
    accuracy_m: float | None  # of the position in the plane
    velocity_accuracy_mps: float | None
    corrections_s: float | None  # age of the last one, at most; CORRECTIONS_OLD_S: more than 120 s
    height_m: float | None = None  # of the antenna above the ellipsoid; None without a fix in three dimensions


class Baseline(NamedTuple):
    """NAV-RELPOSNED: from the base's antenna to the rover's."""

    bearing_rad: float | None  # 0..2 pi, true north; None: the receiver knows none
    accuracy_rad: float
    length_m: float
    is_fixed: bool  # with all ambiguities of the carrier's phase solved
    is_moving: bool  # the base is aboard


class DilutionOfPrecision(NamedTuple):
    """NAV-DOP: dilution of precision."""

    hdop: float


Message = Solution | Baseline | DilutionOfPrecision
_PVT: Final = struct.Struct("<IHBBBBBBIiBBBBiiiiIIiiiiiIIHH4xihH")
_RELPOSNED: Final = struct.Struct("<BxHIiiiii4xbbbbIIIII4xI")
_DOP: Final = struct.Struct("<IHHHHHHH")


def _pvt(payload: bytes) -> Solution:
    """Parse NAV-PVT, whose gnssFixOK says whether it is a fix. Reckoning alone and time alone are no fix, and neither is an
    invalid position."""
    week_ms, year, month, day, hour, minute, second, valid, _, nano, kind, flags, _, satellites, *rest = _PVT.unpack(payload)
    longitude, latitude, height_mm, _, accuracy_mm, _, north, east, _, _, _, velocity_accuracy, _, _, flags3, _, _, _ = rest
    if week_ms >= _WEEK_MS:
        raise FormatError("no time of week")
    at_ns = utc_ns(year, month, day, hour, minute, second, nano) if valid & 7 == 7 else None
    age = flags3 >> 1 & 15
    corrections_s = _CORRECTION_AGES[age] if age < len(_CORRECTION_AGES) else CORRECTIONS_OLD_S
    if not flags & 1 or kind not in (2, 3, 4) or flags3 & 1:
        return Solution(week_ms, at_ns, 0, satellites, None, None, None, None, None, None, corrections_s)
    if not (abs(latitude) <= 900_000_000 and abs(longitude) <= 1_800_000_000):
        raise FormatError("impossible position")
    if max(abs(north), abs(east)) > 1000.0 * _SPEED_MAX_MPS:
        raise FormatError("impossible speed")
    fix = _CARRIER.get(flags >> 6) or (4 if flags & 2 else 2 if kind == 2 else 3)
    return Solution(
        week_ms,
        at_ns,
        fix,
        satellites,
        math.radians(latitude / 1e7),
        math.radians(longitude / 1e7),
        north / 1000.0,
        east / 1000.0,
        _accuracy(accuracy_mm),
        _accuracy(velocity_accuracy),
        corrections_s,
        None if kind == 2 else height_mm / 1000.0,
    )


def _accuracy(thousandths: int) -> float | None:
    return thousandths / 1000.0 if 0 < thousandths < 1000.0 * _ACCURACY_MAX_M else None


def _relposned(payload: bytes) -> Baseline:
    version, _, _, _, _, _, length_cm, bearing, _, _, _, finer, _, _, _, _, accuracy, flags = _RELPOSNED.unpack(payload)
    if version != 1:
        raise FormatError("of another version")
    if not abs(bearing) <= 36_000_000:
        raise FormatError("impossible heading")
    known = flags & 1 and flags & 4 and flags & 0x100
    return Baseline(
        math.radians(bearing / 1e5) % math.tau if known else None,
        math.radians(accuracy / 1e5),
        length_cm / 100.0 + finer / 1e4,
        flags >> 3 & 3 == 2,
        bool(flags & 0x20),
    )


def _dop(payload: bytes) -> DilutionOfPrecision:
    return DilutionOfPrecision(_DOP.unpack(payload)[5] / 100.0)


READERS: Final[dict[int, tuple[int, Callable[[bytes], Message]]]] = {  # with the length of the payload
    NAV_DOP: (_DOP.size, _dop),
    NAV_PVT: (_PVT.size, _pvt),
    NAV_RELPOSNED: (_RELPOSNED.size, _relposned),
}
