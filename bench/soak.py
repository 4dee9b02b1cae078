"""`python -m bench soak`: the whole suite under load for an hour: are memory, descriptors and tasks of its processes flat?

The boat holds its place in simulation, and visitors come, take what they came for, and go, again and again: the page and its
events, the bus by cantcpd, logs by FTP and SFTP, commands by SSH, the command socket; some go in the middle. Flat is what has
not grown from the second third of the time to the last one. docs/benchmark.md
"""

import argparse
import contextlib
import ftplib
import json
import os
import secrets
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections import Counter, defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

from bench.critical_path import command_line, cpu_ns, family, free_ports, running, until
from delfim.base.errors import DelfimError, Refused
from delfim.services.access.connection_limits import hashed
from delfim.vehicle.operator.link import Link

LOOK_S: Final = 5.0  # between two samples; shorter where the whole is short
SAMPLES_MIN: Final = 24
GROWN_BYTES: Final = 4 << 20  # of a process, from one third to the next: less is the allocator's
GROWN: Final = 3  # descriptors, tasks: less is who just came
TIMEOUT_S: Final = 30.0
CROWD: Final = 65536  # bytes of a bus or a log, after which a visitor has seen enough
LOGS_WRITTEN: Final = 3  # at a time: the bus, the state, the system
BUSIEST: Final = 6  # that are told


class Sample(NamedTuple):
    """Of one process, or of all log writers together."""

    memory_bytes: int
    descriptors: int
    tasks: int


def run(asked: argparse.Namespace) -> int:
    """The command. Returns 0 when all is flat, nothing was started again and everybody was served."""
    if absent := [program for program in ("ssh", "sftp", "ssh-keygen") if not shutil.which(program)]:
        raise DelfimError(f"the soak needs {', '.join(absent)}")
    with tempfile.TemporaryDirectory(prefix="delfim-bench-") as name, Boat(asked, Path(name)) as boat:
        samples = defaultdict[str, list[Sample]](list)
        visitors = Visitors(boat)
        count = max(SAMPLES_MIN, round(asked.minutes * 60.0 / LOOK_S))
        for _ in range(count):
            time.sleep(asked.minutes * 60.0 / count)
            for process, sample in boat.samples().items():
                samples[process].append(sample)
        visitors.end()
        restarts = {process: each["restarts"] for process, each in boat.programs().items()}
    rows = [{"process": process, "restarts": restarts.get(process, 0), **grown(its)} for process, its in samples.items()]
    Path(asked.output).mkdir(parents=True, exist_ok=True)
    results = {"minutes": asked.minutes, "rows": rows, "visits": visitors.visits, "failures": visitors.failures}
    (Path(asked.output) / "soak.json").write_text(json.dumps(results, indent=1) + "\n")
    print(_table(rows, asked.minutes))
    for kind in visitors.kinds:
        print(f"  {kind}: {visitors.visits[kind]} visits, {visitors.failures[kind]} in vain {visitors.reasons.get(kind, '')}")
    served_all = all(visitors.visits[kind] > visitors.failures[kind] for kind in visitors.kinds)
    return 0 if served_all and not any(row["grown"] or row["restarts"] for row in rows) else 1


