"""Sockets for DSOR messages: the Berkeley face, the asyncio face, and what happens to messages on a bad bus."""

import asyncio
import contextlib
import errno
import socket
import subprocess
import sys
import threading
import tracemalloc
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.dsor import Rates, exchange
from delfim.base.errors import BusError, FormatError, Refused
from delfim.base.frames import Frame
from delfim.canproxy.dsor import sockets as dsor_sockets
from delfim.canproxy.dsor.endpoint import (
    ANY_ID,
    INBOX_MAX,
    OUTBOX_MAX,
    Address,
    CanPort,
    CanSegm,
    Endpoint,
    message_to,
    source_of,
)
from delfim.canproxy.dsor.protocol import BROADCAST, Kind, Message, Outcome, dsor_arb, segments
from delfim.canproxy.dsor.sockets import DsorSocket, DsorTransport, open_dsor
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import ANYTHING, CanAddress, CanSocket, accepts
from tests.canproxy.dsor_fields import dsor_fields

BUS = "canloop:dsorsocket"
REASON = "node 0x02 did not acknowledge the header"


@pytest.fixture
def sockets() -> Iterator[tuple[DsorSocket, DsorSocket]]:
    """Nodes 1 and 2."""
    with open_dsor(BUS, 1) as first, open_dsor(BUS, 2) as second:
        for each in (first, second):
            each.settimeout(200.0)
        yield first, second


@contextmanager
def answering(node: DsorSocket, messages: int = 1) -> Iterator[list[tuple[bytes, Address]]]:
    """A thread that receives so many messages."""
    got: list[tuple[bytes, Address]] = []
    thread = threading.Thread(target=lambda: got.extend(node.recvfrom(65535) for _ in range(messages)))
    thread.start()
    yield got
    thread.join()


class ScriptedBus:
    """A transport without a bus: what is in `incoming` comes in, what goes out is in `sent` while there is room."""

    name, ifindex, dropped, outlets = "scripted", 7, 0, None

    def __init__(self) -> None:
        self.incoming: deque[Frame] = deque()
        self.sent: list[Frame] = []
        self.room = 1 << 30
        self.failure = ""
        self._accepted: tuple[CanAddress, ...] = ()
        self._ends = socket.socketpair()

    def fileno(self) -> int:
        return self._ends[0].fileno()

    def filter(self, addresses: tuple[CanAddress, ...]) -> None:
        self._accepted = addresses

    def receive(self) -> Frame | None:
        while self.incoming:
            frame = self.incoming.popleft()
            if any(accepts(address, frame.arb) for address in self._accepted):
                return frame
        return None

    def send(self, arb: int, data: bytes, ifindex: int) -> None:
        if self.failure:
            raise BusError(self.failure)
        if not self.room:
            raise BlockingIOError
        self.room -= 1
        self.sent.append(Frame(arb, data))

    def rehearse(self) -> None:
        raise AssertionError

    def rebind(self) -> bool:
        return not self.failure

    def close(self) -> None:
        for end in self._ends:
            end.close()


@pytest.fixture
def bus() -> Iterator[ScriptedBus]:
    scripted = ScriptedBus()
    yield scripted
    scripted.close()


# Addresses


def test_addresses_are_those_of_the_thesis() -> None:
    assert CanSegm._fields == ("priority", "node", "id")
    assert CanPort._fields == ("port", "priority")
    assert CanPort(3 << 9 | 300).node == 3


@given(
    st.one_of(
        st.builds(CanSegm, st.integers(0, 255), st.integers(0, 126), st.integers(0, 0xFFFFFFFF)),
        st.builds(CanPort, st.integers(0, 126 << 9 | 511), st.integers(0, 255)),
    )
)
def test_an_answer_goes_back_with_the_same_identifier_or_port(address: Address) -> None:
    there = message_to(address, 5, b"")
    back = message_to(source_of(there), address.node, b"")
    assert (there.destination, back.destination) == (address.node, 5)
    assert (back.priority, back.id, back.port) == (there.priority, there.id, there.port)


