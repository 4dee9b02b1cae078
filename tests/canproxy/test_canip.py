"""IP over CAN: what a datagram becomes on the bus and what comes out of it. (Real devices: tests/guest/guest_canip.py.)"""

import asyncio
import os
import random
import socket
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from ipaddress import IPv4Address
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.errors import ConfigError, DelfimError, FormatError, PermanentFailure
from delfim.base.frames import CAN_ERR, CAN_RTR, Frame
from delfim.canproxy.canudp import UDP_MAX, WAITING_MAX, CanIp, checksum, open_tun, parsed, rebuilt
from delfim.canproxy.dsor.endpoint import Endpoint
from delfim.canproxy.dsor.protocol import BROADCAST, Message
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import ANYTHING
from delfim.canproxy.tables import Canip, CanipPeer

BUS = "canloop:canip"
FIRST, SECOND = "192.168.1.2", "192.168.1.3"


def number(address: str) -> int:
    return int(IPv4Address(address))


def packet(
    destination: str = SECOND,
    port: int = 4747,
    data: bytes = b"hello",
    options: bytes = b"",
    protocol: int = 17,
    fragment: int = 0,
) -> bytes:
    """As the kernel would hand it to the device, as far as anybody looks."""
    udp = struct.pack("!HHHH", 1234, port, 8 + len(data), 0xABCD) + data
    length = 20 + len(options) + len(udp)
    addresses = IPv4Address(FIRST).packed + IPv4Address(destination).packed
    head = struct.pack("!BBHHHBBH", 0x45 + len(options) // 4, 0, length, 1, fragment, 64, protocol, 0)
    return head + addresses + options + udp


@given(st.integers(0, 0xFFFFFFFF), st.integers(0, 0xFFFF), st.binary(max_size=100), st.sampled_from([b"", bytes(4), bytes(40)]))
def test_a_datagram_is_taken_apart(destination: int, port: int, data: bytes, options: bytes) -> None:
    whole = packet(str(IPv4Address(destination)), port, data, options)
    assert parsed(whole) == (destination, port, data)
    assert parsed(whole + b"padding") == (destination, port, data)


@pytest.mark.parametrize(
    ("raw", "reason"),
    [
        (b"", "not IPv4"),
        (b"\x60" + bytes(47), "not IPv4"),
        (packet()[:19], "not IPv4"),
        (packet(protocol=1), "not UDP"),
        (packet(protocol=6), "not UDP"),
        (packet(fragment=0x2000), "a fragment"),
        (packet(fragment=185), "a fragment"),
        (packet()[:-1], "malformed"),
        (b"\x44" + packet()[1:], "malformed"),
        (b"\x4f" + packet()[1:], "malformed"),
        (packet()[:24] + b"\xff\xff" + packet()[26:], "malformed"),
        (packet()[:24] + b"\0\7" + packet()[26:], "malformed"),
    ],
)
def test_everything_else_is_refused_with_a_reason(raw: bytes, reason: str) -> None:
    with pytest.raises(FormatError, match=reason):
        parsed(raw)


def test_what_must_not_be_fragmented_is_no_fragment() -> None:
    assert parsed(packet(fragment=0x4000))[2] == b"hello"


@given(st.binary(max_size=80) | st.binary(max_size=80).map(lambda tail: packet()[:20] + tail))
def test_no_packet_raises_anything_else(raw: bytes) -> None:
    with suppress(FormatError):
        parsed(raw)


@given(
    st.integers(0, 0xFFFFFFFF),
    st.integers(0, 0xFFFF),
    st.binary(max_size=50),
    st.integers(0, 0xFFFFFFFF),
    st.integers(0, 1 << 20),
)
def test_headers_are_rebuilt(destination: int, port: int, data: bytes, source: int, identification: int) -> None:
    raw = rebuilt(Message(1, 2, 3, 0, data, port=port, address=destination), source, identification)
    assert parsed(raw) == (destination, port, data)
    assert checksum(raw[:20]) == 0  # RFC 1071: over a header with its checksum the sum is zero
    fields = struct.unpack("!BBHHHBBH4s4sHHHH", raw[:28])
    lengths = (28 + len(data), 8 + len(data))
    addresses = (source.to_bytes(4, "big"), destination.to_bytes(4, "big"))
    assert fields == (
        0x45,
        0,
        lengths[0],
        identification & 0xFFFF,
        0x4000,
        64,
        17,
        fields[7],
        *addresses,
        0,
        port,
        lengths[1],
        0,
    )


def test_checksum_is_that_of_known_headers() -> None:
    assert checksum(bytes.fromhex("45000073000040004011 0000 c0a80001c0a800c7")) == 0xB861
    assert checksum(bytes(20)) == 0xFFFF
    assert checksum(b"\xff" * 20) == 0


def test_the_largest_datagram() -> None:
    assert len(rebuilt(Message(1, 2, 3, 0, bytes(UDP_MAX), port=1, address=1), 1, 1)) == 65_535
    with pytest.raises(FormatError, match="too large"):
        rebuilt(Message(1, 2, 3, 0, bytes(UDP_MAX + 1), port=1, address=1), 1, 1)


# Two of them on a bus; a pair of sockets stands for each device


class Side:
    """`device` is what the kernel would hold of the TUN device."""

    def __init__(self, settings: Canip, node: int) -> None:
        self.device, self._tun = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        for end in (self.device, self._tun):
            end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
            end.setblocking(False)
        self._can = open_can(BUS)
        self._loop = asyncio.get_running_loop()
        self.carrier = CanIp(self._loop, self._tun.fileno(), self._can, settings, node)
        self._loop.add_reader(self._tun, self.carrier.on_packets)

    @property
    def counts(self) -> dict[str, int]:
        return self.carrier.counts

    def close(self) -> None:
        self._loop.remove_reader(self._tun)
        self.carrier.close()
        for each in (self.device, self._tun, self._can):
            each.close()

    async def read(self) -> bytes:
        async with asyncio.timeout(200):
            return await asyncio.get_running_loop().sock_recv(self.device, 65_536)


@contextmanager
def sides(source_known: bool = True) -> Iterator[tuple[Side, Side]]:
    peers = {"second": CanipPeer(address=SECOND, node=2), "dead": CanipPeer(address="192.168.1.9", node=9)}
    first = Side(Canip(address=f"{FIRST}/24", peers=peers), 1)
    known = {"first": CanipPeer(address=FIRST, node=1)} if source_known else {}
    second = Side(Canip(address=f"{SECOND}/24", peers=known), 2)
    yield first, second
    first.close()
    second.close()


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(200):
        while not condition():
            await asyncio.sleep(0.001)


@pytest.mark.parametrize("source_known", [True, False])
@pytest.mark.parametrize("size", [0, 1, 1472, 20_000])
async def test_a_datagram_crosses_the_bus(size: int, source_known: bool) -> None:
    with sides(source_known) as (first, second):
        first.device.send(packet(data=bytes(size)))
        raw = await second.read()
        await until(lambda: "delivered" in first.counts)
        assert parsed(raw) == (number(SECOND), 4747, bytes(size))
        assert raw[12:16] == IPv4Address(FIRST if source_known else "192.168.1.1").packed
        assert first.counts == {"sent": 1, "delivered": 1}
        assert second.counts == {"received": 1}
        assert first.carrier.report() == {"datagrams": {"sent": 1, "delivered": 1}, "protocol": {}, "waiting": 0}


@pytest.mark.parametrize("destination", ["192.168.1.255", "255.255.255.255", "239.1.2.3"])
async def test_broadcast_goes_to_everybody(destination: str) -> None:
    with sides() as (first, second):
        first.device.send(packet(destination))
        assert parsed(await second.read())[0] == number(destination)
        assert first.counts == {"sent": 1}


async def test_what_does_not_travel_is_counted() -> None:
    with sides() as (first, _):
        for raw in (packet(protocol=1), packet(fragment=0x2000), packet("10.0.0.1"), b"\x60" + bytes(50), packet()[:-1]):
            first.device.send(raw)
        await until(lambda: sum(first.counts.values()) == 5)
        assert first.counts == dict.fromkeys(("not UDP", "a fragment", "no node has the address", "not IPv4", "malformed"), 1)


async def test_a_dead_node_costs_its_own_datagrams_only() -> None:
    with sides() as (first, second):
        for _ in range(WAITING_MAX + 3):
            first.device.send(packet("192.168.1.9"))
        first.device.send(packet())
        assert parsed(await second.read())[2] == b"hello"
        assert first.counts["too many wait"] == 3
        await until(lambda: first.counts["not acknowledged"] > 0)
        assert first.carrier.report()["waiting"] < WAITING_MAX


async def test_what_comes_from_the_bus_and_is_no_datagram() -> None:
    """A message too large for UDP is dropped where it arrives; messages of the other kinds are left to others."""
    with sides() as (_, second), open_can(BUS) as can:
        end = Endpoint(can, 7)
        end.start(Message(1, 7, BROADCAST, 5, b"segmented"), 0.0)
        end.start(Message(1, 7, BROADCAST, 0, bytes(UDP_MAX + 1), port=1, address=number(SECOND)), 0.0)
        while end.is_sending:
            end.step(0.0)
            await asyncio.sleep(0)
        await until(lambda: bool(second.counts))
        assert second.counts == {"too large for UDP": 1}


async def test_a_device_that_is_gone_ends_the_service() -> None:
    ours, theirs = socket.socketpair()
    with open_can(BUS) as can:
        carrier = CanIp(asyncio.get_running_loop(), ours.fileno(), can, Canip(), 0)
        for end in (ours, theirs):
            end.close()
        with pytest.raises(DelfimError, match="canip0: Bad file descriptor"):
            carrier.on_packets()
        carrier.close()


# Settings and the device


def load(tmp_path: Path, lines: str) -> config.Vehicle:
    file = tmp_path / "boat.toml"
    file.write_text(f'[boat]\nname = "test"\n{lines}')
    return config.load(file)


@pytest.mark.parametrize(
    ("lines", "key"),
    [
        ('[canip]\nsource = "192.168.1"', "canip"),
        ('[canip]\naddress = "192.168.1.2/33"', "canip"),
        ('[canip.peers.camera]\naddress = "host"\nnode = 1', "canip.peers.camera"),
        ('[canip.peers.camera]\naddress = "10.0.0.1"\nnode = 127', "canip.peers.camera.node"),
        ('[canip.peers.a]\naddress = "10.0.0.1"\nnode = 1\n[canip.peers.b]\naddress = "10.0.0.2"\nnode = 1', "canip"),
        ('[canip.peers.a]\naddress = "10.0.0.1"\nnode = 1\n[canip.peers.b]\naddress = "10.0.0.1"\nnode = 2', "canip"),
    ],
)
def test_settings_that_are_refused(tmp_path: Path, lines: str, key: str) -> None:
    with pytest.raises(ConfigError) as error:
        load(tmp_path, lines)
    assert error.value.key == key


def test_without_tun_the_service_stays_down_and_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> int:
        raise FileNotFoundError(2, "No such file or directory")

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(PermanentFailure, match="modprobe tun"):
        open_tun("canip9", "", 1500)


async def test_mutated_frames_make_no_datagram_that_is_too_long_and_it_goes_on(mutations: int) -> None:
    """3,000 frames of real transfers with bits turned, shortened, in any order, of any node; 100,000 with --mutations 1334."""
    chance, frames, heard = random.Random(1), list[Frame](), list[bytes]()
    with sides() as (first, second), open_can(BUS) as can:
        can.bind(ANYTHING)
        can.setblocking(False)
        for size in (0, 5, 200):
            first.device.send(packet(data=bytes(size)))
            await second.read()
        while frame := can.receive():
            frames.append(frame)
        for number in range(75 * mutations):
            frame = chance.choice(frames)
            bits = frame.arb ^ (1 << chance.randrange(3, 32) if number % 2 else 0)
            data = bytearray(frame.data)
            for _ in range(chance.randrange(min(len(data), 4) + 1)):
                data[chance.randrange(len(data))] = chance.randrange(256)
            with suppress(BlockingIOError):
                can.sendmsg(Frame(bits & ~(CAN_RTR | CAN_ERR), bytes(data[: chance.randrange(9)])))
            await asyncio.sleep(0)
        delivered = first.counts["delivered"]
        first.device.send(packet())
        await until(lambda: first.counts["delivered"] > delivered)
        with suppress(BlockingIOError):
            while True:
                heard.append(second.device.recv(1 << 17))
        assert len(frames) > 20
        assert b"hello" in [parsed(raw)[2] for raw in heard]
        assert max(map(len, heard)) <= UDP_MAX + 28
