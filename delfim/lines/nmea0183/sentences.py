"""The NMEA 0183 sentences that are read here, as values in SI units. One row in READERS for each formatter.

Unknown is None. A reader takes the fields of a sentence, the first of which is its address, and raises FormatError, whose text
is a reason without numbers from outside. Which fields mean what, and which receivers disagree: docs/nmea0183.md.
"""

import math
import re
from collections.abc import Callable
from datetime import UTC, datetime
from functools import lru_cache
from typing import Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.base.vessels import readable
from delfim.lines.nmea0183.aissentences import AisPart, part

KNOT: Final = 1852.0 / 3600.0  # m/s
FOOT, FATHOM = 0.3048, 1.8288  # m
SPEED_MAX_MPS: Final = 200.0
TURN_MAX_RADPS: Final = 4.0 * math.tau
DEPTH_MAX_M: Final = 12_000.0
CORRECTIONS_MAX_S: Final = 1e5  # a receiver that had corrections long ago may still tell their age
HEIGHT_MAX_M: Final = 20_000.0
_NUMBER: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)").fullmatch
_CLOCK: Final = re.compile(r"\d{6}(\.\d*)?").fullmatch
_QUALITY: Final = {"0": 0, "1": 3, "2": 4, "3": 3, "4": 5, "5": 6}  # GGA; reckoned, typed and simulated (6, 7, 8) are no fix
_MODE: Final = {"A": 3, "D": 4, "P": 3, "R": 5, "F": 6, "E": 0, "M": 0, "S": 0, "N": 0}  # RMC, VTG, GLL, GNS
_once = lru_cache(4)  # of an instant that a receiver tells in several sentences: one is parsed, the others are looked up
_new = tuple.__new__  # in half the time of Located(...): for the sentences that come ten times a second
_DISTANCE_UNIT: Final = {"K": 1000.0, "N": 1852.0, "S": 1609.344}  # m; speeds are so many an hour
_SPEED_UNIT: Final = {"N": KNOT, "M": 1.0, "K": 1.0 / 3.6, "S": 1609.344 / 3600.0}


class Located(NamedTuple):
    """GGA, GNS, GLL, RMC: a position, or the report that there is none."""

    day_s: float | None  # time of the UTC day
    latitude_rad: float | None
    longitude_rad: float | None
    fix: int | None  # as `Navigation.fix`, 2 where the sentence does not tell more than that there is one
    satellites: int | None = None
    hdop: float | None = None
    utc_ns: int | None = None  # since 1970; RMC alone has the date
    movement: "Movement | None" = None  # RMC
    variation_rad: float | None = None  # RMC; east positive
    corrections_s: float | None = None  # GGA, GNS: age of the differential corrections
    height_m: float | None = None  # GGA: of the antenna above the ellipsoid of WGS 84


class Movement(NamedTuple):
    """VTG, RMC: course and speed over ground."""

    course_rad: float | None  # 0..2 pi, true
    magnetic_rad: float | None  # 0..2 pi, the same course from magnetic north
    speed_mps: float | None
    deviation_mps: float = 0.0  # standard deviation per axis; 0: not told


class Bearing(NamedTuple):
    """HDT, THS, HDG, HDM: the boat's heading, from true or from magnetic north."""

    true_rad: float | None  # 0..2 pi
    magnetic_rad: float | None = None  # 0..2 pi, deviation included
    variation_rad: float | None = None  # east positive
    deviation_rad: float = 0.0  # standard deviation; 0: not told


class Turning(NamedTuple):
    """ROT: rate of turn."""

    rate_radps: float | None  # positive to starboard


class DateTime(NamedTuple):
    """ZDA: date and time."""

    utc_ns: int | None  # since 1970


class Spread(NamedTuple):
    """GST: standard deviations as the receiver states them."""

    north_m: float | None
    east_m: float | None


class ActiveSatellites(NamedTuple):
    """GSA: kind of the fix, and its dilution of precision."""

    dimensions: int | None  # 0 (no fix), 2, 3
    hdop: float | None


class Sounding(NamedTuple):
    """DPT, DBT: depth of the water."""

    depth_m: float | None  # below the transducer
    offset_m: float | None = None  # above zero: from the transducer to the water line; below: to the keel


class Breeze(NamedTuple):
    """MWV: wind."""

    angle_rad: float | None  # 0..2 pi, from the bow, clockwise, where the wind comes from
    speed_mps: float | None
    is_apparent: bool  # as felt aboard; otherwise over the water


