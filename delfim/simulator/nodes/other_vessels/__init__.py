"""Other vessels of the simulated world: their motion, what a boat receives of them by AIS, and how near they come in truth.

They sail by the rows of `simulation.traffic` in the vehicle's file; none of them sees the boat but those that follow or chase
it. A receiver on the NMEA 2000 bus speaks their AIS with the intervals of ITU-R M.1371 (docs/encounters.md).
"""

import math
from collections import deque
from collections.abc import Iterator
from random import Random
from typing import Final, NamedTuple

from delfim import config
from delfim.base.frames import Frame
from delfim.base.geodesy import from_plane, to_plane, wrap
from delfim.base.vessels import VesselFacts, VesselPosition
from delfim.canproxy.socket import CanAddress
from delfim.simulator.model import Model
from delfim.simulator.nodes.other_vessels.frames import facts, framed, position
from delfim.simulator.nodes.other_vessels.sentences import facts_said, position_said
from delfim.simulator.nodes.period import TOLERANCE_S, Period
from delfim.simulator.nodes.talkers import placed
from delfim.simulator.tables import SimulatedVessel, Simulation

FIRST_MMSI: Final = 235_000_000
KNOT_MPS: Final = 1852.0 / 3600.0
SENTENCES_MAX: Final = 256  # that a line has not taken yet; there may be none
LATE_MAX: Final = 4096  # messages of a late receiver that are under way
STATIC_S: Final = 360.0  # between two tellings of name and size
FIRST_STATIC_S: Final = 20.0  # the first one comes within this time
PERFECT_S: Final = 1.0
RESTING: Final = (1, 5)  # status: at anchor, moored
WANDER_S: Final = 60.0  # of the error of a position
SLOW_MPS: Final = 3.0 * KNOT_MPS  # below, a receiver's course is poor ...
COURSE_NOISE_DEG: Final = 0.7
SLOW_NOISE_DEG: Final = 2.0  # ... by so much
SPEED_NOISE_KN: Final = 0.1
AHEAD, ABEAM = 4.0, 1.6  # half axes of the domain, lengths (Fujii and Tanaka 1971) ...
AHEAD_MIN_M, ABEAM_MIN_M = 50.0, 30.0  # ... and at least
AMPLE_S, LATE_S, SILENT_S = 420.0, 150.0, 150.0  # before they meet: who gives way turns, in time or late; AIS falls silent
GAP_S: Final = (200.0, 80.0)  # before they meet: AIS is silent
AWAY_DEG, AFTER_S = 40.0, 30.0  # who gives way turns so far to starboard, and back so long after
GIVES_WAY: Final = ("head-on", "stand-on", "overtaken")  # meetings in which the vessel must keep clear of the boat
TURN_DEG, TURN_S = 30.0, (60.0, 400.0)  # who turns without a reason, and when before they meet


def axes_m(length_m: float) -> tuple[float, float]:
    """Half axes of the domain of a vessel, along and across its course."""
    return max(AHEAD * length_m, AHEAD_MIN_M), max(ABEAM * length_m, ABEAM_MIN_M)


def nearness(north_m: float, east_m: float, course_rad: float, axes: tuple[float, float]) -> float:
    """How far a point at this distance from a vessel is in its domain: 0 in the middle, 1 on the edge."""
    return within(north_m, east_m, math.cos(course_rad), math.sin(course_rad), axes)


def within(north_m: float, east_m: float, c: float, s: float, axes: tuple[float, float]) -> float:
    """The nearness of a point, by the cosine and the sine of the course."""
    return math.hypot((north_m * c + east_m * s) / axes[0], (east_m * c - north_m * s) / axes[1])


