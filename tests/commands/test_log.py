"""`delfim log` as people use it: a sailed minute, the words typed, what is printed and written."""

import gzip
import json
import os
import re
import shutil
from pathlib import Path

import pytest

from delfim.__main__ import main
from delfim.logging.ashore import tree
from delfim.logging.ashore.tree import files
from tests.logging.sailing import sailed


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("log")
    sailed(place).end()
    return place


@pytest.fixture
def log(place, tmp_path, monkeypatch, capsys):
    """`delfim log VERB ...` on that tree; returns what it printed."""
    monkeypatch.chdir(tmp_path)

    def typed(verb: str, *words: str, code: int = 0, path: Path | None = place) -> str:
        assert main(["log", verb, *words, *([str(path)] if path else [])]) == code
        return capsys.readouterr().out

    return typed


def test_ls_names_the_runs(log):
    lines = log("ls").splitlines()
    assert lines[0].split() == ["RUN", "(UTC)", "ID", "FILES", "DURATION", "SIZE", "END"]
    assert [line.split()[:4] for line in lines[1:]] == [
        ["20100101-000000", "lockstep", "1", "0:01:05"],
        ["20100101-000000", "state", "1", "0:01:05"],
    ]
    assert all(line.endswith("clean") for line in lines[1:])
    assert json.loads(log("ls", "--json").splitlines()[1])["end"] == "clean"


def test_cat_prints_state_frames_and_events(log):
    lines = log("cat", "--fields", "cycle,mode,heading").splitlines()
    assert lines[0] == "cycle\tmode\theading"
    assert [int(line.split("\t")[0]) for line in lines[1:]] == list(range(1, len(lines)))
    frames = log("cat", "--id", "lockstep").splitlines()
    assert all(re.fullmatch(r"\(\d{10}\.\d{6}\) lockstep [0-9A-F]+#[0-9A-F]* [RT]", line) for line in frames)
    table = log("cat", "--events").splitlines()
    assert table[0].split() == ["UTC", "WHO", "WHAT", "RESULT"]
    assert re.search(r"^2010-01-01 00:00:\d\d +boat +mode play +local$|^.* mode play ", "\n".join(table), re.MULTILINE)
    assert any(re.match(r"2010-01-01 .* mission text .*  done$", line) for line in table)
    assert "watchdog" not in "".join(table)
    told = [json.loads(line) for line in log("cat", "--events", "--json").splitlines()]
    assert [event["event"] for event in told][:2] == ["start", "start"]
    assert sum(event["event"] == "command" for event in told) == 6


def test_cat_system_prints_what_the_programs_said(log, tmp_path):
    folder = tmp_path / "boat" / "20100101" / "system"
    folder.mkdir(parents=True)
    said = [
        ("info", "runtime: started as process 7"),
        ("error", "runtime: killed \x1b[2J"),
        ("info", "runtime: started as process 9"),
    ]
    lines = [
        {
            "t_ns": 1_262_304_000_000_000_000 + n * 10**9,
            "monotonic_s": 5.0 + n,
            "level": level,
            "pid": 1,
            "service": "supervisor",
        }
        | {"text": text}
        for n, (level, text) in enumerate(said)
    ]
    (folder / "000000.jsonl.gz").write_bytes(gzip.compress("\n".join(map(json.dumps, lines)).encode()))
    boat = tmp_path / "boat"
    assert "20100101-000000  system" in log("ls", path=boat)
    assert log("cat", "system", path=boat).splitlines() == [
        "2010-01-01 00:00:00.000000 info     supervisor[1]: runtime: started as process 7",
        "2010-01-01 00:00:01.000000 error    supervisor[1]: runtime: killed \\x1b[2J",
        "2010-01-01 00:00:02.000000 info     supervisor[1]: runtime: started as process 9",
    ]
    assert len(log("cat", "system", "--level", "warning", path=boat).splitlines()) == 1
    assert len(log("cat", "system", "--from", "+1.5", path=boat).splitlines()) == 1
    assert main(["log", "cat", "system", str(tmp_path)]) == 0, "found below the folder that is named"


