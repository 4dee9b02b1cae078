"""cantcpd on real TCP connections and a canloop bus, with real clients, and with others as they are documented to behave."""

import asyncio
import contextlib
import gzip
import itertools
import os
import pty
import random
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import can
import pytest

from delfim import config
from delfim.__main__ import main
from delfim.base.clock import SystemClock
from delfim.base.errors import BusError
from delfim.base.frames import CAN_RTR, Frame, extended, standard
from delfim.canproxy.canloop import open_canloop
from delfim.canproxy.cantcp import client as client_file
from delfim.canproxy.cantcp.access import Access
from delfim.canproxy.cantcp.bcm import JOBS_MAX
from delfim.canproxy.cantcp.beacon import DATAGRAM_BYTES, announce, datagram
from delfim.canproxy.cantcp.client import ADDRESSES_MAX, Client
from delfim.canproxy.cantcp.server import CanServer, bus_name
from delfim.canproxy.dsor.messages import (
    BATTERIES_PORT,
    BATTERIES_STARBOARD,
    NAVIGATION_ID,
    NAVIGATION_PRIORITY,
    PROPELLER_PORT,
    PROPELLER_STARBOARD,
    RESET,
    SHUTDOWN,
    TIME_FRAME,
    Node,
    sysstat_arb,
    time_frame,
)
from delfim.canproxy.dsor.protocol import Message, segments
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import ANYTHING, CanAddress, CanSocket
from delfim.canproxy.tables import Cantcpd

T = TypeVar("T")
ROOT = Path(__file__).parents[2]
_numbers = itertools.count()
TIMEOUT_S = 200.0
LOCAL_S = 10.0  # what passes within one computer takes less, on a busy machine too


class Loop:
    """What is needed of the runtime."""

    def reader(self, fd: int, handler: Callable[[], object]) -> None:
        asyncio.get_running_loop().add_reader(fd, handler)

    def remove_reader(self, fd: int) -> None:
        asyncio.get_running_loop().remove_reader(fd)


class Served:
    """A server in a thread of its own, as clients block."""

    def __init__(self, buses: list[str], closed: tuple[str, ...] = (), **settings: Any) -> None:
        self._settings, self._buses = Cantcpd(**{"transmit": ("127.0.0.0/8",), **settings}), buses
        self._access = Access(self._settings, None, closed)
        self._ready, self._never, self._stop = threading.Event(), threading.Event(), asyncio.Event()
        self.defects: list[dict[str, Any]] = []  # exceptions that reached the loop
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()))

    async def _run(self) -> None:
        self.loop = asyncio.get_running_loop()
        self.loop.set_exception_handler(lambda _, context: self.defects.append(context))
        self.server = CanServer(self._settings, self._buses, Loop(), SystemClock(), access=self._access)
        listening = await self.loop.create_server(self.server.connection, "127.0.0.1", 0)
        serial = await self.loop.create_server(self.server.slcan_connection, "127.0.0.1", 0)
        self.port, self.slcan_port = (each.sockets[0].getsockname()[1] for each in (listening, serial))
        self._ready.set()
        await self._stop.wait()
        listening.close()
        serial.close()
        self.server.close()
        await asyncio.sleep(0)

    def __enter__(self) -> "Served":
        self._thread.start()
        assert self._ready.wait(TIMEOUT_S)
        return self

    def __exit__(self, *_: object) -> None:
        self.loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(TIMEOUT_S)
        assert not self._thread.is_alive()
        assert self.defects == []

    def call(self, function: Callable[[], T]) -> T:
        """What a function returns that runs in the server's loop."""

        async def called() -> T:
            return function()

        return asyncio.run_coroutine_threadsafe(called(), self.loop).result(TIMEOUT_S)

    def wait_for(self, condition: Callable[[], object]) -> None:
        deadline_s = time.monotonic() + TIMEOUT_S
        while not self.call(condition):
            assert time.monotonic() < deadline_s, self.call(self.server.report)
            self._never.wait(0.002)  # this thread and the server's share one processor

    def counts(self) -> dict[str, int]:
        """Of the only client."""
        (client,) = self.server.clients.inside
        return self.call(lambda: dict(client.counts))


class Peer:
    """A client as blunt as they come: bytes out, bytes in."""

    def __init__(self, served: "Served | Daemon", *greeting: str) -> None:
        self.socket = socket.create_connection(("127.0.0.1", served.port), TIMEOUT_S)
        self.rest = b""
        assert self.element() == "< hi >"
        for text in greeting:
            self.say(text)
            assert self.element() == "< ok >"

    def say(self, text: str) -> None:
        self.socket.sendall(text.encode("latin-1"))

    def element(self) -> str:
        while b">" not in self.rest:
            data = self.socket.recv(4096)
            assert data, "the server closed the connection"
            self.rest += data
        element, _, self.rest = self.rest.partition(b">")
        return element.decode() + ">"

    def frame(self) -> tuple[str, str]:
        """Identifier and data of the next frame."""
        start, kind, identifier, _, *data, end = self.element().split(" ")
        assert (start, kind, end) == ("<", "frame", ">")
        return identifier, " ".join(data)

    def silent(self, seconds: float = 0.05) -> bool:
        """Whether nothing comes for so long."""
        self.socket.settimeout(seconds)
        try:
            return not self.rest and not self.socket.recv(1)
        except TimeoutError:
            return True
        finally:
            self.socket.settimeout(TIMEOUT_S)

    def closed(self) -> bool:
        with contextlib.suppress(ConnectionResetError):
            while data := self.socket.recv(4096):
                self.rest += data
        return True

    def __enter__(self) -> "Peer":
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()


@pytest.fixture
def name() -> str:
    return f"t{os.getpid() % 100000}-{next(_numbers)}"


