"""`python -m bench campaign`: what a campaign spends beside its runs, on this machine and, simulated, with up to 64 workers.

Mixed faults are sailed by one worker and by one for each core, in turns. What counts is processor time, because others use
the machine: what a run takes, and what the process that hands out and writes takes for a batch. For that, and for the memory of
a million runs, a stand-in returns rows without sailing.
"""

import argparse
import heapq
import importlib.util
import json
import os
import resource
import statistics
import tempfile
import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from random import Random
from typing import Any, Final, NamedTuple

from delfim.campaign.measures import MEASURES
from delfim.campaign.runplan import Batch, Plan, Seeds, read
from delfim.campaign.sailing import VERSION
from delfim.campaign.store import Store
from delfim.campaign.workers import AHEAD, Rows, by_cluster, by_processes

FILE: Final = "etc/campaigns/mixed.toml"
BATCH: Final = 20
WORKERS: Final = (1, 2, 4, 8, 16, 32, 64)
RUNS, QUICK_RUNS = 100, 4  # of a turn
MANY, QUICK_MANY = 1_000_000, 2_000  # of the stand-in
SIMULATED: Final = 20_000  # runs of the simulated campaign
YEARS_A_DAY: Final = 1.0 / 365.25
_WORDS: Final = {"VARCHAR": "mission done in 368 s", "INTEGER": 3, "DOUBLE": 1.25}


class Turn(NamedTuple):
    """Some runs by some workers."""

    run_s: list[float]  # processor time of each
    sailed_s: float  # of all
    share: float  # of the workers' time that they were in runs, the start left out
    start_s: float  # until all workers have answered


class Handing(NamedTuple):
    """Many runs of the stand-in."""

    batch_s: float  # processor time of this process for a batch: handing out, taking in, writing
    memory_mb: list[float]  # resident, after each tenth


def stand_in(plan: Plan, batch: Batch, version: str) -> Rows:
    """Rows of the usual size, without sailing."""
    row = {"batch": batch.number, "vehicle": "delfimx", "story": "mixed", "ok": True, "failures": [], "error": ""}
    row |= {measure.name: _WORDS[measure.kind] for measure in MEASURES}
    row |= {"wall_s": 0.1, "cpu_s": 0.1, "host": "bench", "pid": os.getpid(), "version": version}
    return [row | {"point": point, "seed": seed} for point, seed in batch.runs]


def run(asked: argparse.Namespace) -> int:
    """The command. Returns 0 when it was measured, whatever came out."""
    _, plan = read(FILE)
    cores, count = len(os.sched_getaffinity(0)), QUICK_RUNS if asked.quick else RUNS
    turns: dict[int, list[Turn]] = {1: [], cores: []}
    for number in range(asked.rounds or (1 if asked.quick else 3)):
        for workers, of in turns.items():
            of.append(_turn(plan._replace(seeds=Seeds(number * count, count)), workers))
    run_s = [each for turn in turns[cores] for each in turn.run_s]
    many = plan._replace(seeds=Seeds(0, QUICK_MANY if asked.quick else MANY))
    ways = {"processes": _handing(by_processes(many, many.batches(BATCH), cores, stand_in), many)}
    if importlib.util.find_spec("distributed"):
        with _cluster(cores) as address:
            ways["Dask"] = _handing(by_cluster(many, many.batches(BATCH), address, stand_in), many)
    one, all_ = (statistics.median(statistics.fmean(turn.run_s) for turn in turns[workers]) for workers in (1, cores))
    share = min(1.0, statistics.median(turn.share for turn in turns[cores]))
    speed = sum(turn.sailed_s for turn in turns[cores]) / sum(run_s)
    start_s = min(turn.start_s for turn in turns[cores])
    rows = {way: {n: _simulated(plan, run_s, n, handing.batch_s, start_s) for n in WORKERS} for way, handing in ways.items()}
    years = speed * YEARS_A_DAY
    results: dict[str, Any] = {
        "run_cpu_s": {"1": one, str(cores): all_},
        "share_in_runs": share,
        "efficiency": one / all_ * share,
        "start_s": start_s,
        "times_real_time": speed,
        "boat_years_a_day": {"core": years, "16 cores": 16 * years * rows["processes"][16]},
        "batch_s": {way: handing.batch_s for way, handing in ways.items()},
        "simulated_efficiency": rows,
        "memory_mb": {way: handing.memory_mb for way, handing in ways.items()},
    }
    _tell(results, cores, many.runs)
    output = Path(asked.output)
    output.mkdir(parents=True, exist_ok=True)
    (output / "campaign.json").write_text(json.dumps(results, indent=1) + "\n")
    print(f"{output}/campaign.json")
    return 0


