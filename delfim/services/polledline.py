"""A line that several boats share: packets of a TUN device and bytes of the port, by the rules of polling.py."""

import asyncio
import contextlib
import math
import os
from typing import Final, Protocol

from delfim.services.runtime import Runtime

READ_BYTES: Final = 4096
PACKETS_PER_READ: Final = 20


class Talker(Protocol):
    """One end of the line: polling.PolledBoat or polling.PollingShore."""

    def offer(self, packet: bytes, now_s: float) -> None: ...
    def heard(self, data: bytes, now_s: float) -> list[bytes]: ...
    def speak(self, now_s: float) -> bytes: ...
    def due_s(self) -> float: ...
    def silence(self, now_s: float) -> str: ...


class PolledLine:
    """An open port and an open TUN device with one end of the line between them. It closes the device, and not the port."""

    def __init__(
        self, name: str, port: int, tun: int, talker: Talker, runtime: Runtime, loop: asyncio.AbstractEventLoop
    ) -> None:
        self.name = name
        self._port, self._tun, self._talker, self._runtime, self._loop = port, tun, talker, runtime, loop
        self._trouble = ""
        self._timer: asyncio.TimerHandle | None = None

    def attend(self) -> None:
        self._runtime.reader(self._tun, self.on_packets)
        self._runtime.reader(self._port, self.on_bytes)
        self._speak()

    def trouble(self) -> str:
        return self._trouble

    def silence(self) -> str:
        return self._talker.silence(self._loop.time())

    def close(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        for fd in (self._tun, self._port):
            self._runtime.remove_reader(fd)
        os.close(self._tun)

    def on_packets(self) -> None:
        """Packets of the network's for the line."""
        self._take()
        self._speak()

    def on_bytes(self) -> None:
        """Bytes of the line's."""
        try:
            data = os.read(self._port, READ_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            self._lost(error.strerror or "read failed")
            return
        if not data:
            self._lost("the line was hung up")
            return
        for packet in self._talker.heard(data, self._loop.time()):
            with contextlib.suppress(OSError):  # the kernel refuses anything but a packet
                os.write(self._tun, packet)
        self._take()  # answers of this computer to those packets leave in the same turn
        self._speak()

    def _take(self) -> None:
        with contextlib.suppress(BlockingIOError):
            for _ in range(PACKETS_PER_READ):
                self._talker.offer(os.read(self._tun, READ_BYTES), self._loop.time())

    def _speak(self) -> None:
        """What a turn sends fits in the port's buffer. If a port stalls, the rest is lost: later is another one's turn."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        try:
            if data := self._talker.speak(self._loop.time()):
                os.write(self._port, data)
        except BlockingIOError:
            pass
        except OSError as error:
            self._lost(error.strerror or "write failed")
            return
        if (due_s := self._talker.due_s()) < math.inf:
            self._timer = self._loop.call_at(due_s, self._speak)

    def _lost(self, reason: str) -> None:
        self._trouble = reason
        self._runtime.remove_reader(self._port)
