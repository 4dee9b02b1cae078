"""Both ends of the DSOR protocol on a CAN socket, and the addresses of thesis 5.2.6. An endpoint never waits, and has neither
thread nor task: its owner calls `step`."""

import heapq
from collections import deque
from collections.abc import Callable, Iterator
from math import inf
from typing import Final, NamedTuple

from delfim.base.errors import FormatError, Refused
from delfim.base.frames import Frame
from delfim.canproxy.dsor.protocol import BROADCAST, Message, ack_filter, iter_segments, message_filter
from delfim.canproxy.dsor.receiver import Receiver
from delfim.canproxy.dsor.sender import MessageSender
from delfim.canproxy.socket import CanAddress, CanSocket

PRIORITY: Final = 0x80  # the default: in the middle
ANY_ID: Final = -1  # in `bind`: segmented messages of any identifier
INBOX_MAX: Final = 64  # whole messages that wait to be taken; while this many wait, no new one is begun
OUTBOX_MAX: Final = 256  # frames and broadcast messages that wait for the bus
_FRAMES_PER_STEP: Final = 16  # in, and out: bounds one call on a flooded bus
_FULL_RETRY_S: Final = 0.001  # the kernel has no event for room in an interface's queue


class CanSegm(NamedTuple):
    """`struct sockaddr_cansegm`: a segmented message with its identifier. In `bind`, `node` is this node and the priority means
    nothing; in sending, `node` is the destination; of a received message, its source."""

    priority: int  # 0..255, lowest wins the bus
    node: int  # 0..0x7E; 0x7F in sending: everybody
    id: int  # 32 bits; ANY_ID in `bind`


class CanPort(NamedTuple):
    """`struct sockaddr_canport`: a message to a port of a node. The node is used as in CanSegm. The sending port is not
    transmitted: a received message has its source node with the port that it came to."""

    port: int  # 16 bits: 512 * node + port number 0..511
    priority: int = PRIORITY

    @property
    def node(self) -> int:
        return self.port >> 9


Address = CanSegm | CanPort


def message_to(address: Address, source: int, data: bytes) -> Message:
    """The message that carries `data` to an address. Raises FormatError."""
    if isinstance(address, CanSegm):
        return Message(address.priority, source, address.node, address.id, data)
    if not 0 <= address.port <= 0xFFFF:
        raise FormatError(f"port {address.port} is outside 0..65535")
    return Message(address.priority, source, address.node, 0, data, port=address.port & 511)


def source_of(message: Message) -> Address:
    """The address that an answer to a received message goes to."""
    if message.port is None:
        return CanSegm(message.priority, message.source, message.id)
    return CanPort(message.source << 9 | message.port & 511, message.priority)


class Endpoint:
    """Both ends of the protocol for one node, on a CAN socket of its own. Its owner calls `step` when `can` is readable
    and when `next_due_s` has come, and empties `inbox` and `outcomes`.

    inbox     whole messages; bounded, because headers are not answered while INBOX_MAX wait
    outcomes  how addressed messages ended, the latest `sending_max`
    errors    reason in words -> count
    """

    def __init__(self, can: CanSocket, node: int, sending_max: int = 64) -> None:
        """Raises FormatError for a node out of range, BusError."""
        if not 0 <= node < BROADCAST:
            raise FormatError(f"node {node} is outside 0..{BROADCAST - 1}")
        self.can, self.node = can, node
        self.inbox: deque[Message] = deque()
        self._receiver = Receiver(node, self._accepts)
        self._sender = MessageSender(node, queue_max=sending_max)
        self.outcomes, self.errors = self._sender.outcomes, self._receiver.errors
        self._wanted: Callable[[Message], bool] = lambda message: False
        self._outbox: list[tuple[int, bool, int, Iterator[Frame]]] = []
        """A heap: by priority; at the same one broadcast messages last, for a peer's patience is short; then first come."""
        self._serial = self._broadcasts = 0
        self._held: Frame | None = None  # the frame that found the bus's queue full
        self._flush_s = inf
        can.setblocking(False)
        can.bind(CanAddress(*ack_filter(node)))

    def listen(self, wanted: Callable[[Message], bool]) -> None:
        """Receive the wanted messages to this node and to all nodes; `wanted` sees them without data. Other messages are not
        acknowledged: another program on this node may want them. Raises BusError."""
        self._wanted = wanted
        filters = (ack_filter(self.node), message_filter(destination=self.node), message_filter(destination=BROADCAST))
        self.can.bind(*(CanAddress(*each) for each in filters))

    def start(self, message: Message, now_s: float) -> None:
        """Begin to send a message. Raises Refused if too many messages wait, FormatError, BusError."""
        if message.destination != BROADCAST:
            frames = iter(self._sender.start(message, now_s))
        else:
            if len(self._outbox) >= OUTBOX_MAX:
                raise Refused(f"{OUTBOX_MAX} frames and messages already wait for the bus")
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
        """Read waiting frames, up to a bound, and send due ones. Raises BusError; the frame that caused it is lost."""
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
            self.errors["outbox full"] += 1  # the other node repeats its frame
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
