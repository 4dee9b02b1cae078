"""The local command socket: the console's words over a UNIX socket, one JSON object a line, each answered with the state.

`{"command": "watch"}` turns a connection into a stream of states, newest only: a slow reader misses some and delays
no other.
"""

import asyncio
from collections.abc import Callable
from typing import cast

from delfim.base.errors import FormatError
from delfim.vehicle import console
from delfim.vehicle.loop import LOCAL
from delfim.vehicle.operator.reviews import Reviews
from delfim.vehicle.orders.entrusting import PAYLOAD

LINE_BYTES = 1 << 17  # a part of a mission's text fits, however it is escaped
STOPS = (b'"stop"', b'"shutdown"')  # commands that end the review of a plan, even from the end of the queue
BACKLOG_BYTES = 1 << 16


class CommandServer:
    """All connections of the local command socket. `obey` carries out a command of an operator, or of a payload program, and
    returns the reason of a refusal, or None; `reviews` does the same with a plan after its review; `report` is the boat's, in
    JSON."""

    def __init__(
        self,
        obey: Callable[[console.Commands, str], str | None],
        reviews: Reviews,
        report: Callable[[], bytes],
        clients_max: int,
    ) -> None:
        self.obey, self.reviews, self.report = obey, reviews, report
        self.clients_max = clients_max
        self.clients: set[Connection] = set()

    def connection(self) -> "Connection":
        return Connection(self)

    def publish(self, everyone: bool = True) -> None:
        """Send the present state to every watching connection that keeps up, or to the quick ones alone."""
        watching = [each for each in self.clients if (each.watching if everyone else each.quick) and not each.behind()]
        if watching:
            line = console.answer(None, self.report())
            for client in watching:
                client.write(line)

    def close(self) -> None:
        self.reviews.cancel("the program ends")
        for client in list(self.clients):
            client.abort()


class Connection(asyncio.Protocol):
    def __init__(self, server: CommandServer) -> None:
        self._server = server
        self._transport: asyncio.Transport | None = None
        self._loop = asyncio.get_running_loop()
        self._buffer = bytearray()
        self._is_due = self._under_review = False  # the next line; a plan of this connection
        self._is_brief = False  # the answer to a payload program has no state
        self.watching = self.quick = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)  # uvloop's transports do not inherit from it
        if len(self._server.clients) >= self._server.clients_max:
            self.write(console.answer("too many connections", b"{}"))
            transport.close()
            return
        self._server.clients.add(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self._server.clients.discard(self)

    def data_received(self, data: bytes) -> None:
        began = max(len(self._buffer) - len(STOPS[-1]), 0)
        self._buffer += data
        if self._under_review:
            self._heed_stop(began)
        elif not self._is_due:
            self._line()
        if self._transport is not None and len(self._buffer) > LINE_BYTES:
            self._transport.pause_reading()

    def _line(self) -> None:
        """Carry out one line; further ones follow after other due callbacks."""
        self._is_due = False
        end = self._buffer.find(b"\n")
        if end > LINE_BYTES or (end < 0 and len(self._buffer) > LINE_BYTES) or self.behind():
            self.abort()
            return
        if end < 0:
            return
        line = bytes(self._buffer[:end])
        del self._buffer[: end + 1]
        try:
            command = console.parse(line)
        except FormatError as error:
            self._answer(str(error))
            return
        if isinstance(command, console.Watch):
            self.watching, self.quick = True, command.quick
        operator = LOCAL
        self._is_brief = isinstance(command, console.OfPayload)
        if isinstance(command, console.OfPayload):
            operator, command = f"{PAYLOAD}{command.payload}", command.order
        if isinstance(command, console.Plan) and not (isinstance(command, console.LoadMission) and command.more):
            self._under_review = True
            self._server.reviews.begin(operator, command, self._answer)
            self._heed_stop(0)
        else:
            self._answer(self._server.obey(command, operator))

    def _heed_stop(self, began: int) -> None:
        """A stop that waits behind a plan under review ends the review."""
        if self._under_review and any(self._buffer.find(word, began) >= 0 for word in STOPS):
            self._server.reviews.cancel("a stop was commanded after it")

    def _answer(self, reason: str | None) -> None:
        self._under_review = False
        self.write(console.answer(reason, b"{}" if self._is_brief else self._server.report()))
        if self._transport is not None and len(self._buffer) <= LINE_BYTES:
            self._transport.resume_reading()
        if not self._is_due:
            self._is_due = True
            self._loop.call_soon(self._line)

    def behind(self) -> bool:
        """Whether the other side does not read its answers."""
        return self._transport is None or self._transport.get_write_buffer_size() > BACKLOG_BYTES

    def write(self, line: bytes) -> None:
        if self._transport is not None:
            self._transport.write(line)

    def abort(self) -> None:
        if self._transport is not None:
            self._transport.abort()
