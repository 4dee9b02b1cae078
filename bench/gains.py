"""How boats that are drawn sail with the gains that adoption chose for them. python -m bench.gains SEEDS [BOAT ...]

For each boat of docs/adopt.md and each seed: a whole trial, the fit, the gains on the twin, then a voyage of the true boat in
her own wind and current (a turn of 90 degrees, one of 20, two lines, a minute of holding), with today's gains, with those that
were found, and with those that the same choice makes of her true hull; then the proof sail. Prints a row for each boat, and one
for all.
"""

import math
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import msgspec

from delfim import config
from delfim.adoption.trial.boats import SimulatedTrial
from delfim.adoption.trial.concluding import conclude
from delfim.adoption.trial.dialogue import NOISE
from delfim.adoption.trial.hiddenhull import Hidden, LateModel, drawn, rewired
from delfim.adoption.trial.proof import SimulatedProof, proved
from delfim.adoption.trial.session import TrialProgress, TrialSession
from delfim.adoption.twin import gains
from delfim.adoption.twin.twinvoyage import TwinVoyage, sailed, twin_of
from delfim.base.errors import DelfimError
from delfim.simulator.tables import SimulatedHull, Simulation

BOATS = "heron", "otter", "wam-v", "blueboat"
RADIUS_M = 60.0
OVER_DEG, SETTLED_S, NEAR = 5.0, 10.0, 1.15
WORKERS = 2


class Outcome(NamedTuple):
    """Of one boat."""

    name: str
    seed: int
    ended: str  # why there are no gains, in words; empty: there are
    today: TwinVoyage | None = None
    found: TwinVoyage | None = None
    true: TwinVoyage | None = None
    is_steady: bool = True
    proof: str = ""
    least_s: float = 0.0  # that a turn of 90 degrees takes with all her motors give, from rest


def one(job: tuple[str, int, bool]) -> Outcome:
    """Adopt a boat, and sail it."""
    name, seed, with_truth = job
    with TemporaryDirectory() as folder:
        file = Path(folder) / "boat.toml"
        noise = "\n".join(f"{key} = {value}" for key, value in NOISE.items())
        text = Path(f"etc/boats/{name}.toml").read_text()
        file.write_text(text.replace("[simulation]", f"[simulation]\n{noise}"))
        was = config.load(file)
        hidden, progress = drawn(was, seed), TrialProgress(was.thrusters)
        boat = SimulatedTrial(was, hidden, seed, RADIUS_M)
        place = Path(folder) / "boat.trial"
        ended = TrialSession(boat, was, progress, place, RADIUS_M, lambda words: True, lambda words: None).run()
        if ended or (ended := conclude(progress, file, file.with_suffix(".html"), "2026-11-27", lambda words: True, _quiet)):
            return Outcome(name, seed, ended)
        return _voyages(name, seed, was, file, hidden, with_truth)


def _quiet(words: str) -> None:
    pass


def _voyages(name: str, seed: int, was: config.Vehicle, file: Path, hidden: Hidden, with_truth: bool) -> Outcome:
    adopted = config.load(file)
    true = rewired(hidden, adopted.thrusters)
    sea = true.sea

    def sail(settings: config.Vehicle, cruise_mps: float) -> TwinVoyage:
        return sailed(SimulatedTrial(twin_of(settings, sea), true, seed, RADIUS_M).run, cruise_mps)

    hull = gains.twin_hull(adopted)
    keys: gains.Keys = {("control", "heading", key): getattr(adopted.control.heading, key) for key in gains.HEADING}
    rest, cruise = hull.both(keys)
    is_steady = rest.holds(gains.AT_REST) and cruise.holds(gains.AT_CRUISE)
    today = msgspec.structs.replace(adopted, control=was.control, boat=was.boat)
    cruise_mps = adopted.control.speed.cruise_mps
    of_truth = sail(_of_truth(was, adopted, true), cruise_mps) if with_truth else None
    proof = SimulatedProof(SimulatedTrial(adopted, true, seed + 1, RADIUS_M).run)
    try:
        worse = proved(proof, adopted, RADIUS_M, _quiet)
    except DelfimError as error:
        worse = str(error)
    voyages = sail(today, cruise_mps), sail(adopted, cruise_mps), of_truth
    return Outcome(name, seed, "", *voyages, is_steady, worse, _least_s(adopted, true, seed))


def _least_s(settings: config.Vehicle, true: Hidden, seed: int) -> float:
    """The time of a turn of 90 degrees with full power, from rest, and nothing to stop it."""
    calm = LateModel(settings, true._replace(sea=type(true.sea)()), seed)
    for row in settings.thrusters:
        calm.push(row.name, -math.copysign(1.0, row.y_m))
    begun, seconds = calm.heading_rad, 0.0
    while abs(math.remainder(calm.heading_rad - begun, math.tau)) < 0.5 * math.pi and seconds < 60.0:
        calm.advance(0.1)
        seconds += 0.1
    return seconds


