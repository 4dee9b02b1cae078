"""`delfim actuate`: one thruster, armed by its name, for as long as a key is held."""

import contextlib
import json
import os
import pty
import select
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Self

import pytest

from delfim import config
from delfim.base.errors import DelfimError
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import ANYTHING, CanSocket
from delfim.services.bench import HELD_S, DeadMan, Trial, runs
from delfim.vehicle.operator.link import Link
from delfim.vehicle.propulsion.gate import GateLimits
from tests.afloat import running
from tests.parts.pwm.test_outlet import chip, pulse_us
from tests.vehicle.played_devices import PlayedVesc

ROOT = Path(__file__).parents[2]
PATIENCE_S = 200.0
ROWS = ", ".join(
    f'{{name="{name}", driver="DRIVER", address={address}, y_m={y_m}, thrust_n=[-50.0, 50.0], rpm_max=1500.0, rate_per_s=1.0}}'
    for address, name, y_m in ((0, "starboard", 0.5), (1, "port", -0.5))
)


def trial(for_s: float = 2.0) -> tuple[Trial, DeadMan]:
    key = DeadMan(for_s)
    return Trial(GateLimits(config.DELFIMX), 1, 0.2, key), key


def test_it_begins_with_a_key_rises_no_faster_than_the_gate_lets_it_and_ends_when_the_key_is_let_go() -> None:
    (one, key), now_s = trial(), 100.0
    for _ in range(10):
        now_s += 0.05
        assert not one.at(now_s, False).run
    parts = [one.at(now_s + 0.05 * step, True).thrust for step in range(1, 12)]
    assert [starboard for starboard, _ in parts] == [0.0] * 11
    assert parts[0][1] == 0.0
    assert parts[-1][1] == 0.2
    steps = [after[1] - before[1] for before, after in pairwise(parts)]
    assert max(steps) == pytest.approx(0.05 * 0.6667)
    now_s += 0.05 * 11
    assert one.at(now_s + HELD_S - 0.05, False).run
    assert not one.at(now_s + HELD_S + 0.05, False).run
    assert key.ended == "the key was let go"


def test_it_ends_in_time_although_the_key_is_held() -> None:
    one, key = trial(1.0)
    assert [one.at(100.0 + 0.25 * step, True).run for step in range(7)] == [True, True, True, True, True, False, False]
    assert key.ended == "1 s are over"


class Terminal:
    """`delfim actuate` in a terminal."""

    def __init__(self, place: Path, driver: str, *values: str, part: str = "0.2") -> None:
        self.far, near = pty.openpty()
        every = (
            f"thrusters=[{ROWS.replace('DRIVER', driver)}]",
            f'runtime.run_directory="{place}"',
            f'console.socket="{place}/command"',
            *values,
        )
        words = [word for each in every for word in ("--set", each)]
        command = [
            sys.executable,
            "-m",
            "delfim",
            "actuate",
            str(ROOT / "etc/delfimx.toml"),
            "port",
            part,
            "--for",
            "30",
            *words,
        ]
        self.program = subprocess.Popen(command, stdin=near, stdout=near, stderr=near, start_new_session=True)
        os.close(near)
        self.said = ""

    def type(self, text: str) -> None:
        os.write(self.far, text.encode())

    def heard(self, words: str) -> None:
        """Waits until it says so."""
        deadline_s = time.monotonic() + PATIENCE_S
        while words not in self.said:
            assert time.monotonic() < deadline_s, self.said
            if select.select([self.far], [], [], 0.1)[0]:
                with contextlib.suppress(OSError):  # it has ended
                    self.said += os.read(self.far, 4096).decode()

    def end(self) -> int:
        self.program.terminate()
        code = self.program.wait(PATIENCE_S)
        os.close(self.far)
        return code


@pytest.fixture
def vescs(tmp_path: Path) -> Iterator[tuple[str, CanSocket]]:
    name = f"canloop:bench-{os.getpid()}-{tmp_path.name[-8:]}"
    with open_can(name) as bus:
        bus.bind(ANYTHING)
        yield f'vesc.interface="{name}"', bus


def held(terminal: Terminal, played: tuple[PlayedVesc, ...], bus: CanSocket, key: str) -> list[float]:
    """The efforts of the motors, with this key pressed again."""
    terminal.type(key)
    select.select([bus], [], [], 0.1)
    while (frame := bus.receive()) is not None:
        for each in played:
            each.hear(frame.identifier, frame.data, time.monotonic())
    return [round(each.effort(time.monotonic()), 3) for each in played]