def test_ranges_hold_everywhere(log, tmp_path):
    every = log("cat", "--id", "lockstep").splitlines()
    some = log("cat", "--id", "lockstep", "--from", "+10", "--to", "00:00:20").splitlines()
    assert some == [line for line in every if 10.0 <= float(line[1:18]) - 1_262_304_000 <= 20.0]
    assert 200 < len(some) < len(every)
    assert 45 <= len(log("cat", "--from", "+10", "--to", "+20").splitlines()) <= 52
    assert json.loads(log("info", "--json", "--from", "+10", "--to", "+20"))["duration_s"] == pytest.approx(10.0, abs=0.5)
    assert "5" in re.findall(r": (\d+) records", log("export", "csv", "--from", "2010-01-01T00:00:10", "--to", "00:00:11"))
    assert log("ls", "--from", "2011-01-01T00:00:00").count("\n") == 1


def test_info_sums_up(log):
    told = json.loads(log("info", "--json"))
    assert told["boat"] == "DelfimX"
    assert told["track_m"] == pytest.approx(40, abs=25)
    assert list(told["modes_s"]) == ["idle", "play", "heading", "manual"]
    assert told["commands"] == {"play (refused)": 1, "mission": 1, "play": 1, "heading": 1, "manual": 1, "stop": 1}
    assert told["latency"] == {}, "no time passes in lock step"
    assert told["frames"]["lockstep"] > 4000
    assert told["ends"] == {"lockstep": "clean", "state": "clean"}
    text = log("info")
    assert "play refused: no navigation yet" in text
    assert "mode: idle no manual command for 5.0 s" in text


@pytest.mark.parametrize(("form", "begins"), [("png", b"\x89PNG"), pytest.param("svg", b"<?xml", marks=pytest.mark.long)])
def test_plot_draws_every_picture(log, tmp_path, form, begins):
    printed = log("plot", "--format", form).split()
    assert [Path(name).stem for name in printed] == ["track", "speeds", "rpm", "references", "latency"]
    for name in printed:
        assert (tmp_path / name).read_bytes().startswith(begins)
    assert {Path(name).parent.name for name in printed} == {"20100101-000000"}


def test_export_is_named_after_the_run(log, tmp_path):
    assert re.match(r"20100101-000000.gpx: \d+ records, [\d.]+ kB\n", log("export", "gpx"))
    assert re.match(r"box.asc: \d{4} frames", log("export", "asc", "--output", "box.asc"))
    assert (tmp_path / "box.asc").read_text().startswith("date ")


def test_replay_says_that_it_is_bit_exact(log, place, capsys):
    said = re.compile(r"(\d+) cycles repeated, (\d+) propulsion frames compared: all the same, bit by bit\n")
    cycles, every = map(int, said.fullmatch(log("replay")).groups())
    repeated, some = map(int, said.fullmatch(log("replay", "--from", "+20", "--to", "+30")).groups())
    assert repeated == cycles, "the loop remembers"
    assert 150 < some < every / 4
    assert main(["log", "replay", "--from", "+60000", str(place)]) == 2


def test_repair_finds_what_is_cut_and_leaves_the_original(log, place, tmp_path):
    copy = tmp_path / "copy/20100101/lockstep"
    copy.mkdir(parents=True)
    box = next(file for file in files([place]) if file.id == "lockstep")
    data = Path(box.path).read_bytes()[:-100]
    (copy / "000000.log.gz").write_bytes(data)
    os.utime(copy / "000000.log.gz", (0, 0))
    printed = log("repair", path=tmp_path / "copy")
    assert "000000-repaired.log.gz" in printed
    assert printed.endswith("1 files checked, 1 repaired\n")
    assert (copy / "000000.log.gz").read_bytes() == data
    assert log("repair", path=tmp_path / "copy").endswith("1 files checked, 0 repaired\n")


