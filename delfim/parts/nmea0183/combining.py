"""Navigation from NMEA 0183 sentences: each kind of data has its talker and its age (docs/nmea0183.md)."""

import math
from collections.abc import Callable
from typing import Final

from delfim.canproxy.dsor.messages import BatteriesStatus, Fault, Navigation, Node, Status, SystemStatus
from delfim.lines.nmea0183.framing import Sentence
from delfim.lines.nmea0183.sentences import (
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
from delfim.parts.nmea0183.table import Nmea0183
from delfim.vehicle.failsafe.nodehealth import NAMES
from delfim.vehicle.navigation.fusion import MOVING, SLOW_S, SQRT2, UNSTATED, VARIATION_S, Fusion, Quality, over_ground
from delfim.vehicle.navigation.iron import Iron
from delfim.vehicle.state import Ping

TALKERS_MAX: Final = 32
UBX: Final = "UB"  # the talker of delfim.lines.ubx: of a receiver that sends both, it is the better one
SIDES: Final = tuple(NAMES[node] for node in (Node.BATTERIES_STARBOARD, Node.BATTERIES_PORT))
PRESSURES: Final = {"B": 1e5, "P": 1.0}  # Pa of the units of XDR
PRESSURE_PA: Final = 30_000.0, 125_000.0  # of the air
VOLTS_MAX: Final = 1000.0
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
_KINDS: Final = {
    **MOVING,
    **dict.fromkeys(("attitude", "quality", "dimensions", "time", "depth", "apparent wind", "true wind", "accuracy"), SLOW_S),
    "variation": VARIATION_S,
}


class Instants:
    """Puts the sentences of a GNSS receiver together. It tells of one instant in several of them, in an order of its own: GGA
    first or RMC first, VTG in between. The last of them completes the instant; which one that is, the instants before show. So
    a position goes on once, with the velocity of the same instant, and without waiting for sentences that say nothing of it.
    Some plotters say something else each second: after an instant that nothing completed, the next one goes on with its first
    sentence."""

    def __init__(self) -> None:
        self.position: tuple[float, float] | None = None  # rad, of this instant; None: none of its sentences has one, or ...
        self.has_fix = True  # ... one of them says that there is none
        self.day_s: float | None = None  # time of the UTC day
        self.told: tuple[float | None, object] = (None, None)  # time and position that went on last
        self._heard: list[str] = []  # formatters of this instant
        self._last, self._completing = "", ""
        self._went_on, self._hurries = False, False

    def hear(self, formatter: str, said: Located | None) -> bool:
        """A sentence with a position, or a VTG (None). Whether it completes the instant."""
        day_s = None if said is None else said.day_s
        is_later = day_s is not None and self.day_s is not None and day_s != self.day_s
        if is_later or formatter in self._heard:
            self._begin()
        self._heard.append(formatter)
        if said is not None:
            self.day_s = self.day_s if day_s is None else day_s
            self.has_fix = self.has_fix and said.fix != 0
            if said.latitude_rad is not None and said.longitude_rad is not None:
                self.position = said.latitude_rad, said.longitude_rad
        if not self._hurries and self._completing not in ("", formatter):
            return False
        goes_on, self._went_on = not (self._hurries and self._went_on), True
        return goes_on

    def _begin(self) -> None:
        """A new instant. One sentence that was lost, or one that comes with every tenth instant only, changes nothing."""
        last = self._heard[-1]
        if last == self._last or not self._completing:
            self._completing = last
        self._last, self._heard = last, []
        self._hurries, self._went_on = not self._went_on, False
        self.day_s, self.position, self.has_fix = None, None, True


class Combined:
    """Files the values of all lines of NMEA 0183 as readings of PORT:TALKER. Talkers of satellite systems on one port are one
    receiver, GN."""

    def __init__(
        self,
        settings: Nmea0183,
        stale_s: float,
        measured: dict[str, tuple[float, float]],
        iron: Iron | None = None,
        sound: Callable[[Ping], object] = lambda ping: None,
        health: dict[str, tuple[SystemStatus, float]] | None = None,
    ) -> None:
        """measured: gets the values beside navigation, with their times; `sound` gets the depths, `health` the batteries.
        `iron` is undone in magnetic headings."""
        self._sound, self._health = sound, {} if health is None else health
        self._iron = iron
        self._settings, self._stale_s, self._measured = settings, stale_s, measured
        self.fusion: Fusion[str] = Fusion(_KINDS, stale_s, variation_deg=settings.variation_deg)
        self._heard_s = dict[str, float]()  # by talker
        self._ranks = dict[tuple[str, str], tuple[int, float]]()  # by talker and kind: of the best sentence, and its time
        self._receivers = dict[str, Instants]()
        self.strangers = self.repeated = 0

    def take(self, port: str, sentence: Sentence, now_s: float) -> Navigation | None:
        """Take a sentence; returns a message for the vehicle when it completes a position of the chosen talker. Never
        raises."""
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
        if isinstance(message, Sounding):
            self._sounded(talker, sentence.formatter, message, now_s)
        else:
            self._file(talker, message, now_s)
        return None

    def _sounded(self, talker: str, formatter: str, said: Sounding, now_s: float) -> None:
        """A depth. Many sounders tell each twice: DPT, which may have an offset, and DBT."""
        if said.depth_m is not None and not self._outranked("depth", talker, int(formatter == "DBT"), now_s, True):
            self.fusion.put("depth", talker, True, now_s)
            if self.fusion.kinds["depth"].choose(now_s) == talker:
                self._sound(Ping(now_s, said.depth_m, f"nmea0183 {talker}", said.offset_m))

    def _has_room(self, talker: str, port: str, now_s: float) -> bool:
        """Whether there is room for a talker. It drops the one that was silent for longest, if it gives no values any more or
        the new one is preferred: noise makes up talkers, and the receiver must be heard after it."""
        oldest = min(self._heard_s, key=self._heard_s.__getitem__)
        is_fresh = now_s - self._heard_s[oldest] <= max(SLOW_S, self._stale_s)
        if is_fresh and not {talker, port}.intersection(self._settings.preferred):
            return False
        del self._heard_s[oldest]
        self._receivers.pop(oldest, None)
        self._ranks = {key: rank for key, rank in self._ranks.items() if key[0] != oldest}
        for newest in self.fusion.all:
            newest.put(oldest, None, now_s)
        return True

    def _file(self, talker: str, message: object, now_s: float) -> None:
        """File a value that is no position under its kind."""
        match message:
            case Bearing():
                self._heading(talker, message, now_s)
            case Turning(rate_radps):
                self.fusion.take("rate", talker, None if rate_radps is None else (rate_radps,), now_s)
            case DateTime(utc_ns):
                self.fusion.set_time(talker, utc_ns, now_s)
            case ActiveSatellites(dimensions):
                if dimensions:  # some receivers send one for each system, and "no fix" for a system without satellites
                    self.fusion.put("dimensions", talker, message, now_s)
            case Spread(north_m, east_m):
                if north_m is None or east_m is None:
                    self.fusion.put("accuracy", talker, None, now_s)
                else:
                    accuracy_m = math.hypot(north_m, east_m)
                    self._measure("accuracy", talker, {"position_sigma_m": accuracy_m}, now_s, accuracy_m)
            case Breeze(angle_rad, speed_mps, is_apparent):
                if angle_rad is not None and speed_mps is not None:
                    name = "apparent" if is_apparent else "true"
                    values = {f"wind_{name}_rad": angle_rad, f"wind_{name}_mps": speed_mps}
                    self._measure(f"{name} wind", talker, values, now_s)
            case tuple():
                self._attitude(talker, message, now_s)
                self._transducers(message, now_s)

    def _measure(self, kind: str, talker: str, values: dict[str, float], now_s: float, kept: object = True) -> None:
        self.fusion.put(kind, talker, kept, now_s)
        if self.fusion.kinds[kind].choose(now_s) == talker:
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
        """File a heading: true as it is; else magnetic + variation."""
        if b.variation_rad is not None:
            self.fusion.put("variation", talker, b.variation_rad, now_s)
        rank = 0 if b.magnetic_rad is None else 1 if b.true_rad is not None else 2
        if self._outranked("heading", talker, rank, now_s, b.true_rad is not None or b.magnetic_rad is not None):
            return
        heading_rad = b.true_rad
        if heading_rad is None and b.magnetic_rad is not None:
            heading_rad = (b.magnetic_rad + self.fusion.variation_rad(talker, now_s)) % math.tau
        if self._iron is not None and b.magnetic_rad is not None:
            variation_rad = self.fusion.variation_rad(talker, now_s) if b.variation_rad is None else b.variation_rad
            heading_rad = (self._iron.undone(b.magnetic_rad) + variation_rad) % math.tau
        heading = None if heading_rad is None else (heading_rad,)
        self.fusion.take("heading", talker, heading, now_s, b.deviation_rad)

    def _attitude(self, talker: str, measurements: tuple[Measurement, ...], now_s: float) -> None:
        """File (roll_rad, pitch_rad) of the transducers that the file names."""
        found = []
        for wanted in (self._settings.roll, self._settings.pitch):
            sign = -1.0 if wanted.startswith("-") else 1.0
            values = [m.value for m in measurements if wanted and m.name == wanted.removeprefix("-") and m.unit == "D"]
            found.append(
                math.radians(sign * values[0]) if values and values[0] is not None and abs(values[0]) <= 90.0 else None
            )
        if found != [None, None]:
            self.fusion.put("attitude", talker, tuple(found), now_s)

    def _transducers(self, measurements: tuple[Measurement, ...], now_s: float) -> None:
        """File the pressure and the batteries of the transducers that the file names."""
        if not (self._settings.barometer or self._settings.batteries):
            return
        found = {(m.name, m.kind, m.unit): m.value for m in measurements if m.name and m.value is not None}
        for unit, pascals in PRESSURES.items():
            pressure_pa = pascals * found.get((self._settings.barometer, "P", unit), 0.0)
            if PRESSURE_PA[0] <= pressure_pa <= PRESSURE_PA[1]:
                self._measured["air_pa"] = pressure_pa, now_s
        for side, name in zip(SIDES, self._settings.batteries, strict=False):
            volts, amperes = found.get((name, "U", "V")), found.get((name, "I", "A"))
            if volts is not None and 0.0 <= volts <= VOLTS_MAX:
                per_cent = found.get((name, "E", "P"), -1.0)
                charge = per_cent / 100.0 if 0.0 <= per_cent <= 100.0 else None
                self._health[side] = BatteriesStatus(Status.GOOD, Fault(0), volts, amperes, charge, None), now_s

    def _moving(self, talker: str, formatter: str, said: Located | Movement, now_s: float) -> Navigation | None:
        """File position and velocity; returns the message when an instant of the chosen receiver is complete."""
        movement = said if isinstance(said, Movement) else said.movement
        if movement is not None:
            course_rad = movement.course_rad
            if course_rad is None and movement.magnetic_rad is not None:
                course_rad = movement.magnetic_rad + self.fusion.variation_rad(talker, now_s)
            velocity = over_ground(course_rad, movement.speed_mps)
            self.fusion.take("velocity", talker, velocity, now_s, movement.deviation_mps)
        located = said if isinstance(said, Located) else None
        if located is not None:
            if self._outranked("position", talker, int(formatter == "GLL"), now_s, True):
                return None
            self._quality(talker, formatter, located, now_s)
            self.fusion.talking.put(talker, True, now_s)
        if self.fusion.talking.of(talker, now_s) is None:
            return None
        receiver = self._receivers.setdefault(talker, Instants())
        return self._placed(talker, receiver, now_s) if receiver.hear(formatter, located) else None

    def _quality(self, talker: str, formatter: str, said: Located, now_s: float) -> None:
        """File fix, satellites and HDOP, of GGA or GNS where there is one; and what else such a sentence has."""
        is_full = formatter in ("GGA", "GNS")
        if said.fix is not None and not self._outranked("quality", talker, 0 if is_full else 1, now_s, True):
            quality = Quality(said.fix, said.satellites or 0, said.hdop, said.corrections_s)
            self.fusion.put("quality", talker, quality, now_s)
            if said.corrections_s is not None and self.fusion.kinds["quality"].choose(now_s) == talker:
                self._measured["corrections_age_s"] = said.corrections_s, now_s
            if said.height_m is not None and self.fusion.kinds["quality"].choose(now_s) == talker:
                self._measured["height_m"] = said.height_m, now_s
        if said.utc_ns is not None:
            self.fusion.set_time(talker, said.utc_ns, now_s)
        if said.variation_rad is not None:
            self.fusion.put("variation", talker, said.variation_rad, now_s)

    def _placed(self, talker: str, receiver: Instants, now_s: float) -> Navigation | None:
        """The message of a complete instant, if the talker is the chosen one."""
        fusion, position = self.fusion, receiver.position if receiver.has_fix else None
        said, before = (receiver.day_s, position), receiver.told
        if said == before and receiver.day_s is not None:
            self.repeated += 1  # a frozen receiver is silent, whatever else aboard lives
            return None
        receiver.told = said
        if not fusion.place(talker, position, now_s):
            return None
        accuracy_m: float | None = fusion.kinds["accuracy"].of(talker, now_s)
        fusion.tell("position", talker, position, now_s, 0, 0.0 if accuracy_m is None else accuracy_m / SQRT2)
        quality: Quality = fusion.kinds["quality"].of(talker, now_s) or UNSTATED
        satellites = fusion.kinds["dimensions"].of(talker, now_s) or ActiveSatellites(None, None)
        fix = 2 if quality.fix == 3 and satellites.dimensions == 2 else quality.fix
        hdop = satellites.hdop if quality.hdop is None else quality.hdop
        utc_ns = fusion.utc_ns(talker, now_s)
        return fusion.message(position, utc_ns, now_s, fix, quality.satellites, hdop, accuracy_m, quality.corrections_s)

    def _prefer(self) -> None:
        """The talkers that were heard, in the order of the vehicle's file: those it prefers, then port by port."""
        wanted = (*self._settings.preferred, *self._settings.ports)
        heard = sorted(self._heard_s, key=lambda talker: (not talker.endswith(f":{UBX}"), talker))
        order = tuple(talker for each in wanted for talker in heard if each in (talker, talker.partition(":")[0]))
        for newest in self.fusion.all:
            newest.prefer(tuple(dict.fromkeys(order)))

    def status(self, now_s: float) -> dict[str, object]:
        """Talkers used, by kind, and talkers heard with their ages, JSON-ready."""
        kinds = {kind: {"talker": talker, "age_s": age_s} for kind, (talker, age_s) in self.fusion.used(now_s).items()}
        talkers = {talker: now_s - at_s for talker, at_s in sorted(self._heard_s.items())}
        return {"kinds": kinds, "talkers": talkers, "talkers_too_many": self.strangers, "repeated": self.repeated}
