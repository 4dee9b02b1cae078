"""Navigation from an NMEA 2000 bus: each kind of data has its device and its age (docs/nmea2000.md)."""

import math
from collections import Counter
from typing import Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.base.frames import CAN_IDE, Frame, extended
from delfim.canproxy.dsor.messages import Navigation
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
from delfim.parts.nmea2000.table import Nmea2000
from delfim.vehicle.navigation.fusion import MOVING, SLOW_S, UNSTATED, VARIATION_S, Fusion, Quality, over_ground
from delfim.vehicle.navigation.iron import Iron


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
    kinds: dict[str, KindStatus]
    sources: dict[int, HeardFrom]  # by address
    errors: dict[str, int]  # by reason
    last_error: str


# delfim.canproxy.dsor.messages.Navigation.fix by GNSS method. Reckoned, typed or simulated positions are no fix: none may drive
# a boat.
_FIX: Final = {1: 3, 2: 4, 3: 3, 4: 5, 5: 6}
_KINDS: Final = {**MOVING, "attitude": SLOW_S, "variation": VARIATION_S, "quality": SLOW_S, "time": SLOW_S}


class Nmea2000Source:
    """Navigation from an NMEA 2000 bus: it makes readings of frames; `fusion` combines them."""

    # (arb, mask) to bind a socket to, set mask bits = don't care: the PGNs read here, at any priority, from any address.
    filters: Final = tuple((extended(pgn << 8), extended(7 << 26 | 0xFF) & ~CAN_IDE) for pgn in (*LAYOUTS, CLAIMED))

    def __init__(self, settings: Nmea2000, stale_s: float, own_name: int = -1, iron: Iron | None = None) -> None:
        """`own_name` as `Names` has it. `iron` is undone in magnetic headings."""
        self._iron = iron
        self._names = Names(settings.preferred_sources, own_name)
        self.fusion: Fusion[int] = Fusion(_KINDS, stale_s, self._names.preferred, settings.variation_deg)
        self._stale_s = stale_s
        self._rapid_s: dict[int, float] = {}  # by address: when it last sent a position of PGN 129025
        self._heard: dict[int, list[float]] = {}  # by address: last time, frames
        self._errors: Counter[str] = Counter()
        self._last_error = ""
        self._fast = FastPacket(self._errors)

    def feed(self, frame: Frame, now_s: float) -> Navigation | None:
        """Take a frame; returns a navigation message when it brings a new position of the chosen source, with the newest of
        everything else. While no source has a position, the message has position None and fix 0. Never raises."""
        arb, data = frame.arb, frame.data
        if arb & 7 != CAN_IDE:
            self._errors["not an extended data frame"] += 1
            return None
        pgn, address = arb >> 11 & 0x3FFFF, arb >> 3 & 0xFF
        if pgn not in LAYOUTS:
            if pgn == CLAIMED and not self._names.learn(address, data, self.fusion.all):
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
        fusion = self.fusion
        match message:
            case PositionRapid(latitude_rad, longitude_rad):
                self._rapid_s[address] = now_s
                return self._place(address, latitude_rad, longitude_rad, now_s)
            case VesselHeading():
                fusion.take("heading", address, self._true_heading(address, message, now_s), now_s)
            case RateOfTurn(rate_radps):
                fusion.take("rate", address, None if rate_radps is None else (rate_radps,), now_s)
            case CourseSpeed():
                fusion.take("velocity", address, self._over_ground(address, message, now_s), now_s)
            case Attitude(_, pitch_rad, roll_rad):
                known = pitch_rad is not None or roll_rad is not None
                fusion.put("attitude", address, (roll_rad, pitch_rad) if known else None, now_s)
            case GnssPosition():
                return self._gnss(address, message, now_s)
            case Variation(variation_rad):
                fusion.put("variation", address, variation_rad, now_s)
            case SystemTime(utc_ns):
                fusion.set_time(address, utc_ns, now_s)
        return None

    def _gnss(self, address: int, g: GnssPosition, now_s: float) -> Navigation | None:
        """File quality and time of a receiver; its position too unless it sends the rapid one."""
        self.fusion.set_time(address, g.utc_ns, now_s)
        fix = UNSTATED.fix if g.method is None else _FIX.get(g.method, 0)
        self.fusion.put("quality", address, Quality(fix, g.satellites or 0, g.hdop), now_s)
        if now_s - self._rapid_s.get(address, -math.inf) <= self._stale_s:
            return None
        return self._place(address, g.latitude_rad, g.longitude_rad, now_s, g.utc_ns)

    def _place(
        self, address: int, latitude_rad: float | None, longitude_rad: float | None, now_s: float, utc_ns: int | None = None
    ) -> Navigation | None:
        """File a position, or a receiver's report that it has none; returns the message if the address is the chosen one."""
        fusion = self.fusion
        quality: Quality = fusion.kinds["quality"].of(address, now_s) or UNSTATED
        position = None
        if latitude_rad is not None and longitude_rad is not None and quality.fix:
            position = latitude_rad, longitude_rad
        fusion.talking.put(address, True, now_s)
        if not fusion.place(address, position, now_s):
            return None
        fusion.tell("position", address, position, now_s, utc_ns)
        return fusion.message(position, fusion.utc_ns(address, now_s), now_s, quality.fix, quality.satellites, quality.hdop)

    def _true_heading(self, address: int, h: VesselHeading, now_s: float) -> tuple[float] | None:
        """The true heading: sensor + deviation = magnetic, + variation = true; the compass's own variation first."""
        if h.heading_rad is None or h.reference is None:
            return None
        if h.reference is NorthReference.TRUE:
            return (h.heading_rad,)
        variation_rad = self.fusion.variation_rad(address, now_s) if h.variation_rad is None else h.variation_rad
        magnetic_rad = h.heading_rad + (h.deviation_rad or 0.0)
        if self._iron is not None:
            magnetic_rad = self._iron.undone(magnetic_rad)
        return ((magnetic_rad + variation_rad) % TAU,)

    def _over_ground(self, address: int, v: CourseSpeed, now_s: float) -> tuple[float, float] | None:
        """The velocity over ground, (north_mps, east_mps)."""
        course_rad = None if v.reference is None else v.course_rad
        if course_rad is not None and v.speed_mps is not None and v.reference is NorthReference.MAGNETIC:
            course_rad += self.fusion.variation_rad(address, now_s)
        return over_ground(course_rad, v.speed_mps)

    def status(self, now_s: float) -> SourceStatus:
        """The status, for the statistics page: devices used, devices heard and refused messages."""
        kinds = {kind: KindStatus(*used) for kind, used in self.fusion.used(now_s).items()}
        names = {address: f"{name:016x}" for address, name in self._names.by_address.items()}
        sources = {
            address: HeardFrom(now_s - t_s, int(frames), names.get(address, ""))
            for address, (t_s, frames) in sorted(self._heard.items())
        }
        return SourceStatus(kinds, sources, dict(self._errors), self._last_error)
