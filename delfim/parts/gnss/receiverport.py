"""The port of a receiver as corrections reach it: written, and never waited for."""

import asyncio
import contextlib
import os
import select
from collections import deque
from typing import Final

from delfim.base.errors import DelfimError
from delfim.lines.serialline import SOCKETS, open_port, open_socket

WAITING_BYTES: Final = 4096  # some seconds of corrections; older ones are worth nothing
READ_BYTES: Final = 4096
READS: Final = 16  # in one look


class ReceiverPort:
    """`shared`: the vehicle reads this port. It is then opened for writing alone, and its speed and form are left as the
    vehicle sets them, so that nothing that comes from the receiver is lost."""

    def __init__(self, device: str, baud: int, shared: bool) -> None:
        self.device, self.trouble = device, "not open yet"
        self.written = self.dropped = 0  # whole pieces
        self._baud, self._shared, self._port = baud, shared, -1
        self._waiting: deque[bytes] = deque()  # the first one may be the rest of a piece
        self._is_begun = False
        self._loop = asyncio.get_running_loop()

    def put(self, data: bytes) -> None:
        """A piece that is worth something only as a whole. Where too many wait, the older ones go."""
        if self._port < 0:
            self.dropped += 1
            return
        if sum(map(len, self._waiting)) + len(data) > WAITING_BYTES:
            begun = [self._waiting[0]] if self._is_begun else []
            self.dropped += len(self._waiting) - len(begun)
            self._waiting = deque(begun)
        self._waiting.append(data)
        self._write()

    def look(self) -> None:
        """Call about once a second: opens what is not open, and closes what hung up."""
        if self._port < 0:
            try:
                self._port = self._opened()
                self.trouble = ""
            except OSError as error:
                self.trouble = error.strerror or str(error)
            except DelfimError as error:
                self.trouble = str(error)
            return
        poll = select.poll()
        poll.register(self._port, 0)
        if poll.poll(0) or self._is_at_end():
            self._lost("hung up")

    def close(self) -> None:
        self._lost("closed")

    def _opened(self) -> int:
        """Raises OSError, DelfimError."""
        if self.device.startswith(SOCKETS):
            return open_socket(self.device)
        if self._shared:
            return os.open(self.device, os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        return open_port(self.device, self._baud, ignores_modem=True)

    def _is_at_end(self) -> bool:
        """Data of a connection are read and dropped: nobody else reads them."""
        if not self.device.startswith(SOCKETS):
            return False
        with contextlib.suppress(BlockingIOError):
            for _ in range(READS):
                if not os.read(self._port, READ_BYTES):
                    return True
        return False

    def _write(self) -> None:
        self._loop.remove_writer(self._port)
        while self._waiting:
            data = self._waiting[0]
            try:
                taken = os.write(self._port, data)
            except BlockingIOError:
                self._loop.add_writer(self._port, self._write)
                return
            except OSError as error:
                self._lost(error.strerror or str(error))
                return
            self._is_begun = taken < len(data)
            if self._is_begun:
                self._waiting[0] = data[taken:]
            else:
                self._waiting.popleft()
                self.written += 1

    def _lost(self, why: str) -> None:
        self.trouble = why
        self.dropped += len(self._waiting)
        self._waiting.clear()
        self._is_begun = False
        if self._port >= 0:
            self._loop.remove_writer(self._port)
            os.close(self._port)
            self._port = -1
