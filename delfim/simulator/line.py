"""A serial line inside one process, for lock-step simulation and replay: data that is put there is read piece by piece."""

from collections import deque
from typing import Final

from delfim.base.clock import Clock

PIECES_MAX: Final = 1024  # beyond, the oldest ones are lost


class LockstepLine:
    """The boat's end is a delfim.vehicle.links.Line; the other end is `put` and `written`."""

    def __init__(self, clock: Clock) -> None:
        self._clock, self.t_ns = clock, 0
        self._pieces = deque[tuple[int, bytes]](maxlen=PIECES_MAX)
        self.written = deque[bytes](maxlen=PIECES_MAX)

    def put(self, data: bytes) -> None:
        self._pieces.append((self._clock.time_ns(), data))

    def fileno(self) -> int:
        return -1  # never readable for a selector, as the buses of lock step are not

    def rebind(self) -> bool:
        return True

    def read(self) -> bytes:
        if not self._pieces:
            return b""
        self.t_ns, data = self._pieces.popleft()
        return data

    def write(self, data: bytes) -> bool:
        self.written.append(data)
        return True
