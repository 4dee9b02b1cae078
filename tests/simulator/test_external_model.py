"""A model in another program: the example of the documentation sails the boat, and its silence is the sensors' silence."""

import contextlib
import json
import math
import os
import re
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from delfim import config
from delfim.base.errors import DelfimError
from delfim.simulator.model import Hull
from delfim.simulator.nodes import nodes_of
from delfim.simulator.nodes.navigation import NavigationNode, Noise
from delfim.simulator.realtime.external_model import ANSWER_S, ExternalModel, SteppedModel

ROOT = Path(__file__).parents[2]
EXAMPLES = dict(re.findall(r"```(python|octave)\n(.*?)```", (ROOT / "docs/external-model.md").read_text(), re.DOTALL))
PROGRAMS = {"python": [sys.executable, "-c"], "octave": ["octave-cli", "--no-init-file", "--eval"]}
STILL = {"north_m": 0.0, "east_m": 0.0, "heading_rad": 0.0, "north_mps": 0.0, "east_mps": 0.0}


@pytest.fixture
def pair():
    """The model and the other program's end."""
    model = ExternalModel(Hull(), "127.0.0.1:0", 0.67, -0.16)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.settimeout(200.0)
        other.connect(model._socket.getsockname())
        yield model, other
    model._socket.close()


def test_what_is_told_is_where_the_boat_is_and_the_answer_is_what_the_propellers_do(pair):
    model, other = pair
    model.command("starboard", 600.0, True)
    model.advance(5.0)
    other.send(json.dumps(STILL | {"north_m": 10.0, "east_m": -5.0, "heading_rad": 7.0, "east_mps": 1.5}).encode())
    model.listen()
    model.settle()
    answer = json.loads(other.recv(2048))
    assert answer["starboard_rpm"] == pytest.approx(600.0, rel=0.05)
    assert (answer["port_rpm"], answer["starboard_command_rpm"]) == (0.0, 600.0)
    assert (model.north_m, model.east_m) == (10.0, -5.0)
    assert model.heading_rad == pytest.approx(7.0 - math.tau)
    assert (model.north_mps, model.east_mps) == (pytest.approx(0.0, abs=1e-9), pytest.approx(1.5))


def test_other_thrusters_are_told_by_name_as_part_of_full_command_with_their_angle():
    row = config.ThrusterTable(name="motor", driver="dsor", thrust_n=(-50.0, 100.0), steer=config.Steer(kind="azimuth"))
    msgspec.structs.force_setattr(row, "driver", "vesc")
    model = ExternalModel(Hull(), "127.0.0.1:0", 0.67, -0.16, (row,))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other, contextlib.closing(model._socket):
        other.settimeout(200.0)
        other.connect(model._socket.getsockname())
        model.push("motor", 0.5, -0.2)
        model.advance(10.0)
        other.send(json.dumps(STILL).encode())
        model.listen()
        model.push("motor", -0.25, 0.1)
        (told,) = json.loads(other.recv(2048))["thrusters"].values()
    assert told["part"] == pytest.approx(0.5)
    assert (told["command"], told["command_deg"]) == pytest.approx((-0.25, math.degrees(0.1)))
    assert told["angle_deg"] == pytest.approx(math.degrees(-0.2))


@pytest.mark.parametrize("words", [b"", b"{}", b"[1]", b"\xff", json.dumps(STILL | {"north_m": 1e300}).encode()])
def test_what_means_nothing_is_counted_and_changes_nothing(pair, words):
    model, other = pair
    other.send(words)
    model.listen()
    assert model.malformed == 1
    assert not model.alive


def test_its_silence_is_the_silence_of_the_sensors(pair):
    model, other = pair
    node = NavigationNode(model, 5.0, Noise(0.0, 0.0, 0.0), 1)
    assert node.step(0.0, 0) == []
    assert node.due_s == math.inf, "nothing to wait for but a state"
    other.send(json.dumps(STILL).encode())
    model.listen()
    assert node.step(0.2, 0)
    assert node.step(0.4, 0) == []


def test_the_state_that_navigation_is_made_from_is_answered_when_both_propellers_are_commanded(pair):
    model, other = pair
    other.settimeout(0.0)
    node = NavigationNode(model, 5.0, Noise(0.0, 0.0, 0.0), 1)
    other.send(json.dumps(STILL).encode())
    model.listen()
    assert node.step(0.0, 0)
    model.settle()
    model.command("port", 300.0, True)
    with pytest.raises(BlockingIOError):
        other.recv(2048)
    model.command("starboard", 200.0, True)
    answer = json.loads(other.recv(2048))
    assert (answer["port_command_rpm"], answer["starboard_command_rpm"]) == (300.0, 200.0)
    other.send(json.dumps(STILL).encode())
    model.listen()
    assert node.step(0.1, 0) == [], "navigation is not due"
    model.settle()
    assert json.loads(other.recv(2048)) == answer


