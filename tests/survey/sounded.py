"""A survey as a sounder and a receiver would have recorded it over a bed that is known: late, by a wrong speed of sound, beside
the antenna, in waves, on a tide, and with bad echoes. Whoever makes a chart of it can be told how right it is.
"""

import math
from collections.abc import Iterable, Iterator
from itertools import pairwise
from random import Random
from typing import Final, NamedTuple

import numpy as np

from delfim.base.geodesy import Origin, from_plane, origin, to_plane
from delfim.simulator.seabed import SeaBed
from delfim.simulator.tables import SimulatedBed
from delfim.survey.chart.reduction import Reduced, SoundingCorrections
from delfim.survey.chart.soundings import Array, Soundings, track_of
from delfim.survey.chart.tide import Tide

PLACE: Final = origin(math.radians(38.6907), math.radians(-9.2153))
BEGAN_S: Final = 1_790_000_000.0
SPEED_MPS: Final = 1.5
AHEAD_M, STARBOARD_M, DRAUGHT_M, LATE_S = 0.8, 0.25, 0.25, 0.15
TAKEN_MPS, TRUE_MPS = 1500.0, 1508.0
RECEIVER_M: Final = 0.3  # an axis
TIDE_M, TIDE_S = 0.9, 44712.0
PERIODS_S: Final = 4.1, 3.2  # of roll and pitch


class Sounded(NamedTuple):
    """The record, and the truth."""

    soundings: Soundings
    bed: SeaBed
    bad: Array  # whether a sounding is of no bottom
    tide: Tide

    def corrections(self, **others: object) -> SoundingCorrections:
        known = SoundingCorrections(AHEAD_M, STARBOARD_M, DRAUGHT_M, LATE_S, TRUE_MPS / TAKEN_MPS, 0.0, self.tide)
        return known._replace(**others)  # type: ignore[arg-type]

    def truth(self, its: Reduced) -> Array:
        """The depth below the datum where each sounding is said to be, which is that of no tide."""
        return true_depths(self.bed, *its.degrees())


def true_depths(bed: SeaBed, latitude_deg: Array, longitude_deg: Array) -> Array:
    """The depth below the datum at places of any one shape; NaN where there is none."""
    shape = np.shape(latitude_deg)
    rows = zip(np.radians(latitude_deg).ravel().tolist(), np.radians(longitude_deg).ravel().tolist(), strict=True)
    return np.array([bed.depth_at(a, b, 0.0) if a == a else math.nan for a, b in rows]).reshape(shape)


def ways(size_m: float, spacing_m: float, cross: bool = True, there_and_back: bool = False) -> list[tuple[float, float]]:
    """Corners of lines to and fro, north and east; three lines across; and the first line once more, back."""
    places = list[tuple[float, float]]()
    for number in range(round(size_m / spacing_m) + 1):
        ends = [(number * spacing_m, -10.0), (number * spacing_m, size_m + 10.0)]
        places += ends if number % 2 == 0 else ends[::-1]
    if there_and_back:
        places += [places[-2], places[-1]]
    for number, part in enumerate((0.85, 0.5, 0.15) if cross else ()):
        ends = [(-10.0, part * size_m), (size_m + 10.0, part * size_m)]
        places += ends if number % 2 else ends[::-1]
    return places


