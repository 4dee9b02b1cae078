"""The lock-step bus against the semantics of CAN sockets (thesis 5.2)."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.clock import ManualClock
from delfim.base.errors import BusError, FormatError
from delfim.base.frames import CAN_ERR, CAN_IDE, CAN_RTR, Frame, extended, standard
from delfim.canproxy.socket import ANYTHING, BATCH, CanAddress, CanSocket
from delfim.simulator.lockstepbus import LockstepBus

words = st.integers(0, 0xFFFFFFFF)


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock()


@pytest.fixture
def bus(clock: ManualClock) -> LockstepBus:
    return LockstepBus(clock)


def bound(bus: LockstepBus, *addresses: CanAddress, computer: str = "vehicle") -> CanSocket:
    socket = bus.socket(computer)
    socket.bind(*(addresses or (ANYTHING,)))
    return socket


def drained(socket: CanSocket) -> list[Frame]:
    frames = []
    while (frame := socket.receive()) is not None:
        frames.append(frame)
    return frames


def matches(arb: int, address: CanAddress) -> bool:
    """The reference: bit by bit, as thesis 5.2.4 says it; no filter lets an error frame through."""
    if arb & CAN_ERR:
        return False
    return all(address.mask >> bit & 1 or arb >> bit & 1 == address.arb >> bit & 1 for bit in range(32))


@given(
    st.lists(st.builds(CanAddress, words, words, st.just(0)), max_size=4), st.lists(words, min_size=1, max_size=8), st.data()
)
def test_filters_accept_what_the_reference_accepts(addresses: list[CanAddress], arbs: list[int], data: st.DataObject) -> None:
    bus = LockstepBus(ManualClock())
    near = [address.arb ^ data.draw(words) & address.mask for address in addresses]
    sender, receiver = bus.socket(), bus.socket()
    receiver.bind(*addresses)
    for arb in (*arbs, *near):
        sender.sendto(b"", CanAddress(arb))
    wanted = [arb for arb in (*arbs, *near) if any(matches(arb, address) for address in addresses)]
    assert [frame.arb for frame in drained(receiver)] == wanted


def test_a_frame_reaches_all_others_at_once_with_stamp_and_interface(bus: LockstepBus, clock: ManualClock) -> None:
    sender, one, other = bound(bus), bound(bus), bound(bus)
    clock.advance(1.5)
    assert sender.sendto(b"\1\2", CanAddress(standard(0x40))) == 2
    frame = one.receive()
    assert frame == Frame(standard(0x40), b"\1\2", clock.time_ns(), one.ifindex, sent_here=True)
    assert other.receive() == frame
    assert sender.receive() is None, "who sends does not hear itself"


def test_frames_of_another_computer_are_not_sent_here(bus: LockstepBus) -> None:
    vehicle, black_box, nodes = bound(bus), bound(bus), bound(bus, computer="nodes")
    nodes.sendmsg(Frame(extended(1)))
    vehicle.sendmsg(Frame(extended(2)))
    assert [(frame.identifier, frame.sent_here) for frame in drained(black_box)] == [(1, False), (2, True)]


def test_it_hears_nothing_before_bind_and_a_new_bind_replaces_the_old(bus: LockstepBus) -> None:
    sender, receiver = bus.socket(), bus.socket()
    sender.sendmsg(Frame(standard(1)))
    receiver.bind(CanAddress(standard(1)))
    sender.sendmsg(Frame(standard(1), b"a"))
    receiver.bind(CanAddress(standard(2)))
    sender.sendmsg(Frame(standard(1), b"b"))
    sender.sendmsg(Frame(standard(2), b"c"))
    sender.sendmsg(Frame(standard(2) | CAN_RTR, b"d"))
    sender.sendmsg(Frame(standard(2) | CAN_IDE, b"e"))
    assert [frame.data for frame in drained(receiver)] == [b"a", b"c"]


def test_a_full_queue_drops_the_newest_and_counts(clock: ManualClock) -> None:
    bus = LockstepBus(clock, queue_max=3)
    sender, slow, quick = bus.socket(), bound(bus), bound(bus)
    for number in range(5):
        sender.sendmsg(Frame(standard(number)))
        assert quick.receive() is not None
    assert [frame.identifier for frame in drained(slow)] == [0, 1, 2]
    assert (slow.dropped, quick.dropped, sender.dropped) == (2, 0, 0)
    sender.sendmsg(Frame(standard(9)))
    assert [frame.identifier for frame in drained(slow)] == [9]


def test_it_never_blocks_and_is_nothing_to_select_on(bus: LockstepBus) -> None:
    socket = bound(bus)
    assert socket.fileno() == -1
    with pytest.raises(BlockingIOError):
        socket.recvmsg()


def test_connect_and_send(bus: LockstepBus) -> None:
    sender, receiver = bus.socket(), bound(bus)
    with pytest.raises(OSError, match="estination address"):
        sender.send(b"x")
    sender.connect(CanAddress(standard(7)))
    assert sender.send(b"x") == 1
    assert receiver.recvfrom(8) == (b"x", CanAddress(standard(7), 0, receiver.ifindex))


def test_what_is_no_frame_or_of_another_interface_is_refused(bus: LockstepBus) -> None:
    sender, receiver = bus.socket(), bound(bus)
    with pytest.raises(FormatError, match="9 bytes"):
        sender.sendto(bytes(9), CanAddress(standard(1)))
    with pytest.raises(BusError, match="interface 5"):
        sender.sendto(b"", CanAddress(standard(1), 0, 5))
    with pytest.raises(BusError, match="interface 5"):
        receiver.bind(CanAddress(ifindex=5))
    assert receiver.receive() is None


def test_a_closed_socket_neither_sends_nor_hears(bus: LockstepBus) -> None:
    one, other = bound(bus), bound(bus)
    assert one.rebind()
    one.sendmsg(Frame(standard(1)))
    other.close()
    other.close()
    one.sendmsg(Frame(standard(2)))
    assert other.receive() is None
    assert not other.rebind()
    with pytest.raises(BusError, match="closed"):
        other.sendmsg(Frame(standard(3)))
    with pytest.raises(BusError, match="closed"):
        other.bind(ANYTHING)
    assert one.receive() is None


def test_data_of_a_sender_that_goes_on_with_its_buffer_is_kept(bus: LockstepBus) -> None:
    sender, receiver = bus.socket(), bound(bus)
    buffer = bytearray(b"before")
    sender.sendto(buffer, CanAddress(standard(1)))
    buffer[:] = b"after!"
    assert receiver.recv(8) == b"before"


def test_routes_stay_bounded(bus: LockstepBus) -> None:
    sender, receiver = bus.socket(), bound(bus)
    for number in range(10_000):
        sender.sendmsg(Frame(extended(number)))
        assert receiver.receive() is not None
    assert max(len(end.routes) for end in bus._ends) <= 4096


def test_many_frames_go_the_short_way_a_batch_at_a_time_and_on_a_bus_that_is_off_none_is_taken(bus: LockstepBus) -> None:
    sender, receiver = bus.socket(), bound(bus)
    frames = [(standard(number), bytes([number])) for number in range(1, 9)]
    assert sender.send_many(frames) == 0
    heard = [receiver.receive_many() for _ in range(3)]
    assert [len(batch) for batch in heard] == [BATCH, 2, 0]
    assert [(frame.arb, frame.data) for batch in heard for frame in batch] == frames
    bus.off = True
    assert sender.send_many(frames[:4]) == 4
    assert sender.mirror() is None, "there are no caches to warm"
