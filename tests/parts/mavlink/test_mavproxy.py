"""MAVProxy by its own command line, against the running boat: over UDP, in real time."""

import contextlib
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from delfim.vehicle.operator.link import Link
from tests.afloat import running

PORT = 21_000 + os.getpid() % 10_000  # below those that the kernel gives away
PATIENCE_S = 200.0
MISSION = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t38.6907\t-9.2153\t0\t1
1\t0\t3\t16\t5\t3\t0\t0\t38.6909\t-9.2149\t0\t1
2\t0\t3\t16\t0\t3\t0\t0\t38.6912\t-9.2149\t0\t1
"""
JUMP = "3\t0\t3\t177\t1\t2\t0\t0\t0\t0\t0\t1\n"


class Proxy:
    """A person at MAVProxy's prompt."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self._process = process
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout
        for line in self._process.stdout:
            self._lines.put(line)

    def join(self) -> None:
        self._reader.join(PATIENCE_S)

    def say(self, words: str, *answers: str) -> None:
        """A command, and what must be answered, in this order."""
        assert self._process.stdin
        self._process.stdin.write(f"{words}\n")
        self._process.stdin.flush()
        for answer in answers:
            self.hear(answer)

    def hear(self, answer: str) -> None:
        seen, until_s = list[str](), time.monotonic() + PATIENCE_S
        while not (seen and answer in seen[-1]):
            try:
                seen.append(self._lines.get(timeout=max(until_s - time.monotonic(), 0.0)))
            except queue.Empty:
                raise AssertionError(f"{answer!r} is not in {seen}") from None


@contextlib.contextmanager
def mavproxy(place: Path) -> Iterator[Proxy]:
    command = [sys.executable, str(Path(sys.executable).with_name("mavproxy.py")), f"--master=udpin:127.0.0.1:{PORT}"]
    settings = {**os.environ, "PYTHONUNBUFFERED": "1", "HOME": str(place), "PYTHONWARNINGS": "ignore"}
    with subprocess.Popen(
        [*command, "--aircraft=boat", f"--state-basedir={place}"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=place,
        env=settings,
    ) as process:
        proxy = Proxy(process)
        try:
            yield proxy
        finally:
            process.kill()
            proxy.join()


def until(condition: Callable[[], object]) -> None:
    until_s, never = time.monotonic() + PATIENCE_S, threading.Event()
    while not condition():
        assert time.monotonic() < until_s
        never.wait(0.05)


@pytest.mark.long
def test_connect_mode_arm_load_list_play_hold_disarm(tmp_path):
    (tmp_path / "good.txt").write_text(MISSION)
    (tmp_path / "jump.txt").write_text(MISSION + JUMP)

    def state(path: Path) -> dict:
        with Link(path) as link:
            return link.ask("state")

    with running(tmp_path, PORT, 'mavlink.autopilot="ardurover"') as path, mavproxy(tmp_path) as proxy:
        proxy.hear("online system 2")
        until(lambda: all(line["ok"] for line in state(path)["checks"] if line["name"] in ("navigation", "sensors", "log")))
        proxy.say("wp load jump.txt", "item 3: DO_JUMP (177) is not something this b", "MISSION_ACK: TYPE_MISSION: UNSUPPORTED")
        assert state(path)["mission"] is None
        proxy.say("wp load good.txt", "MISSION_ACK: TYPE_MISSION: ACCEPTED")
        proxy.say("wp list", "38.6909000000 -9.2149000000 0.000000 p1=5.0 p2=3.0", "38.6912000000")
        proxy.say("wp param 2 2 4.5", "MISSION_ACK: TYPE_MISSION: ACCEPTED")  # MISSION_WRITE_PARTIAL_LIST
        proxy.say("wp list", "38.6909000000 -9.2149000000 0.000000 p1=5.0 p2=3.0", "p2=4.5")
        proxy.say("arm throttle", "COMPONENT_ARM_DISARM: ACCEPTED")
        proxy.say("mode AUTO", "AP: play: operator", "DO_SET_MODE: ACCEPTED")
        until(lambda: (state(path)["speed_mps"] or 0.0) > 0.5)
        proxy.say("mode HOLD", "AP: idle: operator", "DO_SET_MODE: ACCEPTED")
        assert (state(path)["mode"], state(path)["run"], state(path)["operator"]) == ("idle", False, "console 255")
        proxy.say("mode AUTO", "DO_SET_MODE: ACCEPTED")
        proxy.say("disarm", "COMPONENT_ARM_DISARM: ACCEPTED")
        assert (state(path)["mode"], state(path)["run"]) == ("idle", False)
