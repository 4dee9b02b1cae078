"""The local command socket: the console's words over a UNIX socket, one JSON object a line, each answered with the state.

`{"command": "watch"}` turns a connection into a stream of states, newest only: a reader that is slow misses some and delays
nobody.
"""

import asyncio
from collections.abc import Callable
from typing import Any, cast

from delfim.errors import FormatError
from delfim.vehicle import console

LINE_BYTES = 1 << 21  # a mission file fits
BACKLOG_BYTES = 1 << 16


class CommandServer:
    """All connections of the local command socket. `obey` carries out a command and returns why not, or None."""

    def __init__(
        self,
        obey: Callable[[console.Commands], str | None],
        snapshot: Callable[[], dict[str, Any]],
        clients_max: int,
    ) -> None:
        self.obey, self.snapshot, self.clients_max = obey, snapshot, clients_max
        self.clients: set[Connection] = set()

    def connection(self) -> "Connection":
        return Connection(self)

    def publish(self) -> None:
        """The present state to every watching connection that keeps up."""
        watching = [client for client in self.clients if client.watching and not client.behind()]
        if watching:
            line = console.answer(None, self.snapshot())
            for client in watching:
                client.write(line)

    def close(self) -> None:
        for client in list(self.clients):
            client.abort()


class Connection(asyncio.Protocol):
    def __init__(self, server: CommandServer) -> None:
        self._server = server
        self._transport: asyncio.Transport | None = None
        self._buffer = b""
        self.watching = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)  # uvloop's are none by descent
        if len(self._server.clients) >= self._server.clients_max:
            self.write(console.answer("too many connections", {}))
            transport.close()
            return
        self._server.clients.add(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self._server.clients.discard(self)

    def data_received(self, data: bytes) -> None:
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        for line in lines:
            self._line(line)
        if len(self._buffer) > LINE_BYTES or self.behind():
            self.abort()

    def _line(self, line: bytes) -> None:
        server = self._server
        try:
            command = console.parse(line)
            self.watching = self.watching or isinstance(command, console.Watch)
            reason = server.obey(command)
        except FormatError as error:
            reason = str(error)
        self.write(console.answer(reason, server.snapshot()))

    def behind(self) -> bool:
        """Whether the other side does not read what it is sent."""
        return self._transport is None or self._transport.get_write_buffer_size() > BACKLOG_BYTES

    def write(self, line: bytes) -> None:
        if self._transport is not None:
            self._transport.write(line)

    def abort(self) -> None:
        if self._transport is not None:
            self._transport.abort()
