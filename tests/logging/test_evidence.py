"""The evidence of a voyage: whole, looked at, checked by who gets it, and bad where a log is bad."""

import csv
import json
import os
import shutil
import subprocess
import zipfile
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.__main__ import main
from delfim.base.clock import ManualClock
from delfim.desk.evidence import watches
from delfim.logging.ashore import chaincheck
from delfim.logging.liblog import event_line
from tests.logging.sailing import Day
from tests.logging.test_chain import opened


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs a day apart, and in the second ana, rui, and ana again, of whose orders one is refused."""
    place, clock = tmp_path_factory.mktemp("evidence") / "log", ManualClock(100.0)
    for _ in range(2):
        log = opened(place, clock, "can0")
        log.note(event_line(clock, "start", version="0.1.0", settings={"boat": {"name": "<b>Boat</b>"}}))
        for who, refused in (("ana", ""), ("rui", "not armed"), ("ana", ""), ("rui", ""), ("ana", "")):
            clock.advance(600.0)
            log.put(b"(1262304000.000123) can0 123#1122 R\n")
            log.note(event_line(clock, "command", at_s=0.0, value={"command": "hold"}, refused=refused, operator=who))
        log.note(event_line(clock, "end"))
        log.close()
        for file in sorted(place.iterdir())[-1].glob("*/*"):
            os.utime(file, ns=(clock.time_ns(), clock.time_ns()))
        clock.advance(86_400.0)
    return place


def test_it_holds_the_last_twelve_hours_and_who_commanded_when(logs: Path, tmp_path: Path) -> None:
    assert main(["log", "evidence", str(logs), "--output", str(tmp_path / "out")]) == 0
    days = [path.name for path in (tmp_path / "out/logs").iterdir()]
    assert days == ["20100102"]
    with open(tmp_path / "out/commands.csv", newline="") as file:
        told = [row for row in csv.reader(file) if row[2].startswith("hold")]
    assert [(row[1], row[3]) for row in told] == [
        ("ana", "done"),
        ("rui", "refused: not armed"),
        ("ana", "done"),
        ("rui", "done"),
        ("ana", "done"),
    ]
    page = (tmp_path / "out/index.html").read_text()
    assert "&lt;b&gt;Boat" in page
    assert "<b>Boat" not in page
    assert "no file was changed" in page
    for file in (tmp_path / "out/logs").rglob("*.*"):
        assert file.read_bytes() == (logs / file.relative_to(tmp_path / "out/logs")).read_bytes()


def test_who_gets_it_checks_it_himself(logs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["log", "evidence", str(logs), "--output", str(tmp_path / "day.zip")]) == 0
    with zipfile.ZipFile(tmp_path / "day.zip") as archive:
        archive.extractall(tmp_path)
    subprocess.run(["sha256sum", "--check", "--quiet", "--strict", "SHA256SUMS"], cwd=tmp_path / "day", check=True)
    assert main(["log", "check", str(tmp_path / "day/logs")]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["day", "day.zip"], "nothing else is left"


def test_a_changed_log_makes_bad_evidence(logs: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(logs, tmp_path / "copy")
    for sidecar in copy.rglob("*.meta.jsonl"):
        sidecar.write_bytes(sidecar.read_bytes().replace(b'"rui"', b'"eva"'))
    for file in copy.rglob("*.*"):
        shutil.copystat(logs / file.relative_to(copy), file)
    assert main(["log", "evidence", str(copy), "--output", str(tmp_path / "out")]) == 1
    assert "are not as they were written" in (tmp_path / "out/index.html").read_text()
    assert "CHANGED logs/20100102/can0" in (tmp_path / "out/check.txt").read_text()


def test_another_span(logs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["log", "evidence", str(logs), "--from", "2010-01-01T00:00:00", "--to", "2010-01-01T23:00:00"]
    assert main([*words, "--output", str(tmp_path / "out")]) == 0
    assert [path.name for path in (tmp_path / "out/logs").iterdir()] == ["20100101"]
    assert main([*words, "--output", str(tmp_path / "out")]) == 2
    assert "is there already" in capsys.readouterr().err
    words[4:7:2] = "2011-01-01T00:00:00", "2011-01-01T23:00:00"
    assert main([*words, "--output", str(tmp_path / "none")]) == 2
    assert "nothing was logged from 2011" in capsys.readouterr().err


def test_a_voyage_in_lock_step_has_a_track_and_no_chain(tmp_path: Path) -> None:
    day = Day(tmp_path / "log")
    day.sail(3.0)
    day.end()
    assert main(["log", "evidence", str(tmp_path / "log"), "--output", str(tmp_path / "out")]) == 1
    assert (tmp_path / "out/track.png").read_bytes().startswith(b"\x89PNG")
    told = chaincheck.check([str(tmp_path / "out/logs")], 1 << 62)
    assert {each.found for each in told} == {"no chain"}


@given(st.lists(st.tuples(st.sampled_from(("ana", "rui", "payload:x")), st.booleans(), st.integers(1, 10**12)), max_size=30))
def test_at_each_moment_one_commands_or_nobody(orders: list[tuple[str, bool, int]]) -> None:
    events, t_ns = list[dict[str, Any]](), 10**18
    for who, obeyed, later_ns in orders:
        t_ns += later_ns
        refused = "" if obeyed else "no"
        told = {"event": "command", "value": {"command": "hold"}, "operator": who, "refused": refused}
        events.append(json.loads(json.dumps(told | {"t_ns": t_ns})))
    found = watches(events, t_ns)
    assert all(one.to_ns == other.from_ns and one.who != other.who for one, other in pairwise(found))
    first = next((event for event in events if not event["refused"]), None)
    assert bool(found) == (first is not None)
    if found and first:
        assert (found[0].from_ns, found[-1].to_ns) == (first["t_ns"], t_ns)
