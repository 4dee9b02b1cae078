"""Sockets for DSOR messages (thesis 5.2.6) over any CAN socket: a blocking one for programs, one for an asyncio loop.

`DsorSocket` is used like a UDP socket: bind, connect, sendto, recvfrom. `DsorTransport` calls back. There is no thread and no
task: a blocking socket answers the bus while a call of it is under way, and at no other time.
"""

import asyncio
import errno
import os
import select
import time
from collections import deque
from collections.abc import Callable
from math import inf
from types import TracebackType
from typing import Final, Self

from delfim.base.errors import BusError, Refused
from delfim.canproxy.dsor.endpoint import ANY_ID, Address, CanPort, Endpoint, message_to, source_of
from delfim.canproxy.dsor.protocol import BROADCAST, Message, Outcome
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import MSG_DONTWAIT, CanSocket

REBIND_S: Final = 1.0  # pause between attempts to reopen a bus that failed


class DsorSocket:
    """A socket for messages of one node, blocking unless told otherwise; the calls mean the same as for UDP.

    An addressed message is *delivered* when `sendto` returns: the other node has it whole and intact. If that is not
    known, BusError tells why. Broadcast messages are then only queued for the bus; nothing tells who receives them.
    With MSG_DONTWAIT, a time-out of 0, or after TimeoutError, a message stays under way: it goes on while later calls run,
    and its end is in `outcomes`.

    Two sockets that send from one node to another at one priority disturb each other; give each a priority of its own.
    """

    def __init__(self, can: CanSocket, node: int) -> None:
        """Takes over `can`. Raises FormatError for a node outside 0..0x7E, BusError."""
        self._end = Endpoint(can, node)
        self._timeout_s: float | None = None
        self._peer: Address | None = None
        self._poll = select.poll()
        self._poll.register(can.fileno(), select.POLLIN)
        self.node, self.errors = node, self._end.errors
        self.outcomes: deque[Outcome] = deque(maxlen=64)
        """How messages ended for which no call waited, latest last."""

    def fileno(self) -> int:
        """The file descriptor to wait on for reading; -1 after close."""
        return self._end.can.fileno()

    def bind(self, address: Address) -> None:
        """Receive the messages of an identifier, or to a port, that are for this node or for everybody. Raises OSError
        (EADDRNOTAVAIL) for another node than this socket's."""
        if address.node != self.node:
            raise OSError(errno.EADDRNOTAVAIL, os.strerror(errno.EADDRNOTAVAIL))
        if isinstance(address, CanPort):
            self._end.listen(lambda message: message.address is None and message.port == address.port & 511)
        else:
            self._end.listen(lambda message: message.port is None and address.id in (message.id, ANY_ID))

    def connect(self, address: Address) -> None:
        """Set the destination of every later `send`."""
        self._peer = address

    def send(self, data: bytes, flags: int = 0) -> int:
        """Send to the destination of `connect`. Raises OSError (EDESTADDRREQ) without it."""
        if self._peer is None:
            raise OSError(errno.EDESTADDRREQ, os.strerror(errno.EDESTADDRREQ))
        return self.sendto(data, self._peer, flags)

    def sendto(self, data: bytes, address: Address, flags: int = 0) -> int:
        """Send 0 to 65,535 bytes; returns their number. Raises FormatError if it does not fit, BusError with the reason
        if it was not acknowledged, TimeoutError, BlockingIOError if too many messages are under way."""
        message = message_to(address, self.node, data)
        deadline_s = self._deadline_s(flags)
        self.step()
        while True:
            try:
                self._end.start(message, time.monotonic())
                break
            except Refused:
                self._turn(deadline_s)
        ended: Outcome | None = None
        while deadline_s > -inf and ended is None:
            if message.destination == BROADCAST and not self._end.is_sending:
                break
            ended = self._turn(deadline_s, message)
        if ended and ended.failure:
            raise BusError(ended.failure)
        return len(data)

    def recv(self, length: int, flags: int = 0) -> bytes:
        """Receive the next message's data; bytes beyond `length` are lost for ever."""
        return self.recvmsg(flags).data[:length]

    def recvfrom(self, length: int, flags: int = 0) -> tuple[bytes, Address]:
        """Receive as `recv` does, with the address that an answer goes to."""
        message = self.recvmsg(flags)
        return message.data[:length], source_of(message)

    def recvmsg(self, flags: int = 0) -> Message:
        """Receive the next message, whole. Raises BlockingIOError, TimeoutError, BusError."""
        deadline_s = self._deadline_s(flags)
        self.step()
        while not self._end.inbox:
            self._turn(deadline_s)
        return self._end.inbox.popleft()

    def step(self) -> float:
        """Do what needs no waiting. A program with a loop of its own calls it when `fileno` is readable and after the
        number of seconds that it returns. Raises BusError."""
        now_s = time.monotonic()
        self._end.step(now_s)
        self._collect(None)
        return max(0.0, self._end.next_due_s - now_s)

    def rebind(self) -> bool:
        """Reopen a bus that failed; True when it can be used."""
        return self._end.can.rebind()

    def setblocking(self, flag: bool) -> None:
        self._timeout_s = None if flag else 0.0

    def settimeout(self, timeout_s: float | None) -> None:
        """Set the time-out: None blocks, 0 does not; otherwise TimeoutError is raised after this many seconds."""
        self._timeout_s = timeout_s

    def close(self) -> None:
        self._end.can.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _deadline_s(self, flags: int) -> float:
        """The time when a call has to end; -infinity if it must not wait."""
        if flags & MSG_DONTWAIT or self._timeout_s == 0:
            return -inf
        return inf if self._timeout_s is None else time.monotonic() + self._timeout_s

    def _turn(self, deadline_s: float, message: Message | None = None) -> Outcome | None:
        """Wait for something to do, and do it; return how this message ended, if it has."""
        if deadline_s == -inf:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        now_s = time.monotonic()
        if now_s >= deadline_s:
            raise TimeoutError("timed out")
        until_s = min(deadline_s, self._end.next_due_s)
        self._poll.poll(None if until_s == inf else max(0.0, until_s - now_s) * 1000.0)
        self._end.step(time.monotonic())
        return self._collect(message)

    def _collect(self, message: Message | None) -> Outcome | None:
        """Return the outcome of this message, if there is one; those of others are put aside."""
        found = None
        while self._end.outcomes:
            outcome = self._end.outcomes.popleft()
            if outcome.message is message:
                found = outcome
            else:
                self.outcomes.append(outcome)
        return found


