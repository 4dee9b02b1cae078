"""Several boats and one shore on one frequency: the shore polls, a boat sends only when it is polled (thesis 4.1, figure 4-1).

Bytes and time in, bytes out; no port and no clock. A turn: the shore sends packets to a boat, then POLL with a grant; the boat
answers with packets of no more bytes than the grant, then DONE. The turn ends with DONE, or when grant and turnaround are over:
until then the shore is silent, for the boat may be heard by nobody and speak all the same. All times are in seconds. The frames
and their reasons: docs/slipd.md.
"""

import math
from binascii import crc_hqx
from collections.abc import Iterator, Mapping
from typing import Final

from delfim.services.radio.packetqueue import PacketQueue
from delfim.services.radio.slip import Deframer, framed
from delfim.services.radio.vj import Compressor, Decompressor

DATA, POLL, ANSWER, DONE = b"\x01", b"\x02", b"\x03", b"\x04"  # the first byte of a frame; no packet of (C)SLIP begins with it
GRANT_MAX: Final = 4000  # bytes: they fit in the port's own buffer
PLAIN: Final = b"\x45"  # the first byte of a packet of IPv4 without options, which might name another way
FRAME_MAX: Final = 12  # bytes of a frame without a packet, every byte of it escaped
CRC_ESCAPED: Final = 2  # bytes by which a checksum may be longer than another one
SOON_S: Final = 0.05  # to the next poll of a boat that said nothing; each time twice as long
IDLE_S: Final = 0.2  # at most, of a boat that answers
AWAY_S: Final = 2.0  # at most, of one that does not
MISSES: Final = 3  # turns without an answer: the boat is away
UNPOLLED_S: Final = 5.0  # without a poll the boat takes itself to be alone


class Route:
    """One boat and the shore: the packets that wait at one end, and headers compressed to and from the other."""

    def __init__(self, station: int, compresses: bool) -> None:
        self.station, self.outbox = bytes((station,)), PacketQueue()
        self._compressor = Compressor() if compresses else None
        self._decompressor = Decompressor() if compresses else None

    def frames(self, kind: bytes, most: int) -> bytes:
        """Take packets that fit in so many bytes, framed. One that is alone too long would wait for ever: it is dropped."""
        data = b""
        while self.outbox:
            packet = self.outbox.first()
            size = len(sealed(kind, self.station, packet)) + CRC_ESCAPED  # compressed, it is not longer
            if len(data) + size > most:
                if data:
                    break
                self.outbox.dropped += 1
            else:
                data += sealed(kind, self.station, self._compressor.compress(packet) if self._compressor else packet)
            self.outbox.pop()
        return data

    def packet(self, data: bytes) -> bytes | None:
        """The packet of a frame; None where its header was lost with an earlier one."""
        return self._decompressor.decompress(data) if self._decompressor else data

    def damaged(self) -> None:
        if self._decompressor:
            self._decompressor.damaged()


