"""One vessel: its last report, and its position now by dead reckoning, with the possible error (docs/traffic.md)."""

import math
from dataclasses import dataclass
from typing import Final

from delfim.base.geodesy import Origin, compass, to_plane, wrap
from delfim.base.vessels import THINGS, VesselFacts, VesselPosition
from delfim.vehicle.target import NEVER_S, Target

KNOT: Final = 1852.0 / 3600.0
JUMP_MPS: Final = 60.0 * KNOT  # no vessel is faster
JUMP_M: Final = 150.0  # of noise, and of reports that come some seconds late
LATITUDE_MAX_RAD: Final = math.radians(89.0)
LONGITUDE_MAX_RAD: Final = math.pi + 1e-6
RADIUS_M: Final = 6_378_137.0
STILL_MPS: Final = 0.25  # slower lies still
RESTING: Final = frozenset({1, 5, 6})  # at anchor, moored, aground; set by hand, so it is believed ...
RESTING_MPS: Final = 3.0 * KNOT  # ... up to this speed
RESTING_B_MPS: Final = 2.0 * KNOT  # class B reports each 3 minutes up to this speed
FAST_MPS, FASTER_MPS = 14.0 * KNOT, 23.0 * KNOT  # class A reports more often above these
TURN_S: Final = 30.0  # a rate of turn is believed for so long
TURN_RADPS: Final = math.radians(0.1), math.radians(12.0)  # a slower turn is none, a faster one is a sensor gone wrong
BASE_S: Final = 10.0  # between two positions that make a velocity, at least
BOW_MPS: Final = 1.0  # from this speed on the course stands for a heading that is not known
MARGIN_M, MARGIN_MPS = 10.0, 0.15  # of a vessel whose velocity is known, and by what it grows
THING_M: Final = 2.0  # of a thing, as a boat tells it to a console
DRIFT_MPS: Final = 2.5  # by what it grows if that is not known
MARGIN_MAX_M: Final = 500.0
SAME_RAD: Final = 5e-8  # 0.3 m: the ways round a position differently
STUCK_M: Final = 10.0  # of way, after which a vessel is not at the same place
# A report of the vessel itself is so near to where it is reckoned, its velocity so near to the last one: noise, lateness, ...
OFF_M, OFF_S, OFF_MPS = 30.0, 2.0, 3.0
OFF_MPS2: Final = 2.0  # ... and what it can have done since
DOUBT_S: Final = 60.0  # a place told for a vessel that is believed elsewhere is minded for so long
LENGTH_M, BEAM_M = (1.0, 500.0), (0.3, 100.0)  # that a vessel can have
SIZES: Final = {"A": (50.0, 10.0), "B": (15.0, 5.0), "fleet": (5.0, 2.5), "payload": (15.0, 5.0), "distress": (15.0, 5.0)} | (
    dict.fromkeys(THINGS, (1.0, 1.0))
)