def test_a_motor_turns_while_a_key_is_held_and_stops_when_it_is_let_go(tmp_path: Path, vescs: tuple[str, CanSocket]) -> None:
    value, bus = vescs
    played = PlayedVesc(0), PlayedVesc(1)
    terminal = Terminal(tmp_path, "vesc", value)
    terminal.heard("Type port to arm it: ")
    assert held(terminal, played, bus, "") == [0.0, 0.0]
    terminal.type("port\n")
    terminal.heard("Hold the space bar")
    deadline_s = time.monotonic() + PATIENCE_S
    while held(terminal, played, bus, " ") != [0.0, 0.2]:
        assert time.monotonic() < deadline_s
    terminal.heard("thrust +20%")
    terminal.heard("stopped: the key was let go")
    assert terminal.program.wait(PATIENCE_S) == 0
    assert held(terminal, played, bus, "") == [0.0, 0.0]
    terminal.end()


def test_a_wrong_word_arms_nothing(tmp_path: Path, vescs: tuple[str, CanSocket]) -> None:
    terminal = Terminal(tmp_path, "vesc", vescs[0])
    terminal.heard("Type port to arm it: ")
    terminal.type("yes\n")
    terminal.heard("not armed: that is not its name")
    assert terminal.program.wait(PATIENCE_S) == 2
    assert vescs[1].receive() is None, "not a frame"
    terminal.end()


def test_a_motor_by_pulses_has_its_outlet_and_a_signal_stops_it(tmp_path: Path) -> None:
    place = chip(tmp_path / "pwmchip0", 0, 1)
    terminal = Terminal(tmp_path, "pwm", f'pwm.chip="{place}"', "pwm.arm_s=0.0")
    terminal.heard("Type port to arm it: ")
    terminal.type("port\n")
    terminal.heard("Hold the space bar")
    deadline_s = time.monotonic() + PATIENCE_S
    while pulse_us(place, 1) != 1580:
        terminal.type(" ")
        select.select([], [], [], 0.05)
        assert time.monotonic() < deadline_s
    terminal.end()
    assert [pulse_us(place, each) for each in (0, 1)] == [1500, 1500]


@pytest.mark.parametrize(("part", "words"), [("0.5", "more is nothing for a bench"), ("x", "no number")])
def test_what_is_too_much_for_a_bench_is_refused(tmp_path: Path, part: str, words: str) -> None:
    terminal = Terminal(tmp_path, "vesc", part=part)
    terminal.heard(words)
    assert terminal.program.wait(PATIENCE_S) == 2
    terminal.end()


class PlayedBoat:
    """A boat's command socket, in a thread: what it was asked, and what it answers."""

    def __init__(self, place: Path, mode: str = "idle", refusal: str = "") -> None:
        self._mode, self._refusal = mode, refusal
        self.asked = list[dict[str, object]]()
        self._server = socket.socket(socket.AF_UNIX)
        self._server.bind(f"{place}/command")
        self._server.listen()
        self._thread = threading.Thread(target=self._serve)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._server.close()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                visitor, _ = self._server.accept()
                with visitor, visitor.makefile("rwb") as lines:
                    for line in lines:
                        self.asked.append(json.loads(line))
                        lines.write(json.dumps(self._answer(self.asked[-1])).encode() + b"\n")
                        lines.flush()

    def _answer(self, command: dict[str, object]) -> dict[str, object]:
        reason = self._refusal if command.get("part") else ""
        thrusters = {"port": {"thrust": command.get("part", 0.0), "angle_deg": None, "rpm": 300.0, "faults": []}}
        return {"ok": not reason, "reason": reason, "state": {"mode": self._mode, "thrusters": thrusters}}


def pressed(terminal: Terminal, until: str) -> None:
    """Holds the space bar until it says so."""
    deadline_s = time.monotonic() + PATIENCE_S
    while until not in terminal.said:
        assert time.monotonic() < deadline_s, terminal.said
        with contextlib.suppress(OSError):  # it has ended
            terminal.type(" ")
            if select.select([terminal.far], [], [], 0.1)[0]:
                terminal.said += os.read(terminal.far, 4096).decode()