def open_dsor(interface: str, node: int) -> DsorSocket:
    """Open a socket of `node` on an interface as `open_can` names them. Raises BusError, FormatError."""
    return DsorSocket(open_can(interface), node)


class DsorTransport:
    """The protocol in an asyncio loop: one reader and one timer. A callback takes the time of 16 frames in and 16 out at most.

    on_message  called with each whole message that `wanted` accepted
    on_outcome  called with the end of each addressed message

    A failed bus is counted in `errors` and reopened; the outcomes report the messages under way.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        can: CanSocket,
        node: int,
        *,
        wanted: Callable[[Message], bool] = lambda message: True,
        on_message: Callable[[Message], None] = lambda message: None,
        on_outcome: Callable[[Outcome], None] = lambda outcome: None,
        sending_max: int = 64,
    ) -> None:
        """`can` stays the caller's to close, after `close`. Raises FormatError for a node outside 0..0x7E, BusError."""
        self._loop, self._end = loop, Endpoint(can, node, sending_max)
        self._on_message, self._on_outcome = on_message, on_outcome
        self._timer: asyncio.TimerHandle | None = None
        self._rebind_s = inf
        self.errors = self._end.errors
        self._end.listen(wanted)
        loop.add_reader(can.fileno(), self._step)

    def send(self, message: Message) -> None:
        """Begin to send a message of this node. Raises Refused if too many wait, FormatError."""
        try:
            self._end.start(message, self._loop.time())
        except BusError:
            self._failed()
        self._arm()

    def close(self) -> None:
        """Stop all callbacks; messages under way are dropped."""
        self._loop.remove_reader(self._end.can.fileno())
        if self._timer:
            self._timer.cancel()

    def _step(self) -> None:
        now_s = self._loop.time()
        if now_s >= self._rebind_s:
            self._rebind_s = inf if self._end.can.rebind() else now_s + REBIND_S
        try:
            self._end.step(now_s)
        except BusError:
            self._failed()
        while self._end.inbox:
            self._on_message(self._end.inbox.popleft())
        while self._end.outcomes:
            self._on_outcome(self._end.outcomes.popleft())
        self._arm()

    def _failed(self) -> None:
        self.errors["bus failed"] += 1
        if self._rebind_s == inf:
            self._rebind_s = self._loop.time() + REBIND_S

    def _arm(self) -> None:
        """Set the timer, which may fire too early (harmless), but never too late."""
        due_s = min(self._end.next_due_s, self._rebind_s)
        if self._timer:
            if self._timer.when() <= due_s:
                return
            self._timer.cancel()
        self._timer = self._loop.call_at(due_s, self._ring) if due_s < inf else None

    def _ring(self) -> None:
        self._timer = None
        self._step()