@dataclass(slots=True)
class VesselTrack:
    """The track of a vessel that was heard. Angles in rad, None where they are not known."""

    kind: str
    by: str  # the way by which its last report came
    at_s: float  # monotonic time of that
    latitude_rad: float
    longitude_rad: float
    second: int | None
    status: int
    course_rad: float | None
    speed_mps: float | None
    heading_rad: float | None
    rate_radps: float
    base: tuple[float, float, float]  # latitude, longitude and time of an earlier position
    reports: int = 1
    rival: "VesselTrack | None" = None  # a report that was refused
    name: str = ""
    size: tuple[float, float] | None = None  # length and beam
    ahead_m: float = 0.0  # from the antenna to the middle of the hull
    starboard_m: float = 0.0
    doubt_m: float = 0.0  # how far off its reckoned place it was told to be, by others who are not believed either, and when
    doubt_s: float = NEVER_S

    def can_be_at(self, new: "VesselTrack") -> bool:
        """Whether the vessel can have come there since its last report."""
        most_m = JUMP_M + JUMP_MPS * max(new.at_s - self.at_s, 0.0)
        return math.hypot(*self._way_to(new)) <= most_m

    def _way_to(self, new: "VesselTrack") -> tuple[float, float]:
        """The way to a new position: north and east, m."""
        east = wrap(new.longitude_rad - self.longitude_rad) * math.cos((self.latitude_rad + new.latitude_rad) / 2.0)
        return RADIUS_M * (new.latitude_rad - self.latitude_rad), RADIUS_M * east

    def strays(self, new: "VesselTrack", late_s: float = 0.0) -> tuple[float, float, float]:
        """How far a report is from where this vessel is reckoned at its time: as a part of what one vessel can do since its
        last report, beyond 1 the two contradict each other; of what it does at once; and in m. Place and velocity both count.
        `late_s`: so long before the last report it was made; then it is compared with where the vessel was."""
        passed_s = -late_s or max(new.at_s - self.at_s, 0.0)
        (north_m, east_m), changed_s = self._way_to(new), max(passed_s, 0.0)
        velocity, its = self._velocity, new._velocity
        if velocity is None:
            far_m = math.hypot(north_m, east_m)
            return far_m / (OFF_M + JUMP_MPS * abs(passed_s)), far_m / OFF_M, far_m
        far_m = math.hypot(north_m - velocity[0] * passed_s, east_m - velocity[1] * passed_s)
        near_m = OFF_M + OFF_S * math.hypot(*velocity)
        changed_mps = 0.0 if its is None else math.dist(velocity, its)
        off = far_m / (near_m + 0.5 * OFF_MPS2 * changed_s * changed_s)
        return max(off, changed_mps / (OFF_MPS + OFF_MPS2 * changed_s)), far_m / near_m + changed_mps / OFF_MPS, far_m

    def doubt(self, far_m: float, now_s: float) -> None:
        """It may be so far from where it is reckoned."""
        self.doubt_m = max(far_m, self.doubt_m if now_s - self.doubt_s < DOUBT_S else 0.0)
        self.doubt_s = now_s

    def is_at(self, new: "VesselTrack") -> bool:
        """Whether a report has the same position, but for rounding."""
        north, east = new.latitude_rad - self.latitude_rad, wrap(new.longitude_rad - self.longitude_rad)
        return abs(north) <= SAME_RAD and abs(east) <= SAME_RAD

    def is_stuck(self, new: "VesselTrack") -> bool:
        """Whether a receiver repeats an old position of a vessel that reports that it moves."""
        speed_mps = new.speed_mps or 0.0
        return speed_mps >= BOW_MPS and speed_mps * (new.at_s - self.at_s) > STUCK_M and self.is_at(new)

    def take(self, new: "VesselTrack") -> None:
        """Take the next report. A velocity that it lacks is computed from two positions."""
        self.by, self.at_s, self.second, self.status = new.by, new.at_s, new.second, new.status
        self.latitude_rad, self.longitude_rad = new.latitude_rad, new.longitude_rad
        self.heading_rad, self.rate_radps = new.heading_rad, new.rate_radps
        self.reports += 1
        latitude_rad, longitude_rad, base_s = self.base
        passed_s = new.at_s - base_s
        if passed_s >= BASE_S:
            self.base = new.base
        if new.speed_mps is not None and (new.course_rad is not None or new.speed_mps < STILL_MPS):
            self.course_rad, self.speed_mps = new.course_rad, new.speed_mps
        elif passed_s >= BASE_S:
            self.course_rad, self.speed_mps = _made(latitude_rad, longitude_rad, new, passed_s)
        elif new.speed_mps is not None:
            self.speed_mps = new.speed_mps

    def measure(self, facts: VesselFacts) -> None:
        """Take name and size, and where the antenna stands. A size that no vessel has counts as unknown."""
        self.name = facts.name or self.name
        length_m, beam_m = facts.length_m or 0.0, facts.beam_m or 0.0
        if not (LENGTH_M[0] <= length_m <= LENGTH_M[1] and BEAM_M[0] <= beam_m <= BEAM_M[1]):
            return
        self.size, self.ahead_m, self.starboard_m = (length_m, beam_m), 0.0, 0.0
        bow_m, side_m = facts.from_bow_m, facts.from_starboard_m
        if bow_m is not None and side_m is not None and 0.0 < bow_m <= length_m and 0.0 <= side_m <= beam_m:
            self.ahead_m, self.starboard_m = bow_m - length_m / 2.0, side_m - beam_m / 2.0

    @property
    def is_resting(self) -> bool:
        """Whether it reports in long intervals."""
        if self.kind == "B":
            return self.speed_mps is not None and self.speed_mps < RESTING_B_MPS
        return self._lies and self.status in RESTING

    @property
    def haste(self) -> float:
        """The factor by which the limit of silence of class A is shorter at this speed."""
        speed_mps = self.speed_mps or 0.0
        return 1.0 if speed_mps < FAST_MPS else 0.6 if speed_mps < FASTER_MPS else 0.5

    @property
    def _velocity(self) -> tuple[float, float] | None:
        """The velocity to north and east, m/s; None: not known."""
        if self._lies:
            return 0.0, 0.0
        if self.speed_mps is None or self.course_rad is None:
            return None
        return self.speed_mps * math.cos(self.course_rad), self.speed_mps * math.sin(self.course_rad)

    @property
    def _lies(self) -> bool:
        if self.status in RESTING:
            return (self.speed_mps or 0.0) < RESTING_MPS
        return self.speed_mps is not None and self.speed_mps < STILL_MPS

    def target(self, key: str, age_s: float, is_lost: bool, origin: Origin) -> Target:
        """The vessel `age_s` after its last report. Every number is finite but a heading that is not known."""
        north_m, east_m = to_plane(origin, self.latitude_rad, self.longitude_rad)
        heading_rad, speed_mps = self.heading_rad, self.speed_mps or 0.0
        course_rad, margin_m = self.course_rad if self.course_rad is not None else heading_rad, MARGIN_M + MARGIN_MPS * age_s
        if self.kind in THINGS:
            margin_m = THING_M
        elif age_s + self.at_s - self.doubt_s < DOUBT_S:
            margin_m += self.doubt_m
        if self._lies:
            speed_mps = 0.0
        elif self.speed_mps is None or course_rad is None:
            margin_m += max(DRIFT_MPS, speed_mps) * age_s
            speed_mps = 0.0
        else:
            north, east, course_rad, turned_rad = _run(course_rad, speed_mps, self.rate_radps, age_s)
            north_m, east_m = north_m + north, east_m + east
            heading_rad = None if heading_rad is None else compass(heading_rad + turned_rad)
        bow_rad = heading_rad if heading_rad is not None else course_rad if speed_mps >= BOW_MPS else None
        if bow_rad is None:
            margin_m += math.hypot(self.ahead_m, self.starboard_m)
        else:
            north_m += self.ahead_m * math.cos(bow_rad) - self.starboard_m * math.sin(bow_rad)
            east_m += self.ahead_m * math.sin(bow_rad) + self.starboard_m * math.cos(bow_rad)
        length_m, beam_m = self.size or SIZES[self.kind]
        fields = (
            key,
            self.name or key,
            north_m,
            east_m,
            course_rad or 0.0,
            speed_mps,
            math.nan if heading_rad is None else heading_rad,
            length_m,
            beam_m,
            self.size is not None,
            min(margin_m, MARGIN_MAX_M),
            age_s,
            is_lost,
            self.kind,
            self.status,
        )
        return tuple.__new__(Target, fields)  # a third of the time of Target(...): there may be two hundred


