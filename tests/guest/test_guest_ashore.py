"""The boat's image, booted, as it is met from the shore: page, files, commands, its bus, and its end in order."""

import asyncio
import ftplib
import gzip
import io
import shlex
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import can
import pytest

from delfim.canproxy.dsor.messages import ShutdownAcknowledge, ShutdownStage, pack_shutdown_acknowledge
from delfim.services.access.connection_limits import hashed
from tests.guest import boat_image
from tests.guest.ashore import BOAT, disk, network, started
from tests.guest.pc import PATH, Pc
from tests.services.browser import browser

pytestmark = [pytest.mark.long, pytest.mark.timeout(900)]  # the first one waits for the image to be built
BOOT_S = 120.0
FILE = "/log/boat.toml"
PASSWORD, MISTAKE = "by-the-light-of-the-sea", "by-the-light-of-the-moon"
KEPT = hashed(PASSWORD)
HOST_KEY = "/log/.keys/ssh_host_ed25519"
# Aboard: which lines of standard input are in what is logged. Two files in /log are no logs.
SEARCH = """
import contextlib, gzip, pathlib, sys
logged = bytearray()
for path in pathlib.Path("/log").rglob("*"):
    if path.is_file() and str(path) not in sys.argv:
        with contextlib.suppress(EOFError, OSError), (gzip.open if path.suffix == ".gz" else open)(path, "rb") as file:
            while part := file.read1(65536):
                logged += part
print(*(line for line in sys.stdin.read().split() if line.encode() in logged))
"""


class Boat(NamedTuple):
    console: Pc
    folder: Path
    process: subprocess.Popen[bytes]

    def ssh(self, command: str, **words: object) -> "subprocess.CompletedProcess[str]":
        return subprocess.run(self.ssh_words(command), capture_output=True, text=True, timeout=90, check=False, **words)  # type: ignore[call-overload]

    def sails(self) -> None:
        """It is under way when this returns, whatever went before and however late a busy host makes it."""
        done = self.ssh(f"timeout 80 sh -c 'until delfim drive {FILE} heading 150 1.2; do sleep 0.2; done'")
        assert done.returncode == 0, done.stderr[-2000:] + self.ssh("cat /run/nodes").stdout + self.console.said[-4000:]

    def ssh_words(self, command: str) -> list[str]:
        options = [
            f"UserKnownHostsFile={self.folder}/known",
            "StrictHostKeyChecking=accept-new",
            "IdentitiesOnly=yes",
            "LogLevel=ERROR",
        ]
        words = [word for option in options for word in ("-o", option)]
        return ["ssh", "-F", "none", "-i", f"{self.folder}/key", *words, f"ana@{BOAT}", command]


def log_partition(folder: Path) -> Path:
    """An ext2 disk with the vehicle's file and a host key for sshd, so that nothing but the image itself is in the image."""
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", "ana", "-f", folder / "key"], check=True)
    text = (boat_image.ROOT / "etc" / "delfimx.toml").read_text()
    changes = {'"can0"': '"vcan0"', "required = true": "required = true\nfree_bytes_min = 1_000_000"}
    changes |= {"after_s = 10.0": "after_s = 600.0", "stale_s = 1.0": "stale_s = 10.0"}  # a busy host makes everybody late
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    text += f"""
[sysstat]
stale_s = 10.0
[failsafe.navigation_silent]
after_s = 10.0
[supervisor]
deadman_s = 60.0
[httpd]
listen = "{BOAT}:80"
[cantcpd]
listen = ["{BOAT}:29536"]
watch = ["10.77.0.0/24"]
transmit = ["10.77.0.0/24"]
barred = ["040-043", "0A0"]
[ftpd]
listen = "{BOAT}:21"
[ftpd.users.ana]
password = "{KEPT}"
upload = true
[sshd]
listen = "{BOAT}:22"
[sshd.users.ana]
keys = ["{(folder / "key.pub").read_text().strip()}"]
"""
    (folder / "log").mkdir()
    (folder / "log" / "boat.toml").write_text(text)
    return disk(folder / "log.img", folder / "log")


@pytest.fixture(scope="module")
def boat(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Boat]:
    if reason := boat_image.missing():
        pytest.skip(reason)
    image = boat_image.build()
    folder = tmp_path_factory.mktemp("ashore")
    words = [f"VEHICLE={FILE}", "MODULES=vcan,can-raw"]
    log = log_partition(folder)
    with network(), started(folder, image / "initramfs-guest.gz", log, words) as (console, process):
        booted = Boat(console, folder, process)
        booted.console.wait_for("ssh://", BOOT_S)
        booted.ssh(f"setsid delfim nodes {FILE} >/run/nodes 2>&1 </dev/null &")
        yield booted


def test_a_command_has_its_streams_and_its_exit_status(boat: Boat) -> None:
    done = boat.ssh("cat; echo wrong >&2; exit 7", input="right\n")
    assert (done.returncode, done.stdout, done.stderr) == (7, "right\n", "wrong\n")
    words = boat.ssh_words("while read line; do echo heard $line; done")
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1) as talk:
        assert talk.stdin is not None
        assert talk.stdout is not None
        for word in ("one", "two"):  # each is answered before the next is said
            talk.stdin.write(f"{word}\n")
            assert talk.stdout.readline() == f"heard {word}\n"
        talk.stdin.close()
    assert talk.returncode == 0


