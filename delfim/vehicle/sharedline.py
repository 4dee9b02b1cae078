"""A line with two users: one reads it, the other is handed what was read."""

from collections import deque
from typing import Final

from delfim.vehicle.links import ReadableLine

KEPT: Final = 64  # pieces that nobody has read; beyond, the oldest are lost


class SecondEnd:
    """The line for its second user, who must not wait for it."""

    def __init__(self, line: ReadableLine) -> None:
        self._line, self._pieces, self.t_ns = line, deque[bytes](maxlen=KEPT), 0

    def fileno(self) -> int:
        return -1

    def rebind(self) -> bool:
        return True  # by the first

    def hand(self, data: bytes) -> None:
        self._pieces.append(data)
        self.t_ns = self._line.t_ns

    def read(self) -> bytes:
        return self._pieces.popleft() if self._pieces else b""

    def write(self, data: bytes) -> bool:
        return self._line.write(data)