def test_mistakes_are_one_line(log, capsys, tmp_path, place):
    for words, reason in (
        (("info", "--run", "2011"), "no run 2011"),
        (("cat", "--fields", "nonsense"), "no field nonsense; there are monotonic_s"),
        (("cat", "--from", "soon"), "--from 'soon' is not a time"),
        (("cat", "--to", "later"), "--to 'later' is not a time"),
        (("cat", "--from", "2011-01-01T00:00:00"), "nothing was logged in this time; the logs are from 2010-01-01 00:00:00 to"),
        (("cat", "--id", "lockstep", "--from", "+10.01", "--to", "+10.02"), "nothing was logged in this time"),
        (("cat", "--events", "--from", "+30", "--to", "+30.1"), "nothing was logged in this time"),
        (("info", "--from", "2011-01-01T00:00:00"), "nothing was logged in this time"),
        (("info", "--id", "sonar"), "no logs of sonar"),
    ):
        assert main(["log", *words, str(place)]) == 2
        err = capsys.readouterr().err
        assert reason in err
        assert err.count("\n") == 1
    assert main(["log", "ls", str(tmp_path / "no")]) == 2
    assert main(["log", "fetch", "--from", "+90", "ftp://boat/log", str(tmp_path)]) == 2
    assert "count from the beginning of a run, which is not here yet" in capsys.readouterr().err


def test_without_a_path_the_logs_that_are_there_are_taken_and_named(place, tmp_path, monkeypatch, capsys):
    """An empty /log does not hide those of a simulation; of several simulations it is the newest."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "log").mkdir()
    monkeypatch.setattr(tree, "PLACES", (str(tmp_path / "log"), "run/sim*/log"))
    assert main(["log", "ls"]) == 2
    assert "name their folder" in capsys.readouterr().err
    for name in ("sim", "sim-2"):
        shutil.copytree(place, tmp_path / "run" / name / "log")
    for file in (tmp_path / "run/sim-2/log").rglob("*.state*"):
        os.utime(file, (2e9, 2e9))
    assert main(["log", "ls"]) == 0
    assert capsys.readouterr().err == "delfim: the logs of run/sim-2/log\n"
    shutil.copytree(place, tmp_path / "log", dirs_exist_ok=True)
    assert main(["log", "info"]) == 0
    assert capsys.readouterr().err == f"delfim: the logs of {tmp_path}/log\n"


def test_a_tree_is_found_below_the_folder_that_is_named(place, tmp_path, capsys):
    """As `delfim sim --lockstep --output run/mine` leaves it."""
    shutil.copytree(place, tmp_path / "run/mine/lockstep-1")
    for path in ("run/mine", "run"):
        assert main(["log", "info", str(tmp_path / path)]) == 0
        assert "DelfimX" in capsys.readouterr().out


def test_what_is_written_just_now_is_running_everywhere(place, tmp_path, capsys, caplog):
    """Neither reading nor repair takes it for cut; a while later both do."""
    shutil.copytree(place, tmp_path / "log")
    box = next(file for file in files([tmp_path / "log"]) if file.id == "lockstep")
    Path(box.path).write_bytes(Path(box.path).read_bytes()[:-100])
    Path(box.sidecar).unlink()
    words = ["--id", "lockstep", str(tmp_path / "log")]
    assert main(["log", "ls", *words]) == 0
    assert capsys.readouterr().out.splitlines()[1].endswith("running")
    assert main(["log", "cat", *words]) == 0
    assert main(["log", "repair", *words]) == 0
    assert "skipped, it was written less than 5 s ago" in capsys.readouterr().out
    assert not caplog.messages
    os.utime(box.path, (1_262_304_100, 1_262_304_100))
    assert main(["log", "ls", *words]) == 0
    assert capsys.readouterr().out.splitlines()[1].endswith("cut")
    assert main(["log", "cat", *words]) == 0
    assert "delfim log repair puts it right" in caplog.messages[0]
    assert main(["log", "repair", *words]) == 0
    assert capsys.readouterr().out.endswith("1 files checked, 1 repaired\n")
