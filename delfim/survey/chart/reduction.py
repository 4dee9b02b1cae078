"""Soundings reduced: put where their echo came from, in the plane of UTM, as depths below the datum; and which are believed.

The echo comes from what is nearest within the beam. So a tilt within half of the beam changes nothing, and only what goes
beyond it is corrected.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from delfim.base.projection import plane, utm_of
from delfim.config import SounderTable
from delfim.survey.chart.soundings import Array, BoatTrack, Soundings, read_all
from delfim.survey.chart.tide import Tide

APART_S: Final = 2.0  # between positions further apart nobody knows where a sounding was taken
LEAST_M, MOST_M = 0.05, 12_000.0  # of a range
LYING_RAD: Final = 1.2  # a boat that leans more has capsized, or its sensor has
CONFIDENCE: Final = 0.5
PINGS: Final = 25  # whose median a sounding is compared with ...
FAR_M: Final = 20.0  # ... as far as they lie together
OFF_M: Final = 0.35  # from the median, or ...
OFF: Final = 0.06  # ... this part of it, is a bad echo
BENDS: Final = 4.0  # times as far off is no bad echo, where the bed bends
CHUNK: Final = 1 << 15  # soundings whose neighbours are in memory together
REASONS: Final = ("", "no place", "no echo", "bad echo")  # why a sounding is not believed, by its number


class SoundingCorrections(NamedTuple):
    """What is known of sounder, water and tide. Zeros and None correct nothing."""

    ahead_m: float = 0.0  # of the transducer, from the place that navigation tells
    starboard_m: float = 0.0
    draught_m: float = 0.0  # of it; 0: what the sounder tells
    latency_s: float = 0.0  # a depth comes so much later than the position of its place
    sound: float = 1.0  # speed of sound: that of the water by that which the sounder takes
    beam_deg: float = 0.0
    tide: Tide | None = None
    confidence: float = CONFIDENCE  # of a ping; one of less is no depth


class Reduced(NamedTuple):
    """Soundings as a chart has them, each of the shape (n,)."""

    at_s: Array
    east_m: Array  # UTM; NaN: nobody knows where
    north_m: Array
    depth_m: Array  # below the datum
    tide_m: Array  # that was taken off
    why: NDArray[np.int8]  # index in REASONS; 0: believed
    epsg: int

    @property
    def good(self) -> NDArray[np.bool_]:
        return np.equal(self.why, 0)

    def degrees(self) -> tuple[Array, Array]:
        """Latitude and longitude."""
        longitude_deg, latitude_deg = plane(self.epsg, np)[1](self.east_m, self.north_m)
        return latitude_deg, longitude_deg


class PlacedTrack(NamedTuple):
    """A track in the plane of UTM, in which north is turned from true north."""

    track: BoatTrack
    epsg: int
    east_m: Array
    north_m: Array
    grid_rad: Array  # heading in the plane

    def at(self, at_s: Array) -> tuple[Array, Array, Array]:
        """East, north and heading at these times; NaN between fixes that lie too far apart."""
        times = self.track.at_s
        after = np.clip(np.searchsorted(times, at_s), 1, len(times) - 1)
        is_far = (times[after] - times[after - 1] > APART_S) | (at_s < times[0]) | (at_s > times[-1])
        east, north, heading = (np.interp(at_s, times, each) for each in (self.east_m, self.north_m, self.grid_rad))
        east[is_far] = np.nan
        return east, north, heading

    def tilt(self, at_s: Array) -> tuple[Array, Array]:
        """Roll and pitch at these times; 0 where nobody tells them."""
        its = (np.interp(at_s, self.track.at_s, each) for each in (self.track.roll_rad, self.track.pitch_rad))
        roll, pitch = (np.where(np.abs(each) < LYING_RAD, each, 0.0) for each in its)
        return roll, pitch


def joined(parts: Sequence[Reduced]) -> Reduced:
    """The soundings of several boats or days one after the other; all are in one plane."""
    at_s, east, north, depth, tide, why = (np.concatenate(each) for each in zip(*(part[:-1] for part in parts), strict=True))
    return Reduced(at_s, east, north, depth, tide, why, parts[0].epsg)


def placed(track: BoatTrack, epsg: int = 0) -> PlacedTrack:
    """Lay a track into a zone of UTM, 0: that its middle lies in. A track of less than two fixes has no place."""
    if len(track.at_s) < 2:
        nothing = np.full(2, np.nan)
        track = BoatTrack(np.array([-1.0, 0.0]), *(nothing for _ in track._fields[1:]))
        return PlacedTrack(track, epsg or 32631, nothing, nothing, nothing)
    middle = float(np.median(track.latitude_deg)), math.remainder(float(np.median(track.longitude_deg)), 360.0)
    epsg = epsg or utm_of(*middle)
    forward, _ = plane(epsg, np)
    longitude_deg = track.longitude_deg + middle[1] - float(np.median(track.longitude_deg))
    east, north = forward(longitude_deg, track.latitude_deg)
    off_deg = longitude_deg - ((epsg % 100) * 6.0 - 183.0)
    turned = np.arctan(np.tan(np.radians(off_deg)) * np.sin(np.radians(track.latitude_deg)))  # of grid north, clockwise
    return PlacedTrack(track, epsg, east, north, np.unwrap(_filled(track.heading_rad)) - turned)


def _filled(angles: Array) -> Array:
    """Angles with what is not known as the one before; 0 where none is known."""
    known = np.isfinite(angles)
    if not known.any():
        return np.zeros(len(angles))
    last = np.maximum.accumulate(np.where(known, np.arange(len(angles)), 0))
    return np.nan_to_num(angles[last], nan=float(angles[known][0]))


def good_places(path: str | Path) -> list[tuple[float, float]]:
    """Where a log has good soundings, latitude and longitude; where the boat was, if it has no sounder. The last one is where
    the log ends. Raises DelfimError, OSError."""
    found = read_all(path)
    track = found.track
    places = list(zip(track.latitude_deg.tolist(), track.longitude_deg.tolist(), strict=True))
    if not len(found.at_s):
        return places
    by = found.sounder or SounderTable()
    its = reduced(
        found, placed(track), SoundingCorrections(by.ahead_m, by.starboard_m, latency_s=by.latency_s, beam_deg=by.beam_deg)
    )
    latitude, longitude = its.degrees()
    return [*zip(latitude[its.good].tolist(), longitude[its.good].tolist(), strict=True), *places[-1:]]


def reduced(soundings: Soundings, track: PlacedTrack, by: SoundingCorrections) -> Reduced:
    """Soundings with all corrections, and the look for bad echoes. Raises DelfimError where the tide's table does not reach."""
    at_s = soundings.at_s - by.latency_s
    east, north, heading = track.at(at_s)
    roll, pitch = track.tilt(at_s)
    slant = soundings.range_m * by.sound
    tilt = np.arccos(np.clip(np.cos(roll) * np.cos(pitch), -1.0, 1.0))
    over = np.maximum(tilt - math.radians(by.beam_deg) / 2.0, 0.0)
    aside, along = -np.tan(roll), np.tan(pitch)
    out = slant * np.sin(over) / np.maximum(np.hypot(aside, along), 1e-9)
    ahead, right = by.ahead_m + out * along, by.starboard_m + out * aside
    east, north = (
        east + ahead * np.sin(heading) + right * np.cos(heading),
        north + ahead * np.cos(heading) - right * np.sin(heading),
    )
    deeper = by.starboard_m * np.sin(roll) - by.ahead_m * np.sin(pitch)  # of a transducer that the boat's tilt moves
    draught = by.draught_m if by.draught_m else np.nan_to_num(np.maximum(soundings.offset_m, 0.0), nan=0.0)
    is_placed = np.isfinite(east + north)
    tide = np.zeros(len(at_s))
    if by.tide is not None:
        tide[is_placed] = by.tide.level(at_s[is_placed])
    depth = slant * np.cos(over) + draught + deeper - tide
    why = np.zeros(len(at_s), np.int8)
    is_echo = (soundings.range_m > LEAST_M) & (soundings.range_m < MOST_M) & ~(soundings.confidence < by.confidence)
    why[~is_echo] = REASONS.index("no echo")
    why[~is_placed] = REASONS.index("no place")
    left = np.flatnonzero(why == 0)
    why[left[~believed(east[left], north[left], depth[left], tide[left])]] = REASONS.index("bad echo")
    return Reduced(soundings.at_s, east, north, depth, tide, why, track.epsg)