class Vessel:
    """One vessel: its true motion, and the nearest that the boat came to it."""

    def __init__(self, row: SimulatedVessel, mmsi: int, model: Model, random: Random, manner: str) -> None:
        self.row, self.mmsi, self._model = row, mmsi, model
        self.north_m, self.east_m = row.north_m, row.east_m
        if row.latitude_deg is not None and row.longitude_deg is not None:
            self.north_m, self.east_m = to_plane(model.origin, math.radians(row.latitude_deg), math.radians(row.longitude_deg))
        self.course_rad, self.speed_mps = math.radians(row.course_deg), row.speed_mps
        self._c, self._s = math.cos(self.course_rad), math.sin(self.course_rad)
        self.rate_radps = 0.0  # positive to starboard
        self.silent = silent_of(row, manner)
        self._turns = [(at_s, math.radians(course_deg)) for at_s, course_deg in sorted(turns_of(row, manner, random))]
        self._turn_radps = math.radians(row.turn_dps)
        self._t_s = 0.0
        self._axes_m = axes_m(row.length_m)
        self.nearest, self.nearest_m = math.inf, math.inf  # in domains, and from middle to middle
        self.nearest_s = 0.0  # when it was nearest, in domains

    def sail(self, t_s: float) -> None:
        """Sail on to this time since the start."""
        h = t_s - self._t_s
        self._t_s, way_m, wanted_rad = t_s, self.speed_mps * h, self.course_rad
        if self.row.chases:
            wanted_rad = math.atan2(self._model.east_m - self.east_m, self._model.north_m - self.north_m)
        for at_s, course_rad in self._turns:
            if at_s <= t_s:
                wanted_rad = course_rad
        if self.row.follows_m is not None:
            self._follow(self.row.follows_m, t_s)
        elif wanted_rad == self.course_rad:
            self.rate_radps = 0.0
            self.north_m, self.east_m = self.north_m + way_m * self._c, self.east_m + way_m * self._s
        else:
            self._turn(wanted_rad, way_m, h)
        self._measure()

    def _follow(self, away_m: float, t_s: float) -> None:
        """Move to its place beside the boat, whatever it reports of its course and speed."""
        sides_s, bearing_rad = self.row.sides_s, math.radians(self.row.follows_deg)
        if sides_s and t_s // sides_s % 2.0:
            bearing_rad += math.pi
        self.north_m = self._model.north_m + away_m * math.cos(bearing_rad)
        self.east_m = self._model.east_m + away_m * math.sin(bearing_rad)

    def _turn(self, wanted_rad: float, way_m: float, h: float) -> None:
        """Sail on by this distance in this time, turning towards another course."""
        most_rad = self._turn_radps * h
        turned_rad = min(max(wrap(wanted_rad - self.course_rad), -most_rad), most_rad)
        middle_rad = self.course_rad + 0.5 * turned_rad
        self.north_m, self.east_m = self.north_m + way_m * math.cos(middle_rad), self.east_m + way_m * math.sin(middle_rad)
        self.course_rad, self.rate_radps = self.course_rad + turned_rad, turned_rad / h if h else 0.0
        self._c, self._s = math.cos(self.course_rad), math.sin(self.course_rad)

    def _measure(self) -> None:
        """The boat's place in the domain of this vessel, 1 on its edge."""
        north_m, east_m = self._model.north_m - self.north_m, self._model.east_m - self.east_m
        near, near_m = within(north_m, east_m, self._c, self._s, self._axes_m), math.hypot(north_m, east_m)
        if near < self.nearest:
            self.nearest, self.nearest_s = near, self._t_s
        if near_m < self.nearest_m:
            self.nearest_m = near_m


class Spoken(NamedTuple):
    """A message of AIS that is received."""

    told: VesselPosition | VesselFacts
    status: int | None  # of a position of class A
    is_class_a: bool
    second: int  # of UTC