class Measurement(NamedTuple):
    """XDR: one measured value."""

    kind: str  # A angle, C temperature, P pressure, ...
    value: float | None
    unit: str  # D degrees, C Celsius, B bar, ...
    name: str


class RadarTarget(NamedTuple):
    """TTM, TLL: a target that a radar tracks."""

    number: int
    name: str | None
    place: tuple[float, float] | None = None  # TLL: latitude_rad, longitude_rad
    distance_m: float = 0.0  # TTM: from the boat
    bearing_rad: float = 0.0  # 0..2 pi
    is_from_bow: bool = False  # that bearing; otherwise from true north
    course_rad: float | None = None  # true, over ground
    speed_mps: float | None = None


Message = (
    Located
    | Movement
    | Bearing
    | Turning
    | DateTime
    | Spread
    | ActiveSatellites
    | Sounding
    | Breeze
    | tuple[Measurement, ...]
    | AisPart
    | RadarTarget
    | None
)


def _number(text: str) -> float | None:
    if not text:
        return None
    if not _NUMBER(text):
        raise FormatError("not a number")
    return float(text)


def _within(text: str, most: float, least: float = 0.0) -> float | None:
    if not text:
        return None
    if not _NUMBER(text):
        raise FormatError("not a number")
    value = float(text)
    if not least <= value <= most:
        raise FormatError("out of range")
    return value


def _angle(text: str) -> float | None:
    """Parse an angle of 0 to 360 degrees."""
    value = _within(text, 360.0)
    return None if value is None else math.radians(value) % math.tau


def _signed(text: str, side: str) -> float | None:
    """Parse an angle with E (positive) or W."""
    if not text or (value := _within(text, 180.0)) is None:
        return None
    if value and side not in ("E", "W"):
        raise FormatError("neither east nor west")
    return math.radians(-value if side == "W" else value)


def _speed(text: str, unit: str) -> float | None:
    factor = _SPEED_UNIT.get(unit)
    value = _number(text)
    if value is None:
        return None
    if factor is None:
        raise FormatError("unit unknown")
    if not 0.0 <= value * factor <= SPEED_MAX_MPS:
        raise FormatError("out of range")
    return value * factor


def _half(text: str, side: str, sides: str, limit_rad: float) -> float:
    """Parse a latitude or longitude: degrees and two digits of minutes in one number, with any number of decimals."""
    value = _within(text, 18_000.0)
    if value is None or not side or side not in sides:
        raise FormatError("position incomplete")
    degrees, minutes = divmod(value, 100.0)
    angle_rad = math.radians(degrees + minutes / 60.0)
    if minutes >= 60.0 or angle_rad > limit_rad:
        raise FormatError("no such position")
    return -angle_rad if side == sides[1] else angle_rad


@_once
def _position(latitude: str, ns: str, longitude: str, ew: str) -> tuple[float, float] | tuple[None, None]:
    if not latitude and not longitude:
        return None, None
    return _half(latitude, ns, "NS", math.pi / 2.0), _half(longitude, ew, "EW", math.pi)


@_once
def _day_s(text: str) -> float | None:
    """Parse hhmmss.ss to seconds of the day."""
    if not text:
        return None
    if not _CLOCK(text):
        raise FormatError("not a time")
    hours, minutes, seconds = int(text[:2]), int(text[2:4]), float(text[4:])
    if hours > 23 or minutes > 59 or seconds >= 61.0:  # a leap second has the number 60
        raise FormatError("not a time")
    return 3600.0 * hours + 60.0 * minutes + seconds


def _utc_ns(day_s: float | None, year: str, month: str, day: str) -> int | None:
    if day_s is None or not (year and month and day):
        return None
    return _midnight_s(year, month, day) * 1_000_000_000 + round(day_s * 1e9)


@_once
def _midnight_s(year: str, month: str, day: str) -> int:
    try:
        return round(datetime(int(year), int(month), int(day), tzinfo=UTC).timestamp())
    except (ValueError, OverflowError):
        raise FormatError("not a date") from None


def _mode(fields: list[str], index: int) -> int | None:
    """The fix that a mode letter states; None where an older sentence has none."""
    letter = fields[index] if len(fields) > index else ""
    return _MODE.get(letter, 0) if letter else None


def _gga(f: list[str]) -> Located:
    fix = _QUALITY.get(f[6], 0)
    latitude_rad, longitude_rad = _position(*f[2:6]) if fix else (None, None)
    age_s = _age(f, 13)
    told = (
        _day_s(f[1]),
        latitude_rad,
        longitude_rad,
        fix,
        _count(f[7]),
        _within(f[8], 1000.0),
        None,
        None,
        None,
        age_s,
        _height(f),
    )
    return _new(Located, told)