def _of_truth(was: config.Vehicle, adopted: config.Vehicle, true: Hidden) -> config.Vehicle:
    """The file as the same choice of gains makes it of the true hull."""
    its, replace = true.hull, msgspec.structs.replace
    m11, m22 = its.mass_kg + its.added_surge_kg, its.mass_kg + its.added_sway_kg
    hull = SimulatedHull(
        mass_kg=m11,
        mass_aside_kg=m22,
        mass_turning_kg=m22,
        inertia_kgm2=its.inertia_kgm2 + its.added_yaw_kgm2,
        surge_n_per_mps=its.surge_n_per_mps,
        surge_n_per_mps2=its.surge_n_per_mps2,
        sway_n_per_mps=its.sway_n_per_mps,
        sway_n_per_mps2=its.sway_n_per_mps2,
        sway_ahead_n_per_mps2=its.lift_kg_per_m,
        yaw_nm_per_radps=its.yaw_nm_per_radps,
        yaw_nm_per_radps2=its.yaw_nm_per_radps2,
        yaw_ahead_nm_s_per_m=its.lift_kg_per_m * its.lift_m**2,
        munk_nm_per_mps2=m22 - m11 - its.lift_kg_per_m * its.lift_m,
    )
    rows = tuple(
        replace(row, thrust_n=motor.thrust_n, dead=motor.dead, power=motor.power, delay_s=true.delay_s, lag_s=its.motor_s)
        for row, motor in zip(adopted.thrusters, true.rows, strict=True)
    )
    boat = replace(
        adopted.boat,
        mass_kg=m11 / 1.05,
        drag_n_per_mps=its.surge_n_per_mps,
        drag_n_per_mps2=its.surge_n_per_mps2,
        inertia_kgm2=hull.inertia_kgm2,
        yaw_nm_per_radps=its.yaw_nm_per_radps + hull.yaw_ahead_nm_s_per_m * adopted.control.speed.cruise_mps,
        yaw_nm_per_radps2=its.yaw_nm_per_radps2,
    )
    file = replace(adopted, boat=boat, thrusters=rows, control=was.control, simulation=replace(was.of(Simulation), hull=hull))
    best = gains.chosen(was, file, 1.0).best
    return gains.with_keys(file, best.keys)


def row(name: str, outcomes: list[Outcome]) -> str:
    """A row of the table."""
    done = [each for each in outcomes if each.found is not None]

    def part(holds: Callable[[Any], bool], of: str) -> str:
        seen = [voyage for each in done if (voyage := getattr(each, of)) is not None]
        return f"{sum(map(holds, seen))} of {len(seen)}"

    def middle(of: str, figure: str) -> str:
        seen = [getattr(voyage, figure) for each in done if (voyage := getattr(each, of)) is not None]
        return f"{median(seen):.2f}" if seen else ""

    turns = [part(lambda its: its.over_deg <= OVER_DEG and its.quarter_s <= SETTLED_S, of) for of in ("today", "found", "true")]
    over = [part(lambda its: its.over_deg <= OVER_DEG, of) for of in ("today", "found", "true")]
    figures = [
        " / ".join(middle(of, figure) for of in ("today", "found", "true"))
        for figure in ("over_deg", "quarter_s", "path_m", "hold_m", "speed_off", "travel_per_s")
    ]
    proven = f"{sum(not each.proof for each in done)} of {len(done)}"
    steady = f"{sum(each.is_steady for each in done)} of {len(done)}"
    counts = f"{len(done)} of {len(outcomes)}", " / ".join(turns), " / ".join(over)
    return f"| {' | '.join([name, *counts, *figures, steady, proven])} |"


def main(seeds: int, boats: tuple[str, ...], with_truth: bool) -> None:
    print(
        "| boat | adopted | turn holds: today / found / of the truth | over holds | over, deg | 90 deg, s | path, m "
        "| hold, m | speed off | travel, 1/s | margins | proven |"
    )
    print("|" + "---|" * 12)
    every = list[Outcome]()
    with ProcessPoolExecutor(WORKERS) as pool:
        for name in boats:
            outcomes = list[Outcome]()
            for each in pool.map(one, [(name, seed, with_truth) for seed in range(1, seeds + 1)]):
                outcomes.append(each)
                print(f"  {each}", file=sys.stderr, flush=True)
            every += outcomes
            print(row(name, outcomes), flush=True)
    print(row("all", every), flush=True)


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if word != "--truth"]
    main(int(words[0]), tuple(words[1:]) or BOATS, "--truth" in sys.argv)