@pytest.fixture
def served(name: str) -> Iterator[Served]:
    with Served([f"canloop:{name}"]) as one:
        yield one


@pytest.fixture
def bus(name: str) -> Iterator[CanSocket]:
    with open_canloop(name) as one:
        one.settimeout(TIMEOUT_S)
        one.bind(ANYTHING)
        yield one


def sleepy(served: Served, name: str) -> tuple[Peer, Client]:
    """A client in raw mode that takes little before it reads, and its other side."""
    peer = Peer.__new__(Peer)
    peer.socket, peer.rest = socket.socket(), b""
    peer.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
    peer.socket.settimeout(TIMEOUT_S)
    peer.socket.connect(("127.0.0.1", served.port))
    peer.say(f"< open {name} >< rawmode >")
    assert [peer.element() for _ in range(3)] == ["< hi >", "< ok >", "< ok >"]
    own = f"127.0.0.1:{peer.socket.getsockname()[1]}"
    (client,) = [client for client in served.server.clients.inside if client.name == own]
    served.wait_for(lambda: not client._outbox.is_held)
    return peer, client


def raw(served: "Served | Daemon", name: str) -> Peer:
    return Peer(served, f"< open {name} >", "< rawmode >")


# The protocol on the wire.


def test_raw_mode_both_directions(served: Served, bus: CanSocket, name: str) -> None:
    with raw(served, name) as peer:
        bus.sendto(b"\xab\x01", CanAddress(standard(0x12)))
        assert peer.frame() == ("012", "AB01")
        bus.sendto(b"", CanAddress(extended(0x12)))
        assert peer.frame() == ("00000012", "")
        bus.sendto(b"", CanAddress(standard(5) | CAN_RTR))  # socketcand has no remote frames
        peer.say("< send 7FF 2 1 ff >")
        assert bus.recvmsg()[:2] == (standard(0x7FF), b"\x01\xff")
        assert peer.silent()  # nobody hears his own


def test_a_client_hears_the_others(served: Served, bus: CanSocket, name: str) -> None:
    with raw(served, name) as one, raw(served, name) as two, Peer(served, f"< open {name} >") as three:
        three.say("< subscribe 0 0 123 >< echo >")
        assert three.element() == "< echo >"
        one.say("< send 123 1 11 >")
        assert bus.recv(8) == b"\x11"
        bus.sendto(b"\x22", CanAddress(standard(0x123)))  # the answer comes after the question
        assert [two.frame(), two.frame()] == [("123", "11"), ("123", "22")]
        assert [three.frame(), three.frame()] == [("123", "11 "), ("123", "22 ")]
        assert one.frame() == ("123", "22")


def test_each_connection_has_a_bus_of_its_own(name: str) -> None:
    names = [name, f"{name}b"]
    with Served([f"canloop:{each}" for each in names]) as served, contextlib.ExitStack() as links:
        peers = [links.enter_context(raw(served, each)) for each in names]
        buses = [links.enter_context(open_canloop(each)) for each in names]
        for number, bus in enumerate(buses):
            bus.sendto(bytes([number]), CanAddress(standard(1)))
        assert [peer.frame()[1] for peer in peers] == ["00", "01"]
        assert all(peer.silent() for peer in peers)


def test_modes_and_errors(served: Served, name: str) -> None:
    with Peer(served, f"< open {name} >") as peer:
        peer.say("< isotpmode >")
        assert peer.element() == "< error unknown command >"
        peer.say("< controlmode >")
        assert peer.element() == "< ok >"
        peer.say("< echo >< bcmmode >< rawmode >< send x >")
        assert [peer.element() for _ in range(3)] == ["< echo >", "< ok >", "< ok >"]
        assert peer.silent()


@pytest.mark.parametrize("text", ["< open nothing >", "< rawmode >"])
def test_a_bus_that_is_none_ends_the_connection(served: Served, text: str) -> None:
    with Peer(served) as peer:
        peer.say(text)
        assert peer.closed()
        assert peer.rest == b"< error could not open bus >"


def test_a_bus_that_cannot_be_opened_ends_the_connection() -> None:
    with Served(["can77"]) as served, Peer(served) as peer:
        peer.say("< open can77 >< rawmode >< echo >")
        assert peer.closed()
        assert peer.rest == b"< error could not open bus >"


def test_cycles_are_sent_changed_and_deleted(served: Served, bus: CanSocket, name: str) -> None:
    with Peer(served, f"< open {name} >") as peer:
        peer.say("< add 0 2000 123 1 01 >")
        stamps_ns = [bus.recvmsg().t_ns for _ in range(20)]
        assert (stamps_ns[-1] - stamps_ns[0]) / 19e6 > 1.9  # ms; late on a busy machine, never early
        peer.say("< update 123 2 02 03 >")
        while bus.recv(8) != b"\x02\x03":
            pass
        peer.say("< delete 123 >< echo >")
        assert peer.element() == "< echo >"
        while bus.receive():
            pass
        bus.settimeout(0.05)
        with pytest.raises(TimeoutError):
            bus.recvmsg()


def test_cycles_and_subscriptions_end_with_their_mode_and_connection(served: Served, bus: CanSocket, name: str) -> None:
    with Peer(served, f"< open {name} >") as peer:
        peer.say("< add 0 1000 123 0 >< subscribe 0 0 55 >")
        bus.recvmsg()
        peer.say("< controlmode >")
        assert peer.element() == "< ok >"
        while bus.receive():
            pass
        bus.sendto(b"", CanAddress(standard(0x55)))
        peer.say("< bcmmode >")
        assert peer.element() == "< ok >"
        assert peer.silent()
        peer.say("< add 0 1000 123 0 >")
        bus.recvmsg()
    served.wait_for(lambda: not served.server.clients.inside)
    while bus.receive():
        pass
    bus.settimeout(0.05)
    with pytest.raises(TimeoutError):
        bus.recvmsg()


