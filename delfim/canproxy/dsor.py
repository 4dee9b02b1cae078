"""The DSOR higher-layer protocol: messages longer than a frame, from node to node of the boat (thesis 5.2.6 and 5.3.3).

A message is a header frame and body frames. Between two nodes each frame is acknowledged before the next one is sent
(idle RQ); a broadcast message goes out back to back and is lost when a frame of it is lost. `docs/dsor.md` shows every bit.

State machines only: who owns the socket feeds frames and the time in, and sends what comes out. Routing between buses and
to IP is not done here.
"""

import math
import struct
import zlib
from collections import Counter, deque
from collections.abc import Callable, Iterator
from enum import IntEnum
from itertools import chain
from typing import Final, NamedTuple

from delfim.errors import FormatError, Refused
from delfim.frames import CAN_ERR, CAN_IDE, CAN_RTR, Frame

BROADCAST: Final = 0x7F  # destination node: everybody
TRANSMIT_TIMEOUT_S: Final = 0.1
RETRANSMIT_MAX: Final = 5
RESTART_MAX: Final = 2  # times that a refused message is sent again from its header
REASSEMBLY_TIMEOUT_S: Final = 1.0


class Kind(IntEnum):
    """Two bits below the priority."""

    HEADER = 0
    BODY = 1
    ACK = 2
    PLAIN = 3  # an extended frame outside this protocol


class Ack(IntEnum):
    """First byte of an acknowledgement."""

    HEADER = 0
    BODY = 1
    COMPLETE = 2  # all segments are here and the CRC is right
    REFUSED = 3  # dropped by the receiver: start again or give up


class Message(NamedTuple):
    """One message. `port` None: a segmented message with its id. `port` alone: a message to a port of the destination node.
    `port` and `address`: a UDP datagram's payload, with the port and IPv4 address that it is for."""

    priority: int  # 0..255, lowest wins the bus
    source: int  # node, 0..0x7E
    destination: int  # node, 0..0x7F
    id: int  # 32 bits; 0 in messages to a port
    data: bytes  # 0..65535 bytes
    t_ns: int = 0  # kernel's receive time of the last frame, CLOCK_REALTIME; 0 where it was never received
    port: int | None = None  # 0..511 of a node, 0..65535 of UDP
    address: int | None = None  # IPv4, most significant byte first as people write it


class Fields(NamedTuple):
    """What the 29-bit identifier says."""

    priority: int
    kind: Kind
    source: int
    destination: int
    sequence: int  # message number or segment index, modulo 32


class Outcome(NamedTuple):
    """How a message of a Sender ended."""

    message: Message
    failure: str = ""  # empty: the destination has it, intact; otherwise why nobody knows whether it has


# The arbitration field, from the top: priority 8, kind 2, source 7, destination 7, sequence 5, three flags.
_PRIORITY: Final = 24
_KIND: Final = 22
_SOURCE: Final = 15
_DESTINATION: Final = 8
_SEQUENCE: Final = 3
_STREAM: Final = 0xFF << _PRIORITY | 0x7F << _SOURCE | 0x7F << _DESTINATION  # one message at a time travels on a stream
_FRAME_TYPE: Final = 3 << _KIND | CAN_IDE | CAN_RTR | CAN_ERR
_HEADER_FRAME: Final = Kind.HEADER << _KIND | CAN_IDE
_BODY_FRAME: Final = Kind.BODY << _KIND | CAN_IDE
_ACK_FRAME: Final = Kind.ACK << _KIND | CAN_IDE

_SEGMENTED: Final = struct.Struct("<HI")
_PORT: Final = struct.Struct("<HH")
_UDP: Final = struct.Struct("<HHI")
_ACK: Final = struct.Struct("<BBH")
_CRC: Final = struct.Struct("<I")
_CRC_RESIDUE: Final = 0x2144DF1C  # CRC-32 of any bytes followed by their own CRC-32, little endian


def dsor_arb(priority: int, kind: int, source: int, destination: int, sequence: int) -> int:
    """Arbitration field of a frame of the protocol. Raises FormatError where a field does not fit its bits."""
    for name, value, limit in (
        ("priority", priority, 0xFF),
        ("kind", kind, 3),
        ("source", source, 0x7F),
        ("destination", destination, 0x7F),
        ("sequence", sequence, 31),
    ):
        if not 0 <= value <= limit:
            raise FormatError(f"{name} {value} is outside 0..{limit}")
    return (
        priority << _PRIORITY
        | kind << _KIND
        | source << _SOURCE
        | destination << _DESTINATION
        | sequence << _SEQUENCE
        | CAN_IDE
    )


