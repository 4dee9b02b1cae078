"""The whole suite as a stranger meets it: where it listens, what holds it up, what it lets out. The daemons' own tests say the
rest: paths, limits, wrong passwords and keys."""

import contextlib
import gzip
import itertools
import json
import os
import select
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from delfim import config
from delfim.base.errors import DelfimError
from delfim.base.input.keys import new_key
from delfim.console.link.mavlink import mavlink
from delfim.services.access.connection_limits import hashed
from delfim.services.access.exposure import doors
from delfim.services.suite import services
from delfim.vehicle.operator.link import Link

pytestmark = [
    pytest.mark.skipif(not shutil.which("curl") or not shutil.which("ssh"), reason="needs curl and ssh"),
]
ROOT = Path(__file__).parents[1]
PASSWORD, MISTAKE = "open-sesame", "close-sesame"
KEPT = hashed(PASSWORD)
SERVICES = ("httpd", "ftpd", "sshd", "cantcpd", "guest")


class Boat(NamedTuple):
    """Under way in simulation, with everything on."""

    folder: Path
    ports: dict[str, int]
    pid: int

    def state(self) -> dict:
        with Link(self.folder / "out/command") as link:
            return link.ask("state")

    def page(self, path: str) -> bytes:
        with urllib.request.urlopen(f"http://127.0.0.1:{self.ports['httpd']}{path}", timeout=200) as answer:
            return bytes(answer.read())

    def curl(self, password: str) -> subprocess.CompletedProcess[str]:
        words = ("curl", "-sS", "--max-time", "20", "-u", f"ana:{password}", f"ftp://127.0.0.1:{self.ports['ftpd']}/")
        return subprocess.run(words, capture_output=True, text=True, timeout=200)

    def ssh(self, key: str) -> subprocess.CompletedProcess[str]:
        options = ("-o", "BatchMode=yes", "-o", "StrictHostKeyChecking=no", "-o", "UserKnownHostsFile=/dev/null")
        words = ("ssh", "-F", "none", *options, "-o", "IdentitiesOnly=yes", "-i", str(self.folder / key))
        return subprocess.run(
            (*words, "-p", str(self.ports["sshd"]), "ana@127.0.0.1", "echo aboard"), capture_output=True, text=True, timeout=200
        )


@pytest.fixture(scope="module")
def boat(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Boat]:
    folder = tmp_path_factory.mktemp("boat")
    shutil.copytree(ROOT / "etc/missions", folder / "missions")
    for key in ("friend", "stranger"):
        subprocess.run(("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", folder / key), check=True)
    with contextlib.ExitStack() as held:
        free = [held.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in SERVICES]
        ports = {name: each.getsockname()[1] for name, each in zip(SERVICES, free, strict=True)}
        for name in ("mavlink", "fleet"):
            door = held.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            door.bind(("127.0.0.1", 0))
            ports[name] = door.getsockname()[1]
    for name in ("guest", "mavlink"):
        new_key(folder / f"{name}.key")
    file = folder / "boat.toml"
    file.write_text(
        (ROOT / "etc/delfimx.toml").read_text()
        + f'[ftpd.users.ana]\npassword = "{KEPT}"\nupload = true\n'
        + f'[sshd.users.ana]\nkeys = ["{(folder / "friend.pub").read_text().strip()}"]\n'
    )
    settings = [f'simulation.{name}="127.0.0.1:{ports[name]}"' for name in ("httpd", "ftpd", "sshd")]
    settings += links_to_others(folder, ports)
    settings += [f'cantcpd.listen=["127.0.0.1:{ports["cantcpd"]}"]', f'guest.listen="127.0.0.1:{ports["guest"]}"']
    settings += [f'guest.key="{folder / "guest.key"}"']
    settings += [f'simulation.interface="canloop:open-{os.getpid()}"', "failsafe.console_silent.after_s=600.0"]
    words = [word for setting in settings for word in ("--set", setting)]
    with (folder / "said").open("w") as said:
        program = [sys.executable, "-m", "delfim", "sim", str(file), "--output", str(folder / "out"), "--for", "300", *words]
        process = subprocess.Popen(program, stdout=said, stderr=said)
        boat = Boat(folder, ports, process.pid)
        try:
            deadline_s = time.monotonic() + 120
            while not all(f"{name}: " in (folder / "said").read_text() for name in ("ftpd", "sshd")) or not sails(boat):
                assert time.monotonic() < deadline_s, (folder / "said").read_text()
                select.select([], [], [], 0.1)
            yield boat
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(40)


