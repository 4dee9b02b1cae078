"""The estimator on the simulator's hull in current and wind, driven round turns by hand. Its test stands on it, and

    python -m tests.vehicle.estimator_trial docs/pictures

draws the picture of docs/estimator.md and prints its table.
"""

import math
import random
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from delfim import config
from delfim.base import geodesy
from delfim.simulator.model import Hull, Model
from delfim.simulator.tables import Sea
from delfim.vehicle.navigation.estimator import Estimate, Estimator

SEA = Sea(current_mps=0.5, current_to_deg=60.0, wind_mps=6.0, wind_from_deg=200.0)
PLACE = geodesy.origin(0.67, -0.16)
TICK_S = 0.02  # of the gyro, 50 Hz
LIMITS = config.NavigationTable(sources=("nmea2000",), stale_s=2.5)
FROZEN_S = 3.0
BIAS_RADPS = math.radians(0.5)
SLOW_M, SLOW_S = 0.35, 60.0  # a receiver's slow error, which nobody aboard can see


class Sensors(NamedTuple):
    """What is aboard, with standard deviations."""

    gnss_hz: float = 5.0
    has_velocity: bool = True
    has_gyro: bool = True
    position_m: float = 0.35  # white, beside the slow error
    velocity_mps: float = 0.05
    heading_deg: float = 2.0  # 10 Hz
    rate_degps: float = 0.3

    @property
    def settings(self) -> config.EstimatorTable:
        """The settings that say so."""
        return config.EstimatorTable(
            position_m=self.position_m,
            velocity_mps=self.velocity_mps,
            heading_deg=self.heading_deg,
            rate_degps=self.rate_degps,
        )


class Truth(NamedTuple):
    t_s: float
    north_m: float
    east_m: float
    north_mps: float
    east_mps: float
    heading_rad: float
    yaw_rate_radps: float


class Row(NamedTuple):
    """A look at the estimate: errors, and normalised errors squared by degree of freedom (NEES)."""

    t_s: float
    position_m: float  # beside the receiver's slow error
    velocity_mps: float
    heading_rad: float
    position_nees: float
    velocity_nees: float
    heading_nees: float


class Trial(NamedTuple):
    rows: list[Row]
    position_nis: list[float]  # by degree of freedom
    heading_nis: list[float]
    estimator: Estimator


def tape(seed: int, seconds: float = 120.0) -> list[Truth]:
    """The boat's motion, fifty times a second."""
    model, draw = Model(Hull(), SEA, seed, PLACE.latitude_rad, PLACE.longitude_rad, 1.0), random.Random(seed)
    rows, t_s, next_s = list[Truth](), 0.0, 0.0
    while t_s < seconds:
        if t_s >= next_s:
            ahead, turn = draw.choice((400, 700, 1000)), draw.choice((0, 0, 150, -150, 400, -400))
            model.command("starboard", ahead - turn, True)
            model.command("port", ahead + turn, True)
            next_s = t_s + draw.uniform(3.0, 15.0)
        model.advance(TICK_S)
        t_s += TICK_S
        velocity = model.north_mps, model.east_mps
        rows.append(Truth(t_s, model.north_m, model.east_m, *velocity, model.heading_rad, model.yaw_rate_radps))
    return rows


def trial(truth: Sequence[Truth], seed: int, sensors: Sensors) -> Trial:
    """The estimator on this motion."""
    gauss = random.Random(f"sensors {seed}").gauss
    estimator = Estimator(sensors.settings, LIMITS, FROZEN_S)
    done = Trial([], [], [], estimator)
    keep = math.exp(-TICK_S / SLOW_S)
    new_m = SLOW_M * math.sqrt(1.0 - keep * keep)
    slow_n, slow_e = gauss(0.0, SLOW_M), gauss(0.0, SLOW_M)
    every = round(1.0 / TICK_S / sensors.gnss_hz)
    for i, b in enumerate(truth):
        slow_n, slow_e = keep * slow_n + gauss(0.0, new_m), keep * slow_e + gauss(0.0, new_m)
        if sensors.has_gyro:
            estimator.rate(b.t_s, b.yaw_rate_radps + BIAS_RADPS + gauss(0.0, math.radians(sensors.rate_degps)))
        if i % 5 == 0:
            estimator.heading(b.t_s, b.heading_rad + gauss(0.0, math.radians(sensors.heading_deg)))
            done.heading_nis.append(estimator.turn.nis)
        if i % every == 0:
            north_m, east_m = (at + gauss(0.0, sensors.position_m) for at in (b.north_m + slow_n, b.east_m + slow_e))
            estimator.position(b.t_s, *geodesy.from_plane(PLACE, north_m, east_m))
            done.position_nis.append(estimator.course.nis / 2.0)
            if sensors.has_velocity:
                noise = gauss(0.0, sensors.velocity_mps), gauss(0.0, sensors.velocity_mps)
                estimator.velocity(b.t_s, b.north_mps + noise[0], b.east_mps + noise[1])
        if i % 5 == 3 and b.t_s > 20.0:
            done.rows.append(_compared(b, (slow_n, slow_e), estimator, estimator.estimate(b.t_s)))
    return done


