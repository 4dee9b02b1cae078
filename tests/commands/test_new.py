"""`delfim new`: answers by options and on a terminal; each boat that it writes passes the check and sails its mission."""

import contextlib
import io
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from delfim import config
from delfim.__main__ import main
from delfim.base.errors import DelfimError, FormatError
from delfim.commands.description.new import OF_OWN, _shipped, asked_of_parts
from delfim.commands.description.newform import read_form
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle.console import LoadMission, Play
from delfim.vehicle.plans.mission import load_mission
from delfim.vehicle.state import NoLog

MOTORS, SENSORS = map(list, asked_of_parts())


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def formed(folder: Path, answers: object) -> dict[str, Any]:
    (folder / "a.json").write_bytes(msgspec.json.encode(answers))
    return read_form(str(folder / "a.json"))


@pytest.mark.parametrize("boat", ["own", "otter"])
def test_a_form_asks_what_the_command_asks_and_writes_what_it_writes(folder: Path, boat: str, capsys) -> None:
    answers, asked = {"boat": boat}, []
    while "question" in (told := formed(folder, answers)):
        asked.append(told["question"]["option"])
        answers[asked[-1]] = ""
    assert len(set(asked)) == len(asked)
    assert main(["new", "myboat.toml", "--yes", "--boat", boat]) == 0
    assert told["files"] == {name: Path(name).read_text() for name in ("myboat.toml", "myboat-mission.toml")}
    capsys.readouterr()
    main(["check", "myboat.toml"])
    said = capsys.readouterr()
    assert told["checked"] == (said.err + said.out).strip()


def test_what_to_type_next_knows_blanks(capsys) -> None:
    assert main(["new", "my boat.toml", "--yes", "--name", "myboat"]) == 0
    said = capsys.readouterr().out
    assert "  delfim check 'my boat.toml'\n  delfim sim 'my boat.toml' --console\n" in said
    assert main(["parts", "new", "motor", "acme", "--output", "my parts"]) == 0
    assert "  pip install -e 'my parts/delfim-acme'\n" in capsys.readouterr().out


@given(answers=st.dictionaries(st.sampled_from([*OF_OWN, "boat", "name", "id", "where"]), st.text(max_size=40) | st.just("1")))
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_whatever_a_form_answers_the_next_question_or_a_file_comes(folder: Path, answers: dict[str, str]) -> None:
    with contextlib.suppress(DelfimError):  # as where the numbers together make no boat
        told = formed(folder, answers)
        assert "question" in told or "nothing is wrong" in told["checked"]


@pytest.mark.parametrize("answers", [[], {"boat": 1}, {"boat": "x" * 200}, {str(n): "" for n in range(30)}, None])
def test_what_are_no_answers(folder: Path, answers: object) -> None:
    with pytest.raises(FormatError, match="no answers"):
        formed(folder, answers)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("motors", "sensors"), list(product(MOTORS, SENSORS)))
def test_each_boat_passes_the_check_and_sails_past_its_first_waypoint(motors, sensors, capsys):
    assert main(["new", "boat.toml", "--yes", "--motors", motors, "--sensors", sensors]) == 0
    assert main(["check", "boat.toml"]) == 0
    assert "nothing is wrong with this file" in capsys.readouterr().out
    run = Lockstep(config.load("boat.toml"), 1, lambda clock: NoLog())
    assert run.sail(Path("boat-mission.toml").read_text(), 40.0).startswith("time")
    assert run.state.reference.leg >= 1
    run.close()


