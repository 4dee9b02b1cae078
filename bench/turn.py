"""One turn of a suite in `python -m bench peers`: what is measured of it, and how its processes are looked at."""

import contextlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple, Protocol

from bench.critical_path import cpu_ns

START_S: Final = 60.0  # a suite must have ordered thrust within this time
WATCH_S: Final = 12.0  # for so long an order to stop is waited for after the controller was killed


class Turn(NamedTuple):
    """Of one suite."""

    start_s: float  # from its launch to the first order of thrust
    processor: float  # share of one processor under way
    memory_bytes: int  # PSS of all its processes
    stopped_s: float | None  # from the kill of the controller to the first order to stop; None: not within WATCH_S
    latency_us: list[float]  # ascending; what never came is not in it


class Peer(Protocol):
    label: str

    def turn(self, seconds: float) -> Turn: ...


def spent(pids: Callable[[], list[int]], seconds: float) -> tuple[float, int]:
    """What processes take of one processor in the next seconds, and how much memory they hold in the end (PSS, bytes)."""
    before, began_s = {pid: cpu_ns(pid) for pid in pids()}, time.monotonic()
    time.sleep(seconds)
    now = pids()
    share = sum(cpu_ns(pid) - before.get(pid, 0) for pid in now) / 1e9 / (time.monotonic() - began_s)
    return share, sum(map(_pss_bytes, now))


def _pss_bytes(pid: int) -> int:
    with contextlib.suppress(OSError):
        for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                return 1024 * int(line.split()[1])
    return 0
