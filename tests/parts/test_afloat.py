"""A laboratory's boat in real processes: motor, satellite compass, thermometer, trouble and tide gauge are packages outside."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from delfim.base.errors import DelfimError
from delfim.logging.ashore.table import table
from delfim.logging.ashore.tree import files
from delfim.vehicle.operator.link import Link
from tests.afloat import running
from tests.parts.laboratory import ROOT, installed

KINDS = ("motor", "source", "sensor", "trouble", "service")
ABOARD = tuple(f'parts.example_{kind}="1.0"' for kind in KINDS)
ROWS = """thrusters=[{name="starboard", driver="dsor", y_m=1.0, thrust_n=[-300.0, 500.0], rate_per_s=0.7}, \
{name="port", driver="example_motor", y_m=-1.0, thrust_n=[-300.0, 500.0], rate_per_s=0.7}]"""


class Bench:
    """The other ends of the laboratory's lines, and an operator who looks."""

    def __init__(self, place: Path) -> None:
        """The lines are not where simulated devices have theirs."""
        self._command, self.said = place / "command", 0
        self.lines = place.parent / f"{place.name}-lines"
        self.lines.mkdir()
        self.ends = {name: self._line(self.lines / name) for name in ("compass", "thermometer", "motor")}
        self._rest = b""

    def _line(self, device: Path) -> int:
        end, port = os.openpty()
        device.symlink_to(os.ttyname(port))
        os.set_blocking(end, False)
        return end

    def ask(self, command: str = "state", **words: object) -> dict[str, Any]:
        with Link(self._command, 60.0) as link:
            return link.ask(command, **words)

    def speak(self, until: Callable[[dict[str, Any]], object], satellites: float = 12) -> dict[str, Any]:
        """Messages of the instruments and a look at the state, until it is as wanted."""
        while True:
            self.said += 1
            # It stays where it is, whatever the lines lose.
            position = b"%.9f -9.2 %d.0 0.0 0.0 %d\n" % (38.7 + 1e-8 * (self.said % 10), self.said % 10, self.said)
            with contextlib.suppress(BlockingIOError):  # nobody reads yet
                os.write(self.ends["compass"], position)
                os.write(self.ends["thermometer"], b"17.5\n")
            try:
                state = self.ask()
            except DelfimError:  # it does not run yet
                continue
            if until(state):
                return state

    def obeyed(self, command: str, **words: object) -> None:
        """Speaks until the command is carried out."""

        def accepted(_: dict[str, Any]) -> bool:
            try:
                self.ask(command, **words)
            except DelfimError:
                self.ask("stop")  # a stick that was refused must be let go first, or another mode chosen
                return False
            return True

        self.speak(accepted)

    def told_to_motor(self) -> list[str]:
        """The lines that the motor has heard since."""
        try:
            self._rest += os.read(self.ends["motor"], 1 << 20)
        except BlockingIOError:
            return []
        *lines, self._rest = self._rest.split(b"\n")
        return [line.decode().strip() for line in lines]


def is_fit(state: dict[str, Any]) -> bool:
    return not state["notices"] and {"navigation", "sensors"} <= {line["name"] for line in state["checks"] if line["ok"]}


def command(*words: str, path: str) -> subprocess.CompletedProcess[str]:
    program = [sys.executable, "-m", "delfim", *words]
    return subprocess.run(program, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, timeout=200)


def page(port: int) -> dict[str, Any]:
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/api/state") as answer:
            told: dict[str, Any] = json.load(answer)
    except OSError:  # it does not run yet
        return {}
    return told


@pytest.fixture
def free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port: int = free.getsockname()[1]
    return port


@pytest.fixture
def place(tmp_path: Path) -> Path:
    installed(tmp_path / "laboratory", *KINDS)
    return tmp_path


