"""The sending end of the DSOR protocol: messages, acknowledgements and time in, frames out. The socket's owner sends the
frames and feeds the acknowledgements.
"""

import math
from collections import deque
from typing import Final

from delfim.base.errors import FormatError, Refused
from delfim.base.frames import Frame
from delfim.canproxy.dsor.protocol import (
    ACK_DATA,
    ACK_FRAME,
    BODY_FRAME,
    BROADCAST,
    DESTINATION_AT,
    FRAME_TYPE,
    PRIORITY_AT,
    SEQUENCE_AT,
    SOURCE_AT,
    STREAM,
    Ack,
    Kind,
    Message,
    Outcome,
    dsor_arb,
    encoded,
    segments,
)

TRANSMIT_TIMEOUT_S: Final = 0.1
RETRANSMIT_MAX: Final = 5
RESTART_MAX: Final = 2  # times that a refused message is sent again from its header


class _Transfer:
    """A message under way. `segment` is the one whose acknowledgement is awaited, -1 the header."""

    __slots__ = (
        "arb",
        "count",
        "due_s",
        "header",
        "message",
        "number",
        "restarts",
        "retransmits",
        "segment",
        "stream",
        "whole",
    )

    def __init__(self, message: Message) -> None:
        self.arb = dsor_arb(message.priority, Kind.HEADER, message.source, message.destination, 0)
        self.header, self.stream = encoded(message)
        self.message, self.number = message, 0
        self.count = -(-len(self.stream) // 8)
        self.segment = -1
        self.restarts = self.retransmits = 0
        self.due_s = math.inf
        self.whole = False  # every segment was sent once

    def frame(self) -> Frame:
        if self.segment < 0:
            return Frame(self.arb | self.number << SEQUENCE_AT, self.header)
        arb = self.arb | BODY_FRAME | (self.segment & 31) << SEQUENCE_AT
        return Frame(arb, self.stream[8 * self.segment : 8 * self.segment + 8])


class MessageSender:
    """Sends messages of `node`, each frame after the acknowledgement of the one before. Messages of different priority or to
    different nodes travel side by side, others wait for each other.

    A broadcast message is not acknowledged: `start` returns all of its frames, and nothing follows.

    outcomes  how each addressed message ended, to be taken after each call; the latest `queue_max`
    """

    def __init__(
        self,
        node: int,
        *,
        timeout_s: float = TRANSMIT_TIMEOUT_S,
        retransmit_max: int = RETRANSMIT_MAX,
        queue_max: int = 64,
    ) -> None:
        self.outcomes: deque[Outcome] = deque(maxlen=queue_max)
        self._node, self._timeout_s, self._retransmit_max, self._queue_max = node, timeout_s, retransmit_max, queue_max
        self._streams: dict[int, deque[_Transfer]] = {}  # by stream of the acknowledgements; the first is under way
        self._numbers: dict[int, int] = {}  # of the last message of each stream, which has all numbers to itself

    @property
    def next_due_s(self) -> float:
        """The time when `poll` has something to do; infinity while nothing is under way."""
        return min((queue[0].due_s for queue in self._streams.values()), default=math.inf)

    def start(self, message: Message, now_s: float) -> list[Frame]:
        """Take a message; return the frames to send now. Raises Refused when `queue_max` messages are under way or waiting,
        FormatError for a message that does not fit or of another node."""
        if message.source != self._node:
            raise FormatError(f"node {self._node:#04x} does not send messages of node {message.source:#04x}")
        stream = _answers(message)
        if message.destination == BROADCAST:
            return segments(message, self._next_number(stream))
        if sum(map(len, self._streams.values())) >= self._queue_max:
            raise Refused(f"{self._queue_max} messages are already waiting")
        transfer = _Transfer(message)
        queue = self._streams.setdefault(stream, deque())
        queue.append(transfer)
        return [self._begin(stream, transfer, now_s)] if len(queue) == 1 else []

    def feed(self, frame: Frame, now_s: float) -> list[Frame]:
        """Take an acknowledgement, and return the frames to send then. Never raises; other frames are ignored."""
        queue = self._streams.get(frame.arb & STREAM)
        if queue is None or frame.arb & FRAME_TYPE != ACK_FRAME or len(frame.data) != ACK_DATA.size:
            return []
        transfer = queue[0]
        kind, number, segment = ACK_DATA.unpack(frame.data)
        waiting_header = transfer.segment < 0
        if number != transfer.number:
            return []
        if kind == Ack.HEADER and waiting_header and segment < transfer.count:
            return [self._send(transfer, segment, now_s)]
        if kind == Ack.BODY and not waiting_header and segment == transfer.segment + 1:
            if segment < transfer.count:
                return [self._send(transfer, segment, now_s)]
            return self._restart(transfer, now_s)  # the receiver expects more: it received another header
        if kind == Ack.COMPLETE and segment == transfer.count and transfer.whole:
            return self._end(transfer, "", now_s)
        if kind == Ack.COMPLETE and waiting_header and not transfer.whole:  # the number is from before this node was started
            self._numbers[frame.arb & STREAM] = transfer.number = transfer.number + 16 & 31
            return self._restart(transfer, now_s)
        if kind == Ack.REFUSED and not waiting_header:
            return self._restart(transfer, now_s)
        return []

    def poll(self, now_s: float) -> list[Frame]:
        """The retransmissions that are due, and the first frames of messages that waited for one that failed."""
        frames = []
        for transfer in [queue[0] for queue in self._streams.values() if queue[0].due_s <= now_s]:
            if transfer.retransmits < self._retransmit_max:
                transfer.retransmits += 1
                transfer.due_s = now_s + self._timeout_s
                frames.append(transfer.frame())
            else:
                what = f"segment {transfer.segment} of {transfer.count}" if transfer.segment >= 0 else "the header"
                node = transfer.message.destination
                frames += self._end(transfer, f"node {node:#04x} did not acknowledge {what}", now_s)
        return frames

    def _next_number(self, stream: int) -> int:
        self._numbers[stream] = number = self._numbers.get(stream, 0) + 1 & 31
        return number

    def _begin(self, stream: int, transfer: _Transfer, now_s: float) -> Frame:
        transfer.number = self._next_number(stream)
        return self._send(transfer, -1, now_s)

    def _send(self, transfer: _Transfer, segment: int, now_s: float) -> Frame:
        transfer.segment, transfer.retransmits, transfer.due_s = segment, 0, now_s + self._timeout_s
        transfer.whole |= segment == transfer.count - 1
        return transfer.frame()

    def _restart(self, transfer: _Transfer, now_s: float) -> list[Frame]:
        transfer.restarts += 1
        if transfer.restarts <= RESTART_MAX:
            return [self._send(transfer, -1, now_s)]
        node = transfer.message.destination
        return self._end(transfer, f"node {node:#04x} refused the message {transfer.restarts} times", now_s)

    def _end(self, transfer: _Transfer, failure: str, now_s: float) -> list[Frame]:
        """Record the outcome; return the first frame of the message that waited for it."""
        self.outcomes.append(Outcome(transfer.message, failure))
        stream = (
            transfer.message.priority << PRIORITY_AT | transfer.message.destination << SOURCE_AT | self._node << DESTINATION_AT
        )
        queue = self._streams[stream]
        queue.popleft()
        if queue:
            return [self._begin(stream, queue[0], now_s)]
        del self._streams[stream]
        return []


def _answers(message: Message) -> int:
    """The stream on which the acknowledgements of a message come."""
    return message.priority << PRIORITY_AT | message.destination << SOURCE_AT | message.source << DESTINATION_AT
