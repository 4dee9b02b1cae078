"""A frequency that several radios share: terminals joined to each other. Each byte takes its time on the air and reaches all
others after a delay; bytes that are on the air at once destroy each other, and are counted."""

import os
import pty
import select
import threading
import time
import tty
from collections import deque
from collections.abc import Sequence
from typing import Final

SLICE_BYTES: Final = 50
DELAY_S: Final = 0.005
LOOK_S: Final = 0.05


class Frequency:
    """Radios, a terminal each, in `devices`, until it is closed. `overlaps` counts slices that were on the air at once."""

    def __init__(self, radios: int, bytes_per_s: float) -> None:
        pairs = [pty.openpty() for _ in range(radios)]
        self.devices = [os.ttyname(port) for _, port in pairs]
        self.overlaps, self.carried = 0, [0] * radios
        self.deaf: set[int] = set()  # radios that are out of reach
        self._ends, self._ports = [end for end, _ in pairs], [port for _, port in pairs]
        for port in self._ports:
            tty.setraw(port)
        self._bytes_per_s = bytes_per_s
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._carry, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._closed.set()
        self._thread.join()
        for each in (*self._ends, *self._ports):
            os.close(each)

    def _carry(self) -> None:
        """Time on the air is counted from when a radio has bytes: a late wake-up of this thread delays all of them alike."""
        sent: list[deque[tuple[float, float, bytes]]] = [deque() for _ in self._ends]  # on the air: from, until, bytes
        while not self._closed.is_set():
            due_s = min((slices[0][1] + DELAY_S for slices in sent if slices), default=time.monotonic() + LOOK_S)
            readable, _, _ = select.select(self._ends, [], [], max(due_s - time.monotonic(), 0.0))
            now_s = time.monotonic()
            for end in readable:
                radio = self._ends.index(end)
                self._modulate(radio, os.read(end, 4096), now_s, sent[radio])
            self._deliver(sent, now_s)

    def _modulate(self, radio: int, data: bytes, now_s: float, slices: deque[tuple[float, float, bytes]]) -> None:
        self.carried[radio] += len(data)
        at_s = max(now_s, slices[-1][1] if slices else 0.0)
        for at in range(0, len(data), SLICE_BYTES):
            piece = data[at : at + SLICE_BYTES]
            slices.append((at_s, at_s + len(piece) / self._bytes_per_s, piece))
            at_s = slices[-1][1]

    def _deliver(self, sent: Sequence[deque[tuple[float, float, bytes]]], now_s: float) -> None:
        for radio, slices in enumerate(sent):
            while slices and slices[0][1] + DELAY_S <= now_s:
                from_s, until_s, piece = slices.popleft()
                others = [each for other in sent if other is not slices for each in other]
                if any(begun_s < until_s and from_s < ended_s for begun_s, ended_s, _ in others):
                    self.overlaps += 1
                    piece = bytes(byte ^ 0x55 for byte in piece)
                if radio in self.deaf:
                    continue
                for other, end in enumerate(self._ends):
                    if other != radio and other not in self.deaf:
                        os.write(end, piece)
