"""Decides when the computer's clock is stepped, when it is slewed, and which time it is to have (docs/clock.md).

Times of all sources are handed in as UTC minus monotonic time, which a step of the computer's clock does not change. (A slew
turns both clocks of the kernel faster or slower.) No clock is read and none is set here. `look` is called about once a second.
"""

import statistics
from collections import deque
from datetime import UTC, datetime
from typing import Final, Literal, NamedTuple

from msgspec.structs import replace

from delfim.base.clock import MADE_NS
from delfim.vehicle.report import ClockStatus

TIME_FRAME: Final = "the time frame"  # the source that is taken first: its stamp is the kernel's
HEARD_S: Final = 3.0  # a source that was silent for longer tells no time
SAMPLES: Final = 8  # of a source, one a second
ENOUGH: Final = 5  # of them, before a source is believed
STEADY_S: Final = 0.5  # that the samples of a source may differ
AGREE_S: Final = 1.0  # that two sources may differ: navigation's time is up to a second late
STEP_S: Final = 0.5  # a smaller difference is slewed; the kernel does that at 0.5 ms a second
SLEW_EVERY_S: Final = 8.0
DRIFT: Final = 2e-4  # of a computer's clock that is left alone, generously
LATEST_S: Final = 20 * 365.25 * 86_400.0  # after the year of this version

Fault = Literal["", "implausible", "unsteady", "disagree", "late", "jump"]


class Correction(NamedTuple):
    """A correction of the clock."""

    do: Literal["step", "slew"]
    by_s: float  # positive: forward
    source: str


class _Times:
    """The last samples of one source."""

    def __init__(self) -> None:
        self.offsets_ns: deque[int] = deque(maxlen=SAMPLES)
        self.at_s = 0.0

    def median_ns(self) -> int:
        return statistics.median_low(self.offsets_ns)

    def spread_s(self) -> float:
        return (max(self.offsets_ns) - min(self.offsets_ns)) / 1e9


class ClockKeeper:
    """Disciplines the clock: one step in a run at most, in idle, and only while the clock was not yet right in this run; later
    it slews.

    kept: who keeps the clock, in words. fault: the kind of `status.fault`.
    """

    def __init__(self, kept: str) -> None:
        self.status = ClockStatus(kept)
        self.fault: Fault = ""
        self._times: dict[str, _Times] = {}
        self._right_s: float | None = None  # when the clock was last right; None: not in this run
        self._slewed_s = -SLEW_EVERY_S

    def tell(self, source: str, offset_ns: int, at_s: float) -> None:
        """Take a source's UTC minus monotonic time, and when it was received (monotonic). The names of sources are few."""
        times = self._times.setdefault(source, _Times())
        if at_s - times.at_s > HEARD_S:
            times.offsets_ns.clear()
        times.offsets_ns.append(offset_ns)
        times.at_s = at_s

    def look(self, own_ns: int, now_s: float, *, idle: bool, may_set: bool) -> Correction | None:
        """The correction that is due; `own_ns` is the computer's UTC minus monotonic time. After a step it counts as made."""
        self._say("", "")
        believed = self._believed(now_s)
        if not believed:
            self.status = replace(self.status, off_s=None)
            return None
        source, offset_ns = believed[0]
        off_s = (own_ns - offset_ns) / 1e9
        self.status = replace(self.status, source=source, off_s=off_s)
        if len(believed) > 1 and abs(differ_s := (offset_ns - believed[1][1]) / 1e9) > AGREE_S:
            self._say("disagree", f"{source} is {_seconds(differ_s)} off {believed[1][0]}: neither is taken")
            return None
        if abs(off_s) <= AGREE_S:
            self.status = replace(self.status, is_right=True)
        return self._due(source, off_s, now_s, idle) if may_set else None

    def _due(self, source: str, off_s: float, now_s: float, idle: bool) -> Correction | None:
        if self._right_s is None and abs(off_s) > STEP_S:
            if not idle:
                self._say("late", f"it is {_seconds(off_s)} off {source} and is set when the boat is idle")
                return None
            self._right_s = now_s
            self.status = replace(self.status, off_s=0.0, is_right=True)
            return Correction("step", -off_s, source)
        if self._right_s is not None and abs(off_s) > STEP_S + DRIFT * (now_s - self._right_s):
            self._say("jump", f"{source} is {_seconds(-off_s)} off the clock, which was right in this run: it is not taken")
            return None
        self._right_s = now_s
        if now_s - self._slewed_s < SLEW_EVERY_S:
            return None
        self._slewed_s = now_s
        return Correction("slew", -off_s, source)

    def _believed(self, now_s: float) -> list[tuple[str, int]]:
        """The sources that give a steady, possible time now, the best first."""
        found = []
        for name in sorted(self._times, key=lambda name: (name != TIME_FRAME, -self._times[name].at_s)):
            times = self._times[name]
            if now_s - times.at_s > HEARD_S or len(times.offsets_ns) < ENOUGH:
                continue
            offset_ns = times.median_ns()
            utc_s = offset_ns / 1e9 + now_s
            if not 0.0 <= utc_s - MADE_NS / 1e9 <= LATEST_S:
                self._say("implausible", f"{name} says {_date(utc_s)}, which cannot be: it is not taken")
            elif (spread_s := times.spread_s()) > STEADY_S:
                self._say("unsteady", f"{name} jumps by {_seconds(spread_s)}: it is not taken")
            else:
                found.append((name, offset_ns))
        return found

    def _say(self, fault: Fault, words: str) -> None:
        self.fault, self.status = fault, replace(self.status, fault=words)


def _seconds(seconds: float) -> str:
    return f"{seconds:+.1f} s" if abs(seconds) < 86_400.0 else f"{seconds / 86_400.0:+,.0f} days"


def _date(utc_s: float) -> str:
    """Format any time that 64 bits of nanoseconds can hold."""
    try:
        return f"{datetime.fromtimestamp(utc_s, UTC):%Y-%m-%d}"
    except (ValueError, OverflowError, OSError):
        return f"{utc_s:.0f} s since 1970"
