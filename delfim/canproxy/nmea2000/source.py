"""Navigation from an NMEA 2000 bus: each kind of data has its device and its age (docs/nmea2000.md)."""

import math
from collections import Counter
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from delfim import config
from delfim.canproxy.nmea2000.fastpacket import FastPacket
from delfim.canproxy.nmea2000.names import CLAIMED, Names
from delfim.canproxy.nmea2000.pgns import (
    ADDRESS_MAX,
    GNSS_POSITION,
    LAYOUTS,
    TAU,
    Attitude,
    CourseSpeed,
    GnssPosition,
    Message,
    NorthReference,
    PositionRapid,
    RateOfTurn,
    SystemTime,
    Variation,
    VesselHeading,
    decode,
)
from delfim.errors import FormatError
from delfim.frames import CAN_IDE, Frame, extended
from delfim.messages import Navigation
from delfim.newest import Newest

# Limits of age for kinds that a healthy bus carries less often than positions; all others have the vehicle's `stale_s`.
SLOW_S: Final = 2.5  # attitude, GNSS quality and time come once a second
VARIATION_S: Final = 60.0  # some devices send it every ten seconds, and it changes by a minute of arc in a day's sail
STANDSTILL_MPS: Final = 0.1  # receivers give no course at rest; an unknown course up to this speed means zero velocity


class KindStatus(NamedTuple):
    """The device used for one kind of data. None, None: no device (for variation: the vehicle's file)."""

    source: int | None
    age_s: float | None


class HeardFrom(NamedTuple):
    """A source of navigation frames."""

    age_s: float
    frames: int
    name: str  # 16 hexadecimal digits; empty: not heard


class SourceStatus(NamedTuple):
    kinds: dict[str, KindStatus]  # position, velocity, heading, rate, attitude, variation, quality, time
    sources: dict[int, HeardFrom]  # by address
    errors: dict[str, int]  # by reason
    last_error: str


class _Quality(NamedTuple):
    fix: int
    satellites: int
    hdop: float | None


# delfim.messages.Navigation.fix by GNSS method. Reckoned, typed or simulated positions are no fix: none may drive a boat.
_FIX: Final = {1: 3, 2: 4, 3: 3, 4: 5, 5: 6}
_UNSTATED: Final = _Quality(2, 0, None)  # a position without quality data counts as two-dimensional


