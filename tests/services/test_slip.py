"""SLIP and VJ compression: whatever goes in comes out, and noise costs packets, never more."""

import random
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.services.radio.slip import PACKET_MAX, Deframer, framed
from delfim.services.radio.vj import COMPRESSED, SLOTS, UNCOMPRESSED, Compressor, Decompressor, checksum


@given(st.lists(st.binary(min_size=1, max_size=300), max_size=10), st.integers(1, 7))
def test_packets_come_out_as_they_went_in_however_the_stream_is_cut(packets: list[bytes], step: int) -> None:
    stream, deframer = b"".join(framed(packet) for packet in packets), Deframer()
    out = [packet for at in range(0, len(stream), step) for packet in deframer.feed(stream[at : at + step])]
    assert (out, deframer.errors) == (packets, 0)


@given(st.binary(max_size=2000))
def test_noise_is_bounded_and_the_next_packet_comes_through(noise: bytes) -> None:
    deframer = Deframer()
    list(deframer.feed(noise))
    assert list(deframer.feed(framed(b"after")))[-1:] == [b"after"]


def test_a_line_that_never_ends_a_packet_is_forgotten() -> None:
    deframer = Deframer()
    for _ in range(100):
        assert list(deframer.feed(b"x" * 1000)) == []
    assert deframer.errors > 0
    assert len(deframer._rest) <= 3 * PACKET_MAX


def tcp(
    seq: int = 1000,
    ack: int = 2000,
    data: bytes = b"",
    *,
    port: int = 1,
    flags: int = 0x10,
    window: int = 5000,
    number: int = 1,
    urgent: int = 0,
    tos: int = 0,
    options: bytes = b"",
) -> bytes:
    """A packet whose IP checksum is right; TCP's is taken on trust by the compression."""
    offset = (20 + len(options)) // 4 << 4
    words = port, 80, seq & 0xFFFFFFFF, ack & 0xFFFFFFFF, offset, flags, window, 0xBEEF, urgent
    head = struct.pack("!HHIIBBHHH", *words) + options
    here, there = b"\x0a\0\0\1", b"\x0a\0\0\2"
    ip = struct.pack("!BBHHHBBH", 0x45, tos, 20 + len(head) + len(data), number & 0xFFFF, 0x4000, 64, 6, 0) + here + there
    return ip[:10] + struct.pack("!H", checksum(ip)) + ip[12:] + head + data


PACKETS = st.builds(
    tcp,
    seq=st.one_of(st.integers(0, 70_000), st.integers(0, 2**32 - 1)),
    ack=st.one_of(st.integers(0, 70_000), st.integers(0, 2**32 - 1)),
    data=st.binary(max_size=20),
    port=st.integers(1, 20),
    flags=st.sampled_from([0x10, 0x18, 0x30, 0x50, 0x02, 0x11, 0x14]),
    window=st.one_of(st.integers(4990, 5010), st.integers(0, 65535)),
    number=st.integers(0, 600),
    urgent=st.integers(0, 300),
    tos=st.sampled_from([0, 0x10]),
    options=st.sampled_from([b"", b"\x01\x01\x08\x0a12345678"]),
)


@given(st.lists(st.one_of(PACKETS, st.binary(min_size=1, max_size=60).map(lambda rest: b"\x45" + rest)), max_size=60))
def test_whatever_is_compressed_comes_out_the_same(packets: list[bytes]) -> None:
    one, other = Compressor(), Decompressor()
    for packet in packets:
        assert other.decompress(one.compress(packet)) == packet
    assert other.errors == 0


def test_a_download_and_its_echo_cost_a_few_bytes() -> None:
    """The two short forms of the RFC: data that follows data, and typing that is echoed."""
    one, other = Compressor(), Decompressor()
    sizes = []
    for n in range(20):
        packet = tcp(seq=1000 + 100 * n, data=b"d" * 100, number=n)
        line = one.compress(packet)
        assert other.decompress(line) == packet
        sizes.append(len(line) - 100)
    assert sizes == [40] + [3] * 19
    one = Compressor()
    typed = [one.compress(tcp(seq=1 + n, ack=1 + n, data=b"a", number=n, flags=0x18)) for n in range(3)]
    assert [len(line) for line in typed] == [41, 4, 4]
    assert typed[0][0] >> 4 == UNCOMPRESSED >> 4
    assert typed[1][0] & COMPRESSED


def test_more_connections_than_slots_take_turns() -> None:
    one, other = Compressor(), Decompressor()
    for n in range(10 * SLOTS):
        packet = tcp(port=n % (SLOTS + 4), seq=n, number=n)
        assert other.decompress(one.compress(packet)) == packet


@given(st.lists(st.binary(max_size=60), max_size=50))
def test_no_bytes_can_harm_the_decompressor(lines: list[bytes]) -> None:
    other = Decompressor()
    for line in lines:
        other.decompress(line)
    packet = tcp()
    assert other.decompress(Compressor().compress(packet)) == packet


def test_a_line_that_ends_too_early_leaves_the_connection_that_it_names_as_it_was() -> None:
    one, other = Compressor(), Decompressor()
    for n in range(4):
        packets = [tcp(port=port, seq=1000 + 10 * n, data=b"d" * 10, number=2 * n + port) for port in range(2)]
        for packet in packets:
            assert other.decompress(one.compress(packet)) == packet
        assert other.decompress(bytes((COMPRESSED | 0x40, 0, 7))) is None, "of slot 0, with half a checksum"


@pytest.mark.parametrize("seed", range(20))
def test_after_a_loss_nothing_false_is_delivered_until_tcp_repeats(seed: int) -> None:
    """What refers to a lost packet is wrong and would fail TCP's own checksum; a line that knows of the loss tosses it."""
    draw = random.Random(seed)
    one, other = Compressor(), Decompressor()
    sent, position = [], 1000
    for n in range(200):
        packet = tcp(seq=position, data=b"d" * draw.randrange(1, 50), number=n)
        position += len(packet) - 40
        line = one.compress(packet)
        sent.append(packet)
        if draw.random() < 0.1:
            other.damaged()
            one._slots.clear()  # as if TCP repeated: the next one goes whole
            continue
        out = other.decompress(line)
        assert out in (packet, None)


def test_two_thousand_damaged_streams_cost_packets_and_nothing_more() -> None:
    """Compressed traffic with bits turned and bytes lost on the way: no exception, no packet too long, and on it goes."""
    chance = random.Random(1)
    for number in range(2000):
        compressor, decompressor, deframer = Compressor(), Decompressor(), Deframer()
        packets = [tcp(seq=1000 + 10 * n, data=chance.randbytes(10), number=n + 1, port=n % 3) for n in range(6)]
        stream = bytearray(b"".join(framed(compressor.compress(packet)) for packet in packets))
        for _ in range(chance.randrange(1, 10)):
            at = chance.randrange(len(stream))
            if number % 2:
                stream[at] ^= 1 << chance.randrange(8)
            else:
                stream[at : at + chance.randrange(3)] = chance.randbytes(chance.randrange(3))
        for frame in deframer.feed(bytes(stream)):
            packet = decompressor.decompress(frame)
            assert packet is None or len(packet) <= PACKET_MAX + 128
        again = framed(Compressor().compress(packets[0]))  # not compressed yet: all that it takes is here
        found = [decompressor.decompress(frame) for frame in deframer.feed(again)]
        assert found[-1:] == [packets[0]]