def dsor_fields(arb: int) -> Fields:
    """The inverse of `dsor_arb`. Raises FormatError for what is no extended format data frame."""
    if arb & (CAN_IDE | CAN_RTR | CAN_ERR) != CAN_IDE:
        raise FormatError(f"arbitration field {arb:#010x} is not of an extended format data frame")
    return Fields(
        arb >> _PRIORITY & 0xFF,
        Kind(arb >> _KIND & 3),
        arb >> _SOURCE & 0x7F,
        arb >> _DESTINATION & 0x7F,
        arb >> _SEQUENCE & 31,
    )


def message_filter(source: int | None = None, destination: int | None = None) -> tuple[int, int]:
    """(arb, mask) to bind a socket to the header and body frames from and to these nodes, None being any; set mask bits are
    "don't care". Raises FormatError."""
    arb = dsor_arb(0, Kind.HEADER, source or 0, destination or 0, 0)
    mask = 0xFF << _PRIORITY | Kind.BODY << _KIND | 31 << _SEQUENCE
    mask |= 0x7F << _SOURCE if source is None else 0
    return arb, mask | (0x7F << _DESTINATION if destination is None else 0)


def ack_filter(node: int) -> tuple[int, int]:
    """(arb, mask) for the acknowledgements to a node: what a Sender must hear. Raises FormatError."""
    return dsor_arb(0, Kind.ACK, 0, node, 0), 0xFF << _PRIORITY | 0x7F << _SOURCE | 31 << _SEQUENCE


def segments(message: Message, number: int) -> list[Frame]:
    """All frames of a message in order, header first: how a broadcast message is sent. `number` counts the messages of
    a stream; 5 bits of it travel. Raises FormatError where a field does not fit."""
    return list(iter_segments(message, number))


def iter_segments(message: Message, number: int) -> Iterator[Frame]:
    """The same one by one, for who has no time to cut 65,535 bytes at once. Raises FormatError at once."""
    header, stream = _encoded(message)
    arb = dsor_arb(message.priority, Kind.HEADER, message.source, message.destination, number & 31)
    body = arb & _STREAM | _BODY_FRAME
    bodies = (Frame(body | (i >> 3 & 31) << _SEQUENCE, stream[i : i + 8]) for i in range(0, len(stream), 8))
    return chain((Frame(arb, header),), bodies)


def _encoded(message: Message) -> tuple[bytes, bytes]:
    """Data of the header frame and of all body frames. Raises FormatError."""
    header = _packed_header(message)
    return header, message.data + _CRC.pack(zlib.crc32(message.data, zlib.crc32(header)))


def _packed_header(message: Message) -> bytes:
    """Data of the header frame; its length tells the kind of message. Raises FormatError."""
    if message.source == BROADCAST:
        raise FormatError("the broadcast node does not send")
    try:
        if message.port is None:
            return _SEGMENTED.pack(len(message.data), message.id)
        if message.address is not None:
            return _UDP.pack(len(message.data), message.port, message.address)
        if not 0 <= message.port < 512:
            raise FormatError(f"port {message.port} is outside 0..511")
        return _PORT.pack(len(message.data), message.destination << 9 | message.port)
    except struct.error as error:
        raise FormatError(f"message of {len(message.data)} bytes does not fit a header: {error}") from None


def _announced(arb: int, header: bytes) -> tuple[int, Message] | None:
    """(length, message without its data) of a header frame; None where there is no such header."""
    priority, source, destination = arb >> _PRIORITY & 0xFF, arb >> _SOURCE & 0x7F, arb >> _DESTINATION & 0x7F
    if source == BROADCAST:
        return None
    if len(header) == 6:
        length, identifier = _SEGMENTED.unpack(header)
        return length, Message(priority, source, destination, identifier, b"")
    if len(header) == 8:
        length, port, address = _UDP.unpack(header)
        return length, Message(priority, source, destination, 0, b"", 0, port, address)
    if len(header) == 4:
        length, port = _PORT.unpack(header)
        if port >> 9 == destination:
            return length, Message(priority, source, destination, 0, b"", 0, port & 511)
    return None


class _Assembly:
    """A message of which the header was heard. `stream` begins with the header, as the CRC does."""

    __slots__ = ("announced", "answered", "header", "heard_s", "missing", "next", "number", "stream")

    def __init__(self, number: int, header: bytes, length: int, announced: Message, now_s: float) -> None:
        self.number, self.header, self.announced, self.heard_s = number, header, announced, now_s
        self.answered = announced.destination != BROADCAST
        self.stream = bytearray(header)
        self.missing = length + _CRC.size
        self.next = 0  # segment


class _Received(NamedTuple):
    """The last message of a stream. While it is remembered, a header of it or of one of the 15 before it is a late one."""

    number: int
    header: bytes
    segments: int


