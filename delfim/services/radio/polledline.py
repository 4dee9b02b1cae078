"""A line that several boats share: packets of a TUN device and bytes of the port, by the rules of polling.py."""

import asyncio
import contextlib
import math
from typing import Final, Protocol

from delfim.services.radio.tunport import TunPort
from delfim.services.runtime import Runtime

PACKETS_PER_READ: Final = 20


class Talker(Protocol):
    """One end of the line: polling.PolledBoat or polling.PollingShore."""

    def offer(self, packet: bytes, now_s: float) -> None: ...
    def received(self, data: bytes, now_s: float) -> list[bytes]: ...
    def speak(self, now_s: float) -> bytes: ...
    def due_s(self) -> float: ...
    def silence(self, now_s: float) -> str: ...


class PolledLine:
    """An open port and an open TUN device with one end of the line between them. It closes the device, and not the port."""

    def __init__(
        self, name: str, port: int, tun: int, talker: Talker, runtime: Runtime, loop: asyncio.AbstractEventLoop
    ) -> None:
        self.name = name
        self._ends = TunPort(port, tun, runtime, self._received, self._on_packets)
        self._talker, self._loop = talker, loop

    def attend(self) -> None:
        self._ends.attend()
        self._speak()

    def trouble(self) -> str:
        return self._ends.trouble

    def silence(self) -> str:
        return self._talker.silence(self._loop.time())

    def close(self) -> None:
        self._ends.close()

    def _on_packets(self) -> None:
        self._take()
        self._speak()

    def _received(self, data: bytes) -> None:
        for packet in self._talker.received(data, self._loop.time()):
            self._ends.deliver(packet)
        self._take()  # answers of this computer to those packets leave in the same turn
        self._speak()

    def _take(self) -> None:
        with contextlib.suppress(BlockingIOError):
            for _ in range(PACKETS_PER_READ):
                self._talker.offer(self._ends.packet(), self._loop.time())

    def _speak(self) -> None:
        """Send all of a turn, which fits in the port's buffer. If a port stalls, the rest is lost: later is another one's
        turn."""
        ends = self._ends
        if ends.timer is not None:
            ends.timer.cancel()
            ends.timer = None
        if data := self._talker.speak(self._loop.time()):
            ends.write(data)
        if not ends.trouble and (due_s := self._talker.due_s()) < math.inf:
            ends.timer = self._loop.call_at(due_s, self._speak)