def links_to_others(folder: Path, ports: dict[str, int]) -> list[str]:
    """Consoles need a key; no broker and no router are there."""
    here = f"127.0.0.1:{ports['fleet']}"
    mavlink = [
        f'mavlink.listen="127.0.0.1:{ports["mavlink"]}"',
        f'mavlink.peers=["{here}"]',
        f'mavlink.key="{folder}/mavlink.key"',
    ]
    ros = ['ros.router="tcp/127.0.0.1:9"', "ros.commands=true"]
    return [*mavlink, f'fleet.listen="{here}"', 'fleet.broker="mqtt://127.0.0.1:9/tagus"', *ros]


def sails(boat: Boat) -> bool:
    with contextlib.suppress(DelfimError):
        return bool(boat.state()["mode"] == "play")
    return False


def family(pid: int) -> set[int]:
    """A process and all below it."""
    parents = {}
    for place in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            parents[int(place.name)] = int((place / "stat").read_text().rpartition(")")[2].split()[1])
    found = {pid}
    while more := {child for child, parent in parents.items() if parent in found} - found:
        found |= more
    return found


def open_to_the_world(pids: set[int]) -> set[tuple[str, str, int]]:
    """(protocol, address, port) of all that these processes listen on, as the kernel sees it."""
    inodes = set()
    for pid in pids:
        for link in Path(f"/proc/{pid}/fd").glob("*"):
            with contextlib.suppress(OSError):
                inodes.add(os.readlink(link).removeprefix("socket:[").rstrip("]"))
    found = set()
    for protocol, listening in (("tcp", "0A"), ("tcp6", "0A"), ("udp", "07"), ("udp6", "07")):
        for line in Path(f"/proc/net/{protocol}").read_text().splitlines()[1:]:
            _, local, _, state, *rest = line.split()
            if state == listening and rest[5] in inodes:
                address, _, port = local.partition(":")
                found.add(
                    (protocol, socket.inet_ntoa(bytes.fromhex(address)[::-1]) if len(address) == 8 else address, int(port, 16))
                )
    return found


def test_it_listens_where_the_file_says_and_nowhere_else(boat: Boat) -> None:
    host, _, port = boat.state()["mavlink"]["listen"].partition(":")
    udp = {("udp", host, int(port)), ("udp", "127.0.0.1", boat.ports["fleet"])}
    wanted, found = {*udp, *(("tcp", "127.0.0.1", boat.ports[name]) for name in SERVICES)}, set[tuple[str, str, int]]()
    while not wanted <= found:  # the last of them may still start
        found = {each for each in open_to_the_world(family(boat.pid)) if not each[1].startswith("239.")}  # the bus, on loopback
    assert found == wanted
    assert host == "127.0.0.1"


def test_every_door_is_in_the_list_of_check_sea(boat: Boat) -> None:
    listen = {name: f"127.0.0.1:{boat.ports[name]}" for name in SERVICES}
    words = [f'{name}.listen="{place}"' for name, place in listen.items() if name != "cantcpd"]
    words += [f'cantcpd.listen=["{listen["cantcpd"]}"]', *links_to_others(boat.folder, boat.ports)]
    settings = config.load(boat.folder / "boat.toml", words)
    told = {door.place.removesuffix(" UDP") for door in doors(settings, [row.name for row in services(settings)])}
    outside = {place for place in told if place.startswith(("mqtt://", "tcp/"))}  # they are connected to
    assert len(outside) == 3
    wanted, found = told - outside - {settings.console.socket}, set[str]()
    while not wanted <= found:  # the last of them may still start
        found = {f"{host}:{port}" for _, host, port in open_to_the_world(family(boat.pid)) if not host.startswith("239.")}
    assert found == wanted


def test_the_guests_door_opens_to_the_key_alone(boat: Boat) -> None:
    with socket.create_connection(("127.0.0.1", boat.ports["guest"]), 10) as stranger:
        lines = stranger.makefile("rb")
        assert set(json.loads(lines.readline())) == {"challenge"}
        stranger.sendall(b'{"heading_deg": 90, "speed_mps": 2.0}\n')
        assert lines.read() == b""
    assert boat.state()["counts"]["guest_refused"] == 1
    assert boat.state()["age_s"]["guest"] is None
    words = [sys.executable, "-m", "delfim", "guest", str(boat.folder / "boat.toml")]
    words += ["--set", f'guest.listen="127.0.0.1:{boat.ports["guest"]}"', "--set", f'guest.key="{boat.folder / "guest.key"}"']
    with subprocess.Popen(words) as guest:
        try:
            until(lambda: boat.state()["age_s"]["guest"] is not None)
        finally:
            guest.terminate()


