"""Lines over a network, with real sockets: what comes, who is heard, and what happens when the other end goes."""

import select
import socket
from collections.abc import Callable, Iterator

import pytest

from delfim.networkline import FLOOD_BYTES, NetworkLine

LOOPBACK = ("127.0.0.0/8", "::1/128")
PATIENCE_S = 10.0


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


@pytest.mark.parametrize("kind", ["udp", "tcp-listen"])
def test_a_flood_is_shut_out_until_the_next_second(opened, kind):
    port = free_port(socket.SOCK_DGRAM if kind == "udp" else socket.SOCK_STREAM)
    line = opened(f"{kind}:127.0.0.1:{port}")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM if kind == "udp" else socket.SOCK_STREAM) as sender:
        sender.connect(("127.0.0.1", port))
        taken = 0
        while not line.trouble.startswith("floods"):
            sender.send(bytes(1400))
            taken += len(read(line))
        assert FLOOD_BYTES < taken < FLOOD_BYTES + 2048
        assert select.select([line], [], [], 0.0)[0] == [], "it wakes nobody"
        assert line.read() == b""
    assert line.rebind() is (kind == "udp")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM if kind == "udp" else socket.SOCK_STREAM) as sender:
        sender.connect(("127.0.0.1", port))
        sender.send(b"quiet")
        assert read(line) == b"quiet"


def test_a_port_that_is_taken_is_told_and_tried_again(opened):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        line = opened(f"udp:127.0.0.1:{other.getsockname()[1]}")
        assert line.trouble == "Address already in use"
        assert line.read() == b""
    assert line.rebind()
    assert line.trouble == ""
