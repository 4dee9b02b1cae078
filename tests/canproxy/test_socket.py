"""What a CAN socket is, on every transport there is: canloop here, SocketCAN as well where the kernel has a vcan0."""

import errno
import itertools
import os
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from delfim.base.errors import BusError, FormatError
from delfim.base.frames import CAN_ANY, CAN_ERR, CAN_ID, CAN_IDE, CAN_RTR, Frame, extended, standard, to_can_id
from delfim.canproxy.canloop import CanLoop
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import ANYTHING, BATCH, BusState, CanAddress, CanSocket, accepts, bus_state
from delfim.canproxy.socketcan import SocketCan, kernel_filters

INTERFACES = ["canloop", "canloop without kernel filter"]
INTERFACES += [name for _, name in socket.if_nameindex() if name == "vcan0"]
_numbers = itertools.count()


@pytest.fixture(params=INTERFACES)
def opened(request: pytest.FixtureRequest) -> Iterator[Callable[..., CanSocket]]:
    """Opens sockets on one bus, as many as asked for, and closes them."""
    name = f"test-{os.getpid()}-{next(_numbers)}"
    sockets: list[CanSocket] = []

    def open_one(receive_buffer_bytes: int = 1 << 20, error_frames: bool = False) -> CanSocket:
        if request.param == "vcan0":
            one = CanSocket(SocketCan("vcan0", receive_buffer_bytes, error_frames))
        else:
            kernel_filter = request.param == "canloop"
            one = CanSocket(CanLoop(name, receive_buffer_bytes, error_frames, kernel_filter=kernel_filter))
        one.settimeout(200.0)
        sockets.append(one)
        return one

    yield open_one
    for one in sockets:
        one.close()


def test_a_frame_arrives_whole(opened: Callable[..., CanSocket]) -> None:
    sender, receiver = opened(), opened()
    receiver.bind(ANYTHING)
    before_ns = time.time_ns()
    assert sender.sendto(b"delfim", CanAddress(extended(0x1ABCDEF0))) == 6
    after_ns = time.time_ns()
    frame = receiver.recvmsg()
    assert frame[:2] == (extended(0x1ABCDEF0), b"delfim")
    assert frame.ifindex == receiver.ifindex > 0
    assert frame.sent_here
    assert before_ns - 1_000_000 <= frame.t_ns <= after_ns + 50_000_000


def test_nothing_arrives_before_bind_and_nothing_after_bind_to_nothing(opened: Callable[..., CanSocket]) -> None:
    sender, receiver = opened(), opened()
    sender.sendto(b"1", CanAddress(standard(1)))
    receiver.bind(ANYTHING)
    sender.sendto(b"2", CanAddress(standard(1)))
    assert receiver.recv(8) == b"2"
    receiver.bind()
    sender.sendto(b"3", CanAddress(standard(1)))
    receiver.bind(ANYTHING)
    sender.sendto(b"4", CanAddress(standard(1)))
    assert receiver.recv(8) == b"4"


def test_own_frames_are_heard_by_the_others_only(opened: Callable[..., CanSocket]) -> None:
    one, two, three = opened(), opened(), opened()
    for each in (one, two, three):
        each.bind(ANYTHING)
    one.sendto(b"one", CanAddress(standard(1)))
    two.sendto(b"two", CanAddress(standard(2)))
    assert one.recv(8) == b"two"
    assert two.recv(8) == b"one"
    assert [three.recv(8), three.recv(8)] == [b"one", b"two"]
    assert one.receive() is two.receive() is three.receive() is None


def test_send_needs_connect(opened: Callable[..., CanSocket]) -> None:
    sender, receiver = opened(), opened()
    receiver.bind(ANYTHING)
    with pytest.raises(OSError, match="Destination address required") as caught:
        sender.send(b"x")
    assert caught.value.errno == errno.EDESTADDRREQ
    sender.connect(CanAddress(standard(0x123)))
    assert sender.send(b"x") == 1
    assert receiver.recvfrom(8) == (b"x", CanAddress(standard(0x123), 0, receiver.ifindex))


