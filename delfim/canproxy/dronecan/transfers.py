"""DroneCAN transfers (specification, chapter 4.1): a message as one frame or several, and back.

An identifier has 29 bits: priority 5, type 16, a zero, source 7; source 0 is a device without a number, whose messages are of
one frame each. The last byte of each frame: start 0x80, end 0x40, toggle 0x20, transfer number 0x1F. Several frames begin with
a checksum.
"""

from binascii import crc_hqx
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
_TAILS: Final = tuple(bytes((tail,)) for tail in range(256))
_new = tuple.__new__  # in half the time of Transfer(...)


class Transfer(NamedTuple):
    """A whole message. `source` 0: it is from a device without a number."""

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
            return [(self._arb, payload + _TAILS[START | END | number])]
        return framed(self._arb, self._seed, number, payload)


def framed(arb: int, seed: int, number: int, payload: bytes) -> list[tuple[int, bytes]]:
    """The frames of a transfer."""
    if len(payload) <= 7:
        return [(arb, payload + _TAILS[START | END | number])]
    sent = checksum(payload, seed).to_bytes(2, "little") + payload
    last, tail = (len(sent) - 1) // 7 * 7, START | number
    frames: list[tuple[int, bytes]] = []
    for at in range(0, last, 7):
        frames.append((arb, sent[at : at + 7] + _TAILS[tail]))
        tail = (tail & TOGGLE ^ TOGGLE) | number
    frames.append((arb, sent[last:] + _TAILS[tail | END]))
    return frames


class _Stream:
    """A transfer under way."""

    __slots__ = ("next", "payload", "started_s")

    def __init__(self, number: int, started_s: float, payload: bytes) -> None:
        self.next = TOGGLE | number  # the last byte of its next frame, but for END
        self.started_s, self.payload = started_s, payload


class TransferReceiver:
    """Assembles frames to transfers, of these message types alone. At most STREAMS transfers are under way, the oldest is
    dropped, and so is one that is not complete after TIMEOUT_S. Nothing is raised; `errors` counts by reason."""

    STREAMS: Final = 64
    TIMEOUT_S: Final = 2.0
    LENGTH_MAX: Final = 300  # bytes of a transfer; none of the messages here is longer

    def __init__(self, kinds: Iterable[DataType]) -> None:
        self.errors: Counter[str] = Counter()
        self._kinds = {kind.id: kind for kind in kinds}
        self._streams: dict[int, _Stream] = {}  # by arbitration field

    @property
    def filters(self) -> tuple[CanAddress, ...]:
        """The filters to bind a socket to: these types, from any node, at any priority; nothing else of the bus wakes the
        reader."""
        numbered = [(kind, 0xFFFF00 | SERVICE) for kind in self._kinds]
        anonymous = [(kind, 0x3FF) for kind in self._kinds if kind <= 3]
        return tuple(CanAddress(extended(kind << 8), (0x1FFFFFFF & ~care) << 3) for kind, care in numbered + anonymous)

    def feed(self, frame: Frame, now_s: float) -> Transfer | None:
        """The transfer that this frame completes."""
        arb, data = frame[0], frame[1]
        stream = self._streams.get(arb)
        if (  # most frames: in the midst of a transfer
            stream is not None
            and len(data) == 8
            and data[7] == stream.next
            and len(stream.payload) <= self.LENGTH_MAX - 5
            and now_s - stream.started_s <= self.TIMEOUT_S
        ):
            stream.payload += data[:7]
            stream.next ^= TOGGLE
            return None
        if arb & (SERVICE << 3 | 7) != CAN_IDE or not data:
            self.errors["not a message"] += 1
            return None
        source, tail = arb >> 3 & 0x7F, data[-1]
        kind = self._kinds.get(arb >> 11 & (0xFFFF if source else 0x3))
        if kind is None:
            return None
        if tail & START:
            if tail & (END | TOGGLE) == END:
                return _new(Transfer, (kind.id, source, data[:-1]))
            self._start(arb, data, now_s)
            return None
        if stream is None or tail & ~END != stream.next or now_s - stream.started_s > self.TIMEOUT_S:
            self._refuse(arb, stream, tail, now_s)
            return None
        payload = stream.payload = stream.payload + data[:-1]
        if not tail & END:
            stream.next = tail ^ TOGGLE
            if len(data) != 8 or len(payload) > self.LENGTH_MAX + 2:
                self._drop(arb, "malformed frame")
            return None
        if len(payload) > self.LENGTH_MAX + 2:
            self._drop(arb, "malformed frame")
            return None
        del self._streams[arb]
        told = payload[2:]
        if crc_hqx(told, kind.seed) != payload[0] | payload[1] << 8:
            self.errors[f"{kind.name}: wrong checksum"] += 1
            return None
        return _new(Transfer, (kind.id, source, told))

    def _start(self, arb: int, data: bytes, now_s: float) -> None:
        if not arb >> 3 & 0x7F:  # without a number there are no frames that belong together
            self.errors["malformed frame"] += 1
            return
        if self._streams.pop(arb, None) is not None:
            self.errors["incomplete"] += 1
        if len(data) != 8 or data[-1] & (END | TOGGLE):
            self.errors["malformed frame"] += 1
            return
        if len(self._streams) >= self.STREAMS:
            self._drop(min(self._streams, key=lambda each: self._streams[each].started_s), "incomplete")
        self._streams[arb] = _Stream(data[-1] & NUMBER, now_s, data[:-1])

    def _refuse(self, arb: int, stream: _Stream | None, tail: int, now_s: float) -> None:
        """Count a frame that does not go on with a transfer."""
        if not arb >> 3 & 0x7F:
            self.errors["malformed frame"] += 1
        elif stream is None:
            self.errors["start lost"] += 1
        elif now_s - stream.started_s > self.TIMEOUT_S or (tail ^ stream.next) & NUMBER:
            self._drop(arb, "incomplete")
        else:
            self.errors["repeated frame"] += 1  # a controller does that when one receiver missed the last bit of a frame

    def _drop(self, arb: int, reason: str) -> None:
        del self._streams[arb]
        self.errors[reason] += 1


def checksum(data: bytes, crc: int = 0xFFFF) -> int:
    """The checksum of data, CRC-16-CCITT-FALSE."""
    return crc_hqx(data, crc)
