"""Which motor is where: how often a trial finds it, on boats that are drawn. python -m bench.adoption SEEDS [BOAT ...]

Prints a row for each boat of docs/adopt.md. A drawn boat has other inertia (a third to three times), coefficients up to 40 %
off, unequal motors, a dead band up to 0.15, a delay up to 0.5 s, wind up to 4 m/s, current up to 0.3 m/s, and any wiring.
"""

import math
import sys
from collections import Counter
from statistics import median

from delfim import config
from delfim.adoption.trial.boats import SimulatedTrial
from delfim.adoption.trial.dialogue import NOISE
from delfim.adoption.trial.hiddenhull import drawn
from delfim.adoption.trial.manoeuvres import SeaTrial, TrialEnded
from delfim.adoption.trial.motors import wiring

BOATS = "heron", "otter", "wam-v", "blueboat"
RADIUS_M = 60.0


def tried(name: str, seed: int) -> tuple[str, float, float, float]:
    """How it ended, the time that it took, s, the way from the middle, m, and the greatest command that it took."""
    settings = config.load(
        f"etc/boats/{name}.toml", ["adopted.proven=false", *(f"simulation.{key}={value}" for key, value in NOISE.items())]
    )
    hidden, most_m = drawn(settings, seed), [0.0]

    def look(boat: SimulatedTrial) -> None:
        north_m, east_m = boat.model.north_m - boat.middle_m[0], boat.model.east_m - boat.middle_m[1]
        most_m[0] = max(most_m[0], math.hypot(north_m, east_m))

    trial = SeaTrial(
        SimulatedTrial(settings, hidden, seed, RADIUS_M, look), settings.boat.length_m, RADIUS_M, lambda words: None
    )
    try:
        trial.play("drift", "", lambda: trial.drift(15.0))
        trial.play("motors", "", trial.find_motors)
        trial.play("proof", "", trial.prove_motors)
    except TrialEnded as end:
        print(f"  {name} {seed}: {end}; {hidden.words()}", file=sys.stderr)
    found = trial.motors and wiring(trial.motors, settings.thrusters)
    is_right = found == (hidden.swapped, hidden.reversed)
    how = "no answer" if found is None else "wrong" if not is_right else "right" if len(trial.played) == 3 else "not proven"
    if how == "right" and trial.played[-1].ended:
        how = "not proven"
    power = max((abs(part) for each in trial.tape for part in each.told), default=0.0)
    return how, trial.elapsed_s, most_m[0], power


def main(seeds: int, boats: tuple[str, ...]) -> None:
    print(
        "| boat | right, proven | right, not proven | no answer | wrong | s, median (most) | way, m, the same | power, median |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for name in boats:
        rows = [tried(name, seed) for seed in range(1, seeds + 1)]
        count = Counter(row[0] for row in rows)
        told = [str(count[how]) for how in ("right", "not proven", "no answer", "wrong")]
        figures = [row[1] for row in rows], [row[2] for row in rows]
        told += [f"{median(values):.0f} ({max(values):.0f})" for values in figures]
        print("|", " | ".join([name, *told, f"{median(row[3] for row in rows):.0%}"]), "|", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), tuple(sys.argv[2:]) or BOATS)