def _height(f: list[str]) -> float | None:
    """The antenna's height above the ellipsoid: that above the sea and the geoid's. None: not told; a position needs none."""
    both = (f[9], f[11]) if len(f) > 11 else ("", "")
    height_m = sum(float(each) for each in both) if all(map(_NUMBER, both)) else math.nan
    return height_m if abs(height_m) <= HEIGHT_MAX_M else None


def _gns(f: list[str]) -> Located:
    """Parse GNS, which has one letter for each system; the best of them counts."""
    fixes = [_MODE.get(letter, 0) for letter in f[6]]
    fix = next((good for good in (5, 6, 4, 3) if good in fixes), 0)
    latitude_rad, longitude_rad = _position(*f[2:6]) if fix else (None, None)
    age_s = _age(f, 11)
    return Located(_day_s(f[1]), latitude_rad, longitude_rad, fix, _count(f[7]), _within(f[8], 1000.0), corrections_s=age_s)


def _age(fields: list[str], index: int) -> float | None:
    """The age of differential corrections, s; None where there are none."""
    return _within(fields[index], CORRECTIONS_MAX_S) if len(fields) > index else None


def _gll(f: list[str]) -> Located:
    """Parse GLL, before version 2.0 without time and status."""
    is_valid = len(f) < 7 or f[6] == "A"
    fix = (2 if (mode := _mode(f, 7)) is None else mode) if is_valid else 0
    latitude_rad, longitude_rad = _position(*f[1:5]) if fix else (None, None)
    return Located(_day_s(f[5]) if len(f) > 5 else None, latitude_rad, longitude_rad, fix)


def _rmc(f: list[str]) -> Located:
    """Parse RMC. The navigational status of version 4.1, the last field, is V in most receivers: it is not used."""
    fix = (2 if (mode := _mode(f, 12)) is None else mode) if f[2] == "A" else 0
    has_variation = len(f) > 11 and not f[10].startswith("999")  # a number that some receivers say for "unknown"
    day_s, variation_rad = _day_s(f[1]), _signed(f[10], f[11]) if has_variation else None
    if not fix:
        return Located(day_s, None, None, 0, movement=Movement(None, None, None))
    latitude_rad, longitude_rad = _position(*f[3:7])
    movement = _new(Movement, (_angle(f[8]), None, _speed(f[7], "N"), 0.0))
    if f[9] and not (len(f[9]) == 6 and f[9].isdigit()):
        raise FormatError("not a date")
    century = "19" if f[9][4:] >= "80" else "20"
    utc_ns = _utc_ns(day_s, century + f[9][4:], f[9][2:4], f[9][:2]) if f[9] else None
    return _new(Located, (day_s, latitude_rad, longitude_rad, fix, None, None, utc_ns, movement, variation_rad, None, None))


def _vtg(f: list[str]) -> Movement:
    """Parse VTG, before version 2.0 without letters: the two courses, knots, km/h."""
    if _mode(f, 9) == 0:
        return Movement(None, None, None)
    true, magnetic, knots, kmh = (f[1], f[3], f[5], f[7]) if len(f) > 8 else f[1:5]
    return Movement(_angle(true), _angle(magnetic), _speed(knots, "N") if knots else _speed(kmh, "K"))


def _hdt(f: list[str]) -> Bearing:
    return Bearing(_angle(f[1]))


def _ths(f: list[str]) -> Bearing:
    """Parse THS. Estimated, typed, simulated and void headings count as none."""
    return Bearing(_angle(f[1]) if f[2] == "A" else None)


def _hdm(f: list[str]) -> Bearing:
    return Bearing(None, _angle(f[1]))


def _hdg(f: list[str]) -> Bearing:
    """Parse HDG. Sensor + deviation = magnetic; + variation = true."""
    sensor_rad, deviation_rad, variation_rad = _angle(f[1]), _signed(f[2], f[3]), _signed(f[4], f[5])
    if sensor_rad is None:
        return Bearing(None, None, variation_rad)
    magnetic_rad = (sensor_rad + (deviation_rad or 0.0)) % math.tau
    true_rad = None if variation_rad is None else (magnetic_rad + variation_rad) % math.tau
    return _new(Bearing, (true_rad, magnetic_rad, variation_rad, 0.0))


