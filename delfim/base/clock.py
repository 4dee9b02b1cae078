"""The clocks. Code that needs the time is given a clock and never asks the operating system itself.

Two times exist: `monotonic_s` for ages and intervals, which never steps, and `time_ns` for stamps that people and the
kernel share (CLOCK_REALTIME), which steps when it is set (docs/clock.md).
"""

import time
from typing import Final, Protocol

MADE_NS: Final = 1_767_225_600_000_000_000  # 2026-01-01, the year of this version: no time before it is the present


class Clock(Protocol):
    def monotonic_s(self) -> float: ...
    def time_ns(self) -> int: ...


class SystemClock:
    """The computer's own clocks. The methods are the bare C functions: no frame of Python between caller and clock."""

    monotonic_s = staticmethod(time.monotonic)
    time_ns = staticmethod(time.time_ns)


class WakefulClock:
    """The clock of a computer that may sleep, such as a laptop: `monotonic_s` counts the sleep. `time.monotonic` does not on
    Linux and macOS: old data would look fresh after the sleep. CLOCK_BOOTTIME counts it on Linux, CLOCK_MONOTONIC on macOS,
    and `time.monotonic` on Windows.
    """

    time_ns = staticmethod(time.time_ns)

    def monotonic_s(self) -> float:
        return time.monotonic() if _BOOT is None else time.clock_gettime(_BOOT)


_BOOT: int | None = getattr(time, "CLOCK_BOOTTIME", getattr(time, "CLOCK_MONOTONIC", None))


class ManualClock:
    """A clock that stands still until it is advanced: for tests and lock-step simulation."""

    def __init__(self, monotonic_s: float = 0.0, time_ns: int = 1_262_304_000_000_000_000) -> None:
        self._elapsed_ns = round(monotonic_s * 1e9)
        self._epoch_ns = time_ns - self._elapsed_ns

    def monotonic_s(self) -> float:
        return self._elapsed_ns / 1e9

    def time_ns(self) -> int:
        return self._epoch_ns + self._elapsed_ns

    def advance(self, seconds: float) -> None:
        self._elapsed_ns += round(seconds * 1e9)

    def step(self, seconds: float) -> None:
        """Step the wall clock alone, as a GPS fix after boot does."""
        self._epoch_ns += round(seconds * 1e9)