class Transponder:
    """The transponder of a vessel: lossy, late and wrong as AIS is."""

    def __init__(self, vessel: Vessel, heard: str, lost: float, noise: bool, random: Random) -> None:
        row = vessel.row
        self._vessel, self._random, self._is_perfect = vessel, random, heard == "perfect"
        self._is_class_a = (heard if heard in ("A", "B") else row.transponder) == "A"
        self._lost = 0.0 if self._is_perfect else max(row.lost, lost)
        self._noise_m = row.noise_m if noise and not self._is_perfect else 0.0
        self._error_m = [random.gauss(0.0, self._noise_m) for _ in "ne"]
        self._straight_s, self._turning_s = self._intervals_s()
        self._said_s = -random.uniform(0.0, self._straight_s)  # its last position
        self._last: VesselPosition | None = None
        self._facts_due_s = random.uniform(0.0, FIRST_STATIC_S)

    def _intervals_s(self) -> tuple[float, float]:
        """The intervals between two positions, straight on and turning (ITU-R M.1371): of class A by speed and turning, of
        class B "CS" by speed. A vessel keeps its speed."""
        knots = self._vessel.speed_mps / KNOT_MPS
        if self._is_perfect:
            return PERFECT_S, PERFECT_S
        if not self._is_class_a:
            return (30.0, 30.0) if knots > 2.0 else (180.0, 180.0)
        if self._vessel.row.status in RESTING and knots <= 3.0:
            return 180.0, 180.0
        if knots > 23.0:
            return 2.0, 2.0
        return (10.0, 10.0 / 3.0) if knots <= 14.0 else (6.0, 2.0)

    def is_due(self, t_s: float) -> bool:
        """Whether it has a position or its facts to send."""
        return t_s >= self._facts_due_s or self._is_position_due(t_s)

    def _is_position_due(self, t_s: float) -> bool:
        interval_s = self._turning_s if abs(self._vessel.rate_radps) > 1e-3 else self._straight_s
        return t_s >= self._said_s + interval_s - TOLERANCE_S

    def speak(self, t_s: float, second: int, frozen: bool, wrong_m: float) -> Iterator[Spoken]:
        """The messages of this instant that are received. Of a receiver that is `frozen` the position is the last one;
        `wrong_m` is how far it may be off."""
        status = self._vessel.row.status if self._is_class_a else None
        if self._is_position_due(t_s):
            told, is_first = self._reported(t_s, wrong_m), self._last is None
            self._last = told = self._last if frozen and self._last is not None else told
            if self._is_heard(t_s, is_first):
                yield Spoken(told, status, self._is_class_a, second)
        if t_s >= self._facts_due_s:
            is_first, self._facts_due_s = self._facts_due_s <= FIRST_STATIC_S, t_s + STATIC_S
            if self._is_heard(t_s, is_first):
                yield Spoken(self._facts(), status, self._is_class_a, second)

    def _is_heard(self, t_s: float, is_first: bool) -> bool:
        """Whether a message is received. The first of a kind stands for those before the run and is not lost: a vessel was in
        reach for an hour, and a slow one sends its position each 3 minutes."""
        begin_s, end_s = self._vessel.silent
        return (self._random.random() >= self._lost or is_first) and not begin_s <= t_s < end_s

    def _reported(self, t_s: float, wrong_m: float) -> VesselPosition:
        """The position of its antenna, course and speed, with their errors, as coarse as AIS is."""
        vessel, gauss = self._vessel, self._random.gauss
        keep = math.exp((self._said_s - t_s) / WANDER_S)
        self._said_s, new_m = t_s, self._noise_m * math.sqrt(1.0 - keep * keep)
        self._error_m = [keep * each + gauss(0.0, new_m) for each in self._error_m]
        ahead_m = vessel.row.antenna_m
        north_m = vessel.north_m + ahead_m * math.cos(vessel.course_rad) + self._error_m[0]
        east_m = vessel.east_m + ahead_m * math.sin(vessel.course_rad) + self._error_m[1]
        if wrong_m:
            north_m, east_m = (
                north_m + self._random.uniform(-wrong_m, wrong_m),
                east_m + self._random.uniform(-wrong_m, wrong_m),
            )
        latitude_rad, longitude_rad = from_plane(vessel._model.origin, north_m, east_m)
        course_rad, speed_mps = vessel.course_rad, vessel.speed_mps
        if self._noise_m:
            off_deg = gauss(0.0, SLOW_NOISE_DEG if speed_mps < SLOW_MPS else COURSE_NOISE_DEG)
            course_rad = math.radians(round(math.degrees(course_rad) + off_deg, 1))
            speed_mps = max(round(speed_mps / KNOT_MPS + gauss(0.0, SPEED_NOISE_KN), 1), 0.0) * KNOT_MPS
        heading_rad = vessel.course_rad if self._is_class_a else None
        rate_radps = vessel.rate_radps if self._is_class_a else None
        return VesselPosition(vessel.mmsi, latitude_rad, longitude_rad, course_rad, speed_mps, heading_rad, rate_radps)

    def _facts(self) -> VesselFacts:
        row = self._vessel.row
        bow_m = 0.5 * row.length_m - row.antenna_m
        return VesselFacts(self._vessel.mmsi, row.name, None, row.type, row.length_m, row.beam_m, 0.5 * row.beam_m, bow_m)