# The Berkeley face


@pytest.mark.parametrize("address", [CanSegm(9, 2, 0xDEADBEEF), CanPort(2 << 9 | 300, 9)])
@pytest.mark.parametrize("size", [0, 1, 300])
def test_sendto_is_delivered_when_it_returns(sockets: tuple[DsorSocket, DsorSocket], address: Address, size: int) -> None:
    first, second = sockets
    second.bind(address)
    data = Random(size).randbytes(size)
    with answering(second) as got:
        assert first.sendto(data, address) == size
    back = CanPort(1 << 9 | 300, 9) if isinstance(address, CanPort) else address._replace(node=1)
    assert got == [(data, back)]


def test_connect_and_send(sockets: tuple[DsorSocket, DsorSocket]) -> None:
    first, second = sockets
    with pytest.raises(OSError, match="Destination address required") as error:
        first.send(b"")
    assert error.value.errno == errno.EDESTADDRREQ
    second.bind(CanSegm(0, 2, ANY_ID))
    first.connect(CanSegm(1, 2, 77))
    with answering(second, 2) as got:
        first.send(b"one")
        first.send(b"two")
    assert got == [(b"one", CanSegm(1, 1, 77)), (b"two", CanSegm(1, 1, 77))]


def test_only_what_is_bound_to_is_received(sockets: tuple[DsorSocket, DsorSocket]) -> None:
    first, second = sockets
    second.bind(CanSegm(0, 2, 5))
    with answering(second) as got:
        for address in (CanSegm(1, BROADCAST, 6), CanPort(BROADCAST << 9 | 5), CanSegm(1, BROADCAST, 5)):
            first.sendto(b"%d" % address[0], address)
    assert got == [(b"1", CanSegm(1, 1, 5))]


def test_a_socket_binds_to_its_own_node_only(sockets: tuple[DsorSocket, DsorSocket]) -> None:
    for address in (CanSegm(0, 2, 1), CanPort(2 << 9)):
        with pytest.raises(OSError, match="assign") as error:
            sockets[0].bind(address)
        assert error.value.errno == errno.EADDRNOTAVAIL


def test_before_bind_nothing_is_received_or_answered(sockets: tuple[DsorSocket, DsorSocket]) -> None:
    first, second = sockets
    second.settimeout(0.0)
    with pytest.raises(BusError, match=REASON):
        first.sendto(b"anybody?", CanSegm(1, 2, 1))
    with pytest.raises(BlockingIOError):
        second.recv(1)


def test_bytes_beyond_the_length_are_lost(sockets: tuple[DsorSocket, DsorSocket]) -> None:
    first, second = sockets
    second.bind(CanSegm(0, 2, 5))
    for data in (b"longer", b"next"):
        first.sendto(data, CanSegm(1, BROADCAST, 5))
    assert [second.recv(4), second.recv(4)] == [b"long", b"next"]


def test_time_outs(sockets: tuple[DsorSocket, DsorSocket]) -> None:
    first, second = sockets
    second.bind(CanSegm(0, 2, 5))
    with pytest.raises(BlockingIOError):
        second.recv(1, socket.MSG_DONTWAIT)
    second.setblocking(False)
    with pytest.raises(BlockingIOError):
        second.recvfrom(1)
    second.settimeout(0.001)
    with pytest.raises(TimeoutError):
        second.recv(1)
    first.settimeout(0.001)
    with pytest.raises(TimeoutError):
        first.sendto(b"", CanSegm(1, 2, 5))
    second.settimeout(5.0)
    first.settimeout(0.5)
    with answering(second) as got, pytest.raises(TimeoutError):
        first.recv(1)  # meanwhile the message goes on
    assert got == [(b"", CanSegm(1, 1, 5))]
    assert list(first.outcomes) == [Outcome(Message(1, 1, 2, 5, b""))]


