"""The kernel's broadcast manager (CAN_BCM) for one client, in user space: cyclic transmission, and reception limited by
rate and by change of content. Time is handed in.
"""

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from math import inf
from typing import Final

JOBS_MAX: Final = 256  # cycles, and subscriptions, of one client


@dataclass(slots=True)
class _Row:
    """The memory of a subscription, or of each multiplexed row of one."""

    mask: int
    content: int | None = None  # last seen under the mask
    told_s: float = -inf
    waiting: bytes | None = None  # newest text that came too soon


class Subscription:
    """One subscription: the newest text at most once each `interval_s` (0: no limit), sent late rather than never.

    masks, 64-bit numbers over the data as it comes: none, every frame counts; one, a frame counts when the data under the mask
    changed; more, the first says which bits choose the row of a multiplexed frame, and each other one is a row: its bits under
    the first mask choose it, all its bits are the mask under which a change counts.
    """

    def __init__(self, interval_s: float, masks: tuple[int, ...]) -> None:
        self._interval_s, self._by_content, self._multiplex = interval_s, bool(masks), masks[0] if len(masks) > 1 else 0
        self._rows = [_Row(mask) for mask in (masks[1:] if len(masks) > 1 else masks or (0,))]

    def offer(self, text: bytes, data: bytes, now_s: float) -> bytes | None:
        """Offer a frame that came. Returns the text if it is to be sent now; otherwise it waits, or does not count."""
        content = int.from_bytes(data.ljust(8, b"\0"), "big")
        row = next((row for row in self._rows if not (content ^ row.mask) & self._multiplex), None)
        if row is None or (self._by_content and row.content == content & row.mask):
            return None
        row.content = content & row.mask
        if now_s - row.told_s < self._interval_s:
            row.waiting = text
            return None
        row.told_s, row.waiting = now_s, None
        return text

    @property
    def due_s(self) -> float:
        """When the first waiting text is due; infinite if none waits."""
        return min((row.told_s + self._interval_s for row in self._rows if row.waiting is not None), default=inf)

    def take(self, now_s: float) -> Iterator[bytes]:
        """Take the waiting texts that are due."""
        for row in self._rows:
            if row.waiting is not None and now_s - row.told_s >= self._interval_s:
                yield row.waiting
                row.told_s, row.waiting = now_s, None


@dataclass(slots=True)
class _Cycle:
    data: bytes
    interval_s: float


class Cycles:
    """Frames sent cyclically, by arbitration field. A late cycle does not catch up."""

    def __init__(self) -> None:
        self._cycles: dict[int, _Cycle] = {}
        self._due: list[
            tuple[float, int, int, _Cycle]
        ] = []  # heap of due time, number, arb; replaced entries are removed when due
        self._numbers = count()

    def __len__(self) -> int:
        return len(self._cycles)

    def add(self, arb: int, data: bytes, interval_s: float, now_s: float) -> bool:
        """Begin a cycle at once, replacing that of this arbitration field. False if there are JOBS_MAX others."""
        if arb not in self._cycles and len(self._cycles) >= JOBS_MAX:
            return False
        cycle = self._cycles[arb] = _Cycle(data, interval_s)
        if len(self._due) >= 4 * JOBS_MAX:  # a client replaces cycles faster than they become due
            self._due = [entry for entry in self._due if self._cycles.get(entry[2]) is entry[3]]
            heapq.heapify(self._due)
        heapq.heappush(self._due, (now_s, next(self._numbers), arb, cycle))
        return True

    def update(self, arb: int, data: bytes) -> None:
        if arb in self._cycles:
            self._cycles[arb].data = data

    def delete(self, arb: int) -> None:
        self._cycles.pop(arb, None)

    def clear(self) -> None:
        self._cycles.clear()
        self._due.clear()

    @property
    def due_s(self) -> float:
        return self._due[0][0] if self._due else inf

    def take(self, now_s: float, count_max: int) -> Iterator[tuple[int, bytes]]:
        """Take the due frames, (arbitration field, data), at most this many."""
        while count_max and self._due and self._due[0][0] <= now_s:
            due_s, _, arb, cycle = heapq.heappop(self._due)
            if self._cycles.get(arb) is cycle:
                next_s = due_s + cycle.interval_s
                next_s = next_s if next_s > now_s else now_s + cycle.interval_s
                heapq.heappush(self._due, (next_s, next(self._numbers), arb, cycle))
                count_max -= 1
                yield arb, cycle.data
