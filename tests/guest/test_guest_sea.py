"""A commissioned boat: the image with exactly the files that `delfim commission` wrote, on a board without a battery clock,
from /init to a mission by console. Every door is used from ashore with the key that belongs to it, and tried without.

The board's hardware is played: the other CAN nodes are at the far end of can0, and know the time; the radio is a serial line.
Nobody types anything aboard.
"""

import asyncio
import contextlib
import gzip
import json
import os
import pty
import select
import shlex
import shutil
import socket
import subprocess
import sys
import time
import tty
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import aiohttp
import can
import pytest

from delfim.__main__ import main
from delfim.console.link.mavlink import mavlink
from tests.guest import boat_image
from tests.guest.ashore import BOAT, disk, network, started
from tests.guest.guest_wire import Wire
from tests.guest.pc import PATH, Pc

pytestmark = [
    pytest.mark.long,
    pytest.mark.timeout(900),  # the first one waits for the image to be built
    pytest.mark.skipif(not shutil.which("lftp") or not shutil.which("curl"), reason="needs lftp and curl"),
]
BOOT_S, PATIENCE_S = 180.0, 180.0  # a busy host
CLOCK_S = 30.0  # asked over a busy host
RADIO, CONSOLE = "10.0.0.1", "10.0.0.2"
BYTES_PER_S = 10_000.0  # of the radio: 100 kbit/s
PATIENT = (  # a busy host makes everybody late
    *("navigation.stale_s=10.0", "failsafe.navigation_silent.after_s=10.0", "failsafe.console_silent.after_s=60.0"),
    *("failsafe.navigation_frozen.after_s=30.0", "failsafe.thruster.after_s=30.0"),
    *("sysstat.stale_s=10.0", "supervisor.deadman_s=60.0"),
)
HARDWARE = """
date -s @100 >/dev/null # no battery clock
modprobe can-dev; insmod /vxcan.ko; ip link add can0 type vxcan peer name sea0; ip link set sea0 up
"""
COUNTS = 'from delfim.vehicle.operator.link import Link; print(Link("/run/delfim/command").ask("state")["mavlink"]["counts"])'
NODES = Path(__file__).with_name("sea_nodes.py")
MISSION = {
    "name": "first",
    "waypoints": [{"latitude_deg": 38.6910, "longitude_deg": -9.2153}, {"latitude_deg": 38.6910, "longitude_deg": -9.2158}],
    "fence": [],
    "obstacles": [],
    "home": None,
}


class Boat(NamedTuple):
    console: Pc
    made: Path  # what `delfim commission` wrote
    folder: Path

    def shore(self, name: str) -> str:
        return str(self.made / "shore" / name)

    def ssh(self, command: str, key: str | None = None, **words: Any) -> "subprocess.CompletedProcess[str]":
        options = f"UserKnownHostsFile={self.shore('known_hosts')}", "IdentitiesOnly=yes", "LogLevel=ERROR", "BatchMode=yes"
        told = [word for option in options for word in ("-o", option)]
        program = ["ssh", "-F", "none", "-i", key or self.shore("ana.key"), *told, f"ana@{BOAT}", command]
        return subprocess.run(program, capture_output=True, text=True, timeout=90, check=False, **words)

    def lftp(self, commands: str, password: str | None = None) -> "subprocess.CompletedProcess[str]":
        settings = (
            f"set ftp:ssl-force true; set ssl:ca-file {self.shore('boat.crt')}; set net:max-retries 1; set net:timeout 60"
        )
        password = password or Path(self.shore("ana.password")).read_text().strip()
        program = ["lftp", "-u", f"ana,{password}", "-e", f"{settings}; {commands}; bye", BOAT]
        return subprocess.run(program, capture_output=True, text=True, timeout=150, check=False)

    def state(self) -> dict[str, Any]:
        return dict(json.loads(page("/api/state"))["vehicle"])

    def until(self, is_so: Callable[[dict[str, Any]], object], words: str) -> dict[str, Any]:
        deadline_s, state = time.monotonic() + PATIENCE_S, {}
        while not (state and is_so(state)):
            assert time.monotonic() < deadline_s, f"{words}: {state}"
            with contextlib.suppress(OSError):
                state = self.state()
            select.select([], [], [], 0.2)
        return state