def _rot(f: list[str]) -> Turning:
    """Parse ROT: degrees a minute, port negative."""
    rate = _number(f[1]) if f[2] == "A" else None
    if rate is None:
        return Turning(None)
    if abs(rate_radps := math.radians(rate) / 60.0) > TURN_MAX_RADPS:
        raise FormatError("out of range")
    return _new(Turning, (rate_radps,))


def _zda(f: list[str]) -> DateTime:
    return DateTime(_utc_ns(_day_s(f[1]), f[4], f[3], f[2]))


def _gst(f: list[str]) -> Spread:
    return _new(Spread, (_within(f[6], 1e6), _within(f[7], 1e6)))


def _gsa(f: list[str]) -> ActiveSatellites:
    return ActiveSatellites({"1": 0, "2": 2, "3": 3}.get(f[2]), _within(f[16], 1000.0))


def _dpt(f: list[str]) -> Sounding:
    return Sounding(_within(f[1], DEPTH_MAX_M), _within(f[2], 100.0, -100.0))


def _dbt(f: list[str]) -> Sounding:
    """Parse DBT: feet, metres, fathoms; a device may leave out the units that it does not use."""
    feet, metres, fathoms = _within(f[1], 4e4), _within(f[3], DEPTH_MAX_M), _within(f[5], 1e4)
    if metres is not None:
        return Sounding(metres)
    if feet is not None:
        return Sounding(feet * FOOT)
    return Sounding(None if fathoms is None else fathoms * FATHOM)


def _mwv(f: list[str]) -> Breeze:
    if f[2] not in ("R", "T"):
        raise FormatError("neither apparent nor true")
    if f[5] != "A":
        return Breeze(None, None, f[2] == "R")
    return Breeze(_angle(f[1]), _speed(f[3], f[4]), f[2] == "R")


def _xdr(f: list[str]) -> tuple[Measurement, ...]:
    if len(f) % 4 != 1:
        raise FormatError("not in groups of four")
    return tuple(Measurement(f[i], _number(f[i + 1]), f[i + 2], f[i + 3]) for i in range(1, len(f), 4))


def _ttm(f: list[str]) -> RadarTarget | None:
    """Parse TTM. One that is lost, or not acquired yet, is none. A relative course does not say to what, and is unknown."""
    if f[12] != "T":
        return None
    unit, distance, bearing_rad = _DISTANCE_UNIT.get(f[10]), _within(f[2], 1000.0), _angle(f[3])
    if unit is None or f[4] not in ("T", "R"):
        raise FormatError("unit unknown" if unit is None else "neither true nor relative")
    if distance is None or bearing_rad is None:
        raise FormatError("position incomplete")
    speed = _within(f[5], 500.0) if f[7] == "T" and f[6] else None
    course_rad, speed_mps = (None, None) if speed is None else (_angle(f[6]), speed * unit / 3600.0)
    number, name = _target(f[1], f[11])
    return RadarTarget(number, name, None, distance * unit, bearing_rad, f[4] == "R", course_rad, speed_mps)


def _tll(f: list[str]) -> RadarTarget | None:
    """Parse TLL, which tells where a target is, and not where it goes."""
    if f[8] != "T":
        return None
    latitude_rad, longitude_rad = _position(*f[2:6])
    if latitude_rad is None or longitude_rad is None:
        raise FormatError("position incomplete")
    return RadarTarget(*_target(f[1], f[6]), (latitude_rad, longitude_rad))


def _target(number: str, name: str) -> tuple[int, str | None]:
    value = _within(number, 1023.0)
    if value is None:
        raise FormatError("no target number")
    return int(value), readable(name[:20])


def _count(text: str) -> int | None:
    value = _within(text, 99.0)
    return None if value is None else int(value)


READERS: Final[dict[str, tuple[int, Callable[[list[str]], Message]]]] = {  # with the least number of fields, address included
    "GGA": (9, _gga),
    "GNS": (9, _gns),
    "GLL": (5, _gll),
    "RMC": (10, _rmc),
    "VTG": (5, _vtg),
    "HDT": (2, _hdt),
    "THS": (3, _ths),
    "HDM": (2, _hdm),
    "HDG": (6, _hdg),
    "ROT": (3, _rot),
    "ZDA": (5, _zda),
    "GST": (8, _gst),
    "GSA": (17, _gsa),
    "DPT": (3, _dpt),
    "DBT": (6, _dbt),
    "MWV": (6, _mwv),
    "XDR": (5, _xdr),
    "TTM": (13, _ttm),
    "TLL": (9, _tll),
    "VDM": (7, part),
    "VDO": (7, part),
}
ENCAPSULATED: Final = ("VDM", "VDO")  # begin with "!" instead of "$"
