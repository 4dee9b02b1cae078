"""One UDP socket for all boats."""

import asyncio
import socket
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final, cast

IPTOS_LOWDELAY: Final = 0x10


class Udp(asyncio.DatagramProtocol):
    """One UDP socket for all boats: answers go to the address that a boat sends from."""

    def __init__(self, receive: Callable[[Any, bytes], None]) -> None:
        self._receive = receive
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)
        with suppress(OSError, AttributeError):  # not every system lets a program set it
            transport.get_extra_info("socket").setsockopt(socket.IPPROTO_IP, socket.IP_TOS, IPTOS_LOWDELAY)

    def datagram_received(self, data: bytes, address: Any) -> None:
        self._receive(("udp", *address[:2]), data)

    def error_received(self, exc: Exception) -> None:
        """Nobody listens at the other end now: the ages on the page show it."""

    def send(self, address: Any, data: bytes) -> None:
        if self._transport is not None:
            self._transport.sendto(data, address[1:])
