"""The dead-man with the whole suite on a bus: the runtime really hangs, and somebody else stops the propellers.

The contract: stop frames within 1.2 s, the suite back within 3 s, the reason in the state. How long it took is printed
(`pytest -rP`); on a clock of its own the supervisor is held to it in tests/services/test_supervisor.py.
"""

import json
import os
import re
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from delfim.base.errors import DelfimError
from delfim.canproxy.dsor import messages
from delfim.canproxy.dsor.messages import Fault, Node, PropellerStatus
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.vehicle.operator.link import Link

ROOT = Path(__file__).parents[1]
VEHICLE = str(ROOT / "etc/delfimx.toml")
NEVER = threading.Event()

STOOD = {
    "python": re.compile(r"beat stopped for .*; it stood in hang \(tests/hanging.py:\d+\), called by sleeper"),
    "interpreter lock": re.compile(r"beat stopped for .*; it stood in hang \(tests/hanging.py:\d+\), called by sleeper"),
    "memory": re.compile(r"beat stopped for .*; it stood in hang \(tests/hanging.py:\d+\), called by sleeper"),
    "SIGSTOP": re.compile(r"beat stopped for .*; it did not say where it stood: T \(stopped\)"),
    "SIGKILL": re.compile(r"^$"),
}


class Suite(NamedTuple):
    folder: Path
    bus: CanSocket
    hang: Path
    supervisor: subprocess.Popen[bytes]

    def runtime_pid(self) -> int:
        return int(json.loads((self.folder / "supervisor.json").read_text())["programs"]["runtime"]["pid"])

    def asked(self, command: str, **words: object) -> dict:
        """The answer to a command, as soon as the vehicle carries it out."""
        until = time.monotonic() + 200
        while True:
            try:
                with Link(self.folder / "command") as link:
                    return link.ask(command, **words)
            except DelfimError:
                if time.monotonic() > until:
                    raise
            NEVER.wait(0.05)  # a refusal is a line of the system log, which drops the lines of a program that floods it

    def system_log(self) -> str:
        """As `delfim log cat system` prints it."""
        words = [sys.executable, "-m", "delfim", "log", "cat", "system", str(self.folder / "log")]
        return subprocess.run(words, capture_output=True, text=True).stdout

    def stopped(self, since: float) -> float:
        """How long after `since` the bus carried a stop for the starboard propeller."""
        while True:
            if not messages.unpack_propeller_command(self.bus.recvmsg().data).run:
                return time.monotonic() - since


@pytest.fixture
def suite(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Suite]:
    """A supervised boat under way; its parameter, where it has one, is what the supervisor is started by."""
    prefix = getattr(request, "param", ())
    bus = f"canloop:deadman-{os.getpid()}-{tmp_path.name[-10:]}"
    settings = {
        "can.interface": f'"{bus}"',
        "console.socket": f'"{tmp_path}/command"',
        "log.directory": f'"{tmp_path}/log"',
        "runtime.run_directory": f'"{tmp_path}"',
        "supervisor.hardware_watchdog": '""',
        "guest.enabled": "false",
        "services.vehicle.log": '"debug"',
    }
    words = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
    hang = tmp_path / "hang"
    nodes = subprocess.Popen([sys.executable, "-m", "delfim", "nodes", VEHICLE, *words])
    command = [*prefix, sys.executable, str(ROOT / "tests/hanging.py"), str(hang), "supervise", VEHICLE, *words]
    supervisor = subprocess.Popen(command)
    with open_can(bus) as socket:
        socket.bind(CanAddress(messages.PROPELLER_STARBOARD))
        socket.settimeout(200)
        boat = Suite(tmp_path, socket, hang, supervisor)
        boat.asked("manual", starboard=0.5, port=0.5)
        while not messages.unpack_propeller_command(socket.recvmsg().data).run:
            pass
        yield boat
    for process in (supervisor, nodes):
        process.send_signal(signal.SIGTERM)
        process.wait(200)


@pytest.mark.parametrize(
    "how", ["python", "interpreter lock", pytest.param("memory", marks=pytest.mark.long), "SIGSTOP", "SIGKILL"]
)
def test_a_runtime_that_hangs_loses_the_propellers_and_comes_back(suite, how):
    pid = suite.runtime_pid()
    suite.hang.write_text(how)
    began = time.monotonic()
    os.kill(pid, getattr(signal, how, signal.SIGUSR1))
    silence_s = suite.stopped(began)
    state = suite.asked("state")
    back_s = time.monotonic() - began
    print(f"{how}: stopped after {silence_s:.2f} s, back after {back_s:.2f} s")
    assert state["mode"] == "idle"
    assert STOOD[how].search(str(state["deadman"].get("reason", ""))), "an operator sees why, and where the loop stood"
    told = json.loads((suite.folder / "supervisor.json").read_text())
    assert told["programs"]["runtime"]["restarts"] == 1
    expected = "killed by signal 9" if how == "SIGKILL" else "dead-man"
    assert expected in told["programs"]["runtime"]["reason"]
    assert suite.runtime_pid() != pid


