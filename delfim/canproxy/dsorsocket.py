"""Sockets for DSOR messages (thesis 5.2.6) over any CAN socket: a blocking face for programs, one for an asyncio loop.

`DsorSocket` is used like a UDP socket: bind, connect, sendto, recvfrom. `DsorTransport` calls back. Both stand on `Endpoint`,
which owns the two state machines of `delfim.canproxy.dsor` and the frames that wait for the bus, and never waits itself.
There is no thread and no task: a blocking socket answers the bus while a call of it is under way, and at no other time.
"""

import asyncio
import errno
import heapq
import os
import select
import time
from collections import deque
from collections.abc import Callable, Iterator
from math import inf
from socket import MSG_DONTWAIT
from types import TracebackType
from typing import Final, NamedTuple, Self

from delfim.canproxy.dsor import BROADCAST, Message, Outcome, Receiver, Sender, ack_filter, iter_segments, message_filter
from delfim.canproxy.socket import CanAddress, CanSocket, open_can
from delfim.errors import BusError, FormatError, Refused
from delfim.frames import Frame

PRIORITY: Final = 0x80  # where nobody says which: in the middle
ANY_ID: Final = -1  # to bind to: all segmented messages, whatever their identifier
INBOX_MAX: Final = 64  # whole messages that wait to be taken; while so many wait no further one is begun
OUTBOX_MAX: Final = 256  # frames and broadcast messages that wait for the bus
REBIND_S: Final = 1.0  # a bus that failed is looked after so often
_FRAMES_PER_STEP: Final = 16  # in, and out: bounds one call on a flooded bus
_FULL_RETRY_S: Final = 0.001  # the kernel has no event for room in an interface's queue


class CanSegm(NamedTuple):
    """`struct sockaddr_cansegm`: a segmented message with its identifier. In `bind`, `node` is this node and the priority means
    nothing; in sending, `node` is the destination; of a received message, its source."""

    priority: int  # 0..255, lowest wins the bus
    node: int  # 0..0x7E; 0x7F in sending: everybody
    id: int  # 32 bits; ANY_ID in `bind`


class CanPort(NamedTuple):
    """`struct sockaddr_canport`: a message to a port of a node. The node is used as in CanSegm. The port that a message comes
    from does not travel: a received message names its source node with the port that it came to."""

    port: int  # 16 bits: 512 * node + port number 0..511
    priority: int = PRIORITY

    @property
    def node(self) -> int:
        return self.port >> 9


Address = CanSegm | CanPort


def message_to(address: Address, source: int, data: bytes) -> Message:
    """The message that says `data` to an address. Raises FormatError."""
    if isinstance(address, CanSegm):
        return Message(address.priority, source, address.node, address.id, data)
    if not 0 <= address.port <= 0xFFFF:
        raise FormatError(f"port {address.port} is outside 0..65535")
    return Message(address.priority, source, address.node, 0, data, port=address.port & 511)


def source_of(message: Message) -> Address:
    """Where a received message came from, such that a message to this address is an answer."""
    if message.port is None:
        return CanSegm(message.priority, message.source, message.id)
    return CanPort(message.source << 9 | message.port & 511, message.priority)


