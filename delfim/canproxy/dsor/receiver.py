"""The receiving end of the DSOR protocol: frames and time in, whole messages and acknowledgements out. The owner of the socket
feeds the frames and sends the replies.
"""

import math
import zlib
from collections import Counter, deque
from collections.abc import Callable
from typing import Final, NamedTuple

from delfim.base.frames import Frame
from delfim.canproxy.dsor.protocol import (
    ACK_DATA,
    ACK_FRAME,
    BODY_FRAME,
    BROADCAST,
    CRC,
    CRC_RESIDUE,
    DESTINATION_AT,
    FRAME_TYPE,
    HEADER_FRAME,
    PRIORITY_AT,
    SEQUENCE_AT,
    SOURCE_AT,
    STREAM,
    Ack,
    Message,
    is_broadcast,
    read_header,
)

REASSEMBLY_TIMEOUT_S: Final = 1.0
_new = tuple.__new__  # a third of the time of Message(...)


class _Assembly:
    """A message whose header was received. `stream` begins with the header, as the CRC does."""

    __slots__ = ("announced", "answered", "header", "heard_s", "missing", "next", "number", "stream")

    def __init__(self, number: int, header: bytes, length: int, announced: Message, now_s: float) -> None:
        self.number, self.header, self.announced, self.heard_s = number, header, announced, now_s
        self.answered = announced.destination != BROADCAST
        self.stream = bytearray(header)
        self.missing = length + CRC.size
        self.next = 0  # segment


class _Received(NamedTuple):
    """The last message of a stream. While it is remembered, its header or one of the 15 headers before it counts as late."""

    number: int
    header: bytes
    segments: int


