"""TCP/IP header compression, RFC 1144 ("VJ"), as the kernel's CSLIP speaks it: 40 bytes of header become three to five.

A Compressor at one end and a Decompressor at the other remember the last header of up to 16 connections; only changes are
sent. After a damaged packet the Decompressor drops packets, until TCP itself repeats a packet uncompressed.
"""

import struct
from collections import OrderedDict
from typing import Final

SLOTS: Final = 16
IP, UNCOMPRESSED, COMPRESSED = 0x40, 0x70, 0x80  # the first byte of a packet tells which
_NEW_C, _NEW_I, _PUSH, _NEW_S, _NEW_A, _NEW_W, _NEW_U = 0x40, 0x20, 0x10, 0x08, 0x04, 0x02, 0x01
_SPECIAL_I, _SPECIAL_D, _SPECIALS = _NEW_S | _NEW_W | _NEW_U, _NEW_S | _NEW_A | _NEW_W | _NEW_U, 0x0F
_FIN_SYN_RST, _ACK, _URG, _PSH = 0x07, 0x10, 0x20, 0x08
_TCP: Final = 6
_IP_HEAD: Final = struct.Struct("!BBHHHBBH")  # to the checksum
_TCP_HEAD: Final = struct.Struct("!HHIIBBHHH")


class _TcpIpHeader:
    """An IP and a TCP header, taken apart as far as they change."""

    __slots__ = ("ack", "flags", "identifier", "length", "raw", "seq", "size", "tcp", "urgent", "window")

    def __init__(self, packet: bytes) -> None:
        self.tcp = tcp = (packet[0] & 15) * 4
        self.length, self.identifier = struct.unpack_from("!HH", packet, 2)
        _, _, self.seq, self.ack, offset, self.flags, self.window, _, self.urgent = _TCP_HEAD.unpack_from(packet, tcp)
        self.size = tcp + (offset >> 4) * 4
        self.raw = packet[: self.size]

    def constant(self) -> bytes:
        """The constant fields: version, type of service, fragments, time to live, options, and the length of both headers."""
        raw, tcp = self.raw, self.tcp
        return raw[:2] + raw[6:10] + raw[20:tcp] + raw[tcp + 12 : tcp + 13] + raw[tcp + 20 :]


def _compressible(packet: bytes) -> bool:
    """Whether a packet is whole TCP under way, and not one that opens or closes a connection."""
    if len(packet) < 40 or packet[0] >> 4 != 4 or packet[9] != _TCP or struct.unpack_from("!H", packet, 6)[0] & 0x3FFF:
        return False
    tcp = (packet[0] & 15) * 4
    if tcp < 20 or len(packet) < tcp + 20:
        return False
    size = tcp + (packet[tcp + 12] >> 4) * 4
    if size < tcp + 20 or len(packet) < size or struct.unpack_from("!H", packet, 2)[0] != len(packet):
        return False
    return packet[tcp + 13] & (_FIN_SYN_RST | _ACK) == _ACK


class Compressor:
    """The sending end."""

    def __init__(self) -> None:
        self._slots: OrderedDict[bytes, tuple[int, _TcpIpHeader]] = OrderedDict()  # by connection, the longest unused first
        self._last = -1

    def compress(self, packet: bytes) -> bytes:
        """The bytes on the line for this packet."""
        if not _compressible(packet):
            return packet
        new = _TcpIpHeader(packet)
        connection = packet[12:20] + packet[new.tcp : new.tcp + 4]
        known = self._slots.pop(connection, None)
        if known is None:
            slot = len(self._slots) if len(self._slots) < SLOTS else self._slots.popitem(last=False)[1][0]
            self._slots[connection] = slot, new
            return self._whole(packet, slot)
        slot, old = known
        self._slots[connection] = slot, new
        changes = _changes(old, new)
        if changes is None:
            return self._whole(packet, slot)
        mask, deltas = changes
        if new.flags & _PSH:
            mask |= _PUSH
        checksum = packet[new.tcp + 16 : new.tcp + 18]
        if slot == self._last:
            head = bytes([COMPRESSED | mask])
        else:
            self._last, head = slot, bytes([COMPRESSED | mask | _NEW_C, slot])
        return head + checksum + deltas + packet[new.size :]

    def _whole(self, packet: bytes, slot: int) -> bytes:
        self._last = slot
        return bytes([packet[0] | UNCOMPRESSED]) + packet[1:9] + bytes([slot]) + packet[10:]