class Endpoint:
    """Both ends of the protocol for one node, on a CAN socket of its own. Whoever owns it calls `step` when `can` is readable
    and when `next_due_s` has come, and takes what is in `inbox` and `outcomes`.

    inbox     whole messages; bounded, because headers are not answered while INBOX_MAX wait
    outcomes  how addressed messages ended, the latest `sending_max`
    errors    reason in words -> count
    """

    def __init__(self, can: CanSocket, node: int, sending_max: int = 64) -> None:
        """Raises FormatError for a node that is none, BusError."""
        if not 0 <= node < BROADCAST:
            raise FormatError(f"node {node} is outside 0..{BROADCAST - 1}")
        self.can, self.node = can, node
        self.inbox: deque[Message] = deque()
        self._receiver = Receiver(node, self._accepts)
        self._sender = Sender(node, queue_max=sending_max)
        self.outcomes, self.errors = self._sender.outcomes, self._receiver.errors
        self._wanted: Callable[[Message], bool] = lambda message: False
        self._outbox: list[tuple[int, bool, int, Iterator[Frame]]] = []
        """A heap: by priority; at the same one broadcast messages last, for a peer's patience is short; then first come."""
        self._serial = self._broadcasts = 0
        self._held: Frame | None = None  # found the bus's queue full
        self._flush_s = inf
        can.setblocking(False)
        can.bind(CanAddress(*ack_filter(node)))

    def listen(self, wanted: Callable[[Message], bool]) -> None:
        """Receive the messages to this node and to everybody that are wanted; `wanted` sees them without data. Others are not
        answered: somebody else on this node may want them. Raises BusError."""
        self._wanted = wanted
        filters = (ack_filter(self.node), message_filter(destination=self.node), message_filter(destination=BROADCAST))
        self.can.bind(*(CanAddress(*each) for each in filters))

    def start(self, message: Message, now_s: float) -> None:
        """Begin to send. Raises Refused where too many messages wait, FormatError, BusError."""
        if message.destination != BROADCAST:
            frames = iter(self._sender.start(message, now_s))
        else:
            if len(self._outbox) >= OUTBOX_MAX:
                raise Refused(f"{OUTBOX_MAX} frames and messages wait for the bus already")
            frames = iter_segments(message, self._broadcasts)
            self._broadcasts += 1
        self._put(message.priority, message.destination == BROADCAST, frames)
        self._flush(now_s)

    @property
    def next_due_s(self) -> float:
        return min(self._sender.next_due_s, self._receiver.next_due_s, self._flush_s)

    @property
    def is_sending(self) -> bool:
        """Whether frames wait for the bus."""
        return self._held is not None or bool(self._outbox)

    def step(self, now_s: float) -> None:
        """Read what came, up to a bound, and send what is due. Raises BusError; the frame that it concerned is lost."""
        try:
            for _ in range(_FRAMES_PER_STEP):
                frame = self.can.receive()
                if frame is None:
                    break
                message = self._receiver.feed(frame, now_s)
                if message is not None:
                    self.inbox.append(message)
                self._put_each(self._sender.feed(frame, now_s))
            self._receiver.expire(now_s)
            self._put_each(self._sender.poll(now_s))
        finally:
            while self._receiver.replies:
                self._put_each([self._receiver.replies.popleft()])
            self._flush(now_s)

    def _accepts(self, message: Message) -> bool:
        if not self._wanted(message):
            return False
        if len(self.inbox) >= INBOX_MAX:
            self.errors["inbox full"] += 1
            return False
        return True

    def _put_each(self, frames: list[Frame]) -> None:
        for frame in frames:
            self._put(frame.arb >> 24, False, iter((frame,)))

    def _put(self, priority: int, is_broadcast: bool, frames: Iterator[Frame]) -> None:
        if len(self._outbox) >= OUTBOX_MAX:
            self.errors["outbox full"] += 1  # whoever waits for an answer repeats
            return
        heapq.heappush(self._outbox, (priority, is_broadcast, self._serial, frames))
        self._serial += 1

    def _flush(self, now_s: float) -> None:
        """Hand frames to the bus until its queue is full, up to a bound."""
        send = self.can.sendmsg
        for _ in range(_FRAMES_PER_STEP):
            frame, self._held = self._held, None
            while frame is None and self._outbox:
                frame = next(self._outbox[0][3], None)
                if frame is None:
                    heapq.heappop(self._outbox)
            if frame is None:
                self._flush_s = inf
                return
            try:
                send(frame)
            except BlockingIOError:
                self._held, self._flush_s = frame, now_s + _FULL_RETRY_S
                return
        self._flush_s = now_s