def test_a_bus_stays_open_for_the_next_visitor_and_is_closed_when_none_came(served: Served, bus: CanSocket, name: str) -> None:
    """To open it takes longer than a callback may, and visitors that come and go would make the loop open it each time."""
    shared, sockets = served.server.buses[name], set()
    for _ in range(3):
        with Peer(served, f"< open {name} >< rawmode >") as peer:
            assert peer.element() == "< ok >"
            sockets.add(served.call(lambda: id(shared._can)))
        served.wait_for(lambda: not served.server.clients.inside)
        served.call(shared.poll)
    assert len(sockets) == 1
    assert served.call(lambda: shared._can) is not None
    bus.sendto(b"unheard", CanAddress(standard(0x55)))
    served.wait_for(lambda: shared.received)
    served.call(shared.poll)
    assert served.call(lambda: shared._can) is None
    with Peer(served, f"< open {name} >< rawmode >") as peer:
        peer.element()
        bus.sendto(b"heard", CanAddress(standard(0x55)))
        assert "6865617264" in peer.element().lower()


def test_subscriptions_are_throttled_and_the_newest_frame_is_told(served: Served, bus: CanSocket, name: str) -> None:
    with Peer(served, f"< open {name} >") as peer:
        peer.say("< subscribe 0 200000 123 >< subscribe 0 0 125 >< echo >")
        assert peer.element() == "< echo >"
        for number in range(50):
            bus.sendto(bytes([number]), CanAddress(standard(0x123)))
            bus.sendto(b"", CanAddress(standard(0x124)))  # not subscribed
        assert [peer.frame(), peer.frame()] == [("123", "00 "), ("123", "31 ")]
        bus.sendto(b"\1", CanAddress(standard(0x125)))
        assert peer.frame() == ("125", "01 ")
        peer.say("< unsubscribe 125 >< echo >")
        assert peer.element() == "< echo >"
        bus.sendto(b"\1", CanAddress(standard(0x125)))
        assert peer.silent()


def test_subscriptions_are_bounded_and_may_be_changed(served: Served, bus: CanSocket, name: str) -> None:
    with Peer(served, f"< open {name} >") as peer:
        peer.say("".join(f"< subscribe 0 0 {number:x} >" for number in range(JOBS_MAX + 10)) + "< subscribe 9 0 5 >< echo >")
        assert peer.element() == "< echo >"
        assert served.counts()["refused"] == 10
        for arb in (JOBS_MAX, 5, 5, JOBS_MAX - 1):
            bus.sendto(b"", CanAddress(standard(arb)))
        assert [peer.frame()[0], peer.frame()[0]] == ["005", "0FF"]
    served.wait_for(lambda: not served.server.buses[name].watchers)


def test_content_filters(served: Served, bus: CanSocket, name: str) -> None:
    with Peer(served, f"< open {name} >") as peer:
        rows = "FF 00 00 00 00 00 00 00 01 FF 00 00 00 00 00 00"
        peer.say(f"< filter 0 0 123 1 F0 >< muxfilter 0 0 124 2 {rows} >< echo >")
        assert peer.element() == "< echo >"
        for data in (b"\x10", b"\x1f", b"\x20"):
            bus.sendto(data, CanAddress(standard(0x123)))
        for data in (b"\x01\x01", b"\x02\x01", b"\x01\x01", b"\x01\x02"):
            bus.sendto(data, CanAddress(standard(0x124)))
        told = [peer.frame() for _ in range(4)]
        assert told == [("123", "10 "), ("123", "20 "), ("124", "01 01 "), ("124", "01 02 ")]
        assert peer.silent()


def test_statistics(served: Served, bus: CanSocket, name: str) -> None:
    with Peer(served, f"< open {name} >", "< controlmode >") as peer, raw(served, name) as other:
        bus.sendto(b"\1\2\3", CanAddress(standard(1)))
        assert other.frame() == ("001", "010203")
        other.say("< send 1 1 1 >< echo >")
        assert other.element() == "< echo >"
        peer.say("< statistics 10 >")
        assert [peer.element(), peer.element()] == ["< stat 3 1 1 1 >"] * 2
        peer.say("< statistics 0 >< echo >")
        while peer.element() != "< echo >":
            pass
        assert peer.silent(0.2)


def test_a_connection_has_its_socket_options(served: Served, name: str) -> None:
    with raw(served, name):
        (client,) = served.server.clients.inside
        peer = client._transport.get_extra_info("socket")
        assert peer.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        assert peer.getsockopt(socket.IPPROTO_IP, socket.IP_TOS) == 0x10
        assert client_file._round_trip_s(peer) < LOCAL_S


# Real clients.


def python_can(served: Served, name: str, **options: Any) -> can.BusABC:
    return can.Bus(interface="socketcand", host="127.0.0.1", port=served.port, channel=name, **options)


def test_python_can_on_a_busy_bus(served: Served, bus: CanSocket, name: str) -> None:
    """It reads exactly "< hi >", "< ok >", "< ok >": a frame in the same read is an error."""
    stop = threading.Event()

    def traffic() -> None:
        with open_canloop(name) as source:
            for number in itertools.count():
                if stop.wait(0.0005):
                    return
                source.sendto(number.to_bytes(4, "big"), CanAddress(standard(0x100)))

    busy = threading.Thread(target=traffic)
    busy.start()
    try:
        for _ in range(10):
            with python_can(served, name) as client:
                received = [client.recv(TIMEOUT_S) for _ in range(50)]
                numbers = [int.from_bytes(message.data, "big") for message in received if message]
                assert numbers == list(range(numbers[0], numbers[0] + 50))
    finally:
        stop.set()
        busy.join()