def _compared(b: Truth, slow_m: tuple[float, float], estimator: Estimator, e: Estimate) -> Row:
    assert None not in e[:5]
    north_m, east_m = geodesy.to_plane(PLACE, e.latitude_rad, e.longitude_rad)
    away_m = math.hypot(north_m - b.north_m - slow_m[0], east_m - b.east_m - slow_m[1])
    slip_mps = math.hypot(e.north_mps - b.north_mps, e.east_mps - b.east_mps)
    off_rad = math.remainder(e.heading_rad - b.heading_rad, math.tau)
    course, turn = estimator.course, estimator.turn
    nees = away_m**2 / course.p11 / 2.0, slip_mps**2 / course.p22 / 2.0, off_rad**2 / turn.p11
    return Row(b.t_s, away_m, slip_mps, off_rad, *nees)


def mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def rms(values: Sequence[float]) -> float:
    return math.sqrt(mean([value * value for value in values]))


ABOARD = {
    "5 Hz, compass and gyro": Sensors(),
    "5 Hz, compass": Sensors(has_gyro=False),
    "1 Hz, compass and gyro": Sensors(gnss_hz=1.0),
    "10 Hz, compass and gyro": Sensors(gnss_hz=10.0),
    "5 Hz, no velocity, compass and gyro": Sensors(has_velocity=False),
}


def figures(trials: Sequence[Trial]) -> dict[str, float]:
    """RMS errors, and mean normalised errors by degree of freedom."""
    rows = [row for each in trials for row in each.rows]
    return {
        "position, m": rms([row.position_m for row in rows]),
        "velocity, m/s": rms([row.velocity_mps for row in rows]),
        "heading, degrees": math.degrees(rms([row.heading_rad for row in rows])),
        "NEES position": mean([row.position_nees for row in rows]),
        "NEES velocity": mean([row.velocity_nees for row in rows]),
        "NEES heading": mean([row.heading_nees for row in rows]),
        "NIS position": mean([nis for each in trials for nis in each.position_nis]),
        "NIS heading": mean([nis for each in trials for nis in each.heading_nis]),
    }


def bounds(freedom: int, seeds: int) -> tuple[float, float]:
    """Of the mean over seeds of a normalised error squared, by degree of freedom: 95 % of a filter that is right, as Wilson and
    Hilferty approximate chi-square."""
    ninth = 2.0 / (9.0 * freedom * seeds)
    low, high = ((1.0 - ninth + z * math.sqrt(ninth)) ** 3 for z in (-1.96, 1.96))
    return low, high


def draw(output: Path, seeds: int) -> None:
    """The picture: NEES over time, the mean of all seeds, and the histogram of NIS; and the table."""
    from matplotlib.figure import Figure

    from delfim.logging.ashore.plot import BOAT, INK, LINE, WATER

    tapes = [tape(seed) for seed in range(seeds)]
    for name, sensors in ABOARD.items():
        told = figures([trial(truth, seed, sensors) for seed, truth in enumerate(tapes)])
        print(f"| {name} | " + " | ".join(f"{value:.2f}" for value in told.values()) + " |")
    trials = [trial(truth, seed, Sensors()) for seed, truth in enumerate(tapes)]
    sheet = Figure(figsize=(9.0, 9.0), layout="constrained", facecolor="white")
    axes = sheet.subplots(4, 1)
    shown = ("position_nees", 2, "position"), ("velocity_nees", 2, "velocity"), ("heading_nees", 1, "heading")
    for at, (key, freedom, word) in enumerate(shown):
        axes[at].plot(
            [row.t_s for row in trials[0].rows],
            [mean([getattr(each.rows[i], key) for each in trials]) for i in range(len(trials[0].rows))],
            color=WATER,
            lw=0.9,
        )
        for bound in bounds(freedom, seeds):
            axes[at].axhline(bound, color=BOAT, lw=0.9, ls="--")
        axes[at].set(xlabel="s", ylabel="NEES by degree of freedom", ylim=(0.0, 2.6))
        axes[at].set_title(
            f"{word}: mean of {seeds} seeds, and the bounds of 95 % of a filter that is right", fontsize=10, color=INK
        )
    nis = [2.0 * value for each in trials for value in each.position_nis]
    axes[3].hist(nis, bins=[0.25 * i for i in range(61)], density=True, color=LINE)
    axes[3].plot([0.05 * i for i in range(300)], [0.5 * math.exp(-0.025 * i) for i in range(300)], color=BOAT, lw=0.9, ls="--")
    axes[3].axvline(13.8, color=INK, lw=0.8, ls=":")
    axes[3].set(xlabel="NIS of a position", ylabel="density", xlim=(0.0, 15.0))
    axes[3].set_title("NIS of positions, chi-square of two degrees of freedom, and the gate", fontsize=10, color=INK)
    for each in axes:
        each.spines[["top", "right"]].set_visible(False)
    sheet.savefig(output / "estimator.png", dpi=110)


if __name__ == "__main__":
    draw(Path(sys.argv[1]), 20)
