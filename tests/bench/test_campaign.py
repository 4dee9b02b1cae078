"""The scheduler that the benchmark of campaigns simulates, and the benchmark itself."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from bench import campaign
from delfim.campaign.runplan import Seeds, read

ROOT = Path(__file__).parents[2]
FILE = ROOT / campaign.FILE


def test_workers_that_nobody_waits_for_are_always_in_runs():
    _, plan = read(FILE)
    parts = [campaign._simulated(plan, [0.1], workers, 0.0, 0.0) for workers in (1, 2, 64)]
    assert parts[0] == pytest.approx(1.0)
    assert all(part > 0.99 for part in parts)


def test_one_process_that_hands_out_serves_no_more_workers_than_it_has_time_for():
    """A batch of 20 runs of 0.1 s is two seconds of work: who needs half a second for each serves four workers."""
    _, plan = read(FILE)
    four, eight = (campaign._simulated(plan, [0.1], workers, 0.5, 0.0) for workers in (4, 8))
    assert eight == pytest.approx(four / 2, rel=0.02)


def test_the_start_costs_every_worker():
    _, plan = read(FILE)
    all_s = campaign.SIMULATED * 0.1 / 4
    assert campaign._simulated(plan, [0.1], 4, 0.0, all_s) == pytest.approx(0.5, rel=0.01)


def test_the_rows_of_the_stand_in_are_written_as_those_of_runs(tmp_path):
    _, plan = read(FILE)
    few = plan._replace(seeds=Seeds(0, 300))
    given = ((batch.number, campaign.stand_in(few, batch, "none")) for batch in few.batches(20))
    handing = campaign._handing(given, few)
    assert handing.batch_s > 0.0
    assert len(handing.memory_mb) == 10


@pytest.mark.long
def test_it_runs(tmp_path):
    """In a process of its own: Dask warns of what is no concern here."""
    command = (sys.executable, "-m", "bench", "campaign", "--quick", "--output", tmp_path)
    settings = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=settings, timeout=110)
    assert done.returncode == 0, done.stderr
    results = json.loads((tmp_path / "campaign.json").read_text())
    assert results["boat_years_a_day"]["16 cores"] > 0.0
    assert "parallel efficiency from 1 to" in done.stdout
