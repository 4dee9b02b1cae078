"""Navigation from NMEA 0183 sentences: each kind of data has its talker and its age (docs/nmea0183.md)."""

import math
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from delfim import config
from delfim.messages import Navigation
from delfim.newest import Newest
from delfim.nmea0183.framing import Sentence
from delfim.nmea0183.instants import Instants
from delfim.nmea0183.sentences import (
    ActiveSatellites,
    Bearing,
    Breeze,
    DateTime,
    Located,
    Measurement,
    Movement,
    Sounding,
    Spread,
    Turning,
)

SLOW_S: Final = 2.5  # quality, attitude and time may come once a second, whatever the vehicle's `stale_s`
VARIATION_S: Final = 60.0
STANDSTILL_MPS: Final = 0.1  # receivers give no course at rest; an unknown course up to this speed means zero velocity
TALKERS_MAX: Final = 32
UBX: Final = "UB"  # the talker of delfim.ubx: of a receiver that sends both, it is the better one
SQRT2: Final = math.sqrt(2.0)  # an accuracy in the plane is that of two axes
_GNSS: Final = {
    "GP",
    "GN",
    "GL",
    "GA",
    "GB",
    "GQ",
    "GI",
    "BD",
    "QZ",
}  # a receiver changes between these as satellites come and go
_KINDS: Final = {  # with the age that a value may have; None: `navigation.stale_s`
    **dict.fromkeys(("position", "velocity", "heading", "rate")),
    **dict.fromkeys(("attitude", "quality", "dimensions", "time", "depth", "apparent wind", "true wind", "accuracy"), SLOW_S),
    "variation": VARIATION_S,
}


class Chosen(NamedTuple):
    """The talker used for one kind of data, PORT:TALKER. None, None: nobody (for variation: the vehicle's file)."""

    talker: str | None
    age_s: float | None


class _GnssQuality(NamedTuple):
    fix: int
    satellites: int
    hdop: float | None
    corrections_s: float | None = None


_UNTOLD: Final = _GnssQuality(2, 0, None)