def test_a_state_is_answered_soon_even_if_the_vehicle_commands_nothing(pair):
    model, other = pair
    node = NavigationNode(model, 5.0, Noise(0.0, 0.0, 0.0), 1)
    other.send(json.dumps(STILL).encode())
    model.listen()
    assert node.step(0.0, 0)
    model.settle()
    model.advance(2 * ANSWER_S)
    assert json.loads(other.recv(2048))["time_s"] == 2 * ANSWER_S


def test_without_noise_the_sensors_measure_the_state_itself():
    settings = config.load(ROOT / "etc/delfimx.toml", ["simulation.noise=false", "simulation.heading_deg=90.0"])
    nodes = nodes_of(settings, 1)
    measured, model = nodes.navigation.measured(0), nodes.model
    assert (measured.latitude_rad, measured.longitude_rad) == (model.latitude_rad, model.longitude_rad)
    assert (measured.north_mps, measured.east_mps) == (model.north_mps, model.east_mps)
    assert (measured.heading_rad, measured.yaw_rate_radps) == (math.pi / 2, 0.0)


def test_in_lock_step_states_of_another_time_are_left_out_and_silence_ends_the_run(monkeypatch):
    monkeypatch.setattr("delfim.simulator.realtime.external_model.STEP_S", 0.05)
    model = SteppedModel(Hull(), "127.0.0.1:0", 0.67, -0.16)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.connect(model._socket.getsockname())
        for north_m, time_s in ((9.0, 71.0), (9.0, 71.0)):  # of the run before
            other.send(json.dumps(STILL | {"north_m": north_m, "time_s": time_s}).encode())
        with pytest.raises(DelfimError, match=r'"time_s": 0\.000 came'):
            model.begin()
        assert json.loads(other.recv(2048))["next_s"] == 0.0
        for north_m, time_s in ((1.0, 0.0), (1.0, 0.0), (2.0, 0.2), (3.0, 0.4)):
            other.send(json.dumps(STILL | {"north_m": north_m, "time_s": time_s}).encode())
        model._wait(0.05, 0.0)
        model.command("port", 500.0, True)
        model.advance(0.2)
        answer = json.loads(other.recv(2048))
        assert (answer["next_s"], answer["port_command_rpm"], model.north_m) == (0.2, 500.0, 2.0)
        assert 0.0 < answer["port_rpm"] < 500.0
        model.advance(0.2)
        assert model.north_m == 3.0
        with pytest.raises(DelfimError, match=r"0\.600 came"):
            model.advance(0.2)
    model._socket.close()


def test_an_address_that_is_taken_is_told(pair):
    taken = f"127.0.0.1:{pair[0]._socket.getsockname()[1]}"
    with pytest.raises(DelfimError, match=r"simulation\.external"):
        ExternalModel(Hull(), taken, 0.67, -0.16)


no_octave = pytest.mark.skipif(not shutil.which("octave-cli"), reason="needs GNU Octave")
in_both_languages = pytest.mark.parametrize(
    "language",
    ["python", pytest.param("octave", marks=[pytest.mark.long, no_octave])],
)


@contextlib.contextmanager
def modelled(language: str) -> Iterator[str]:
    """The address that the example of this language sends to while it runs."""
    there = f"127.0.0.1:{40_000 + os.getpid() % 20_000}"
    example = subprocess.Popen([*PROGRAMS[language], EXAMPLES[language].replace("4800", there.rpartition(":")[2])])
    try:
        yield there
    finally:
        example.kill()
        example.wait()


@in_both_languages
@pytest.mark.long
def test_in_lock_step_the_example_sails_the_same_run_twice_byte_for_byte(language, tmp_path):
    runs = []
    with modelled(language) as there:
        command = [sys.executable, "-m", "delfim", "sim", str(ROOT / "etc/delfimx.toml"), "--lockstep", "--for", "30"]
        for name in ("one", "two"):
            words = ["--output", str(tmp_path / name), "--set", f'simulation.external="{there}"']
            done = subprocess.run([*command, *words], capture_output=True, text=True, timeout=50)
            assert done.returncode == 0, done.stderr
            (log,) = tmp_path.glob(f"{name}/lockstep-1/*/state/*.state")
            runs.append(log.read_bytes())
    assert float(re.search(r"distance +(\d+) m", done.stdout)[1]) > 10.0, "the other program moves the boat"
    assert runs[0] == runs[1]


@pytest.mark.long
@in_both_languages
def test_the_example_of_the_documentation_sails_the_whole_suite(language, tmp_path):
    settings = {"simulation.interface": f'"canloop:{language}-{os.getpid()}"', "guest.enabled": "false"}
    command = [sys.executable, "-m", "delfim", "sim", str(ROOT / "etc/delfimx.toml"), "--json", "--for", "12"]
    with modelled(language) as there:
        settings["simulation.external"] = f'"{there}"'
        words = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
        done = subprocess.run([*command, "--output", str(tmp_path), *words], capture_output=True, text=True, timeout=50)
    states = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert len(EXAMPLES[language].splitlines()) <= 30
    assert done.returncode == 0, done.stderr
    assert states[-1]["mode"] == "play"
    assert states[-1]["speed_mps"] > 0.3, "the other program moves the boat"
