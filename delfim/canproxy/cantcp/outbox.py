"""The output to one client: replies at once, and frames in a bounded queue that drops the oldest."""

import asyncio
from collections import Counter, deque
from collections.abc import Callable
from math import inf


class Outbox:
    """Writes at once unless the kernel takes no more; then frames wait, and the overflow is lost for this client alone."""

    def __init__(
        self, transport: asyncio.Transport, queue_bytes: int, counts: Counter[str], warn: Callable[[str], None]
    ) -> None:
        self.queued_bytes = 0
        self.is_full = False  # the kernel and the transport take no more
        self.is_held = False  # frames wait until this is over
        self._transport, self._queue_bytes, self._counts, self._warn = transport, queue_bytes, counts, warn
        self._queue: deque[tuple[bytes, int]] = deque()  # text, and the number of frames in it
        self._soon: asyncio.Handle | None = None  # the write of waiting frames

    def put(self, text: bytes, frames: int) -> None:
        """Queue frames, to be written soon or lost: many writes at once would make a long callback."""
        self._queue.append((text, frames))
        self.queued_bytes += len(text)
        while self.queued_bytes > self._queue_bytes:
            lost, count = self._queue.popleft()
            self.queued_bytes -= len(lost)
            if not self._counts["dropped"]:
                self._warn("is too slow: its frames are dropped")
            self._counts["dropped"] += count
        if not (self._soon or self.is_full or self.is_held):
            self._soon = asyncio.get_running_loop().call_soon(self.flush)

    def reply(self, text: bytes) -> None:
        """Queue a reply behind earlier frames, unless these are held."""
        if self.is_full:
            self.put(text, 0)
        else:
            self.flush()
            self._transport.write(text)

    def flush(self) -> None:
        self._soon = None
        while self._queue and not self.is_full and not self.is_held:
            text, frames = self._queue.popleft()
            self.queued_bytes -= len(text)
            self._counts["frames"] += frames
            self._transport.write(text)

    def clear(self) -> None:
        self._queue.clear()
        self.queued_bytes = 0


class Timers:
    """Jobs for later, each done once."""

    def __init__(self) -> None:
        self._timers: dict[Callable[[], None], asyncio.TimerHandle] = {}

    def at(self, job: Callable[[], None], when_s: float) -> None:
        """Do a job at this time, or at an earlier one set before; infinite: keep the time set before."""
        timer = self._timers.get(job)
        if when_s < inf and (timer is None or timer.when() > when_s):
            if timer:
                timer.cancel()
            self._timers[job] = asyncio.get_running_loop().call_at(when_s, self._due, job)

    def _due(self, job: Callable[[], None]) -> None:
        del self._timers[job]
        job()

    def cancel(self, job: Callable[[], None]) -> None:
        if timer := self._timers.pop(job, None):
            timer.cancel()

    def clear(self) -> None:
        for job in list(self._timers):
            self.cancel(job)
