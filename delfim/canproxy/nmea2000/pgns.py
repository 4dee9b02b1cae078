"""The NMEA 2000 messages that are read here, as values and as bytes. One row in LAYOUTS for each PGN."""

import math
import struct
from collections.abc import Callable
from enum import IntEnum
from typing import Any, Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.base.frames import Frame, extended
from delfim.canproxy.nmea2000.fastpacket import split

TAU: Final = math.tau
ADDRESS_MAX: Final = 251  # 252 and 253 are reserved, 254 has no address, 255 is broadcast

SYSTEM_TIME: Final = 126992
HEADING: Final = 127250
RATE_OF_TURN: Final = 127251
ATTITUDE: Final = 127257
VARIATION: Final = 127258
POSITION_RAPID: Final = 129025
COURSE_SPEED_RAPID: Final = 129026
GNSS_POSITION: Final = 129029


class NorthReference(IntEnum):
    """The north that a heading or course refers to."""

    TRUE = 0
    MAGNETIC = 1


class PositionRapid(NamedTuple):
    """PGN 129025, usually 10 Hz: position, 1e-7 degrees."""

    latitude_rad: float | None
    longitude_rad: float | None


class CourseSpeed(NamedTuple):
    """PGN 129026, usually 4 Hz: course and speed over ground; 1e-4 rad, 0.01 m/s."""

    reference: NorthReference | None
    course_rad: float | None  # 0..2 pi
    speed_mps: float | None


class GnssPosition(NamedTuple):
    """PGN 129029, usually 1 Hz: position and time, 1e-16 degrees; a fast packet of 43 bytes and 4 for each reference
    station."""

    utc_ns: int | None
    latitude_rad: float | None
    longitude_rad: float | None
    method: (
        int | None
    )  # 0 no fix, 1 GNSS, 2 differential, 3 precise, 4 RTK, 5 RTK float, 6 dead reckoning, 7 manual, 8 simulated
    satellites: int | None
    hdop: float | None


class VesselHeading(NamedTuple):
    """PGN 127250, usually 10 Hz: the sensor's heading and the corrections to add, 1e-4 rad."""

    heading_rad: float | None  # 0..2 pi
    deviation_rad: float | None  # east positive; sensor to magnetic
    variation_rad: float | None  # east positive; magnetic to true
    reference: NorthReference | None


class RateOfTurn(NamedTuple):
    """PGN 127251, usually 10 Hz: rate of turn, 2**-5 urad/s; positive turns the bow to starboard."""

    rate_radps: float | None


class Attitude(NamedTuple):
    """PGN 127257, usually 1 Hz: attitude, 1e-4 rad; pitch positive bow up, roll positive starboard down."""

    yaw_rad: float | None  # its reference is not stated: never used as a heading
    pitch_rad: float | None
    roll_rad: float | None


class Variation(NamedTuple):
    """PGN 127258, usually 1 Hz: magnetic variation, 1e-4 rad, east positive."""

    variation_rad: float | None


class SystemTime(NamedTuple):
    """PGN 126992, usually 1 Hz: UTC, 0.1 ms."""

    utc_ns: int | None  # None, too, where it comes from the device's own crystal


Message = PositionRapid | CourseSpeed | GnssPosition | VesselHeading | RateOfTurn | Attitude | Variation | SystemTime


_DEGREES_1E7: Final = math.radians(1e-7)
_DEGREES_1E16: Final = math.radians(1e-16)
_RATE_RADPS: Final = 1e-6 / 32
_DAY_NS: Final = 86_400_000_000_000
_I16, _I32, _I64 = 0x7FFF, 0x7FFFFFFF, 0x7FFFFFFFFFFFFFFF  # not available; the first reserved value is two less
_LOCAL_CRYSTAL = 5  # source of a system time: a clock of the device's own
_U16, _U32 = 0xFFFF, 0xFFFFFFFF
_CIRCLE: Final = 62_832  # 2 pi in 1e-4 rad, rounded up: some senders do not wrap before they round
_REFERENCES: Final = (NorthReference.TRUE, NorthReference.MAGNETIC, None, None)


def _signed(raw: int, unavailable: int, limit: int, unit: float, name: str) -> float | None:
    """A signed field in its unit. Raises FormatError beyond +-limit."""
    if -limit <= raw <= limit:
        return raw * unit
    if raw >= unavailable - 2:
        return None
    raise FormatError(f"impossible {name} {raw * unit:.6g}")


def _circle(raw: int, name: str) -> float | None:
    """An angle of 0..2 pi, in 1e-4 rad. Raises FormatError beyond that."""
    if raw < _CIRCLE:
        return raw * 1e-4
    if raw == _CIRCLE:
        return 0.0
    if raw >= _U16 - 2:
        return None
    raise FormatError(f"impossible {name} {raw * 1e-4:.4f} rad")