def page(path: str, host: str = BOAT) -> bytes:
    with urllib.request.urlopen(f"http://{host}{path}", timeout=60) as answer:
        return bytes(answer.read())


def archive(files: dict[str, bytes]) -> bytes:
    """Of the "newc" format: laid over the image's own files."""
    found = b""
    for number, (name, content) in enumerate([*files.items(), ("TRAILER!!!", b"")]):
        numbers = (number, 0o100755, 0, 0, 1, 0, len(content), 0, 0, 0, 0, len(name) + 1, 0)
        head = b"070701" + b"".join(b"%08X" % each for each in numbers) + name.encode() + b"\0"
        found += head + bytes(-len(head) % 4) + content + bytes(-len(content) % 4)
    return found


def board(image: Path, folder: Path) -> Path:
    """The image on a board whose hardware is played: /init first makes what the kernel of a real one would have found."""
    modules = next(boat_image.KERNELS.iterdir())
    init = (boat_image.ROOT / "etc/init").read_text()
    assert init.count("\nlate()") == 1
    files = {"init": init.replace("\nlate()", f"{HARDWARE}late()").encode()}
    files["vxcan.ko"] = (modules / "kernel/drivers/net/can/vxcan.ko").read_bytes()
    whole = (image / "initramfs-guest.gz").read_bytes()
    (folder / "initrd").write_bytes(whole + bytes(-len(whole) % 4) + gzip.compress(archive(files)))
    return folder / "initrd"


def commissioned(folder: Path) -> Path:
    words = ["--yes", "--name", "Sailor", "--network", f"{BOAT}/24", "--interface", "vec0", "--radio", "/dev/ttyS0"]
    words += ["--users", "ana", *(word for one in PATIENT for word in ("--set", one))]
    assert main(["commission", str(boat_image.ROOT / "etc/delfimx-sea.toml"), "--output", str(folder / "made"), *words]) == 0
    return folder / "made"


@contextlib.contextmanager
def radio(boat_port: int, boat_end: int, made: Path, folder: Path) -> Iterator[None]:
    """The line and its end ashore, as the command told to type it."""
    shore_end, shore_port = pty.openpty()
    for port in (boat_port, shore_port):
        tty.setraw(port)
    wire = Wire(boat_end, shore_end, (BYTES_PER_S, BYTES_PER_S))
    words = ["run", str(made / "shore/boat.toml"), "--service", "slipd"]
    values = "slipd.mode=user", f"slipd.device={os.ttyname(shore_port)}", f"slipd.address={CONSOLE}", f"slipd.peer={RADIO}"
    words += [word for one in (*values, f"runtime.run_directory={folder}") for word in ("--set", one)]
    with (folder / "slipd").open("w") as said, running(*words, stderr=said):
        yield
    wire.close()


@contextlib.contextmanager
def running(*words: str, **more: Any) -> Iterator["subprocess.Popen[str]"]:
    """A command of the operator's, until the test has seen enough."""
    program = subprocess.Popen([sys.executable, "-u", "-m", "delfim", *words], text=True, cwd=boat_image.ROOT, **more)
    try:
        yield program
    finally:
        program.terminate()
        program.communicate(timeout=30)


