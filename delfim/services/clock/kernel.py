"""The computer's clock as the kernel has it, and the battery clock (RTC) beside it: read, stepped, slewed, written.

Standard library only: the supervisor reads the battery clock before its programs start, and writes it after they ended.
Linux only. Other keepers of the clock, and how they are found: docs/clock.md.
"""

import ctypes
import fcntl
import logging
import os
import struct
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from delfim.base.clock import MADE_NS

KEEPERS: Final = ("chronyd", "ntpd", "openntpd", "systemd-timesyn", "ptp4l", "phc2sys")  # as /proc/PID/comm has them
CAP_SYS_TIME: Final = 25
BATTERY: Final = "the battery clock"
RTC: Final = Path("/dev/rtc0")
_SINGLESHOT: Final = 0x8001  # ADJ_OFFSET_SINGLESHOT of sys/timex.h: 0.5 ms a second until it is done
_UNSYNCHRONISED, _DISCIPLINED = 0x0040, 0x000F  # STA_UNSYNC; STA_PLL, STA_PPSFREQ, STA_PPSTIME, STA_FLL
_RTC_SET_TIME: Final = 0x4024700A  # linux/rtc.h
_RTC_TIME: Final = struct.Struct("9i")

log = logging.getLogger(__name__)


class Timex(ctypes.Structure):
    """The beginning of `struct timex` (adjtimex(2)), and room for the rest."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_char * 256),
    )

    @property
    def synchronised(self) -> bool:
        return not self.status & _UNSYNCHRONISED


class KernelClock:
    """CLOCK_REALTIME of the kernel. Each call takes microseconds."""

    def __init__(self) -> None:
        self._libc = ctypes.CDLL(None, use_errno=True)

    def read(self) -> Timex:
        """The kernel's data of its clock. Raises OSError."""
        return self._adjtimex(Timex())

    def disciplined(self) -> bool:
        """Whether a program has tuned the kernel's clock since the start of the computer; Delfim never does."""
        try:
            found = self.read()
        except OSError:
            return False
        return found.synchronised or found.freq != 0 or bool(found.status & _DISCIPLINED)

    def step(self, by_s: float) -> None:
        """Step the clock. Raises OSError."""
        time.clock_settime_ns(time.CLOCK_REALTIME, time.time_ns() + round(by_s * 1e9))

    def slew(self, by_s: float) -> None:
        """Slew the clock, in place of what was left of the slew before. Raises OSError."""
        self._adjtimex(Timex(modes=_SINGLESHOT, offset=round(by_s * 1e6)))

    def _adjtimex(self, timex: Timex) -> Timex:
        if self._libc.adjtimex(ctypes.byref(timex)) < 0:
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number))
        return timex


def left_alone(mode: str, buses: Sequence[str], proc: Path = Path("/proc")) -> str:
    """The reason, in words, why this program must not set the clock; empty: it may. `mode` is `clock.set` of the vehicle's
    file."""
    if mode == "never":
        return 'not set: clock.set = "never"'
    if any(bus.startswith(("vcan", "canloop:")) for bus in buses):
        return "not set: the bus is simulated"
    if other := keeper(proc):
        return f"kept by {other}"
    if not may_set(proc):
        return "not set: this program may not (CAP_SYS_TIME)"
    return ""


def keeper(proc: Path = Path("/proc")) -> str:
    """The name of another program that keeps the clock; empty: none runs. Takes milliseconds."""
    names = {_read(proc / pid / "comm").strip() for pid in os.listdir(proc) if pid.isdecimal()}
    return next((name for name in KEEPERS if name in names), "")


def may_set(proc: Path = Path("/proc")) -> bool:
    """Whether this process has CAP_SYS_TIME."""
    found = [line.split()[1] for line in _read(proc / "self/status").splitlines() if line.startswith("CapEff:")]
    return bool(found) and bool(int(found[0], 16) >> CAP_SYS_TIME & 1)


def battery_ns(sysfs: Path = Path("/sys")) -> int | None:
    """The time of the battery clock, to a second; None where there is none or it has lost its time. Takes milliseconds."""
    text = _read(sysfs / "class/rtc/rtc0/since_epoch").strip()
    return int(text) * 1_000_000_000 if text.isdecimal() else None


def set_from_battery(mode: str, buses: Sequence[str]) -> None:
    """Set a clock that was never set from the battery clock, before anything else runs, if that can be."""
    if time.time_ns() >= MADE_NS or left_alone(mode, buses):
        return
    found_ns = battery_ns()
    if found_ns is None:
        log.info("clock: never set, and there is no battery clock")
    elif found_ns < MADE_NS:
        log.warning("clock: %s says %s, before this program was made: it is not taken", BATTERY, _date(found_ns))
    else:
        time.clock_settime_ns(time.CLOCK_REALTIME, found_ns)
        log.info("clock: set by %s to %s", BATTERY, _date(found_ns))


def write_battery(mode: str, buses: Sequence[str], rtc: Path = RTC) -> None:
    """Write the clock's time to the battery clock, at the end, unless the clock was never set or another program keeps both."""
    now_ns = time.time_ns()
    if now_ns < MADE_NS or not rtc.exists() or left_alone(mode, buses) or KernelClock().disciplined():
        return
    utc = time.gmtime(round(now_ns / 1e9))
    words = _RTC_TIME.pack(utc.tm_sec, utc.tm_min, utc.tm_hour, utc.tm_mday, utc.tm_mon - 1, utc.tm_year - 1900, 0, 0, 0)
    try:
        fd = os.open(rtc, os.O_RDONLY | os.O_CLOEXEC)
        try:
            fcntl.ioctl(fd, _RTC_SET_TIME, words)
        finally:
            os.close(fd)
        log.info("clock: %s set to %s", BATTERY, _date(now_ns))
    except OSError as error:
        log.warning("clock: %s: %s", rtc, error.strerror)


def _date(utc_ns: int) -> str:
    return time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(utc_ns // 1_000_000_000))


def _read(path: Path) -> str:
    """Read a small file; empty where there is none: processes come and go, and a battery clock without a time has an error to
    read."""
    try:
        return path.read_text(errors="replace")
    except OSError:
        return ""
