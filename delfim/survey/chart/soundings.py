"""Soundings as they were recorded, from a boat's log or from the CSV of `delfim log export soundings`: raw, each with its own
time. What is corrected is corrected later (`reduction`), and never in the record.
"""

import csv
import math
import os
import re
from array import array
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from delfim.base.errors import DelfimError, FormatError
from delfim.config import SounderTable
from delfim.logging.ashore import tree
from delfim.logging.ashore.table import TIME, Columns, table
from delfim.logging.ashore.tree import ALWAYS, LogFile, Span

Array = NDArray[np.floating[Any]]

MOST: Final = 5_000_000  # soundings: two weeks at four a second
BYTES: Final = 1 << 29  # of a CSV
LINE: Final = 2000  # bytes
NO_LINE: Final = 0
LARGEST: Final = 1e10
DEGREE: Final = math.pi / 180.0
HEADS: Final = {  # of the CSV, without units, and what the value is multiplied by
    "latitude": 1.0,
    "longitude": 1.0,
    "depth": 1.0,
    "depth_offset": 1.0,
    "confidence": 1.0,
    "line": 1.0,
    "heading": DEGREE,
    "roll": DEGREE,
    "pitch": DEGREE,
    "height": 1.0,
    "accuracy": 1.0,
    "fix": 1.0,
}
NAMES: Final = {"offset": "depth_offset"}
UNIT: Final = re.compile(r"(_m|_deg)?( \[[^\]]*\])?$")


class BoatTrack(NamedTuple):
    """Where the boat was, as navigation told it. Each has the shape (n,); NaN is unknown. Angles as the state log has them."""

    at_s: Array  # since 1970, rising
    latitude_deg: Array
    longitude_deg: Array  # without a step at the date line
    heading_rad: Array
    roll_rad: Array
    pitch_rad: Array
    height_m: Array  # of the antenna above the ellipsoid
    accuracy_m: Array  # as the receiver states it
    fix: Array  # 5 is RTK


class Soundings(NamedTuple):
    """What a sounder said: each has the shape (n,), in the order of time. NaN: it was not said."""

    at_s: Array  # since 1970, as each came in
    range_m: Array  # from the transducer, by the speed of sound that the sounder takes
    offset_m: Array  # as the device tells it: above 0 up to the water line
    confidence: Array  # 0..1
    line: Array  # of the survey; NO_LINE: none
    track: BoatTrack
    source: str  # in words
    boat: str = "a boat"
    sounder: SounderTable | None = None  # as the vehicle's file had it that day


def read(path: str | Path, span: Span = ALWAYS) -> Soundings:
    """The soundings of a log (tree, day, folder or file), or of a CSV, between two times. Raises DelfimError, OSError."""
    found = read_all(path, span)
    chosen = (found.at_s >= span.from_ns / 1e9) & (found.at_s <= span.to_ns / 1e9)
    found = found._replace(**{name: getattr(found, name)[chosen] for name in found._fields[:5]})
    if not len(found.at_s):
        raise DelfimError(f"{path}: no soundings in it: has the boat a sounder that is read?")
    return found


def joined(parts: Sequence[Soundings]) -> Soundings:
    """The soundings of several boats or days one after the other, with the track of the first."""
    source = "; ".join(part.source for part in parts)
    at_s, *others = (np.concatenate(each) for each in zip(*(part[:5] for part in parts), strict=True))
    range_m, offset_m, confidence, line = others
    return Soundings(at_s, range_m, offset_m, confidence, line, parts[0].track, source, parts[0].boat, parts[0].sounder)


def read_all(path: str | Path, span: Span = ALWAYS) -> Soundings:
    """The same, though there may be none. Raises DelfimError, OSError."""
    if Path(path).suffix.lower() == ".csv":
        return of_csv(path)
    return of_logs([file for file in tree.files([path]) if file.suffix.startswith(".state")], span)


def of_logs(files: Iterable[LogFile], span: Span = ALWAYS) -> Soundings:
    """The soundings in the sidecars of state logs, with the records' track. Raises DelfimError."""
    its = list(files)
    if not its:
        raise DelfimError("no state logs there")
    columns, schema = table(its, span)
    rows = [array("d") for _ in range(4)]
    sounder: SounderTable | None = None
    for told in tree.events(its):
        if told["event"] == "start":
            sounder = _sounder(told.get("settings")) or sounder
        if told["event"] != "sounding" or not span.has(told["t_ns"]):
            continue
        late_s = told["monotonic_s"] - told["measured_s"]
        values = told["t_ns"] / 1e9 - late_s, told["depth_m"], told.get("offset_m"), told.get("confidence")
        for row, number in zip(rows, map(_number, values), strict=True):
            row.append(number)
        if len(rows[0]) > MOST:
            raise DelfimError(f"more than {MOST} soundings: take them in parts, with --from and --to")
    line = columns["line"] if "line" in columns else np.full(len(columns[TIME]), NO_LINE)
    before = np.searchsorted(columns[TIME] / 1e9, np.asarray(rows[0]), "right") - 1
    found = _in_order([*rows, line[np.maximum(before, 0)]], _track(columns), f"{len(its)} files of the log of {schema.boat}")
    return found._replace(boat=schema.boat, sounder=sounder)


def _sounder(settings: object) -> SounderTable | None:
    """The table of a vehicle's file that was logged; None: it has none that is understood."""
    try:
        return msgspec.convert(settings["sounder"], SounderTable)  # type: ignore[index]
    except (KeyError, TypeError, msgspec.ValidationError):
        return None


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan


