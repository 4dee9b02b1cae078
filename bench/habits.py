"""What four habits of the critical path are worth: each of them broken in turn, against the program as it is.

    python -m bench.habits [--rate HZ] [--seconds S] [--rounds N] [--load]

garbage   the interpreter collects garbage whenever it likes, not in the quiet time between two cycles
log       the record of the last cycle is written before the propellers are commanded, not after
names     what is called for each frame is looked up in its object each time, not bound once
practice  while a window waits it only looks, and practises no part of the path

Turns are interleaved on one machine; the program as it is has two a round, and its halves against each other are the noise.
"""

import argparse
import contextlib
import gc
import sys
import tempfile
from collections import defaultdict
from itertools import chain
from pathlib import Path

from bench import competitor, critical_path, report
from delfim.parts.dsor.source import DsorNavigation
from delfim.vehicle.helm.helm import Helm
from delfim.vehicle.navigation.fixes import Fix
from delfim.vehicle.rehearsal import Rehearsal
from delfim.vehicle.state import Wanted

AS_IT_IS, HABITS = "delfim", ("garbage", "log", "names", "practice")
PERCENTILES = ("p50", "p99", "p999")


def broken(habit: str) -> None:
    """Break one habit in this process."""
    if habit == "garbage":
        gc.freeze = gc.disable = lambda: None
    elif habit == "log":
        control = Helm.control

        def log_and_control(helm: Helm, now_s: float) -> Wanted:
            helm._log.write(helm.state, now_s)
            return control(helm, now_s)

        Helm.control = log_and_control  # type: ignore[method-assign,assignment]
    elif habit == "names":
        DsorNavigation.read = read_by_name  # type: ignore[method-assign,assignment]
    elif habit == "practice":
        Rehearsal.part = lambda rehearsal: None  # type: ignore[method-assign,assignment]


def read_by_name(navigation: DsorNavigation, now_s: float) -> Fix | None:
    fix = None
    for frame in navigation.input.receive_many():
        message = navigation._receiver.feed(frame, now_s)
        if message is not None:
            fix = navigation._fix(message, now_s) or fix
    return fix


class Team(critical_path.Team):
    """A competitor that broke a habit."""

    def _competitor(self, kind: str) -> list[str]:
        return [sys.executable, "-m", "bench.habits", kind, *self._arguments]


def measure(asked: argparse.Namespace) -> dict[str, list[list[float]]]:
    """Lengths of the critical path, us, of each turn of each."""
    with contextlib.ExitStack() as links:
        place = Path(links.enter_context(tempfile.TemporaryDirectory(prefix="delfim-bench-")))
        programs, teams = critical_path.build(place), {}
        settings = argparse.Namespace(file="etc/delfimx.toml", set=[], bus=None, frames=7700, wire_us=0)
        for key in (AS_IT_IS, *HABITS):
            teams[key] = links.enter_context(Team(key, asked.rate, settings, programs, place / key))
        slices = defaultdict(list)
        for number in range(asked.rounds):
            print(f"round {number + 1} of {asked.rounds}", file=sys.stderr)
            for key in (AS_IT_IS, *(HABITS if number % 2 else reversed(HABITS)), AS_IT_IS):
                slices[key].append(teams[key].turn(asked.seconds, None, flood=asked.load))
        for team in teams.values():
            team.end()
        return {
            key: [report.paths_us(critical_path._within(teams[key].cycles(), part)) for part in turns]
            for key, turns in slices.items()
        }


def main() -> None:
    parser = argparse.ArgumentParser(description="What four habits of the critical path are worth.")
    parser.add_argument("--rate", type=float, default=100.0)
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--load", action="store_true", help="a full bus, all of it in the black box")
    paths = measure(parser.parse_args())
    halves = [sorted(chain(*paths[AS_IT_IS][start::2])) for start in (0, 1)]
    noise, its = report.noise_of(*halves), sorted(chain(*halves))
    print(f"{'us':<12}{'cycles':>8}" + "".join(f"{name:>9}{'x':>7}" for name in PERCENTILES))
    for key, turns in paths.items():
        ordered = sorted(chain(*turns))
        figures = [(report.percentile(ordered, report.PERCENTILES[name]) or 0.0) for name in PERCENTILES]
        of = [(report.percentile(its, report.PERCENTILES[name]) or 0.0) for name in PERCENTILES]
        cells = "".join(f"{value:>9.1f}{value / base:>7.2f}" for value, base in zip(figures, of, strict=True))
        print(f"{key if key in HABITS else 'as it is':<12}{len(ordered):>8}{cells}")
    print("noise, as it is against itself: " + ", ".join(f"{name} x {noise[name]}" for name in PERCENTILES))


if __name__ == "__main__":
    if sys.argv[1:] and sys.argv[1] in (AS_IT_IS, *HABITS, *competitor.KINDS):
        broken(sys.argv[1])
        sys.exit(competitor.main([AS_IT_IS, *sys.argv[2:]]))
    main()
