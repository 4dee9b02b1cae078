"""`python -m bench sim`: how many times faster than the clock one core sails a mission in lock step, its state log written."""

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
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


def run(asked: argparse.Namespace) -> int:
    """The command. Returns 0 when it was measured, whatever came out."""
    settings = config.load(asked.file, asked.set)
    if not settings.of(Simulation).mission:
        raise ConfigError(asked.file, "simulation.mission", "missing: there is nothing to sail")
    mission = canonical(load_mission(str(Path(asked.file).parent / settings.of(Simulation).mission)))
    cpus = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cpus)})
    try:
        count = asked.rounds or (QUICK_REPETITIONS if asked.quick else REPETITIONS)
        speeds = [_speeds(asked, mission, turn, count) for turn in range(count)]
    finally:
        os.sched_setaffinity(0, cpus)
    clock, processor = ({"min": min(of), "median": statistics.median(of), "max": max(of)} for of in zip(*speeds, strict=True))
    results = {"repetitions": count, "times_real_time": clock, "times_processor_time": processor, "contract": CONTRACT}
    output = Path(asked.output)
    output.mkdir(parents=True, exist_ok=True)
    (output / "sim.json").write_text(json.dumps(results, indent=1) + "\n")
    for what, times in ("by the clock", clock), ("by processor time, whoever else uses the machine", processor):
        told = ", ".join(f"{name} {value:.0f}" for name, value in times.items())
        print(f"lock step on one core, {count} voyages, {what}: {told} times real time (contract: {CONTRACT:.0f})")
    print(f"{output}/sim.json")
    return 0


def _speeds(asked: argparse.Namespace, mission: str, turn: int, count: int) -> tuple[float, float]:
    """One voyage, in seconds sailed a second of the clock, and of the processor."""
    with tempfile.TemporaryDirectory(prefix="delfim-bench-") as place:
        settings = config.load(asked.file, [*asked.set, f'log.directory="{place}"', 'log.state_method="write"'])
        began_s, worked_s = time.monotonic(), time.process_time()
        voyage = Lockstep(settings, turn + 1, lambda clock: Logbook(settings, clock))
        end = voyage.sail(mission, asked.seconds or SAILED_S)
        voyage.close()
        speed = voyage.elapsed_s / (time.monotonic() - began_s)
        alone = voyage.elapsed_s / (time.process_time() - worked_s)
    if end.startswith("stopped") or end.endswith("mode idle"):
        raise DelfimError(f"voyage {turn + 1}, which is the seed of its weather, was not sailed to its end: {end}")
    print(f"delfim: voyage {turn + 1} of {count}: {end}, {speed:.0f} times real time", file=sys.stderr, flush=True)
    return speed, alone