class DsorSocket:
    """A socket for messages of one node, blocking unless told otherwise; the calls mean what they mean for UDP.

    An addressed message is *delivered* when `sendto` returns: the other node has it whole and intact. Where that cannot be
    said, BusError tells why. Broadcast messages are on their way to the bus then, and nobody knows who hears them.
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
        """File descriptor to wait on for reading; -1 after close."""
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
        """Set where every later `send` goes."""
        self._peer = address

    def send(self, data: bytes, flags: int = 0) -> int:
        """Send where `connect` said. Raises OSError (EDESTADDRREQ) where it did not."""
        if self._peer is None:
            raise OSError(errno.EDESTADDRREQ, os.strerror(errno.EDESTADDRREQ))
        return self.sendto(data, self._peer, flags)

    def sendto(self, data: bytes, address: Address, flags: int = 0) -> int:
        """Send 0 to 65,535 bytes; returns their number. Raises FormatError for what does not fit, BusError with the reason
        where the message was not acknowledged, TimeoutError, BlockingIOError where too many messages are under way."""
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
        """The next message's data; bytes beyond `length` are lost for ever."""
        return self.recvmsg(flags).data[:length]

    def recvfrom(self, length: int, flags: int = 0) -> tuple[bytes, Address]:
        """As `recv`, with the address that an answer goes to."""
        message = self.recvmsg(flags)
        return message.data[:length], source_of(message)

    def recvmsg(self, flags: int = 0) -> Message:
        """The next message, whole. Raises BlockingIOError, TimeoutError, BusError."""
        deadline_s = self._deadline_s(flags)
        self.step()
        while not self._end.inbox:
            self._turn(deadline_s)
        return self._end.inbox.popleft()

    def step(self) -> float:
        """What can be done without waiting; for a program with a loop of its own, which calls it when `fileno` is readable and
        after so many seconds as it returns. Raises BusError."""
        now_s = time.monotonic()
        self._end.step(now_s)
        self._collect(None)
        return max(0.0, self._end.next_due_s - now_s)

    def rebind(self) -> bool:
        """Take up a bus that failed. True when it can be used."""
        return self._end.can.rebind()

    def setblocking(self, flag: bool) -> None:
        self._timeout_s = None if flag else 0.0

    def settimeout(self, timeout_s: float | None) -> None:
        """None: block; 0: do not; otherwise raise TimeoutError after so many seconds."""
        self._timeout_s = timeout_s

    def close(self) -> None:
        self._end.can.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _deadline_s(self, flags: int) -> float:
        """When a call has to end; -infinity where it must not wait."""
        if flags & MSG_DONTWAIT or self._timeout_s == 0:
            return -inf
        return inf if self._timeout_s is None else time.monotonic() + self._timeout_s

    def _turn(self, deadline_s: float, message: Message | None = None) -> Outcome | None:
        """Wait for something to do, and do it. Returns how this message ended, if it has."""
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
        """The outcome of this message, if there is one; those of others are put aside."""
        found = None
        while self._end.outcomes:
            outcome = self._end.outcomes.popleft()
            if outcome.message is message:
                found = outcome
            else:
                self.outcomes.append(outcome)
        return found


def open_dsor(interface: str, node: int) -> DsorSocket:
    """A socket of `node` on an interface as `open_can` names them; raises BusError, FormatError."""
    return DsorSocket(open_can(interface), node)


class DsorTransport:
    """The protocol in an asyncio loop: one reader and one timer. A callback takes the time of 16 frames in and 16 out at most.

    on_message  called with each whole message that `wanted` accepted
    on_outcome  called with the end of each addressed message

    A bus that fails is counted in `errors` and taken up again; what was under way then is told by its outcome.
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
        """Begin to send a message of this node. Raises Refused where too many wait, FormatError."""
        try:
            self._end.start(message, self._loop.time())
        except BusError:
            self._failed()
        self._arm()

    def close(self) -> None:
        """Nothing is called any more; what was under way is forgotten."""
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
        """The timer may ring too early, which is harmless, but never too late."""
        due_s = min(self._end.next_due_s, self._rebind_s)
        if self._timer:
            if self._timer.when() <= due_s:
                return
            self._timer.cancel()
        self._timer = self._loop.call_at(due_s, self._ring) if due_s < inf else None

    def _ring(self) -> None:
        self._timer = None
        self._step()
