"""Lines over a network, with real sockets: what comes, who is heard, and what happens when the other end goes."""

import select
import socket
from collections.abc import Callable, Iterator

import pytest

from delfim.base.input.ratelimit import BURST_S, PIECE_BYTES, SECOND_BYTES
from delfim.lines.networkline import NetworkLine

LOOPBACK = ("127.0.0.0/8", "::1/128")
PATIENCE_S = 200.0


class Clock:
    now_s = 100.0

    def monotonic_s(self) -> float:
        return self.now_s

    def time_ns(self) -> int:
        return round(self.now_s * 1e9)


@pytest.fixture
def opened() -> Iterator[Callable[..., NetworkLine]]:
    lines = list[NetworkLine]()

    def line(device: str, senders: tuple[str, ...] = LOOPBACK) -> NetworkLine:
        lines.append(NetworkLine(device, senders, Clock()))
        lines[-1].rebind()
        return lines[-1]

    yield line
    for each in lines:
        each.close()


def read(line: NetworkLine) -> bytes:
    """What comes next, once it can be read."""
    assert select.select([line], [], [], PATIENCE_S)[0], "nothing to read"
    return line.read()


def free_port(kind: int = socket.SOCK_STREAM) -> int:
    with socket.socket(socket.AF_INET, kind) as any_socket:
        any_socket.bind(("127.0.0.1", 0))
        return any_socket.getsockname()[1]


def test_udp_hears_its_senders_and_nobody_else(opened):
    port = free_port(socket.SOCK_DGRAM)
    line = opened(f"udp:127.0.0.1:{port}", ("127.0.0.2/32",))
    assert line.trouble == ""
    for host, heard in (("127.0.0.3", b""), ("127.0.0.2", b"$GPHDT")):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.bind((host, 0))
            sender.sendto(b"$GPHDT", ("127.0.0.1", port))
            assert read(line) == heard
            assert bool(line.trouble) == (not heard)
            assert "127.0.0.3" in line.trouble or heard
            sender.sendto(b"", ("127.0.0.1", port))  # says nothing, and is not the end
            assert read(line) == b""
    assert line.t_ns == 100 * 10**9
    assert line.read() == b""


def test_udp_over_ipv6(opened):
    with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as sender:
        sender.bind(("::1", 0))
        line = opened("udp:[::1]:0")
        port = line._line.getsockname()[1]
        sender.sendto(b"$GPHDT", ("::1", port))
        assert read(line) == b"$GPHDT"


def test_a_tcp_server_hears_the_newest_sender(opened):
    port = free_port()
    line = opened(f"tcp-listen:127.0.0.1:{port}")
    assert line.trouble == "nobody is connected"
    first = socket.create_connection(("127.0.0.1", port))
    first.send(b"one")
    assert read(line) == b"one"
    with socket.create_connection(("127.0.0.1", port)) as second:
        second.send(b"two")
        assert read(line) == b"two"
        assert first.recv(1) == b"", "the place is taken"
    first.close()
    assert read(line) == b""
    assert line.trouble == "nobody is connected: the other end closed the connection"
    assert line.rebind() is False
    with socket.create_connection(("127.0.0.1", port)) as third:
        third.send(b"three")
        assert read(line) == b"three"
        assert line.trouble == ""


def test_a_tcp_server_closes_the_door_to_strangers(opened):
    port = free_port()
    line = opened(f"tcp-listen:127.0.0.1:{port}", ("10.0.0.1/32",))
    with socket.create_connection(("127.0.0.1", port)) as stranger:
        assert read(line) == b""
        assert stranger.recv(1) == b""
    assert line.trouble.startswith("data from 127.0.0.1 are not taken")


def test_a_long_datagram_is_read_in_pieces_and_stays_readable(opened):
    port = free_port(socket.SOCK_DGRAM)
    line = opened(f"udp:127.0.0.1:{port}")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect(("127.0.0.1", port))
        for size in (1, PIECE_BYTES, PIECE_BYTES + 1, 1400):
            sender.send(said := bytes(each % 251 for each in range(size)))
            pieces = [read(line) for _ in range(-(-size // PIECE_BYTES))]
            assert b"".join(pieces) == said
            assert max(map(len, pieces)) <= PIECE_BYTES
            assert select.select([line], [], [], 0.0)[0] == [], "it wakes nobody"
            assert line.read() == b""


@pytest.mark.parametrize("kind", ["udp", "tcp-listen"])
def test_a_flood_is_dropped_until_the_next_second(opened, kind):
    port = free_port(socket.SOCK_DGRAM if kind == "udp" else socket.SOCK_STREAM)
    line = opened(f"{kind}:127.0.0.1:{port}")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM if kind == "udp" else socket.SOCK_STREAM) as sender:
        sender.connect(("127.0.0.1", port))
        taken = sent = 0
        while line.allowance.bytes < 10_000:
            while sent - taken - line.allowance.bytes < 1400:
                sender.send(b"$GPHDT,1,T\r\n" * 100)
                sent += 1200
            piece = len(read(line))
            assert piece <= PIECE_BYTES
            taken += piece
        assert SECOND_BYTES * BURST_S <= taken < SECOND_BYTES * BURST_S + 1200
        line._clock.now_s += 1.0
        assert line.rebind()
        assert line.trouble.startswith("more than it may say: ")
        while sent > taken + line.allowance.bytes:
            taken += len(read(line))
        for _ in range(2):
            assert line.rebind()
        assert line.trouble == ""
        sender.send(b"1,T\r\nquiet")
        assert read(line).endswith(b"quiet")


def test_a_port_that_is_taken_is_told_and_tried_again(opened):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        line = opened(f"udp:127.0.0.1:{other.getsockname()[1]}")
        assert line.trouble == "Address already in use"
        assert line.read() == b""
    assert line.rebind()
    assert line.trouble == ""