def test_the_boats_program_is_asked_where_it_runs_and_the_devices_are_left_to_it(tmp_path, vescs):
    with PlayedBoat(tmp_path) as boat:
        terminal = Terminal(tmp_path, "vesc", vescs[0])
        terminal.heard("Type port to arm it: ")
        assert boat.asked == [{"command": "state"}]
        terminal.type("port\n")
        terminal.heard("Hold the space bar")
        pressed(terminal, "thrust +20% rpm 300.0")
        terminal.heard("stopped: the key was let go")
        assert terminal.program.wait(PATIENCE_S) == 0
        terminal.end()
    told = boat.asked[1:]
    assert set(map(str, told[:-1])) == {str({"command": "actuate", "thruster": "port", "part": 0.2, "for_s": 30.0})}
    assert told[-1] == {"command": "actuate", "thruster": "port", "part": 0.0}
    assert vescs[1].receive() is None, "not a frame"


def test_a_wrong_word_asks_the_boat_nothing(tmp_path: Path) -> None:
    with PlayedBoat(tmp_path) as boat:
        terminal = Terminal(tmp_path, "vesc")
        terminal.heard("Type port to arm it: ")
        terminal.type("starboard\n")
        terminal.heard("not armed: that is not its name")
        assert terminal.program.wait(PATIENCE_S) == 2
        terminal.end()
    assert boat.asked == [{"command": "state"}]


def test_a_boat_that_refuses_is_told_nothing_more(tmp_path: Path) -> None:
    """Somebody else may have it now, and his thrust must not end."""
    with PlayedBoat(tmp_path, refusal="actuate refused: the boat is in mode play; stop it first") as boat:
        terminal = Terminal(tmp_path, "vesc")
        terminal.heard("Type port to arm it: ")
        terminal.type("port\n")
        terminal.heard("Hold the space bar")
        pressed(terminal, "actuate refused: the boat is in mode play")
        assert terminal.program.wait(PATIENCE_S) == 1
        terminal.end()
    assert [each["command"] for each in boat.asked] == ["state", "actuate"]


def test_a_boat_under_way_is_left_alone(tmp_path: Path) -> None:
    with PlayedBoat(tmp_path, mode="play") as boat:
        terminal = Terminal(tmp_path, "vesc")
        terminal.heard("the boat's program runs, in mode play: a thruster is tried in idle alone; stop it first")
        assert terminal.program.wait(PATIENCE_S) == 2
        terminal.end()
    assert boat.asked == [{"command": "state"}]


def test_a_socket_that_cannot_be_asked_is_no_sign_that_nobody_has_the_thrusters(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for name, answer in (("command", False), ("file", False), ("file/command", None)):
        settings = config.Vehicle(boat=config.BoatTable(name="test"), console=config.Console(socket=f"{tmp_path}/{name}"))
        if answer is None:
            with pytest.raises(DelfimError, match="it cannot be told whether the boat's program runs"):
                runs(settings)
        else:
            assert runs(settings) is answer


@pytest.mark.long
def test_a_whole_boat_turns_one_motor_in_idle_while_the_key_is_held(tmp_path: Path) -> None:
    """Its controllers are those of the simulation."""
    rows = f"thrusters=[{ROWS.replace('DRIVER', 'vesc')}]"
    values = (rows, f'vesc.interface="canloop:bench-{os.getpid()}"', 'sysstat.required=["gps"]', "mavlink.enabled=false")
    with running(tmp_path, 14550, *values) as command:
        deadline_s = time.monotonic() + PATIENCE_S
        while True:
            with contextlib.suppress(DelfimError), Link(command) as boat:
                boat.ask("state")
                break
            assert time.monotonic() < deadline_s
        terminal = Terminal(tmp_path, "vesc", *values)
        terminal.heard("Type port to arm it: ")
        terminal.type("port\n")
        terminal.heard("Hold the space bar")
        pressed(terminal, "thrust +20% rpm 30")  # 300 of 1500
        with Link(command) as boat:
            state = boat.ask("state")
        assert (state["mode"], state["run"], state["thrusters"]["starboard"]["thrust"]) == ("idle", True, 0.0)
        terminal.heard("stopped: the key was let go")
        terminal.end()
        with Link(command) as boat:
            assert boat.ask("state")["run"] is False


def test_it_needs_a_terminal(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "delfim", "actuate", str(ROOT / "etc/delfimx.toml"), "port", "0.1"]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=PATIENCE_S)
    assert (done.returncode, "needs a terminal" in done.stderr) == (2, True)
    done = subprocess.run(
        [*command[:-2], "prot", "0.1"], stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert "there is no thruster 'prot'" in done.stderr
