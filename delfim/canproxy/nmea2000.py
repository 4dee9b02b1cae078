"""NMEA 2000: navigation from off-the-shelf sensors. Frames in, `delfim.messages.Navigation` out; no sockets, time handed in.

An NMEA 2000 identifier is SAE J1939's: priority 3 bits, PGN 18 bits, source address 8 bits. PGNs below PDU format 240 carry a
destination in their low byte; the ones read here are all broadcast. Messages of up to 8 bytes are one frame, longer ones are
fast packets (`FastPacket`). Field layouts are those documented by the canboat project; the largest three values of a field
mean not available, error and reserved, and all arrive as None.

What this does not do: claim an address, answer requests, or send anything by itself. It listens.
"""

import math
import struct
from collections import Counter
from collections.abc import Callable
from enum import IntEnum
from typing import Any, Final, Generic, NamedTuple, TypeVar

from delfim import config
from delfim.errors import FormatError
from delfim.frames import CAN_IDE, Frame, extended
from delfim.messages import Navigation

TAU: Final = math.tau
BROADCAST: Final = 255
ADDRESS_MAX: Final = 251  # 252 and 253 are reserved, 254 cannot claim an address, 255 is everybody

SYSTEM_TIME: Final = 126992
HEADING: Final = 127250
RATE_OF_TURN: Final = 127251
ATTITUDE: Final = 127257
VARIATION: Final = 127258
POSITION_RAPID: Final = 129025
COURSE_SPEED_RAPID: Final = 129026
GNSS_POSITION: Final = 129029

# Limits of age for kinds that a healthy bus carries less often than positions; all others are held to the vehicle's `stale_s`.
SLOW_S: Final = 2.5  # attitude, GNSS quality and time come once a second
VARIATION_S: Final = 60.0  # some devices send it every ten seconds, and it changes by a minute of arc in a day's sail
STANDSTILL_MPS: Final = 0.1  # receivers name no course at rest; an unknown course at up to this speed is a velocity of zero


class Reference(IntEnum):
    """North of a heading or course."""

    TRUE = 0
    MAGNETIC = 1


class PositionRapid(NamedTuple):
    """PGN 129025, usually 10 Hz, resolution 1e-7 degrees."""

    latitude_rad: float | None
    longitude_rad: float | None


class CourseSpeed(NamedTuple):
    """PGN 129026, usually 4 Hz: over ground; 1e-4 rad, 0.01 m/s."""

    reference: Reference | None
    course_rad: float | None  # 0..2 pi
    speed_mps: float | None


class GnssPosition(NamedTuple):
    """PGN 129029, usually 1 Hz: fast packet of 43 bytes and 4 for each reference station; 1e-16 degrees."""

    utc_ns: int | None
    latitude_rad: float | None
    longitude_rad: float | None
    method: (
        int | None
    )  # 0 no fix, 1 GNSS, 2 differential, 3 precise, 4 RTK, 5 RTK float, 6 dead reckoning, 7 manual, 8 simulated
    satellites: int | None
    hdop: float | None


class Heading(NamedTuple):
    """PGN 127250, usually 10 Hz, 1e-4 rad: what the sensor reads, and what to add to it."""

    heading_rad: float | None  # 0..2 pi
    deviation_rad: float | None  # east positive; sensor to magnetic
    variation_rad: float | None  # east positive; magnetic to true
    reference: Reference | None


class RateOfTurn(NamedTuple):
    """PGN 127251, usually 10 Hz, 2**-5 urad/s; positive turns the bow to starboard."""

    rate_radps: float | None


class Attitude(NamedTuple):
    """PGN 127257, usually 1 Hz, 1e-4 rad; pitch positive bow up, roll positive starboard down."""

    yaw_rad: float | None  # of no stated reference: never used as a heading
    pitch_rad: float | None
    roll_rad: float | None


class Variation(NamedTuple):
    """PGN 127258, usually 1 Hz, 1e-4 rad, east positive."""

    variation_rad: float | None


class SystemTime(NamedTuple):
    """PGN 126992, usually 1 Hz, 0.1 ms."""

    utc_ns: int | None