def test_slow_visitors_of_all_daemons_leave_the_boat_sailing_and_the_others_served(boat: Boat) -> None:
    """Slow-loris: more connections than one address may have, a byte now and then on each."""
    began = boat.state()["cycle"]
    with contextlib.ExitStack() as held:
        slow = []
        for name in ("httpd", "ftpd", "sshd"):
            for _ in range(20):
                link = socket.create_connection(("127.0.0.1", boat.ports[name]), 10, ("127.0.0.2", 0))
                slow.append(held.enter_context(link))
        until_s = time.monotonic() + 3.0
        while time.monotonic() < until_s:
            for link in slow:
                with contextlib.suppress(OSError):
                    link.send(b"G")
            select.select([], [], [], 0.2)
        assert b"DelfimX" in boat.page("/")
        assert boat.curl(PASSWORD).returncode == 0
        assert boat.ssh("friend").stdout == "aboard\n"
        state = boat.state()
    assert state["mode"] == "play"
    assert state["cycle"] - began > 10
    assert state["deadman"] == {}


def memory_kib(pid: int) -> int:
    """That a process has in use."""
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.partition("VmRSS:")[2].split()[0])


def idle_and_half_open(boat: Boat, held: contextlib.ExitStack) -> None:
    """200 visitors at each door: some say nothing, some half of something, some ask for much and read none of it."""
    words = {
        "httpd": (b"", b"GET / HTTP/1.1\r\nX: " + b"x" * 7000, b"GET /events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"),
        "ftpd": (b"", b"USER " + b"x" * 400, b"STAT\r\n" * 1000),
        "sshd": (b"", b"SSH-2.0-x", b"SSH-2.0-x\r\n" + bytes(30_000)),
        "cantcpd": (b"", b"< open " + b"x" * 400, b"< open can0 >< rawmode >"),
        "guest": (b"", b'{"heading_deg": ' + b"9" * 400, b'{"heading_deg": 90}\n' * 1000),
    }
    for name, n in itertools.product(SERVICES, range(200)):
        link = socket.create_connection(("127.0.0.1", boat.ports[name]), 10, (f"127.0.1.{n % 100 + 1}", 0))
        held.callback(link.close)
        link.setblocking(False)
        with contextlib.suppress(OSError):
            link.send(words[name][n % 3])
    host, _, port = boat.state()["mavlink"]["listen"].partition(":")
    for n in range(200):
        console = held.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        console.connect((host, int(port)))
        console.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3).pack(mavlink.MAVLink(None, 1 + n, 190)))


@pytest.mark.long
def test_two_hundred_idle_and_half_open_visitors_at_each_door_cost_bounded_memory(boat: Boat) -> None:
    before = {name: memory_kib(each["pid"]) for name, each in programs(boat).items()}
    began = boat.state()["cycle"]
    with contextlib.ExitStack() as held:
        idle_and_half_open(boat, held)
        until(lambda: boat.state()["cycle"] > began + 30)
        grown = {name: memory_kib(each["pid"]) - before[name] for name, each in programs(boat).items()}
        assert max(grown.values()) < 8 << 10, grown
    assert (boat.state()["mode"], boat.state()["deadman"]) == ("play", {})


def test_no_secret_is_in_a_log_on_a_page_or_in_a_list_of_processes(boat: Boat) -> None:
    assert boat.curl(PASSWORD).returncode == 0
    assert boat.curl(MISTAKE).returncode == 67
    assert boat.ssh("stranger").returncode == 255
    assert boat.ssh("friend").returncode == 0
    pages = b"".join(map(boat.page, ("/", "/checks", "/metrics", "/api/state", "/api/schema", "/logs/")))
    processes = b"".join(Path(f"/proc/{pid}/cmdline").read_bytes() for pid in family(boat.pid))
    host_key = boat.folder / "out/ssh_host_ed25519"
    secret_lines = [
        *((boat.folder / f"{name}.key").read_bytes().strip() for name in ("guest", "mavlink")),
        *host_key.read_bytes().splitlines()[1:-1],
        *(boat.folder / "friend").read_bytes().splitlines()[1:-1],
    ]
    files = [path for path in (boat.folder / "out").rglob("*") if path.is_file() and path != host_key]
    logged = b"".join(_content(path) for path in files) + (boat.folder / "said").read_bytes()
    assert b"wrong password for 'ana' from 127.0.0.1" in logged
    assert b"wrong key SHA256:" in logged
    assert b'"event":"start"' in logged.replace(b": ", b":"), "the vehicle's file is in the log"
    for secret in (PASSWORD.encode(), MISTAKE.encode(), KEPT.encode(), KEPT.rpartition(":")[2].encode(), *secret_lines):
        assert secret not in pages
        assert secret not in processes
        assert secret not in logged


