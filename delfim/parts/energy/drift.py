"""The boat's way over ground by its push: its speed through the water, what wind does to it, and the water's own motion.

With the push that gives u in still water by the vehicle's file, a boat whose keel points along h (n to starboard of it) makes

    k u + s (u - u0) along h,  and the water c,  and by the wind w: f (w . h) along h and ASIDE f (w . n) along n,  f = u0 / u.

u0 is the speed of the way home. What is learnt are k, s, c north, c east, w north, w east: a Kalman filter of six numbers, in
which the water drifts and the boat nearly stays. It learns from means of spells of one course and push: within a spell the
autopilot answers each gust with more push at the same speed, which looks like a slow hull. While the boat sails one way alone
much of it cannot be told apart; the covariance says so, and what follows from it for each way.
"""

import math
from typing import Final, NamedTuple

SPELL_S: Final = 60.0  # the longest ...
LEAST_S: Final = 20.0  # ... and the shortest that is learnt from
TURNED_RAD: Final = math.radians(20.0)  # from its mean: another spell
CHANGED_MPS: Final = 0.15  # likewise
NOISE_MPS: Final = 0.04  # of a spell, beside the model; waves and gusts are least in long ones
FACTOR: Final = 0.06  # of k, when nothing was learnt: drag and thrust of a file are guesses
SLOPE: Final = 0.1  # of s
GUESSED: Final = 0.98, 0.12  # k and s where a file has the speed at full thrust alone, and drag is taken as a square: ...
# ... part of it grows less, and a slow boat is slower than that has it. The simulator's boats: 0.89 to 0.98, and 0.12 to 0.2
CURRENT_MPS: Final = 0.3  # of the water, north and east
WIND_MPS: Final = 0.07  # of what the wind does at u0
PER_S: Final = (0.02**2 / 3600.0, 0.0, *(0.3**2 / 1200.0,) * 2, *(0.05**2 / 1200.0,) * 2)  # by which the six drift: ...
# ... a current of 0.4 m/s that turns by 120 degrees an hour changes by 0.28 m/s in 1,200 s
ASIDE: Final = 2.5  # the wind moves a boat so much more aside than ahead: 1.8 to 3.8 by the simulator's hulls
SLOWEST_MPS: Final = 0.5  # of f
FAR: Final = 16.0  # squared standard deviations; what is farther off counts less
MOST_MPS: Final = 50.0  # no boat goes so fast

Six = tuple[float, float, float, float, float, float]
Square = tuple[tuple[float, ...], ...]
BEFORE: Final = (FACTOR**2, SLOPE**2, CURRENT_MPS**2, CURRENT_MPS**2, WIND_MPS**2, WIND_MPS**2)

UNKNOWN: Final[Square] = tuple(
    [tuple([each if row == column else 0.0 for column in range(6)]) for row, each in enumerate(BEFORE)]
)


class DriftFound(NamedTuple):
    """What was learnt: u0, k, s, c and w, and the covariance of the last six, m/s and none."""

    at_mps: float
    factor: float = 1.0
    slope: float = 0.0
    north_mps: float = 0.0
    east_mps: float = 0.0
    wind_north_mps: float = 0.0
    wind_east_mps: float = 0.0
    covariance: Square = UNKNOWN

    def wind(self, still_mps: float, ahead_n: float, ahead_e: float) -> tuple[float, float, float]:
        """f, and what the wind makes of the way ahead and to starboard, with the keel along this unit vector."""
        part = self.at_mps / max(still_mps, SLOWEST_MPS)
        ahead = self.wind_north_mps * ahead_n + self.wind_east_mps * ahead_e
        return part, part * ahead, ASIDE * part * (self.wind_east_mps * ahead_n - self.wind_north_mps * ahead_e)