Message = PositionRapid | CourseSpeed | GnssPosition | Heading | RateOfTurn | Attitude | Variation | SystemTime


def pgn_of(arb: int) -> tuple[int, int, int, int]:
    """(priority 0..7, pgn, source, destination) of an arbitration field; the destination of a broadcast PGN is 255.
    Raises FormatError for anything but an extended format data frame: NMEA 2000 has no others."""
    if arb & 7 != CAN_IDE:
        raise FormatError(f"arbitration field {arb:#010x} is not that of an extended data frame")
    pgn, source = arb >> 11 & 0x3FFFF, arb >> 3 & 0xFF
    if pgn & 0xFF00 < 0xF000:
        return arb >> 29, pgn & 0x3FF00, source, pgn & 0xFF
    return arb >> 29, pgn, source, BROADCAST


# Messages as bytes ----------------------------------------------------------------------------------------------------------

_DEGREES_1E7: Final = math.radians(1e-7)
_DEGREES_1E16: Final = math.radians(1e-16)
_RATE_RADPS: Final = 1e-6 / 32
_DAY_NS: Final = 86_400_000_000_000
_I16, _I32, _I64 = 0x7FFF, 0x7FFFFFFF, 0x7FFFFFFFFFFFFFFF  # not available; two less is the first value without meaning
_U16, _U32 = 0xFFFF, 0xFFFFFFFF
_CIRCLE: Final = 62_832  # 2 pi in 1e-4 rad, rounded up: some senders do not wrap before they round
_REFERENCES: Final = (Reference.TRUE, Reference.MAGNETIC, None, None)


def _signed(raw: int, unavailable: int, limit: int, unit: float, name: str) -> float | None:
    """A signed field in its unit. Raises FormatError beyond +-limit."""
    if -limit <= raw <= limit:
        return raw * unit
    if raw >= unavailable - 2:
        return None
    raise FormatError(f"impossible {name} {raw * unit:.6g}")


def _circle(raw: int, name: str) -> float | None:
    """A field of 0..2 pi in 1e-4 rad. Raises FormatError for what is no angle."""
    if raw < _CIRCLE:
        return raw * 1e-4
    if raw == _CIRCLE:
        return 0.0
    if raw >= _U16 - 2:
        return None
    raise FormatError(f"impossible {name} {raw * 1e-4:.4f} rad")


def _utc_ns(days: int, tenths_ms: int) -> int | None:
    """Nanoseconds since 1970; a leap second is the 86401st of its day. Raises FormatError beyond that."""
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


