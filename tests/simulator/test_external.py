"""A model in another program: the example of the documentation sails the boat, and its silence is the sensors' silence."""

import json
import math
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from delfim.clock import ManualClock
from delfim.errors import DelfimError
from delfim.simulator.external import SILENT_S, ExternalModel
from delfim.simulator.model import Hull
from delfim.simulator.nodes.navigation import NavigationNode, Noise

ROOT = Path(__file__).parents[2]
EXAMPLES = dict(re.findall(r"```(python|octave)\n(.*?)```", (ROOT / "docs/external-model.md").read_text(), re.DOTALL))
PROGRAMS = {"python": [sys.executable, "-c"], "octave": ["octave-cli", "--no-init-file", "--eval"]}
STILL = {"north_m": 0.0, "east_m": 0.0, "heading_rad": 0.0, "north_mps": 0.0, "east_mps": 0.0}


@pytest.fixture
def pair():
    """The model, its clock, and the other program's end."""
    clock = ManualClock(100.0)
    model = ExternalModel(Hull(), clock, "127.0.0.1:0", 0.67, -0.16)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.settimeout(30.0)
        other.connect(model._socket.getsockname())
        yield model, clock, other
    model._socket.close()


def test_what_is_told_is_where_the_boat_is_and_the_answer_is_what_the_propellers_do(pair):
    model, _, other = pair
    model.command("starboard", 600.0, True)
    model.advance(5.0)
    other.send(json.dumps(STILL | {"north_m": 10.0, "east_m": -5.0, "heading_rad": 7.0, "east_mps": 1.5}).encode())
    model.listen()
    answer = json.loads(other.recv(2048))
    assert answer["starboard_rpm"] == pytest.approx(600.0, rel=0.05)
    assert answer["port_rpm"] == 0.0
    assert (model.north_m, model.east_m) == (10.0, -5.0)
    assert model.heading_rad == pytest.approx(7.0 - math.tau)
    assert (model.north_mps, model.east_mps) == (pytest.approx(0.0, abs=1e-9), pytest.approx(1.5))


@pytest.mark.parametrize("words", [b"", b"{}", b"[1]", b"\xff", json.dumps(STILL | {"north_m": 1e300}).encode()])
def test_what_means_nothing_is_counted_and_changes_nothing(pair, words):
    model, _, other = pair
    other.send(words)
    model.listen()
    assert model.malformed == 1
    assert not model.alive


def test_its_silence_is_the_silence_of_the_sensors(pair):
    model, clock, other = pair
    node = NavigationNode(model, 5.0, Noise(0.0, 0.0, 0.0), 1)
    assert node.step(0.0, 0) == []
    other.send(json.dumps(STILL).encode())
    model.listen()
    assert node.step(0.2, 0)
    clock.advance(SILENT_S)
    assert node.step(1.4, 0) == []


def test_an_address_that_is_taken_is_told(pair):
    taken = f"127.0.0.1:{pair[0]._socket.getsockname()[1]}"
    with pytest.raises(DelfimError, match=r"simulation\.external"):
        ExternalModel(Hull(), ManualClock(), taken, 0.67, -0.16)


@pytest.mark.parametrize(
    "language",
    ["python", pytest.param("octave", marks=pytest.mark.skipif(not shutil.which("octave-cli"), reason="needs GNU Octave"))],
)
def test_the_example_of_the_documentation_sails_the_whole_suite(language, tmp_path):
    port = 40_000 + os.getpid() % 20_000
    example = subprocess.Popen([*PROGRAMS[language], EXAMPLES[language].replace("4800", str(port))])
    settings = {
        "simulation.external": f'"127.0.0.1:{port}"',
        "simulation.interface": f'"canloop:{language}-{os.getpid()}"',
        "guest.enabled": "false",
    }
    words = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
    command = [sys.executable, "-m", "delfim", "sim", str(ROOT / "etc/delfimx.toml"), "--json", "--for", "12"]
    done = subprocess.run([*command, "--output", str(tmp_path), *words], capture_output=True, text=True, timeout=50)
    example.send_signal(signal.SIGKILL)
    example.wait()
    states = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert len(EXAMPLES[language].splitlines()) <= 30
    assert done.returncode == 0, done.stderr
    assert states[-1]["mode"] == "play"
    assert states[-1]["speed_mps"] > 0.3, "the other program moves the boat"
