"""An open serial port and an open TUN device, for a line that this program carries itself: TunLine and PolledLine."""

import asyncio
import contextlib
import fcntl
import os
import struct
import termios
from collections.abc import Callable
from typing import Final

from delfim.services.runtime import Runtime

READ_BYTES: Final = 4096


class TunPort:
    """Reads both as long as the port is there. `heard` gets the port's bytes; `waiting` is called when the device has packets.
    It closes the device, and not the port."""

    def __init__(
        self, port: int, tun: int, runtime: Runtime, heard: Callable[[bytes], object], waiting: Callable[[], object]
    ) -> None:
        self.trouble = ""  # why the port is not read any more, in words
        self.timer: asyncio.TimerHandle | None = None  # for the line's next turn
        self._port, self._tun, self._runtime = port, tun, runtime
        self._heard, self._waiting = heard, waiting

    def attend(self) -> None:
        self._runtime.reader(self._tun, self._waiting)
        self._runtime.reader(self._port, self._on_bytes)

    def packet(self) -> bytes:
        """Read the next packet from the network for the line. Raises BlockingIOError when there is none."""
        return os.read(self._tun, READ_BYTES)

    def deliver(self, packet: bytes) -> None:
        """Write a packet from the line to the network."""
        with contextlib.suppress(OSError):  # the kernel refuses anything but a packet
            os.write(self._tun, packet)

    def write(self, data: bytes) -> int:
        """Write bytes to the line; returns how many it took: none when it stalls, or is lost."""
        try:
            return os.write(self._port, data)
        except BlockingIOError:
            return 0
        except OSError as error:
            self._lost(error.strerror or "write failed")
            return 0

    def unsent(self) -> int:
        """The number of bytes in the port's buffer, which cannot be overtaken; none when it is lost."""
        try:
            return int(struct.unpack("i", fcntl.ioctl(self._port, termios.TIOCOUTQ, bytes(4)))[0])
        except OSError as error:
            self._lost(error.strerror or "the line was hung up")
            return 0

    def close(self) -> None:
        if self.timer is not None:
            self.timer.cancel()
        for fd in (self._tun, self._port):
            self._runtime.remove_reader(fd)
        os.close(self._tun)

    def _on_bytes(self) -> None:
        try:
            data = os.read(self._port, READ_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            self._lost(error.strerror or "read failed")
            return
        if data:
            self._heard(data)
        else:
            self._lost("the line was hung up")

    def _lost(self, reason: str) -> None:
        self.trouble = reason
        self._runtime.remove_reader(self._port)
