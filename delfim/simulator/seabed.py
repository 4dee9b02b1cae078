"""The bottom of the simulated sea, drawn from a seed, and the echoes that a sounder hears of it.

`SeaBed.depth_m` is the truth: whoever judges a chart asks it. It is a pure function of place and time. The bed slopes, has
hills, a channel that winds, and shallows and boulders within SCATTERED_M of its middle; it does not dry, and no boat runs
aground.
"""

import math
from random import Random
from typing import Final, NamedTuple

from delfim.base.geodesy import Origin, origin, to_plane
from delfim.simulator.tables import SimulatedBed, Simulation

SCATTERED_M: Final = 300.0  # shallows and boulders are no farther north, south, east or west of the middle
LEAST_M: Final = 0.3  # of water, anywhere
SHALLOWS, BOULDERS = 6, 20
STEEPEST: Final = 1.0 / 60.0  # slope of the whole bed
HILLS_M: Final = (330.0, 210.0, 130.0, 80.0, 50.0, 32.0, 20.0)  # their lengths from crest to crest
HILL: Final = 0.08  # height of the longest, of the mean depth
LEVEL: Final = 0.4  # of the mean depth: what the slope comes to, far away


class Hill(NamedTuple):
    """One wave of the ground."""

    height_m: float
    north_rad_per_m: float
    east_rad_per_m: float
    phase_rad: float


class Rise(NamedTuple):
    """A shallow or a boulder: round, and as high at its middle."""

    north_m: float
    east_m: float
    height_m: float
    radius_m: float


class Channel(NamedTuple):
    """A deeper strip whose middle line is a sine."""

    bearing_rad: float
    off_m: float  # of the bed's middle, to the right of the bearing
    deeper_m: float
    half_width_m: float
    swing_m: float
    length_m: float  # from bend to bend and back


class SeaBed:
    """A bed about its middle."""

    def __init__(self, table: SimulatedBed, middle: Origin) -> None:
        draw = Random(f"sea bed {table.seed}")
        self.middle, self._table, mean_m = middle, table, table.mean_m
        to_rad, steep = draw.uniform(0.0, math.tau), draw.uniform(0.2, 1.0) * STEEPEST
        self._slope = LEVEL * mean_m, steep * math.cos(to_rad), steep * math.sin(to_rad)
        self._hills = [_hill(draw, HILL * mean_m * (long_m / HILLS_M[0]) ** 0.8, long_m) for long_m in HILLS_M]
        self._channel = Channel(
            draw.uniform(0.0, math.pi),
            draw.uniform(-0.4, 0.4) * SCATTERED_M,
            draw.uniform(0.15, 0.4) * mean_m,
            draw.uniform(10.0, 25.0),
            draw.uniform(10.0, 40.0),
            draw.uniform(300.0, 600.0),
        )
        self._rises = [_rise(draw, draw.uniform(0.3, 0.8) * mean_m, draw.uniform(12.0, 40.0)) for _ in range(SHALLOWS)]
        tall_m = min(1.5, 0.5 * mean_m)
        self._rises += [_rise(draw, draw.uniform(0.3, 1.0) * tall_m, draw.uniform(1.5, 4.0)) for _ in range(BOULDERS)]

    def depth_m(self, north_m: float, east_m: float, time_s: float) -> float:
        """The depth of the water so far from the middle, so long after the simulation began."""
        most_m, to_north, to_east = self._slope
        deep_m = self._table.mean_m + most_m * math.tanh((to_north * north_m + to_east * east_m) / most_m)
        for height_m, north_rad, east_rad, phase_rad in self._hills:
            deep_m -= height_m * math.sin(north_rad * north_m + east_rad * east_m + phase_rad)
        bearing_rad, off_m, deeper_m, half_m, swing_m, length_m = self._channel
        c, s = math.cos(bearing_rad), math.sin(bearing_rad)
        across_m = east_m * c - north_m * s - off_m - swing_m * math.sin(math.tau * (north_m * c + east_m * s) / length_m)
        deep_m += deeper_m / (1.0 + (across_m / half_m) ** 4)
        for middle_north_m, middle_east_m, height_m, radius_m in self._rises:
            north, east = (north_m - middle_north_m) / radius_m, (east_m - middle_east_m) / radius_m
            if (far2 := north * north + east * east) < 1.0:
                deep_m -= height_m * (1.0 - far2) ** 2
        return max(deep_m + self.tide_m(time_s), LEAST_M)

    def depth_at(self, latitude_rad: float, longitude_rad: float, time_s: float) -> float:
        """The same of a position."""
        return self.depth_m(*to_plane(self.middle, latitude_rad, longitude_rad), time_s)

    def tide_m(self, time_s: float) -> float:
        """The level of the water above its mean, where it was when the simulation began, rising."""
        return self._table.tide_m * math.sin(math.tau * time_s / self._table.tide_s)


def _hill(draw: Random, height_m: float, long_m: float) -> Hill:
    to_rad, per_m = draw.uniform(0.0, math.tau), math.tau / long_m
    return Hill(height_m, per_m * math.cos(to_rad), per_m * math.sin(to_rad), draw.uniform(0.0, math.tau))


def _rise(draw: Random, height_m: float, radius_m: float) -> Rise:
    return Rise(draw.uniform(-SCATTERED_M, SCATTERED_M), draw.uniform(-SCATTERED_M, SCATTERED_M), height_m, radius_m)


def bed_of(here: Simulation) -> SeaBed | None:
    """The bed that a vehicle's file describes; None: the bottom is flat."""
    table = here.sea_bed
    if not table.mean_m:
        return None
    latitude_deg = here.latitude_deg if table.latitude_deg is None else table.latitude_deg
    longitude_deg = here.longitude_deg if table.longitude_deg is None else table.longitude_deg
    return SeaBed(table, origin(math.radians(latitude_deg), math.radians(longitude_deg)))


class Echoes:
    """What a sounder takes for the bottom: now and then something in the water above it, or the echo that came twice."""

    def __init__(self, here: Simulation, seed: int, name: str) -> None:
        self._bad = here.sea_bed.bad_echoes if here.noise else 0.0
        self._random = Random(f"echoes {name} {seed}")

    def heard(self, depth_m: float) -> float:
        """The depth that is told."""
        if not self._bad or self._random.random() >= self._bad:
            return depth_m
        return depth_m * (2.0 if self._random.random() < 0.3 else self._random.uniform(0.1, 0.8))