class Combined:
    """All lines of NMEA 0183 together. A value older than its limit is None in the message. Talkers of satellite systems on one
    port are one receiver, GN."""

    def __init__(self, settings: config.Nmea0183, stale_s: float, measured: dict[str, tuple[float, float]]) -> None:
        """measured: gets the values beside navigation, with their times."""
        self._settings, self._stale_s, self._measured = settings, stale_s, measured
        self._variation_rad = math.radians(settings.variation_deg)
        self._newest: dict[str, Newest[str, Any]] = {
            kind: Newest((), stale_s if limit_s is None else max(limit_s, stale_s)) for kind, limit_s in _KINDS.items()
        }
        self._talking: Newest[str, bool] = Newest((), stale_s)  # sends positions, even if only to say that it has none
        self._heard_s = dict[str, float]()  # by talker
        self._ranks = dict[tuple[str, str], tuple[int, float]]()  # by talker and kind: of the best sentence, and its time
        self._receivers = dict[str, Instants]()
        self._counter = self.strangers = self.repeated = 0
        self.hearer: Callable[[str, tuple[float, ...], int, float], None] | None = None  # gets each value of a chosen talker

    def take(self, port: str, sentence: Sentence, now_s: float) -> Navigation | None:
        """A message for the vehicle when this sentence completes a position of the chosen talker. Never raises."""
        talker = f"{port}:{'GN' if sentence.talker in _GNSS else sentence.talker}"
        if talker not in self._heard_s:
            if len(self._heard_s) == TALKERS_MAX and not self._has_room(talker, port, now_s):
                self.strangers += 1
                return None
            self._heard_s[talker] = now_s
            self._prefer()
        self._heard_s[talker] = now_s
        message = sentence.message
        if isinstance(message, Located | Movement):
            return self._moving(talker, sentence.formatter, message, now_s)
        self._file(talker, message, now_s)
        return None

    def _has_room(self, talker: str, port: str, now_s: float) -> bool:
        """Forgets the talker that was silent for longest, if it gives no values any more or the new one is preferred: noise
        makes up talkers, and the receiver must be heard after it."""
        oldest = min(self._heard_s, key=self._heard_s.__getitem__)
        is_fresh = now_s - self._heard_s[oldest] <= max(SLOW_S, self._stale_s)
        if is_fresh and not {talker, port}.intersection(self._settings.preferred):
            return False
        del self._heard_s[oldest]
        self._receivers.pop(oldest, None)
        self._ranks = {key: rank for key, rank in self._ranks.items() if key[0] != oldest}
        for newest in (*self._newest.values(), self._talking):
            newest.put(oldest, None, now_s)
        return True

    def _file(self, talker: str, message: object, now_s: float) -> None:
        """A value that is no position, under its kind."""
        match message:
            case Bearing():
                self._heading(talker, message, now_s)
            case Turning(rate_radps):
                self._put("rate", talker, rate_radps, now_s)
                self._tell("rate", talker, None if rate_radps is None else (rate_radps,), now_s)
            case DateTime(utc_ns):
                self._set_time(talker, utc_ns, now_s)
            case ActiveSatellites(dimensions):
                if dimensions:  # some receivers send one for each system, and "no fix" for a system without satellites
                    self._put("dimensions", talker, message, now_s)
            case Spread(north_m, east_m):
                if north_m is None or east_m is None:
                    self._put("accuracy", talker, None, now_s)
                else:
                    accuracy_m = math.hypot(north_m, east_m)
                    self._measure("accuracy", talker, {"position_sigma_m": accuracy_m}, now_s, accuracy_m)
            case Sounding(depth_m, offset_m):
                if depth_m is not None:
                    offset = {} if offset_m is None else {"depth_offset_m": offset_m}
                    self._measure("depth", talker, {"depth_m": depth_m} | offset, now_s)
            case Breeze(angle_rad, speed_mps, is_apparent):
                if angle_rad is not None and speed_mps is not None:
                    name = "apparent" if is_apparent else "true"
                    values = {f"wind_{name}_rad": angle_rad, f"wind_{name}_mps": speed_mps}
                    self._measure(f"{name} wind", talker, values, now_s)
            case tuple():
                self._attitude(talker, message, now_s)

    def _put(self, kind: str, talker: str, value: object, now_s: float) -> None:
        self._newest[kind].put(talker, value, now_s)

    def _tell(self, kind: str, talker: str, value: tuple[float, ...] | None, now_s: float, deviation: float = 0.0) -> None:
        """Hand a value over, if it is of the talker that is chosen for its kind."""
        if self.hearer is not None and value is not None and self._newest[kind].choose(now_s) == talker:
            self.hearer(kind, value, 0, deviation)

    def _measure(self, kind: str, talker: str, values: dict[str, float], now_s: float, kept: object = True) -> None:
        self._put(kind, talker, kept, now_s)
        if self._newest[kind].choose(now_s) == talker:
            for name, value in values.items():
                self._measured[name] = value, now_s

    def _outranked(self, kind: str, talker: str, rank: int, now_s: float, is_known: bool) -> bool:
        """Whether this talker sends the kind in a better sentence, too; 0 is the best one."""
        best, at_s = self._ranks.get((talker, kind), (rank, now_s))
        if best < rank and now_s - at_s <= self._stale_s:
            return True
        if is_known:
            self._ranks[talker, kind] = rank, now_s
        elif best == rank:
            self._ranks.pop((talker, kind), None)
        return False

    def _heading(self, talker: str, b: Bearing, now_s: float) -> None:
        """True as it is; else magnetic + variation."""
        if b.variation_rad is not None:
            self._put("variation", talker, b.variation_rad, now_s)
        rank = 0 if b.magnetic_rad is None else 1 if b.true_rad is not None else 2
        if self._outranked("heading", talker, rank, now_s, b.true_rad is not None or b.magnetic_rad is not None):
            return
        heading_rad = b.true_rad
        if heading_rad is None and b.magnetic_rad is not None:
            heading_rad = (b.magnetic_rad + self._variation(talker, now_s)) % math.tau
        self._put("heading", talker, heading_rad, now_s)
        self._tell("heading", talker, None if heading_rad is None else (heading_rad,), now_s, b.deviation_rad)

    def _attitude(self, talker: str, measurements: tuple[Measurement, ...], now_s: float) -> None:
        """(roll_rad, pitch_rad) of the transducers that the file names."""
        found = []
        for wanted in (self._settings.roll, self._settings.pitch):
            sign = -1.0 if wanted.startswith("-") else 1.0
            values = [m.value for m in measurements if wanted and m.name == wanted.removeprefix("-") and m.unit == "D"]
            found.append(
                math.radians(sign * values[0]) if values and values[0] is not None and abs(values[0]) <= 90.0 else None
            )
        if found != [None, None]:
            self._put("attitude", talker, tuple(found), now_s)

    def _moving(self, talker: str, formatter: str, said: Located | Movement, now_s: float) -> Navigation | None:
        """Position and velocity; the message, when an instant of the chosen receiver is complete."""
        movement = said if isinstance(said, Movement) else said.movement
        if movement is not None:
            velocity = self._over_ground(talker, movement, now_s)
            self._put("velocity", talker, velocity, now_s)
            self._tell("velocity", talker, velocity, now_s, movement.deviation_mps)
        located = said if isinstance(said, Located) else None
        if located is not None:
            if self._outranked("position", talker, int(formatter == "GLL"), now_s, True):
                return None
            self._quality(talker, formatter, located, now_s)
            self._talking.put(talker, True, now_s)
        if self._talking.of(talker, now_s) is None:
            return None
        receiver = self._receivers.setdefault(talker, Instants())
        return self._placed(talker, receiver, now_s) if receiver.hear(formatter, located) else None

    def _quality(self, talker: str, formatter: str, said: Located, now_s: float) -> None:
        """Fix, satellites and HDOP, of GGA or GNS where there is one; and what else such a sentence says."""
        is_full = formatter in ("GGA", "GNS")
        if said.fix is not None and not self._outranked("quality", talker, 0 if is_full else 1, now_s, True):
            self._put("quality", talker, _GnssQuality(said.fix, said.satellites or 0, said.hdop, said.corrections_s), now_s)
            if said.corrections_s is not None and self._newest["quality"].choose(now_s) == talker:
                self._measured["corrections_age_s"] = said.corrections_s, now_s
        if said.utc_ns is not None:
            self._set_time(talker, said.utc_ns, now_s)
        if said.variation_rad is not None:
            self._put("variation", talker, said.variation_rad, now_s)

    def _placed(self, talker: str, receiver: Instants, now_s: float) -> Navigation | None:
        """The message of a complete instant, if the talker is the chosen one."""
        newest, position = self._newest, receiver.position if receiver.has_fix else None
        said, before = (receiver.day_s, position), receiver.told
        if said == before and receiver.day_s is not None:
            self.repeated += 1  # a frozen receiver is silent, whatever else aboard lives
            return None
        receiver.told = said
        newest["position"].put(talker, position, now_s)
        if (newest["position"].choose(now_s) or self._talking.choose(now_s)) != talker:
            return None
        accuracy_m: float | None = newest["accuracy"].of(talker, now_s)
        self._tell("position", talker, position, now_s, 0.0 if accuracy_m is None else accuracy_m / SQRT2)
        quality = newest["quality"].of(talker, now_s) or _UNTOLD
        satellites = newest["dimensions"].of(talker, now_s) or ActiveSatellites(None, None)
        fix = 2 if quality.fix == 3 and satellites.dimensions == 2 else quality.fix
        latitude_rad, longitude_rad = position or (None, None)
        north_mps, east_mps = newest["velocity"].get(now_s) or (None, None)
        roll_rad, pitch_rad = newest["attitude"].get(now_s) or (None, None)
        self._counter = self._counter + 1 & 0xFF
        return Navigation(
            self._utc_ns(talker, now_s),
            latitude_rad,
            longitude_rad,
            north_mps,
            east_mps,
            newest["heading"].get(now_s),
            newest["rate"].get(now_s),
            roll_rad,
            pitch_rad,
            fix if position else 0,
            quality.satellites,
            satellites.hdop if quality.hdop is None else quality.hdop,
            self._counter,
            accuracy_m if position else None,
            quality.corrections_s,
        )

    def _over_ground(self, talker: str, m: Movement, now_s: float) -> tuple[float, float] | None:
        """(north_mps, east_mps)."""
        course_rad = m.course_rad
        if course_rad is None and m.magnetic_rad is not None:
            course_rad = m.magnetic_rad + self._variation(talker, now_s)
        if m.speed_mps is None:
            return None
        if course_rad is None:
            return (0.0, 0.0) if m.speed_mps <= STANDSTILL_MPS else None
        return m.speed_mps * math.cos(course_rad), m.speed_mps * math.sin(course_rad)

    def _variation(self, talker: str, now_s: float) -> float:
        """For a magnetic angle of a talker: its own variation, else that of the chosen talker, else the vehicle's file."""
        variation: Newest[str, float] = self._newest["variation"]
        found = variation.of(talker, now_s)
        found = variation.get(now_s) if found is None else found
        return self._variation_rad if found is None else found

    def _set_time(self, talker: str, utc_ns: int | None, now_s: float) -> None:
        self._put("time", talker, None if utc_ns is None else utc_ns - round(now_s * 1e9), now_s)

    def _utc_ns(self, talker: str, now_s: float) -> int:
        """The time now, by the talker of the position if it tells one; 0 while nobody does."""
        times: Newest[str, int] = self._newest["time"]
        offset_ns = times.of(talker, now_s)
        offset_ns = times.get(now_s) if offset_ns is None else offset_ns
        return 0 if offset_ns is None else offset_ns + round(now_s * 1e9)

    def _prefer(self) -> None:
        """The talkers that were heard, in the order of the vehicle's file: those it prefers, then port by port."""
        wanted = (*self._settings.preferred, *self._settings.ports)
        heard = sorted(self._heard_s, key=lambda talker: (not talker.endswith(f":{UBX}"), talker))
        order = tuple(talker for each in wanted for talker in heard if each in (talker, talker.partition(":")[0]))
        for newest in (*self._newest.values(), self._talking):
            newest.prefer(tuple(dict.fromkeys(order)))

    def status(self, now_s: float) -> dict[str, object]:
        """Talkers used, by kind, and talkers heard with their ages, JSON-ready."""
        kinds = {}
        for kind, newest in self._newest.items():
            talker = newest.choose(now_s)
            kinds[kind] = Chosen(talker, None if talker is None else newest.age_s(talker, now_s))._asdict()
        talkers = {talker: now_s - at_s for talker, at_s in sorted(self._heard_s.items())}
        return {"kinds": kinds, "talkers": talkers, "talkers_too_many": self.strangers, "repeated": self.repeated}
