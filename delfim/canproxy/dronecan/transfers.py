"""DroneCAN transfers (specification, chapter 4.1): a message as one frame or several, and back.

An identifier has 29 bits: priority 5, type 16, a zero, source 7; source 0 is a device without a number, whose messages are of
one frame each. The last byte of each frame: start 0x80, end 0x40, toggle 0x20, transfer number 0x1F. Several frames begin with
a checksum.
"""

from collections import Counter
from collections.abc import Iterable
from typing import Final, NamedTuple

from delfim.base.frames import CAN_IDE, Frame, extended
from delfim.canproxy.dronecan.fields import DataType
from delfim.canproxy.socket import CanAddress

NODE_MAX: Final = 125  # 126 and 127 are for tools
COMMAND, SENSOR, STATUS = 8, 16, 24  # priorities as devices have them; 0 wins the bus
START, END, TOGGLE, NUMBER = 0x80, 0x40, 0x20, 0x1F
SERVICE: Final = 0x80  # in the identifier: not a message


class Transfer(NamedTuple):
    """A whole message. `source` 0: from a device without a number."""

    type: int
    source: int
    payload: bytes


class Publisher:
    """One message type of one node, which numbers its transfers."""

    def __init__(self, kind: DataType, source: int, priority: int) -> None:
        self._arb = extended(priority << 24 | kind.id << 8 | source)
        self._seed, self._number = kind.seed, NUMBER

    def frames(self, payload: bytes) -> list[tuple[int, bytes]]:
        """The frames of the next transfer, to be sent in this order."""
        number = self._number = (self._number + 1) & NUMBER
        if len(payload) <= 7:  # as below: this is on the critical path
            return [(self._arb, payload + bytes((START | END | number,)))]
        return framed(self._arb, self._seed, number, payload)


def framed(arb: int, seed: int, number: int, payload: bytes) -> list[tuple[int, bytes]]:
    """The frames of a transfer."""
    if len(payload) <= 7:
        return [(arb, payload + bytes((START | END | number,)))]
    sent = checksum(payload, seed).to_bytes(2, "little") + payload
    last = (len(sent) - 1) // 7
    frames = list[tuple[int, bytes]]()
    for i in range(last + 1):
        tail = (START if i == 0 else 0) | (END if i == last else 0) | (TOGGLE if i & 1 else 0) | number
        frames.append((arb, sent[7 * i : 7 * i + 7] + bytes((tail,))))
    return frames


class _Stream:
    """A transfer under way."""

    __slots__ = ("number", "payload", "started_s", "toggle")

    def __init__(self, number: int, started_s: float, payload: bytes) -> None:
        self.number, self.started_s, self.toggle = number, started_s, 0
        self.payload = bytearray(payload)


class TransferReceiver:
    """Frames to transfers, of these message types alone. At most STREAMS transfers are under way, the oldest is dropped, and so
    is one that is not complete after TIMEOUT_S. Nothing is raised; `errors` counts by reason."""

    STREAMS: Final = 64
    TIMEOUT_S: Final = 2.0
    LENGTH_MAX: Final = 300  # bytes of a transfer; none of the messages here is longer

    def __init__(self, kinds: Iterable[DataType]) -> None:
        self.errors: Counter[str] = Counter()
        self._kinds = {kind.id: kind for kind in kinds}
        self._streams: dict[int, _Stream] = {}  # by arbitration field

    @property
    def filters(self) -> tuple[CanAddress, ...]:
        """To bind a socket to: these types, from any node, at any priority; nothing else of the bus wakes the reader."""
        numbered = [(kind, 0xFFFF00 | SERVICE) for kind in self._kinds]
        anonymous = [(kind, 0x3FF) for kind in self._kinds if kind <= 3]
        return tuple(CanAddress(extended(kind << 8), (0x1FFFFFFF & ~care) << 3) for kind, care in numbered + anonymous)

    def feed(self, frame: Frame, now_s: float) -> Transfer | None:
        """The transfer that this frame completes."""
        arb, data = frame.arb, frame.data
        if arb & 7 != CAN_IDE or arb >> 3 & SERVICE or not data:
            self.errors["not a message"] += 1
            return None
        source, tail = arb >> 3 & 0x7F, data[-1]
        kind = self._kinds.get(arb >> 11 & (0xFFFF if source else 0x3))
        if kind is None:
            return None
        if tail & (START | END | TOGGLE) == START | END:
            return Transfer(kind.id, source, data[:-1])
        if source == 0:
            self.errors["malformed frame"] += 1  # without a number there are no frames that belong together
            return None
        if tail & START:
            self._start(arb, data, now_s)
            return None
        payload = self._go_on(arb, data, now_s)
        if payload is None:
            return None
        if checksum(payload[2:], kind.seed) != payload[0] | payload[1] << 8:
            self.errors[f"{kind.name}: wrong checksum"] += 1
            return None
        return Transfer(kind.id, source, bytes(payload[2:]))

    def _start(self, arb: int, data: bytes, now_s: float) -> None:
        if self._streams.pop(arb, None) is not None:
            self.errors["incomplete"] += 1
        if len(data) != 8 or data[-1] & (END | TOGGLE):
            self.errors["malformed frame"] += 1
            return
        if len(self._streams) >= self.STREAMS:
            del self._streams[min(self._streams, key=lambda each: self._streams[each].started_s)]
            self.errors["incomplete"] += 1
        self._streams[arb] = _Stream(data[-1] & NUMBER, now_s, data[:-1])

    def _go_on(self, arb: int, data: bytes, now_s: float) -> bytearray | None:
        """The checksum and the payload, if they are whole now."""
        stream, tail = self._streams.get(arb), data[-1]
        if stream is None:
            self.errors["start lost"] += 1
            return None
        is_last, length = tail & END, len(stream.payload) + len(data) - 1
        if now_s - stream.started_s > self.TIMEOUT_S or tail & NUMBER != stream.number:
            reason = "incomplete"
        elif bool(tail & TOGGLE) == bool(stream.toggle):
            self.errors["repeated frame"] += 1  # a controller does that when one receiver missed the last bit of a frame
            return None
        elif (not is_last and len(data) != 8) or length > self.LENGTH_MAX + 2:
            reason = "malformed frame"
        else:
            stream.toggle = tail & TOGGLE
            stream.payload += data[:-1]
            if not is_last:
                return None
            return self._streams.pop(arb).payload
        del self._streams[arb]
        self.errors[reason] += 1
        return None


def _table() -> tuple[int, ...]:
    table = list[int]()
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
        table.append(crc)
    return tuple(table)


_CRC: Final = _table()


def checksum(data: bytes | bytearray, crc: int = 0xFFFF) -> int:
    """CRC-16-CCITT-FALSE."""
    for byte in data:
        crc = (crc << 8 ^ _CRC[crc >> 8 ^ byte]) & 0xFFFF
    return crc
