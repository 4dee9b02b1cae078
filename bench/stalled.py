"""The boat's serial radio, with a console behind it that listens, or a radio that stalls: it takes nothing from the port."""

import contextlib
import os
import threading
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Final, Self

from bench.fuzz import COMPONENT, SYSTEM
from delfim.base.clock import SystemClock
from delfim.base.input.keys import read_key
from delfim.parts.mavlink.codec.signing import Signing
from delfim.parts.mavlink.codec.wire import Sender, dialect

EVERY_S: Final = 0.05


class Radio:
    """`port` is the boat's end. From `__enter__` to `__exit__` a console with the key says twenty times a second that it is
    there, so that the boat tells it all that it tells."""

    def __init__(self, key: Path) -> None:
        self._end, self._boats = os.openpty()
        tty.setraw(self._boats)
        os.set_blocking(self._end, False)
        self.port = os.ttyname(self._boats)
        secret = read_key(key)
        self._sender = Sender(SYSTEM, COMPONENT, secret, Signing(secret, SystemClock()).stamp)
        self._stalls, self._ended, self._said = threading.Event(), threading.Event(), 0
        self._thread = threading.Thread(target=self._run, name="radio")

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        os.close(self._end)
        os.close(self._boats)

    @contextlib.contextmanager
    def stalled(self) -> Iterator[list[int]]:
        """Meanwhile it takes nothing; afterwards the list holds how often the console spoke."""
        said, before = list[int](), self._said
        self._stalls.set()
        yield said
        self._stalls.clear()
        said.append(self._said - before)

    def _run(self) -> None:
        while not self._ended.wait(EVERY_S):
            with contextlib.suppress(BlockingIOError):
                os.write(self._end, self._sender.pack(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3)))
                self._said += 1
            with contextlib.suppress(BlockingIOError):
                while not self._stalls.is_set():
                    os.read(self._end, 4096)
