"""The power fails while the boat sails and logs under load. The kernel is a real one, its disk a file, its death SIGKILL: what
it had not handed to the disk is gone."""

import gzip
import json
import os
import random
import select
import shutil
import subprocess
from pathlib import Path

import can
import pytest

from delfim.base.modes import Mode
from delfim.logging.ashore.repair import repair
from delfim.logging.ashore.tree import LogFile, files
from delfim.logging.candump import parse_line
from delfim.logging.kept.record import newest
from delfim.logging.kept.writer import VOYAGE
from delfim.logging.reading import read_log
from delfim.logging.statelog import columns, read_state
from tests.guest.harness import PATH, guest, missing

pytestmark = pytest.mark.long

LOST_S = 1.0
LAST = 60  # records of the state log: three seconds
SIZE = 64 << 20


@pytest.fixture(scope="module")
def disk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log partition; it lives through all cuts."""
    if reason := missing():
        pytest.skip(reason)
    image = tmp_path_factory.mktemp("disk") / "log.img"
    image.touch()
    os.truncate(image, SIZE)
    tool("mke2fs", "-q", "-t", "ext2", "-F", str(image))
    return image


def tool(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, env={"PATH": PATH}, capture_output=True, text=True, timeout=60)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    metafunc.parametrize("cut", range(metafunc.config.getoption("--cuts")))


def test_a_power_cut_costs_a_second_and_no_human(disk, tmp_path, cut, request):
    frames_per_s = request.config.getoption("--frames-per-s")
    ended_s = power_cut(disk, tmp_path, frames_per_s, random.Random(cut).uniform(0.0, 3.0))
    check = tool("e2fsck", "-f", "-p", str(disk))
    assert check.returncode in (0, 1), f"a human is asked for: {check.stdout}"
    place = tmp_path / "log"
    place.mkdir()
    tool("debugfs", "-R", f"rdump / {place}", str(disk))
    assert not list((place / "lost+found").iterdir())
    found = files([place])
    for file in found:
        repair(file)
    lost_s = {}
    for id_ in ("state", "vcan0", "gps", "system"):
        its = [file for file in files([place]) if file.id == id_]
        assert its
        for file in its:
            opens(file)
        lost_s[id_] = round(ended_s - max(last_s(file) for file in its[-2:]), 3)
    print(f"cut {cut}: missing, s: {lost_s}, of {len(found)} files; voyage in mode {kept(place)}")
    assert max(lost_s.values()) <= LOST_S
    shutil.rmtree(place)


def kept(place: Path) -> str:
    """The mode of the voyage that the next boot goes on with: one that the boat was in at the end, by its log."""
    _, record = newest([str(place)], VOYAGE, b"")
    assert record is not None
    mode = str(json.loads(record.split(b"\n")[1])["mode"])
    its = [file.path for file in files([place]) if file.id == "state"]
    logged = columns(its[-2:])
    last = {Mode(number).name.lower() for number in logged["mode"][-LAST:]}
    assert mode in last
    return mode


def power_cut(disk: Path, folder: Path, frames_per_s: int, after_s: float) -> float:
    """Boot, sail, log, and die after so long. Returns the guest's last sign of life: a busy host may have stopped it before."""
    with guest(folder, kernel_args=(f"ubd0={disk}",)) as boat:
        result = boat.run(f"python tests/guest/guest_cut.py {frames_per_s} /dev/ubda 200_000", timeout_s=90.0)
        assert result.code == 0, result.output
        select.select([], [], [], after_s)
    return float((boat.folder / "alive").read_text())


def opens(file: LogFile) -> None:
    """With readers that know nothing of power cuts."""
    with gzip.open(file.path) as content:
        is_empty = not content.read()  # of a file that had just begun not even its header may be on the disk
    assert subprocess.run(["zcat", file.path], stdout=subprocess.DEVNULL, timeout=60).returncode == 0
    if file.id == "state":
        assert is_empty or not read_state(file.path).complaint
    elif file.id == "vcan0":
        with can.LogReader(file.path) as reader:
            for _ in reader:
                pass


def last_s(file: LogFile) -> float:
    """When the last thing in it happened; 0 where nothing did."""
    if file.id == "state":
        return max((t1 / 1e9 for t1 in columns([file.path]).get("t1", [])), default=0.0)
    lines = read_log(file.path)[0].decode().splitlines()
    if file.id in ("gps", "system"):
        return max((json.loads(line)["t_ns"] / 1e9 for line in lines), default=0.0)
    return max((parse_line(line)[1].t_ns / 1e9 for line in lines[-3:]), default=0.0)