def sounded(
    seed: int,
    places: list[tuple[float, float]],
    rate_hz: float = 5.0,
    bad: float = 0.01,
    mean_m: float = 8.0,
    noise: float = 1.0,
) -> Sounded:
    """Sail along these corners."""
    draw = Random(f"sounded {seed}")
    bed = SeaBed(SimulatedBed(mean_m=mean_m, seed=seed), _middle(places))
    step_m = SPEED_MPS / rate_hz
    rows, wander, at_s = list[tuple[float, ...]](), 0.0, BEGAN_S
    said: list[tuple[float, float, bool]] = []  # time, range, bad
    waves = [draw.uniform(0.0, math.tau) for _ in PERIODS_S]
    for line, ((north, east), (to_north, to_east)) in enumerate(pairwise(places), 1):
        long_m, heading = math.hypot(to_north - north, to_east - east), math.atan2(to_east - east, to_north - north)
        for number in range(int(long_m / step_m)):
            at_s += 1.0 / rate_hz
            wander = 0.995 * wander + draw.gauss(0.0, 0.03)
            along = number * step_m
            n = north + along * math.cos(heading) - wander * math.sin(heading)
            e = east + along * math.sin(heading) + wander * math.cos(heading)
            roll, pitch = (
                math.radians(deg) * math.sin(math.tau * at_s / period_s + phase)
                for deg, period_s, phase in zip((3.0, 1.5), PERIODS_S, waves, strict=True)
            )
            slant, is_wrong = _echo(bed, draw, n, e, heading, roll, pitch, at_s, bad)
            said.append((at_s + LATE_S, slant, is_wrong))
            here = n + noise * draw.gauss(0.0, RECEIVER_M), e + noise * draw.gauss(0.0, RECEIVER_M)
            rows.append((at_s, *here, heading + math.radians(draw.gauss(0.0, 1.0)), roll, pitch, float(line)))
    return _recorded(rows, said, bed)


def _middle(places: list[tuple[float, float]]) -> Origin:
    north, east = (sum(place[k] for place in places) / len(places) for k in (0, 1))
    return origin(*from_plane(PLACE, north, east))


def tide_m(at_s: Array | float) -> Array:
    return np.asarray(1.2 + TIDE_M * np.sin(math.tau * (np.asarray(at_s) - BEGAN_S + 6000.0) / TIDE_S))


def _echo(
    bed: SeaBed,
    draw: Random,
    north: float,
    east: float,
    heading: float,
    roll: float,
    pitch: float,
    at_s: float,
    bad: float,
) -> tuple[float, bool]:
    """What a narrow beam says that leans with the boat."""
    c, s = math.cos(heading), math.sin(heading)
    north, east = north + AHEAD_M * c - STARBOARD_M * s, east + AHEAD_M * s + STARBOARD_M * c
    deep, low = 5.0, DRAUGHT_M + STARBOARD_M * math.sin(roll) - AHEAD_M * math.sin(pitch)
    level = float(tide_m(at_s))
    shift = to_plane(bed.middle, *from_plane(PLACE, 0.0, 0.0))
    for _ in range(4):
        ahead, aside = deep * math.tan(pitch), -deep * math.tan(roll)
        there = shift[0] + north + ahead * c - aside * s, shift[1] + east + ahead * s + aside * c
        deep = bed.depth_m(*there, 0.0) + level - low
    true = deep / math.cos(math.atan(math.hypot(math.tan(roll), math.tan(pitch))))
    slant = true * TAKEN_MPS / TRUE_MPS * (1.0 + draw.gauss(0.0, 0.003)) + draw.gauss(0.0, 0.015)
    is_wrong = draw.random() < bad
    return (draw.choice((0.35, 2.0 * slant, slant * draw.uniform(0.3, 0.8))) if is_wrong else slant), is_wrong


def _recorded(rows: list[tuple[float, ...]], said: list[tuple[float, float, bool]], bed: SeaBed) -> Sounded:
    at_s, north, east, heading, roll, pitch, line = np.array(rows).T
    places = np.degrees([from_plane(PLACE, n, e) for n, e in zip(north, east, strict=True)])
    unknown = np.full(len(at_s), math.nan)
    track = track_of(at_s, places[:, 0], places[:, 1], heading, roll, pitch, unknown, np.full(len(at_s), RECEIVER_M), unknown)
    stamps, ranges, bad = np.array(said).T
    soundings = Soundings(stamps, ranges, np.full(len(stamps), math.nan), np.full(len(stamps), math.nan), line, track, "a test")
    hours = np.arange(BEGAN_S - 600.0, at_s[-1] + 1200.0, 600.0)
    return Sounded(soundings, bed, bad > 0.5, Tide(hours, tide_m(hours), "a test"))


def utc_rows(places: Iterable[tuple[float, float]], depth_m: float = 5.0) -> Iterator[str]:
    """Rows of a CSV of soundings at these places, latitude and longitude, one a second."""
    for number, (latitude_deg, longitude_deg) in enumerate(places):
        yield f"{BEGAN_S + number:.0f},{latitude_deg:.8f},{longitude_deg:.8f},{depth_m}\n"