def test_bytes_that_do_not_fit_are_lost(opened: Callable[..., CanSocket]) -> None:
    sender, receiver = opened(), opened()
    receiver.bind(ANYTHING)
    sender.sendto(b"12345678", CanAddress(standard(1)))
    sender.sendto(b"abcdefgh", CanAddress(standard(1)))
    assert receiver.recv(3) == b"123"
    assert receiver.recvfrom(0)[0] == b""
    assert receiver.receive() is None


def test_more_than_eight_bytes_are_no_frame(opened: Callable[..., CanSocket]) -> None:
    with pytest.raises(FormatError):
        opened().sendto(bytes(9), CanAddress(standard(1)))


def test_an_empty_queue(opened: Callable[..., CanSocket]) -> None:
    receiver = opened()
    receiver.bind(ANYTHING)
    assert receiver.receive() is None
    with pytest.raises(BlockingIOError):
        receiver.recv(8, socket.MSG_DONTWAIT)
    receiver.settimeout(0.01)
    with pytest.raises(TimeoutError):
        receiver.recv(8)
    receiver.setblocking(False)
    with pytest.raises(BlockingIOError):
        receiver.recvmsg()


def test_a_blocking_socket_waits_for_its_frame(opened: Callable[..., CanSocket]) -> None:
    sender, receiver = opened(), opened()
    receiver.bind(CanAddress(standard(7)))
    receiver.setblocking(True)
    timer = threading.Timer(0.05, lambda: sender.sendto(b"late", CanAddress(standard(7))))
    timer.start()
    assert receiver.recv(8) == b"late"
    timer.join()


@pytest.mark.parametrize("opened", [name for name in INTERFACES if "without" not in name], indirect=True)
def test_the_file_descriptor_tells_that_a_frame_is_there(opened: Callable[..., CanSocket]) -> None:
    sender, receiver = opened(), opened()
    receiver.bind(CanAddress(standard(7)))
    sender.sendto(b"", CanAddress(standard(8)))
    assert select.select([receiver.fileno()], [], [], 0)[0] == []
    sender.sendto(b"", CanAddress(standard(7)))
    assert select.select([receiver.fileno()], [], [], 5.0)[0] == [receiver.fileno()]


@pytest.mark.parametrize(
    "frame", [Frame(standard(5, remote=True), bytes(3)), Frame(extended(6), b""), Frame(standard(0), bytes(8))]
)
def test_sendmsg_carries_every_kind_of_frame(opened: Callable[..., CanSocket], frame: Frame) -> None:
    sender, receiver = opened(), opened()
    receiver.bind(ANYTHING)
    assert sender.sendmsg(frame) == len(frame.data)
    assert receiver.recvmsg()[:2] == frame[:2]


def test_ide_dont_care_takes_both_formats(opened: Callable[..., CanSocket]) -> None:
    sender, receiver = opened(), opened()
    receiver.bind(CanAddress(standard(0x123), CAN_IDE), CanAddress(standard(0x7FF)))
    wanted = [standard(0x123), extended(0x123 << 18), standard(0x7FF)]
    for arb in (extended(0x123), standard(0x124), extended(0x123 << 18 | 1), standard(0x123, remote=True), *wanted):
        sender.sendto(b"", CanAddress(arb))
    assert [receiver.recvmsg().arb for _ in wanted] == wanted


arbs = st.one_of(
    st.builds(standard, st.integers(0, 0x7FF), st.booleans()), st.builds(extended, st.integers(0, 0x1FFFFFFF), st.booleans())
)
masks = st.one_of(
    st.integers(0, 0xFFFFFFFF), st.sampled_from([0, CAN_ANY, CAN_IDE, CAN_RTR, CAN_IDE | CAN_RTR, CAN_ID, 0x1FFFF8, 0xFFFFFFFF])
)


@st.composite
def filters_and_frames(draw: st.DrawFn) -> tuple[list[CanAddress], list[int]]:
    """Frames near the filters: a random frame would hardly ever pass."""
    addresses = draw(st.lists(st.builds(CanAddress, arbs, masks, st.just(0)), max_size=4))
    near = [st.integers(0, 31).map(lambda bit, arb=address.arb: arb ^ 1 << bit) for address in addresses]
    near += [st.just(address.arb) for address in addresses]
    frames = draw(st.lists(st.one_of(arbs, *near), min_size=1, max_size=12))
    return addresses, [possible(arb) for arb in frames]


