"""The record of a boat: what its thrusters were told, and how it moved then, each with its own stamps.

A trial fills one with the raw values of the sensors. `read_log` makes one of the state log of ordinary sailing, whose motion is
that of the navigation: an estimator has smoothed it, and what comes late comes later still.
"""

from collections.abc import Iterable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from delfim.base.errors import DelfimError
from delfim.logging.ashore.table import Columns, table
from delfim.logging.ashore.tree import ALWAYS, LogFile, Span
from delfim.logging.reading import raw

Array = NDArray[np.floating[Any]]

TRIAL: Final = "trial"  # the source of its record
DRIFT, DRIFT_LEAST = "drift", 20  # a manoeuvre with the motors off, and its least positions
APART_S: Final = 60.0  # between two starts of a boat's program, whose clocks have nothing in common


class Series(NamedTuple):
    """Values of one kind: `at_s` has the shape (n,), seconds of the record's clock, rising; `values` (n, columns)."""

    at_s: Array
    values: Array

    @classmethod
    def of(cls, rows: Sequence[Sequence[float]], columns: int) -> "Series":
        """Make one of rows that begin with their time. What is not finite was not measured, and is left out."""
        every = np.asarray(rows, float).reshape(-1, 1 + columns)
        known = every[np.isfinite(every).all(1)]
        return cls(known[:, 0], known[:, 1:])


NOTHING: Final = Series.of((), 1)


class Manoeuvre(NamedTuple):
    """A piece of a trial, by its name in words."""

    name: str
    from_s: float
    to_s: float


class BoatRecord(NamedTuple):
    """What a boat was told and what it did. SI units; times are seconds of one clock that never steps."""

    thrusters: tuple[str, ...]  # the names of the file's rows, in its order
    told: (
        Series  # a column for each row: the part, -1..1 of full command, from then on; 0 without current; then the angles, rad
    )
    position: Series  # north and east of any fixed point, m
    velocity: Series  # over ground, to north and to east, m/s
    heading: Series  # rad; as the compass says it
    turn: Series  # rate of turn, rad/s, positive to starboard
    wind: Series = NOTHING  # speed, m/s, and where the apparent wind comes from, rad clockwise from the bow
    revolutions: Series = NOTHING  # a column for each row, 1/min, as reported; NaN where a row reports none
    is_raw: bool = True  # the sensors' own values; False: as an estimator has smoothed them
    manoeuvres: tuple[Manoeuvre, ...] = ()
    source: str = ""  # in words: which log or trial
    digest: str = ""  # of the files that it was made of

    @property
    def seconds(self) -> float:
        """The time from the first command to the last."""
        return float(self.told.at_s[-1] - self.told.at_s[0]) if len(self.told.at_s) else 0.0


def read_log(files: Iterable[LogFile], span: Span = ALWAYS) -> BoatRecord:
    """The record of state logs in this time. Raises DelfimError where they hold no command or no motion."""
    chosen = [file for file in files if file.suffix.startswith(".state")]
    columns, schema = table(chosen, span)
    at_s = one_clock(np.asarray(columns["monotonic_s"], float))
    rows = tuple(name.removesuffix("_command") for name in columns if name.endswith("_command"))
    if not rows:
        raise DelfimError("these state logs have no commands of thrusters")
    running = np.asarray(columns["run"], float) > 0.5
    parts = np.stack([_known(columns, f"{name}_command") for name in rows], 1)
    parts[~running | ~np.isfinite(parts).all(1)] = 0.0
    angles = [np.nan_to_num(_known(columns, f"{name}_angle"))[:, None] for name in rows if f"{name}_angle" in columns]
    turned = np.stack([_known(columns, f"{name}_rpm_measured") for name in rows], 1)
    wind = _of(columns, at_s, "wind_apparent_mps", "wind_apparent_rad")
    record = BoatRecord(
        thrusters=rows,
        told=Series(at_s, np.hstack([parts, *angles])),
        position=_of(columns, at_s, "north", "east"),
        velocity=_of(columns, at_s, "north_speed", "east_speed"),
        heading=_of(columns, at_s, "heading"),
        turn=_of(columns, at_s, "yaw_rate"),
        wind=wind,
        revolutions=Series(at_s, turned) if np.isfinite(turned).any() else NOTHING,
        is_raw=False,
        source=f"state log of {schema.boat}, {len(chosen)} files",
        digest=digest_of(chosen),
    )
    if not len(record.velocity.at_s) or not len(record.heading.at_s):
        raise DelfimError("these state logs have no velocity or no heading: nothing can be learned of the hull")
    return record


def scatter_m(record: BoatRecord) -> float:
    """The deviation of the receiver's position, per axis, m: about a straight line while she drifts. Where no manoeuvre is a
    drift nobody knows: 0."""
    found = list[float]()
    for each in record.manoeuvres:
        inside = (record.position.at_s >= each.from_s) & (record.position.at_s <= each.to_s)
        if each.name.startswith(DRIFT) and int(inside.sum()) >= DRIFT_LEAST:
            at_s, places = record.position.at_s[inside], record.position.values[inside]
            line = np.polynomial.polynomial.polyfit(at_s - at_s[0], places, 1)
            off = places - np.polynomial.polynomial.polyval(at_s - at_s[0], line).T
            found.append(float(np.sqrt(np.mean(off**2))))
    return max(found, default=0.0)


def one_clock(at_s: Array) -> Array:
    """The times of several starts, each of which may begin anew, as those of one clock, with a gap between two."""
    back = np.flatnonzero(np.diff(at_s) < 0.0)
    late = np.zeros(len(at_s))
    for index in back:
        late[index + 1 :] += at_s[index] - at_s[index + 1] + APART_S
    return at_s + late


def digest_of(files: Iterable[LogFile]) -> str:
    """The SHA-256 of the files' bytes, in their order, 64 hexadecimal digits. Raises OSError for one too large to be a log."""
    import hashlib

    total = hashlib.sha256()
    for file in files:
        total.update(raw(file.path))
    return total.hexdigest()


def _known(columns: Columns, name: str) -> Array:
    """A column, or NaN where no file has it."""
    if name not in columns:
        return np.full(len(columns["monotonic_s"]), np.nan)
    return np.asarray(columns[name], float).copy()


def _of(columns: Columns, at_s: Array, *names: str) -> Series:
    stacked: Any = np.stack([at_s, *(_known(columns, name) for name in names)], 1)
    return Series.of(stacked, len(names))