class Receiver:
    """Assembles the messages to `node` and to all nodes. One per user of messages; several may serve one node.

    `accept` sees each announced message without its data and says whether it is received here; None receives all. A message
    that is not accepted is not answered: another program on this node may want it.

    replies  acknowledgements that the caller sends, at most 64; if the caller does not take them the oldest is lost
    errors   reason in words -> count

    Memory is bounded: `open_max` messages under way, each of at most 64 KiB; a new one replaces the one that is silent
    for longest.
    """

    def __init__(
        self,
        node: int,
        accept: Callable[[Message], bool] | None = None,
        *,
        timeout_s: float = REASSEMBLY_TIMEOUT_S,
        open_max: int = 16,
    ) -> None:
        self.replies: deque[Frame] = deque(maxlen=64)
        self.errors: Counter[str] = Counter()
        self._node, self._accept, self._timeout_s, self._open_max = node, accept, timeout_s, open_max
        self._open: dict[int, _Assembly] = {}
        self._last: dict[int, _Received] = {}  # by stream

    @property
    def next_due_s(self) -> float:
        """The time when `expire` has something to do; infinity while no message is under way."""
        return min((assembly.heard_s for assembly in self._open.values()), default=math.inf) + self._timeout_s

    @property
    def is_waiting(self) -> bool:
        """Whether a message is under way."""
        return bool(self._open)

    def feed(self, frame: Frame, now_s: float) -> Message | None:
        """Take a frame, and return the message that it completes. Never raises; other frames are ignored."""
        arb, data, t_ns, _, _ = frame
        kind = arb & FRAME_TYPE
        if kind == BODY_FRAME:
            assembly = self._open.get(arb & STREAM)
            if assembly is None:
                self._stray(arb)
                return None
            missing = assembly.missing
            if arb >> SEQUENCE_AT & 31 != assembly.next & 31 or len(data) != (missing if missing < 8 else 8):
                self._misplaced(arb, assembly)
                return None
            assembly.stream += data
            assembly.heard_s = now_s
            assembly.next += 1
            if missing > 8:
                assembly.missing = missing - 8
                if assembly.answered:
                    self._acknowledge(arb, Ack.BODY, assembly.number, assembly.next)
                return None
            return self._completed(arb, assembly, t_ns)
        if kind == HEADER_FRAME:
            self._header(arb, data, now_s)
        return None

    def expire(self, now_s: float) -> None:
        """Drops the messages that have been silent for as long as the time-out."""
        for stream, assembly in list(self._open.items()):
            if assembly.heard_s + self._timeout_s <= now_s:
                self._drop(stream, "timed out")

    def _header(self, arb: int, header: bytes, now_s: float) -> None:
        if arb >> DESTINATION_AT & 0x7F not in (self._node, BROADCAST):
            return
        announced = read_header(arb, header)
        if announced is None:
            self.errors["malformed header"] += 1
            return
        length, message = announced
        stream, number = arb & STREAM, arb >> SEQUENCE_AT & 31
        assembly, last = self._open.get(stream), self._last.get(stream)
        accepted = self._accept is None or self._accept(message)
        is_late = last is not None and last.number - number & 31 < 16
        if not accepted:
            if not is_late:
                self._last.pop(stream, None)  # the next frames on this stream are for another node
        elif assembly and (number, header) == (assembly.number, assembly.header) and (assembly.answered or not assembly.next):
            assembly.heard_s = now_s
            self._acknowledge(arb, Ack.HEADER, number, assembly.next)
            return
        elif last and is_late and message.destination != BROADCAST:
            self._acknowledge(arb, Ack.COMPLETE, number, last.segments if last[:2] == (number, header) else 0)
            return
        if assembly:
            del self._open[stream]
            self.errors["superseded"] += 1
        if not accepted:
            return
        if len(self._open) >= self._open_max:
            self._drop(min(self._open, key=lambda each: self._open[each].heard_s), "crowded out")
        self._open[stream] = assembly = _Assembly(number, header, length, message, now_s)
        if assembly.answered:
            self._acknowledge(arb, Ack.HEADER, number, 0)

    def _completed(self, arb: int, assembly: _Assembly, t_ns: int) -> Message | None:
        stream = arb & STREAM
        if zlib.crc32(assembly.stream) != CRC_RESIDUE:
            self._drop(stream, "wrong CRC")
            return None
        del self._open[stream]
        if len(self._last) >= 128:
            del self._last[next(iter(self._last))]
        self._last[stream] = _new(_Received, (assembly.number, assembly.header, assembly.next))
        if assembly.answered:
            self._acknowledge(arb, Ack.COMPLETE, assembly.number, assembly.next)
        priority, source, destination, identifier, _, _, port, address = assembly.announced
        data = bytes(assembly.stream[len(assembly.header) : -4])  # less the CRC
        return _new(Message, (priority, source, destination, identifier, data, t_ns, port, address))

    def _misplaced(self, arb: int, assembly: _Assembly) -> None:
        """Count a body frame other than the expected one: repeated, too long or short, late, or after a lost one."""
        sequence = arb >> SEQUENCE_AT & 31
        if assembly.next and sequence == assembly.next - 1 & 31:
            self.errors["duplicate"] += 1
            self._acknowledge(arb, Ack.BODY, assembly.number, assembly.next)
        elif sequence == assembly.next & 31:
            self._drop(arb & STREAM, "wrong length")
        elif assembly.answered:
            self.errors["out of order"] += 1  # delayed on its way; the sender repeats the expected one
        else:
            self._drop(arb & STREAM, "out of order")

    def _stray(self, arb: int) -> None:
        """Handle a body frame without an open message: the last one of a message that is complete, or its header was lost."""
        last = self._last.get(arb & STREAM)
        if last is None:
            return
        sequence = arb >> SEQUENCE_AT & 31
        if sequence == last.segments - 1 & 31 and not is_broadcast(arb):
            self.errors["duplicate"] += 1
            self._acknowledge(arb, Ack.COMPLETE, last.number, last.segments)
        elif sequence == 0:
            self.errors["header lost"] += 1

    def _drop(self, stream: int, reason: str) -> None:
        number = self._open.pop(stream).number
        self.errors[reason] += 1
        self._acknowledge(stream | number << SEQUENCE_AT, Ack.REFUSED, number, 0)

    def _acknowledge(self, arb: int, kind: Ack, number: int, segment: int) -> None:
        """Queue an acknowledgement; `segment` is the index of the next expected segment."""
        if is_broadcast(arb):
            return
        if len(self.replies) == self.replies.maxlen:
            self.errors["reply lost"] += 1
        back = (arb >> DESTINATION_AT & 0x7F) << SOURCE_AT | (arb >> SOURCE_AT & 0x7F) << DESTINATION_AT
        back |= arb & (0xFF << PRIORITY_AT | 31 << SEQUENCE_AT) | ACK_FRAME
        self.replies.append(Frame(back, ACK_DATA.pack(kind, number, segment)))