@pytest.mark.long
def test_the_boat_of_a_laboratory_sails_is_shown_logged_repeated_and_stopped(place, free_port):
    path, bench = f"{place}/laboratory:{ROOT}", Bench(place)
    values = (
        *ABOARD,
        ROWS,
        'navigation.sources=["example_source"]',
        'sensors.names=["sysstat", "example_sensor"]',
        f'example_source.device="{bench.lines}/compass"',
        f'example_sensor.device="{bench.lines}/thermometer"',
        f'example_motor.device="{bench.lines}/motor"',
        "example_motor.most=0.9",
        'failsafe.few_satellites.heading="hold"',
        'sysstat.required=["gps"]',
        f'httpd.listen="127.0.0.1:{free_port}"',
        "mavlink.enabled=false",
        "failsafe.manual_silent.after_s=30.0",  # a busy machine speaks slowly
        "supervisor.deadman_s=5.0",
    )
    with running(place, 14550, *values, package=path):
        bench.speak(is_fit)
        told = list[str]()
        while "thrust 0 0.900" not in told:  # the file's limit, of 1.0 that was asked for
            bench.obeyed("manual", starboard=-1.0, port=1.0)
            told += bench.told_to_motor()
        assert [line for line in told if 0.0 < float(line.split()[2]) < 0.9], "no faster than the row's rate"
        os.write(bench.ends["motor"], b"nonsense\n0 1850\n")
        state = bench.speak(lambda state: state["thrusters"]["port"].get("rpm") == 1850.0)
        assert state["counts"]["example_motor_malformed"] == 1
        assert state["source"] == "example_source"
        assert state["measured"] == {"water_c": 17.5}
        assert next(line["reason"] for line in state["checks"] if line["name"] == "navigation").startswith("example_source, ")
        assert state["parts"]["example_source"]["failed"] == 0
        bench.obeyed("heading", heading_deg=90.0, speed_mps=1.0)
        shown: dict[str, Any] = {}
        while shown.get("state") != "running":
            report = page(free_port)
            shown = ((report.get("computer") or {}).get("supervisor") or {}).get("example_service", {})
            bench.speak(lambda state: True)
        assert shown["place"] == "process"
        assert set(page(free_port)["vehicle"]["parts"]) == {"example_source", "example_sensor", "example_motor"}
        runtime = json.loads((place / "supervisor.json").read_text())["programs"]["runtime"]["pid"]
        bench.told_to_motor()
        os.kill(runtime, signal.SIGSTOP)
        while "thrust 0 0" not in bench.told_to_motor():  # as the supervisor says it
            pass
    logged = [file for file in files([place / "log"]) if file.id == "state"]
    columns, _ = table(logged[:1])
    assert columns["water_c"][-1] == 17.5
    cat = command("log", "cat", "--events", "--json", str(place / "log"), path=str(ROOT))
    assert '"example_motor": "1.0"' in cat.stdout or '"example_motor":"1.0"' in cat.stdout, "the start event names the parts"


@pytest.mark.long
def test_a_log_is_repeated_with_the_parts_and_read_without(place):
    path, bench = f"{place}/laboratory:{ROOT}", Bench(place)
    values = (
        *ABOARD,
        'navigation.sources=["example_source"]',
        f'example_source.device="{bench.lines}/compass"',
        "failsafe.few_satellites.satellites=20",
        "mavlink.enabled=false",
    )
    with running(place, 14550, *values, package=path):
        bench.obeyed("heading", heading_deg=90.0, speed_mps=1.0)
        state = bench.speak(lambda state: state["run"] and state["thrusters"]["starboard"]["thrust"])
        assert ("few_satellites", "12 satellites") in {(each["name"], each["reason"]) for each in state["notices"]}
        os.write(bench.ends["compass"], b"nonsense\n")
        bench.speak(lambda state: state["counts"].get("example_source_malformed"))
        while (state := bench.ask())["mode"] != "idle":  # it says nothing any more
            assert state["age_s"]["navigation"] < 60.0
    log = str(place / "log")
    repeated = command("log", "replay", log, path=path)
    assert "all the same, bit by bit" in repeated.stdout, repeated.stdout + repeated.stderr
    assert int(repeated.stdout.split()[0]) > 3, "cycles"
    refused = command("log", "replay", log, path=str(ROOT))
    assert "parts.example_motor: no installed package has a part of this name" in refused.stderr
    assert "few_satellites: 12 satellites: warn" in command("log", "cat", "--events", "--json", log, path=str(ROOT)).stdout


def test_a_boat_without_its_motor_starts_nothing_that_needs_it_and_says_so(place, free_port):
    (place / "laboratory/example_motor/driver.py").write_text("raise RuntimeError('made on a Friday')")
    motor = (ABOARD[0], ROWS, f'example_motor.device="{place}/motor"', 'sysstat.required=["gps"]')
    values = (*motor, "mavlink.enabled=false", f'httpd.listen="127.0.0.1:{free_port}"')
    with running(place, 14550, *values, package=f"{place}/laboratory:{ROOT}"):
        vehicle: dict[str, Any] = {}
        while vehicle.get("state") not in ("failed", "ended"):
            vehicle = page(free_port).get("services", {}).get("vehicle", {})
        print(vehicle)
    assert "part example_motor: example_motor.driver cannot be imported: RuntimeError: made on a Friday" in vehicle["reason"]