def test_messages_under_way_are_bounded_and_told(sockets: tuple[DsorSocket, DsorSocket]) -> None:
    first, _ = sockets
    for i in range(64):
        first.sendto(b"", CanSegm(i, 2, 5), socket.MSG_DONTWAIT)
    with pytest.raises(BlockingIOError):
        first.sendto(b"", CanSegm(64, 2, 5), socket.MSG_DONTWAIT)
    with pytest.raises(BusError, match=REASON):
        first.sendto(b"", CanSegm(65, 2, 5))  # waits for room, and for its own end
    assert [outcome.failure for outcome in first.outcomes] == [REASON] * 64


@pytest.mark.parametrize("node", [-1, 127, 128])
def test_nodes_that_are_none(node: int) -> None:
    with open_can(BUS) as can, pytest.raises(FormatError, match="node"):
        DsorSocket(can, node)


def test_what_does_not_fit_is_refused(sockets: tuple[DsorSocket, DsorSocket]) -> None:
    for data, address in ((bytes(65536), CanSegm(1, 2, 1)), (b"", CanSegm(1, 2, ANY_ID)), (b"", CanPort(65536))):
        with pytest.raises(FormatError):
            sockets[0].sendto(data, address)


def test_a_long_broadcast_arrives() -> None:
    """Nobody acknowledges it, and this bus has no bit rate: its listener has room for all of it, however late it listens."""
    with open_dsor(BUS, 1) as first, open_can(BUS, receive_buffer_bytes=64 << 20) as can:
        second = DsorSocket(can, 2)
        second.settimeout(200.0)
        second.bind(CanSegm(0, 2, 5))
        data = Random(0).randbytes(65_535)
        with answering(second) as got:
            first.sendto(data, CanSegm(0, BROADCAST, 5))
        assert got == [(data, CanSegm(0, 1, 5))]


# The endpoint


def test_a_full_bus_queue_is_waited_for_and_nothing_is_lost(bus: ScriptedBus) -> None:
    end = Endpoint(CanSocket(bus), 1)
    bus.room = 0
    message = Message(8, 1, BROADCAST, 5, bytes(100))
    end.start(message, 0.0)
    assert end.is_sending
    assert end.next_due_s == pytest.approx(0.001)
    for i in range(20):
        bus.room = 1
        end.step(1.0 + i)
    assert bus.sent == segments(message, 0)
    assert not end.is_sending
    assert end.next_due_s == float("inf")


def test_urgent_frames_pass_long_messages(bus: ScriptedBus) -> None:
    end = Endpoint(CanSocket(bus), 1)
    end.listen(lambda message: True)
    bus.room = 5
    end.start(Message(8, 1, BROADCAST, 5, bytes(1000)), 0.0)
    end.start(Message(7, 1, BROADCAST, 6, b""), 0.0)
    bus.incoming += segments(Message(8, 2, 1, 9, b""), 0)[:1]  # its answer has the same priority as the long message
    bus.room = 100
    end.step(0.1)
    kinds = [(dsor_fields(frame.arb).priority, dsor_fields(frame.arb).kind) for frame in bus.sent]
    assert kinds[:10] == [(8, Kind.HEADER)] + [(8, Kind.BODY)] * 5 + [
        (7, Kind.HEADER),
        (7, Kind.BODY),
        (8, Kind.ACK),
        (8, Kind.BODY),
    ]


def test_one_step_is_bounded(bus: ScriptedBus) -> None:
    end = Endpoint(CanSocket(bus), 1)
    end.listen(lambda message: True)
    end.start(Message(8, 1, BROADCAST, 5, bytes(65_535)), 0.0)
    assert len(bus.sent) == 16
    assert end.next_due_s == 0.0
    bus.incoming += segments(Message(8, 2, BROADCAST, 9, bytes(1000)), 0)
    end.step(0.0)
    assert (len(bus.sent), len(bus.incoming)) == (32, 127 - 16)


