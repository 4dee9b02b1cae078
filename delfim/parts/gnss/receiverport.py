"""The port of a receiver, for corrections: it is written without waiting."""

import asyncio
import os
import select
from collections import deque
from typing import Final

from delfim.base.clock import SystemClock
from delfim.lines.serialline import SOCKETS, SerialLine

WAITING_BYTES: Final = 4096  # some seconds of corrections; older ones are worth nothing
READS: Final = 16  # in one look


class ReceiverPort(SerialLine):
    """A line with an outbox. The port of a receiver. `shared`: the vehicle reads this port. It is then opened for writing
    alone, and its speed and form are left as the vehicle sets them, so that nothing that comes from the receiver is lost."""

    def __init__(self, device: str, baud: int, shared: bool) -> None:
        self.written = self.dropped = 0  # whole pieces
        self._shared = shared and not device.startswith(SOCKETS)
        self._waiting: deque[bytes] = deque()  # the first one may be the rest of a piece
        self._is_begun = False
        self._loop = asyncio.get_running_loop()
        super().__init__(device, baud, SystemClock(), may_lack=True)

    def send(self, data: bytes) -> None:
        """Write a piece that is worth something only as a whole. Where too many wait, the older ones go."""
        if self._port < 0:
            self.dropped += 1
            return
        if sum(map(len, self._waiting)) + len(data) > WAITING_BYTES:
            begun = [self._waiting[0]] if self._is_begun else []
            self.dropped += len(self._waiting) - len(begun)
            self._waiting = deque(begun)
        self._waiting.append(data)
        self._flush()

    def look(self) -> None:
        """Open what is not open, and close what hung up; call it about once a second."""
        if self._port < 0:
            self.rebind()
        elif any(events & ~select.EPOLLIN for _, events in self._ready.poll(0)):
            self._lost("hung up")
        elif self.device.startswith(SOCKETS):  # data of a connection are dropped: nobody else reads them
            for _ in range(READS):
                if not self.read():
                    break

    def _open(self) -> None:
        if not self._shared:
            super()._open()
            return
        self._port = os.open(self.device, os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        self._ready.register(self._port, 0)
        self.trouble = ""

    def _flush(self) -> None:
        self._loop.remove_writer(self._port)
        while self._waiting:
            data = self._waiting[0]
            taken = self.put(data)
            if self._port < 0:
                return
            self._is_begun = taken < len(data) and (self._is_begun or taken > 0)
            if taken < len(data):
                self._waiting[0] = data[taken:]
                self._loop.add_writer(self._port, self._flush)
                return
            self._waiting.popleft()
            self.written += 1

    def _lost(self, why: str) -> None:
        if self._port >= 0:
            self._loop.remove_writer(self._port)
        self.dropped += len(self._waiting)
        self._waiting.clear()
        self._is_begun = False
        super()._lost(why)
