"""How boats that are drawn sail with the gains that adoption chose for them.

    python -m bench.gains SEEDS [BOAT ...] [--truth] [--workers 2] [--rows run/gains.jsonl]

For each boat of docs/adopt.md and each seed: a whole trial, the fit, the gains on the twin, then a voyage of the true boat in
her own wind and current (a turn of 90 degrees, one of 20, two lines, a minute of holding), with today's gains, with those that
were found, and, with --truth, with those that the same choice makes of her true hull. Gusts and receivers of one voyage say
little of two gains that are nearly alike: with both of these she sails in each of SEAS, too. Then the proof sail; then 300 m of
a mission by the true boat and by her twin, with quiet receivers: one and the same boat is 2 to 3 m off her own track by two
receivers of 1 m. Prints a row for each boat, and one for all. A hull that no control turns by 90 degrees in ten seconds is
counted by itself. Each hull appends a row to the file, and is not asked for again.
"""

import argparse
import math
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import NamedTuple

import msgspec

from delfim import config
from delfim.adoption.trial.boats import SimulatedTrial
from delfim.adoption.trial.concluding import conclude
from delfim.adoption.trial.dialogue import NOISE
from delfim.adoption.trial.hiddenhull import Hidden, drawn, rewired
from delfim.adoption.trial.session import TrialProgress, TrialSession
from delfim.adoption.twin import gains
from delfim.adoption.twin.twinvoyage import TwinVoyage, VoyageTurn
from delfim.campaign.adopted.voyages import RADIUS_M, least_s, of_truth, twin_off_m, voyage
from delfim.campaign.adopted.whole import not_proven

BOATS = "heron", "otter", "wam-v", "blueboat"
OVER_DEG, SETTLED_S = 5.0, 10.0
SEAS = range(1, 9)  # seeds of gusts and receivers, in the boat's own wind and current
WORSE = 1.15  # times what gains of the truth give
TWIN_M = 2.0  # that the twin's track may be off


class InSeas(NamedTuple):
    """What gains give in each of SEAS: rms off the lines, m, from the point that she holds, m, and of the speed."""

    path_m: list[float]
    hold_m: list[float]
    speed_off: list[float]


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
    seas: tuple[InSeas, InSeas] | None = None  # with the gains that were found, and with those of the truth


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
    hull = gains.twin_hull(adopted)
    keys: gains.Keys = {("control", "heading", key): getattr(adopted.control.heading, key) for key in gains.HEADING}
    rest, cruise = hull.both(keys)
    is_steady = rest.holds(gains.AT_REST) and cruise.holds(gains.AT_CRUISE)
    today = msgspec.structs.replace(adopted, control=was.control, boat=was.boat)
    cruise_mps = adopted.control.speed.cruise_mps
    known = of_truth(was, adopted, true) if with_truth else None
    truth = voyage(known, true, seed, cruise_mps) if known is not None else None
    seas = (_in_seas(adopted, true, cruise_mps), _in_seas(known, true, cruise_mps)) if known is not None else None
    worse = not_proven(adopted, true, seed)
    sails = voyage(today, true, seed, cruise_mps), voyage(adopted, true, seed, cruise_mps), truth
    ends = least_s(adopted, true, seed), twin_off_m(adopted, true, seed)
    return Outcome(name, seed, "", *sails, is_steady, worse, *ends, seas)


def _in_seas(settings: config.Vehicle, true: Hidden, cruise_mps: float) -> InSeas:
    every = [voyage(settings, true, sea, cruise_mps) for sea in SEAS]
    return InSeas([its.path_m for its in every], [its.hold_m for its in every], [its.speed_off for its in every])


def compared(outcomes: list[Outcome]) -> Iterator[str]:
    """How gains that were found compare with those of the truth, over all seas, and how sure that is: the same for each half of
    the seas."""
    both = [each.seas for each in outcomes if each.seas is not None]
    for axis, words in enumerate(("path", "hold", "speed")):
        times = sorted(_times(pair, axis, slice(None)) for pair in both)
        halves = [abs(_times(pair, axis, slice(0, None, 2)) / _times(pair, axis, slice(1, None, 2)) - 1.0) for pair in both]
        near = f"{sum(each <= WORSE for each in times)} of {len(times)} at most {WORSE - 1.0:.0%} worse"
        spread = f"median {median(times):.3f}, {times[0]:.2f} to {times[-1]:.2f} times that of the truth"
        yield f"{words}: {near}; {spread}; one half of the seas beside the other: {median(halves):.1%} (most {max(halves):.0%})"


def _times(pair: tuple[InSeas, InSeas], axis: int, seas: slice) -> float:
    """Of the gains that were found, over that of the true ones."""
    found, true = (math.hypot(*its[axis][seas]) for its in pair)
    return found / true


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
    parser.add_argument("--workers", type=int, default=2, help="Processes.")
    parser.add_argument("--rows", type=Path, default=Path("run/gains.jsonl"), metavar="FILE")
    asked = parser.parse_args()
    asked.rows.parent.mkdir(parents=True, exist_ok=True)
    lines = asked.rows.read_bytes().splitlines() if asked.rows.exists() else []
    had = {(its.name, its.seed): its for its in (msgspec.json.decode(line, type=Outcome) for line in lines)}
    print(f"{HEAD}\n|{'---|' * 15}")
    with ProcessPoolExecutor(asked.workers) as pool:
        wanted = [(name, seed) for seed in range(1, asked.seeds + 1) for name in asked.boats]
        missing = [(name, seed, asked.truth) for name, seed in wanted if (name, seed) not in had]
        for each in pool.map(one, missing):
            had[each.name, each.seed] = each
            with asked.rows.open("ab") as file:
                file.write(msgspec.json.encode(each) + b"\n")
            print(f"  {each}", file=sys.stderr, flush=True)
    for name in asked.boats:
        print(row(name, [had[each] for each in wanted if each[0] == name]))
    every = [had[each] for each in wanted]
    print(row("all", every))
    if any(each.seas for each in every):
        print("\n".join(compared(every)))


if __name__ == "__main__":
    main()
