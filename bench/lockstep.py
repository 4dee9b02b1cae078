"""`python -m bench sim`: how many times faster than the clock one core sails each boat's mission in lock step, its state log
written. The boats take turns, so that whatever else the machine does meets all of them."""

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from delfim import config
from delfim.base.errors import ConfigError, DelfimError
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.tables import Simulation
from delfim.vehicle.log.logbook import Logbook
from delfim.vehicle.plans.mission import canonical, load_mission

REPETITIONS, QUICK_REPETITIONS = 7, 2
SAILED_S: Final = 7200.0  # the longest voyage
CONTRACT: Final = 1000.0  # times real time
YEAR_S: Final = 365.25 * 86400.0
CORES: Final = 16  # of the machine that boat-years a day are told for


def run(asked: argparse.Namespace) -> int:
    """The command. Returns 0 when it was measured, whatever came out."""
    others = sorted(Path(asked.file).parent.glob("boats/*.toml"))
    files = [asked.file, *map(str, others)]
    for file in files:
        if not config.load(file, asked.set).of(Simulation).mission:
            raise ConfigError(file, "simulation.mission", "missing: there is nothing to sail")
    cpus = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cpus)})
    try:
        count = asked.rounds or (QUICK_REPETITIONS if asked.quick else REPETITIONS)
        turns = [[_speeds(asked, file, turn) for file in files] for turn in range(count)]
    finally:
        os.sched_setaffinity(0, cpus)
    boats = {Path(file).stem: _figures(speeds) for file, speeds in zip(files, zip(*turns, strict=True), strict=True)}
    results = {"repetitions": count, "contract": CONTRACT, "boats": boats}
    output = Path(asked.output)
    output.mkdir(parents=True, exist_ok=True)
    (output / "sim.json").write_text(json.dumps(results, indent=1) + "\n")
    print(f"lock step on one core, {count} voyages of each boat in turns, times real time (contract: {CONTRACT:.0f}):")
    print(f"{'':12}{'by processor time':>24}{'by the clock':>24}   boat-years a day of {CORES} such cores")
    for name, times in boats.items():
        told = "".join(f"{times[by][n]:8.0f}" for by in ("times_processor_time", "times_real_time") for n in _PARTS)
        print(f"{name:12}{told}{CORES * times['times_processor_time']['median'] * 86400.0 / YEAR_S:10.0f}")
    print(f"least, median and most of the voyages: their distance is the noise\n{output}/sim.json")
    return 0


_PARTS: Final[dict[str, Callable[[Sequence[float]], float]]] = {"min": min, "median": statistics.median, "max": max}


def _figures(speeds: tuple[tuple[float, float], ...]) -> dict[str, dict[str, float]]:
    clock, processor = ({name: of(each) for name, of in _PARTS.items()} for each in zip(*speeds, strict=True))
    return {"times_real_time": clock, "times_processor_time": processor}


def _speeds(asked: argparse.Namespace, file: str, turn: int) -> tuple[float, float]:
    """One voyage, in seconds sailed a second of the clock, and of the processor."""
    with tempfile.TemporaryDirectory(prefix="delfim-bench-") as place:
        settings = config.load(file, [*asked.set, f'log.directory="{place}"', 'log.state_method="write"'])
        mission = canonical(load_mission(str(Path(file).parent / settings.of(Simulation).mission)))
        began_s, worked_s = time.monotonic(), time.process_time()
        voyage = Lockstep(settings, turn + 1, lambda clock: Logbook(settings, clock))
        end = voyage.sail(mission, asked.seconds or SAILED_S)
        voyage.close()
        speed = voyage.elapsed_s / (time.monotonic() - began_s)
        alone = voyage.elapsed_s / (time.process_time() - worked_s)
    if end.startswith("stopped") or end.endswith("mode idle"):
        raise DelfimError(f"{file}: voyage {turn + 1}, which is the seed of its weather, was not sailed to its end: {end}")
    print(f"delfim: {Path(file).stem}, voyage {turn + 1}: {end}, {speed:.0f} times real time", file=sys.stderr, flush=True)
    return speed, alone
