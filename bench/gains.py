"""How boats that are drawn sail with the gains that adoption chose for them.

    python -m bench.gains SEEDS [BOAT ...] [--truth] [--rows run/gains.jsonl]

For each boat of docs/adopt.md and each seed: a whole trial, the fit, the gains on the twin, then a voyage of the true boat in
her own wind and current (a turn of 90 degrees, one of 20, two lines, a minute of holding), with today's gains, with those that
were found, and, with --truth, with those that the same choice makes of her true hull; then the proof sail; then 300 m of a
mission by the true boat and by her twin, with quiet receivers: one and the same boat is 2 to 3 m off her own track by two
receivers of 1 m. Prints a row for each boat, and one for all. A hull that no control turns by 90 degrees in ten seconds is
counted by itself. Each hull appends a row to the file, and is not asked for again.
"""

import argparse
import math
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import NamedTuple

import msgspec
import numpy as np

from delfim import config
from delfim.adoption.model import Array
from delfim.adoption.trial.boats import SETTLE_S, SimulatedTrial
from delfim.adoption.trial.concluding import conclude
from delfim.adoption.trial.dialogue import NOISE
from delfim.adoption.trial.hiddenhull import Hidden, LateModel, drawn, rewired
from delfim.adoption.trial.proof import SimulatedProof, proved
from delfim.adoption.trial.session import TrialProgress, TrialSession
from delfim.adoption.twin import gains
from delfim.adoption.twin.twintrack import apart
from delfim.adoption.twin.twinvoyage import FACTOR, NEAR_DEG, TwinVoyage, VoyageTurn, mission_text, sailed, twin_of
from delfim.base.errors import DelfimError
from delfim.base.modes import Mode
from delfim.simulator.lockstep import Lockstep, uncollected
from delfim.simulator.tables import SimulatedHull, Simulation
from delfim.vehicle import console
from delfim.vehicle.state import NoLog

BOATS = "heron", "otter", "wam-v", "blueboat"
RADIUS_M = 60.0
OVER_DEG, SETTLED_S = 5.0, 10.0
LONG_S, STEP_S, ROUNDS = 30.0, 0.1, 8
WORKERS = 2
MISSION_M = (8.0, 0.0), (98.0, 0.0), (98.0, 60.0), (8.0, 60.0), (8.0, 10.0)  # north and east of her
MISSION_LONG_M = 300.0
TWIN_M = 2.0  # that the twin's track may be off


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
    least_s: float = 0.0  # that a turn of 90 degrees takes by full power one way and then the other
    twin_m: tuple[float, float] = (math.inf, math.inf)  # of the twin's track off hers in one mission: rms, most


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
    return Outcome(name, seed, "", *voyages, is_steady, worse, _least_s(adopted, true, seed), _beside(adopted, true, seed))


def _beside(adopted: config.Vehicle, true: Hidden, seed: int) -> tuple[float, float]:
    """How far the twin's track of a mission is off hers, with quiet receivers, in the same sea, m: rms, most."""
    alone = twin_of(adopted, true.sea)
    begun = {"noise": False, "heading_deg": math.degrees(true.heading_rad) % 360.0}
    quiet = msgspec.structs.replace(alone, simulation=msgspec.structs.replace(alone.of(Simulation), **begun))
    twin = Lockstep(quiet, seed, lambda clock: NoLog())
    for _ in twin.cycles(SETTLE_S):
        pass
    runs, cruise_mps = (SimulatedTrial(quiet, true, seed, RADIUS_M).run, twin), adopted.control.speed.cruise_mps
    mission = mission_text(twin.nodes.model.origin, MISSION_M, cruise_mps)
    tracks = [_track(run, mission, FACTOR * MISSION_LONG_M / cruise_mps) for run in runs]
    if not all(map(len, tracks)):
        return math.inf, math.inf
    off_m = np.concatenate([apart(*tracks), apart(*tracks[::-1])])
    return float(np.sqrt(np.mean(off_m**2))), float(off_m.max())


@uncollected()
def _track(run: Lockstep, mission: str, limit_s: float) -> Array:
    """Where the boat truly is while she sails a mission, m: empty where she does not sail it to its end."""
    places, model = list[tuple[float, float]](), run.nodes.model
    if run.command(console.LoadMission(mission)) is None and run.command(console.Play()) is None:
        for state in run.cycles(limit_s):
            if state.mode is not Mode.PLAY:
                return np.array(places)
            places.append((model.north_m, model.east_m))
    return np.empty((0, 2))