class Nmea2000Source:
    """A navigation source made of an NMEA 2000 bus. Each kind of data has a chosen source and an age of its own; a value
    older than its limit is None in the message. Limits: `stale_s`; attitude, quality and time at least `SLOW_S`; variation
    at least `VARIATION_S`. The rules are in docs/nmea2000.md."""

    # (arb, mask) to bind a socket to, set mask bits = don't care: the PGNs read here, at any priority, from any address.
    filters: Final = tuple((extended(pgn << 8), extended(7 << 26 | 0xFF) & ~CAN_IDE) for pgn in (*LAYOUTS, CLAIMED))

    def __init__(self, settings: config.Nmea2000, stale_s: float, own_name: int = -1) -> None:
        """`own_name` as `Names` has it."""
        self._names = Names(settings.preferred_sources, own_name)
        preferred, slow_s = self._names.preferred, max(stale_s, SLOW_S)
        self._configured_variation_rad = math.radians(settings.variation_deg)
        self._stale_s = stale_s
        self._position: Newest[int, tuple[float, float]] = Newest(preferred, stale_s)
        self._talking: Newest[int, bool] = Newest(preferred, stale_s)  # sends positions, even if only to say that it has none
        self._velocity: Newest[int, tuple[float, float]] = Newest(preferred, stale_s)
        self._heading: Newest[int, float] = Newest(preferred, stale_s)
        self._rate: Newest[int, float] = Newest(preferred, stale_s)
        self._attitude: Newest[int, Attitude] = Newest(preferred, slow_s)
        self._variation: Newest[int, float] = Newest(preferred, max(stale_s, VARIATION_S))
        self._quality: Newest[int, _Quality] = Newest(preferred, slow_s)
        self._time: Newest[int, int] = Newest(preferred, slow_s)  # UTC minus monotonic time, ns
        self._kinds: dict[str, Newest[int, Any]] = {
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
        self.hearer: Callable[[str, tuple[float, ...], int], None] | None = (
            None  # is told each value of a chosen device, by kind
        )

    def feed(self, frame: Frame, now_s: float) -> Navigation | None:
        """A navigation message when this frame brings a new position of the chosen source, with the newest of everything
        else. While no source has a position, the message has position None and fix 0. Never raises."""
        arb, data = frame.arb, frame.data
        if arb & 7 != CAN_IDE:
            self._errors["not an extended data frame"] += 1
            return None
        pgn, address = arb >> 11 & 0x3FFFF, arb >> 3 & 0xFF
        if pgn not in LAYOUTS:
            if pgn == CLAIMED and not self._names.learn(address, data, (*self._kinds.values(), self._talking)):
                self._errors["claim: malformed"] += 1
            return None
        if address == self._names.own:
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
        return self._take(address, message, now_s)

    def _take(self, address: int, message: Message, now_s: float) -> Navigation | None:
        """File a message under its kind; positions go on to the vehicle."""
        match message:
            case PositionRapid(latitude_rad, longitude_rad):
                self._rapid_s[address] = now_s
                return self._place(address, latitude_rad, longitude_rad, now_s)
            case VesselHeading():
                heading_rad = self._true_heading(address, message, now_s)
                self._heading.put(address, heading_rad, now_s)
                if heading_rad is not None:
                    self._tell("heading", address, (heading_rad,), now_s)
            case RateOfTurn(rate_radps):
                self._rate.put(address, rate_radps, now_s)
                if rate_radps is not None:
                    self._tell("rate", address, (rate_radps,), now_s)
            case CourseSpeed():
                velocity = self._over_ground(address, message, now_s)
                self._velocity.put(address, velocity, now_s)
                if velocity is not None:
                    self._tell("velocity", address, velocity, now_s)
            case Attitude(_, pitch_rad, roll_rad):
                known = pitch_rad is not None or roll_rad is not None
                self._attitude.put(address, message if known else None, now_s)
            case GnssPosition():
                return self._gnss(address, message, now_s)
            case Variation(variation_rad):
                self._variation.put(address, variation_rad, now_s)
            case SystemTime(utc_ns):
                self._set_time(address, utc_ns, now_s)
        return None

    def _tell(self, kind: str, address: int, value: tuple[float, ...], now_s: float, utc_ns: int | None = None) -> None:
        """Hand a value over, if it is of the device that is chosen for its kind."""
        if self.hearer is not None and self._kinds[kind].choose(now_s) == address:
            self.hearer(kind, value, utc_ns or 0)

    def _gnss(self, address: int, g: GnssPosition, now_s: float) -> Navigation | None:
        """Quality and time of a receiver; its position too unless it sends the rapid one."""
        self._set_time(address, g.utc_ns, now_s)
        fix = _UNSTATED.fix if g.method is None else _FIX.get(g.method, 0)
        self._quality.put(address, _Quality(fix, g.satellites or 0, g.hdop), now_s)
        if now_s - self._rapid_s.get(address, -math.inf) <= self._stale_s:
            return None
        return self._place(address, g.latitude_rad, g.longitude_rad, now_s, g.utc_ns)

    def _place(
        self, address: int, latitude_rad: float | None, longitude_rad: float | None, now_s: float, utc_ns: int | None = None
    ) -> Navigation | None:
        """File a position, or a receiver's report that it has none; returns the message if the address is the chosen one."""
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
        if position is not None:
            self._tell("position", address, position, now_s, utc_ns)
        latitude_rad, longitude_rad = position or (None, None)
        north_mps, east_mps = self._velocity.get(now_s) or (None, None)
        _, pitch_rad, roll_rad = self._attitude.get(now_s) or (None, None, None)
        self._counter = self._counter + 1 & 0xFF
        return Navigation(
            self._utc_ns(address, now_s),
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

    def _true_heading(self, address: int, h: VesselHeading, now_s: float) -> float | None:
        """Sensor + deviation = magnetic, + variation = true; the compass's own variation first."""
        if h.heading_rad is None or h.reference is None:
            return None
        if h.reference is NorthReference.TRUE:
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
        if v.reference is NorthReference.MAGNETIC:
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

    def _utc_ns(self, address: int, now_s: float) -> int:
        """The bus's time now, by the source of the position if it tells the time; 0 while nobody does: the computer's own clock
        is not compared with itself."""
        offset_ns = self._time.of(address, now_s)
        if offset_ns is None:
            offset_ns = self._time.get(now_s)
        return 0 if offset_ns is None else offset_ns + round(now_s * 1e9)

    def status(self, now_s: float) -> SourceStatus:
        """Devices used, devices heard and refused messages, for the statistics page."""
        kinds = {}
        for name, newest in self._kinds.items():
            chosen = newest.choose(now_s)
            kinds[name] = KindStatus(chosen, None if chosen is None else newest.age_s(chosen, now_s))
        names = {address: f"{name:016x}" for address, name in self._names.by_address.items()}
        sources = {
            address: HeardFrom(now_s - t_s, int(frames), names.get(address, ""))
            for address, (t_s, frames) in sorted(self._heard.items())
        }
        return SourceStatus(kinds, sources, dict(self._errors), self._last_error)
