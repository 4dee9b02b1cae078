"""`delfim adopt`: a whole trial of a drawn boat from the command line, and what it refuses."""

import io
from pathlib import Path

import pytest

from delfim import config
from delfim.__main__ import main
from delfim.adoption.trial import concluding
from delfim.adoption.twin import gains

ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "etc/boats/heron.toml").read_text()
    Path("heron.toml").write_text(f"{text}\n[adopted]\nproven = false\n")
    return tmp_path


@pytest.fixture
def few_gains(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the candidates some, in this process: all of them, in one of their own, are tried in tests/adoption/test_linked.py."""
    monkeypatch.setattr(gains, "SAILED", 1)
    monkeypatch.setattr(gains, "LOOKS_S", ())
    monkeypatch.setattr(concluding, "in_child", lambda work, *values, tell: work(*values, tell))


@pytest.mark.usefixtures("few_gains")
def test_a_drawn_boat_is_tried_and_what_was_found_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["adopt", "heron.toml", "--sim", "6", "--yes"]) == 0
    out = capsys.readouterr().out
    truth = out.splitlines()[0]
    assert ("exchanged" in truth) is ("The motors of port and starboard are exchanged." in out)
    for name in ("starboard", "port"):
        assert (name in truth) is (f"The motor that {name} reaches is reversed." in out)
    assert "Motors off: what wind, current and noise do." in out
    assert "The motors are proven." in out
    assert "adopted.proven = true" in out
    assert "speed at full power" in out
    assert "gains: " in out
    assert out.splitlines()[-1] == "Proven: she does as her twin foretold, or better."
    assert Path("adopt/heron-6.trial").is_file()
    assert "Gains, tried on the twin" in Path("adopt/heron-6.html").read_text()
    assert "proven = false" in Path("heron.toml").read_text(), "a drawn boat is written into a copy"
    assert config.load("adopt/heron-6.toml").control.heading.p_nm_per_rad
    assert main(["adopt", "heron.toml", "--sim", "6", "--yes"]) == 0
    again = capsys.readouterr().out.splitlines()
    assert len(again) == 1
    assert again[0].startswith("Adopted already, on 20")


def test_a_file_that_came_with_delfim_is_tried_on_a_drawn_boat_alone(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    assert main(["adopt", "etc/boats/heron.toml", "--sim", "6"]) == 1
    assert capsys.readouterr().out.startswith("A boat is drawn: ")
    assert main(["adopt", "etc/boats/heron.toml"]) == 2
    assert "No such file" in capsys.readouterr().err, "in the wrong folder a boat would sail by an example"


def test_who_says_no_starts_nothing(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    assert main(["adopt", "heron.toml", "--sim", "6"]) == 1
    assert "Each motor" not in capsys.readouterr().out


def test_the_copy_for_a_drawn_boat_finds_the_mission_from_its_own_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    assert main(["adopt", str(ROOT / "etc/boats/heron.toml"), "--sim", "6"]) == 1
    copy = "adopt/heron-6.toml"
    assert config.mission_place(copy, config.load(copy)).samefile(ROOT / "etc/missions/doca.toml")


def test_at_the_berth_each_motor_turns_and_nothing_else(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["adopt", "heron.toml", "--sim", "6", "--berth", "--yes"]) == 0
    assert "The motors turn and stop." in capsys.readouterr().out
    assert not Path("adopt").exists()


def test_boats_that_cannot_be_adopted_and_circles_that_make_no_sense_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    askew = (ROOT / "etc/boats/float.toml").read_text().replace("angle_deg = -45.0", "angle_deg = 45.0", 1)
    Path("askew.toml").write_text(askew)
    assert main(["adopt", "askew.toml", "--sim", "1"]) == 2
    told = capsys.readouterr().err
    assert "this boat cannot be adopted: bow_starboard hardly turns the boat by itself" in told
    assert "try each motor by hand (docs/bench.md), and write [adopted] proven = true" in told
    with pytest.raises(SystemExit):
        main(["adopt", "heron.toml", "--radius", "300"])
    assert "300 is not a number of metres from 15 to 160" in capsys.readouterr().err


def test_a_drawn_boat_of_four_thrusters_has_her_motors_found_and_written(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["adopt", str(ROOT / "etc/boats/float.toml"), "--sim", "7", "--yes"]) == 0
    out = capsys.readouterr().out
    assert "will drive by herself for about 3 minutes" in out
    assert "The motor that bow_starboard reaches is reversed." in out
    assert "Hull, compass and gains stay as they are: her thrusters push across" in out
    written = config.load("adopt/float-7.toml")
    assert [row.reversed for row in written.thrusters] == [True, False, False, False]
    assert written.adopted.proven


def test_without_a_boat_that_runs_it_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["adopt", "heron.toml", "--yes", "--set", 'console.socket="/nowhere/command"']) == 2
    assert "no vehicle at /nowhere/command" in capsys.readouterr().err