def possible(arb: int) -> int:
    """The frame that could be on a bus: no error frame, no extended identifier in a standard one."""
    return arb & ~CAN_ERR if arb & CAN_IDE else arb & (0x7FF << 21 | CAN_RTR)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(filters_and_frames())
@example(([CanAddress(standard(1), CAN_ANY | CAN_ERR)], [standard(5), extended(9)]))
@example(([CanAddress(standard(1) | CAN_ERR, CAN_ANY)], [standard(5), extended(9)]))
def test_the_kernel_filters_as_the_thesis_says(opened, case):
    addresses, frames = case
    end = CanAddress(extended(0x15555555, remote=True))
    sender, receiver = opened(), opened()
    receiver.bind(*addresses, end)
    for arb in [*frames, end.arb]:
        sender.sendto(b"", CanAddress(arb))
    accepted = []
    while not accepted or accepted[-1] != end.arb:
        accepted.append(receiver.recvmsg().arb)
    first_end = [*frames, end.arb].index(end.arb) + 1
    assert accepted == [a for a in [*frames, end.arb][:first_end] if any(accepts(address, a) for address in [*addresses, end])]
    sender.close()
    receiver.close()


@given(arbs, masks, arbs, st.integers(0, 31))
def test_socketcan_filter_entries_mean_the_same(arb: int, mask: int, other: int, bit: int) -> None:
    """The rule of CAN_RAW_FILTER, linux/can.h: a frame passes when received_id & mask == can_id & mask, for any entry."""
    address = CanAddress(arb, mask)
    for frame in (possible(other), possible(arb), possible(arb ^ 1 << bit)):
        passed = any(to_can_id(frame) & can_mask == can_id & can_mask for can_id, can_mask in kernel_filters(address))
        assert passed == accepts(address, frame)


def test_a_full_queue_loses_frames_and_counts_them(opened: Callable[..., CanSocket]) -> None:
    sender, receiver = opened(), opened(receive_buffer_bytes=4096)
    receiver.bind(CanAddress(standard(1)), CanAddress(standard(2)))
    sender.sendto(b"", CanAddress(standard(1)))
    sender.sendto(b"", CanAddress(standard(2)))
    assert (receiver.recvmsg().arb, receiver.recvmsg().arb) == (standard(1), standard(2))
    for number in range(100):
        sender.sendto(bytes([number]), CanAddress(standard(1)))
        sender.sendto(bytes([number]), CanAddress(standard(0x700)))  # refused, not lost
    queued = 0
    while receiver.receive() is not None:
        queued += 1
    assert 0 < queued < 100
    assert receiver.dropped == 0  # told with the next frame that gets through
    sender.sendto(b"", CanAddress(standard(2)))
    sender.sendto(b"", CanAddress(standard(1)))
    assert (receiver.recvmsg().arb, receiver.recvmsg().arb) == (standard(2), standard(1))
    assert receiver.dropped == 100 - queued


def test_error_frames_pass_only_where_asked_for(opened: Callable[..., CanSocket]) -> None:
    bus_off = 0x40 << 3 | CAN_IDE | CAN_ERR
    sender, ordinary, listener = opened(), opened(), opened(error_frames=True)
    for each in (ordinary, listener):
        each.bind(CanAddress(standard(1)))
    sender.sendto(bytes(8), CanAddress(bus_off))
    sender.sendto(b"", CanAddress(standard(1)))
    assert ordinary.recvmsg().arb == standard(1)
    frame = listener.recvmsg()
    assert frame.error
    assert bus_state(frame) == BusState("bus off")
    assert listener.recvmsg().arb == standard(1)


def test_an_interface_of_another_bus_is_refused(opened: Callable[..., CanSocket]) -> None:
    one = opened()
    one.bind(ANYTHING._replace(ifindex=one.ifindex))
    with pytest.raises(BusError, match="has index"):
        one.bind(ANYTHING._replace(ifindex=one.ifindex + 1))