def _changes(old: _TcpIpHeader, new: _TcpIpHeader) -> tuple[int, bytes] | None:
    """The changed fields and by how much; None if there is no short form."""
    if old.constant() != new.constant() or (old.flags ^ new.flags) & ~(_PSH | _URG):
        return None
    mask, said = 0, []
    if new.flags & _URG:
        mask, said = _NEW_U, [_number(new.urgent, zero=True)]
    elif new.urgent != old.urgent:
        return None
    window, ack, seq = new.window - old.window & 0xFFFF, new.ack - old.ack & 0xFFFFFFFF, new.seq - old.seq & 0xFFFFFFFF
    if ack > 0xFFFF or seq > 0xFFFF:
        return None
    for bit, delta in ((_NEW_W, window), (_NEW_A, ack), (_NEW_S, seq)):
        if delta:
            mask |= bit
            said.append(_number(delta))
    carried = old.length - old.size
    if mask == 0 and not (new.length != old.length and carried == 0):
        return None  # the same again: a repetition, or a window probe
    if mask in (_SPECIAL_I, _SPECIAL_D):
        return None  # changes that happen to look like the short forms
    if mask == _NEW_S | _NEW_A and seq == ack == carried:
        mask, said = _SPECIAL_I, []
    elif mask == _NEW_S and seq == carried:
        mask, said = _SPECIAL_D, []
    step = new.identifier - old.identifier & 0xFFFF
    if step != 1:
        mask |= _NEW_I
        said.append(_number(step, zero=True))
    return mask, b"".join(said)


def _number(value: int, zero: bool = False) -> bytes:
    """Encode a number in one byte for 1..255; in three for larger values, and for 0 where that is possible."""
    return b"\0" + struct.pack("!H", value) if value >= 256 or (zero and value == 0) else bytes([value])


class Decompressor:
    """The receiving end. `errors` counts the packets that were dropped."""

    def __init__(self) -> None:
        self.errors = 0
        self._slots: dict[int, bytearray] = {}  # headers
        self._last = -1
        self._is_tossing = True

    def decompress(self, data: bytes) -> bytes | None:
        """Restore the packet; None if it cannot be."""
        try:
            packet = self._packet(data)
        except (IndexError, struct.error):
            packet = None
        if packet is None:
            self.errors += 1
            self._is_tossing = True
        return packet

    def damaged(self) -> None:
        """Note that the line lost something: nothing that refers to the packet before is to be trusted."""
        self._is_tossing = True

    def _packet(self, data: bytes) -> bytes | None:
        kind = data[0]
        if kind & COMPRESSED:
            return self._compressed(data)
        if kind >> 4 == UNCOMPRESSED >> 4:
            slot, packet = data[9], bytearray(data)
            packet[0], packet[9] = kind & 0x4F, _TCP
            if slot >= SLOTS or len(packet) < 40:
                return None
            tcp = (packet[0] & 15) * 4
            size = tcp + (packet[tcp + 12] >> 4) * 4
            if tcp < 20 or size < tcp + 20 or size > len(packet):
                return None
            self._slots[slot], self._last, self._is_tossing = packet[:size], slot, False
            return bytes(packet)
        return data if kind >> 4 == 4 else None

    def _compressed(self, data: bytes) -> bytes | None:
        mask, at = data[0] & 0x7F, 1
        if mask & _NEW_C:
            self._last, at, self._is_tossing = data[1], 2, False
        header = self._slots.get(self._last)
        if self._is_tossing or header is None or len(data) < at + 2:
            return None
        tcp = (header[0] & 15) * 4
        carried = struct.unpack_from("!H", header, 2)[0] - len(header)
        header[tcp + 16 : tcp + 18] = data[at : at + 2]
        at += 2
        seq, ack, _, flags, window, _, urgent = struct.unpack_from("!IIBBHHH", header, tcp + 4)
        flags = flags | _PSH if mask & _PUSH else flags & ~_PSH
        kind = mask & _SPECIALS
        if kind == _SPECIAL_I:
            seq, ack = seq + carried, ack + carried
        elif kind == _SPECIAL_D:
            seq += carried
        else:
            flags &= ~_URG
            if mask & _NEW_U:
                flags |= _URG
                urgent, at = _read(data, at)
            steps = [0, 0, 0]
            for i, bit in enumerate((_NEW_W, _NEW_A, _NEW_S)):
                if mask & bit:
                    steps[i], at = _read(data, at)
            window, ack, seq = window + steps[0], ack + steps[1], seq + steps[2]
        step = 1
        if mask & _NEW_I:
            step, at = _read(data, at)
        if at > len(data):
            return None
        struct.pack_into("!II", header, tcp + 4, seq & 0xFFFFFFFF, ack & 0xFFFFFFFF)
        struct.pack_into("!BHH", header, tcp + 13, flags, window & 0xFFFF, _at(header, tcp + 16))
        struct.pack_into("!H", header, tcp + 18, urgent)
        struct.pack_into("!HH", header, 2, len(header) + len(data) - at, _at(header, 4) + step & 0xFFFF)
        struct.pack_into("!H", header, 10, 0)
        struct.pack_into("!H", header, 10, checksum(header[:tcp]))
        return bytes(header) + data[at:]


def _at(data: bytearray, offset: int) -> int:
    return data[offset] << 8 | data[offset + 1]


def _read(data: bytes, at: int) -> tuple[int, int]:
    """Read a number; returns it and where the next one is. Raises IndexError."""
    if data[at]:
        return data[at], at + 1
    return data[at + 1] << 8 | data[at + 2], at + 3


def checksum(data: bytes | bytearray) -> int:
    """The Internet checksum, RFC 1071."""
    total = sum(struct.unpack(f"!{len(data) // 2}H", data[: len(data) // 2 * 2])) + (data[-1] << 8 if len(data) % 2 else 0)
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return int(~total & 0xFFFF)
