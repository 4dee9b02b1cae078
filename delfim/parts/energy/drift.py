"""The boat's way over ground by its push: its speed through the water, and the water's own, learnt while it sails.

Over ground the boat moves with k u(push) along its keel, and with the water c: u is the speed at which the file's drag takes
the push. k, c north and c east are least squares of all seconds, forgotten within five minutes (the tide turns), with a prior:
k near that of the last hour, c near nothing. While the boat sails one way alone, k and c cannot be told apart: the push for
another way is uncertain then, and `still_mps` says more. Wind counts as water: it carries the boat and slows it.
"""

import math
from typing import Final, NamedTuple

FORGET_S: Final = 300.0
NOISE_MPS: Final = 0.15  # of a velocity, beside the model ...
ALIKE_S: Final = 10.0  # ... which stays for so long: waves, gusts, a controller at work
FACTOR: Final = 0.1  # of k, when nothing was learnt: drag and thrust of a file are guesses
KNOWN: Final = 0.03  # of k, when it was learnt
CURRENT_MPS: Final = 0.3  # of the water
REMEMBERS_S: Final = 1200.0  # k of the boat is that of so long
SOON_S: Final = 300.0  # after so long of it the first guess is half forgotten
SIGMAS: Final = 0.2  # of what is not known of the water, added to what the boat needs
NEAR_MPS: Final = 0.3  # a speed that is so far from that of the way home counts half
MOST_MPS: Final = 50.0  # no boat goes so fast
SEEN: Final = 0.1  # k is remembered where it is known as well as this


class DriftFound(NamedTuple):
    """What was learnt. `covariance` is of (k, north, east), its six upper numbers row by row."""

    factor: float = 1.0
    north_mps: float = 0.0
    east_mps: float = 0.0
    covariance: tuple[float, float, float, float, float, float] = (FACTOR**2, 0.0, 0.0, CURRENT_MPS**2, 0.0, CURRENT_MPS**2)


class Drifting:
    """The sums of the least squares. Only `learn` changes them; the cost of a call is some 10 us."""

    def __init__(self, speed_mps: float) -> None:
        """`speed_mps`: with which the boat goes home; what is learnt near it counts more, for no hull is quite as told."""
        self._speed_mps = speed_mps
        # Of u u, u to north, u to east, 1; and, with the velocity g, of u g along the keel, g to north, g to east.
        self._sums: tuple[float, ...] = (0.0,) * 7
        self._factor, self._sure_s = 1.0, 0.0  # k of the last hour, and how long it was known well
        self.found = DriftFound()

    def learn(self, still_mps: float, heading_rad: float, north_mps: float, east_mps: float, dt_s: float) -> None:
        """A second of steady way: `still_mps` u of the push, and the velocity over ground."""
        speeds_mps = still_mps, north_mps, east_mps
        if not (all(abs(each) < MOST_MPS for each in speeds_mps) and math.isfinite(heading_rad) and dt_s > 0.0):
            return
        dt_s = min(dt_s, 10.0)
        far = (still_mps - self._speed_mps) / NEAR_MPS
        keep, counts = math.exp(-dt_s / FORGET_S), dt_s / (ALIKE_S * NOISE_MPS**2) / (1.0 + far * far)
        along_n, along_e = still_mps * math.cos(heading_rad), still_mps * math.sin(heading_rad)
        news = (
            still_mps * still_mps,
            along_n,
            along_e,
            1.0,
            along_n * north_mps + along_e * east_mps,
            north_mps,
            east_mps,
        )
        self._sums = tuple([was * keep + counts * new for was, new in zip(self._sums, news, strict=True)])
        self.found = self._solved()
        if self.found.covariance[0] < SEEN**2:
            self._factor += dt_s / (min(self._sure_s, REMEMBERS_S) + SOON_S) * (self.found.factor - self._factor)
            self._sure_s += dt_s

    def _solved(self) -> DriftFound:
        """The least squares with their prior: three unknowns, of which north and east meet in k alone."""
        uu, un, ue, ones, ug, gn, ge = self._sums
        spread = max(KNOWN, FACTOR / (1.0 + self._sure_s / SOON_S))
        prior, c_prior = 1.0 / spread**2, 1.0 / CURRENT_MPS**2
        ones += c_prior
        left = uu + prior - (un * un + ue * ue) / ones  # above 0: the prior is
        factor = (ug + prior * self._factor - (un * gn + ue * ge) / ones) / left
        of_k, of_n, of_e = 1.0 / left, un / ones, ue / ones
        covariance = (
            of_k,
            -of_k * of_n,
            -of_k * of_e,
            1.0 / ones + of_k * of_n * of_n,
            of_k * of_n * of_e,
            1.0 / ones + of_k * of_e * of_e,
        )
        return DriftFound(factor, (gn - factor * un) / ones, (ge - factor * ue) / ones, covariance)


def still_mps(drift: DriftFound, speed_mps: float, course_rad: float) -> float:
    """The still-water speed of the push that takes the boat over ground with this speed on this course, and more: SIGMAS
    standard deviations of what is not known of it."""
    through_n = speed_mps * math.cos(course_rad) - drift.north_mps
    through_e = speed_mps * math.sin(course_rad) - drift.east_mps
    through, k = math.hypot(through_n, through_e), max(drift.factor, 0.1)
    if through < 1e-3:
        return through
    by_k, n, e = -through / (k * k), -through_n / (through * k), -through_e / (through * k)
    kk, kn, ke, nn, ne, ee = drift.covariance
    variance = by_k * (by_k * kk + 2.0 * (n * kn + e * ke)) + n * n * nn + 2.0 * n * e * ne + e * e * ee
    return through / k + SIGMAS * math.sqrt(max(variance, 0.0))


def over_ground_mps(drift: DriftFound, still: float, course_rad: float) -> float:
    """The speed over ground on a course with the push of this still-water speed, with a crab angle; 0 where the boat makes no
    way on it."""
    north, east = math.cos(course_rad), math.sin(course_rad)
    through = max(drift.factor, 0.1) * still
    along, across = drift.north_mps * north + drift.east_mps * east, drift.east_mps * north - drift.north_mps * east
    left = through * through - across * across
    return max(along + math.sqrt(left), 0.0) if left > 0.0 else 0.0
