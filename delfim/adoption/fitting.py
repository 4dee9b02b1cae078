"""The fit of the reduced model to a record: output error, with numpy alone. The same record gives the same numbers.

Each window of the record starts at a state of its own, which is an unknown of its own and is eliminated: a gust before a window
does not bend the numbers. Each number has a prior; what the record does not show stays where the prior has it, and says so.
"""

from collections.abc import Iterator
from itertools import product
from typing import Final, NamedTuple

import numpy as np

from delfim.adoption.model import (
    FACTORS,
    HIGHS,
    LOCAL,
    LOWS,
    NAMES,
    OF_THE_DAY,
    PLACE,
    Array,
    Windows,
    observe,
    plain,
    simulate,
    values_of,
)

SIGMAS: Final = 0.06, np.radians(2.2), np.radians(0.5)  # m/s, rad, rad/s: of usual sensors, and of gusts
HUBER: Final = 3.0  # sigmas from which on a residual counts by its size instead of its square
CHI2_MOST: Final = 2.0  # per measurement; beyond, the model is not this boat
AGAIN: Final = 1.8  # begin once more from other numbers: there may be another minimum
UNLIKE: Final = 0.5  # logarithm of the first of two motors over the second, at another beginning
UNLIKE_MOST: Final = 0.8  # of a boat that is believed: beyond, other boats move as well like this one
NUDGES: Final = np.where(FACTORS, 1e-3, 1e-4)  # of each number, for its derivative
STEP_MOST: Final = 0.7  # of a number at a time
UNSEEN: Final = 0.8  # of its prior's spread, or more, is left of the spread of a number that the record does not show
CORRELATED: Final = 60  # steps, over which residuals are looked at for what they have in common
ELSEWHERE: Final = {"ahead": 0.5, "yaw": 0.3, "surge2": 0.5, "lag": 0.6}  # factors, of another beginning


class Prior(NamedTuple):
    """What is known before the record: internal numbers with their standard deviations."""

    centre: Array
    spread: Array
    told: Array  # as the file has it: without what motors have that no file says


class Fit(NamedTuple):
    """What came of it."""

    theta: Array  # (numbers,), internal
    covariance: Array  # (numbers, numbers)
    prior: Prior
    chi2: float  # per measurement
    windows: Windows
    predicted: Array  # (steps, windows, 4), as `Windows.measured`
    first: Array  # the same, as the vehicle's file foretold it
    sigmas: tuple[float, float, float]  # m/s, rad, rad/s, of the residuals

    @property
    def values(self) -> dict[str, float]:
        return plain(self.theta)

    @property
    def spread(self) -> Array:
        """The standard deviation of each internal number: of a factor, of its logarithm."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def relative(self, *names: str) -> float:
        """The standard deviation of the product of these factors, as a part of it; of one other number, its own."""
        at = [PLACE[name] for name in names]
        return float(np.sqrt(max(self.covariance[np.ix_(at, at)].sum(), 0.0)))

    @property
    def unseen(self) -> tuple[str, ...]:
        """The numbers that the record does not show: they are those of the vehicle's file still."""
        still = np.abs(self.theta - self.prior.centre) < self.prior.spread  # one that went to nothing was seen to be nothing
        is_unseen = (self.spread >= UNSEEN * self.prior.spread) & still
        return tuple(name for name, unseen in zip(NAMES, is_unseen, strict=True) if unseen)

    @property
    def refusal(self) -> str:
        """Why this fit is not to be used, in words; empty: it may."""
        if self.chi2 > CHI2_MOST:
            away = ", ".join(self._worst())
            return (
                f"the motion does not follow from the commands: chi2 is {self.chi2:.1f}, {CHI2_MOST:.0f} at most; worst: {away}"
            )
        for side in ("starboard", "port"):
            unlike = abs(self.values[f"within_{side}"])
            if unlike > UNLIKE_MOST:
                than = f"{np.exp(unlike):.1f} times as strong as the other"
                return f"one of the two motors at {side} would be {than}, which no log of a voyage tells surely"
        return ""

    def _worst(self) -> list[str]:
        """The kinds of measurements that are farthest from the model, in words, the worst first."""
        words = "velocity (gusts, waves, a poor receiver)", "heading (a bent compass)", "rate of turn (waves, or a wrong motor)"
        over = [had / usual for had, usual in zip(self.sigmas, SIGMAS, strict=True)]
        return [words[index] for index in np.argsort(over)[::-1] if over[index] > 1.3] or [words[0]]


class Normal(NamedTuple):
    """The normal equations: of the numbers, of each window's start, and of both."""

    numbers: Array  # (free, free)
    slope: Array  # (free,)
    mixed: Array  # (windows, free, LOCAL)
    starts: Array  # (windows, LOCAL, LOCAL)
    start_slopes: Array  # (windows, LOCAL)


