"""What a boat does in calm water by its fitted numbers: speeds, ways to stop, rates of turn, each with its uncertainty."""

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np

from delfim.adoption.fitting import NUDGES, Fit
from delfim.adoption.model import (
    LOCAL,
    OF_THE_DAY,
    PLACE,
    Array,
    ModelMotion,
    MotorPush,
    SteeringGear,
    Windows,
    simulate,
    values_of,
)

STEP_S: Final = 0.1
PUSH_S, COAST_S = 40.0, 60.0  # until the speed is steady; until she lies
BACK: Final = 15  # steps before
RISEN: Final = 0.63  # of the last rate of turn: the time constant of a turn
MODEL: Final = 0.03  # of a figure: what a model of 39 numbers leaves of a true hull
WINDY: Final = 1.5  # times the acceleration that no command explains, over that of the motors: the speed is so much less sure
LEAST_SEEN: Final = 10  # velocities of a window
TOO_WINDY: Final = 0.2  # of a speed: one that is less sure than this is not built upon
BEYOND: Final = 1.1  # times the fastest that was sailed: a figure that is extrapolated ...
QUICKEST: Final = 0.99  # of all rates of turn: a gyro jumps now and then
EXTRA: Final = 0.25  # ... is so much of the excess less sure

Parts = tuple[float, float]  # of the starboard and the port motor


class Figure(NamedTuple):
    """A figure of the boat: found, its standard deviation, and what the vehicle's file told."""

    name: str
    words: str
    unit: str
    found: float
    spread: float
    told: float
    is_beyond: bool = False  # faster than she was sailed, or a quicker turn: extrapolated


class CalmRun(NamedTuple):
    """A manoeuvre in calm water, from rest: these parts for PUSH_S, then motors off."""

    name: str
    parts: Parts
    turn: float = 0.0  # of a boat that steers, at the mean of these parts or the greater one: of her greatest angle


RUNS: Final = (
    CalmRun("25", (0.25, 0.25)),
    CalmRun("30", (0.3, 0.3)),
    CalmRun("50", (0.5, 0.5)),
    CalmRun("60", (0.6, 0.6)),
    CalmRun("75", (0.75, 0.75)),
    CalmRun("100", (1.0, 1.0)),
    CalmRun("astern 60", (-0.6, -0.6)),
    CalmRun("turn", (0.3, 0.7), 0.5),
    CalmRun("turn to port", (0.7, 0.3), -0.5),
    CalmRun("spin 50", (-0.5, 0.5), 1.0),
    CalmRun("spin 90", (-0.9, 0.9), 1.0),
)
_AT: Final = {run.name: index for index, run in enumerate(RUNS)}
_PUSHED: Final = round(PUSH_S / STEP_S)


def _speed(name: str) -> Callable[[ModelMotion], Array]:
    return lambda motion: motion.surge[_PUSHED - 1, :, _AT[name]]


def _rate(name: str) -> Callable[[ModelMotion], Array]:
    return lambda motion: np.degrees(motion.turn[_PUSHED - 1, :, _AT[name]])


def _way(name: str) -> Callable[[ModelMotion], Array]:
    return lambda motion: np.maximum(motion.surge[_PUSHED:, :, _AT[name]], 0.0).sum(0) * STEP_S


def _radius(motion: ModelMotion) -> Array:
    """The radius of the circle of one motor stronger than the other, at their steady way."""
    at = _PUSHED - 1, slice(None), _AT["turn"]
    return np.asarray(np.hypot(motion.surge[at], motion.sway[at]) / np.maximum(np.abs(motion.turn[at]), 1e-3))


def _turning(motion: ModelMotion) -> Array:
    """The time until the rate of a spin is most of what it comes to: between two steps as between two lines."""
    rates = np.abs(motion.turn[:_PUSHED, :, _AT["spin 50"]])
    goal = RISEN * rates[-1]
    after = np.argmax(rates >= goal, 0)
    lanes = np.arange(len(goal))
    low, high = rates[np.maximum(after - 1, 0), lanes], rates[after, lanes]
    return np.asarray(STEP_S * (after - (high - goal) / np.maximum(high - low, 1e-9)))


FIGURES: Final[tuple[tuple[str, str, str, Callable[[ModelMotion], Array]], ...]] = (
    ("full_mps", "speed at full power", "m/s", _speed("100")),
    ("three_quarters_mps", "speed at 75 % of command", "m/s", _speed("75")),
    ("half_mps", "speed at 50 % of command", "m/s", _speed("50")),
    ("quarter_mps", "speed at 25 % of command", "m/s", _speed("25")),
    ("sixty_mps", "speed at 60 % of command", "m/s", _speed("60")),
    ("thirty_mps", "speed at 30 % of command", "m/s", _speed("30")),
    ("astern_mps", "speed at 60 % astern", "m/s", _speed("astern 60")),
    ("stop_full_m", "way with motors off, from full speed", "m", _way("100")),
    ("stop_60_m", "way with motors off, from 60 % of command", "m", _way("60")),
    ("stop_30_m", "way with motors off, from 30 % of command", "m", _way("30")),
    ("turn_dps", "rate of turn, motors at 30 and 70 %", "deg/s", _rate("turn")),
    ("turn_port_dps", "the same to port", "deg/s", _rate("turn to port")),
    ("radius_m", "radius of that circle", "m", _radius),
    ("spin_dps", "rate of a spin at 50 %", "deg/s", _rate("spin 50")),
    ("spin_full_dps", "rate of a spin at 90 %", "deg/s", _rate("spin 90")),
    ("turning_s", "until a spin has 63 % of its rate", "s", _turning),
)
STEERED: Final = {  # words for a boat that steers
    "turn_dps": "rate of turn, 50 % of command, half the angle",
    "spin_dps": "rate of turn, 50 % of command, whole angle",
    "spin_full_dps": "rate of turn, 90 % of command, whole angle",
    "turning_s": "until a turn has 63 % of its rate",
}
SPEEDS: Final = {  # from which run
    "full_mps": "100",
    "three_quarters_mps": "75",
    "half_mps": "50",
    "quarter_mps": "25",
    "sixty_mps": "60",
    "thirty_mps": "30",
}
STOPS: Final = {"stop_full_m": "100", "stop_60_m": "60", "stop_30_m": "30"}  # from which run


