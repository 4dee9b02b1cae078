"""A boat that `delfim commission` made: each door of which it tells a command is open to whoever types that command ashore."""

import asyncio
import contextlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import NamedTuple

import aiohttp
import pytest

from delfim import config
from delfim.__main__ import main
from delfim.base.ranges import address
from delfim.commands.description.new import asked_of_parts
from delfim.services.access.exposure import doors
from delfim.services.suite import services
from tests.guest.ashore import alone

ROOT = Path(__file__).parents[2]
SHIPPED = [*sorted((ROOT / "etc/boats").glob("*.toml")), ROOT / "etc/delfimx.toml", ROOT / "etc/delfimx-sea.toml"]
OURS = [f"{motors} {sensors}" for motors, sensors in product(*asked_of_parts())]
BOAT, SHORE = "192.168.5.10", "192.168.5.20"
WORDS = ("--yes", "--users", "ana", "--radio", "", "--console", SHORE, "--network", f"{BOAT}/24")
PATIENCE_S = 200.0
HAS_NETWORKS = all(map(shutil.which, ("unshare", "lftp", "ssh", "curl"))) and not subprocess.call(("unshare", "-n", "true"))


def written(boat: str, folder: Path) -> str:
    """The vehicle's file of a name above."""
    if boat.startswith("/"):
        return boat
    motors, sensors = boat.split()
    assert main(["new", str(folder / "boat.toml"), "--yes", "--motors", motors, "--sensors", sensors]) == 0
    return str(folder / "boat.toml")


