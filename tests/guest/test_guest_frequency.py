"""Two boats and one shore, a computer each, and their three radios on one frequency: polled in turn, logs fetched from both
boats at once, a boat out of reach and back."""

import contextlib
import random
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from delfim.services.access.connection_limits import hashed
from tests.guest.harness import ROOT, Guest, guest
from tests.services.frequency import Frequency

pytestmark = pytest.mark.long

BYTES_PER_S = 10_000.0  # 100 kbit/s, 8N1
PORT = "/dev/ttyS0"
BOATS = {"10.0.0.1": 1, "10.0.0.3": 2}  # with their stations
FILE = """
[ftpd]
listen = "0.0.0.0:21"
root = "{root}"

[ftpd.users.ana]
password = "{password}"

[slipd]
device = "{port}"
station = {station}
address = "{address}"
peer = "10.0.0.2"
radio_bps = 100_000
"""


class Afloat(NamedTuple):
    """The computers, and what is between them."""

    air: Frequency
    shore: Guest
    logs: dict[str, bytes]  # of each boat, by its address

    def said(self) -> str:
        return self.shore.run("cat /run/said").output

    def fetch(self) -> None:
        """The logs of both boats at once, whole."""
        words = "curl -sS --retry 60 --retry-delay 1 --retry-all-errors --max-time 120 -u ana:sea"
        gets = "".join(f"{words} -o $FOLDER/{each} ftp://{each}/day.log & p{n}=$!\n" for n, each in enumerate(self.logs))
        result = self.shore.run(f"{gets}wait $p0 && wait $p1", timeout_s=240.0)
        assert result.code == 0, f"{result.output}\n{self.said()}"
        assert {each: (self.shore.folder / each).read_bytes() for each in self.logs} == self.logs


@contextlib.contextmanager
def computer(tmp_path: Path, device: str) -> Iterator[Guest]:
    with guest(tmp_path, modules=("tun",), kernel_args=(f"ssl0=tty:{device}",)) as booted:
        assert booted.run("ip link set lo up; mkdir -p /run/d").code == 0
        yield booted


def aboard(boat: Guest, folder: Path, address: str, station: int, log: bytes) -> None:
    """Its radio and its ftpd, by its file."""
    folder.mkdir()
    (folder / "day.log").write_bytes(log)
    file = folder.with_suffix(".toml")
    table = FILE.format(root=folder, password=hashed("sea"), port=PORT, station=station, address=address)
    file.write_text((ROOT / "etc/delfimx.toml").read_text() + table)
    for service in ("slipd", "ftpd"):
        run = f'runtime.run_directory="/run/d/{service}"'
        boat.run(f"python -m delfim run {file} --service {service} --set '{run}' </dev/null >/run/{service} 2>&1 &")


@pytest.fixture
def afloat(tmp_path: Path) -> Iterator[Afloat]:
    logs = {address: random.Random(station).randbytes(10_000) for address, station in BOATS.items()}
    with contextlib.ExitStack() as stack:
        air = stack.enter_context(contextlib.closing(Frequency(3, BYTES_PER_S)))
        shore, *boats = [stack.enter_context(computer(tmp_path, device)) for device in air.devices]
        for boat, (address, station) in zip(boats, BOATS.items(), strict=True):
            aboard(boat, tmp_path / f"boat{station}", address, station, logs[address])
        names = ",".join(f"{address}={station}" for address, station in BOATS.items())
        words = f"--boats {names} --radio-bps 100000 --turnaround 2"
        shore.run(f"python -m delfim shore {PORT} {words} </dev/null >/run/said 2>&1 &")
        yield Afloat(air, shore, logs)


@pytest.mark.timeout(600)
def test_two_boats_and_one_shore_on_one_frequency(afloat: Afloat) -> None:
    afloat.fetch()
    afloat.air.deaf = {2}
    lost = "no answer from 10.0.0.3 (station 2)"
    told = afloat.shore.run(f"until grep -qF '{lost}' /run/said; do busybox ping -c 1 -w 1 10.0.0.3; done", timeout_s=120.0)
    assert told.code == 0, afloat.said()
    assert afloat.shore.run("busybox ping -c 1 -w 30 10.0.0.1").code == 0, "the other boat is served"
    afloat.air.deaf = set()
    afloat.fetch()
    assert afloat.air.overlaps == 0, "nobody talked over another one"