def _least_s(settings: config.Vehicle, true: Hidden, seed: int) -> float:
    """The time from an order until she stays within NEAR_DEG of a heading 90 degrees to starboard, from rest in calm water, by
    full power one way and then the other, which go NEAR_DEG beyond it: no control is quicker."""

    def turned(for_s: float) -> tuple[float, float]:
        """How far she turns, rad, with full power for so long, and the time until she is near the heading, s."""
        calm = LateModel(settings, true._replace(sea=type(true.sea)()), seed)
        begun, seconds, near_s, way = calm.heading_rad, 0.0, LONG_S, 1.0
        while seconds < LONG_S and calm.yaw_rate_radps >= 0.0:
            way = 1.0 if seconds < for_s else -1.0
            for row in settings.thrusters:
                calm.push(row.name, -math.copysign(way, row.y_m))
            calm.advance(STEP_S)
            seconds += STEP_S
            gone_rad = math.remainder(calm.heading_rad - begun - math.pi, math.tau) + math.pi
            if gone_rad >= 0.5 * math.pi - math.radians(NEAR_DEG):
                near_s = min(near_s, seconds)
            if gone_rad > 0.5 * math.pi + math.radians(NEAR_DEG):
                return gone_rad, near_s
        return calm.heading_rad - begun, near_s

    low_s, high_s = 0.0, LONG_S
    for _ in range(ROUNDS):
        middle_s = 0.5 * (low_s + high_s)
        is_far = turned(middle_s)[0] > 0.5 * math.pi + math.radians(NEAR_DEG)
        low_s, high_s = (low_s, middle_s) if is_far else (middle_s, high_s)
    return true.delay_s + turned(high_s)[1]


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
    able = [each for each in done if each.least_s <= SETTLED_S]

    def part(holds: Callable[[VoyageTurn], bool], of: str) -> str:
        seen = [voyage.quarter for each in able if (voyage := getattr(each, of)) is not None]
        return f"{sum(map(holds, seen))} of {len(seen)}"

    def middle(figure: Callable[[TwinVoyage], float], of: str) -> str:
        seen = [figure(voyage) for each in done if (voyage := getattr(each, of)) is not None]
        return f"{median(seen):.2f}" if seen else ""

    holds: list[Callable[[VoyageTurn], bool]] = [
        lambda its: its.over_deg <= OVER_DEG and its.settled_s <= SETTLED_S,
        lambda its: its.told_over_deg <= OVER_DEG and its.told_s <= SETTLED_S,
    ]
    figures: list[Callable[[TwinVoyage], float]] = [
        lambda its: its.quarter.over_deg,
        lambda its: its.quarter.settled_s,
        *(lambda its, key=key: getattr(its, key) for key in ("path_m", "hold_m", "speed_off", "travel_per_s")),
    ]
    of = [each for each in ("today", "found", "true") if any(getattr(its, each) is not None for its in done)]
    turns = [" / ".join(part(one, each) for each in of) for one in holds]
    told = [" / ".join(middle(figure, each) for each in of) for figure in figures]
    proven = f"{sum(not each.proof for each in done)} of {len(done)}"
    steady = f"{sum(each.is_steady for each in done)} of {len(done)}"
    counts = f"{len(done)} of {len(outcomes)}", str(len(done) - len(able))
    twins = [each.twin_m for each in done]
    near = f"{sum(most_m <= TWIN_M for _, most_m in twins)} of {len(done)}"
    off = " / ".join(f"{median(figures):.2f}" for figures in zip(*twins, strict=True))
    return f"| {' | '.join([name, *counts, *turns, *told, steady, proven, off, near])} |"


HEAD = (
    "| boat | adopted | cannot | turn holds: today / found / of the truth | the same as told | over, deg | 90 deg, s | path, m "
    "| hold, m | speed off | travel, 1/s | margins | proven | twin off her, m: rms / most | within 2 m |"
)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.gains", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("seeds", type=int, help="Of each boat, from 1.")
    parser.add_argument("boats", nargs="*", default=BOATS)
    parser.add_argument("--truth", action="store_true", help="With the gains of the true hull, too.")
    parser.add_argument("--rows", type=Path, default=Path("run/gains.jsonl"), metavar="FILE")
    asked = parser.parse_args()
    asked.rows.parent.mkdir(parents=True, exist_ok=True)
    lines = asked.rows.read_bytes().splitlines() if asked.rows.exists() else []
    had = {(its.name, its.seed): its for its in (msgspec.json.decode(line, type=Outcome) for line in lines)}
    print(f"{HEAD}\n|{'---|' * 15}")
    with ProcessPoolExecutor(WORKERS) as pool:
        wanted = [(name, seed) for seed in range(1, asked.seeds + 1) for name in asked.boats]
        missing = [(name, seed, asked.truth) for name, seed in wanted if (name, seed) not in had]
        for each in pool.map(one, missing):
            had[each.name, each.seed] = each
            with asked.rows.open("ab") as file:
                file.write(msgspec.json.encode(each) + b"\n")
            print(f"  {each}", file=sys.stderr, flush=True)
    for name in asked.boats:
        print(row(name, [had[each] for each in wanted if each[0] == name]))
    print(row("all", [had[each] for each in wanted]))


if __name__ == "__main__":
    main()
