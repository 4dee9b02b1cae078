"""Navigation as NMEA 0183 sentences, for sonar and survey software. An unknown value is not sent: an empty HDT makes more
trouble than silence.

Talker GP throughout, as the programs that read RMC and HDT expect it from a receiver with heading; TI for the rate of turn.
"""

import math
from datetime import UTC, datetime
from functools import lru_cache
from typing import Final

from delfim.canproxy.dsor.messages import Navigation
from delfim.lines.nmea0183.framing import framed
from delfim.lines.nmea0183.sentences import KNOT

COURSE_MPS: Final = 0.1  # a slower boat has no course over ground
_DAY_NS: Final = 86_400_000_000_000
_QUALITY: Final = {2: 1, 3: 1, 4: 2, 5: 4, 6: 5}
_MODE: Final = {2: "A", 3: "A", 4: "D", 5: "R", 6: "F"}


def rmc(n: Navigation) -> bytes:
    """RMC: position, speed and course with date and time; empty while position or time is unknown."""
    if (place := _place(n)) is None:
        return b""
    speed, course = _movement(n) or ("", "")
    date = _date(n.utc_ns // _DAY_NS)
    return framed(f"GPRMC,{clock(n.utc_ns)},A,{place},{speed},{course},{date},,,{_MODE.get(n.fix, 'A')}")


def gga(n: Navigation) -> bytes:
    """GGA: position with its quality; empty while position or time is unknown. The altitude is not known here."""
    if (place := _place(n)) is None:
        return b""
    hdop = "" if n.hdop is None else f"{n.hdop:.1f}"
    age = "" if n.corrections_s is None else f"{min(n.corrections_s, 999.0):.1f}"
    return framed(f"GPGGA,{clock(n.utc_ns)},{place},{_QUALITY.get(n.fix, 1)},{n.satellites:02d},{hdop},,M,,M,{age},")


def hdt(n: Navigation) -> bytes:
    """HDT: true heading."""
    return b"" if n.heading_rad is None else framed(f"GPHDT,{_degrees(n.heading_rad)},T")


def vtg(n: Navigation) -> bytes:
    """VTG: course and speed over ground."""
    if (movement := _movement(n)) is None:
        return b""
    speed, course = movement
    kmh = math.hypot(n.north_mps or 0.0, n.east_mps or 0.0) * 3.6
    return framed(f"GPVTG,{course},T,,M,{speed},N,{kmh:.3f},K,{_MODE.get(n.fix, 'A')}")


def rot(n: Navigation) -> bytes:
    """ROT: rate of turn, degrees a minute, positive to starboard."""
    return b"" if n.yaw_rate_radps is None else framed(f"TIROT,{math.degrees(n.yaw_rate_radps) * 60.0:.2f},A")


SPEAKERS: Final = {"RMC": rmc, "HDT": hdt, "GGA": gga, "VTG": vtg, "ROT": rot}


def _place(n: Navigation) -> str | None:
    """Position as four fields, minutes with six decimals (2 mm)."""
    if n.latitude_rad is None or n.longitude_rad is None or not n.utc_ns or not n.fix:
        return None
    return halves(n.latitude_rad, n.longitude_rad)


@lru_cache(1)  # GGA and RMC tell the same place and time
def halves(latitude_rad: float, longitude_rad: float) -> str:
    """A position as four fields."""
    return f"{_half(latitude_rad, 2, 'NS')},{_half(longitude_rad, 3, 'EW')}"


def _half(angle_rad: float, digits: int, sides: str) -> str:
    degrees, minutes_1e6 = divmod(round(abs(math.degrees(angle_rad)) * 60e6), 60_000_000)
    return f"{degrees:0{digits}d}{minutes_1e6 // 1_000_000:02d}.{minutes_1e6 % 1_000_000:06d},{sides[angle_rad < 0.0]}"


def _movement(n: Navigation) -> tuple[str, str] | None:
    """Speed in knots, and course, which a boat at rest does not have."""
    if n.north_mps is None or n.east_mps is None:
        return None
    speed_mps = math.hypot(n.north_mps, n.east_mps)
    return f"{speed_mps / KNOT:.3f}", _degrees(math.atan2(n.east_mps, n.north_mps)) if speed_mps >= COURSE_MPS else ""


def _degrees(angle_rad: float) -> str:
    return f"{round(math.degrees(angle_rad) * 100.0) % 36_000 / 100.0:06.2f}"


@lru_cache(1)
def _date(day: int) -> str:
    """The date of a day since 1970 as a field."""
    return f"{datetime.fromtimestamp(86_400 * day, UTC):%d%m%y}"


def clock(utc_ns: int) -> str:
    """The time of day as a field."""
    return _clock(utc_ns % _DAY_NS // 10_000_000)


@lru_cache(1)
def _clock(day_cs: int) -> str:
    seconds, hundredths = divmod(day_cs, 100)
    return f"{seconds // 3600:02d}{seconds // 60 % 60:02d}{seconds % 60:02d}.{hundredths:02d}"