def _read_heading(_sid: int, heading: int, deviation: int, variation: int, reference: int) -> Heading:
    return Heading(
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


def _read_time(_sid: int, _source: int, days: int, time: int) -> SystemTime:
    return SystemTime(_utc_ns(days, time))


def _raw(value: float | None, unit: float, low: int, high: int, unavailable: int) -> int:
    """A field's integer; not available where the value is None, not a number or outside what `decode` takes."""
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


def _raw_reference(reference: Reference | None) -> int:
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


def _write_heading(m: Heading) -> tuple[int, ...]:
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


_LAYOUTS: Final = {
    SYSTEM_TIME: _Layout(struct.Struct("<BBHI"), _read_time, SystemTime, _write_time, 3),
    HEADING: _Layout(struct.Struct("<BHhhB"), _read_heading, Heading, _write_heading, 2),
    RATE_OF_TURN: _Layout(struct.Struct("<BiBH"), _read_rate, RateOfTurn, _write_rate, 2),
    ATTITUDE: _Layout(struct.Struct("<BhhhB"), _read_attitude, Attitude, _write_attitude, 3),
    VARIATION: _Layout(struct.Struct("<BBHhH"), _read_variation, Variation, _write_variation, 7),
    POSITION_RAPID: _Layout(struct.Struct("<ii"), _read_position, PositionRapid, _write_position, 2),
    COURSE_SPEED_RAPID: _Layout(struct.Struct("<BBHHH"), _read_course_speed, CourseSpeed, _write_course_speed, 2),
    GNSS_POSITION: _Layout(struct.Struct("<BHIqqqBBBhhiB"), _read_gnss, GnssPosition, _write_gnss, 3),
}
_PGNS: Final = {layout.kind: pgn for pgn, layout in _LAYOUTS.items()}


def decode(pgn: int, data: bytes) -> Message:
    """The values of one complete message. Raises FormatError for a PGN that is not read here, a wrong length (129029 may be
    longer: reference stations follow) and values that no boat can have, such as a latitude beyond 90 degrees."""
    layout = _LAYOUTS.get(pgn)
    if layout is None:
        raise FormatError(f"PGN {pgn} is not one of {', '.join(map(str, _LAYOUTS))}")
    size = layout.fields.size
    if len(data) != size and not (pgn == GNSS_POSITION and len(data) > size):
        raise FormatError(f"{len(data)} bytes instead of {size}")
    return layout.read(*layout.fields.unpack_from(data))


def encode(message: Message, source: int, sequence: int = 0) -> list[Frame]:
    """The frames of a message as the device at address `source` sends them: one, or the seven of a fast packet with the
    sequence number 0..7 (one up each message). Values that `decode` would not take are sent as not available. Raises
    FormatError for an address outside 0..251."""
    if not 0 <= source <= ADDRESS_MAX:
        raise FormatError(f"address {source} is outside 0..{ADDRESS_MAX}")
    pgn = _PGNS[type(message)]
    layout = _LAYOUTS[pgn]
    arb = extended(layout.priority << 26 | pgn << 8 | source)
    data = layout.fields.pack(*layout.write(message))
    if len(data) <= 8:
        return [Frame(arb, data)]
    head = (sequence & 7) << 5
    rest = bytes((len(data),)) + data
    return [Frame(arb, (bytes((head | i,)) + rest[7 * i : 7 * i + 7]).ljust(8, b"\xff")) for i in range(-(-len(rest) // 7))]


# Fast packets ---------------------------------------------------------------------------------------------------------------


class _Flight:
    """A message under way."""

    __slots__ = ("frames", "sequence", "started_s")

    def __init__(self, sequence: int, started_s: float) -> None:
        self.sequence, self.started_s = sequence, started_s
        self.frames: dict[int, bytes] = {}


class FastPacket:
    """Reassembly of one PGN's fast packets: 3 bits sequence, 5 bits frame number, then data; frame 0 begins with the length
    1..223. Frames may come in any order and twice. At most `IN_FLIGHT` messages per source are under way, the oldest is
    dropped, and so is one that is not complete after `TIMEOUT_S`. Nothing is raised; `errors` counts by reason."""

    IN_FLIGHT: Final = 2
    TIMEOUT_S: Final = 0.75
    LENGTH_MAX: Final = 223

    def __init__(self, errors: Counter[str]) -> None:
        self.errors = errors
        self._flights: dict[int, list[_Flight]] = {}

    def feed(self, source: int, data: bytes, now_s: float) -> bytes | None:
        """The message that this frame completes."""
        if len(data) != 8 or (not data[0] & 31 and not 1 <= data[1] <= self.LENGTH_MAX):
            self.errors["fast packet: malformed frame"] += 1
            return None
        flight = self._flight(source, data, now_s)
        frames = flight.frames
        frames[data[0] & 31] = data
        first = frames.get(0)
        if first is None:
            return None
        needed = 1 + first[1] // 7  # the length and the data, seven bytes a frame
        if len(frames) < needed:
            return None
        self._flights[source].remove(flight)
        if max(frames) >= needed:
            self.errors["fast packet: frame beyond the end"] += 1
            return None
        return (first[2:] + b"".join([frames[number][1:] for number in range(1, needed)]))[: first[1]]

    def _flight(self, source: int, data: bytes, now_s: float) -> _Flight:
        """The message that a frame belongs to, cleared of what cannot be completed any more."""
        flights = self._flights.setdefault(source, [])
        sequence = data[0] >> 5
        for flight in flights:
            if flight.sequence != sequence:
                continue
            held = flight.frames.get(data[0] & 31)
            if now_s - flight.started_s > self.TIMEOUT_S:
                self.errors["fast packet: timed out"] += 1
            elif held is None:
                return flight
            elif held == data:
                self.errors["fast packet: duplicated frame"] += 1
                return flight
            else:
                self.errors["fast packet: incomplete"] += 1  # the sequence number came round again
            flights.remove(flight)
            break
        if len(flights) == self.IN_FLIGHT:
            self.errors["fast packet: incomplete"] += 1
            del flights[0]
        flights.append(_Flight(sequence, now_s))
        return flights[-1]


# Choice of source -----------------------------------------------------------------------------------------------------------

T = TypeVar("T")


class Newest(Generic[T]):
    """The newest value of one kind from each address, and whose counts: the first of the preferred addresses whose value is
    fresh; else the present one while it is fresh; else the lowest fresh address. At most 256 addresses exist."""

    def __init__(self, preferred: tuple[int, ...], limit_s: float) -> None:
        self._preferred, self._limit_s = preferred, limit_s
        self._values: dict[int, tuple[T, float]] = {}
        self._order: tuple[int, ...] = preferred  # preferred, then the present one

    def put(self, address: int, value: T | None, now_s: float) -> None:
        """None: the source says that it does not know, which ends what it said before."""
        if value is None:
            self._values.pop(address, None)
        else:
            self._values[address] = value, now_s

    def choose(self, now_s: float) -> int | None:
        """The address that counts now, None when none is fresh."""
        values, oldest_s = self._values, now_s - self._limit_s
        for address in self._order:
            held = values.get(address)
            if held is not None and held[1] >= oldest_s:
                break
        else:
            fresh = [address for address, (_, t_s) in values.items() if t_s >= oldest_s]
            if not fresh:
                return None
            address = min(fresh)
        self._order = (*self._preferred, address)
        return address

    def get(self, now_s: float) -> T | None:
        """The value that counts now."""
        address = self.choose(now_s)
        return None if address is None else self._values[address][0]

    def of(self, address: int, now_s: float) -> T | None:
        """The value of one address, None when it is not fresh."""
        held = self._values.get(address)
        return held[0] if held is not None and held[1] >= now_s - self._limit_s else None

    def age_s(self, address: int, now_s: float) -> float:
        return now_s - self._values[address][1]


class KindStatus(NamedTuple):
    """Who is believed for one kind of data. None, None: nobody (for variation: the vehicle's file)."""

    source: int | None
    age_s: float | None


class Heard(NamedTuple):
    """A source of navigation frames."""

    age_s: float
    frames: int


class Status(NamedTuple):
    kinds: dict[str, KindStatus]  # position, velocity, heading, rate, attitude, variation, quality, time
    sources: dict[int, Heard]  # by address
    errors: dict[str, int]  # by reason
    last_error: str


class _Quality(NamedTuple):
    fix: int
    satellites: int
    hdop: float | None


# delfim.messages.Navigation.fix by GNSS method. What is reckoned, typed in or simulated is no fix: it must not drive a boat.
_FIX: Final = {1: 3, 2: 4, 3: 4, 4: 5, 5: 4}
_UNSTATED: Final = _Quality(2, 0, None)  # a position of which nothing else is said has two dimensions


class Nmea2000Source:
    """A navigation source made of an NMEA 2000 bus. Each kind of data has a chosen source and an age of its own; what is older
    than its limit is None in the message. Limits: `stale_s`; attitude, quality and time at least `SLOW_S`; variation
    `VARIATION_S`. The rules are in docs/nmea2000.md."""

    # (arb, mask) to bind a socket to, set mask bits = don't care: the PGNs read here, at any priority, from any address.
    filters: Final = tuple((extended(pgn << 8), extended(7 << 26 | 0xFF) & ~CAN_IDE) for pgn in _LAYOUTS)

    def __init__(self, settings: config.Nmea2000, stale_s: float) -> None:
        preferred, slow_s = settings.preferred_sources, max(stale_s, SLOW_S)
        self._configured_variation_rad = math.radians(settings.variation_deg)
        self._stale_s = stale_s
        self._position: Newest[tuple[float, float]] = Newest(preferred, stale_s)
        self._talking: Newest[bool] = Newest(preferred, stale_s)  # says something of position, if only that it has none
        self._velocity: Newest[tuple[float, float]] = Newest(preferred, stale_s)
        self._heading: Newest[float] = Newest(preferred, stale_s)
        self._rate: Newest[float] = Newest(preferred, stale_s)
        self._attitude: Newest[Attitude] = Newest(preferred, slow_s)
        self._variation: Newest[float] = Newest(preferred, VARIATION_S)
        self._quality: Newest[_Quality] = Newest(preferred, slow_s)
        self._time: Newest[int] = Newest(preferred, slow_s)  # UTC minus monotonic time, ns
        self._kinds: dict[str, Newest[Any]] = {
            "position": self._position,
            "velocity": self._velocity,
            "heading": self._heading,
            "rate": self._rate,
            "attitude": self._attitude,
            "variation": self._variation,
            "quality": self._quality,
            "time": self._time,
        }
        self._rapid_s: dict[int, float] = {}  # by address: when it last sent a position of PGN 129025
        self._heard: dict[int, list[float]] = {}  # by address: last time, frames
        self._errors: Counter[str] = Counter()
        self._last_error = ""
        self._fast = FastPacket(self._errors)
        self._counter = 0

    def feed(self, frame: Frame, now_s: float) -> Navigation | None:
        """A navigation message when this frame brings a new position of the chosen source, with the newest of everything
        else. While no source has a position, the source that says so is passed on: position None, fix 0. Never raises."""
        arb, data = frame.arb, frame.data
        if arb & 7 != CAN_IDE:
            self._errors["not an extended data frame"] += 1
            return None
        pgn, address = arb >> 11 & 0x3FFFF, arb >> 3 & 0xFF
        if pgn not in _LAYOUTS:
            return None
        if address > ADDRESS_MAX:
            self._errors["source address that nobody can have"] += 1
            return None
        heard = self._heard.get(address)
        if heard is None:
            heard = self._heard[address] = [0.0, 0]
        heard[0] = now_s
        heard[1] += 1
        if pgn == GNSS_POSITION:
            payload = self._fast.feed(address, data, now_s)
            if payload is None:
                return None
            data = payload
        try:
            message = decode(pgn, data)
        except FormatError as error:
            self._errors[f"PGN {pgn}: malformed"] += 1
            self._last_error = f"PGN {pgn} of source {address}: {error}"
            return None
        return self._take(address, message, frame.t_ns, now_s)

    def _take(self, address: int, message: Message, t_ns: int, now_s: float) -> Navigation | None:
        """File a message under its kind; positions go on to the vehicle."""
        match message:
            case PositionRapid(latitude_rad, longitude_rad):
                self._rapid_s[address] = now_s
                return self._place(address, latitude_rad, longitude_rad, t_ns, now_s)
            case Heading():
                self._heading.put(address, self._true_heading(address, message, now_s), now_s)
            case RateOfTurn(rate_radps):
                self._rate.put(address, rate_radps, now_s)
            case CourseSpeed():
                self._velocity.put(address, self._over_ground(address, message, now_s), now_s)
            case Attitude(_, pitch_rad, roll_rad):
                known = pitch_rad is not None or roll_rad is not None
                self._attitude.put(address, message if known else None, now_s)
            case GnssPosition():
                return self._gnss(address, message, t_ns, now_s)
            case Variation(variation_rad):
                self._variation.put(address, variation_rad, now_s)
            case SystemTime(utc_ns):
                self._set_time(address, utc_ns, now_s)
        return None

    def _gnss(self, address: int, g: GnssPosition, t_ns: int, now_s: float) -> Navigation | None:
        """Quality and time of a receiver; its position too unless it sends the rapid one."""
        self._set_time(address, g.utc_ns, now_s)
        fix = _UNSTATED.fix if g.method is None else _FIX.get(g.method, 0)
        self._quality.put(address, _Quality(fix, g.satellites or 0, g.hdop), now_s)
        if now_s - self._rapid_s.get(address, -math.inf) <= self._stale_s:
            return None
        return self._place(address, g.latitude_rad, g.longitude_rad, t_ns, now_s)

    def _place(
        self, address: int, latitude_rad: float | None, longitude_rad: float | None, t_ns: int, now_s: float
    ) -> Navigation | None:
        """A position, or the word of a receiver that it has none: the navigation message if the address is the chosen one."""
        quality = self._quality.of(address, now_s) or _UNSTATED
        position = None
        if latitude_rad is not None and longitude_rad is not None and quality.fix:
            position = latitude_rad, longitude_rad
        self._position.put(address, position, now_s)
        self._talking.put(address, True, now_s)
        chosen = self._position.choose(now_s)
        if chosen is None:
            chosen = self._talking.choose(now_s)
        if chosen != address:
            return None
        latitude_rad, longitude_rad = position or (None, None)
        north_mps, east_mps = self._velocity.get(now_s) or (None, None)
        _, pitch_rad, roll_rad = self._attitude.get(now_s) or (None, None, None)
        self._counter = self._counter + 1 & 0xFF
        return Navigation(
            self._utc_ns(address, t_ns, now_s),
            latitude_rad,
            longitude_rad,
            north_mps,
            east_mps,
            self._heading.get(now_s),
            self._rate.get(now_s),
            roll_rad,
            pitch_rad,
            quality.fix if position else 0,
            quality.satellites,
            quality.hdop,
            self._counter,
        )

    def _true_heading(self, address: int, h: Heading, now_s: float) -> float | None:
        """Sensor + deviation = magnetic, + variation = true; the compass' own variation first."""
        if h.heading_rad is None or h.reference is None:
            return None
        if h.reference is Reference.TRUE:
            return h.heading_rad
        variation_rad = self._variation_rad(address, now_s) if h.variation_rad is None else h.variation_rad
        return (h.heading_rad + (h.deviation_rad or 0.0) + variation_rad) % TAU

    def _over_ground(self, address: int, v: CourseSpeed, now_s: float) -> tuple[float, float] | None:
        """(north_mps, east_mps)."""
        if v.speed_mps is None:
            return None
        if v.course_rad is None or v.reference is None:
            return (0.0, 0.0) if v.speed_mps <= STANDSTILL_MPS else None
        course_rad = v.course_rad
        if v.reference is Reference.MAGNETIC:
            course_rad += self._variation_rad(address, now_s)
        return v.speed_mps * math.cos(course_rad), v.speed_mps * math.sin(course_rad)

    def _variation_rad(self, address: int, now_s: float) -> float:
        """For a magnetic angle of a source: its own variation, else that of the chosen source, else the vehicle's file."""
        variation_rad = self._variation.of(address, now_s)
        if variation_rad is None:
            variation_rad = self._variation.get(now_s)
        return self._configured_variation_rad if variation_rad is None else variation_rad

    def _set_time(self, address: int, utc_ns: int | None, now_s: float) -> None:
        self._time.put(address, None if utc_ns is None else utc_ns - round(now_s * 1e9), now_s)

    def _utc_ns(self, address: int, t_ns: int, now_s: float) -> int:
        """The bus' time now, by the source of the position if it tells the time; else this computer's stamp of the frame."""
        offset_ns = self._time.of(address, now_s)
        if offset_ns is None:
            offset_ns = self._time.get(now_s)
        return t_ns if offset_ns is None else offset_ns + round(now_s * 1e9)

    def status(self, now_s: float) -> Status:
        """Who is believed, who talks, what was refused: for the statistics page."""
        kinds = {}
        for name, newest in self._kinds.items():
            chosen = newest.choose(now_s)
            kinds[name] = KindStatus(chosen, None if chosen is None else newest.age_s(chosen, now_s))
        sources = {address: Heard(now_s - t_s, int(frames)) for address, (t_s, frames) in sorted(self._heard.items())}
        return Status(kinds, sources, dict(self._errors), self._last_error)