class Drifting:
    """The filter. Only `learn` and `pass_by` change it; the cost of a call is bounded, 5 us and once in a spell 60 us."""

    def __init__(self, speed_mps: float, is_guessed: bool = False) -> None:
        """`speed_mps`: with which the boat goes home; `is_guessed`: the file's drag is a square alone."""
        self.found = DriftFound(speed_mps, *GUESSED) if is_guessed else DriftFound(speed_mps)
        self._spell: tuple[float, ...] = (
            0.0,
        ) * 6  # s; of the still-water speed, the heading's cosine and sine, the velocity: times s
        self._passed_s = 0.0  # for which the covariance has not grown yet

    def pass_by(self, dt_s: float) -> None:
        """Time passes: what is known ages, whether the boat learns or not."""
        self._passed_s += min(max(dt_s, 0.0), 10.0)
        if self._passed_s >= SPELL_S:
            self.found = self.found._replace(covariance=self._aged())

    def learn(self, still_mps: float, heading_rad: float, north_mps: float, east_mps: float, dt_s: float) -> None:
        """A second of steady way: `still_mps` u of the push, and the velocity over ground."""
        speeds_mps = still_mps, north_mps, east_mps
        if not (all(abs(each) < MOST_MPS for each in speeds_mps) and math.isfinite(heading_rad) and dt_s > 0.0):
            return
        seconds, u, c, s, north, east = self._spell
        if seconds:
            mean_rad = math.atan2(s, c)
            has_turned = abs(math.remainder(heading_rad - mean_rad, math.tau)) > TURNED_RAD
            if has_turned or abs(still_mps - u / seconds) > CHANGED_MPS or seconds >= SPELL_S:
                if seconds >= LEAST_S:
                    self._take(seconds, u / seconds, mean_rad, north / seconds, east / seconds)
                self._spell = (0.0,) * 6
        news = (1.0, still_mps, math.cos(heading_rad), math.sin(heading_rad), north_mps, east_mps)
        self._spell = tuple([was + min(dt_s, 10.0) * new for was, new in zip(self._spell, news, strict=True)])

    def _aged(self) -> Square:
        passed_s, self._passed_s = self._passed_s, 0.0
        rows = [list(row) for row in self.found.covariance]
        for index, (per_s, most) in enumerate(zip(PER_S, BEFORE, strict=True)):
            rows[index][index] = min(rows[index][index] + per_s * passed_s, max(most, rows[index][index]))
        return tuple([tuple(row) for row in rows])

    def _take(self, seconds: float, still_mps: float, heading_rad: float, north_mps: float, east_mps: float) -> None:
        """A spell: its north and its east component, one after the other."""
        n, e, at_mps = math.cos(heading_rad), math.sin(heading_rad), self.found.at_mps
        part, more = at_mps / max(still_mps, SLOWEST_MPS), still_mps - at_mps
        crossed = -(ASIDE - 1.0) * part * n * e
        known, rows = list(self.found[1:7]), self._aged()
        for told, row in (
            (north_mps, (still_mps * n, more * n, 1.0, 0.0, part * (n * n + ASIDE * e * e), crossed)),
            (east_mps, (still_mps * e, more * e, 0.0, 1.0, crossed, part * (e * e + ASIDE * n * n))),
        ):
            ways = [sum(a * b for a, b in zip(line, row, strict=True)) for line in rows]
            off = told - sum(a * b for a, b in zip(known, row, strict=True))
            expected = sum(a * b for a, b in zip(ways, row, strict=True)) + NOISE_MPS**2 * max(SPELL_S / seconds, 1.0)
            expected = max(expected, off * off / FAR)
            known = [a + way * off / expected for a, way in zip(known, ways, strict=True)]
            rows = tuple(
                [
                    tuple([a - w * v / expected for a, v in zip(line, ways, strict=True)])
                    for line, w in zip(rows, ways, strict=True)
                ]
            )
        k, slope, c_n, c_e, w_n, w_e = known
        self.found = DriftFound(at_mps, k, slope, c_n, c_e, w_n, w_e, rows)


def still_mps(drift: DriftFound, speed_mps: float, course_rad: float) -> tuple[float, float]:
    """The still-water speed of the push that takes the boat over ground with this speed on this course, and its heading."""
    north = speed_mps * math.cos(course_rad) - drift.north_mps
    east = speed_mps * math.sin(course_rad) - drift.east_mps
    still, heading_rad, per = math.hypot(north, east), math.atan2(east, north), max(drift.factor + drift.slope, 0.2)
    for _ in range(3):  # the wind's part is small
        n, e = math.cos(heading_rad), math.sin(heading_rad)
        _, ahead, aside = drift.wind(still, n, e)
        by_n, by_e = north - ahead * n + aside * e, east - ahead * e - aside * n
        still, heading_rad = max(math.hypot(by_n, by_e) + drift.slope * drift.at_mps, 0.0) / per, math.atan2(by_e, by_n)
    return still, heading_rad


def over_ground_mps(drift: DriftFound, still: float, course_rad: float) -> float:
    """The speed over ground on a course with the push of this still-water speed, with a crab angle; 0 where the boat makes no
    way on it."""
    n, e = math.cos(course_rad), math.sin(course_rad)
    _, ahead, aside = drift.wind(still, n, e)  # as if the keel lay along the course
    through = max(drift.factor * still + drift.slope * (still - drift.at_mps), 0.1 * still)
    along = drift.north_mps * n + drift.east_mps * e + ahead
    across = drift.east_mps * n - drift.north_mps * e + aside
    left = through * through - across * across
    return max(along + math.sqrt(left), 0.0) if left > 0.0 else 0.0


def unsure(drift: DriftFound, still: float, heading_rad: float) -> Six:
    """How the way ahead changes with each of the six, by this push: m/s for each."""
    n, e = math.cos(heading_rad), math.sin(heading_rad)
    part = drift.at_mps / max(still, SLOWEST_MPS)
    return still, still - drift.at_mps, n, e, part * n, part * e
