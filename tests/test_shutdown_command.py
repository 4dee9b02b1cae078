"""`delfim shutdown` and the command socket's shutdown, with the whole suite on a bus: the propellers are off before the power
may be cut, also where the runtime hangs."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from delfim.base.errors import DelfimError
from delfim.canproxy.dsor import messages
from delfim.canproxy.dsor.messages import PropellerCommand, ShutdownStage
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.services.supervision import shutdown
from delfim.vehicle.operator.link import Link

ROOT = Path(__file__).parents[1]
VEHICLE = str(ROOT / "etc/delfimx.toml")


class Suite(NamedTuple):
    folder: Path
    words: list[str]
    bus: CanSocket
    supervisor: subprocess.Popen[bytes]

    def asked(self, command: str, **words: object) -> None:
        """As soon as the vehicle carries it out."""
        until = time.monotonic() + 200
        while True:
            try:
                with Link(self.folder / "command") as link:
                    link.ask(command, **words)
                    return
            except DelfimError:
                if time.monotonic() > until:
                    raise

    def shut_down(self) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "delfim", "shutdown", VEHICLE, *self.words]
        return subprocess.run(command, capture_output=True, text=True, timeout=200, check=False)

    def until_safe(self) -> tuple[list[ShutdownStage], PropellerCommand]:
        """The bus up to the word that the power may be cut: the stages told, the last command to a propeller."""
        stages, last = [], PropellerCommand(0, True, 0)
        while ShutdownStage.SAFE not in stages:
            frame = self.bus.recvmsg()
            if frame.arb == messages.SHUTDOWN_ACKNOWLEDGE:
                stages.append(messages.unpack_shutdown_acknowledge(frame.data).stage)
            elif frame.arb == messages.PROPELLER_STARBOARD:
                last = messages.unpack_propeller_command(frame.data)
        return stages, last


@pytest.fixture
def suite(tmp_path: Path) -> Iterator[Suite]:
    """A supervised boat under way."""
    bus = f"canloop:shutdown-{os.getpid()}-{tmp_path.name[-10:]}"
    settings = {
        "can.interface": f'"{bus}"',
        "console.socket": f'"{tmp_path}/command"',
        "log.directory": f'"{tmp_path}/log"',
        "runtime.run_directory": f'"{tmp_path}"',
        "supervisor.hardware_watchdog": '""',
        "guest.enabled": "false",
        "services.httpd.enabled": "false",
        "cantcpd.listen": '["127.0.0.1:0"]',
        "powerd.told_s": "0.5",
    }
    words = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
    processes = [subprocess.Popen([sys.executable, "-m", "delfim", what, VEHICLE, *words]) for what in ("nodes", "supervise")]
    with open_can(bus) as socket:
        socket.bind(CanAddress(messages.PROPELLER_STARBOARD), CanAddress(messages.SHUTDOWN_ACKNOWLEDGE))
        socket.settimeout(200)
        boat = Suite(tmp_path, words, socket, processes[1])
        boat.asked("manual", starboard=0.5, port=0.5)
        while not messages.unpack_propeller_command(socket.recvmsg().data).run:
            pass
        yield boat
    for process in processes:
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
        process.wait(200)


def test_the_command_waits_until_the_power_may_be_cut(suite: Suite) -> None:
    done = suite.shut_down()
    assert (done.returncode, done.stdout, done.stderr) == (0, "delfim: the power may be cut\n", "")
    stages, last = suite.until_safe()
    assert stages == [ShutdownStage.SAFE]
    assert not last.run
    assert suite.supervisor.wait(200) == 0
    assert not (suite.folder / "log/running").exists(), "an end in order"
    again = suite.shut_down()
    assert again.returncode == 2
    assert "is it running?" in again.stderr


def test_a_runtime_that_hangs_does_not_keep_the_boat_under_way(suite: Suite) -> None:
    pid = json.loads((suite.folder / "supervisor.json").read_text())["programs"]["runtime"]["pid"]
    os.kill(pid, signal.SIGSTOP)
    shutdown.request(shutdown.socket_path(suite.folder), "off", "test")
    stages, last = suite.until_safe()
    assert stages == [ShutdownStage.SAFE]
    assert not last.run


@pytest.mark.parametrize("how", [pytest.param("command socket", marks=pytest.mark.long), "frame"])
def test_who_drives_and_who_powers_the_boat_may_end_it(suite: Suite, how: str) -> None:
    if how == "frame":
        suite.bus.sendto(messages.pack_shutdown(messages.Shutdown(False)), CanAddress(messages.SHUTDOWN))
    else:
        suite.asked("shutdown")
    stages, last = suite.until_safe()
    assert stages == ([ShutdownStage.BEGUN] if how == "frame" else []) + [ShutdownStage.SAFE]
    assert not last.run
    assert suite.supervisor.wait(200) == 0