@pytest.mark.parametrize("tcp_tune", [False, True])
def test_python_can_both_directions_and_notifier(served: Served, bus: CanSocket, name: str, tcp_tune: bool) -> None:
    heard: list[can.Message] = []
    with python_can(served, name, tcp_tune=tcp_tune) as client:
        both = threading.Event()

        def listen(message: can.Message) -> None:
            heard.append(message)
            if len(heard) == 3:
                both.set()

        notifier = can.Notifier(client, [listen], timeout=0.1)
        bus.sendto(b"\1\2", CanAddress(standard(0x123)))
        bus.sendto(b"", CanAddress(standard(0x124)))
        bus.sendto(bytes(8), CanAddress(extended(0x123)))
        assert both.wait(TIMEOUT_S)
        notifier.stop()
        client.send(can.Message(arbitration_id=0x321, is_extended_id=False, data=b"\x0a\xff"))
        client.send(can.Message(arbitration_id=0x321, data=bytes(8)))
        assert bus.recvmsg()[:2] == (standard(0x321), b"\x0a\xff")
        assert bus.recvmsg()[:2] == (extended(0x321), bytes(8))
    seen = [(message.arbitration_id, message.is_extended_id, bytes(message.data)) for message in heard]
    assert seen == [(0x123, False, b"\1\2"), (0x124, False, b""), (0x123, True, bytes(8))]
    assert all(abs(message.timestamp - time.time()) < LOCAL_S for message in heard)


def test_python_can_may_send_what_it_may_not_and_reads_on(served: Served, bus: CanSocket, name: str) -> None:
    with python_can(served, name) as client:
        client.send(can.Message(arbitration_id=0x40, is_extended_id=False, data=bytes(4)))  # barred
        client.send(can.Message(arbitration_id=4, is_extended_id=False, is_remote_frame=True, dlc=4))
        bus.sendto(b"on", CanAddress(standard(1)))
        message = client.recv(TIMEOUT_S)
        assert message is not None
        assert bytes(message.data) == b"on"
    assert bus.receive() is None


def test_python_can_logger_and_viewer(served: Served, bus: CanSocket, name: str, tmp_path: Path) -> None:
    """The tools run unchanged; what the viewer draws on its terminal holds the identifier."""
    log = tmp_path / "out.log"
    options = ["-i", "socketcand", "-c", name, "--bus-kwargs", "host=127.0.0.1", f"port={served.port}"]
    terminal, other_end = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "LINES": "24", "COLUMNS": "80"}
    viewer = subprocess.Popen(
        [sys.executable, "-m", "can.viewer", *options], stdin=other_end, stdout=other_end, stderr=other_end, env=environment
    )
    os.close(other_end)
    logger = subprocess.Popen([sys.executable, "-m", "can.logger", "-f", str(log), *options], stdout=subprocess.DEVNULL)
    try:
        served.wait_for(lambda: len(served.server.buses[name].raw) == 2)
        screen = b""
        while b"5A5" not in screen:
            bus.sendto(b"\x5a", CanAddress(standard(0x5A5)))
            assert select.select([terminal], [], [], TIMEOUT_S)[0], screen
            screen += os.read(terminal, 65536)
        while not (log.exists() and log.stat().st_size):
            bus.sendto(b"\x5a", CanAddress(standard(0x5A5)))
            served.wait_for(lambda: True)
        logger.send_signal(signal.SIGINT)
        logger.wait(TIMEOUT_S)
    finally:
        for each in (logger, viewer):
            each.kill()
            each.wait(TIMEOUT_S)
        os.close(terminal)
    assert "5A5#5A" in log.read_text()


# Clients that cannot be run here, as their sources say they behave (ecosystem notes, docs/cantcpd.md).


def test_savvycan(served: Served, bus: CanSocket, name: str) -> None:
    """Whole reads are compared with the greeting; numbers are signed and as wide as Qt makes them; after 10 s without data it
    comes again, so that coming again is cheap."""
    for _ in range(5):
        with socket.create_connection(("127.0.0.1", served.port), TIMEOUT_S) as savvy:
            assert savvy.recv(4096) == b"< hi >"
            savvy.sendall(f"< open {name} >".encode())
            assert savvy.recv(4096) == b"< ok >"
            savvy.sendall(b"< rawmode >")
            bus.sendto(b"\1", CanAddress(standard(1)))  # it may come before the mode, and is not passed on then
            assert savvy.recv(4096) == b"< ok >"
            bus.sendto(b"\1", CanAddress(standard(1)))
            assert savvy.recv(4096).startswith(b"< frame 001 ")
            savvy.sendall(b"< send 12 2 ffffff80 7f >< send ffffffff92345678 1 ffffffffffffffff >")
            assert bus.recvmsg()[:2] == (standard(0x12), b"\x80\x7f")
            assert bus.recvmsg()[:2] == (extended(0x12345678), b"\xff")


def test_kayak(served: Served, bus: CanSocket, name: str) -> None:
    """A connection each for raw, BCM and control; microseconds are parsed as an integer of six digits."""
    with (
        raw(served, name) as frames,
        Peer(served, f"< open {name} >") as jobs,
        Peer(served, f"< open {name} >", "< controlmode >") as control,
    ):
        jobs.say("< subscribe 0 0 123 >")
        control.say("< statistics 100 >")
        assert control.element().startswith("< stat ")
        bus.sendto(b"\1\2", CanAddress(standard(0x123)))
        element = frames.element().split()
        assert element[:2] == ["<", "frame"]
        assert len(element[3].partition(".")[2]) == 6
        assert jobs.frame() == ("123", "01 02 ")
        jobs.say("< send 321 1 01 >")
        assert bus.recv(8) == b"\1"
        jobs.say("< add 0 1000 322 1 02 >")
        assert [bus.recv(8), bus.recv(8)] == [b"\2", b"\2"]