def _utc_ns(days: int, tenths_ms: int) -> int | None:
    """UTC in nanoseconds since 1970; a leap second is the 86401st of its day. Raises FormatError beyond that."""
    if days >= _U16 - 2 or tenths_ms >= _U32 - 2:
        return None
    if tenths_ms >= 864_010_000:
        raise FormatError(f"impossible time of day {tenths_ms * 1e-4:.4f} s")
    return days * _DAY_NS + tenths_ms * 100_000


def _read_position(latitude: int, longitude: int) -> PositionRapid:
    return PositionRapid(
        _signed(latitude, _I32, 900_000_000, _DEGREES_1E7, "latitude in rad"),
        _signed(longitude, _I32, 1_800_000_000, _DEGREES_1E7, "longitude in rad"),
    )


def _read_course_speed(_sid: int, reference: int, course: int, speed: int, _reserved: int) -> CourseSpeed:
    return CourseSpeed(_REFERENCES[reference & 3], _circle(course, "course"), speed * 0.01 if speed < _U16 - 2 else None)


def _read_gnss(*raw: int) -> GnssPosition:
    _sid, days, time, latitude, longitude, _altitude, kind, _integrity, satellites, hdop, _pdop, _geoid, _stations = raw
    if hdop < 0:
        raise FormatError(f"impossible horizontal dilution of precision {hdop * 0.01:.2f}")
    return GnssPosition(
        _utc_ns(days, time),
        _signed(latitude, _I64, 900_000_000_000_000_000, _DEGREES_1E16, "latitude in rad"),
        _signed(longitude, _I64, 1_800_000_000_000_000_000, _DEGREES_1E16, "longitude in rad"),
        kind >> 4 if kind < 0xE0 else None,
        satellites if satellites < 0xFD else None,
        hdop * 0.01 if hdop < _I16 - 2 else None,
    )


def _read_heading(_sid: int, heading: int, deviation: int, variation: int, reference: int) -> VesselHeading:
    return VesselHeading(
        _circle(heading, "heading"),
        _signed(deviation, _I16, 31_416, 1e-4, "deviation in rad"),
        _signed(variation, _I16, 31_416, 1e-4, "variation in rad"),
        _REFERENCES[reference & 3],
    )


def _read_rate(_sid: int, rate: int, _reserved: int, _reserved2: int) -> RateOfTurn:
    return RateOfTurn(rate * _RATE_RADPS if rate < _I32 - 2 else None)


def _read_attitude(_sid: int, yaw: int, pitch: int, roll: int, _reserved: int) -> Attitude:
    return Attitude(
        _signed(yaw, _I16, 31_416, 1e-4, "yaw in rad"),
        _signed(pitch, _I16, 15_708, 1e-4, "pitch in rad"),
        _signed(roll, _I16, 31_416, 1e-4, "roll in rad"),
    )


def _read_variation(_sid: int, _source: int, _age_days: int, variation: int, _reserved: int) -> Variation:
    return Variation(_signed(variation, _I16, 31_416, 1e-4, "variation in rad"))


def _read_time(_sid: int, source: int, days: int, time: int) -> SystemTime:
    utc_ns = _utc_ns(days, time)
    return SystemTime(None if source & 0xF == _LOCAL_CRYSTAL else utc_ns)


def _raw(value: float | None, unit: float, low: int, high: int, unavailable: int) -> int:
    """A field's integer; not available if the value is None, NaN or outside the range of `decode`."""
    scaled = math.nan if value is None else value / unit
    if not math.isfinite(scaled):
        return unavailable
    raw = round(scaled)
    return raw if low <= raw <= high else unavailable


def _raw_circle(angle_rad: float | None) -> int:
    return _U16 if angle_rad is None or not math.isfinite(angle_rad) else round(angle_rad % TAU * 1e4) % _CIRCLE


def _raw_angle(angle_rad: float | None, limit: int = 31_416) -> int:
    return _raw(angle_rad, 1e-4, -limit, limit, _I16)


