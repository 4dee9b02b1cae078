"""The frames of the DSOR protocol: identifiers, header, body and acknowledgement (docs/dsor.md). No state."""

import struct
import zlib
from collections.abc import Iterator
from enum import IntEnum
from itertools import chain
from typing import Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.base.frames import CAN_ERR, CAN_IDE, CAN_RTR, Frame

BROADCAST: Final = 0x7F  # destination node: everybody


class Kind(IntEnum):
    """The kind of a frame, two bits below the priority."""

    HEADER = 0
    BODY = 1
    ACK = 2
    PLAIN = 3  # an extended frame outside this protocol


class Ack(IntEnum):
    """The first byte of an acknowledgement."""

    HEADER = 0
    BODY = 1
    COMPLETE = 2  # all segments are here and the CRC is right
    REFUSED = 3  # dropped by the receiver: start again or give up


class Message(NamedTuple):
    """A message. `port` None: a segmented message with its id. `port` alone: a message to a port of the destination node.
    `port` and `address`: a UDP datagram's payload, with the port and IPv4 address that it is for."""

    priority: int  # 0..255, lowest wins the bus
    source: int  # node, 0..0x7E
    destination: int  # node, 0..0x7F
    id: int  # 32 bits; 0 in messages to a port
    data: bytes  # 0..65535 bytes
    t_ns: int = 0  # kernel's receive time of the last frame, CLOCK_REALTIME; 0 if it was never received
    port: int | None = None  # 0..511 of a node, 0..65535 of UDP
    address: int | None = None  # IPv4, most significant byte first as people write it


class Outcome(NamedTuple):
    """The outcome of a message of a Sender."""

    message: Message
    failure: str = ""  # empty: it was delivered intact; otherwise why that is not known


# The arbitration field, from the top: priority 8, kind 2, source 7, destination 7, sequence 5, three flags.
PRIORITY_AT: Final = 24
KIND_AT: Final = 22
SOURCE_AT: Final = 15
DESTINATION_AT: Final = 8
SEQUENCE_AT: Final = 3
STREAM: Final = 0xFF << PRIORITY_AT | 0x7F << SOURCE_AT | 0x7F << DESTINATION_AT  # one message at a time travels on a stream
FRAME_TYPE: Final = 3 << KIND_AT | CAN_IDE | CAN_RTR | CAN_ERR
HEADER_FRAME: Final = Kind.HEADER << KIND_AT | CAN_IDE
BODY_FRAME: Final = Kind.BODY << KIND_AT | CAN_IDE
ACK_FRAME: Final = Kind.ACK << KIND_AT | CAN_IDE

_SEGMENTED: Final = struct.Struct("<HI")
_PORT: Final = struct.Struct("<HH")
_UDP: Final = struct.Struct("<HHI")
ACK_DATA: Final = struct.Struct("<BBH")
CRC: Final = struct.Struct("<I")
_new = tuple.__new__  # a third of the time of Frame(...)
CRC_RESIDUE: Final = 0x2144DF1C  # CRC-32 of any bytes followed by their own CRC-32, little endian


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
        priority << PRIORITY_AT
        | kind << KIND_AT
        | source << SOURCE_AT
        | destination << DESTINATION_AT
        | sequence << SEQUENCE_AT
        | CAN_IDE
    )


def message_filter(source: int | None = None, destination: int | None = None) -> tuple[int, int]:
    """The filter (arb, mask) that binds a socket to the header and body frames from and to these nodes, None being any; set
    mask bits are "don't care". Raises FormatError."""
    arb = dsor_arb(0, Kind.HEADER, source or 0, destination or 0, 0)
    mask = 0xFF << PRIORITY_AT | Kind.BODY << KIND_AT | 31 << SEQUENCE_AT
    mask |= 0x7F << SOURCE_AT if source is None else 0
    return arb, mask | (0x7F << DESTINATION_AT if destination is None else 0)


def ack_filter(node: int) -> tuple[int, int]:
    """The filter (arb, mask) of the acknowledgements to a node, which a Sender must receive. Raises FormatError."""
    return dsor_arb(0, Kind.ACK, 0, node, 0), 0xFF << PRIORITY_AT | 0x7F << SOURCE_AT | 31 << SEQUENCE_AT


def segments(message: Message, number: int) -> list[Frame]:
    """All frames of a message in order, header first: how a broadcast message is sent. `number` counts the messages of
    a stream; 5 bits of it travel. Raises FormatError where a field does not fit."""
    return list(iter_segments(message, number))


def iter_segments(message: Message, number: int) -> Iterator[Frame]:
    """The same frames one by one, for callers that cannot spend the time on 65,535 bytes. Raises FormatError at once."""
    header, stream = encoded(message)
    arb = dsor_arb(message.priority, Kind.HEADER, message.source, message.destination, number & 31)
    body = arb & STREAM | BODY_FRAME
    bodies = (
        _new(Frame, (body | (i >> 3 & 31) << SEQUENCE_AT, stream[i : i + 8], 0, 0, False)) for i in range(0, len(stream), 8)
    )
    return chain((_new(Frame, (arb, header, 0, 0, False)),), bodies)


def encoded(message: Message) -> tuple[bytes, bytes]:
    """Encode a message: the data of its header frame and of all body frames. Raises FormatError."""
    header = _packed_header(message)
    return header, message.data + CRC.pack(zlib.crc32(message.data, zlib.crc32(header)))


def _packed_header(message: Message) -> bytes:
    """Pack the data of the header frame; its length shows the kind of message. Raises FormatError."""
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


def read_header(arb: int, header: bytes) -> tuple[int, Message] | None:
    """Read a header frame: (length, message without its data); None if it is not one."""
    priority, source, destination = arb >> PRIORITY_AT & 0xFF, arb >> SOURCE_AT & 0x7F, arb >> DESTINATION_AT & 0x7F
    if source == BROADCAST:
        return None
    if len(header) == 6:
        length, identifier = _SEGMENTED.unpack(header)
        return length, _new(Message, (priority, source, destination, identifier, b"", 0, None, None))
    if len(header) == 8:
        length, port, address = _UDP.unpack(header)
        return length, Message(priority, source, destination, 0, b"", 0, port, address)
    if len(header) == 4:
        length, port = _PORT.unpack(header)
        if port >> 9 == destination:
            return length, Message(priority, source, destination, 0, b"", 0, port & 511)
    return None


def is_broadcast(arb: int) -> bool:
    return arb >> DESTINATION_AT & 0x7F == BROADCAST
