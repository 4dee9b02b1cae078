"""Inside the guest: a board without a battery clock. The suite comes up in 1970 and is visited, sessions stay open; then the
other nodes speak, the clock is stepped in idle, and the boat sails.

Prints one JSON object for the test outside.
"""

import argparse
import ftplib
import json
import os
import ssl
import subprocess
import sys
import time
import urllib.request
from itertools import pairwise
from pathlib import Path
from typing import Any

from bench import critical_path
from bench.critical_path import running, until
from bench.soak import TIMEOUT_S, Boat, Visitors
from delfim.base.errors import DelfimError
from delfim.logging.ashore import tree
from delfim.logging.reading import read_log
from delfim.logging.statelog import columns
from delfim.vehicle.operator.link import Link

FOLDER = Path(os.environ["FOLDER"])
BEGAN_S = 100.0  # after 1970
SAIL_S = 8.0


class Ashore(Boat):
    """The suite on can0; the nodes are on the other end of the wire, and come later."""

    def _commands(self) -> tuple[str, ...]:
        return ("supervise",)

    def _begin(self, link: Link) -> None:
        pass

    def _overrides(self) -> list[str]:
        # A busy host makes everybody late, but by no decades. The other nodes and the kernel's part of the network run on the
        # one slow processor, too: beside a runtime in real time they would hardly get it.
        patient = (
            *("navigation.stale_s=30.0", "failsafe.navigation_silent.after_s=30.0", "sysstat.stale_s=30.0"),
            *("supervisor.deadman_s=60.0", "runtime.fifo_priority=0"),
        )
        doors = 'can.interface="can0"', f'ftpd.certificate="{FOLDER}/tls.pem"', "log.free_bytes_min=0"
        return [*super()._overrides(), *doors, *patient]


class TlsVisitors(Visitors):
    def _ftp(self) -> None:
        with logged_in(self._boat) as ftp:
            list(ftp.mlsd("/"))


def logged_in(boat: Boat) -> ftplib.FTP_TLS:
    ftp = ftplib.FTP_TLS(context=ssl._create_unverified_context(), timeout=TIMEOUT_S)
    ftp.connect("127.0.0.1", boat.ports["ftpd"])
    ftp.login("bench", boat.password)
    ftp.prot_p()
    return ftp


class Session:
    """An SSH session that stays open: it repeats the lines it is told."""

    def __init__(self, boat: Boat) -> None:
        options = ("StrictHostKeyChecking=no", "UserKnownHostsFile=/dev/null", "IdentitiesOnly=yes", "LogLevel=ERROR")
        told = [word for each in options for word in ("-o", each)]
        command = ["ssh", "-F", "none", "-i", str(boat.key), *told, "-p", str(boat.ports["sshd"]), "bench@127.0.0.1", "cat"]
        self._ssh = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def repeats(self, line: bytes) -> bool:
        assert self._ssh.stdin
        assert self._ssh.stdout
        self._ssh.stdin.write(line + b"\n")
        self._ssh.stdin.flush()
        return self._ssh.stdout.readline() == line + b"\n"

    def end(self) -> None:
        assert self._ssh.stdin
        self._ssh.stdin.close()
        self._ssh.wait(TIMEOUT_S)


def fetched(boat: Boat, path: str) -> str:
    with urllib.request.urlopen(f"http://127.0.0.1:{boat.ports['httpd']}/{path}", timeout=TIMEOUT_S) as answer:
        return str(answer.read().decode())


def stepped(operator: Link) -> dict[str, Any]:
    """The state once the clock is set."""
    state = operator.ask("state")
    if state["clock"]["off_s"] is None or abs(state["clock"]["off_s"]) > 0.5:
        raise DelfimError(f"the clock is not set: {state['clock']}")
    return state


def main() -> None:
    true_s = time.time() - time.monotonic()
    critical_path.START_S = 100.0  # type: ignore[misc]  # the guest's only processor may be that of a busy host
    certificate = ("openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-subj", "/CN=boat", "-days", "30")
    subprocess.run((*certificate, "-keyout", FOLDER / "tls.key", "-out", FOLDER / "tls.crt"), check=True, capture_output=True)
    (FOLDER / "tls.pem").write_bytes((FOLDER / "tls.key").read_bytes() + (FOLDER / "tls.crt").read_bytes())
    time.clock_settime(time.CLOCK_REALTIME, BEGAN_S)
    (FOLDER / "boat").mkdir()
    nodes = [sys.executable, "tests/guest/sea_nodes.py", str(true_s), "etc/delfimx.toml"]
    nodes += ['can.interface="sea0"', f'runtime.run_directory="{FOLDER}/sea"']
    (FOLDER / "sea").mkdir()
    with Ashore(argparse.Namespace(file="etc/delfimx.toml", set=[]), FOLDER / "boat") as boat:
        boat.bus = "can0"
        visitors, session, ftp = TlsVisitors(boat), Session(boat), logged_in(boat)
        with Link(boat.place / "command") as operator, running(nodes, stdout=subprocess.DEVNULL):
            before = {"ssh": session.repeats(b"before"), "state": operator.ask("state"), "at_s": time.time()}
            state = until(lambda: stepped(operator), "set clock")
            after = {"ssh": session.repeats(b"after"), "ftp": ftp.voidcmd("NOOP"), "state": state}
            until(lambda: operator.ask("heading", heading_deg=150.0, speed_mps=1.2), "heading")
            states, until_s = [], time.monotonic() + SAIL_S
            while time.monotonic() < until_s:
                operator.ask("alive")
                states.append(operator.ask("state"))
                time.sleep(0.5)
            page = fetched(boat, ""), fetched(boat, "metrics"), fetched(boat, "api/state")
            off_s = time.time() - time.monotonic() - true_s
            visitors.end()
        session.end()
        programs = boat.programs()
    files = tree.files([boat.place / "log"])
    moments = columns(file.path for file in files if file.id == "state")["monotonic_s"]
    report = {
        "before": before,
        "after": after,
        "sailed": [{key: state[key] for key in ("mode", "reason", "notices", "clock")} for state in states],
        "off_s": off_s,
        "page": page,
        "restarts": {name: each["restarts"] for name, each in programs.items() if each["restarts"]},
        "visits": visitors.visits,
        "failures": visitors.failures,
        "reasons": visitors.reasons,
        "steps": [event for event in tree.events(files) if event["event"] == "clock step"],
        "files": [os.path.relpath(file.path, boat.place / "log") for file in files],
        "in_order": all(a <= b for a, b in pairwise(moments)),
        "gap_s": max(b - a for a, b in pairwise(sorted(moments))),
        "said": [line for file in files if file.id == "system" for line in read_log(file.path)[0].decode().splitlines()],
    }
    print("REPORT " + json.dumps(report))


main()
