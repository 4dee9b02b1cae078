"""The other ends of a simulated boat's NMEA 0183 ports, in real time: a pty for a serial port, or the network of this computer.

They are played only where `delfim sim` has put them: a device in the run directory, or an address of this computer. Nothing
here waits; what nobody takes is lost, as on a real line.
"""

import array
import contextlib
import fcntl
import os
import select
import socket
import termios
import tty
from collections.abc import Iterable
from pathlib import Path
from typing import Final, Protocol, Self

from delfim import config
from delfim.base.ranges import address, is_loopback
from delfim.simulator.nodes.talkers import port_devices

UNREAD_BYTES: Final = 2048  # of a pty that nobody reads, which would keep old positions for its next reader
CONNECT_S: Final = 1.0  # between two attempts


class LineEnd(Protocol):
    def say(self, data: bytes, now_s: float) -> None: ...
    def close(self) -> None: ...


class PtyEnd:
    """A serial port under the name that the boat opens. Raises OSError."""

    def __init__(self, name: Path) -> None:
        self._name = name
        self._end, self._port = os.openpty()
        os.set_blocking(self._end, False)
        tty.setraw(self._port)
        name.unlink(missing_ok=True)
        name.symlink_to(os.ttyname(self._port))

    def say(self, data: bytes, now_s: float) -> None:
        unread = array.array("i", [0])
        fcntl.ioctl(self._port, termios.FIONREAD, unread)
        if unread[0] > UNREAD_BYTES:
            termios.tcflush(self._port, termios.TCIFLUSH)
        with contextlib.suppress(OSError):
            os.write(self._end, data)
        with contextlib.suppress(OSError):  # a device of this kind has nothing to learn
            os.read(self._end, UNREAD_BYTES)

    def close(self) -> None:
        self._name.unlink(missing_ok=True)
        os.close(self._end)
        os.close(self._port)


class DatagramEnd:
    """Datagrams to a port of the boat."""

    def __init__(self, address: tuple[str, int]) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self._socket.connect(address)

    def say(self, data: bytes, now_s: float) -> None:
        with contextlib.suppress(OSError):  # the boat does not listen yet
            self._socket.send(data)

    def close(self) -> None:
        self._socket.close()


class ConnectionEnd:
    """A connection: made to the boat where it listens, or taken from it. Raises OSError."""

    def __init__(self, address: tuple[str, int], listens: bool) -> None:
        self._address, self._tried_s = address, -CONNECT_S
        self._door: socket.socket | None = None if listens else socket.create_server(address)
        if self._door is not None:
            self._door.setblocking(False)
        self._line: socket.socket | None = None

    def say(self, data: bytes, now_s: float) -> None:
        try:
            self._line = self._newest(now_s)
            if self._line is not None and select.select([], [self._line], [], 0.0)[1]:
                self._line.send(data)
                if not self._line.recv(UNREAD_BYTES):  # of a boat that takes this for gpsd
                    self._hang_up()
        except BlockingIOError:
            pass
        except OSError:
            self._hang_up()

    def _newest(self, now_s: float) -> socket.socket | None:
        """The connection, the newest where several were made. Raises OSError."""
        if self._door is not None:
            with contextlib.suppress(BlockingIOError):
                taken, _ = self._door.accept()
                self._hang_up()
                taken.setblocking(False)
                return taken
        elif self._line is None and now_s >= self._tried_s + CONNECT_S:
            self._tried_s = now_s
            made = socket.socket(socket.AF_INET, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
            made.connect_ex(self._address)
            return made
        return self._line

    def _hang_up(self) -> None:
        if self._line is not None:
            self._line.close()
        self._line = None

    def close(self) -> None:
        self._hang_up()
        if self._door is not None:
            self._door.close()


class InstrumentLines:
    """The ends of all ports that have instruments."""

    def __init__(self, settings: config.Vehicle, ports: Iterable[str]) -> None:
        """Open the ends. Raises OSError."""
        table, run = port_devices(settings), Path(settings.runtime.run_directory)
        made = {name: _end(table[name], run) for name in ports}
        self._ends = {name: end for name, end in made.items() if end is not None}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for end in self._ends.values():
            end.close()

    def say(self, port: str, data: bytes, now_s: float) -> None:
        if (end := self._ends.get(port)) is not None:
            end.say(data, now_s)


def _end(device: str, run: Path) -> LineEnd | None:
    """Open the end of a port; None for a real device. Raises OSError."""
    kind, _, place = device.partition(":")
    if device.startswith("/"):
        return PtyEnd(Path(device)) if Path(device).is_relative_to(run) else None
    if not is_loopback(place):
        return None
    its = address(place)
    return DatagramEnd(its) if kind == "udp" else ConnectionEnd(its, kind == "tcp-listen")