def fitted(windows: Windows, prior: Prior) -> Fit:
    """Fit, once more from other numbers where the first fit is poor, and once more with the weights that its own residuals ask
    for: gusts are no noise of a sensor."""
    every = (_descended(windows, prior, begun, SIGMAS, 16, 1e-3) for begun in _beginnings(windows, prior))
    best = min(every, key=lambda each: each[2])
    if best[2] > AGAIN:
        other = prior.centre.copy()
        for name, factor in ELSEWHERE.items():
            other[PLACE[name]] += np.log(factor)
        best = min(best, _descended(windows, prior, other, SIGMAS, 16, 1e-3), key=lambda each: each[2])
    theta, starts, chi2 = best
    sigmas = _sigmas(windows, _predicted(theta, windows, starts))
    theta, starts, _ = _descended(windows, prior, theta, sigmas, 8, 3e-4, starts)
    predicted = _predicted(theta, windows, starts)
    covariance = _covariance(windows, prior, theta, starts, _weighed(windows, predicted, sigmas))
    first = prior.told.copy()
    for name in OF_THE_DAY:
        first[PLACE[name]] = theta[PLACE[name]]  # the same sea and sensors: what is compared is the boat
    return Fit(theta, covariance, prior, chi2, windows, predicted, _predicted(first, windows, starts), sigmas)


def _beginnings(windows: Windows, prior: Prior) -> Iterator[Array]:
    """The numbers to begin from. Where two motors at a side push across, also from the first and from the second being the
    stronger one, at each side: from both being alike the way to the wrong one may be downhill, and ends there."""
    yield prior.centre
    if any(row.within for row in windows.rows):
        for starboard, port in product((-UNLIKE, UNLIKE), repeat=2):
            other = prior.centre.copy()
            other[PLACE["within_starboard"]] += starboard
            other[PLACE["within_port"]] += port
            yield other


def _descended(
    windows: Windows,
    prior: Prior,
    theta: Array,
    sigmas: tuple[float, ...],
    rounds: int,
    enough: float,
    starts: Array | None = None,
) -> tuple[Array, Array, float]:
    """Levenberg-Marquardt. Returns numbers, starts of the windows, and chi2 per measurement."""
    starts = _starts(windows, theta) if starts is None else starts
    cost, damping = _cost(windows, prior, theta, starts, sigmas), 1e-2
    for _ in range(rounds):
        normal, before = _normal(windows, prior, theta, starts, sigmas), cost
        for _ in range(10):
            step, start_steps = _step(normal, damping)
            near = np.clip(theta + np.clip(step, -STEP_MOST, STEP_MOST), LOWS, HIGHS)
            its = starts + start_steps(near - theta)
            now = _cost(windows, prior, near, its, sigmas)
            if now < cost:
                theta, starts, cost, damping = near, its, now, max(damping / 5.0, 1e-7)
                break
            damping *= 5.0
        if before - cost < enough * before:
            break
    count = int(np.isfinite(windows.measured).sum())
    return theta, starts, cost / max(count, 1)


def _step(normal: Normal, damping: float) -> "tuple[Array, _StartSteps]":
    """The step of the numbers, and what gives those of the starts for it. The equations have the shape of an arrow."""
    numbers = normal.numbers + damping * np.diag(np.diag(normal.numbers))
    inverse = np.linalg.inv(normal.starts * (1.0 + damping * np.eye(LOCAL)))
    through = normal.mixed @ inverse  # (windows, free, LOCAL)
    left = numbers - np.einsum("sij,skj->ik", through, normal.mixed)
    right = normal.slope - np.einsum("sij,sj->i", through, normal.start_slopes)
    return -np.linalg.solve(left, right), _StartSteps(normal, inverse)


class _StartSteps(NamedTuple):
    normal: Normal
    inverse: Array

    def __call__(self, step: Array) -> Array:
        moved = self.normal.start_slopes + np.einsum("sij,i->sj", self.normal.mixed, step)
        return np.asarray(-np.einsum("sij,sj->si", self.inverse, moved))


def _normal(windows: Windows, prior: Prior, theta: Array, starts: Array, sigmas: tuple[float, ...]) -> Normal:
    """The normal equations at these numbers, by differences: a lane for each number and for each unknown of a start."""
    count = len(theta)
    lanes = np.repeat(theta[None], 1 + count + LOCAL, 0)
    lanes[1 + np.arange(count), np.arange(count)] += NUDGES
    its = np.repeat(starts[None], len(lanes), 0)
    for index in range(LOCAL):
        its[1 + count + index, :, index] += 1e-4
    off = _residuals(lanes, windows, its, sigmas)
    slopes = (off[1 : 1 + count] - off[0]) / NUDGES[:, None, None]
    of_starts = (off[1 + count :] - off[0]) / 1e-4
    flat = slopes.reshape(count, -1)
    away = (theta - prior.centre) / prior.spread**2
    by_window, starts_by_window = slopes.transpose(1, 0, 2), of_starts.transpose(1, 0, 2)
    return Normal(
        flat @ flat.T + np.diag(prior.spread**-2.0),
        flat @ off[0].reshape(-1) + away,
        by_window @ starts_by_window.transpose(0, 2, 1),
        starts_by_window @ starts_by_window.transpose(0, 2, 1) + 1e-6 * np.eye(LOCAL),
        np.einsum("sij,sj->si", starts_by_window, off[0]),
    )


