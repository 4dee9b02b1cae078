"""The level of the water above the chart's datum: from a table of heights, or from the height of an antenna with RTK."""

import re
from array import array
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from delfim.base.errors import DelfimError, FormatError
from delfim.base.input.untrusted import read_file
from delfim.survey.chart.soundings import Array, BoatTrack, seconds

BYTES: Final = 1 << 23
APART_S: Final = 3600.0  # heights further apart say nothing of what is between: high and low waters alone are no table
MOST_M: Final = 50.0
SMOOTHED_S: Final = 60.0  # of an antenna's height: waves and errors go, the tide stays
RTK: Final = 5
ROW: Final = re.compile(r"(.+?)(?:[,;\t]|\s)\s*([+-]?\d+(?:\.\d*)?)\s*")


class Tide(NamedTuple):
    """Levels above the datum: both have the shape (n,)."""

    at_s: Array  # since 1970, rising
    level_m: Array
    source: str  # in words

    def level(self, at_s: Array) -> Array:
        """The level at each of these times, on straight lines between. Raises DelfimError where the table does not say."""
        if not len(at_s):
            return at_s
        after = np.clip(np.searchsorted(self.at_s, at_s), 1, len(self.at_s) - 1)
        apart_s = self.at_s[after] - self.at_s[after - 1]
        if at_s.min() < self.at_s[0] or at_s.max() > self.at_s[-1] or apart_s.max() > APART_S:
            raise DelfimError(
                f"{self.source}: no heights of the tide at each hour from {_utc(at_s.min())} to {_utc(at_s.max())},"
                " when the soundings were taken"
            )
        return np.asarray(np.interp(at_s, self.at_s, self.level_m))


def _utc(at_s: float) -> str:
    return str(np.datetime64(int(at_s), "s"))


def read_tide(path: str | Path) -> Tide:
    """A table: on each line a time (ISO 8601, UTC; or seconds since 1970), a comma, a semicolon or blanks, and metres above the
    datum. A head, empty lines and lines with # are passed over. Raises OSError, FormatError."""
    try:
        lines = read_file(path, BYTES).decode().splitlines()
    except UnicodeDecodeError as error:
        raise FormatError(f"{path}: not UTF-8: {error.reason} at byte {error.start}") from None
    stamps, levels, is_head = array("d"), array("d"), True
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            match = ROW.fullmatch(line[:200])
            if match is None or abs(level_m := float(match[2])) > MOST_M:
                raise ValueError
            at_s = seconds(match[1])
        except (ValueError, OverflowError):
            if is_head:
                is_head = False
                continue
            raise FormatError(f"{path}: line {number} is no time with metres, as 2010-01-01T09:30,1.24") from None
        is_head = False
        if stamps and at_s <= stamps[-1]:
            raise FormatError(f"{path}: line {number} is not later than the line before")
        stamps.append(at_s)
        levels.append(level_m)
    if len(stamps) < 2:
        raise FormatError(f"{path}: no table of the tide: it needs two lines, each a time and metres")
    return Tide(np.array(stamps), np.array(levels), str(path))


def by_rtk(track: BoatTrack, antenna_m: float, datum_m: float) -> Tide:
    """The level by the antenna's height while the fix is RTK: `antenna_m` is above the water line, `datum_m` the height of the
    chart's datum above the ellipsoid. Raises DelfimError."""
    known = (track.fix == RTK) & np.isfinite(track.height_m)
    if not known.any():
        raise DelfimError("the log has no heights with RTK: take the tide from a table, --tide FILE")
    at_s, level_m = track.at_s[known], track.height_m[known] - antenna_m - datum_m
    of = np.floor((at_s - at_s[0]) / SMOOTHED_S).astype(int)
    firsts = np.flatnonzero(np.diff(of, prepend=-1))
    medians = np.array([np.median(part) for part in np.split(level_m, firsts[1:])])
    middles = np.array([part.mean() for part in np.split(at_s, firsts[1:])])
    middles, medians = np.append(middles, at_s[-1] + 1e-3), np.append(medians, medians[-1])
    return Tide(np.insert(middles, 0, at_s[0] - 1e-3), np.insert(medians, 0, medians[0]), "height of the antenna by RTK")