class PolledBoat:
    """The end of a boat. `heard` and `speak` take the time in seconds; they exchange bytes of the line for packets of IP."""

    def __init__(self, station: int, compresses: bool, now_s: float) -> None:
        """station: 1 to 254, of no other boat on the frequency."""
        self._route, self._deframer, self._grant = Route(station, compresses), Deframer(), 0
        self._polled_s = self._other_s = -math.inf
        self._began_s = now_s

    @property
    def dropped(self) -> int:
        return self._route.outbox.dropped

    def offer(self, packet: bytes, now_s: float) -> None:
        """Offer a packet for the shore. While nobody polls, it is dropped: it would be stale when it left."""
        if self._is_alone(now_s):
            self._route.outbox.dropped += 1
        else:
            self._route.outbox.put(packet)

    def received(self, data: bytes, now_s: float) -> list[bytes]:
        """Take bytes of the line; return their packets. A poll counts only while nothing was heard after it: the shore waits no
        longer then."""
        packets = []
        for body in opened(self._deframer, data):
            self._grant = 0
            if body is None:
                self._route.damaged()
            elif body[1:2] != self._route.station:
                self._other_s = now_s if body[:1] == POLL else self._other_s
            elif body[:1] == POLL:
                self._polled(int.from_bytes(body[2:], "big"), now_s)
            elif body[:1] == DATA and (packet := self._route.packet(body[2:])) is not None:
                packets.append(packet)
        if self._deframer.is_within:
            self._grant = 0
        return packets

    def speak(self, now_s: float) -> bytes:
        """The answer to a poll; empty while it is not this boat's turn."""
        if not self._grant:
            return b""
        grant, self._grant = self._grant, 0
        frames = self._route.frames(ANSWER, grant - FRAME_MAX)
        return frames + sealed(DONE, self._route.station, bytes((bool(self._route.outbox),)))

    def due_s(self) -> float:
        """The time when to call `speak` without having heard anything: never."""
        return math.inf

    def silence(self, now_s: float) -> str:
        """The reason, in words, why nothing is carried; empty while the shore polls."""
        if not self._is_alone(now_s) or now_s - self._began_s <= UNPOLLED_S:
            return ""
        station = self._route.station[0]
        if now_s - self._other_s <= UNPOLLED_S:
            return f"the shore polls other boats, but not station {station}"
        return f"no poll for station {station}: the shore is out of reach, or does not poll"

    def _is_alone(self, now_s: float) -> bool:
        return now_s - self._polled_s > UNPOLLED_S

    def _polled(self, grant: int, now_s: float) -> None:
        if self._is_alone(now_s):
            self._route.outbox.clear()
        self._grant = min(grant, GRANT_MAX)
        self._polled_s = now_s


class _Peer:
    """A boat, as the shore knows it."""

    def __init__(self, address: bytes, station: int, compresses: bool) -> None:
        self.address, self.route = address, Route(station, compresses)
        self.name = ".".join(map(str, address))
        self.misses = MISSES  # turns without an answer, MISSES at most: away until it has answered
        self.is_busy = False  # packets were carried in its turn
        self.is_garbled = False  # its last turn had noise and no answer
        self.due_s = self.pause_s = 0.0

    @property
    def is_away(self) -> bool:
        return self.misses >= MISSES

    def answered(self, has_more: bool, now_s: float) -> None:
        self.misses, self.is_garbled = 0, False
        if has_more or self.is_busy or self.route.outbox:
            self.due_s, self.pause_s = now_s, 0.0
        else:
            self._rests(now_s, IDLE_S)

    def missed(self, is_garbled: bool, now_s: float) -> None:
        self.is_garbled, self.misses = is_garbled, min(self.misses + 1, MISSES)
        if self.is_away:
            self.route.outbox.clear()
        self._rests(now_s, AWAY_S if self.is_away else IDLE_S)

    def _rests(self, now_s: float, most_s: float) -> None:
        """Rest for a pause that is longer than the last, up to the most."""
        self.pause_s = min(max(2.0 * self.pause_s, SOON_S), most_s)
        self.due_s = now_s + self.pause_s