def _cost(windows: Windows, prior: Prior, theta: Array, starts: Array, sigmas: tuple[float, ...]) -> float:
    off = _residuals(theta[None], windows, starts[None], sigmas)
    return float((off**2).sum() + (((theta - prior.centre) / prior.spread) ** 2).sum())


def _residuals(lanes: Array, windows: Windows, starts: Array, sigmas: tuple[float, ...]) -> Array:
    """(lanes, windows, 4 steps): in sigmas, 0 where nothing was measured, less where they are far. The first lane's weights
    hold for all, so that differences between lanes are slopes."""
    p = values_of(lanes)
    seen = observe(p, simulate(p, windows, starts), windows.step_s)
    out = list[Array]()
    for index, each in enumerate(seen):
        off = each - windows.measured[:, None, :, index]
        if index == 2:
            off = np.remainder(off + np.pi, 2.0 * np.pi) - np.pi
        sigma = sigmas[max(index - 1, 0)]
        out.append((np.where(np.isfinite(off), off, 0.0) / sigma).transpose(1, 2, 0))
    every = np.concatenate(out, 2)
    far = np.maximum(np.abs(every[:1]), HUBER)
    return np.asarray(every * np.sqrt(HUBER / far))


def _predicted(theta: Array, windows: Windows, starts: Array) -> Array:
    p = values_of(theta[None])
    return np.stack([each[:, 0] for each in observe(p, simulate(p, windows, starts[None]), windows.step_s)], -1)


def _off(windows: Windows, predicted: Array) -> Array:
    """Measured less predicted, (steps, windows, 4)."""
    off = windows.measured - predicted
    off[..., 2] = np.remainder(off[..., 2] + np.pi, 2.0 * np.pi) - np.pi
    return off


def _sigmas(windows: Windows, predicted: Array) -> tuple[float, float, float]:
    """The deviation of the residuals, as the middle half of them has it, and no less than a usual sensor's."""
    off = _off(windows, predicted)
    kinds = off[..., :2], off[..., 2], off[..., 3]
    found = [1.4826 * float(np.nanmedian(np.abs(each))) if np.isfinite(each).any() else 0.0 for each in kinds]
    velocity, heading, turn = (max(had, 0.5 * usual) for had, usual in zip(found, SIGMAS, strict=True))
    return velocity, heading, turn


def _weighed(windows: Windows, predicted: Array, sigmas: tuple[float, float, float]) -> tuple[float, ...]:
    """The sigmas by which the residuals count for as many as are independent: neighbours have gusts and waves in common."""
    off, weighed = _off(windows, predicted), list[float]()
    for index, sigma in ((0, sigmas[0]), (2, sigmas[1]), (3, sigmas[2])):
        known = np.where(np.isfinite(off[..., index]), off[..., index], 0.0)
        power, common = float((known**2).sum()), 1.0
        for shift in range(1, min(CORRELATED, windows.steps)):
            both = np.isfinite(off[shift:, :, index]) & np.isfinite(off[:-shift, :, index])
            if not both.any():
                continue
            shared = float((known[shift:] * known[:-shift]).sum()) / max(power, 1e-12)
            if shared < 0.05:
                break
            common += 2.0 * shared
        weighed.append(sigma * common**0.5)
    return tuple(weighed)


def _covariance(windows: Windows, prior: Prior, theta: Array, starts: Array, sigmas: tuple[float, ...]) -> Array:
    normal = _normal(windows, prior, theta, starts, sigmas)
    through = normal.mixed @ np.linalg.inv(normal.starts)
    return np.asarray(np.linalg.inv(normal.numbers - np.einsum("sij,skj->ik", through, normal.mixed)))


def _starts(windows: Windows, theta: Array) -> Array:
    """The states at which the windows begin, from what was measured in their first second."""
    first = windows.measured[: round(1.0 / windows.step_s)]
    p = plain(theta)
    count = first.shape[1]
    north, east, turn = (_mean(first[..., index]) for index in (0, 1, 3))
    heading = np.array([_first(first[:, window, 2]) for window in range(count)]) - p["compass_offset"]
    north, east = north - p["current_north"], east - p["current_east"]
    c, s = np.cos(heading), np.sin(heading)
    return np.stack([north * c + east * s, east * c - north * s, turn - p["gyro_bias"], heading], 1)


def _mean(values: Array) -> Array:
    known = np.isfinite(values)
    return np.asarray(np.where(known, values, 0.0).sum(0) / np.maximum(known.sum(0), 1))


def _first(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known[0]) if len(known) else 0.0
