"""The radio's line for real: the kernel's SLIP at the boat's end, ours on a TUN device at the other, a slow wire between."""

import json
import os
import pty
import random
import time
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from delfim.services.access.connection_limits import hashed
from tests.guest.guest_wire import Wire
from tests.guest.harness import ROOT, Guest, guest

pytestmark = pytest.mark.long

BOAT, SHORE, MTU = "10.0.0.1", "10.0.0.2", 296
BYTES_PER_S = 10_000  # 100 kbit/s, 8N1
LINE = "/dev/radio"
LOG = random.Random(1).randbytes(40_000)
INFINITE = float("inf")
ENDED = """if [ -e /run/slipd ]; then
    kill -TERM "$(cat /run/slipd)"
    while [ -e "/proc/$(cat /run/slipd)" ]; do sleep 0.1; done
fi
"""


def sailed(tmp_path: Path, encapsulation: str, mode: str, seconds: float) -> dict[str, Any]:
    with guest(tmp_path, modules=("slip", "tun")) as booted:
        result = booted.run(f"python tests/guest/guest_slip.py {encapsulation} {mode} {seconds}", timeout_s=60 + 12 * seconds)
        assert result.code == 0, result.output
        report: dict[str, Any] = json.loads(result.output.split("REPORT ", 1)[1])
        return report


@pytest.mark.parametrize(("encapsulation", "mode"), [("cslip", "kernel"), ("slip", "user")])
def test_the_line_comes_up_favours_the_console_and_comes_back(tmp_path: Path, encapsulation: str, mode: str) -> None:
    report = sailed(tmp_path, encapsulation, mode, 3.0)
    assert report["interface"].startswith("sl" if mode == "kernel" else "radio")
    medians = report["medians"]
    assert medians["lowdelay_ms"] < medians["loaded_ms"], "an urgent packet overtakes a download"
    assert report["bytes_per_s"] > 0
    assert report["exit_codes"] == [0, 0]


class Radio:
    """Two guests, boat and shore, and the serial line between them."""

    def __init__(self, boat: Guest, shore: Guest, wire: Wire) -> None:
        self.boat, self.shore, self.wire = boat, shore, wire

    def speak(self, encapsulation: str) -> None:
        """Both ends, from now on: the kernel's aboard, ours ashore."""
        for end, mode, address, peer in ((self.boat, "kernel", BOAT, SHORE), (self.shore, "user", SHORE, BOAT)):
            settings = f'device="{LINE}" mode="{mode}" encapsulation="{encapsulation}" address="{address}" peer="{peer}"'
            words = " ".join(f"--set 'slipd.{each}'" for each in f"{settings} mtu={MTU} radio_bps={10 * BYTES_PER_S}".split())
            run = f"python -m delfim run etc/delfimx.toml --service slipd {words} --set 'runtime.run_directory=\"/run/d\"'"
            end.run(f"{ENDED}{run} </dev/null >/run/said 2>&1 &\necho $! >/run/slipd")
        self.reached(60.0)

    def reached(self, limit_s: float) -> float:
        """Until the boat answers the shore."""
        began_s = time.monotonic()
        while self.shore.run(f"busybox ping -c 1 -w 1 {BOAT}").code:
            said = [end.run("cat /run/said; ip addr").output for end in (self.boat, self.shore)]
            assert time.monotonic() - began_s < limit_s, said
        return time.monotonic() - began_s

    def download(self) -> tuple[float, float]:
        """The log, over FTP, whole: (its bytes a second, bytes on the line for each of its own)."""
        (self.shore.folder / "fetched").unlink(missing_ok=True)
        before = self.wire.carried[0]
        form = "%{size_download} %{time_starttransfer} %{time_total}"
        words = f"curl -sS --retry 60 --retry-delay 1 --retry-connrefused -u ana:sea -w '{form}' -o $FOLDER/fetched"
        result = self.shore.run(f"{words} ftp://{BOAT}/day.log", timeout_s=240.0)
        assert result.code == 0, result.output
        size, began_s, ended_s = map(float, result.output.split()[-3:])  # before them: what was tried in vain
        assert (self.shore.folder / "fetched").read_bytes() == LOG
        return size / (ended_s - began_s), (self.wire.carried[0] - before) / size


@pytest.fixture
def radio(tmp_path: Path) -> Iterator[Radio]:
    """Two guests whose serial ports are joined, and ftpd on one of them."""
    (boat_end, boat_port), (shore_end, shore_port) = pty.openpty(), pty.openpty()
    for port in (boat_port, shore_port):
        tty.setraw(port)
    log = tmp_path / "log"
    log.mkdir()
    (log / "day.log").write_bytes(LOG)
    file = tmp_path / "boat.toml"
    users = f'[ftpd]\nlisten = "0.0.0.0:21"\nroot = "{log}"\n[ftpd.users.ana]\npassword = "{hashed("sea")}"\n'
    file.write_text((ROOT / "etc/delfimx.toml").read_text() + users)
    names = [f"ssl0=tty:{os.ttyname(port)}" for port in (boat_port, shore_port)]
    with (
        guest(tmp_path, modules=("slip", "tun"), kernel_args=names[:1]) as boat,
        guest(tmp_path, modules=("slip", "tun"), kernel_args=names[1:]) as shore,
    ):
        for end in (boat, shore):
            end.run(f"python -m tests.guest.guest_wire {LINE} {BYTES_PER_S} </dev/null >/run/wire 2>&1 &")
        boat.run(f"python -m delfim run {file} --service ftpd </dev/null >/run/ftpd 2>&1 &")
        wire = Wire(boat_end, shore_end, (INFINITE, INFINITE))
        yield Radio(boat, shore, wire)
        wire.close()
    for end in (boat_end, boat_port, shore_end, shore_port):
        os.close(end)


@pytest.mark.timeout(600)
def test_two_computers_on_one_line_with_and_without_compressed_headers_and_with_noise(radio: Radio) -> None:
    """The figures are printed (pytest -rP)."""
    radio.speak("slip")
    plain_bps, plain_cost = radio.download()
    radio.speak("cslip")
    bps, cost = radio.download()
    print(f"{10 * BYTES_PER_S} bit/s, MTU {MTU}: {plain_bps:.0f} B/s by SLIP, {bps:.0f} B/s by CSLIP")
    print(f"bytes on the line for each of the log's: {plain_cost:.3f}, {cost:.3f}")
    assert cost < 0.95 * plain_cost, "headers are compressed"
    radio.wire.noise = 1e-4
    radio.download()
    radio.wire.noise = 3e-2  # nothing comes through
    radio.shore.run(f"busybox ping -c 30 -i 0.1 -w 2 {BOAT}")
    radio.wire.noise = 0.0
    radio.reached(60.0)