def test_rebind_of_a_bus_that_is_well_changes_nothing(opened: Callable[..., CanSocket]) -> None:
    sender, receiver = opened(), opened()
    receiver.bind(CanAddress(standard(1)))
    assert receiver.rebind()
    sender.sendto(b"", CanAddress(standard(2)))
    sender.sendto(b"", CanAddress(standard(1)))
    assert receiver.recvmsg().arb == standard(1)


def test_a_closed_socket_says_so(opened: Callable[..., CanSocket]) -> None:
    with opened() as one:
        pass
    assert one.fileno() == -1
    with pytest.raises(BusError):
        one.receive()
    with pytest.raises(BusError):
        one.sendto(b"", CanAddress(standard(1)))


MANY = [(standard(0x40 + i), bytes(range(i))) for i in range(3)] + [
    (extended(0x1ABCDEF0), b"delfim"),
    (extended(7), b"12345678"),
]


def test_many_frames_at_once_are_those_one_by_one(opened: Callable[..., CanSocket]) -> None:
    sender, receiver, other = opened(), opened(), opened()
    receiver.bind(ANYTHING)
    other.bind(ANYTHING)
    assert sender.receive_many() == []
    assert sender.send_many(MANY) == 0
    sender.sendto(b"", CanAddress(standard(1)))
    one_by_one = [other.recvmsg() for _ in range(6)]
    assert [frame[:2] for frame in one_by_one] == [*MANY, (standard(1), b"")]
    select.select([receiver], [], [], 5.0)
    frames: list[Frame] = []
    while len(frames) < 6:
        frames += receiver.receive_many()
    assert [frame._replace(t_ns=0) for frame in frames] == [frame._replace(t_ns=0) for frame in one_by_one]
    assert all(abs(at_once.t_ns - single.t_ns) < 50_000_000 for at_once, single in zip(frames, one_by_one, strict=True))
    assert receiver.dropped == 0


def test_many_frames_leave_no_more_than_a_batch_at_a_time(opened: Callable[..., CanSocket]) -> None:
    sender, receiver = opened(), opened()
    receiver.bind(ANYTHING)
    for number in range(BATCH + 2):
        sender.sendto(bytes([number]), CanAddress(standard(1)))
    select.select([receiver], [], [], 5.0)
    assert [frame.data[0] for frame in receiver.receive_many()] == list(range(BATCH))
    assert [frame.data[0] for frame in receiver.receive_many()] == [BATCH, BATCH + 1]


def test_many_frames_count_what_a_full_queue_lost(opened: Callable[..., CanSocket]) -> None:
    sender, receiver = opened(), opened(receive_buffer_bytes=2048)
    receiver.bind(ANYTHING)
    for _ in range(100):
        sender.send_many([(standard(1), b"12345678")] * BATCH)
    heard = 0
    while frames := receiver.receive_many():
        heard += len(frames)
    assert heard < 600
    sender.send_many([(standard(1), b"last")])
    assert [frame.data for frame in receiver.receive_many()] == [b"last"]
    assert receiver.dropped == 600 - heard


def test_a_rehearsal_is_heard_by_nobody(opened: Callable[..., CanSocket]) -> None:
    sender, receiver = opened(), opened()
    receiver.bind(ANYTHING)
    sender.rehearse()
    sender.sendto(b"after", CanAddress(standard(1)))
    assert receiver.recv(8) == b"after"
    assert receiver.dropped == 0


def test_a_mirror_receives_what_it_sends_as_the_bus_would_and_nobody_hears_it(opened: Callable[..., CanSocket]) -> None:
    sender, receiver = opened(), opened()
    receiver.bind(ANYTHING)
    frames = [(standard(1), b""), (extended(0x1ABCDEF1), b"12345678"), (standard(0x7FF), b"123")]
    mirror = sender.mirror()
    if mirror is None:  # no system calls for many
        assert not sender._transport._kernel_filter
        return
    for _ in range(2):
        assert mirror.send_many(frames) == 0
        assert [(frame.arb, frame.data) for frame in mirror.receive_many()] == frames
        assert mirror.receive_many() == []
    assert sender.send_many(frames) == 0
    heard = [receiver.recvmsg() for _ in frames]  # they may take a moment
    assert [(frame.arb, frame.data) for frame in heard] == frames, "none was missed"
    assert receiver.receive_many() == [], "once"
    assert receiver.dropped == 0