def believed(east_m: Array, north_m: Array, depth_m: Array, tide_m: Array) -> NDArray[np.bool_]:
    """Whether each sounding is near the median of its neighbours, of which there are PINGS, or as many as lie within FAR_M. On
    a slope that bends it need only be near the line between the three before it and the three after it. All of the shape (n,),
    in the order of time."""
    count, half = len(depth_m), PINGS // 2
    found = np.ones(count, bool)
    way = np.cumsum(np.hypot(np.diff(east_m, prepend=east_m[:1]), np.diff(north_m, prepend=north_m[:1])))
    padded = np.pad(depth_m, half, mode="reflect" if count > half else "edge") if count else depth_m
    ways = np.pad(way, half, constant_values=np.inf)
    ways[:half] = -np.inf
    for begin in range(0, count, CHUNK):
        here = slice(begin, min(begin + CHUNK, count))
        wide = slice(here.start, here.stop + 2 * half)
        every = np.lib.stride_tricks.sliding_window_view(padded[wide], PINGS)
        far = np.abs(np.lib.stride_tricks.sliding_window_view(ways[wide], PINGS) - way[here, None]) > FAR_M / 2.0
        far[(~far).sum(1) < 5, half - 2 : half + 3] = False  # of a boat that is fast for its sounder
        median = np.nanmedian(np.where(far, np.nan, every), axis=1)
        line = (np.median(every[:, half - 3 : half], axis=1) + np.median(every[:, half + 1 : half + 4], axis=1)) / 2.0
        may_m = np.maximum(OFF_M, OFF * np.abs(median + tide_m[here]))
        off_m = np.abs(depth_m[here] - median)
        found[here] = (off_m < may_m) | ((np.abs(depth_m[here] - line) < may_m) & (off_m < BENDS * may_m))
    return found
