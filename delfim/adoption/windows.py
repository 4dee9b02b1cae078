"""The pieces of a record that a fit looks at: windows of an even grid in which the motors ran, and why there are too few."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from delfim.adoption.model import Array, MotorPush, SteeringGear, Windows
from delfim.adoption.record import BoatRecord, Series
from delfim.base.errors import DelfimError

STEP_S: Final = 0.1  # a longer one shifts delays by as much as they are
WINDOW_S: Final = 12.0
BACK_S: Final = 1.5  # of commands before a window, for delay and lag
NEAR_S: Final = 2.0  # after the motors ran, and before: she coasts
RUNNING: Final = 0.01  # of full command
ACTIVE: Final = 0.4  # of a window, at least, is near to where the motors ran
HELD_S: Final = 1.5  # a command that is not repeated for this long is not known: the log has a gap
SEEN: Final = 0.2  # of the steps of a window, at least, have a velocity, and a heading, where they come once a second or faster
MOST: Final = 60  # windows: 12 minutes; more of ordinary sailing tells the same again
LEAST: Final = 5
LONGEST_S: Final = 7.0 * 86_400.0  # of a record, from its first command to its last
DIFFERENCE: Final = 0.03  # of full command, between the sides, or rad: else nothing is learned of her turning


def windows_of(
    record: BoatRecord,
    columns: Sequence[tuple[int, float]],
    gear: SteeringGear | None = None,
    motors: tuple[MotorPush, ...] = (),
) -> Windows:
    """The windows of a record, for two motors, starboard and port: the place of each row, and the sign with which its part
    pushes ahead; with a gear for one motor and its angle; with three or four motors for each of them. Raises DelfimError, in
    words, where the record cannot tell what is asked."""
    if len(record.told.at_s) < 2:
        raise DelfimError("the record has no commands")
    rows, signs = [row for row, _ in columns], np.array([sign for _, sign in columns])
    zero_s, end_s = float(record.told.at_s[0]), float(record.told.at_s[-1])
    if not end_s - zero_s <= LONGEST_S:
        raise DelfimError(f"the record is {(end_s - zero_s) / 86_400.0:.3g} days long: fit a day of it")
    zero_s += _phase(record.heading.at_s - zero_s)
    steps, back = round(WINDOW_S / STEP_S), round(BACK_S / STEP_S)
    edges = zero_s + STEP_S * np.arange(-back, int((end_s - zero_s) / STEP_S) + 1)
    commands = _held(record.told, edges)[:, rows] * signs
    measured = np.concatenate([_gridded(each, edges[:-1]) for each in (record.velocity, record.heading, record.turn)], 1)
    known = np.diff(np.interp(edges, record.told.at_s, _gaps(record.told.at_s))) < 0.5 * STEP_S
    first = _chosen(commands if gear is None else commands[:, :1], measured, known, back, steps)
    if len(first) < LEAST:
        raise DelfimError(_too_few(len(first), record))
    turns = np.diff(commands, axis=1) if gear is None else commands[:, 1:]
    if motors:
        turns = commands @ np.array([each.arm * each.shares[0] for each in motors])
    if max(float(np.std(turns[at : at + steps])) for at in first) < DIFFERENCE:
        alike = "both motors always ran alike" if gear is None else "her motor always pointed one way"
        raise DelfimError(f"{alike}: nothing can be learned of her turning; sail some turns")
    take = first[:, None] + np.arange(steps)
    before = first[:, None] + np.arange(-back, steps)
    return Windows(STEP_S, commands[before], measured[take].transpose(1, 0, 2), edges[first], back, gear, motors)


def _phase(since_s: Array) -> float:
    """The time after the steps of a grid at which most values came: the mean of a circle."""
    if not len(since_s):
        return 0.0
    turns = 2.0 * np.pi * since_s / STEP_S
    return float(np.arctan2(np.sin(turns).mean(), np.cos(turns).mean()) / (2.0 * np.pi) * STEP_S)


def _held(told: Series, edges: Array) -> Array:
    """The mean of each command over each step: it holds from its time until the next."""
    lasted = np.diff(told.at_s)[:, None]
    total = np.concatenate([np.zeros((1, told.values.shape[1])), np.cumsum(told.values[:-1] * lasted, 0)])
    at_edges = np.stack([np.interp(edges, told.at_s, column) for column in total.T], 1)
    return np.asarray(np.diff(at_edges, axis=0) / STEP_S)


def _gaps(at_s: Array) -> Array:
    """The time, at each command, that had no known command until then."""
    lasted = np.diff(at_s)
    return np.concatenate([[0.0], np.cumsum(np.where(lasted > HELD_S, lasted, 0.0))])


def _gridded(series: Series, grid: Array) -> Array:
    """The values at the steps of the grid that are nearest to their times; NaN elsewhere. Of several the last one counts."""
    out = np.full((len(grid), series.values.shape[1]), np.nan)
    at = np.rint((series.at_s - grid[0]) / STEP_S).astype(int)
    inside = (at >= 0) & (at < len(grid))
    out[at[inside]] = series.values[inside]
    return out


def _chosen(commands: Array, measured: Array, known: Array, back: int, steps: int) -> NDArray[np.intp]:
    """The first steps of the windows to look at, in their order."""
    active = np.abs(commands).max(1) > RUNNING
    near = np.convolve(active, np.ones(2 * round(NEAR_S / STEP_S) + 1), "same") > 0
    found, at = list[int](), back
    while at + steps <= len(commands):
        here = slice(at, at + steps)
        seen = np.isfinite(measured[here][:, [0, 2]]).mean(0)
        sees = float(seen[0]) >= SEEN * min(1.0, 5.0 * STEP_S) and float(seen[1]) >= SEEN
        if near[here].mean() >= ACTIVE and known[at - back : at + steps].all() and sees:
            found.append(at)
            at += steps
        else:
            at += steps // 4
    first: NDArray[np.intp] = np.array(found, dtype=np.intp)
    if len(first) <= MOST:
        return first
    moved = [float(commands[at : at + steps].std(0).sum()) for at in first]
    lively = np.argsort(moved, kind="stable")[-MOST // 2 :]
    rest = np.setdiff1d(np.arange(len(first)), lively)
    even = rest[np.linspace(0, len(rest) - 1, MOST - len(lively)).astype(int)]
    chosen = np.sort(np.concatenate([lively, even]))
    return np.asarray(first[chosen])


def _too_few(count: int, record: BoatRecord) -> str:
    had = "has no window" if not count else f"has only {count} windows"
    words = (
        f"the record {had} of {WINDOW_S:.0f} s in which the motors ran and velocity and heading were known; {LEAST} are needed"
    )
    if not len(record.velocity.at_s):
        return f"{words}: no velocity over ground was measured"
    return f"{words}: no heading was measured" if not len(record.heading.at_s) else words
