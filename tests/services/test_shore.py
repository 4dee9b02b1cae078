"""The shore's end of the radio's line, as programs in networks of their own: two boats and one shore on one frequency, and one
boat alone."""

import contextlib
import os
import pty
import random
import signal
import subprocess
import sys
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from delfim.__main__ import main
from tests.guest.guest_wire import Wire
from tests.services.frequency import Frequency

ROOT = Path(__file__).parents[2]
BYTES_PER_S = 10_000.0  # 100 kbit/s, 8N1
BOATS = ("10.0.0.1", "10.0.0.3")
LOG = random.Random(1).randbytes(10_000)


def has_networks() -> bool:
    """Whether this computer gives programs networks and TUN devices of their own."""
    return os.path.exists("/dev/net/tun") and subprocess.run(("unshare", "-n", "true"), capture_output=True).returncode == 0


needs_networks = pytest.mark.skipif(not has_networks(), reason="needs root, network namespaces and TUN")


class Program:
    """`delfim ...` in a network of its own. `said` is what `says` has read of its standard error."""

    def __init__(self, *words: str) -> None:
        command = ("unshare", "-n", sys.executable, "-m", "delfim", *words)
        self._process = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True)
        self.said = ""

    def inside(self, *words: str) -> tuple[str, ...]:
        """The command in the program's network."""
        return ("nsenter", "-t", str(self._process.pid), "-n", *words)

    def says(self, words: str) -> None:
        """Waits until it has said so, since the last time."""
        assert self._process.stderr is not None
        for line in self._process.stderr:
            self.said += line
            if words in line:
                return
        raise AssertionError(self.said)

    def end(self) -> int:
        self._process.send_signal(signal.SIGTERM)
        self.said += self._process.communicate(timeout=200)[1]
        return self._process.returncode


@contextlib.contextmanager
def boat(folder: Path, name: str, device: str, **settings: object) -> Iterator[Program]:
    """slipd alone, and the log for whoever fetches it."""
    settings |= {"device": device, "peer": "10.0.0.2", "radio_bps": 100_000}
    words = [word for key, value in settings.items() for word in ("--set", f"slipd.{key}={value!r}")]
    run = f'runtime.run_directory="{folder / name}"'
    program = Program("run", "etc/delfimx.toml", "--service", "slipd", "--set", run, *words)
    program.says("is up on")
    (folder / "files").mkdir(exist_ok=True)
    (folder / "files/log").write_bytes(LOG)
    served = program.inside(sys.executable, "-m", "http.server", "80", "--directory", str(folder / "files"))
    with subprocess.Popen(served, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as server:
        try:
            yield program
        finally:
            server.terminate()
            assert program.end() == 0


@contextlib.contextmanager
def ashore(*words: str) -> Iterator[Program]:
    program = Program("shore", *words, "--radio-bps", "100000", "--turnaround", "1")
    try:
        yield program
    finally:
        assert program.end() == 0, program.said


def fetch(shore: Program, address: str, more: str = "") -> subprocess.Popen[bytes]:
    words = ("curl", "-sS", "--max-time", "60", "--retry", "30", "--retry-delay", "1", "--retry-all-errors")
    return subprocess.Popen(shore.inside(*words, f"http://{address}/log{more}"), stdout=subprocess.PIPE)


@pytest.mark.long
@needs_networks
def test_two_boats_and_one_shore_share_a_frequency(tmp_path: Path) -> None:
    with (
        contextlib.closing(Frequency(3, BYTES_PER_S)) as air,
        ashore(air.devices[0], "--boats", f"{BOATS[0]}=1,{BOATS[1]}=2") as shore,
        boat(tmp_path, "one", air.devices[1], address=BOATS[0], station=1),
        boat(tmp_path, "two", air.devices[2], address=BOATS[1], station=2) as two,
    ):
        air.deaf = {2}
        two.says("no poll for station 2")
        shore.says(": no answer from 10.0.0.3 (station 2)")
        assert fetch(shore, BOATS[0]).communicate(timeout=90)[0] == LOG, "the other boat is served"
        air.deaf = set()
        shore.says(": up")
        fetched = [fetch(shore, address) for address in BOATS]
        assert [each.communicate(timeout=90)[0] == LOG for each in fetched] == [True, True]
        assert air.overlaps == 0, "nobody talked over another one"


@needs_networks
def test_one_boat_alone_needs_no_station(tmp_path: Path) -> None:
    ends = [pty.openpty() for _ in range(2)]
    for _, port in ends:
        tty.setraw(port)
    devices = [os.ttyname(port) for _, port in ends]
    with (
        contextlib.closing(Wire(ends[0][0], ends[1][0], (BYTES_PER_S, BYTES_PER_S))),
        ashore(devices[0], "--boats", BOATS[0]) as shore,
        boat(tmp_path, "one", devices[1], address=BOATS[0]),
    ):
        assert fetch(shore, BOATS[0]).communicate(timeout=90)[0] == LOG
    for pair in ends:
        for each in pair:
            os.close(each)


@pytest.mark.parametrize(
    ("boats", "more", "reason"),
    [
        ("10.0.0.1,10.0.0.3", (), "--boats: of several boats each needs a station"),
        ("10.0.0.1=1,10.0.0.3=1", (), "another boat has this address or this station"),
        ("10.0.0.1=255", (), "a station is a number from 1 to 254"),
        ("10.0.0.1=one", (), "is not ADDRESS=STATION"),
        ("10.0.1.1=1", (), "is not another address of 10.0.0.0/24"),
        ("10.0.0.1=1", ("--address", "ashore"), "is not ADDRESS/PREFIX"),
        ("10.0.0.1=1", ("--turnaround", "0"), "0 is not from 0.005 to 5 s"),
        ("10.0.0.1=1", ("--mtu", "20"), "slipd.mtu"),
    ],
)
def test_what_cannot_be_is_refused_in_words(boats, more, reason, capsys):
    assert main(("shore", "/dev/null", "--boats", boats, *more)) == 2
    assert reason in capsys.readouterr().err