class PollingShore:
    """The end of the shore, which polls. Methods as those of PolledBoat."""

    def __init__(
        self, boats: Mapping[bytes, int], compresses: bool, bytes_per_s: float, turnaround_s: float, airtime_s: float, mtu: int
    ) -> None:
        """boats: the station of each address of four bytes. turnaround_s: from the end of a poll to the end of an answer
        without packets, at most; if it is too short, boats talk over each other. airtime_s: of a turn, each way, or one
        packet's."""
        self._strangers = 0
        self._deframer = Deframer()
        self._peers = {address: _Peer(address, station, compresses) for address, station in boats.items()}
        self._bytes_per_s, self._turnaround_s = bytes_per_s, turnaround_s
        self._least = 2 * (mtu + FRAME_MAX)  # bytes of the longest packet and DONE, every byte escaped
        self._grant = min(max(round(airtime_s * bytes_per_s), self._least), GRANT_MAX)
        self._turn: _Peer | None = None
        self._is_garbled = False  # a frame of this turn was damaged
        self._ends_s = 0.0

    @property
    def dropped(self) -> int:
        return self._strangers + sum(peer.route.outbox.dropped for peer in self._peers.values())

    def offer(self, packet: bytes, now_s: float) -> None:
        """Offer a packet for a boat. If it is for none, or for one that does not answer, it is dropped: it would leave
        stale."""
        peer = self._peers.get(packet[16:20]) if len(packet) >= 20 and packet[0] >> 4 == 4 else None
        if peer is None:
            self._strangers += 1
        elif peer.is_away:
            peer.route.outbox.dropped += 1
        else:
            peer.route.outbox.put(packet)
            peer.due_s = min(peer.due_s, now_s)

    def received(self, data: bytes, now_s: float) -> list[bytes]:
        """Take bytes of the line; return their packets, which only the boat whose turn it is may send: in its own name, and not
        to another boat, where a computer that forwards would send them on."""
        packets = []
        for body in opened(self._deframer, data):
            turn = self._turn
            if body is None:
                self._garbled()
            elif turn is None or body[1:2] != turn.route.station:
                continue
            elif body[:1] == ANSWER and (packet := turn.route.packet(body[2:])) is not None:
                turn.is_busy = True
                if packet[:1] == PLAIN and packet[12:16] == turn.address and packet[16:20] not in self._peers:
                    packets.append(packet)
                else:
                    self._strangers += 1
            elif body[:1] == DONE:
                self._turn = None
                turn.answered(body[2:] == b"\1", now_s)
        return packets

    def speak(self, now_s: float) -> bytes:
        """Packets for the boat whose turn it is, and its poll; empty while a boat may speak, and while none is due."""
        if self._turn is not None:
            if now_s < self._ends_s:
                return b""
            self._turn.missed(self._is_garbled, now_s)
            self._turn = None
        peer = min(self._peers.values(), key=lambda peer: peer.due_s)
        if peer.due_s > now_s:
            return b""
        grant = self._least if peer.is_away else self._grant
        frames = peer.route.frames(DATA, self._grant - FRAME_MAX)
        data = frames + sealed(POLL, peer.route.station, grant.to_bytes(2, "big"))
        self._turn, peer.is_busy, self._is_garbled = peer, bool(frames), False
        self._ends_s = now_s + (len(data) + grant) / self._bytes_per_s + self._turnaround_s
        return data

    def due_s(self) -> float:
        """The time when to call `speak`, if nothing is heard before."""
        return self._ends_s if self._turn is not None else min(peer.due_s for peer in self._peers.values())

    def silence(self, now_s: float) -> str:
        """The boats that do not answer, in words; empty while all do."""
        return "; ".join(
            f"only noise from {peer.name} (station {peer.route.station[0]}): out of reach, or another boat has this station"
            if peer.is_garbled
            else f"no answer from {peer.name} (station {peer.route.station[0]})"
            for peer in self._peers.values()
            if peer.is_away
        )

    def _garbled(self) -> None:
        """Count a damaged frame; nobody knows whose."""
        self._is_garbled = True
        for peer in self._peers.values():
            peer.route.damaged()


def sealed(kind: bytes, station: bytes, data: bytes) -> bytes:
    """Build a frame of the line: kind, station, data, CRC-16/XMODEM."""
    body = kind + station + data
    return framed(body + crc_hqx(body, 0).to_bytes(2, "big"))


def opened(deframer: Deframer, data: bytes) -> Iterator[bytes | None]:
    """Open the frames that end in these bytes: kind, station and data; None for one that is damaged."""
    for frame in deframer.feed(data):
        yield frame[:-2] if len(frame) >= 4 and crc_hqx(frame, 0) == 0 else None