class Shipping:
    """All other vessels, and a receiver of AIS on the NMEA 2000 bus."""

    hears: tuple[CanAddress, ...] = ()

    def __init__(self, settings: config.Vehicle, model: Model, seed: int) -> None:
        here = settings.of(Simulation).traffic
        self.interface, self._period, self._began_s = settings.table("nmea2000").interface, Period(PERFECT_S / 5.0), math.nan
        self._sequence = dict[int, int]()
        self._late = deque[tuple[float, Spoken]](maxlen=LATE_MAX)  # when due
        self.sentences = deque[bytes](maxlen=SENTENCES_MAX)  # the same for a line of NMEA 0183, which takes them from here
        self._has_line = bool(placed(settings))
        self._said = 0
        self.silent = self.frozen = False  # frozen: it repeats the last position of each vessel
        self.late_s = 0.0
        self.wrong_m = 0.0  # each position is off by up to so much, another way each time
        self.vessels = list[Vessel]()
        self._transponders = list[Transponder]()
        for number, row in enumerate(here.vessel):
            random = Random(f"vessel {number} {seed}")
            vessel = Vessel(row, row.mmsi or FIRST_MMSI + number, model, random, here.manner)
            self.vessels.append(vessel)
            if row.transponder != "none":
                self._transponders.append(Transponder(vessel, here.heard, here.lost, settings.of(Simulation).noise, random))

    @property
    def due_s(self) -> float:
        """The time when `step` is due next."""
        return self._period.due_s

    def feed(self, frame: Frame, now_s: float) -> None:
        """Ignore the frame: the receiver listens to nobody."""

    def step(self, now_s: float, utc_ns: int) -> list[Frame]:
        """The frames that the receiver sends now; the vessels sail on to this time."""
        if not self._period.passed(now_s):
            return []
        if math.isnan(self._began_s):
            self._began_s = now_s
        t_s, second = now_s - self._began_s, utc_ns // 1_000_000_000 % 60
        for vessel in self.vessels:
            vessel.sail(t_s)
        for each in self._transponders:
            if each.is_due(t_s):
                self._late.extend((now_s + self.late_s, said) for said in each.speak(t_s, second, self.frozen, self.wrong_m))
        frames = list[Frame]()
        while self._late and self._late[0][0] <= now_s:
            frames += self._hear(self._late.popleft()[1])
        return frames

    def _hear(self, said: Spoken) -> Iterator[Frame]:
        """The frames of a message; its sentences are kept for the line."""
        told, status, is_class_a, second = said
        if self.silent:
            return
        self._said += 1
        if isinstance(told, VesselPosition):
            messages = [position(told, status, second)]
            if self._has_line:
                self.sentences.append(position_said(told, status, second))
        else:
            messages = list(facts(told, is_class_a))
            if self._has_line:
                self.sentences.extend(facts_said(told, is_class_a, self._said))
        for pgn, data in messages:
            yield from framed(pgn, data, self._next(pgn))

    def _next(self, pgn: int) -> int:
        self._sequence[pgn] = (self._sequence.get(pgn, -1) + 1) % 8
        return self._sequence[pgn]


def silent_of(row: SimulatedVessel, manner: str) -> tuple[float, float]:
    """The time, s, from when to when a vessel's AIS is silent."""
    if row.meets_s is not None and manner == "silent":
        return row.meets_s - SILENT_S, math.inf
    if row.meets_s is not None and manner == "gap":
        return row.meets_s - GAP_S[0], row.meets_s - GAP_S[1]
    begin_s, end_s = row.silent_from_s, row.silent_to_s
    return math.inf if begin_s is None else begin_s, math.inf if end_s is None else end_s


def turns_of(row: SimulatedVessel, manner: str, random: Random) -> list[tuple[float, float]]:
    """The (time s, course deg) of each turn of a vessel."""
    turns = [(turn.at_s, turn.course_deg) for turn in row.turns]
    if row.meets_s is None:
        return turns
    if manner in ("rules", "late") and row.meeting in GIVES_WAY:
        before_s = AMPLE_S if manner == "rules" else LATE_S
        return [*turns, (row.meets_s - before_s, row.course_deg + AWAY_DEG), (row.meets_s + AFTER_S, row.course_deg)]
    if manner == "turn":
        return [*turns, (row.meets_s - random.uniform(*TURN_S), row.course_deg + random.choice((-TURN_DEG, TURN_DEG)))]
    return turns


def devices_of(settings: config.Vehicle, model: Model, seed: int) -> Shipping | None:
    return Shipping(settings, model, seed) if settings.of(Simulation).traffic.vessel else None