def test_the_page_is_seen_in_a_browser(boat: Boat) -> None:
    boat.sails()

    async def look() -> tuple[str, bytes]:
        async with asyncio.timeout(120), browser(boat.folder / "browser") as page:
            await page.open(f"http://{BOAT}/", width=390, height=844)
            await page.until("document.body.innerText.toLowerCase().includes('heading')", timeout_s=60)
            return str(await page.value("document.body.innerText")), await page.picture()

    text, picture = asyncio.run(look())
    (boat.folder / "page.png").write_bytes(picture)
    assert "DelfimX" in text


def test_logs_come_and_files_go_over_ftp(boat: Boat) -> None:
    with ftplib.FTP(BOAT, timeout=60) as ftp:
        ftp.login("ana", PASSWORD)
        day = next(name for name, facts in ftp.mlsd() if facts["type"] == "dir" and name.isdecimal())
        name = next(name for name, _ in ftp.mlsd(f"{day}/vcan0") if name.endswith(".log.gz"))
        held = io.BytesIO()
        ftp.retrbinary(f"RETR {day}/vcan0/{name}", held.write)
        assert held.getvalue()[:2] == b"\x1f\x8b"
        ftp.storbinary("STOR upload/new.image", io.BytesIO(b"no image"))
        assert ftp.size("upload/new.image") == 8


def test_no_secret_is_in_the_image_in_a_log_or_on_a_page(boat: Boat) -> None:
    with ftplib.FTP(BOAT, timeout=60) as ftp, pytest.raises(ftplib.error_perm):
        ftp.login("ana", MISTAKE)
    boat.ssh("echo that is all >/dev/console")
    boat.console.wait_for("that is all", 60)
    assert "wrong password for 'ana'" in boat.console.said
    keys = boat.ssh(f"cat {HOST_KEY}").stdout + (boat.folder / "key").read_text()
    secrets = [PASSWORD, MISTAKE, KEPT, KEPT.rpartition(":")[2], *(line for line in keys.splitlines() if "-----" not in line)]
    assert len(secrets) > 10
    image = gzip.decompress((boat_image.FOLDER / "initramfs-guest.gz").read_bytes())
    pages = b"".join(map(page, ("/", "/checks", "/metrics", "/api/state", "/api/schema", "/logs/")))
    for secret in secrets:
        assert secret not in boat.console.said
        assert secret.encode() not in pages
        assert secret.encode() not in image
    search = f"python3 -c {shlex.quote(SEARCH)} {FILE} {HOST_KEY}"
    found = boat.ssh(search, input="\n".join(["DelfimX", *secrets])).stdout.split()
    assert found == ["DelfimX"], "what is logged names the boat"


def page(path: str) -> bytes:
    with urllib.request.urlopen(f"http://{BOAT}{path}", timeout=60) as answer:
        return bytes(answer.read())


def test_an_image_is_not_installed_under_way(boat: Boat) -> None:
    boat.sails()
    done = boat.ssh(f"delfim image {FILE} install /log/upload/new.image")
    refusal = "delfim: image install refused: the boat is under way, in mode heading\n"
    assert (done.returncode, done.stderr) == (1, refusal), boat.console.said[-4000:]
    assert boat.ssh(f"delfim drive {FILE} idle").returncode == 0


def test_its_bus_is_a_bus_of_python_can_and_the_shutdown_frame_ends_it(boat: Boat) -> None:
    """Acknowledged, when it begins and when it is safe, switched off, and the log partition clean. A program that stays in
    the guest to the end tells on its console what is on the bus: cantcpd ends in between."""
    boat.ssh("cd /; setsid delfim can dump -L vcan0,040:7FE,0C9:7FF >/dev/console 2>&1 </dev/null &")
    boat.console.wait_for(" 040#", 60)  # it listens
    with can.Bus(interface="socketcand", channel="vcan0", host=BOAT, port=29536) as bus:
        deadline_s = time.monotonic() + 60
        seen = set[int]()
        while len(seen) < 3:
            assert time.monotonic() < deadline_s, seen
            if (message := bus.recv(1.0)) is not None:
                seen.add(message.arbitration_id)
        bus.send(can.Message(arbitration_id=0x0C8, data=bytes.fromhex("FE5AF10F00"), is_extended_id=False))
        boat.console.wait_for(acknowledged(ShutdownStage.BEGUN), 60)
    boat.console.wait_for(acknowledged(ShutdownStage.SAFE), 60)
    code = boat.process.wait(60)
    assert code == 0, (boat.process.stdout.read() if boat.process.stdout else b"").decode(errors="replace")[-6000:]
    check = ["e2fsck", "-n", "-f", str(boat.folder / "log.img")]
    done = subprocess.run(check, capture_output=True, text=True, env={"PATH": PATH}, check=False)
    assert done.returncode == 0, done.stdout
    assert "not cleanly" not in done.stdout + done.stderr


def acknowledged(stage: ShutdownStage) -> str:
    return f" 0C9#{pack_shutdown_acknowledge(ShutdownAcknowledge(stage, 0)).hex().upper()}"
