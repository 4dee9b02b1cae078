"""Plays the black box back onto a bus, at any speed: for bus monitors, and for nodes on a test bench."""

import time
from collections.abc import Callable, Iterable
from typing import Final

from delfim.base.frames import Frame
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import CanAddress

RETRY_S: Final = 0.001  # after the interface's queue was full


def play(
    frames: Iterable[tuple[str, Frame]],
    interface: str,
    speed: float,
    only: str | None = None,
    *,
    now_s: Callable[[], float] = time.monotonic,
    wait_s: Callable[[float], None] = time.sleep,
) -> tuple[int, float]:
    """Send frames at their recorded intervals, `speed` times as fast; 0: as fast as the bus takes them. Error
    frames are not sent. `only` is "received" or "sent". Returns (frames sent, worst lateness, s). Raises BusError."""
    count, late_s, begin_s, begin_ns = 0, 0.0, 0.0, 0
    with open_can(interface) as socket:
        socket.setblocking(False)
        for _, frame in frames:
            if frame.error or (only and frame.sent_here != (only == "sent")):
                continue
            if not count:
                begin_s, begin_ns = now_s(), frame.t_ns
            if speed > 0:
                due_s = begin_s + (frame.t_ns - begin_ns) / 1e9 / speed
                ahead_s = due_s - now_s()
                if ahead_s > 0:
                    wait_s(ahead_s)
                late_s = max(late_s, now_s() - due_s)
            while True:
                try:
                    socket.sendto(frame.data, CanAddress(frame.arb))
                    break
                except BlockingIOError:
                    wait_s(RETRY_S)
            count += 1
    return count, late_s
