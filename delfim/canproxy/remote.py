"""A bus behind a socketcand server (cantcpd, or the reference one) as a transport of CanSocket.

socketcand does not carry remote and error frames, filters (frames are filtered after reception), or any report of a frame
that the server refused to send; cantcpd tells of those when it is asked (`confirm`). `rebind` restores a broken connection on
the same file descriptor.
"""

import errno
import os
import select
import socket
import time
from collections.abc import Callable, Sequence
from typing import Final

from delfim.base.errors import BusError, FormatError
from delfim.base.frames import CAN_ERR, CAN_RTR, Frame
from delfim.canproxy.canloop import stable_index
from delfim.canproxy.socket import CanAddress, accepts
from delfim.canproxy.socketcand import ELEMENT_BYTES, HI, OK, parse_frame, send_text

CONNECT_S: Final = 5.0  # for the connection, and for each answer while it is made
PEEK_BYTES: Final = 256  # more than any frame takes
UNSENT_BYTES: Final = 4096  # of commands that the connection did not take yet


class Remote:
    """The bus `HOST:PORT:BUS`. Making the connection blocks for CONNECT_S at most; nothing else blocks."""

    outlets: Callable[[], Sequence[int]] | None = None

    def __init__(self, place: str, receive_buffer_bytes: int) -> None:
        self.name, self.dropped, self.ifindex = f"socketcand:{place}", 0, stable_index(place)
        host_and_port, _, self._bus = place.rpartition(":")
        host, _, port = host_and_port.rpartition(":")
        if not host or not port.isdecimal() or not self._bus or not self._bus.isprintable() or set(self._bus) & set("<> "):
            raise BusError(f"socketcand:{place}: write socketcand:HOST:PORT:BUS, for example socketcand:127.0.0.1:29536:can0")
        self._address = (host.strip("[]"), int(port))
        self._receive_buffer_bytes = receive_buffer_bytes
        self._addresses: tuple[CanAddress, ...] = ()
        self._socket = self._connected()
        self._partial = self._unsent = b""
        self._failed = False

    def fileno(self) -> int:
        return self._socket.fileno()

    def close(self) -> None:
        self._socket.close()

    def filter(self, addresses: tuple[CanAddress, ...]) -> None:
        for address in addresses:
            if address.ifindex not in (0, self.ifindex):
                raise BusError(f"{self.name} has index {self.ifindex}: it receives no frames of interface {address.ifindex}")
        self._addresses = addresses

    def receive(self) -> Frame | None:
        """Take one element at a time from the kernel, so that the descriptor stays readable while there are others."""
        while (element := self._element()) is not None:
            try:
                frame = parse_frame(element.decode("ascii", "replace").split() or [""])
            except FormatError:
                continue
            if frame and any(accepts(address, frame.arb) for address in self._addresses):
                return frame._replace(ifindex=self.ifindex)
        return None

    def send(self, arb: int, data: bytes, ifindex: int) -> None:
        if len(data) > 8 or arb & (CAN_RTR | CAN_ERR):
            raise FormatError("socketcand carries data frames of up to 8 bytes")
        if ifindex not in (0, self.ifindex):
            raise BusError(f"{self.name} has index {self.ifindex}: it does not send by interface {ifindex}")
        if self._failed:
            raise BusError(f"{self.name}: not connected")
        self._push()
        if len(self._unsent) > UNSENT_BYTES:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        self._unsent += send_text(arb, data)
        self._push()

    def rehearse(self) -> None:
        """Do nothing: the server would send any frame to the bus."""

    def confirm(self) -> None:
        """Ask whether all that was sent is on the bus; waits for CONNECT_S at most. A server that does not know the question is
        believed. Raises BusError."""
        deadline_s = time.monotonic() + CONNECT_S
        self._unsent += b"< unsent >"
        while (left_s := deadline_s - time.monotonic()) > 0.0:
            self._push()
            if (element := self._element()) is None:
                select.select([self._socket], [self._socket] if self._unsent else [], [], left_s)
                continue
            word, number, *why = [*element.decode("ascii", "replace").split(), "", ""]
            if word == "unsent" and number != "0":
                raise BusError(f"{self.name}: {number} of these frames were not sent: {' '.join(why).strip()}")
            if word in ("unsent", "error"):
                return
        raise BusError(f"{self.name}: the server does not say whether it sent these frames")

    def rebind(self) -> bool:
        if not self._failed:
            return True
        try:
            fresh = self._connected()
        except BusError:
            return False
        with fresh:
            os.dup2(fresh.fileno(), self._socket.fileno())
        self._partial = self._unsent = b""
        self._failed = False
        return True

    def _connected(self) -> socket.socket:
        try:
            connection = socket.create_connection(self._address, CONNECT_S)
        except OSError as error:
            raise BusError(f"{self.name}: {error.strerror or error}") from None
        try:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, self._receive_buffer_bytes)
            for command, answer in ((b"", HI), (f"< open {self._bus} >".encode(), OK), (b"< rawmode >", OK)):
                connection.sendall(command)
                said = _element_of(connection)
                if said != answer:
                    raise BusError(f"{self.name}: the server says {said.decode('ascii', 'replace')!r}")
        except OSError as error:
            connection.close()
            raise error if isinstance(error, BusError) else BusError(f"{self.name}: {error.strerror or error}") from None
        connection.setblocking(False)
        return connection

    def _element(self) -> bytes | None:
        """The content of the next `< ... >`; None if none is complete."""
        while True:
            try:
                seen = self._socket.recv(PEEK_BYTES, socket.MSG_PEEK)
                end = seen.find(b">") + 1
                self._partial += self._socket.recv(end or len(seen)) if seen else b""
            except BlockingIOError:
                return None
            except OSError as error:
                raise self._failure(error.strerror or str(error)) from None
            if not seen:
                raise self._failure("the server closed the connection")
            if end:
                element, self._partial = self._partial, b""
                return element.rpartition(b"<")[2][:-1]
            if len(self._partial) > ELEMENT_BYTES:
                self._partial = b""

    def _push(self) -> None:
        try:
            self._unsent = self._unsent[self._socket.send(self._unsent) :]
        except BlockingIOError:
            pass
        except OSError as error:
            raise self._failure(error.strerror or str(error)) from None

    def _failure(self, why: str) -> BusError:
        """Report the failure once: a socket without traffic replaces the broken one."""
        self._failed = True
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
            silent.setblocking(False)
            os.dup2(silent.fileno(), self._socket.fileno())
        return BusError(f"{self.name}: {why}")


def _element_of(connection: socket.socket) -> bytes:
    """Read the next element byte by byte, so that the bytes after it stay."""
    element = b""
    while not element.endswith(b">") and len(element) < ELEMENT_BYTES:
        byte = connection.recv(1)
        if not byte:
            raise BusError("the server closed the connection")
        element += byte
    return element.strip()