def _turn(plan: Plan, workers: int) -> Turn:
    began_s = time.monotonic()
    for _ in by_processes(plan, [Batch(n, ()) for n in range(workers)], workers, stand_in):
        pass
    start_s = time.monotonic() - began_s
    rows = [row for _, some in by_processes(plan, plan.batches(BATCH), workers) for row in some]
    in_runs_s = sum(row["wall_s"] for row in rows)
    share = in_runs_s / (workers * (time.monotonic() - began_s - 2.0 * start_s))
    return Turn([row["cpu_s"] for row in rows], sum(row.get("sailed_s") or 0.0 for row in rows), share, start_s)


def _handing(batches: Generator[tuple[int, Rows], None, None], plan: Plan) -> Handing:
    memory, began_s, count = list[float](), time.process_time(), 0
    with tempfile.TemporaryDirectory(prefix="delfim-bench-") as place:
        store = Store(Path(place), plan, BATCH, VERSION)
        for number, rows in batches:
            store.add(number, rows)
            count += 1
            if store.runs >= (len(memory) + 1) * plan.runs / 10:
                memory.append(_resident_mb())
        store.flush()
    return Handing((time.process_time() - began_s) / count, memory)


@contextmanager
def _cluster(workers: int) -> Iterator[str]:
    """The address of a Dask cluster whose scheduler is in this process."""
    dask: Any = import_module("distributed")
    with dask.LocalCluster(
        n_workers=workers, threads_per_worker=1, dashboard_address="127.0.0.1:0", host="127.0.0.1", silence_logs=50
    ) as cluster:
        yield cluster.scheduler_address


def _simulated(plan: Plan, run_s: list[float], workers: int, batch_s: float, start_s: float) -> float:
    """The part of their time that so many workers are in runs. One process hands out and takes in, and takes `batch_s` for
    each; a worker takes the next batch as soon as it has ended one."""
    random, server_s, sailed_s, end_s = Random(1), 0.0, 0.0, 0.0
    free, ended = [start_s] * workers, list[float]()
    long = plan._replace(seeds=Seeds(0, SIMULATED))
    for at, batch in enumerate(long.batches(BATCH)):
        if at >= AHEAD * workers:
            server_s = max(server_s, heapq.heappop(ended))
        server_s += batch_s
        takes_s = sum(random.choices(run_s, k=len(batch.runs)))
        end_s = max(heapq.heappop(free), server_s) + takes_s
        heapq.heappush(free, end_s)
        heapq.heappush(ended, end_s)
        sailed_s += takes_s
    return sailed_s / (workers * max(free))


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def _tell(results: dict[str, Any], cores: int, many: int) -> None:
    took, years = results["run_cpu_s"], results["boat_years_a_day"]
    alone_ms, all_ms = took["1"] * 1e3, took[str(cores)] * 1e3
    print(f"a run of mixed faults takes {alone_ms:.0f} ms of a processor alone, {all_ms:.0f} on all {cores}")
    in_runs = f"workers are in runs {results['share_in_runs']:.1%} of the time after {results['start_s']:.1f} s of start"
    print(f"{in_runs}: parallel efficiency from 1 to {cores} {results['efficiency']:.1%}")
    print(f"{results['times_real_time']:.0f} times real time a core, {years['core']:.2f} boat-years a day")
    for way, of in results["simulated_efficiency"].items():
        told = ", ".join(f"{workers}: {part:.1%}" for workers, part in of.items())
        print(f"{way}: {results['batch_s'][way] * 1e3:.2f} ms a batch of {BATCH}; simulated, {SIMULATED} runs, workers {told}")
        memory = " ".join(f"{mb:.0f}" for mb in results["memory_mb"][way])
        print(f"{way}: memory over {many} runs that are not sailed, MB: {memory}")
    print(f"16 such cores by processes: {years['16 cores']:.0f} boat-years a day")