@pytest.fixture(scope="module")
def boat(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Boat]:
    if reason := boat_image.missing():
        pytest.skip(reason)
    image, folder = boat_image.build(), tmp_path_factory.mktemp("sea")
    made = commissioned(folder)
    shutil.copytree(made / "boat", folder / "log/.boat")
    boat_end, boat_port = pty.openpty()
    words = ["VEHICLE=/log/.boat/boat.toml", "MODULES=can-raw,slip", f"ssl0=tty:{os.ttyname(boat_port)}"]
    log = disk(folder / "log.img", folder / "log", 192)
    with network(), started(folder, board(image, folder), log, words) as (console, _), radio(boat_port, boat_end, made, folder):
        console.wait_for("ssh://", BOOT_S)
        sailor = Boat(console, made, folder)
        uptime_s = float(sailor.ssh("cat >/run/nodes.py; cat /proc/uptime", input=NODES.read_text()).stdout.split()[0])
        nodes = f"setsid python3 /run/nodes.py {time.time() - uptime_s} /log/.boat/boat.toml"
        sailor.ssh(f"{nodes} can.interface=sea0 runtime.run_directory=/run/sea >/run/nodes 2>&1 </dev/null &")
        yield sailor


@pytest.fixture(scope="module")
def afloat(boat: Boat) -> Boat:
    """It hears its nodes, and knows the time."""
    boat.until(
        lambda state: {each["name"] for each in state["checks"] if not each["ok"]} == {"link"}, "checks but for the console's"
    )
    return boat


def test_nobody_typed_anything_and_the_file_is_the_one_that_was_written(boat: Boat) -> None:
    assert boat.ssh("cat /log/.boat/boat.toml").stdout == (boat.made / "boat/boat.toml").read_text()
    assert boat.ssh("ls -ld /log/.boat | cut -c1-10; id -u").stdout.split() == ["drwx------", "0"]


def test_a_mission_is_sailed_by_console_over_the_radio_from_1970_on(afloat: Boat) -> None:
    today_s = float(afloat.ssh("date +%s").stdout)
    assert abs(today_s - time.time()) < CLOCK_S, "its clock was set by the bus"
    before = afloat.state()

    def ours(message: dict[str, Any]) -> dict[str, Any]:
        return next((one for one in message.get("boats", []) if one["id"] == 2), {})

    async def sail(url: str) -> None:
        async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as session, asyncio.timeout(PATIENCE_S):
            async with session.get(url):
                pass
            async with session.ws_connect(url.partition("?")[0] + "ws") as there:

                async def told(is_so: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
                    while not is_so(message := await there.receive_json()):
                        pass
                    return dict(message)

                async def do(seq: int, **words: Any) -> None:
                    await there.send_json({"seq": seq, "boat": 2, **words})
                    answer = await told(lambda message: message["t"] == "answer" and message["seq"] == seq)
                    assert answer["ok"], answer

                await told(lambda message: ours(message).get("latitude_deg"))
                for seq, words in enumerate(
                    ({"do": "save", "mission": MISSION}, {"do": "load", "name": "first"}, {"do": "upload"})
                ):
                    await do(seq, t="mission", **words)
                await do(8, t="command", command="play")
                await told(lambda message: ours(message).get("mode") == "play")
                north_deg = before["latitude_deg"] + 1e-4  # 11 m
                await told(lambda message: (ours(message).get("latitude_deg") or 0.0) > north_deg)
                await do(9, t="command", command="stop")

    key, file = afloat.shore("mavlink.key"), afloat.shore("boat.toml")
    words = ["console", "--boats", "0.0.0.0:14550", "--key", key, "--vehicle", file, "--no-browser", "--page", "127.0.0.1:0"]
    words += [word for each in ("missions", "charts", "sessions", "token") for word in (f"--{each}", str(afloat.folder / each))]
    with running(*words, stdout=subprocess.PIPE) as console:
        assert console.stdout is not None
        line = console.stdout.readline()
        asyncio.run(sail(line.split("the console is at ")[1].split(";")[0].strip()))
    afloat.until(lambda state: state["mode"] == "idle", "idle")


def test_who_does_not_sign_commands_nothing_by_wire_or_radio(afloat: Boat) -> None:
    forged = mavlink.MAVLink(None, 250, 190)
    for host in (BOAT, RADIO):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            for message in (mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3), mavlink.MAVLink_set_mode_message(2, 1, 5)):
                stranger.sendto(message.pack(forged), (host, 14555))
    deadline_s = time.monotonic() + PATIENCE_S
    while "'unsigned': 4" not in (told := afloat.ssh(f"python3 -c {shlex.quote(COUNTS)}").stdout):
        assert time.monotonic() < deadline_s, told
    assert afloat.state()["mode"] == "idle"