def test_an_inbox_that_nobody_empties_is_bounded(bus: ScriptedBus) -> None:
    end = Endpoint(CanSocket(bus), 1)
    end.listen(lambda message: True)
    for i in range(2 * INBOX_MAX):
        bus.incoming += segments(Message(8, 2, 1, i, b""), i)
        end.step(0.0)
    assert len(end.inbox) == INBOX_MAX
    assert end.errors["inbox full"] == INBOX_MAX
    end.inbox.clear()
    bus.incoming += segments(Message(8, 2, 1, 99, b""), 99)
    end.step(0.0)
    assert [message.id for message in end.inbox] == [99]


def test_an_outbox_that_the_bus_does_not_empty_is_bounded(bus: ScriptedBus) -> None:
    end = Endpoint(CanSocket(bus), 1)
    end.listen(lambda message: True)
    bus.room = 0
    for i in range(OUTBOX_MAX):
        end.start(Message(8, 1, BROADCAST, i, b""), 0.0)
    with pytest.raises(Refused, match="wait for the bus"):
        end.start(Message(8, 1, BROADCAST, 0, b""), 0.0)
    for i in range(40):
        bus.incoming += segments(Message(8, 2, 1, i, b""), i)
        end.step(0.0)
    assert end.errors["outbox full"] == 80
    bus.room = 1 << 30
    while end.is_sending:
        end.step(0.0)
    assert len(bus.sent) == 2 * OUTBOX_MAX


def test_a_bus_that_fails_loses_frames_and_nothing_else(bus: ScriptedBus) -> None:
    end = Endpoint(CanSocket(bus), 1)
    bus.failure = "gone"
    with pytest.raises(BusError, match="gone"):
        end.start(Message(8, 1, 2, 5, b""), 0.0)
    with pytest.raises(BusError, match="gone"):
        end.step(0.1)
    bus.failure = ""
    end.step(0.2)
    assert bus.sent == segments(Message(8, 1, 2, 5, b""), 1)[:1]


def any_frames(nodes: st.SearchStrategy[int]) -> st.SearchStrategy[list[Frame]]:
    arbs = st.builds(dsor_arb, st.integers(0, 1), st.sampled_from(Kind), nodes, nodes, st.integers(0, 3))
    datas = st.sampled_from([b"\x09\0\0\0\0\0", b"\0\0\0\2", bytes(8), b"\0\0\0\0", b"\1\0\1\0", b"\2\0\2\0", b"\3\0\0\0"])
    return st.lists(st.builds(Frame, arbs | st.integers(0, 0xFFFFFFFF), datas | st.binary(max_size=8)), max_size=80)


@given(any_frames(st.sampled_from([1, 2, BROADCAST])), st.integers(0, 40), st.integers(1, 3))
def test_no_frame_raises_and_everything_ends(frames: list[Frame], room: int, per_step: int) -> None:
    """Both ends at once: node 1 sends while anything at all comes in, in steps of a few frames, on a bus with little room."""
    bus = ScriptedBus()
    try:
        end = Endpoint(CanSocket(bus), 1)
        end.listen(lambda message: message.id != 3)
        bus.room = room
        end.start(Message(1, 1, 2, 5, b"0123456789"), 0.0)
        end.start(Message(0, 1, BROADCAST, 5, b"0123456789"), 0.0)
        now_s = 0.0
        while frames:
            bus.incoming += frames[:per_step]
            del frames[:per_step]
            now_s += 0.05
            end.step(now_s)
        bus.room = 1 << 30
        for _ in range(40):
            now_s += 0.1
            end.step(now_s)
        assert len(end.outcomes) == 1
        assert not end.is_sending
        assert end.next_due_s == float("inf")
    finally:
        bus.close()


