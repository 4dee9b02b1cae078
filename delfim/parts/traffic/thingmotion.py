"""How a thing moves, from its sightings: a swimmer, what drifts, a kayak without AIS.

A line through the places where it was seen, fitted by least squares at first, and fading later: the older a sighting, the less
it counts (Morrison 1969, the expanding- and fading-memory filters of degree 1). A motion that is within the scatter of the
sightings is none, so that a buoy which a camera tells poorly stands. Pure; a sighting costs some arithmetic.
"""

import math
from typing import Final, NamedTuple

from delfim.base.geodesy import wrap

FADES_S: Final = 5.0  # a sighting so old counts a third of a new one
SURE_S: Final = 5.0  # for so long a thing must have been seen before its motion counts
GAP_S: Final = 10.0  # after such a silence its motion is measured anew
SLOWEST_MPS, FASTEST_MPS = 0.25, 3.0  # below, it stands; faster than that none is believed to be
SCATTER: Final = 2.0  # its way within FADES_S is longer than so many times the scatter
RADIUS_M: Final = 6_378_137.0
STILL: Final = 0.0, 0.0


class ThingMotion(NamedTuple):
    """What is known of it at its last sighting."""

    latitude_rad: float  # on the line
    longitude_rad: float
    at_s: float
    since_s: float  # when it was seen first
    seen: int = 1  # so often
    north_mps: float = 0.0
    east_mps: float = 0.0
    scatter_m: float = 0.0  # mean distance of a sighting from where the line led
    moves_s: float = math.inf  # since when it moves; inf: it stands

    @property
    def mps(self) -> tuple[float, float]:
        """Its velocity to north and east, where it is known to move; 0, 0: it stands, or nobody knows."""
        return STILL if self.moves_s == math.inf else (self.north_mps, self.east_mps)


def seen_at(latitude_rad: float, longitude_rad: float, now_s: float) -> ThingMotion:
    """After the first sighting."""
    return ThingMotion(latitude_rad, longitude_rad, now_s, now_s)


def seen_again(was: ThingMotion, latitude_rad: float, longitude_rad: float, now_s: float) -> ThingMotion:
    """After the next sighting. One of the same time, or an earlier one, changes nothing."""
    passed_s = now_s - was.at_s
    if passed_s <= 0.0:
        return was
    if passed_s > GAP_S:
        return seen_at(latitude_rad, longitude_rad, now_s)
    parallel_m = RADIUS_M * math.cos(latitude_rad)
    reckoned_rad = was.latitude_rad + was.north_mps * passed_s / RADIUS_M
    meridian_rad = was.longitude_rad + was.east_mps * passed_s / parallel_m
    off_n = RADIUS_M * (latitude_rad - reckoned_rad)
    off_e = parallel_m * wrap(longitude_rad - meridian_rad)
    kept, n = math.exp(-passed_s / FADES_S), was.seen + 1
    place = max(1.0 - kept * kept, 2.0 * (2 * n - 1) / (n * (n + 1)))
    more = max((1.0 - kept) ** 2, 6.0 / (n * (n + 1))) / passed_s
    scatter_m = was.scatter_m + place * (math.hypot(off_n, off_e) - was.scatter_m)
    mps = _bounded(was.north_mps + more * off_n, was.east_mps + more * off_e)
    speed_mps, is_sure = math.hypot(*mps), now_s - was.since_s >= SURE_S
    moves = is_sure and speed_mps >= SLOWEST_MPS and speed_mps * FADES_S > SCATTER * scatter_m
    return ThingMotion(
        reckoned_rad + place * off_n / RADIUS_M,
        wrap(meridian_rad + place * off_e / parallel_m),
        now_s,
        was.since_s,
        n,
        *mps,
        scatter_m,
        min(was.moves_s, now_s) if moves else math.inf,
    )


def told_to_move(was: ThingMotion, course_rad: float, speed_mps: float) -> ThingMotion:
    """After a sighting that tells its motion, too: it is taken as it is told."""
    mps = _bounded(speed_mps * math.cos(course_rad), speed_mps * math.sin(course_rad))
    moves_s = min(was.moves_s, was.at_s) if math.hypot(*mps) >= SLOWEST_MPS else math.inf
    return was._replace(north_mps=mps[0], east_mps=mps[1], moves_s=moves_s)


def _bounded(north_mps: float, east_mps: float) -> tuple[float, float]:
    part = FASTEST_MPS / max(math.hypot(north_mps, east_mps), FASTEST_MPS)
    return part * north_mps, part * east_mps