def test_programs_run_for_whoever_has_a_key(boat: Boat) -> None:
    done = boat.ssh("echo aboard; exit 7")
    assert (done.stdout, done.returncode) == ("aboard\n", 7)
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", boat.folder / "stranger"], check=True)
    assert boat.ssh("echo aboard", key=str(boat.folder / "stranger")).returncode == 255


def test_files_come_and_go_by_tls_for_whoever_has_the_password(boat: Boat) -> None:
    (boat.folder / "plan.txt").write_text("north\n")
    done = boat.lftp(f"put -O upload {boat.folder}/plan.txt; cat upload/plan.txt; cls -1")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("north\n")
    assert ".boat" not in done.stdout
    assert boat.lftp("cat .boat/boat.toml").returncode != 0, "no service gives out keys"
    assert boat.lftp("cls", password="sesame").returncode != 0
    plain = subprocess.run(
        ["curl", "-sS", "-u", "ana:x", f"ftp://{BOAT}/"], capture_output=True, text=True, timeout=60, check=False
    )
    assert plain.returncode == 67, "no password in the clear"


def test_the_page_is_for_everybody_and_changes_nothing(boat: Boat) -> None:
    curl = subprocess.run(["curl", "-sS", f"http://{BOAT}/"], capture_output=True, text=True, timeout=60, check=True)
    assert "Sailor" in curl.stdout
    for path, method, code in (("/logs/.boat/boat.toml", "GET", 404), ("/", "POST", 405)):
        with pytest.raises(urllib.error.HTTPError) as refused:
            urllib.request.urlopen(urllib.request.Request(f"http://{BOAT}{path}", method=method), timeout=60)
        with refused.value as answer:
            assert answer.code == code


def test_the_bus_may_be_watched_and_not_written_to(afloat: Boat) -> None:
    with can.Bus(interface="socketcand", channel="can0", host=BOAT, port=29536) as bus:
        assert bus.recv(60.0) is not None
        bus.send(can.Message(arbitration_id=0x123, data=b"\1", is_extended_id=False))
        deadline_s = time.monotonic() + PATIENCE_S
        while b'"refused":1' not in page("/api/state").replace(b" ", b""):
            assert time.monotonic() < deadline_s
            select.select([], [], [], 0.5)
        seen = [bus.recv(1.0) for _ in range(50)]
    assert 0x123 not in {message.arbitration_id for message in seen if message}


def test_the_guest_is_who_has_its_key(afloat: Boat) -> None:
    words = ["guest", afloat.shore("boat.toml"), "--set", f"guest.listen={BOAT}:4747"]
    with socket.create_connection((BOAT, 4747), 60) as stranger:
        stranger.sendall(b'{"heading_deg": 90, "speed_mps": 2.0}\n')
        with stranger.makefile() as said:
            lines = [list(json.loads(line)) for line in said]
    assert lines == [["challenge"]], "the stranger heard nothing of the boat"
    assert afloat.state()["age_s"]["guest"] is None
    with running(*words, "--set", f"guest.key={afloat.made}/guest/guest.key"):
        afloat.until(lambda state: state["age_s"]["guest"] is not None, "the guest is heard")


def test_the_radio_leads_to_the_same_doors(boat: Boat) -> None:
    assert b"Sailor" in page("/", RADIO)
    stranger = ["ssh", "-F", "none", "-i", str(boat.folder / "none"), "-o", "BatchMode=yes", "-o", "StrictHostKeyChecking=no"]
    done = subprocess.run([*stranger, f"ana@{RADIO}", "echo aboard"], env={"PATH": PATH}, capture_output=True, check=False)
    assert done.returncode == 255