def test_socketcandcl_and_those_who_do_not_wait(served: Served, bus: CanSocket, name: str) -> None:
    """open and rawmode back to back, a trailing double blank; others send a newline after each element."""
    for text in (f"< open {name} >< rawmode >", f"< open {name} >\n< rawmode >\n"):
        with Peer(served) as peer:
            peer.say(text)
            assert [peer.element(), peer.element()] == ["< ok >", "< ok >"]
            peer.say("< send 123 2 11 22  >\n< send 00000123 0  >\n")
            assert bus.recvmsg()[:2] == (standard(0x123), b"\x11\x22")
            assert bus.recvmsg()[:2] == (extended(0x123), b"")


def test_whole_reads_of_the_greeting_while_the_bus_is_busy(served: Served, bus: CanSocket, name: str) -> None:
    """C# and Go clients: one read, one answer, and no frame with it."""
    with socket.create_connection(("127.0.0.1", served.port), TIMEOUT_S) as client:
        for command, answer in (("", b"< hi >"), (f"< open {name} >", b"< ok >"), ("< rawmode >", b"< ok >")):
            client.sendall(command.encode())
            for number in range(10):
                bus.sendto(bytes([number]), CanAddress(standard(0x100)))
            assert client.recv(4096) == answer


def test_our_own_client(served: Served, bus: CanSocket, name: str) -> None:
    with open_can(f"socketcand:127.0.0.1:{served.port}:{name}") as remote:
        remote.settimeout(TIMEOUT_S)
        remote.bind(CanAddress(standard(0x100), standard(0xFF)))
        bus.sendto(b"no", CanAddress(standard(0x200)))
        bus.sendto(b"yes", CanAddress(standard(0x123)))
        bus.sendto(b"two", CanAddress(standard(0x124)))
        assert remote.recvfrom(8) == (b"yes", CanAddress(standard(0x123), 0, remote.ifindex))
        assert remote.recv(8) == b"two"
        remote.sendto(b"back", CanAddress(extended(7)))
        assert bus.recvmsg()[:2] == (extended(7), b"back")
        served.call(lambda: [client.abort() for client in served.server.clients.inside])
        with pytest.raises(BusError, match=r"closed|reset"):
            remote.recvmsg()
        assert remote.receive() is None
        with pytest.raises(BusError, match="not connected"):
            remote.sendto(b"", CanAddress(standard(1)))
        assert remote.rebind()
        bus.sendto(b"again", CanAddress(standard(0x123)))
        assert remote.recv(8) == b"again"


@pytest.mark.parametrize("place", ["127.0.0.1", "127.0.0.1:can0", "127.0.0.1:x:can0", "127.0.0.1:1:a b", "127.0.0.1:1:"])
def test_our_own_client_says_how_a_place_is_written(place: str) -> None:
    with pytest.raises(BusError, match="write socketcand:HOST:PORT:BUS"):
        open_can(f"socketcand:{place}")


def test_our_own_client_is_told_why_not(served: Served) -> None:
    with pytest.raises(BusError, match="could not open bus"):
        open_can(f"socketcand:127.0.0.1:{served.port}:nothing")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        with pytest.raises(BusError, match="refused"):
            open_can(f"socketcand:127.0.0.1:{free.getsockname()[1]}:can0")


# Access.


def test_access_by_network_and_identifier() -> None:
    access = Access(Cantcpd(watch=("10.0.0.0/8", "::1/128"), transmit=("10.1.0.0/16",), barred=("040-043", "050", "00000040")))
    assert access.may_watch("10.9.9.9")
    assert access.may_watch("::ffff:10.9.9.9")
    assert access.may_watch("::1")
    assert not access.may_watch("11.0.0.1")
    assert not access.may_watch("fe80::1%eth0")
    assert access.may_transmit("10.1.2.3")
    assert not access.may_transmit("10.2.0.1")
    barred = [arb for arb in range(0x7FF) if access.is_barred(standard(arb))]
    assert barred == [0x40, 0x41, 0x42, 0x43, 0x50]
    assert [arb for arb in range(0x100) if access.is_barred(extended(arb))] == [0x40]
    assert not access.is_barred(extended(0x40 << 18))


def test_by_default_nobody_transmits_and_who_may_does_not_command_the_boat_nor_speak_as_its_nodes() -> None:
    access = Access(Cantcpd())
    assert not access.may_transmit("127.0.0.1")
    assert not access.may_transmit("::1")
    access = Access(Cantcpd(transmit=("127.0.0.0/8",)), config.Can(vehicle=0xD0))
    actuators = PROPELLER_STARBOARD, PROPELLER_PORT, BATTERIES_STARBOARD, BATTERIES_PORT
    refused = [arb for arb in map(standard, range(0x800)) if access.refusal("127.0.0.1", "can0", arb)]
    assert refused == [*actuators, RESET, TIME_FRAME, SHUTDOWN, time_frame(0xD0)]
    assert not access.refusal("127.0.0.1", "can1", time_frame(0xD0)), "on another bus it is another frame"


@pytest.mark.parametrize("node", set(Node) - {Node.BROADCAST})
def test_nobody_speaks_in_the_name_of_a_node_of_the_boat(node: Node) -> None:
    access = Access(Cantcpd(transmit=("127.0.0.0/8",)), config.Can())
    for priority in (0, NAVIGATION_PRIORITY, 255):
        message = Message(priority, node, Node.BROADCAST, NAVIGATION_ID, bytes(32))
        for arb in (*(frame.arb for frame in segments(message, 7)), sysstat_arb(node)):
            assert "is for the boat's own nodes alone" in access.refusal("127.0.0.1", "can0", arb)
            assert not access.refusal("127.0.0.1", "can1", arb)
    other = segments(Message(NAVIGATION_PRIORITY, 0x30, Node.BROADCAST, NAVIGATION_ID, bytes(32)), 7)
    assert not any(access.refusal("127.0.0.1", "can0", frame.arb) for frame in other)