def _raw_utc(utc_ns: int | None) -> tuple[int, int]:
    days, rest_ns = divmod(-1 if utc_ns is None else utc_ns, _DAY_NS)
    return (days, rest_ns // 100_000) if 0 <= days < _U16 - 2 else (_U16, _U32)


def _raw_reference(reference: NorthReference | None) -> int:
    return 0xFF if reference is None else 0xFC | reference


def _write_position(m: PositionRapid) -> tuple[int, ...]:
    return (
        _raw(m.latitude_rad, _DEGREES_1E7, -900_000_000, 900_000_000, _I32),
        _raw(m.longitude_rad, _DEGREES_1E7, -1_800_000_000, 1_800_000_000, _I32),
    )


def _write_course_speed(m: CourseSpeed) -> tuple[int, ...]:
    return 0xFF, _raw_reference(m.reference), _raw_circle(m.course_rad), _raw(m.speed_mps, 0.01, 0, _U16 - 3, _U16), 0xFFFF


def _write_gnss(m: GnssPosition) -> tuple[int, ...]:
    latitude = _raw(m.latitude_rad, _DEGREES_1E16, -900_000_000_000_000_000, 900_000_000_000_000_000, _I64)
    longitude = _raw(m.longitude_rad, _DEGREES_1E16, -1_800_000_000_000_000_000, 1_800_000_000_000_000_000, _I64)
    method, satellites = _raw(m.method, 1, 0, 13, 15), _raw(m.satellites, 1, 0, 0xFC, 0xFF)
    hdop = _raw(m.hdop, 0.01, 0, _I16 - 3, _I16)
    return 0xFF, *_raw_utc(m.utc_ns), latitude, longitude, _I64, method << 4, 0xFC, satellites, hdop, _I16, _I32, 0


def _write_heading(m: VesselHeading) -> tuple[int, ...]:
    return (
        0xFF,
        _raw_circle(m.heading_rad),
        _raw_angle(m.deviation_rad),
        _raw_angle(m.variation_rad),
        _raw_reference(m.reference),
    )


def _write_rate(m: RateOfTurn) -> tuple[int, ...]:
    return 0xFF, _raw(m.rate_radps, _RATE_RADPS, -_I32, _I32 - 3, _I32), 0xFF, 0xFFFF


def _write_attitude(m: Attitude) -> tuple[int, ...]:
    return 0xFF, _raw_angle(m.yaw_rad), _raw_angle(m.pitch_rad, 15_708), _raw_angle(m.roll_rad), 0xFF


def _write_variation(m: Variation) -> tuple[int, ...]:
    return 0xFF, 0xFF, 0xFFFF, _raw_angle(m.variation_rad), 0xFFFF


def _write_time(m: SystemTime) -> tuple[int, ...]:
    return 0xFF, 0xF0, *_raw_utc(m.utc_ns)  # low half of the second byte: by GPS


class _Layout(NamedTuple):
    fields: struct.Struct
    read: Callable[..., Message]
    kind: type
    write: Callable[[Any], tuple[int, ...]]
    priority: int  # as sent


LAYOUTS: Final = {
    SYSTEM_TIME: _Layout(struct.Struct("<BBHI"), _read_time, SystemTime, _write_time, 3),
    HEADING: _Layout(struct.Struct("<BHhhB"), _read_heading, VesselHeading, _write_heading, 2),
    RATE_OF_TURN: _Layout(struct.Struct("<BiBH"), _read_rate, RateOfTurn, _write_rate, 2),
    ATTITUDE: _Layout(struct.Struct("<BhhhB"), _read_attitude, Attitude, _write_attitude, 3),
    VARIATION: _Layout(struct.Struct("<BBHhH"), _read_variation, Variation, _write_variation, 7),
    POSITION_RAPID: _Layout(struct.Struct("<ii"), _read_position, PositionRapid, _write_position, 2),
    COURSE_SPEED_RAPID: _Layout(struct.Struct("<BBHHH"), _read_course_speed, CourseSpeed, _write_course_speed, 2),
    GNSS_POSITION: _Layout(struct.Struct("<BHIqqqBBBhhiB"), _read_gnss, GnssPosition, _write_gnss, 3),
}
_PGNS: Final = {layout.kind: pgn for pgn, layout in LAYOUTS.items()}


def decode(pgn: int, data: bytes) -> Message:
    """Decode one complete message. Raises FormatError for a PGN that is not in LAYOUTS, a wrong length (129029 may be longer:
    reference stations follow) and values that no boat can have, such as a latitude beyond 90 degrees."""
    layout = LAYOUTS.get(pgn)
    if layout is None:
        raise FormatError(f"PGN {pgn} is not one of {', '.join(map(str, LAYOUTS))}")
    size = layout.fields.size
    if len(data) != size and not (pgn == GNSS_POSITION and len(data) > size):
        raise FormatError(f"{len(data)} bytes instead of {size}")
    return layout.read(*layout.fields.unpack_from(data))


def pack(message: Message) -> tuple[int, bytes, int]:
    """PGN, data and priority of a message. Values that `decode` would refuse are sent as not available."""
    pgn = _PGNS[type(message)]
    layout = LAYOUTS[pgn]
    return pgn, layout.fields.pack(*layout.write(message)), layout.priority


def encode(message: Message, source: int, sequence: int = 0) -> list[Frame]:
    """The frames of a message as the device at address `source` sends them: one, or the seven of a fast packet with the
    sequence number 0..7 (one up each message), as `pack` has them. Raises FormatError for an address outside 0..251."""
    if not 0 <= source <= ADDRESS_MAX:
        raise FormatError(f"address {source} is outside 0..{ADDRESS_MAX}")
    pgn, data, priority = pack(message)
    arb = extended(priority << 26 | pgn << 8 | source)
    return [Frame(arb, part) for part in (split(data, sequence) if len(data) > 8 else [data])]