@pytest.mark.parametrize("boat", [*map(str, SHIPPED), *OURS], ids=lambda boat: boat.rpartition("/")[2])
def test_whoever_types_what_was_told_finds_a_door_there(boat: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = tmp_path / "made"
    assert main(["commission", written(boat, tmp_path), "--output", str(made), *WORDS]) == 0
    told = capsys.readouterr().out.partition("To the operator's computer")[2]
    settings = config.load(made / "boat/boat.toml")
    found = doors(settings, [row.name for row in services(settings)])
    listening = {each.service: address(each.place.removesuffix(" UDP")) for each in found if each.reach != "here"}
    typed = {"mavlink": 14555} if re.search(r"delfim console --boats 0.0.0.0:14550", told) else {}
    for service, usual, pattern in (
        ("sshd", 22, r"ssh (?:-p (\d+) )?.*ana@"),
        ("ftpd", 21, r"lftp (?:-p (\d+) )?-u ana .*"),
        ("httpd", 80, rf"browser: http://{BOAT}(?::(\d+))?/"),
        ("cantcpd", 0, rf"delfim can dump socketcand:{BOAT}:(\d+):can\d"),
    ):
        if command := re.search(pattern, told):
            typed[service] = int(command[1] or usual)
    assert {name: ("0.0.0.0", port) for name, port in typed.items()} == {
        name: place for name, place in listening.items() if name != "guest"
    }
    assert {"mavlink", "sshd", "ftpd", "httpd"} <= set(typed)
    assert settings.mavlink.peers == (f"{SHORE}:14550",)
    assert "10.0.0." not in told
    assert main(["check", "--sea", str(made / "boat/boat.toml")]) == 0
    said = capsys.readouterr().err
    assert "no console can reach this boat" not in said
    assert "cannot be reached" not in said
    assert "simulation.mission" not in said, "the mission goes aboard and ashore with the file"


class Aboard(NamedTuple):
    commands: list[str]  # that were told, to be typed ashore
    made: Path
    folder: Path

    def typed(self, begins: str, instead: str, more: str = "", **words: str) -> str:
        """What the command says that begins so, with more options in its beginning and words at its end."""
        command = instead + next(each for each in self.commands if each.startswith(begins)).removeprefix(begins) + more
        told = {"input": "cls -1 /\nbye\n", "capture_output": True, "text": True, "env": os.environ | words}
        done = subprocess.run(command, shell=True, timeout=PATIENCE_S, check=False, **told)
        assert done.returncode == 0, f"{command}: {done.stderr}"
        return str(done.stdout)


@pytest.fixture(scope="module")
def aboard(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Aboard]:
    """A boat of `delfim new` under its supervisor in a network of its own, with a wire to this thread's."""
    folder = tmp_path_factory.mktemp("opened")
    made, file = folder / "made", written("esc usb", folder)
    words = [sys.executable, "-m", "delfim", "commission", file, "--output", str(made), *WORDS]
    told = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    ashore = told.partition("To the operator's computer")[2]
    commands = re.findall(r"^    (?:browser: )?(\S.*)$", ashore, re.MULTILINE)
    for place in ("log", "run"):
        (folder / place).mkdir()
    aboard = {"mavlink.key": "mavlink.key", "ftpd.certificate": "ftpd.pem", "sshd.host_key": "ssh_host_ed25519"}
    values = {key: made / "boat" / name for key, name in aboard.items()}
    values |= dict.fromkeys(("log.directory", "ftpd.root", "sshd.root"), folder / "log")
    values |= {"runtime.run_directory": folder / "run", "console.socket": folder / "command"}
    more = [word for key, value in values.items() for word in ("--set", f"{key}={value}")]
    start = 'echo ready; read wired; exec "$@"'
    program = [sys.executable, "-m", "delfim", "supervise", str(made / "boat/boat.toml"), *more]
    with alone():
        boat = subprocess.Popen(
            ["unshare", "-n", "sh", "-c", start, "sh", *program], cwd=ROOT, stdin=-1, stdout=-1, stderr=-2, text=True
        )
        assert boat.stdin is not None
        assert boat.stdout is not None
        assert boat.stdout.readline() == "ready\n"
        there = ("nsenter", "-t", str(boat.pid), "-n")
        for line in (
            (f"ip link add shore0 type veth peer name eth0 netns {boat.pid}", ()),
            (f"ip address add {SHORE}/24 dev shore0", ()),
            ("ip link set shore0 up", ()),
            ("ip link set lo up", there),
            (f"ip address add {BOAT}/24 dev eth0", there),
            ("ip link set eth0 up", there),
        ):
            subprocess.run([*line[1], *line[0].split()], check=True)
        boat.stdin.write("wired\n")
        boat.stdin.flush()
        try:
            doors_ahead = {"httpd: http://", "ftpd: ftp://", "sshd: ssh://"}
            while doors_ahead:
                line = boat.stdout.readline()
                assert line, f"the boat ended without {doors_ahead}"
                doors_ahead -= {each for each in doors_ahead if line.startswith(each)}
            yield Aboard(commands, made, folder)
        finally:
            boat.terminate()
            boat.communicate(timeout=PATIENCE_S)


needs_networks = pytest.mark.skipif(not HAS_NETWORKS, reason="needs root, network namespaces, lftp, ssh and curl")


@needs_networks
@pytest.mark.long
def test_the_page(aboard: Aboard) -> None:
    assert "<title>" in aboard.typed("http", "curl -sS --max-time 20 http")


@needs_networks
def test_programs_by_ssh(aboard: Aboard) -> None:
    assert aboard.typed("ssh", "ssh -F none -o BatchMode=yes", " echo aboard") == "aboard\n"


@needs_networks
def test_files_by_ftp(aboard: Aboard) -> None:
    password = (aboard.made / "shore/ana.password").read_text().strip()
    assert "upload" in aboard.typed("lftp", "lftp --env-password", LFTP_PASSWORD=password)


@needs_networks
def test_the_console_hears_the_boat(aboard: Aboard) -> None:
    words = next(each for each in aboard.commands if each.startswith("delfim console")).split()[1:]
    words += ["--no-browser", "--page", "127.0.0.1:0", "--number", "201"]
    words += [word for each in ("missions", "charts", "sessions", "token") for word in (f"--{each}", str(aboard.folder / each))]

    async def hears(url: str) -> None:
        async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as session, asyncio.timeout(PATIENCE_S):
            async with session.get(url):
                pass
            async with session.ws_connect(url.partition("?")[0] + "ws") as page:
                while True:
                    for boat in (await page.receive_json()).get("boats", []):
                        if boat["name"] == "boat":
                            return

    console = subprocess.Popen([sys.executable, "-u", "-m", "delfim", *words], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    with contextlib.closing(console.stdout) as said:  # type: ignore[type-var]
        assert said is not None
        try:
            url = said.readline().split("the console is at ")[1].split(";")[0].strip()
            asyncio.run(hears(url))
        finally:
            console.terminate()
            console.wait(200)


def test_a_boat_that_no_console_can_reach_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = tmp_path / "made"
    file = written("esc usb", tmp_path)
    assert main(["commission", file, "--output", str(made), *WORDS, "--set", 'mavlink.listen="127.0.0.1:14555"']) == 0
    assert "delfim console" not in capsys.readouterr().out
    assert main(["check", "--sea", str(made / "boat/boat.toml")]) == 0
    said, here = capsys.readouterr().err, "mavlink.listen is 127.0.0.1:14555"
    assert f"warning: no console can reach this boat: {here}, which only this computer reaches" in said
    assert f"warning: mavlink.peers: {SHORE}:14550 cannot be reached, for {here}" in said


def test_without_a_radio_the_operators_computer_must_be_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = written("esc usb", tmp_path)
    assert main(["commission", file, "--output", str(tmp_path / "made"), "--yes", "--users", "ana"]) == 2
    assert "--console is missing: Address of the operator's computer" in capsys.readouterr().err