def test_who_may_not_watch_is_not_greeted(name: str) -> None:
    with Served([f"canloop:{name}"], watch=("10.0.0.0/8",)) as served:
        with socket.create_connection(("127.0.0.1", served.port), TIMEOUT_S) as stranger, contextlib.suppress(ConnectionError):
            assert stranger.recv(100) == b""
        served.wait_for(lambda: served.server.clients.refused == 1)


def test_who_may_only_watch_does_not_transmit(name: str, bus: CanSocket) -> None:
    with Served([f"canloop:{name}"], transmit=()) as served, Peer(served, f"< open {name} >") as peer:
        peer.say("< unsent >")
        assert peer.element() == "< unsent 0 the bus did not take it >"
        peer.say("< send 123 0 >< add 0 1000 123 0 >< rawmode >")
        assert peer.element() == "< ok >"
        peer.say("< send 123 0 >< unsent >< echo >")
        assert peer.element() == "< unsent 3 its network may only watch (cantcpd.transmit) >"
        assert peer.element() == "< echo >"
        assert served.counts()["refused"] == 3
        bus.sendto(b"\1", CanAddress(standard(1)))
        assert peer.frame() == ("001", "01")
    assert bus.receive() is None


def test_the_tool_says_when_frames_were_not_sent(name, bus, capsys, tmp_path):
    with Served([f"canloop:{name}"], transmit=()) as served:
        there = f"socketcand:127.0.0.1:{served.port}:{name}"
        assert main(["can", "send", there, "123#01", "124#"]) != 0
        assert f"{there}: 2 of these frames were not sent: its network may only watch" in capsys.readouterr().err
        assert main(["can", "gen", "-n", "3", "-g", "1", there]) != 0
        (tmp_path / "log").write_text(f"(1436509052.249713) {name} 123#01\n")
        assert main(["can", "replay", str(tmp_path / "log"), f"{there}={name}"]) != 0
    with Served([f"canloop:{name}"]) as served:
        assert main(["can", "send", f"socketcand:127.0.0.1:{served.port}:{name}", "123#01"]) == 0
        assert bus.recvmsg().arb == standard(0x123)
        assert main(["can", "send", f"socketcand:127.0.0.1:{served.port}:{name}", "040#01"]) != 0
        assert "1 of these frames were not sent: 40 is barred" in capsys.readouterr().err


def test_barred_identifiers_are_not_sent_by_anybody(served: Served, bus: CanSocket, name: str) -> None:
    with Peer(served, f"< open {name} >") as peer:
        peer.say("< send 040 0 >< add 0 1000 043 0 >< send 044 0 >< send 00000040 0 >")
        assert [bus.recvmsg().arb, bus.recvmsg().arb] == [standard(0x44), extended(0x40)]


def test_a_bus_of_motors_may_be_watched_and_nobody_sends_there(name: str, bus: CanSocket) -> None:
    buses = [f"canloop:{name}"]
    with Served(buses, closed=tuple(buses)) as served, Peer(served, f"< open {name} >") as peer:
        peer.say("< send 123 0 >< add 0 1000 123 0 >< rawmode >")
        assert peer.element() == "< ok >"
        assert served.counts()["refused"] == 2
        bus.sendto(b"\1", CanAddress(standard(1)))
        assert peer.frame() == ("001", "01")
    assert bus.receive() is None


@pytest.mark.parametrize("limits", [{"clients": 2}, {"clients_per_address": 2}], ids=lambda limits: next(iter(limits)))
def test_connections_are_bounded(name: str, limits: dict[str, int]) -> None:
    with Served([f"canloop:{name}"], **limits) as served, raw(served, name), raw(served, name):
        with socket.create_connection(("127.0.0.1", served.port), TIMEOUT_S) as third, contextlib.suppress(ConnectionError):
            assert third.recv(100) == b""
        served.wait_for(lambda: served.server.clients.refused == 1)
        assert served.call(lambda: len(served.server.clients.inside)) == 2


def test_who_opens_no_bus_gives_way_the_oldest_first(name: str) -> None:
    """Idle connections, twice as many as there may be, keep nobody out, and none who has opened a bus is sent away."""
    with Served([f"canloop:{name}"], clients=4) as served, raw(served, name) as watching, contextlib.ExitStack() as held:
        idle = [held.enter_context(Peer(served)) for _ in range(8)]
        with raw(served, name) as another:
            for peer in idle[:6]:
                assert peer.closed()
            for peer in (watching, another):
                peer.say("< echo >")
                assert peer.element() == "< echo >"
            assert all(peer.silent() for peer in idle[6:])
            assert served.call(lambda: len(served.server.clients.inside)) == 4


def test_one_address_cannot_keep_the_others_out(name: str) -> None:
    with Served([f"canloop:{name}"], clients=4, clients_per_address=2) as served, contextlib.ExitStack() as held:
        for _ in range(20):
            link = socket.create_connection(("127.0.0.1", served.port), TIMEOUT_S, ("127.0.0.2", 0))
            held.enter_context(link).sendall(f"< open {name} >".encode())
        for _ in range(2):
            held.enter_context(raw(served, name))
        served.wait_for(lambda: sum(client.host == "127.0.0.2" for client in served.server.clients.inside) <= 2)
        served.wait_for(lambda: sum(client.host == "127.0.0.1" for client in served.server.clients.inside) == 2)


