"""APB, RMB and XTE: the line along which survey software or a plotter steers a boat, as it steers any autopilot
(docs/guest.md)."""

import math
from typing import Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.lines.nmea0183.proprietary import number

MILE_M: Final = 1852.0
CROSS_MAX_M: Final = 100.0 * MILE_M
NEAR_M: Final = 0.01 * MILE_M  # nearer to the destination RMB does not tell the direction of the line
_UNITS: Final = {"N": MILE_M, "K": 1000.0}
_VOID: Final = frozenset("EMSN")  # modes of a position that was reckoned, typed in, simulated, or is none


class TrackLine(NamedTuple):
    """A line, and the boat's cross-track error from it."""

    cross_m: float | None  # positive: boat to starboard of the line; None: the sender warns, or the line is behind the boat
    course_rad: float | None  # of the line; None: XTE does not tell it
    is_magnetic: bool = False


INVALID: Final = TrackLine(None, None)


def track_line(f: list[str]) -> TrackLine | None:
    """Parse the line from the fields of a sentence; None for any other sentence. Raises FormatError, also where the fields are
    too few to steer by."""
    form = f[0][2:] if len(f[0]) == 5 else ""
    try:
        match form:
            case "APB":
                return _apb(f)
            case "RMB":
                return _rmb(f)
            case "XTE":
                return INVALID if _warns(f[1:3], f[6:7]) else TrackLine(_cross_m(*f[3:6]), None)
    except (ValueError, IndexError, TypeError) as error:
        raise FormatError(f"{form}: {error}") from None
    return None


def _apb(f: list[str]) -> TrackLine:
    """Parse APB: the bearing from origin to destination is the line's. Once its end is passed abeam (field 7) there is none."""
    if _warns(f[1:3], f[15:16]) or f[7] == "A":
        return INVALID
    if f[9] not in ("T", "M"):
        raise FormatError("APB: bearing neither true nor magnetic")
    return TrackLine(_cross_m(*f[3:6]), _bearing_rad(f[8]), f[9] == "M")


def _rmb(f: list[str]) -> TrackLine:
    """Parse RMB: it has the bearing of the destination and the distance to it; the line's direction follows from these."""
    cross_m, range_m = _cross_m(f[2], f[3], "N"), MILE_M * _known(f[10])
    if _warns(f[1:2], f[14:15]) or range_m < max(NEAR_M, abs(cross_m)):
        return INVALID
    return TrackLine(cross_m, (_bearing_rad(f[11]) + math.asin(cross_m / range_m)) % math.tau)


def _warns(flags: list[str], mode: list[str]) -> bool:
    return any(flag != "A" for flag in flags) or bool(_VOID.intersection(mode))


def _cross_m(distance: str, side: str, unit: str) -> float:
    """The cross-track error, m; `side` is the side to which the boat must steer."""
    away_m = _known(distance) * _UNITS.get(unit, math.nan)
    if side not in ("L", "R") or not 0.0 <= away_m <= CROSS_MAX_M:
        raise FormatError("cross-track error out of range, or without its side or unit")
    return away_m if side == "L" else -away_m


def _bearing_rad(text: str) -> float:
    if not 0.0 <= (bearing := _known(text)) <= 360.0:
        raise FormatError("bearing out of range")
    return math.radians(bearing) % math.tau


def _known(text: str) -> float:
    if (value := number(text)) is None:
        raise FormatError("a number is missing")
    return value