@pytest.mark.parametrize("boat", _shipped())
def test_each_known_boat_gets_a_name_a_number_a_place_and_a_mission(boat: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--yes", "--boat", boat, "--name", "Lua", "--id", "7", "--where", "52.1", "4.2"]
    assert main(["new", "boat.toml", *words]) == 0
    assert main(["check", "boat.toml"]) == 0
    assert "mission" not in capsys.readouterr().err
    settings = config.load("boat.toml")
    assert (settings.boat.name, settings.boat.id, settings.simulation.latitude_deg) == ("Lua", 7, 52.1)
    assert settings.thrusters == config.load(_shipped()[boat]).thrusters
    run = Lockstep(settings, 1, lambda clock: NoLog())
    assert run.sail(Path("boat-mission.toml").read_text(), 70.0).startswith("time")
    assert run.state.reference.leg >= 1
    run.close()


SMALL = ["--length", "1.2", "--beam", "0.93", "--mass", "30", "--thrust", "60"]


@pytest.mark.parametrize("words", [[], pytest.param(SMALL, marks=pytest.mark.long)])
@pytest.mark.parametrize("motors", MOTORS)
def test_no_boat_sails_much_faster_than_it_is_told(motors: str, words: list[str]) -> None:
    """Whatever the force of its motors: model and autopilot take one speed at full power."""
    assert main(["new", "boat.toml", "--yes", "--motors", motors, *words]) == 0
    run = Lockstep(config.load("boat.toml"), 1, lambda clock: NoLog())
    assert run.command(LoadMission(Path("boat-mission.toml").read_text())) is None
    playing, most_mps = False, 0.0
    for _ in run.cycles(90.0):
        playing = playing or run.command(Play()) is None
        most_mps = max(most_mps, run.nodes.model.surge_mps)
    asked_mps = run.settings.control.speed.cruise_mps
    run.close()
    assert 0.9 * asked_mps < most_mps < 1.15 * asked_mps


def test_options_are_what_the_file_says() -> None:
    words = ["--name", "Lua", "--length", "2", "--beam", "1,1", "--mass", "55", "--thrust", "120", "--motors", "vesc"]
    words += ["--boat", "own", "--id", "9", "--speed", "2.5"]
    assert main(["new", "lua.toml", *words, "--sensors", "nmea2000", "--where", "-33.85", "151.24"]) == 0
    settings = config.load("lua.toml")
    boat = settings.boat
    assert (boat.name, boat.length_m, boat.beam_m, boat.mass_kg, boat.full_mps) == ("Lua", 2.0, 1.1, 55.0, 2.5)
    assert [row.thrust_n[1] for row in settings.thrusters] == [120.0, 120.0]
    assert (settings.vesc.interface, settings.nmea2000.interface) == ("can0", "can1"), "a bus carries one protocol"
    first = load_mission("lua-mission.toml").waypoint[-1]
    assert (first.latitude_deg, first.longitude_deg) == (-33.85, 151.24)


def test_a_board_gives_motors_and_is_the_usual_sensor_then() -> None:
    assert main(["new", "pix.toml", "--yes", "--motors", "ardupilot"]) == 0
    settings = config.load("pix.toml")
    assert (settings.drivers, settings.navigation.sources) == (("mavlink_front_seat",), ("mavlink_front_seat",))
    assert Path("pix.toml").read_text().count("[mavlink_front_seat]") == 1
    assert main(["new", "own.toml", "--yes", "--motors", "esc", "--sensors", "ardupilot"]) == 0
    settings = config.load("own.toml")
    assert (settings.drivers, settings.navigation.sources) == (("pwm",), ("mavlink_front_seat",))


def test_on_a_terminal_it_asks_and_asks_again_for_what_is_wrong(monkeypatch, capsys):
    answers = ["raft", "", "my boat", "MyBoat", "250", "5", "two", "2.5", "", "", "oars", "rudder", "", "", "", "52.1, 4.2"]
    monkeypatch.setattr("sys.stdin", Terminal("\n".join(answers) + "\n"))
    assert main(["new", "boat.toml"]) == 0
    out = capsys.readouterr().out
    for told in (
        "there are own, bait-boat",
        "blueboat   BlueBoat of",
        "a whole number from 1",
        "a name is a letter",
        "this must be a number above 0",
        "there are esc, ardupilot",
        "usb        a GPS mouse",
    ):
        assert told in out
    settings = config.load("boat.toml")
    assert (settings.boat.name, settings.boat.length_m, settings.boat.beam_m) == ("MyBoat", 2.5, 1.25)
    assert settings.boat.id == 5
    assert settings.thrusters[0].steer is not None
    assert settings.simulation.latitude_deg == 52.1


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--yes", "--motors", "oars"], "--motors oars: there are esc, ardupilot, dronecan, rudder, torqeedo, torqlink, vesc"),
        (["--yes", "--length", "-1"], "--length -1: this must be a number above 0"),
        (["--yes", "--mass", "2e6"], "nothing was written: boat.mass_kg: 2000000.0 is not allowed"),
        (
            ["--yes", "--where", "91", "0"],
            "--where 91 0: a latitude goes from -85 to 85 here, and a longitude from -180 to 180",
        ),
        ([], "nobody is here to ask: give --boat, or --yes for all defaults"),
        (["--yes", "--boat", "raft"], "--boat raft: there are own, bait-boat, blueboat, float, heron, otter, skiff, wam-v"),
        (
            ["--yes", "--boat", "otter", "--motors", "esc"],
            "--motors: otter has its own; leave this away, and change the file afterwards",
        ),
        (["--yes", "--id", "250"], "--id 250: this must be a whole number from 1 to 249"),
    ],
)
def test_what_cannot_be_is_refused_in_a_line_and_nothing_is_written(words, told, folder, monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", io.StringIO())
    assert main(["new", "boat.toml", *words]) == 2
    assert capsys.readouterr().err == f"delfim: {told}\n"
    assert list(folder.iterdir()) == []


def test_no_file_is_replaced(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "boat-mission.toml").write_text("mine")
    assert main(["new", "boat.toml", "--yes"]) == 2
    assert capsys.readouterr().err == "delfim: boat-mission.toml exists already, and nothing is replaced: name another file\n"
    assert not (folder / "boat.toml").exists()
    assert (folder / "boat-mission.toml").read_text() == "mine"