def test_who_opens_no_bus_in_time_is_closed_and_a_serial_bridge_is_not(name: str) -> None:
    with Served([f"canloop:{name}"], stall_s=60.0) as served, Peer(served) as idle, contextlib.ExitStack() as held:
        watching = held.enter_context(raw(served, name))
        with socket.create_connection(("127.0.0.1", served.slcan_port), TIMEOUT_S) as bridge:
            served.wait_for(lambda: len(served.server.clients.inside) == 3)
            served.call(lambda: served.server.poll(0))
            assert served.call(lambda: len(served.server.clients.inside)) == 3
            served.call(lambda: [setattr(client, "since_s", client.since_s - 60.0) for client in served.server.clients.inside])
            served.call(lambda: served.server.poll(0))
            assert idle.closed()
            watching.say("< echo >")
            assert watching.element() == "< echo >"
            bridge.sendall(b"O\r")
            assert bridge.recv(1) == b"\r"


def test_counts_of_clients_that_have_left_are_kept_by_address(name: str) -> None:
    with Served([f"canloop:{name}"]) as served:
        for _ in range(3):
            with raw(served, name) as peer:
                peer.say("< send 040 0 >< send 040 >< echo >")
                assert peer.element() == "< echo >"
            served.wait_for(lambda: not served.server.clients.inside)
        left = served.call(served.server.report)["left"]
        assert left == {"127.0.0.1": {"refused": 3, "malformed": 3, "clients": 3}}
        served.call(lambda: served.server.clients.left.update({f"192.0.2.{number}": {} for number in range(ADDRESSES_MAX)}))
        with raw(served, name):
            pass
        served.wait_for(lambda: not served.server.clients.inside)
        assert served.call(lambda: len(served.server.clients.left)) <= ADDRESSES_MAX + 1


# Backpressure.


def test_a_sleeping_client_loses_its_oldest_frames_and_nobody_else_does(name: str, bus: CanSocket) -> None:
    with Served([f"canloop:{name}"], queue_bytes=8192) as served, raw(served, name) as awake:
        asleep, sleeper = sleepy(served, name)
        sent = 0
        while not served.call(lambda: sleeper.counts["dropped"]):
            for _ in range(100):
                bus.sendto(sent.to_bytes(8, "big"), CanAddress(standard(1)))
                sent += 1
            heard = [int(awake.frame()[1], 16) for _ in range(100)]
            assert heard == list(range(sent - 100, sent))
            assert served.call(lambda: sleeper._outbox.queued_bytes) <= 8192
        lost = served.call(lambda: sleeper.counts["dropped"])
        numbers = [int(asleep.frame()[1], 16) for _ in range(sent - lost)]
        assert numbers[-1] == sent - 1  # the newest is there
        assert sorted(set(numbers)) == numbers
        assert served.call(lambda: sleeper.counts["frames"]) == sent - lost
        asleep.socket.close()


def test_seven_of_eight_clients_lose_nothing_on_a_full_bus_while_one_sleeps() -> None:
    """7,700 frames a second, as long as bench/cantcpd.py is patient."""
    command = [sys.executable, str(ROOT / "bench/cantcpd.py"), "--clients", "8", "--seconds", "1"]
    told = subprocess.run(command, capture_output=True, text=True, timeout=200, check=True).stdout
    assert told.splitlines()[1].endswith("[0, 0, 0, 0, 0, 0, 0]"), told


def test_a_client_that_stalls_is_closed(name: str, bus: CanSocket) -> None:
    with Served([f"canloop:{name}"], queue_bytes=8192, stall_s=600.0) as served:
        asleep, client = sleepy(served, name)
        while not served.call(lambda: client.counts["dropped"]):
            for _ in range(100):
                bus.sendto(bytes(8), CanAddress(standard(1)))
        served.call(lambda: served.server.clients.poll(served.loop.time()))
        assert client in served.server.clients.inside  # not yet
        served.call(lambda: served.server.clients.poll(served.loop.time() + 601.0))
        served.wait_for(lambda: not served.server.clients.inside)
        assert asleep.closed()
        asleep.socket.close()


def test_a_full_bus_holds_back_the_sender_and_loses_nothing(served, bus, name, monkeypatch):
    with raw(served, name) as peer:
        can_socket = served.server.buses[name]._can
        assert can_socket is not None
        sendto, attempts = can_socket.sendto, itertools.count()

        def often_full(data: bytes, address: CanAddress) -> int:
            if next(attempts) % 3:
                raise BlockingIOError
            return sendto(data, address)

        monkeypatch.setattr(can_socket, "sendto", often_full)
        peer.say("".join(f"< send 123 1 {number:x} >" for number in range(100)) + "< echo >")
        assert [bus.recv(8)[0] for _ in range(100)] == list(range(100))
        assert peer.element() == "< echo >"


def test_a_bus_that_takes_nothing_is_given_up(served, bus, name, monkeypatch):
    monkeypatch.setattr(client_file, "GIVE_UP_S", 0.05)
    with raw(served, name) as peer:
        can_socket = served.server.buses[name]._can
        assert can_socket is not None

        def full(data: bytes, address: CanAddress) -> int:
            raise BlockingIOError

        monkeypatch.setattr(can_socket, "sendto", full)
        peer.say("< send 123 0 >" * 100 + "< echo >")
        assert peer.element() == "< echo >"
        assert served.counts()["not transmitted"] == 100