def begun(position: VesselPosition, by: str, now_s: float) -> VesselTrack | None:
    """A vessel of which this is the first report; None: no vessel can be there, or so fast. Latitude and longitude 0 are told
    by a receiver that has no position."""
    latitude_rad, longitude_rad, speed_mps = position.latitude_rad, position.longitude_rad, position.speed_mps
    if latitude_rad is None or longitude_rad is None or latitude_rad == longitude_rad == 0.0 or position.kind not in SIZES:
        return None
    if not (abs(latitude_rad) <= LATITUDE_MAX_RAD and abs(longitude_rad) <= LONGITUDE_MAX_RAD):
        return None
    if speed_mps is not None and not 0.0 <= speed_mps <= JUMP_MPS:
        return None
    rate_radps = position.rate_radps or 0.0
    return VesselTrack(
        position.kind,
        by,
        now_s,
        latitude_rad,
        longitude_rad,
        position.second,
        position.status,
        _angle(position.course_rad),
        speed_mps,
        _angle(position.heading_rad),
        rate_radps if TURN_RADPS[0] <= abs(rate_radps) <= TURN_RADPS[1] else 0.0,
        (latitude_rad, longitude_rad, now_s),
    )


def _angle(told_rad: float | None) -> float | None:
    return compass(told_rad) if told_rad is not None and math.isfinite(told_rad) else None


def _made(latitude_rad: float, longitude_rad: float, now: VesselTrack, passed_s: float) -> tuple[float, float]:
    """Course and speed between two positions."""
    north = now.latitude_rad - latitude_rad
    east = wrap(now.longitude_rad - longitude_rad) * math.cos(latitude_rad)
    return compass(math.atan2(east, north)), min(RADIUS_M * math.hypot(north, east) / passed_s, JUMP_MPS)


def _run(course_rad: float, speed_mps: float, rate_radps: float, passed_s: float) -> tuple[float, float, float, float]:
    """(north_m, east_m, course_rad, turned_rad): an arc for up to TURN_S, then straight on."""
    if rate_radps == 0.0:
        way_m = speed_mps * passed_s
        return way_m * math.cos(course_rad), way_m * math.sin(course_rad), course_rad, 0.0
    arc_s = min(passed_s, TURN_S)
    turned_rad = rate_radps * arc_s
    after_rad, radius_m, way_m = course_rad + turned_rad, speed_mps / rate_radps, speed_mps * (passed_s - arc_s)
    north_m = radius_m * (math.sin(after_rad) - math.sin(course_rad)) + way_m * math.cos(after_rad)
    east_m = radius_m * (math.cos(course_rad) - math.cos(after_rad)) + way_m * math.sin(after_rad)
    return north_m, east_m, compass(after_rad), turned_rad
