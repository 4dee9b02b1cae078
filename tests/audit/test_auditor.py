"""The auditor over logs on disk: a sailed minute with its black box, by the command; and runs of a campaign."""

import json
import re
from pathlib import Path

import pytest

from delfim.__main__ import main
from delfim.audit import auditor
from delfim.base.errors import DelfimError
from delfim.campaign import runplan, sailing
from delfim.logging.ashore import tree
from delfim.simulator.scenarios import trial
from tests.logging.sailing import sailed

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("log")
    sailed(place, "log.state_method=write", "can.interface=canloop:lockstep").end()
    return place


def test_a_sailed_day_keeps_all_rules_and_its_frames_are_compared(place, capsys):
    assert main(["log", "audit", str(place)]) == 0
    told = capsys.readouterr().out
    assert re.search(r"^frames-as-records +1 +Each command", told, re.MULTILINE)
    assert re.search(r"^1 runs, 3\d\d cycles$", told, re.MULTILINE)
    assert "not judged in 1 runs: fence-watched: there is no fence" in told
    assert "BROKEN 2" not in told


def test_a_note_that_nobody_wrote_is_found_with_its_time(place, tmp_path, capsys):
    state = tmp_path / "20100101" / "state"
    state.mkdir(parents=True)
    for file in (place / "20100101/state").iterdir():
        text = file.read_bytes()
        if file.name.endswith(".jsonl"):
            its = [line for line in text.splitlines(keepends=True) if json.loads(line)["event"] != "mode"]
            text = b"".join(its)
        (state / file.name).write_bytes(text)
    assert main(["log", "audit", str(tmp_path)]) == 1
    told = capsys.readouterr().out
    assert re.search(
        r"^BROKEN 20100101-000000 2010-01-01 00:00:\d\d \(\d+\.\d s\) modes-agree: the records say", told, re.MULTILINE
    )
    assert "not judged in 1 runs: frames-as-records: there is no black box of lockstep" in told


def test_logs_without_a_state_are_refused_and_an_empty_one_is_not_judged(tmp_path):
    with pytest.raises(DelfimError, match="no state log"):
        auditor.audit([])
    state = tmp_path / "20100101" / "state"
    state.mkdir(parents=True)
    (state / "000000.state").write_bytes(b"")
    (verdict,) = auditor.audit(tree.runs(tree.files([tmp_path]), 0))
    assert verdict.cycles == 0
    assert {each.unjudged for each in verdict.judged} == {"no state was logged in this time"}


def test_a_restart_within_a_log_is_judged_as_two_lives(tmp_path):
    overrides = (f'log.directory="{tmp_path}"', 'log.state_method="write"')
    trial.run_file(ROOT / "etc/scenarios/restarted.toml", ROOT / "etc/delfimx.toml", 1, overrides, logged=True)
    verdicts = auditor.audit(tree.runs(tree.files([tmp_path]), 0))
    assert len(verdicts) == 3
    assert [each.words() for each in verdicts] == [[], [], []]


def test_a_campaign_with_audit_fails_where_its_auditor_finds_something(tmp_path, monkeypatch):
    file = tmp_path / "one.toml"
    text = f'version = 1\nname = "one"\nvehicle = "{ROOT}/etc/delfimx.toml"\nscenario = "mixed"\nseeds = {{ count = 1 }}\n'
    file.write_text(text)
    _, plain = runplan.read(file)
    file.write_text(text + "audit = true\n")
    _, plan = runplan.read(file)
    assert (plain.audit, plan.audit) == (False, True)
    assert plain.digest != plan.digest
    without, row = sailing.one(plain, 0, 0, 1), sailing.one(plan, 0, 0, 1)
    assert row["failures"] == []
    assert row["digest"] == without["digest"]
    monkeypatch.setattr(auditor, "complaints", lambda folder: ["1.0 s: a-rule: broken"])
    row = sailing.one(plan, 0, 0, 1)
    assert (row["ok"], row["failures"]) == (False, ["audit: 1.0 s: a-rule: broken"])


def test_a_stick_that_is_held_is_in_the_log_of_a_scenario_as_often_as_it_speaks(tmp_path):
    overrides = (f'log.directory="{tmp_path}"', 'log.state_method="write"')
    trial.run_file(ROOT / "etc/scenarios/fence-manual.toml", ROOT / "etc/delfimx.toml", 1, overrides, logged=True)
    told = list(tree.events(tree.files([tmp_path])))
    assert sum(each["event"] == "command" and each["value"]["command"] == "manual" for each in told) > 20