class Receiver:
    """Puts messages to `node` and to everybody together. One per user of messages; several may serve one node.

    `accept` sees each announced message without its data and says whether it is received here; None receives all. A message
    that is not accepted is not answered: somebody else on this node may want it.

    replies  acknowledgements that the caller sends, at most 64; when they are not taken the oldest is lost
    errors   reason in words -> count

    Memory is bounded: `open_max` messages under way, each of at most 64 KiB; the one that is silent for longest makes
    room for a new one.
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
        """When `expire` has something to do; infinity while no message is under way."""
        return min((assembly.heard_s for assembly in self._open.values()), default=math.inf) + self._timeout_s

    @property
    def is_waiting(self) -> bool:
        """Whether a message is under way."""
        return bool(self._open)

    def feed(self, frame: Frame, now_s: float) -> Message | None:
        """The message that this frame completes. Never raises; frames of no concern are passed over."""
        arb = frame.arb
        kind = arb & _FRAME_TYPE
        if kind == _BODY_FRAME:
            assembly = self._open.get(arb & _STREAM)
            if assembly is None:
                self._stray(arb)
                return None
            data = frame.data
            missing = assembly.missing
            if arb >> _SEQUENCE & 31 != assembly.next & 31 or len(data) != (missing if missing < 8 else 8):
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
            return self._completed(arb, assembly, frame.t_ns)
        if kind == _HEADER_FRAME:
            self._header(arb, frame.data, now_s)
        return None

    def expire(self, now_s: float) -> None:
        """Drops the messages that have been silent for as long as the time-out."""
        for stream, assembly in list(self._open.items()):
            if assembly.heard_s + self._timeout_s <= now_s:
                self._drop(stream, "timed out")

    def _header(self, arb: int, header: bytes, now_s: float) -> None:
        if arb >> _DESTINATION & 0x7F not in (self._node, BROADCAST):
            return
        announced = _announced(arb, header)
        if announced is None:
            self.errors["malformed header"] += 1
            return
        length, message = announced
        stream, number = arb & _STREAM, arb >> _SEQUENCE & 31
        assembly, last = self._open.get(stream), self._last.get(stream)
        accepted = self._accept is None or self._accept(message)
        is_late = last is not None and last.number - number & 31 < 16
        if not accepted:
            if not is_late:
                self._last.pop(stream, None)  # what follows on this stream is for somebody else
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
        self._open[stream] = _Assembly(number, header, length, message, now_s)
        self._acknowledge(arb, Ack.HEADER, number, 0)

    def _completed(self, arb: int, assembly: _Assembly, t_ns: int) -> Message | None:
        stream = arb & _STREAM
        if zlib.crc32(assembly.stream) != _CRC_RESIDUE:
            self._drop(stream, "wrong CRC")
            return None
        del self._open[stream]
        if len(self._last) >= 128:
            del self._last[next(iter(self._last))]
        self._last[stream] = _Received(assembly.number, assembly.header, assembly.next)
        if assembly.answered:
            self._acknowledge(arb, Ack.COMPLETE, assembly.number, assembly.next)
        priority, source, destination, identifier, _, _, port, address = assembly.announced
        data = bytes(assembly.stream[len(assembly.header) : -4])  # less the CRC
        return Message(priority, source, destination, identifier, data, t_ns, port, address)

    def _misplaced(self, arb: int, assembly: _Assembly) -> None:
        """A body frame that is not the one that is due: repeated, too long or short, late, or the one before it was lost."""
        sequence = arb >> _SEQUENCE & 31
        if assembly.next and sequence == assembly.next - 1 & 31:
            self.errors["duplicate"] += 1
            self._acknowledge(arb, Ack.BODY, assembly.number, assembly.next)
        elif sequence == assembly.next & 31:
            self._drop(arb & _STREAM, "wrong length")
        elif assembly.answered:
            self.errors["out of order"] += 1  # delayed on its way; the sender repeats what is due
        else:
            self._drop(arb & _STREAM, "out of order")

    def _stray(self, arb: int) -> None:
        """A body frame without an open message: the last one of a message that is complete, or its header was lost."""
        last = self._last.get(arb & _STREAM)
        if last is None:
            return
        sequence = arb >> _SEQUENCE & 31
        if sequence == last.segments - 1 & 31 and not _everybody(arb):
            self.errors["duplicate"] += 1
            self._acknowledge(arb, Ack.COMPLETE, last.number, last.segments)
        elif sequence == 0:
            self.errors["header lost"] += 1

    def _drop(self, stream: int, reason: str) -> None:
        number = self._open.pop(stream).number
        self.errors[reason] += 1
        self._acknowledge(stream | number << _SEQUENCE, Ack.REFUSED, number, 0)

    def _acknowledge(self, arb: int, kind: Ack, number: int, segment: int) -> None:
        """`segment` is the index of the one that is wanted next."""
        if _everybody(arb):
            return
        if len(self.replies) == self.replies.maxlen:
            self.errors["reply lost"] += 1
        back = (arb >> _DESTINATION & 0x7F) << _SOURCE | (arb >> _SOURCE & 0x7F) << _DESTINATION
        back |= arb & (0xFF << _PRIORITY | 31 << _SEQUENCE) | _ACK_FRAME
        self.replies.append(Frame(back, _ACK.pack(kind, number, segment)))


def _everybody(arb: int) -> bool:
    return arb >> _DESTINATION & 0x7F == BROADCAST


class _Transfer:
    """A message on its way. `segment` is the one whose acknowledgement is awaited, -1 the header."""

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
        self.header, self.stream = _encoded(message)
        self.message, self.number = message, 0
        self.count = -(-len(self.stream) // 8)
        self.segment = -1
        self.restarts = self.retransmits = 0
        self.due_s = math.inf
        self.whole = False  # every segment was sent once

    def frame(self) -> Frame:
        if self.segment < 0:
            return Frame(self.arb | self.number << _SEQUENCE, self.header)
        arb = self.arb | _BODY_FRAME | (self.segment & 31) << _SEQUENCE
        return Frame(arb, self.stream[8 * self.segment : 8 * self.segment + 8])


class Sender:
    """Sends messages of `node`, each frame after the acknowledgement of the one before. Messages of different priority or to
    different nodes travel side by side, those of the same wait for each other.

    A broadcast message is not acknowledged: `start` returns all of its frames, and that is that.

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
        """When `poll` has something to do; infinity while nothing is under way."""
        return min((queue[0].due_s for queue in self._streams.values()), default=math.inf)

    def start(self, message: Message, now_s: float) -> list[Frame]:
        """Takes a message; returns what is to be sent now. Raises Refused when `queue_max` messages are under way or waiting,
        FormatError for a message that does not fit or of another node."""
        if message.source != self._node:
            raise FormatError(f"node {self._node:#04x} does not send messages of node {message.source:#04x}")
        stream = message.priority << _PRIORITY | message.destination << _SOURCE | self._node << _DESTINATION
        if message.destination == BROADCAST:
            return segments(message, self._next_number(stream))
        if sum(map(len, self._streams.values())) >= self._queue_max:
            raise Refused(f"{self._queue_max} messages are waiting already")
        transfer = _Transfer(message)
        queue = self._streams.setdefault(stream, deque())
        queue.append(transfer)
        return [self._begin(stream, transfer, now_s)] if len(queue) == 1 else []

    def feed(self, frame: Frame, now_s: float) -> list[Frame]:
        """What is to be sent after an acknowledgement. Never raises; other frames are passed over."""
        queue = self._streams.get(frame.arb & _STREAM)
        if queue is None or frame.arb & _FRAME_TYPE != _ACK_FRAME or len(frame.data) != _ACK.size:
            return []
        transfer = queue[0]
        kind, number, segment = _ACK.unpack(frame.data)
        waiting_header = transfer.segment < 0
        if number != transfer.number:
            return []
        if kind == Ack.HEADER and waiting_header and segment < transfer.count:
            return [self._send(transfer, segment, now_s)]
        if kind == Ack.BODY and not waiting_header and segment == transfer.segment + 1:
            if segment < transfer.count:
                return [self._send(transfer, segment, now_s)]
            return self._restart(transfer, now_s)  # the receiver awaits more: it heard another header
        if kind == Ack.COMPLETE and segment == transfer.count and transfer.whole:
            return self._end(transfer, "", now_s)
        if kind == Ack.COMPLETE and waiting_header and not transfer.whole:  # the number is one of before this node was started
            self._numbers[frame.arb & _STREAM] = transfer.number = transfer.number + 16 & 31
            return self._restart(transfer, now_s)
        if kind == Ack.REFUSED and not waiting_header:
            return self._restart(transfer, now_s)
        return []

    def poll(self, now_s: float) -> list[Frame]:
        """Retransmissions that are due, and the first frames of messages that waited for one that failed."""
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
        """The outcome, and the first frame of the message that waited for it."""
        self.outcomes.append(Outcome(transfer.message, failure))
        stream = transfer.message.priority << _PRIORITY | transfer.message.destination << _SOURCE | self._node << _DESTINATION
        queue = self._streams[stream]
        queue.popleft()
        if queue:
            return [self._begin(stream, queue[0], now_s)]
        del self._streams[stream]
        return []