def _content(path: Path) -> bytes:
    """Of a log that is being written, what can be read."""
    if path.suffix != ".gz":
        return path.read_bytes()
    parts = []
    with contextlib.suppress(EOFError, OSError), gzip.open(path) as file:
        while part := file.read(1 << 16):
            parts.append(part)
    return b"".join(parts)


def programs(boat: Boat) -> dict:
    return dict(json.loads((boat.folder / "out/supervisor.json").read_text())["programs"])


def until(condition: Callable[[], object], within_s: float = 200.0) -> None:
    deadline_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline_s, "it did not happen"
        select.select([], [], [], 0.1)


def test_daemons_that_run_out_of_memory_come_back_and_the_boat_sails_on(boat: Boat) -> None:
    """The kernel ends who has more than its group may have, by SIGKILL, in the middle of whatever it does."""
    before, began, reasons = programs(boat), boat.state()["cycle"], dict[str, str]()

    def died() -> bool:
        now = programs(boat)
        for name in ("ftpd", "sshd"):
            if now[name]["restarts"] > before[name]["restarts"]:
                reasons.setdefault(name, now[name]["reason"])  # the first: one that starts on a busy machine may be silent next
        return len(reasons) == 2

    with contextlib.ExitStack() as held:
        for name in ("ftpd", "sshd"):
            for _ in range(4):
                held.enter_context(socket.create_connection(("127.0.0.1", boat.ports[name]), 10))
            os.kill(before[name]["pid"], signal.SIGKILL)
        until(died)
    assert set(reasons.values()) == {"killed by signal 9 (Killed)"}
    until(lambda: boat.curl(PASSWORD).returncode == 0)
    until(lambda: boat.ssh("friend").stdout == "aboard\n")
    state = boat.state()
    assert (state["mode"], state["deadman"]) == ("play", {})
    assert state["cycle"] > began
    assert programs(boat)["runtime"]["pid"] == before["runtime"]["pid"]


def test_a_supervisor_that_is_stopped_holds_nobody_up(boat: Boat) -> None:
    began, before = boat.state()["cycle"], programs(boat)["runtime"]
    supervisor = json.loads((boat.folder / "out/supervisor.json").read_text())["pid"]
    os.kill(supervisor, signal.SIGSTOP)
    try:
        until(lambda: boat.state()["cycle"] > began + 10)
    finally:
        os.kill(supervisor, signal.SIGCONT)
    until(lambda: boat.state()["cycle"] > began + 20)
    state, after = boat.state(), programs(boat)["runtime"]
    assert (state["mode"], state["deadman"]) == ("play", {})
    assert (after["pid"], after["restarts"]) == (before["pid"], before["restarts"])


@pytest.mark.long
def test_the_page_shows_who_is_at_the_doors(boat: Boat) -> None:
    assert boat.curl(PASSWORD).returncode == 0
    assert boat.ssh("friend").stdout == "aboard\n"
    deadline_s = time.monotonic() + 200
    while True:
        programs = json.loads(boat.page("/api/state"))["computer"]["supervisor"]
        told = programs.get("ftpd", {}).get("figures", {}).get("address") and programs["sshd"]["figures"].get("commands")
        if told and {programs[name]["state"] for name in ("ftpd", "sshd")} == {"running"}:
            break
        assert time.monotonic() < deadline_s, programs
        select.select([], [], [], 0.2)
    for name in ("ftpd", "sshd"):
        assert os.sched_getscheduler(programs[name]["pid"]) == os.SCHED_IDLE
    assert os.sched_getscheduler(programs["runtime"]["pid"]) == os.SCHED_OTHER