def calm(fit: Fit) -> ModelMotion:
    """The runs of a fit, in lanes: as found, with each number nudged, as the file tells."""
    lanes = np.concatenate([[fit.theta], fit.theta + np.diag(NUDGES), [fit.prior.told]])
    return sailed(lanes, fit.windows.gear, fit.windows.rows)


def figures(fit: Fit, motion: ModelMotion) -> dict[str, Figure]:
    """The figures of a fit from its runs, each with the deviation that follows from the uncertainty of the numbers and of the
    model."""
    count = len(fit.theta)
    gusts = unexplained_mps2(fit)
    found, fastest = dict[str, Figure](), np.nanmax(np.abs(fit.windows.measured[..., :2]).max(2))
    quickest_dps = quickest_turn_dps(fit)
    for name, words, unit, of in FIGURES:
        every = of(motion)
        slopes = (every[1 : 1 + count] - every[0]) / NUDGES
        value, began = float(every[0]), _speed(STOPS[name])(motion) if name in STOPS else every
        excess = abs(float(began[0])) / fastest if unit == "m/s" or name in STOPS else 1.0
        excess = abs(value) / quickest_dps if unit == "deg/s" and quickest_dps > 0.0 else excess
        windy = WINDY * gusts / _pushed(fit, name) if name in SPEEDS else 0.0
        vague = MODEL + windy + (2.0 * EXTRA if name in STOPS else EXTRA) * max(excess - 1.0, 0.0)
        spread = float(np.sqrt(max(slopes @ fit.covariance @ slopes, 0.0) + (vague * value) ** 2))
        words = words if fit.windows.gear is None else STEERED.get(name, words)
        found[name] = Figure(name, words, unit, value, spread, float(every[-1]), excess > BEYOND)
    return found


def quickest_turn_dps(fit: Fit) -> float:
    """The quickest rate of turn that was measured, but for a hundredth of all; 0: none was."""
    rates = np.abs(fit.windows.measured[..., 3])
    return float(np.degrees(np.nanquantile(rates, QUICKEST))) if np.isfinite(rates).any() else 0.0


def unexplained_mps2(fit: Fit) -> float:
    """The acceleration, m/s2, that no command explains: the deviation, over the windows, of how the velocity that is left over
    grows within each, less what the noise of a receiver does of that. Gusts do it, and waves."""
    off = (fit.windows.measured - fit.predicted)[..., :2]  # (steps, windows, 2)
    at_s = fit.windows.step_s * np.arange(len(off))
    slopes = list[float]()
    noise = list[float]()
    for each in off.reshape(len(off), -1).T:
        known = np.isfinite(each)
        if int(known.sum()) < LEAST_SEEN:
            continue
        away = at_s[known] - at_s[known].mean()
        slope = float((away * each[known]).sum() / (away**2).sum())
        left = each[known] - each[known].mean() - slope * away
        slopes.append(slope**2)
        noise.append(float((left**2).mean() / (away**2).sum()))
    return float(np.sqrt(max(float(np.mean(slopes)) - float(np.mean(noise)), 0.0))) if slopes else 0.0


def _pushed(fit: Fit, name: str) -> float:
    """The acceleration, m/s2, that both motors give in the run of a speed."""
    p, part = fit.values, RUNS[_AT[SPEEDS[name]]].parts[0]
    share = [max((part - p[dead]) / (1.0 - p[dead]), 0.0) ** p["power"] for dead in ("dead_starboard", "dead_port")]
    return max(float(p["ahead"] * (sum(share) if fit.windows.gear is None else share[0])), 1e-6)


def sailed(lanes: Array, gear: SteeringGear | None = None, rows: tuple[MotorPush, ...] = ()) -> ModelMotion:
    """The runs of these internal numbers (lanes, numbers), in calm water, with what turns a motor set straight, and with those
    of `rows` at a side alike: (steps, lanes, runs)."""
    calm = lanes.copy()
    calm[:, [PLACE[name] for name in (*OF_THE_DAY, "straight")]] = 0.0
    steps = round((PUSH_S + COAST_S) / STEP_S)
    commands = np.zeros((len(RUNS), BACK + steps, len(rows) or 2))
    for index, run in enumerate(RUNS):
        parts: Sequence[float] = run.parts if gear is None else _steered(run, gear)
        if rows:
            parts = [{1: run.parts[0], -1: run.parts[1], 0: 0.0}[row.side] for row in rows]
        commands[index, BACK : BACK + _PUSHED] = parts
    windows = Windows(STEP_S, commands, np.empty((steps, len(RUNS), 4)), np.zeros(len(RUNS)), BACK, gear, rows)
    return simulate(values_of(calm), windows, np.zeros((len(calm), len(RUNS), LOCAL)))


def _steered(run: CalmRun, gear: SteeringGear) -> Parts:
    """The part and the angle, rad, of a boat that steers."""
    part = max(run.parts) if run.parts[0] + run.parts[1] == 0.0 else 0.5 * (run.parts[0] + run.parts[1])
    return part, gear.way * run.turn * gear.most_rad