def bad_bus(seed: int, lost: float, doubled: float, wrong: float) -> Callable[[list[Frame]], list[Frame]]:
    random = Random(seed)

    def carry(frames: list[Frame]) -> list[Frame]:
        carried = []
        for frame in frames:
            if random.random() < lost:
                continue
            if frame.data and random.random() < wrong:
                at = random.randrange(len(frame.data))
                frame = frame._replace(data=frame.data[:at] + random.randbytes(1) + frame.data[at + 1 :])
            carried += [frame] * (1 + (random.random() < doubled))
            if len(carried) > 1 and random.random() < doubled:
                carried[-1], carried[-2] = carried[-2], carried[-1]
        return carried

    return carry


@given(st.integers(0, 1 << 32), st.floats(0, 0.4), st.floats(0, 0.4), st.floats(0, 0.05))
def test_two_ends_on_a_bad_bus(seed: int, lost: float, doubled: float, wrong: float) -> None:
    """In virtual time. Each message arrives once and intact, or its sender is told."""
    buses = ScriptedBus(), ScriptedBus()
    carry, random = bad_bus(seed, lost, doubled, wrong), Random(seed)
    try:
        ends = [Endpoint(CanSocket(bus), node) for node, bus in enumerate(buses, 1)]
        sent = [
            Message(i % 3, node, 3 - node, 10 * node + i, random.randbytes(random.randint(0, 60)))
            for node in (1, 2)
            for i in range(5)
        ]
        for end in ends:
            end.listen(lambda message: True)
        for message in sent:
            ends[message.source - 1].start(message, 0.0)
        now_s = 0.0
        while any(end.next_due_s < float("inf") for end in ends):
            now_s += 0.01
            for end, bus, other in zip(ends, buses, reversed(buses), strict=True):
                end.step(now_s)
                other.incoming += carry(bus.sent)
                bus.sent.clear()
        got = [message for end in ends for message in end.inbox]
        outcomes = [outcome for end in ends for outcome in end.outcomes]
        assert len(got) == len({message.id for message in got})
        assert all(message in sent for message in got)
        assert sorted(outcome.message for outcome in outcomes) == sorted(sent)
        assert all(outcome.message in got for outcome in outcomes if not outcome.failure)
    finally:
        for bus in buses:
            bus.close()


# The asyncio face


@contextmanager
def transports(**second: object) -> Iterator[tuple[DsorTransport, DsorTransport, list[Outcome]]]:
    """Nodes 1 and 2 in the running loop, and the outcomes of node 1."""
    loop, outcomes = asyncio.get_running_loop(), list[Outcome]()
    with open_can(BUS) as one, open_can(BUS) as two:
        ends = (
            DsorTransport(loop, one, 1, on_outcome=outcomes.append),
            DsorTransport(loop, two, 2, **second),  # type: ignore[arg-type]
        )
        yield *ends, outcomes
        for end in ends:
            end.close()


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(200):
        while not condition():
            await asyncio.sleep(0.001)


async def test_asyncio_round_trip() -> None:
    got = list[Message]()
    with transports(on_message=got.append) as (first, _, outcomes):
        sent = [Message(i, 1, 2, i, Random(i).randbytes(300 * i)) for i in range(10)]
        for message in sent:
            first.send(message)
        first.send(Message(1, 1, BROADCAST, 99, b"to all"))
        await until(lambda: len(outcomes) == 10 and len(got) == 11)
    assert sorted(outcome.message.id for outcome in outcomes) == list(range(10))
    assert not any(outcome.failure for outcome in outcomes)
    assert {message.id: message.data for message in got} == {message.id: message.data for message in sent} | {99: b"to all"}


async def test_asyncio_tells_what_was_not_acknowledged_and_asks_what_is_wanted() -> None:
    asked = list[int]()
    with transports(wanted=lambda message: bool(asked.append(message.id))) as (first, _, outcomes):
        first.send(Message(1, 1, 2, 7, b""))
        await until(lambda: bool(outcomes))
    assert outcomes == [Outcome(Message(1, 1, 2, 7, b""), REASON)]
    assert asked == [7] * 6


