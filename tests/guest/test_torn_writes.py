"""A disk with a cache of its own loses its power: of what it was given since the last flush, any part is on it, in any order,
and the last block torn. The kernel writes down every block that it gives to the disk (dm-log-writes), while the boat sails and
logs; from that many crashed disks are made."""

import random
import shutil
import struct
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import pytest

from delfim.logging.ashore.repair import repair
from delfim.logging.ashore.tree import files
from tests.guest.harness import PATH, guest, missing
from tests.guest.test_power_cut import LOST_S, kept, last_s, opens, tool

pytestmark = pytest.mark.long

SIZE, LOG_SIZE = 32 << 20, 1 << 30
CRASHES_A_CUT = 4  # --cuts is 3 where nothing else is said
STILL_S = 0.2  # between two marks: the machine stood still, and all logs with it
MAGIC, SECTOR = 0x6A736677736872, 512  # drivers/md/dm-log-writes.c
FLUSH, DISCARD, MARK = 1, 4, 8
RECORD = """
modprobe dm-log-writes && mkdir -p /dev/mapper && { [ -e /dev/mapper/control ] || mknod /dev/mapper/control c 10 236; } &&
dmsetup create disk --noudevsync --table "0 $(blockdev --getsz /dev/ubda) log-writes /dev/ubda /dev/ubdb" && dmsetup mknodes &&
python tests/guest/guest_cut.py 2000 /dev/mapper/disk 10_000 && python tests/guest/guest_mark.py disk 4
"""


class Entry(NamedTuple):
    """A block that the disk was given, or a word of ours."""

    at: int  # bytes
    flags: int
    data: bytes


def entries(log: Path) -> Iterator[Entry]:
    """What dm-log-writes wrote down: a super block, then a sector for each entry with its data behind it."""
    with log.open("rb") as file:
        magic, _, count, sector = struct.unpack("<QQQI", file.read(28))
        assert magic == MAGIC
        at = sector
        for _ in range(count):
            file.seek(at)
            start, sectors, flags, length = struct.unpack("<QQQQ", file.read(32))
            at += sector
            if flags & MARK:
                yield Entry(0, flags, file.read(length).rstrip(b"\0"))
            elif flags & DISCARD:
                yield Entry(start * sector, flags, b"")
            else:
                file.seek(at)
                yield Entry(start * sector, flags, file.read(sectors * sector))
                at += sectors * sector


def written(image: bytearray, entry: Entry) -> None:
    image[entry.at : entry.at + len(entry.data)] = entry.data


def crashed(image: bytearray, epoch: list[Entry], chance: random.Random) -> bytearray:
    """The disk with some of what came after its last flush."""
    result = bytearray(image)
    some = chance.sample(epoch, chance.randint(0, len(epoch)))
    for number, entry in enumerate(some):
        torn = chance.randint(0, len(entry.data) // SECTOR) * SECTOR if number == len(some) - 1 else len(entry.data)
        written(result, entry._replace(data=entry.data[:torn]))
    return result


def crashes(base: Path, log: Path, count: int, chance: random.Random) -> Iterator[tuple[bytearray, float, float]]:
    """Crashed disks, the time of each crash, and how long the machine itself had stood still in the seconds before it."""
    every = list(entries(log))
    marks = [(number, float(entry.data)) for number, entry in enumerate(every) if entry.flags & MARK]
    flushes = [number for number, entry in enumerate(every) if entry.flags & FLUSH and not entry.flags & MARK]
    ends = [(begin, end) for begin, end in pairwise(flushes) if sum(number < end for number, _ in marks) > 20]
    chosen = sorted(chance.choices(ends, k=count))
    image, done = bytearray(base.read_bytes()), 0
    for begin, end in chosen:
        for entry in every[done : begin + 1]:
            if not entry.flags & MARK:
                written(image, entry)
        done = begin + 1
        epoch = [entry for entry in every[begin + 1 : end + 1] if entry.data and not entry.flags & MARK]
        times_s = [time_s for number, time_s in marks if number < end]
        pauses_s = (b - a for a, b in pairwise(times_s[-40:]))
        yield crashed(image, epoch, chance), times_s[-1], sum(pause_s for pause_s in pauses_s if pause_s > STILL_S)


def test_torn_and_reordered_writes_cost_a_second_and_no_human(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    if reason := missing():
        pytest.skip(reason)
    if not shutil.which("dmsetup", path=PATH):
        pytest.skip("dmsetup is missing (make system installs it on Debian)")
    disk, base, log = (tmp_path / name for name in ("disk", "base", "log"))
    for path, size in ((disk, SIZE), (log, LOG_SIZE)):
        path.touch()
        with path.open("r+b") as file:
            file.truncate(size)
    tool("mke2fs", "-q", "-t", "ext2", "-F", str(disk))
    shutil.copy(disk, base)
    with guest(tmp_path, kernel_args=(f"ubd0={disk}", f"ubd1={log}")) as boat:
        result = boat.run(RECORD, timeout_s=150.0)
        assert result.code == 0, result.output
    lost, by_force, count = [], 0, CRASHES_A_CUT * request.config.getoption("--cuts")
    for number, (image, at_s, still_s) in enumerate(crashes(base, log, count, random.Random(1))):
        crash = tmp_path / f"crash{number}"
        crash.write_bytes(image)
        by_force += mended(crash)
        lost.append((lost_s(crash, at_s), still_s))
        crash.unlink()
    words = ", ".join(f"{each:.2f}" + (f" ({still:.2f} of them stood still)" if still else "") for each, still in lost)
    print(f"measured: missing after {len(lost)} crashes, s: {words}; {by_force} by e2fsck -y")
    assert max(each - still for each, still in lost) <= LOST_S


def mended(disk: Path) -> bool:
    """As the boat's init does it. Returns whether it took force."""
    force = bool(tool("e2fsck", "-f", "-p", str(disk)).returncode & 4)
    if force:
        tool("e2fsck", "-f", "-y", str(disk))
    assert tool("e2fsck", "-f", "-n", str(disk)).returncode == 0
    return force


def lost_s(disk: Path, at_s: float) -> float:
    """Of the log of which most is missing; all of them open with the readers of others."""
    place = disk.with_name(f"{disk.name}.log")
    place.mkdir()
    tool("debugfs", "-R", f"rdump / {place}", str(disk))
    for file in files([place]):
        repair(file)
    result = 0.0
    for id_ in ("state", "vcan0", "gps"):
        its = [file for file in files([place]) if file.id == id_]
        assert its, f"the log {id_} is gone"
        for file in its:
            opens(file)
        result = max(result, at_s - max(last_s(file) for file in its))
    kept(place)
    shutil.rmtree(place)
    return result
