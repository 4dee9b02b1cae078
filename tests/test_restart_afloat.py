"""The real programs, killed under way: the runtime, the supervisor, and both told to end. What the boat does then is the same
as in lock step (tests/vehicle/test_restart.py); here it is seen to be kept and read again."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from delfim.base.errors import DelfimError
from delfim.logging.kept.record import newest
from delfim.logging.kept.writer import VOYAGE
from delfim.vehicle.operator.link import Link

ROOT = Path(__file__).parents[1]
VEHICLE = str(ROOT / "etc/delfimx.toml")
MISSION = (ROOT / "etc/missions/doca.toml").read_text()
FENCE = "[fence]\nversion = 1\n[[fence.keep_in]]\ncentre = [[38.6895, -9.2150]]\nradius_m = 600\n"
NEVER = threading.Event()


class Boat:
    """A supervised boat on a bus of its own."""

    def __init__(self, folder: Path, *more: str) -> None:
        bus = f"canloop:restart-{os.getpid()}-{folder.name[-10:]}"
        values = (
            *(f'can.interface="{bus}"', f'console.socket="{folder}/command"', f'log.directory="{folder}/log"'),
            *(f'runtime.run_directory="{folder}/run"', 'supervisor.hardware_watchdog=""', "supervisor.deadman_s=30.0"),
            *('httpd.listen="127.0.0.1:0"', 'cantcpd.listen=["127.0.0.1:0"]', "guest.enabled=false", "mavlink.enabled=false"),
            *more,
        )
        self.folder, self._words = folder, [VEHICLE, *(word for value in values for word in ("--set", value))]
        self.nodes = self._started("nodes")
        self.supervisor = self._started("supervise")

    def _started(self, name: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen([sys.executable, "-m", "delfim", name, *self._words])

    def start(self) -> None:
        """The supervisor again, as an init script does."""
        self.supervisor = self._started("supervise")

    def end(self) -> None:
        for program in (self.supervisor, self.nodes):
            program.send_signal(signal.SIGTERM)
            program.wait(200)

    def runtime(self) -> int:
        return int(json.loads((self.folder / "run/supervisor.json").read_text())["programs"]["runtime"]["pid"])

    def kill(self) -> None:
        os.kill(pid := self.runtime(), signal.SIGKILL)
        self.until(lambda _: self.runtime() != pid)

    def asked(self, command: str, **words: Any) -> dict[str, Any]:
        """The answer, as soon as the vehicle obeys."""
        until_s = time.monotonic() + 200
        while True:
            try:
                with Link(self.folder / "command") as link:
                    return link.ask(command, **words)
            except DelfimError:
                if time.monotonic() > until_s:
                    raise
            NEVER.wait(0.05)

    def until(self, is_so: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """The state, once this is so."""
        until_s = time.monotonic() + 200
        while not is_so(state := self.asked("state")):
            assert time.monotonic() < until_s, (state["mode"], state["reason"], state["notices"], state["checks"])
            NEVER.wait(0.05)
        return state

    def kept(self, words: bytes) -> None:
        """Wait until this stands in the newest record beside the logs."""
        until_s = time.monotonic() + 200
        while words not in (newest([str(self.folder / "log")], VOYAGE, b"")[1] or b""):
            assert time.monotonic() < until_s
            NEVER.wait(0.02)


@pytest.fixture
def boat(tmp_path: Path) -> Iterator[Boat]:
    """A boat that plays its mission inside a fence."""
    sailing = Boat(tmp_path)
    try:
        sailing.until(lambda state: state["latitude_deg"] is not None)
        sailing.asked("mission", text=MISSION + FENCE)
        sailing.asked("set", key="control.speed.max_mps", value=1.4)
        sailing.asked("play")
        sailing.kept(b'{"mode":"play"')
        yield sailing
    finally:
        sailing.end()


def restarted(state: dict[str, Any]) -> str:
    return next((notice["reason"] for notice in state["notices"] if notice["name"] == "restarted"), "")


def check(state: dict[str, Any], name: str) -> dict[str, Any]:
    found: dict[str, Any] = next(line for line in state["checks"] if line["name"] == name)
    return found


def test_a_killed_runtime_holds_and_goes_on_when_it_is_told(boat):
    for _ in range(2):
        boat.kill()
        state = boat.until(lambda state: state["mode"] == "hold")
        assert "it was in play on leg 1; hold now" in restarted(state)
        assert state["mission"] == "Doca"
        assert check(state, "fence")["reason"].startswith("1 zones")
        boat.kept(b'{"mode":"hold"')
        boat.asked("continue")
        assert boat.until(lambda state: state["mode"] == "play")["reason"] == "operator continues"
        boat.kept(b'{"mode":"play"')


def test_a_killed_supervisor_takes_nothing_of_the_voyage_with_it(boat):
    pid = boat.runtime()
    boat.supervisor.kill()
    boat.supervisor.wait()
    while Path(f"/proc/{pid}").exists():
        NEVER.wait(0.02)
    boat.start()
    state = boat.until(lambda state: state["mode"] == "hold")
    assert "it was in play" in restarted(state)
    assert state["mission"] == "Doca"


def test_a_boat_that_is_told_to_end_stays_idle_with_its_mission_aboard(boat):
    boat.supervisor.terminate()
    boat.supervisor.wait(200)
    boat.start()
    state = boat.until(lambda state: check(state, "fence")["ok"] and state["mission"] == "Doca")
    assert state["mode"] == "idle"
    assert not restarted(state)


@pytest.mark.long
def test_a_boat_that_dies_again_before_it_knows_where_it_is_goes_on_all_the_same(boat):
    boat.supervisor.send_signal(signal.SIGSTOP)  # it does not start the runtime before navigation is silent
    os.kill(boat.runtime(), signal.SIGKILL)
    boat.nodes.send_signal(signal.SIGSTOP)
    boat.supervisor.send_signal(signal.SIGCONT)
    boat.until(lambda state: "waits for navigation" in restarted(state))
    boat.kill()
    boat.until(lambda state: "waits for navigation" in restarted(state))
    boat.nodes.send_signal(signal.SIGCONT)
    state = boat.until(lambda state: state["mode"] == "hold")
    assert "it was in play" in restarted(state)
    assert state["mission"] == "Doca"


@pytest.mark.long
def test_a_disk_that_is_gone_does_not_take_the_voyage_with_it(boat):
    for slot in (boat.folder / "log").glob("voyage-*"):
        slot.unlink()
    boat.kill()
    assert "it was in play" in restarted(boat.until(lambda state: state["mode"] == "hold"))


@pytest.mark.long
def test_a_torn_record_is_the_one_before_it_and_two_are_told(boat):
    while not all(b'{"mode":"play"' in slot.read_bytes() for slot in boat.folder.glob("*/voyage-*")):
        NEVER.wait(0.1)  # the one before it is of the same mode after a few seconds under way
    for name in ("log", "run"):
        slots = sorted((boat.folder / name).glob("voyage-*"), key=lambda path: path.stat().st_mtime_ns)
        slots[-1].write_bytes(slots[-1].read_bytes()[:700])
    boat.kill()
    boat.until(lambda state: state["mode"] == "hold")
    boat.kept(b'{"mode":"hold"')
    boat.supervisor.send_signal(signal.SIGSTOP)  # it does not start the runtime before the slots are damaged
    os.kill(boat.runtime(), signal.SIGKILL)
    for slot in boat.folder.glob("*/voyage-*"):
        slot.write_bytes(slot.read_bytes().replace(b"boat", b"bait", 1))
    boat.supervisor.send_signal(signal.SIGCONT)
    state = boat.until(lambda state: "damaged" in restarted(state))
    assert state["mode"] == "idle"
    assert not check(state, "fence")["ok"]