async def test_asyncio_takes_up_a_bus_that_failed(bus: ScriptedBus, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dsor_sockets, "REBIND_S", 0.01)
    rebound = list[bool]()
    monkeypatch.setattr(bus, "rebind", lambda: rebound.append(not bus.failure) or not bus.failure)
    transport = DsorTransport(asyncio.get_running_loop(), CanSocket(bus), 1)
    bus.failure = "gone"
    transport.send(Message(1, 1, 2, 7, b""))
    await until(lambda: len(rebound) > 1)
    bus.failure = ""
    await until(lambda: bool(bus.sent))
    transport.close()
    assert rebound[-1] is True


async def test_nothing_is_called_after_close() -> None:
    with transports() as (first, _, outcomes):
        first.send(Message(1, 1, 5, 7, b""))
        first.close()
        await asyncio.sleep(0.15)
        assert not outcomes


# Two processes


@pytest.mark.parametrize(
    ("messages", "bytes_max", "rates"),
    [
        pytest.param(400, 300, Rates(0.05, 0.05, 0.05, 0.005), id="a bad bus"),
        pytest.param(40, 65_535, Rates(0.0005, 0.001, 0.001, 0.00002), id="long messages", marks=pytest.mark.long),
    ],
)
def test_two_processes_on_a_bad_bus(messages: int, bytes_max: int, rates: Rates) -> None:
    """The short form of `python bench/dsor.py --messages 10000`."""
    verdict = exchange(messages, rates, seed=1, bytes_max=bytes_max, bus="testdsor")
    assert verdict.wrong == []
    assert verdict.delivered + verdict.told == messages
    assert verdict.delivered > 0.8 * messages, verdict
    assert verdict.errors["duplicate"] > 0
    with open_can("canloop:testdsor-1") as quiet:
        quiet.bind(ANYTHING)
        assert quiet.receive() is None


HEADERS = """
import itertools
from delfim.canproxy.dsor.protocol import Message, iter_segments
from delfim.canproxy.opening import open_can

data = bytes(9), bytes(65_535)
with open_can("canloop:headers") as can:
    for i in itertools.count():
        can.sendmsg(next(iter_segments(Message(i & 0xFF, 2 + (i >> 8) % 100, 1, i, data[i % 2]), i)))
"""


def test_a_process_that_sends_headers_without_end_and_no_bodies_fills_nothing() -> None:
    """Of 25,600 streams, to a socket in this process; then a message of a third party comes through all the same."""
    with (
        open_dsor("canloop:headers", 1) as node,
        open_dsor("canloop:headers", 120) as other,
        subprocess.Popen([sys.executable, "-c", HEADERS]) as flood,
    ):
        node.bind(CanSegm(0, 1, ANY_ID))
        other.settimeout(200.0)
        kept = node._end._receiver

        def heard(headers: int) -> None:
            until, seen = kept.errors["crowded out"] + headers, 0
            while kept.errors["crowded out"] < until:
                assert flood.poll() is None
                node.step()
                seen = max(seen, len(kept._open))
                assert len(kept._open) <= 16
                assert len(kept._last) <= 128
            assert seen == 16

        try:
            tracemalloc.start()
            heard(3000)
            before, _ = tracemalloc.get_traced_memory()
            heard(6000)
            after, _ = tracemalloc.get_traced_memory()
            tracemalloc.stop()
        finally:
            flood.kill()
        assert after - before < 100_000, "6,000 headers that are kept would take more than a megabyte"
        node.settimeout(200.0)

        def sent() -> None:
            for _ in range(100):
                with contextlib.suppress(BusError):  # on a busy machine nobody may be there to acknowledge in time
                    other.sendto(b"through", CanSegm(0, 1, 7))
                    return

        thread = threading.Thread(target=sent)
        thread.start()
        while node.recvmsg().source != 120:
            pass
        thread.join()