def _in_order(rows: Sequence[Any], track: BoatTrack, source: str) -> Soundings:
    at_s, range_m, offset_m, confidence, line = (_sane(np.asarray(row, float)) for row in rows)
    order = np.argsort(at_s, kind="stable")
    line = np.where(np.isfinite(line), line, NO_LINE)
    return Soundings(at_s[order], range_m[order], offset_m[order], confidence[order], line[order], track, source)


def _sane(values: Array) -> Array:
    """Values with NaN for what no sensor says. Times since 1970 are the largest."""
    return np.asarray(np.where(np.abs(values) < LARGEST, values, np.nan))


def _track(columns: Columns) -> BoatTrack:
    count = len(columns[TIME])

    def known(name: str, scale: float = 1.0) -> Array:
        return np.asarray(columns[name], float) * scale if name in columns else np.full(count, np.nan)

    degrees = 180.0 / math.pi
    names = ("heading", "roll", "pitch", "height_m", "accuracy", "fix")
    return track_of(known(TIME) / 1e9, known("latitude", degrees), known("longitude", degrees), *map(known, names))


def track_of(at_s: Array, latitude_deg: Array, longitude_deg: Array, *others: Array) -> BoatTrack:
    """The track of fixes in any order, without those that have no place. `others`: heading, roll, pitch, height, accuracy,
    fix."""
    known = np.flatnonzero(np.isfinite(at_s + latitude_deg + longitude_deg))
    known = known[np.argsort(at_s[known], kind="stable")]
    known = known[np.diff(at_s[known], prepend=-np.inf) > 0.0]
    east = np.unwrap(longitude_deg[known], period=360.0)
    return BoatTrack(at_s[known], latitude_deg[known], east, *(_sane(other[known]) for other in others))


def of_csv(path: str | Path) -> Soundings:
    """The soundings of a CSV: heads as in HEADS with `utc`, in any order; other columns are of no matter. Raises OSError,
    FormatError."""
    rows = _rows(path)
    heads = [_plain(name) for name in next(rows, [])]
    if missing := [name for name in ("utc", "latitude", "longitude", "depth") if name not in heads]:
        raise FormatError(f"{path}: no soundings of delfim log export: it has no column {', '.join(missing)}")
    its = {name: array("d") for name in HEADS}
    places = [(its[name], heads.index(name), scale) for name, scale in HEADS.items() if name in heads]
    stamps, utc = array("d"), heads.index("utc")
    for number, row in enumerate(rows, 2):
        try:
            stamps.append(seconds(row[utc]))
            for values, place, scale in places:
                word = row[place]
                values.append(float(word) * scale if word else math.nan)
        except (ValueError, IndexError, OverflowError):
            raise FormatError(f"{path}: line {number} is no sounding") from None
        if len(stamps) > MOST:
            raise FormatError(f"{path}: more than {MOST} soundings: take them in parts")
    return _tabled(stamps, its, str(path))


def _tabled(stamps: Sequence[float], columns: dict[str, Any], path: str) -> Soundings:
    at_s = np.asarray(stamps, float)
    its = {name: np.asarray(row, float) if len(row) else np.full(len(at_s), np.nan) for name, row in columns.items()}
    if np.any(np.abs(its["latitude"]) > 89.0) or np.any(np.abs(its["longitude"]) > 360.0):
        raise FormatError(f"{path}: a place that is not on the Earth, in degrees of WGS 84")
    others = (its[name] for name in ("heading", "roll", "pitch", "height", "accuracy", "fix"))
    track = track_of(at_s, its["latitude"], its["longitude"], *others)
    rows = (its[name] for name in ("depth", "depth_offset", "confidence", "line"))
    return _in_order([at_s, *rows], track, path)


def _plain(head: str) -> str:
    """A head without its unit."""
    name = UNIT.sub("", head)
    return NAMES.get(name, name)


def _rows(path: str | Path) -> Iterator[list[str]]:
    """The rows of a file that is not taken into memory as a whole. Raises OSError, FormatError."""
    if (size := os.stat(path).st_size) > BYTES or not os.path.isfile(path):
        raise FormatError(f"{path}: {size} bytes: files of more than {BYTES} are not read, nor what is no file")
    try:
        with open(path, "rb") as file:
            yield from filter(None, csv.reader(_lines(path, file), strict=True))
    except csv.Error as error:
        raise FormatError(f"{path}: not CSV: {error}") from None


def _lines(path: str | Path, file: BinaryIO) -> Iterator[str]:
    for number, line in enumerate(iter(partial(file.readline, LINE), b""), 1):
        if len(line) == LINE:
            raise FormatError(f"{path}: line {number} is longer than {LINE} bytes: no sounding")
        try:
            yield line.decode("utf-8-sig" if number == 1 else "utf-8")  # spreadsheets may begin one with a mark
        except UnicodeDecodeError as error:
            raise FormatError(f"{path}: line {number} is not UTF-8: {error.reason}") from None


def seconds(text: str) -> float:
    """Seconds since 1970 of a time by ISO 8601, UTC where it names no zone, or as a number of them. Raises ValueError."""
    try:
        when = datetime.fromisoformat(text.strip())
    except ValueError:
        value = float(text)
        if not 0.0 <= value < 1e10:
            raise
        return value
    return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()
