"""The time on the bus (dsor-time and dsor-rtime of thesis 5.3.3): a frame with UTC at the start of each second.

As master this computer sends it each second. As redundant it listens, takes over when the master falls silent, and stops
again at the master's next frame. `docs/timed.md` says when, and why the redundant one sends a little late.
"""

import ctypes
import errno
import logging
import os
import struct
from collections import deque
from typing import Final, Literal

from delfim.base.clock import MADE_NS, Clock
from delfim.base.errors import BusError
from delfim.base.frames import Frame
from delfim.canproxy.dsor.messages import TIME, TIME_FRAME
from delfim.canproxy.socket import CanSocket

REDUNDANT_DELAY_S: Final = 0.01  # after the start of a second, so that a returning master is first
FRAMES_PER_READ: Final = 16
RECENT: Final = 600  # seconds shown in the jitter figures
_SECOND_NS: Final = 1_000_000_000
_ASTRAY_NS: Final = 500_000_000  # farther from the start of a second nothing is sent: the clock stepped

log = logging.getLogger(__name__)


class Timekeeper:
    """Decides whether to send the time. Times are handed in; `tick` is called each second, `delay_s` after its start.

    heard        frames of another master
    sent         frames of this computer
    takeovers    times that the redundant one began to send
    """

    def __init__(self, mode: Literal["master", "redundant"], takeover_s: float, now_s: float, arb: int = TIME_FRAME) -> None:
        self._arb = arb
        self.delay_s = REDUNDANT_DELAY_S if mode == "redundant" else 0.0
        self.heard = self.sent = self.takeovers = 0
        self.is_speaking = mode == "master"
        self._mode, self._takeover_s, self._heard_s = mode, takeover_s, now_s
        self._late_s: deque[float] = deque(maxlen=RECENT)

    def hear(self, frame: Frame, now_s: float) -> None:
        """Take a frame of the bus; all but time frames are ignored."""
        if frame.arb != self._arb or len(frame.data) != TIME.size:
            return
        self.heard += 1
        self._heard_s = now_s
        self.is_speaking = self._mode == "master"

    def tick(self, now_s: float, utc_ns: int) -> Frame | None:
        """Return the frame to send at once, if one is due: it carries the present time, jitter included."""
        if not self.is_speaking and now_s - self._heard_s >= self._takeover_s:
            self.is_speaking = True
            self.takeovers += 1
        late_ns = (utc_ns - round(self.delay_s * 1e9)) % _SECOND_NS
        if not self.is_speaking or late_ns >= _ASTRAY_NS:
            return None
        self._late_s.append(late_ns / 1e9)
        self.sent += 1
        return Frame(self._arb, TIME.pack(utc_ns))

    def report(self) -> dict[str, object]:
        """The report, JSON-ready. `late_s`: how late the frames of the last ten minutes were handed to the bus."""
        late_s = sorted(self._late_s)
        jitter = (
            {"p50": late_s[len(late_s) // 2], "p99": late_s[len(late_s) * 99 // 100], "worst": late_s[-1]} if late_s else {}
        )
        counts = {"sent": self.sent, "heard": self.heard, "takeovers": self.takeovers}
        return {"mode": self._mode, "speaking": self.is_speaking, **counts, "late_s": jitter}


class SecondTimer:
    """A timerfd(2) of the wall clock, readable `delay_s` after the start of each second. It follows the clock when it is slewed
    and when it is stepped, which no timer of an event loop does, and is as precise as the kernel's high resolution timers."""

    _REALTIME, _NONBLOCK, _CLOEXEC = 0, os.O_NONBLOCK, os.O_CLOEXEC
    _ABSTIME, _CANCEL_ON_SET = 1, 2

    def __init__(self, delay_s: float, utc_ns: int) -> None:
        """Make the timer. Raises BusError if the system has no such timers."""
        self._libc = ctypes.CDLL(None, use_errno=True)
        self._delay_ns = round(delay_s * 1e9)
        try:
            self._fd: int = self._libc.timerfd_create(self._REALTIME, self._NONBLOCK | self._CLOEXEC)
        except AttributeError:
            raise BusError("no timerfd in this system") from None
        self._set(utc_ns)

    def fileno(self) -> int:
        return self._fd

    def passed(self, utc_ns: int) -> bool:
        """Whether a second began; call it when readable. False after a step of the clock; the timer is then set again."""
        try:
            os.read(self._fd, 8)
        except BlockingIOError:
            return False
        except OSError as error:
            if error.errno != errno.ECANCELED:
                raise
            self._set(utc_ns)
            return False
        return True

    def close(self) -> None:
        os.close(self._fd)

    def _set(self, utc_ns: int) -> None:
        seconds = (utc_ns - self._delay_ns) // _SECOND_NS + 1
        times = struct.pack("@4l", 1, 0, seconds, self._delay_ns)  # struct itimerspec: interval, first
        if self._libc.timerfd_settime(self._fd, self._ABSTIME | self._CANCEL_ON_SET, times, None):
            number = ctypes.get_errno()
            raise BusError(f"timerfd: {os.strerror(number)}")


class TimeService:
    """Joins the Timekeeper, its timer and a socket bound to the time frame. Call `on_frames` when `can` is readable,
    `on_second` when `timer` is. A bus that fails is counted, and reopened each second.

    failures  frames that the bus did not take, and failed reads
    """

    def __init__(self, keeper: Timekeeper, timer: SecondTimer, can: CanSocket, clock: Clock) -> None:
        self.failures = 0
        self._keeper, self._timer, self._can, self._clock = keeper, timer, can, clock

    def on_frames(self) -> None:
        was_speaking = self._keeper.is_speaking
        try:
            for _ in range(FRAMES_PER_READ):
                frame = self._can.receive()
                if frame is None:
                    break
                self._keeper.hear(frame, self._clock.monotonic_s())
        except BusError:
            self.failures += 1
        if was_speaking and not self._keeper.is_speaking:
            log.warning("timed: another node sends the time again; this one stops sending")

    def on_second(self) -> None:
        if not self._timer.passed(self._clock.time_ns()) or self._clock.time_ns() < MADE_NS:  # a clock that was never set
            return
        self.on_frames()  # frames that waited while this program did not run
        was_speaking = self._keeper.is_speaking
        frame = self._keeper.tick(self._clock.monotonic_s(), self._clock.time_ns())
        if frame is not None:
            try:
                self._can.sendmsg(frame)
            except OSError:  # a BusError or a full queue: a late time is useless
                self.failures += 1
                self._can.rebind()
        if self._keeper.is_speaking and not was_speaking:
            log.warning("timed: no other node sends the time; this one sends it now")

    def report(self) -> dict[str, object]:
        """The report, JSON-ready."""
        return {**self._keeper.report(), "failures": self.failures}