def test_a_socket_that_takes_one_frame_at_a_time_has_no_mirror() -> None:
    assert CanSocket(FullBus(full=0)).mirror() is None
    with CanSocket(CanLoop(f"m{os.getpid()}", droprate=0.5, seed=1)) as lossy:
        assert lossy.mirror() is None


def test_a_closed_socket_neither_takes_nor_gives_many(opened: Callable[..., CanSocket]) -> None:
    """Its descriptor may be somebody else's by then."""
    closed = opened()
    receive_many, send_many = closed.receive_many, closed.send_many
    closed.close()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as heir:
        heir.bind(("127.0.0.1", 0))
        heir.sendto(b"not yours", heir.getsockname())
        with pytest.raises(BusError):
            receive_many()
        assert send_many(MANY) == len(MANY)
        assert heir.recv(16) == b"not yours"


def test_one_frame_that_is_not_taken_does_not_keep_the_others_back() -> None:
    bus = FullBus(full=2)
    assert CanSocket(bus).send_many(MANY) == 2
    assert [arb for arb, _, _ in bus.sent] == [arb for arb, _ in MANY[2:]]


class FullBus:
    """A transport whose transmit queue is full for the first `full` tries."""

    name, ifindex, dropped, outlets = "full", 1, 0, None

    def __init__(self, full: int) -> None:
        self.full, self.sent = full, []

    def send(self, arb: int, data: bytes, ifindex: int) -> None:
        self.full -= 1
        if self.full >= 0:
            raise BlockingIOError(errno.EAGAIN, "full")
        self.sent.append((arb, data, ifindex))

    def receive(self) -> None:
        return None

    def rehearse(self) -> None: ...


def test_a_full_transmit_queue() -> None:
    bus = FullBus(full=3)
    one = CanSocket(bus)
    with pytest.raises(BlockingIOError):
        one.sendto(b"x", CanAddress(8), socket.MSG_DONTWAIT)
    assert one.sendto(b"x", CanAddress(8)) == 1
    assert bus.sent == [(8, b"x", 0)]
    bus.full = 1_000_000
    one.settimeout(0.01)
    with pytest.raises(TimeoutError):
        one.sendto(b"x", CanAddress(8))
    one.setblocking(False)
    with pytest.raises(BlockingIOError):
        one.sendto(b"x", CanAddress(8))


def test_ifindex_zero_sends_by_every_interface_of_any() -> None:
    bus = FullBus(full=0)
    bus.outlets = lambda: [3, 5]
    CanSocket(bus).sendto(b"x", CanAddress(8))
    CanSocket(bus).sendto(b"y", CanAddress(8, 0, 5))
    assert bus.sent == [(8, b"x", 3), (8, b"x", 5), (8, b"y", 5)]


@pytest.mark.parametrize("interface", ["nocan7", "lo", "python-can:virtual", "python-can:no-such-interface:1"])
def test_an_interface_that_cannot_be_opened_has_a_reason(interface: str) -> None:
    with pytest.raises(BusError, match=interface.partition(":")[0]):
        open_can(interface)


@pytest.mark.parametrize(
    ("identifier", "data", "state"),
    [
        (0x040, bytes(8), BusState("bus off")),
        (0x044, bytes([0, 0x20, 0, 0, 0, 0, 0, 0]), BusState("bus off")),
        (0x100, bytes(8), BusState("restarted")),
        (0x204, bytes([0, 0x20, 0, 0, 0, 0, 128, 3]), BusState("error passive", 128, 3)),
        (0x204, bytes([0, 0x08, 0, 0, 0, 0, 96, 0]), BusState("error warning", 96, 0)),
        (0x004, bytes([0, 0x40]), BusState("error active")),
        (0x004, bytes([0, 0x01, 0, 0, 0, 0, 0, 0]), None),
        (0x020, bytes(8), None),
        (0x004, b"", None),
    ],
)
def test_bus_state(identifier: int, data: bytes, state: BusState | None) -> None:
    assert bus_state(Frame(identifier << 3 | CAN_IDE | CAN_ERR, data)) == state


def test_data_frames_say_nothing_of_the_bus() -> None:
    assert bus_state(Frame(extended(0x40), bytes(8))) is None