def test_a_bus_that_fails_and_comes_back(served: Served, bus: CanSocket, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with raw(served, name) as peer:
        one = served.server.buses[name]
        assert one._can is not None
        receive_many = one._can.receive_many

        def down() -> list[Frame]:
            raise BusError("can0 is down")

        monkeypatch.setattr(one._can, "receive_many", down)
        bus.sendto(b"", CanAddress(standard(1)))
        served.wait_for(lambda: one.failure == "can0 is down")
        monkeypatch.setattr(one._can, "receive_many", receive_many)
        served.call(lambda: served.server.poll(0))
        assert one.failure == ""
        bus.sendto(b"\1", CanAddress(standard(1)))
        assert [peer.frame(), peer.frame()] == [("001", ""), ("001", "01")]


# Robustness.


class Daemon:
    """The service as the supervisor starts it: alone, or with the vehicle and the black box in the runtime."""

    def __init__(self, interface: str, place: Path, *words: str) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        settings = [
            f'can.interface="{interface}"',
            f'cantcpd.listen=["127.0.0.1:{self.port}"]',
            'cantcpd.transmit=["127.0.0.0/8"]',
            f'runtime.run_directory="{place}"',
            f'console.socket="{place}/command"',
            f'log.directory="{place}"',
            "guest.enabled=false",
        ]
        overrides = [word for setting in settings for word in ("--set", setting)]
        command = [sys.executable, "-m", "delfim", "run", str(ROOT / "etc/delfimx.toml"), *overrides, *words]
        self._process = subprocess.Popen(command, stderr=subprocess.DEVNULL)

    def __enter__(self) -> "Daemon":
        deadline_s = time.monotonic() + TIMEOUT_S
        never = threading.Event()
        while True:
            with contextlib.suppress(ConnectionRefusedError), socket.create_connection(("127.0.0.1", self.port)):
                return self
            assert time.monotonic() < deadline_s
            assert self._process.poll() is None
            never.wait(0.02)

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        assert self._process.wait(TIMEOUT_S) == 0

    def resident_bytes(self) -> int:
        return int(Path(f"/proc/{self._process.pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def test_a_flood_of_malformed_commands_and_of_connections(bus: CanSocket, name: str, tmp_path: Path) -> None:
    """100,000 commands that mean nothing on one connection, and 1,000 connections dropped in all stages."""
    chance = random.Random(1)
    words = ["send", "add", "subscribe", "filter", "muxfilter", "0", "1", "9", "123", "GGG", "f" * 16, "<", ">", "\0", "\xff"]
    rubbish = "".join(f"<{' '.join(chance.choices(words, k=chance.randrange(6)))}>" for _ in range(10_000))
    stages = ["", "< open", f"< open {name} >", f"< open {name} >< rawmode >", f"< open {name} >< add 0 1000 7 0 ><"]
    service = ("--service", "cantcpd")
    with Daemon(f"canloop:{name}", tmp_path, *service) as daemon, Peer(daemon, f"< open {name} >", "< rawmode >") as peer:
        before = 0
        for _ in range(10):
            reader = threading.Thread(target=peer.say, args=(f"{rubbish}< echo >",))
            reader.start()
            while peer.element() != "< echo >":
                pass
            reader.join()
            before = before or daemon.resident_bytes()
        for number in range(1000):
            with socket.create_connection(("127.0.0.1", daemon.port), TIMEOUT_S) as dropped:
                dropped.sendall(stages[number % len(stages)].encode())
        bus.sendto(b"\1", CanAddress(standard(1)))
        while peer.frame() != ("001", "01"):
            pass  # what the dropped connections had sent in their short lives
        assert daemon.resident_bytes() - before < 2 << 20


def test_every_transmission_is_in_the_black_box(bus: CanSocket, name: str, tmp_path: Path) -> None:
    with Daemon(f"canloop:{name}", tmp_path) as daemon, raw(daemon, name) as peer:
        peer.say("".join(f"< send 7A5 1 {number:x} >" for number in range(100)) + "< echo >")
        while peer.element() != "< echo >":  # the boat's own frames are on this bus, too
            pass
    (log,) = tmp_path.glob(f"*/{name}/*.log.gz")
    lines = gzip.decompress(log.read_bytes()).decode().splitlines()
    ours = [line.split(" ", 1)[1] for line in lines if " 7A5#" in line]
    assert ours == [f"{name} 7A5#{number:02X} T" for number in range(100)]


# Beacon and names.


def test_the_beacon_is_what_python_can_looks_for(monkeypatch: pytest.MonkeyPatch) -> None:
    from can.interfaces.socketcand import socketcand as python_can_socketcand

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    monkeypatch.setattr(python_can_socketcand, "DEFAULT_SOCKETCAND_DISCOVERY_ADDRESS", "127.0.0.1")
    monkeypatch.setattr(python_can_socketcand, "DEFAULT_SOCKETCAND_DISCOVERY_PORT", port)
    stop = threading.Event()

    def announcing() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not stop.wait(0.02):
                sender.sendto(datagram('a "boat" <x>', "127.0.0.1", 29536, ["can0", "can1"]), ("127.0.0.1", port))

    thread = threading.Thread(target=announcing)
    thread.start()
    found = python_can_socketcand.detect_beacon()
    stop.set()
    thread.join()
    assert [(each["host"], each["port"], each["channel"]) for each in found] == [
        ("127.0.0.1", 29536, "can0"),
        ("127.0.0.1", 29536, "can1"),
    ]


def test_a_beacon_is_never_too_long_and_never_on_what_is_no_lan() -> None:
    assert len(datagram("x" * 64, "1.2.3.4", 29536, [f"canbus-{n:09}" for n in range(100)])) <= DATAGRAM_BYTES
    with pytest.raises(OSError, match="is not a LAN"):
        announce("lo", 29536, ["can0"])
    with pytest.raises(OSError, match="No such device"):
        announce("nothing0", 29536, ["can0"])


def test_a_failing_beacon_is_told_once(name: str, caplog: pytest.LogCaptureFixture) -> None:
    with Served([f"canloop:{name}"], beacon=("lo",)) as served:
        for _ in range(7):
            served.call(lambda: served.server.poll(29536))
    assert [record.getMessage() for record in caplog.records] == ["cantcpd: no beacon on lo: lo is not a LAN"]


def test_names_by_which_clients_open_a_bus() -> None:
    names = [bus_name(interface) for interface in ("can0", "canloop:can1", "python-can:pcan:PCAN_USBBUS1@500000")]
    assert names == ["can0", "can1", "PCAN_USBBUS1-500"]
