"""A run that failed is shrunken to what it takes, and the rest is a scenario that fails in the same words."""

import re
import shlex
from pathlib import Path

import pytest

from delfim.__main__ import main
from delfim.base.errors import DelfimError
from delfim.campaign import report, runner, shrinking
from delfim.campaign.runplan import Plan, read
from delfim.campaign.sailing import Drawn, drawn_run
from delfim.campaign.store import Store
from delfim.simulator.invariants.onlooker import Onlooker
from delfim.simulator.scenarios.trial import run_file
from tests.campaign.test_runplan import written

SEED = 4  # its scenario has several faults and orders


@pytest.fixture
def plan(tmp_path):
    return read(written(tmp_path, 'scenario = "mixed"', f"seeds = {{ first = {SEED}, count = 1 }}"))[1]


def test_what_does_not_matter_is_left_out_and_the_end_is_near(plan):
    """The boat "fails" with two faults and an order, if it is sailed for 40 s."""
    drawn, told = drawn_run(plan, 0, SEED), list[str]()
    faults, orders = drawn.scenario.fault, drawn.scenario.command
    needs = {*faults[:2]}

    def failures(now: Drawn) -> list[str]:
        its = now.scenario
        fails = needs <= {*its.fault} and orders[-1] in its.command and its.seconds >= 40.0
        return ["another thing", f"wrong at {its.seconds:.1f} s"][fails:] if fails else ["another thing"]

    assert len(faults) > 2
    assert len(orders) > 2
    shrunk = shrinking.shrink(drawn, lambda now: failures(now)[-1:], told.append)
    its = shrunk.drawn.scenario
    assert ({*its.fault}, its.command, its.vehicle, its.guest) == (needs, orders[-1:], {}, None)
    assert 40.0 <= its.seconds <= 41.0
    assert shrunk.words == f"wrong at {drawn.scenario.seconds:.1f} s"
    assert shrunk.runs < 100


def test_it_gives_up_after_so_many_runs_and_tells_those_who_wait(plan, monkeypatch):
    clock, told = iter(range(0, 10**6, 3)), list[str]()
    monkeypatch.setattr(shrinking.time, "monotonic", lambda: next(clock))
    shrunk = shrinking.shrink(drawn_run(plan, 0, SEED), lambda now: ["wrong"], told.append, most=5)
    assert shrunk.runs == 5
    assert told[0].startswith("shrinking: 2 of at most 5 runs, ")
    with pytest.raises(DelfimError, match="does not fail"):
        shrinking.shrink(drawn_run(plan, 0, SEED), lambda now: [], told.append)


def test_a_campaign_shrinks_what_failed_by_itself_and_ends_whatever_comes_of_it(tmp_path, monkeypatch, capsys):
    file, plan = read(written(tmp_path, 'scenario = "mixed"', f"seeds = {{ first = {SEED}, count = 2 }}"))
    asked = list[tuple[int, int]]()

    def run(plan: Plan, folder: Path, point: int, seed: int) -> int:
        asked.append((point, seed))
        raise DelfimError("this run does not fail")

    monkeypatch.setattr(shrinking, "run", run)
    monkeypatch.setattr(report, "write", lambda *given: "report.html")
    told = {"batch": 0, "point": 0, "ok": False, "failures": ["wrong at 3.0 s"], "error": ""}
    rows = [told | {"seed": SEED}, told | {"seed": SEED + 1, "failures": [], "error": "TooLong: not over after 300 s"}]
    store = Store(tmp_path / "out", plan, 2, "")
    store.add(0, rows)
    store.flush()
    assert runner.tell(file, plan, tmp_path / "out", "delfim campaign", None) == 0
    assert asked == [(0, SEED)], "not one that takes too long"
    assert "  not shrunken: this run does not fail\n" in capsys.readouterr().out


def test_a_boat_that_is_wrong_on_purpose_is_shrunken_by_its_campaign_to_a_command_that_repeats_it(
    tmp_path, monkeypatch, capsys
):
    """As if it were wrong to hang a disk: the campaign prints the command, which fails in the same words."""
    whole = Onlooker.look

    def look(watch: Onlooker) -> None:
        whole(watch)
        if "disk_slow" in watch._run.faults.on:
            watch._fail("wrong on purpose")

    monkeypatch.setattr(Onlooker, "look", look)
    path = written(tmp_path, 'scenario = "mixed"', f"seeds = {{ first = {DISK}, count = 1 }}", "[draw]", WIND)
    assert main(["campaign", str(path), "--output", str(tmp_path / "out"), "--shrink", f"0:{DISK}"]) == 0
    told = capsys.readouterr().out
    assert re.search(
        r"wrong on purpose at .* s \(operator\): shrunken to 1 of 4 faults, 1 of \d commands, \d of 75 s in \d+ runs", told
    )
    boat, _, file, _, seed = shlex.split(told.rpartition("again: delfim sim ")[2])
    assert "\npatient = false\n" in Path(file).read_text()
    (words,) = run_file(file, boat, int(seed)).failures
    assert words.startswith("wrong on purpose at ")


WIND = '"simulation.sea.wind_mps" = { uniform = [1.0, 2.0] }'
DISK = 24  # a seed with a disk that hangs, and three other faults
