"""What the tests of logs share: a disk of a few pages, a way to wait for the writer, and recorded traffic."""

import select
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from delfim.base.clock import ManualClock
from delfim.logging.filelog import FileLog
from delfim.logging.liblog import LogSettings, in_order
from delfim.logging.pipelog import PipeLog
from delfim.logging.reading import read_log

RECORDINGS = Path(__file__).parents[1] / "data" / "nmea2000"


@pytest.fixture
def recordings() -> Path:
    return RECORDINGS


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock(monotonic_s=100.0)  # 2010-01-01 00:00:00 UTC


@pytest.fixture
def file_log(tmp_path: Path, clock: ManualClock) -> Iterator[Callable[..., FileLog]]:
    """Opens a log of files under tmp_path/log, with other settings if asked."""
    logs: list[FileLog] = []

    def opened(*, deflate: bool = False, durable: bool = False, **settings: object) -> FileLog:
        told = {"header": b"", "file_bytes": 1_000_000, "file_s": 600.0, "free_bytes_min": 0, "when_full": "delete-oldest"}
        told |= {"directory": str(tmp_path / "log"), "id": "gps", "suffix": ".log"} | settings
        logs.append(FileLog(LogSettings(**told), clock, deflate=deflate, durable=durable))
        return logs[-1]

    yield opened
    for log in logs:
        log.close()


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 64 KiB in memory."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "delfim", place], capture_output=True, text=True)
    if mounted.returncode:
        pytest.skip(f"this user cannot mount a small disk: {mounted.stderr.strip()}")
    yield place
    subprocess.run(["umount", "-l", place], check=True)


def remount(place: Path, how: str) -> None:
    subprocess.run(["mount", "-o", f"remount,{how}", place], check=True)


def files(directory: Path) -> list[Path]:
    """The log files, oldest first, without their sidecars and chains."""
    return [path for path in in_order(directory.glob("*/*/*")) if not path.name.endswith((".meta.jsonl", ".chain"))]


def content(directory: Path) -> bytes:
    """What all files hold, one after the other."""
    return b"".join(read_log(path)[0] for path in files(directory))


def numbers(directory: Path) -> list[int]:
    """The records of a log whose records are numbered lines, whatever their tails. Lines without an end are none."""
    lines = [line for path in files(directory) for line in read_log(path)[0].splitlines(keepends=True)]
    return [int(line.split()[0]) for line in lines if line.endswith(b"\n")]


def until(log: PipeLog, true: Callable[[], bool], timeout_s: float = 200.0) -> None:
    """Read the writer's reports until something is true."""
    while not true():
        assert select.select([log.status_fileno()], [], [], timeout_s)[0], f"the writer is silent: {log.status()}"
        log.poll()
