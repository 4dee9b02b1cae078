"""A line on which this computer listens, read as a serial line is: UDP datagrams, or a TCP server for one sender."""

import contextlib
import os
import select
import socket
from collections.abc import Callable
from ipaddress import ip_address, ip_network
from typing import Final

from delfim.base.clock import Clock
from delfim.base.input.ratelimit import PIECE_BYTES, SECOND_BYTES, Allowance

DATAGRAM_BYTES: Final = 2048
LISTENING: Final = ("udp:", "tcp-listen:")


class NetworkLine:
    """A line over the network, with the methods of delfim.lines.serialline.SerialLine. `rebind`, called about once a second,
    opens what failed; it never waits. `trouble` says in words why nothing can come, or not all of it."""

    def __init__(
        self,
        device: str,
        senders: tuple[str, ...],
        clock: Clock,
        heard: Callable[[int, bytes], object] = lambda t_ns, data: None,
    ) -> None:
        """device: udp or tcp-listen, a colon, and ADDRESS:PORT, the address in numbers. senders: the networks from which data
        are taken."""
        self._kind, _, place = device.partition(":")
        host, _, port = place.rpartition(":")
        self._place, self._family = (host.strip("[]"), int(port)), socket.AF_INET6 if ":" in host else socket.AF_INET
        self._senders = tuple(ip_network(each) for each in senders)
        self._clock, self._heard = clock, heard
        self.device, self.trouble, self.t_ns = device, "not open yet", 0
        self._ready = select.epoll()
        self._door: socket.socket | None = None  # tcp-listen: where senders connect
        self._line: socket.socket | None = None
        self.allowance = Allowance(SECOND_BYTES, clock.monotonic_s)
        self._rest, self._more = b"", os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)  # of a datagram; set while there is any
        self._ready.register(self._more, select.EPOLLIN)

    def fileno(self) -> int:
        """The descriptor, readable when there is something to read."""
        return self._ready.fileno()

    def read(self) -> bytes:
        """Read the next data, PIECE_BYTES at most, their time in `t_ns`; empty: there are none, or the sender exceeds its rate
        limit."""
        try:
            if self._door is not None:
                self._accept(self._door)
            data = self._rest if self._rest or self._line is None else self._received(self._line)
        except BlockingIOError:
            return b""
        except OSError as error:
            self._lost(str(error.strerror))
            return b""
        data, rest = data[:PIECE_BYTES], data[PIECE_BYTES:]
        if rest and not self._rest:
            os.eventfd_write(self._more, 1)
        elif self._rest and not rest:
            os.eventfd_read(self._more)
        self._rest = rest
        if data:
            self.trouble, self.t_ns = self.allowance.words, self._clock.time_ns()
            self._heard(self.t_ns, data)
        return data

    def write(self, data: bytes) -> bool:
        """Write data; False where the connection did not take all of it: it is not sent again."""
        with contextlib.suppress(OSError):
            return self._line is not None and self._line.send(data) == len(data)
        return False

    def rebind(self) -> bool:
        """Reopen what failed. True when data can come."""
        was = self.allowance.words
        self.allowance.look()
        if self.trouble == was:
            self.trouble = self.allowance.words
        if self._line is None and self._door is None:
            try:
                self._open()
            except OSError as error:
                self.trouble = str(error.strerror)
        return self.trouble == self.allowance.words

    def close(self) -> None:
        self._lost("closed")
        if self._door is not None:
            self._door.close()
        os.close(self._more)
        self._ready.close()

    def _open(self) -> None:
        kind = socket.SOCK_DGRAM if self._kind == "udp" else socket.SOCK_STREAM
        opened = socket.socket(self._family, kind | socket.SOCK_NONBLOCK)
        try:
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, int(self._kind == "tcp-listen"))
            opened.bind(self._place)
            if self._kind == "tcp-listen":
                opened.listen(1)
        except OSError:
            opened.close()
            raise
        self._ready.register(opened, select.EPOLLIN)
        if self._kind == "tcp-listen":
            self._door, self.trouble = opened, "nobody is connected"
        else:
            self._line, self.trouble = opened, ""

    def _accept(self, door: socket.socket) -> None:
        """Accept a sender; it takes the place of the one before, which may be gone without a word."""
        with contextlib.suppress(BlockingIOError):
            sender, (host, *_) = door.accept()
            if not self._is_welcome(host):
                sender.close()
                return
            if self._line is not None:
                self._ready.unregister(self._line)
                self._line.close()
            sender.setblocking(False)
            self._ready.register(sender, select.EPOLLIN)
            self._line = sender

    def _received(self, line: socket.socket) -> bytes:
        """Receive from the sender. Raises OSError."""
        most = self.allowance.at_once(PIECE_BYTES)
        if self._kind == "udp":
            data, (host, *_) = line.recvfrom(DATAGRAM_BYTES)
            return self.allowance.of(data) if self._is_welcome(host) else b""
        data = line.recv(most)
        if not data:
            raise ConnectionError(None, "the other end closed the connection")
        return self.allowance.of(data)

    def _is_welcome(self, host: str) -> bool:
        address = ip_address(host.partition("%")[0])
        if any(address in network for network in self._senders):
            return True
        self.trouble = f"data from {host} are not taken: it is not among the senders of the vehicle's file"
        return False

    def _lost(self, why: str) -> None:
        """Close a lost connection. A server goes on listening while its sender is gone."""
        self.trouble = why if self._door is None else f"nobody is connected: {why}"
        if self._line is not None:
            self._ready.unregister(self._line)
            self._line.close()
            self._line = None