def test_the_system_log_tells_all_of_it(suite):
    """As `delfim log cat system` prints it afterwards: in order, although four programs wrote it, one of which was killed."""
    pid = suite.runtime_pid()
    suite.hang.write_text("python")
    suite.asked("heading", heading_deg=90.0)
    os.kill(pid, signal.SIGUSR1)
    suite.stopped(time.monotonic())
    while suite.runtime_pid() == pid or suite.asked("state")["mode"] != "idle":
        pass
    suite.asked("stop")
    while '{"command":"stop"}: done' not in suite.system_log():  # its writer has what the others leave of the processor
        NEVER.wait(0.1)
    suite.supervisor.send_signal(signal.SIGTERM)
    suite.supervisor.wait(200)
    told = suite.system_log()
    lines = iter(told.splitlines())
    for words in (
        r"info     supervisor\[\d+\]: delfim .* starts .*/etc/delfimx.toml, sha256 [0-9a-f]{64}, with other values of can",
        r"info     supervisor\[\d+\]: runtime: started as process",
        r"info     vehicle\[\d+\]: mode manual: operator",
        r'debug    vehicle\[\d+\]: command of local: {"command":"manual","starboard":0.5,"port":0.5}: done',
        r'info     vehicle\[\d+\]: command of local: {"command":"heading","heading_deg":90.0.*}: done',
        r"critical supervisor\[\d+\]: runtime: beat stopped for .*; it stood in hang",
        r"critical supervisor\[\d+\]:   \| .*hanging.py.* in hang",
        r"error    supervisor\[\d+\]: runtime: beat stopped for .*; started again in 0 s",
        r"info     supervisor\[\d+\]: runtime: started as process",
        r'info     vehicle\[\d+\]: command of local: {"command":"stop"}: done',
        r"warning  runtime\[\d+\]: stopping: SIGTERM",
        r"info     supervisor\[\d+\]: runtime: ended",
    ):
        assert any(re.search(words, line) for line in lines), f"{words}\n{told}"


@pytest.mark.parametrize("suite", [("taskset", "-c", str(min(os.sched_getaffinity(0))))], indirect=True)
def test_a_runtime_that_hangs_in_real_time_does_not_keep_the_processor_from_its_supervisor(suite):
    pid = suite.runtime_pid()
    policies = [(os.sched_getscheduler(each), os.sched_getparam(each).sched_priority) for each in (pid, suite.supervisor.pid)]
    if os.geteuid() == 0:
        assert policies == [(os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, 10), (os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, 11)]
    suite.hang.write_text("python")
    began = time.monotonic()
    os.kill(pid, signal.SIGUSR1)
    silence_s = suite.stopped(began)
    print(f"stopped after {silence_s:.2f} s")
    assert "beat stopped for" in suite.asked("state")["deadman"]["reason"]


def test_with_nobody_left_to_stop_them_the_propellers_stop_by_themselves(suite):
    """The runtime is frozen, and who would have noticed is dead: what is left is the time-out of the propulsion nodes."""
    pid = suite.runtime_pid()
    suite.bus.bind(CanAddress(messages.sysstat_arb(Node.PROPELLER_STARBOARD)))
    runtime = os.pidfd_open(pid)
    try:
        os.kill(pid, signal.SIGSTOP)
        suite.supervisor.kill()
        began = time.monotonic()
        while not (report := propeller_report(suite.bus)).faults & Fault.NO_COMMAND or report.rpm:
            pass
        stopped_s = time.monotonic() - began
        print(f"stopped by themselves after {stopped_s:.2f} s")
    finally:
        os.kill(pid, signal.SIGCONT)  # now it learns that it is alone, and ends
        assert select.select([runtime], [], [], 60)[0]
        os.close(runtime)


def propeller_report(bus: CanSocket) -> PropellerStatus:
    """The next one; frames that were queued before the socket was bound to reports are others."""
    while (frame := bus.recvmsg()).arb != messages.sysstat_arb(Node.PROPELLER_STARBOARD):
        pass
    report = messages.unpack_sysstat(Node.PROPELLER_STARBOARD, frame.data)
    assert isinstance(report, PropellerStatus)
    return report