class Boat:
    """The suite and its other nodes, from `__enter__` to `__exit__`."""

    def __init__(self, asked: argparse.Namespace, place: Path) -> None:
        self.place, self.password, self.key = place, secrets.token_hex(8), place / "key"
        self.ports = dict(zip(("httpd", "ftpd", "sshd", "cantcpd"), free_ports(4), strict=True))
        self.bus, self._asked, self._all = f"soak-{os.getpid()}", asked, contextlib.ExitStack()
        self.started: list[subprocess.Popen[bytes]] = []  # its nodes, and last its supervisor

    def __enter__(self) -> "Boat":
        subprocess.run(("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", self.key), check=True)
        words = [word for each in (*self._asked.set, *self._overrides()) for word in ("--set", each)]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": (self.place / "said").open("w")}
        try:
            self._all.callback(quiet["stderr"].close)  # type: ignore[attr-defined]
            for command in self._commands():
                program = [sys.executable, "-m", "delfim", command, self._asked.file, *words]
                self.started.append(self._all.enter_context(running(program, **quiet)))
            with until(lambda: Link(self.place / "command"), "its command socket") as link:
                self._begin(link)
            for name, port in self.ports.items():
                until(lambda port=port: socket.create_connection(("127.0.0.1", port), 1.0).close(), name)
        except BaseException:
            self._all.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._all.close()

    def _commands(self) -> tuple[str, ...]:
        return "nodes", "supervise"

    def _begin(self, link: Link) -> None:
        until(lambda: link.ask("mode", mode="hold"), "hold")

    def _overrides(self) -> list[str]:
        place, listening = self.place, {name: f"127.0.0.1:{port}" for name, port in self.ports.items()}
        return [
            f'can.interface="canloop:{self.bus}"',
            f'console.socket="{place}/command"',
            f'log.directory="{place}/log"',
            f'runtime.run_directory="{place}"',
            'supervisor.hardware_watchdog=""',
            'mavlink.listen="127.0.0.1:0"',
            "mavlink.peers=[]",
            "failsafe.console_silent.after_s=3600.0",
            f'cantcpd.listen=["{listening.pop("cantcpd")}"]',
            *(f'{name}.listen="{address}"' for name, address in listening.items()),
            f'ftpd.root="{place}/log"',
            f'sshd.root="{place}/log"',
            f'sshd.host_key="{place}/host_key"',
            f"ftpd.users.bench.password={json.dumps(hashed(self.password))}",
            f"sshd.users.bench.keys={json.dumps([self.key.with_suffix('.pub').read_text().strip()])}",
        ]

    def programs(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads((self.place / "supervisor.json").read_text())["programs"]
        return found

    def samples(self) -> dict[str, Sample]:
        """Of the supervisor, its programs, and all log writers together."""
        pids = {each["pid"]: name for name, each in self.programs().items()} | {self.started[-1].pid: "supervisor"}
        found: dict[str, Sample] = {}
        for pid in family(self.started[-1].pid):
            name = pids.get(pid, "log writers" if b"delfim.logging.writer" in command_line(pid) else "")
            with contextlib.suppress(OSError):
                memory = int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
                one = Sample(memory, len(os.listdir(f"/proc/{pid}/fd")), self._tasks(name))
                found[name] = Sample(*map(sum, zip(found.get(name, Sample(0, 0, 0)), one, strict=True)))
        found.pop("", None)  # programs that visitors run
        return found

    def processes(self) -> dict[int, str]:
        """Those of this computer that can be seen, by number: a program of the boat by its name in the supervisor, others by
        the kernel's."""
        programs, found = {each["pid"]: name for name, each in self.programs().items()}, {}
        for pid in (int(name) for name in os.listdir("/proc") if name.isdecimal()):
            with contextlib.suppress(OSError):
                found[pid] = programs.get(pid) or Path(f"/proc/{pid}/comm").read_text().strip()
        return found

    def _tasks(self, name: str) -> int:
        if name == "runtime":
            with Link(self.place / "command") as link:
                return int(link.ask("state")["loop"]["tasks"])
        with contextlib.suppress(OSError, ValueError, KeyError):
            return int(json.loads((self.place / f"service-{name}.json").read_text())["tasks"])
        return 0


class Visitors:
    """Each kind in a thread of its own, from the beginning until `end`."""

    def __init__(self, boat: Boat) -> None:
        self._boat, self._ended = boat, threading.Event()
        self.visits, self.failures, self.reasons = Counter[str](), Counter[str](), dict[str, str]()
        self.kinds: dict[str, tuple[Callable[[], object], float]] = {  # and the pause between two visits, s
            "page": (self._page, 1.0),
            "events": (self._events, 1.0),
            "monitor": (self._monitor, 1.0),
            "command socket": (self._command, 0.5),
            "FTP": (self._ftp, 2.0),
            "SSH": (self._ssh, 5.0),
            "SFTP": (self._sftp, 5.0),
        }
        self._threads = [threading.Thread(target=self._come, args=(kind,), daemon=True) for kind in self.kinds]
        for thread in self._threads:
            thread.start()

    def end(self) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join()

    def _come(self, kind: str) -> None:
        visit, pause_s = self.kinds[kind]
        while not self._ended.wait(pause_s):
            self.visits[kind] += 1
            try:
                visit()
            except (OSError, EOFError, ftplib.Error, subprocess.SubprocessError, DelfimError, Refused) as error:
                self.failures[kind] += 1
                self.reasons[kind] = f"({error}; busy then: {busiest(self._boat.processes())})"

    def _page(self) -> None:
        for path in ("", "api/state", "metrics", "logs/"):
            with urllib.request.urlopen(f"http://127.0.0.1:{self._boat.ports['httpd']}/{path}", timeout=TIMEOUT_S) as answer:
                answer.read()

    def _events(self) -> None:
        with urllib.request.urlopen(f"http://127.0.0.1:{self._boat.ports['httpd']}/events", timeout=TIMEOUT_S) as answer:
            for _ in range(10):
                answer.readline()

    def _monitor(self) -> None:
        with socket.create_connection(("127.0.0.1", self._boat.ports["cantcpd"]), TIMEOUT_S) as link:
            link.sendall(f"< open {self._boat.bus} >< rawmode >".encode())
            seen = 0
            while seen < CROWD // 16:
                seen += len(link.recv(CROWD))

    def _command(self) -> None:
        with Link(self._boat.place / "command") as link:
            link.ask("alive")

    def _ftp(self) -> None:
        with contextlib.closing(ftplib.FTP(timeout=TIMEOUT_S)) as ftp:
            ftp.connect("127.0.0.1", self._boat.ports["ftpd"])
            ftp.login("bench", self._boat.password)
            with oldest_log(ftp) as data:
                data.recv(CROWD)  # and away

    def _ssh(self) -> None:
        self._openssh("ssh", "-p", str(self._boat.ports["sshd"]), "bench@127.0.0.1", "echo aboard; ls /proc/self/fd")

    def _sftp(self) -> None:
        batch = "ls -l\nbye\n"
        self._openssh("sftp", "-P", str(self._boat.ports["sshd"]), "-b", "-", "bench@127.0.0.1", said=batch)

    def _openssh(self, program: str, *words: str, said: str = "") -> None:
        options = ["StrictHostKeyChecking=no", "UserKnownHostsFile=/dev/null", "IdentitiesOnly=yes", "LogLevel=ERROR"]
        told = [word for each in options for word in ("-o", each)]
        command = [program, "-F", "none", "-i", str(self._boat.key), *told, *words]
        subprocess.run(command, check=True, input=said.encode(), capture_output=True, timeout=TIMEOUT_S)


def oldest_log(ftp: ftplib.FTP) -> socket.socket:
    """The data of the log that is first by its name. One that gets its right name by a step of the clock, or is deleted to make
    room, is gone though it was listed: then the lists are asked for again. Raises ftplib.Error, OSError."""
    for _ in range(LOGS_WRITTEN):
        with contextlib.suppress(ftplib.error_perm):
            return _first_log(ftp)
    return _first_log(ftp)


def _first_log(ftp: ftplib.FTP) -> socket.socket:
    place = "/"
    while folders := [name for name, facts in ftp.mlsd(place) if facts["type"] == "dir"]:
        place += f"{min(folders)}/"
    return ftp.transfercmd(f"RETR {place}{min((name for name, _ in ftp.mlsd(place)), default='')}")


def busiest(processes: dict[int, str], seconds: float = 1.0) -> str:
    """Which of these processes, by number and name, take most of a processor in the next seconds, each with its share."""
    began_ns = time.monotonic_ns()
    before = {pid: cpu_ns(pid) for pid in processes}
    time.sleep(seconds)
    passed_ns = time.monotonic_ns() - began_ns
    shares = sorted(((cpu_ns(pid) - before[pid]) / passed_ns, name) for pid, name in processes.items())
    return ", ".join(f"{name} {share:.0%}" for share, name in reversed(shares[-BUSIEST:]) if share > 0.0)


def grown(samples: list[Sample]) -> dict[str, Any]:
    """In the second third of the time and in the last one: memory in the middle, the least that was open and under way; and
    what of that has grown."""
    third = len(samples) // 3
    then, now = samples[third : 2 * third], samples[2 * third :]
    row: dict[str, Any] = {"grown": []}
    fields = ("memory_bytes", statistics.median, GROWN_BYTES), ("descriptors", min, GROWN), ("tasks", min, GROWN)
    for field, of, limit in fields:
        before, after = (int(of(getattr(each, field) for each in part)) for part in (then, now))
        row[field] = [before, after]
        if after - before > limit:
            row["grown"].append(field)
    return row


def _table(rows: list[dict[str, Any]], minutes: float) -> str:
    lines = [
        f"{f'{minutes:g} min: second third -> last third':40}{'memory MB':>18}{'descriptors':>16}{'tasks':>12}{'restarts':>10}"
    ]
    for row in rows:
        memory = " -> ".join(f"{each / 1e6:.1f}" for each in row["memory_bytes"])
        counts = [" -> ".join(map(str, row[field])) for field in ("descriptors", "tasks")]
        verdict = f"  {', '.join(row['grown'])} grew" if row["grown"] else ""
        lines.append(f"{row['process']:40}{memory:>18}{counts[0]:>16}{counts[1]:>12}{row['restarts']:>10}{verdict}")
    return "\n".join(lines)
