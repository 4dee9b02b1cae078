"""The DSOR segmented message: bits, both state machines, and the two against each other over a bad bus."""

import heapq
import itertools
import random
import re
import tracemalloc
import zlib
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.clock import ManualClock
from delfim.base.errors import FormatError, Refused
from delfim.base.frames import CAN_ERR, Frame, extended, standard
from delfim.canproxy.dsor.messages import Node, sysstat_arb
from delfim.canproxy.dsor.protocol import Ack, Kind, Message, Outcome, ack_filter, dsor_arb, message_filter, segments
from delfim.canproxy.dsor.receiver import Receiver
from delfim.canproxy.dsor.sender import MessageSender
from tests.canproxy.dsor_fields import dsor_fields

NAVIGATION = Message(0x20, Node.NAVIGATION, Node.BROADCAST, 1, bytes(range(32)))
TO_VEHICLE = Message(0x80, Node.GPS, Node.VEHICLE, 2, bytes(range(16)))

bytes_of = st.integers(0, 255)
node = st.integers(0, 0x7E)
datas = st.binary(max_size=300)
headers = st.one_of(
    st.builds(lambda i: (i, None, None), st.integers(0, 0xFFFFFFFF)),
    st.builds(lambda p: (0, p, None), st.integers(0, 511)),
    st.builds(lambda p, a: (0, p, a), st.integers(0, 0xFFFF), st.integers(0, 0xFFFFFFFF)),
)


@st.composite
def messages(draw: st.DrawFn, destination: st.SearchStrategy[int]) -> Message:
    identifier, port, address = draw(headers)
    return Message(draw(bytes_of), draw(node), draw(destination), identifier, draw(datas), 0, port, address)


def feed(receiver: Receiver, frames: Iterable[Frame], now_s: float = 0.0) -> list[Message]:
    return [m for frame in frames if (m := receiver.feed(frame, now_s)) is not None]


def ack(message: Message, kind: int, number: int, segment: int) -> Frame:
    arb = dsor_arb(message.priority, Kind.ACK, message.destination, message.source, 0)
    return Frame(arb, bytes([kind, number, segment & 0xFF, segment >> 8]))


def flipped(frame: Frame, bit: int) -> Frame:
    """One bit of the data turned over."""
    return frame._replace(data=(int.from_bytes(frame.data, "little") ^ 1 << bit).to_bytes(len(frame.data), "little"))


# Bits


def test_examples_of_the_document() -> None:
    """docs/dsor.md shows a broadcast message, an addressed one with its acknowledgements, and two more headers."""
    sender, receiver = MessageSender(1), Receiver(0)
    conversation = sender.start(Message(0x80, 1, 0, 2, b"DelfimX"), 0.0)
    for frame in conversation:
        feed(receiver, [frame])
        conversation += [*receiver.replies, *(f for reply in receiver.replies for f in sender.feed(reply, 0.0))]
        receiver.replies.clear()
    frames = segments(Message(0x20, 0x02, 0x7F, 1, b"DelfimX"), 5) + conversation
    frames += segments(Message(0x80, 1, 0, 0, b"", port=300), 5)[:1]
    frames += segments(Message(0x80, 1, 0, 0, b"", port=4747, address=0xC0A80102), 5)[:1]
    text = (Path(__file__).parents[2] / "docs" / "dsor.md").read_text(encoding="utf-8")
    shown = re.findall(r"([0-9A-F]{8})(?: \||)\s`([0-9a-f ]+)`", text)
    assert shown == [(f"{f.identifier:08X}", f.data.hex(" ")) for f in frames]


def test_crc_is_that_of_the_document() -> None:
    assert zlib.crc32(bytes.fromhex("070001000000") + b"DelfimX") == 0xEB9E5E89
    assert zlib.crc32(b"DelfimX" + zlib.crc32(b"DelfimX").to_bytes(4, "little")) == 0x2144DF1C


@given(bytes_of, st.sampled_from(Kind), st.integers(0, 127), st.integers(0, 127), st.integers(0, 31))
def test_arbitration_field_round_trip(priority: int, kind: Kind, source: int, destination: int, sequence: int) -> None:
    arb = dsor_arb(priority, kind, source, destination, sequence)
    assert dsor_fields(arb) == (priority, kind, source, destination, sequence)
    assert arb == extended(priority << 21 | kind << 19 | source << 12 | destination << 5 | sequence)


@pytest.mark.parametrize("fields", [(256, 0, 0, 0, 0), (0, 4, 0, 0, 0), (0, 0, 128, 0, 0), (0, 0, 0, -1, 0), (0, 0, 0, 0, 32)])
def test_fields_that_do_not_fit_are_refused(fields: tuple[int, int, int, int, int]) -> None:
    with pytest.raises(FormatError, match="outside 0"):
        dsor_arb(*fields)


@pytest.mark.parametrize("arb", [standard(1), extended(1, remote=True), extended(1) | CAN_ERR])
def test_only_extended_data_frames_have_fields(arb: int) -> None:
    with pytest.raises(FormatError, match="extended"):
        dsor_fields(arb)


@pytest.mark.parametrize(
    "change",
    [
        {"data": bytes(65536)},
        {"id": 1 << 32},
        {"id": -1},
        {"port": 512},
        {"port": -1},
        {"port": 65536, "address": 1},
        {"port": 1, "address": 1 << 32},
        {"source": 0x7F},
        {"source": 0x80},
        {"priority": 256},
    ],
)
def test_messages_that_do_not_fit_are_refused(change: dict[str, object]) -> None:
    with pytest.raises(FormatError):
        segments(TO_VEHICLE._replace(**change), 0)  # type: ignore[arg-type]


def accepted(arb: int, filter_: tuple[int, int]) -> bool:
    return (arb ^ filter_[0]) & ~filter_[1] & 0xFFFFFFFF == 0


@given(bytes_of, st.sampled_from(Kind), node, node, node, node, st.integers(0, 31))
def test_filters(priority: int, kind: Kind, source: int, destination: int, a: int, b: int, sequence: int) -> None:
    arb = dsor_arb(priority, kind, source, destination, sequence)
    message = kind in (Kind.HEADER, Kind.BODY)
    assert accepted(arb, message_filter()) == message
    assert accepted(arb, message_filter(source=a)) == (message and source == a)
    assert accepted(arb, message_filter(destination=b)) == (message and destination == b)
    assert accepted(arb, message_filter(source, destination)) == message
    assert accepted(arb, ack_filter(a)) == (kind == Kind.ACK and destination == a)
    assert not accepted(arb | 2, message_filter())


def test_status_frames_are_outside_the_protocol() -> None:
    assert dsor_fields(sysstat_arb(Node.PROPELLER_PORT)).kind == Kind.PLAIN
    receiver = Receiver(Node.VEHICLE)
    assert receiver.feed(Frame(sysstat_arb(Node.PROPELLER_PORT), bytes(6)), 0.0) is None
    assert not receiver.errors
    assert not receiver.replies


# Broadcast


@given(messages(st.just(0x7F)), st.integers(0, 1000))
def test_broadcast_round_trip(message: Message, number: int) -> None:
    receiver = Receiver(5)
    frames = segments(message, number)
    assert all(len(f.data) <= 8 for f in frames)
    assert feed(receiver, frames) == [message]
    assert not receiver.replies
    assert not receiver.errors


@pytest.mark.parametrize("length", [0, 1, 3, 4, 5, 8, 251, 252, 253, 256, 65531, 65532, 65535])
def test_every_length(length: int) -> None:
    message = NAVIGATION._replace(data=random.Random(length).randbytes(length))
    frames = segments(message, 31)
    assert len(frames) == 1 + (length + 4 + 7) // 8
    assert feed(Receiver(0), frames) == [message]


def test_stamp_is_that_of_the_last_frame() -> None:
    stamped = [f._replace(t_ns=1000 + i) for i, f in enumerate(segments(NAVIGATION, 0))]
    assert feed(Receiver(0), stamped) == [NAVIGATION._replace(t_ns=1005)]


@pytest.mark.parametrize("lost", range(1, 6))
def test_a_lost_body_loses_the_broadcast_message_and_not_the_next(lost: int) -> None:
    receiver = Receiver(0)
    frames = segments(NAVIGATION, 0)
    assert feed(receiver, frames[:lost] + frames[lost + 1 :]) == []
    assert feed(receiver, segments(NAVIGATION, 1)) == [NAVIGATION]
    assert receiver.errors == {"superseded" if lost == 5 else "out of order": 1}


def test_a_lost_header_is_counted_where_messages_are_received() -> None:
    receiver = Receiver(0)
    feed(receiver, segments(NAVIGATION, 0))
    assert feed(receiver, segments(NAVIGATION, 1)[1:]) == []
    assert receiver.errors == {"header lost": 1}


def test_bodies_of_a_message_for_others_are_no_error() -> None:
    receiver = Receiver(0, lambda message: message.id == 1)
    assert feed(receiver, segments(NAVIGATION._replace(id=9), 0)) == []
    assert feed(receiver, segments(TO_VEHICLE._replace(destination=4), 0)) == []
    assert not receiver.errors


def test_a_late_header_that_is_not_for_here_does_not_make_forget() -> None:
    """Corrupted so that nobody wants it; the last body, repeated for want of an answer, is known all the same."""
    receiver = Receiver(0, lambda message: message.id == 2)
    header, *bodies = segments(TO_VEHICLE, 1)
    assert feed(receiver, [header, *bodies]) == [TO_VEHICLE]
    assert feed(receiver, [flipped(header, 20)]) == []
    receiver.replies.clear()
    assert feed(receiver, [bodies[-1]]) == []
    assert list(receiver.replies) == [ack(TO_VEHICLE, Ack.COMPLETE, 1, 3)._replace(arb=receiver.replies[0].arb)]


def test_the_message_that_is_silent_for_longest_makes_room() -> None:
    receiver = Receiver(0, open_max=2)
    first, second, third = (segments(TO_VEHICLE._replace(source=source), 0) for source in (1, 2, 3))
    feed(receiver, [first[0]], 0.0)
    feed(receiver, [second[0]], 0.1)
    feed(receiver, [first[1]], 0.2)
    feed(receiver, [third[0]], 0.3)
    assert feed(receiver, first[2:], 0.4) == [TO_VEHICLE._replace(source=1)]
    assert receiver.errors == {"crowded out": 1}


def test_a_message_for_others_ends_the_one_before_it() -> None:
    receiver = Receiver(0, lambda message: message.id == 1)
    assert feed(receiver, segments(NAVIGATION, 0)[:3] + segments(NAVIGATION._replace(id=9), 1)) == []
    assert receiver.errors == {"superseded": 1}


def test_frames_that_the_controller_repeats_are_received_once() -> None:
    """CAN repeats a frame of which a receiver missed the last bit only: both copies arrive, one after the other."""
    receiver = Receiver(0)
    doubled = [f for frame in segments(NAVIGATION, 0) for f in (frame, frame)]
    assert feed(receiver, doubled) == [NAVIGATION]
    assert receiver.errors == {"duplicate": 4}


def test_a_sender_that_does_not_count_loses_no_more_than_others() -> None:
    """The next header is the same, and is taken for a new one all the same."""
    receiver = Receiver(0)
    assert feed(receiver, segments(NAVIGATION, 0)[:4] + segments(NAVIGATION, 0)) == [NAVIGATION]
    assert receiver.errors == {"superseded": 1}


def test_a_message_does_not_begin_with_segment_31() -> None:
    receiver = Receiver(0)
    header, first = segments(TO_VEHICLE, 0)[:2]
    assert feed(receiver, [header, first._replace(arb=first.arb | 31 << 3)]) == []
    assert receiver.errors == {"out of order": 1}


@pytest.mark.parametrize("data", [b"", bytes(7), bytes(9)])
@pytest.mark.parametrize("message", [NAVIGATION, TO_VEHICLE])
def test_a_body_of_a_wrong_length_drops_the_message_at_once(message: Message, data: bytes) -> None:
    receiver = Receiver(0)
    header, first = segments(message, 0)[:2]
    assert feed(receiver, [header, first._replace(data=data)]) == []
    assert receiver.errors == {"wrong length": 1}
    assert [reply.data[0] for reply in receiver.replies] == ([0, 3] if message is TO_VEHICLE else [])


def test_swapped_bodies_are_never_delivered() -> None:
    for i, j in itertools.combinations(range(1, 6), 2):
        frames = segments(NAVIGATION, 0)
        frames[i], frames[j] = frames[j], frames[i]
        receiver = Receiver(0)
        assert feed(receiver, frames) == []
        assert receiver.errors


@given(st.data())
def test_one_wrong_bit_is_never_delivered(data: st.DataObject) -> None:
    frames = segments(NAVIGATION, 0)
    which = data.draw(st.integers(0, 5))
    frames[which] = flipped(frames[which], data.draw(st.integers(0, 8 * len(frames[which].data) - 1)))
    assert feed(Receiver(0), frames) == []


def test_32_lost_bodies_in_a_row_show_in_the_crc() -> None:
    """The sequence comes round and sees nothing: that is what the CRC is for."""
    message = NAVIGATION._replace(data=random.Random(1).randbytes(600))
    frames = segments(message, 0)
    receiver = Receiver(0)
    assert feed(receiver, frames[:5] + frames[37:] + segments(message, 1)[1:]) == []
    assert receiver.errors["wrong length"] + receiver.errors["wrong CRC"] + receiver.errors["out of order"] == 1


def test_messages_of_different_senders_and_priorities_interleave() -> None:
    sent = [
        Message(priority, source, 0x7F, 7, random.Random(priority + source).randbytes(90))
        for priority in (1, 2)
        for source in (3, 4, 5)
    ]
    frames = [f for column in zip(*(segments(m, 9) for m in sent), strict=True) for f in column]
    assert feed(Receiver(0), frames) == sent


def test_accept_sees_the_header() -> None:
    seen = []
    receiver = Receiver(0, lambda message: bool(seen.append(message)))  # type: ignore[func-returns-value]
    sent = [NAVIGATION, TO_VEHICLE._replace(id=0, port=300), TO_VEHICLE._replace(id=0, port=4747, address=0xC0A80101)]
    for number, message in enumerate(sent):
        feed(receiver, segments(message, number))
    assert seen == [message._replace(data=b"") for message in sent]
    assert not receiver.replies


@pytest.mark.parametrize(
    ("arb", "data"),
    [
        *((dsor_arb(1, Kind.HEADER, 2, 0, 0), bytes(n)) for n in (0, 1, 2, 3, 5, 7, 9)),
        (dsor_arb(1, Kind.HEADER, 0x7F, 0, 0), bytes(6)),
        (dsor_arb(1, Kind.HEADER, 2, 0, 0), b"\1\0\0\2"),  # a port of node 1 in a frame to node 0
    ],
)
def test_malformed_headers_are_counted_and_not_answered(arb: int, data: bytes) -> None:
    receiver = Receiver(0)
    assert receiver.feed(Frame(arb, data), 0.0) is None
    assert receiver.errors == {"malformed header": 1}
    assert not receiver.replies


# Bounds of the receiver


def test_expire_drops_what_is_silent_and_only_that() -> None:
    receiver = Receiver(0, timeout_s=1.0)
    silent, slow = segments(NAVIGATION, 0), segments(TO_VEHICLE, 0)
    feed(receiver, silent[:-1], 0.0)
    for i, frame in enumerate(slow[:-1]):
        receiver.feed(frame, 0.6 * i)
        receiver.expire(0.6 * i)
    assert receiver.errors == {"timed out": 1}
    assert feed(receiver, silent[-1:], 1.3) == []
    assert feed(receiver, slow[-1:], 1.3) == [TO_VEHICLE]


def test_a_repeated_header_keeps_the_message_open() -> None:
    receiver = Receiver(0)
    header, *bodies = segments(TO_VEHICLE, 0)
    for now_s in (0.0, 0.9):
        feed(receiver, [header], now_s)
    receiver.expire(1.5)
    assert feed(receiver, bodies, 1.5) == [TO_VEHICLE]


def test_the_oldest_of_too_many_messages_makes_room() -> None:
    receiver = Receiver(0, open_max=16)
    sent = [segments(TO_VEHICLE._replace(source=source), 0) for source in range(1, 18)]
    for frames in sent:
        feed(receiver, frames[:2])
    assert receiver.errors == {"crowded out": 1}
    assert receiver.replies[-3] == ack(TO_VEHICLE._replace(source=1), Ack.REFUSED, 0, 0)
    assert len(feed(receiver, [f for frames in sent for f in frames[2:]])) == 16


@pytest.mark.parametrize("whole", [False, True], ids=["headers alone", "complete messages"])
def test_endless_streams_leave_memory_flat(whole: bool) -> None:
    receiver = Receiver(0)

    def flood(start: int, count: int) -> None:
        for i in range(start, start + count):
            frames = segments(Message(i & 0xFF, i >> 8 & 0x3F, 0, i, b"x" * 9), i)
            feed(receiver, frames if whole else frames[:1], 0.0)

    flood(0, 2000)
    tracemalloc.start()
    flood(2000, 4000)
    grown, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert grown < 100_000  # the bound of what is kept, which was replaced meanwhile; 4000 headers would take a megabyte
    assert len(receiver.replies) == 64
    assert receiver.errors["reply lost"] > 4000


any_frame = st.builds(
    Frame,
    st.one_of(
        st.integers(0, 0xFFFFFFFF),
        st.builds(
            dsor_arb,
            st.integers(0, 1),
            st.sampled_from(Kind),
            st.integers(0, 2) | st.just(0x7F),
            st.integers(0, 2) | st.just(0x7F),
            st.integers(0, 3),
        ),
    ),
    st.binary(max_size=8) | st.sampled_from([b"\x09\0\0\0\0\0", b"\0\0\0\0", bytes(8), b"\1\0\1\0", b"\2\0\2\0", b"\3\0\0\0"]),
)


@given(st.lists(any_frame, max_size=60))
def test_no_frame_raises(frames: list[Frame]) -> None:
    receiver, sender = Receiver(0, open_max=2), MessageSender(0, queue_max=4)
    sender.start(Message(1, 0, 1, 1, b"0123456789"), 0.0)
    sender.start(Message(0, 0, 2, 1, b"0123456789"), 0.0)
    for i, frame in enumerate(frames):
        receiver.feed(frame, 0.1 * i)
        receiver.expire(0.1 * i)
        sender.feed(frame, 0.1 * i)
        sender.poll(0.1 * i)
    assert len(receiver.replies) <= 64
    assert set(receiver.errors) <= set(REASONS)
    sender.poll(1000.0)
    for i in range(6):
        sender.poll(1001.0 + i)
    assert sender.next_due_s == float("inf")
    assert len(sender.outcomes) == 2


REASONS = [
    "crowded out",
    "duplicate",
    "header lost",
    "malformed header",
    "out of order",
    "reply lost",
    "superseded",
    "timed out",
    "wrong CRC",
    "wrong length",
]


# Sender and receiver


def exchange(sender: MessageSender, receiver: Receiver, frames: list[Frame], now_s: float = 0.0) -> list[Message]:
    """A perfect bus: until nobody has anything to say."""
    got = []
    while frames:
        got += feed(receiver, frames, now_s)
        replies = list(receiver.replies)
        receiver.replies.clear()
        frames = [f for reply in replies for f in sender.feed(reply, now_s)]
    return got


@given(messages(node))
def test_addressed_round_trip(message: Message) -> None:
    sender, receiver = MessageSender(message.source), Receiver(message.destination)
    assert exchange(sender, receiver, sender.start(message, 0.0)) == [message]
    assert list(sender.outcomes) == [Outcome(message)]
    assert sender.next_due_s == float("inf")
    assert not receiver.errors


@pytest.mark.parametrize("length", [0, 4, 5, 65535])
def test_addressed_lengths(length: int) -> None:
    message = TO_VEHICLE._replace(data=random.Random(length).randbytes(length))
    sender, receiver = MessageSender(message.source), Receiver(message.destination)
    assert exchange(sender, receiver, sender.start(message, 0.0)) == [message]


def test_one_frame_at_a_time() -> None:
    sender, receiver = MessageSender(Node.GPS), Receiver(Node.VEHICLE)
    frames = sender.start(TO_VEHICLE, 0.0)
    sent = []
    while frames:
        assert len(frames) == 1
        sent += frames
        feed(receiver, frames)
        assert len(receiver.replies) == 1
        reply = receiver.replies.popleft()
        fields = dsor_fields(reply.arb)
        assert fields[:4] == (0x80, Kind.ACK, Node.VEHICLE, Node.GPS)
        assert fields.sequence == dsor_fields(frames[0].arb).sequence
        frames = sender.feed(reply, 0.0)
    assert sent == segments(TO_VEHICLE, 1)


def test_silence_is_told_after_five_retransmissions() -> None:
    sender = MessageSender(Node.GPS)
    first = sender.start(TO_VEHICLE, 10.0)
    assert sender.next_due_s == pytest.approx(10.1)
    assert sender.poll(10.05) == []
    for i in range(1, 6):
        assert sender.poll(10.0 + 0.11 * i) == first
    assert not sender.outcomes
    assert sender.poll(11.0) == []
    assert list(sender.outcomes) == [Outcome(TO_VEHICLE, "node 0x00 did not acknowledge the header")]
    assert sender.next_due_s == float("inf")


def test_the_message_behind_a_failed_one_is_sent() -> None:
    sender, receiver = MessageSender(Node.GPS, retransmit_max=0), Receiver(Node.VEHICLE)
    behind = TO_VEHICLE._replace(id=3)
    sender.start(TO_VEHICLE, 0.0)
    assert sender.start(behind, 0.0) == []
    assert exchange(sender, receiver, sender.poll(1.0), 1.0) == [behind]
    assert [o.failure == "" for o in sender.outcomes] == [False, True]


def test_a_dead_node_does_not_hold_up_another() -> None:
    sender, receiver = MessageSender(Node.GPS), Receiver(Node.VEHICLE)
    sender.start(TO_VEHICLE._replace(destination=9), 0.0)
    assert exchange(sender, receiver, sender.start(TO_VEHICLE, 0.0)) == [TO_VEHICLE]


def test_every_first_copy_lost() -> None:
    sender, receiver = MessageSender(Node.GPS), Receiver(Node.VEHICLE)
    sender.start(TO_VEHICLE, 0.0)
    got, now_s = [], 0.0
    while sender.next_due_s < float("inf"):
        now_s += 0.1
        got += feed(receiver, sender.poll(now_s), now_s)
        while receiver.replies:
            sender.feed(receiver.replies.popleft(), now_s)
    assert got == [TO_VEHICLE]
    assert list(sender.outcomes) == [Outcome(TO_VEHICLE)]


def test_every_first_acknowledgement_lost() -> None:
    sender, receiver = MessageSender(Node.GPS), Receiver(Node.VEHICLE)
    got, now_s, frames = [], 0.0, sender.start(TO_VEHICLE, 0.0)
    while sender.next_due_s < float("inf"):
        now_s += 0.1
        got += feed(receiver, frames, now_s)
        receiver.replies.clear()
        got += feed(receiver, sender.poll(now_s), now_s)
        frames = [f for reply in receiver.replies for f in sender.feed(reply, now_s)]
        receiver.replies.clear()
    assert got == [TO_VEHICLE]
    assert list(sender.outcomes) == [Outcome(TO_VEHICLE)]
    assert receiver.errors == {"duplicate": 3}  # of the header too, which is no error


def test_a_corrupt_message_is_sent_again_and_then_given_up() -> None:
    sender, receiver = MessageSender(Node.GPS), Receiver(Node.VEHICLE)
    frames = sender.start(TO_VEHICLE, 0.0)
    while frames:
        feed(receiver, [flipped(f, 3) if dsor_fields(f.arb).kind == Kind.BODY else f for f in frames])
        frames = sender.feed(receiver.replies.popleft(), 0.0)
    assert receiver.errors == {"wrong CRC": 3}
    assert list(sender.outcomes) == [Outcome(TO_VEHICLE, "node 0x00 refused the message 3 times")]


def test_a_corrupt_header_is_told_by_the_end() -> None:
    """The receiver waits for more than the sender has, or for less: both start again."""
    for bit in (0, 4, 9):
        sender, receiver = MessageSender(Node.GPS), Receiver(Node.VEHICLE)
        (header,) = sender.start(TO_VEHICLE, 0.0)
        assert exchange(sender, receiver, [flipped(header, bit)]) == [TO_VEHICLE]
        assert list(sender.outcomes) == [Outcome(TO_VEHICLE)]


def test_a_late_header_neither_restarts_nor_delivers_again() -> None:
    receiver = Receiver(Node.VEHICLE)
    header, *bodies = segments(TO_VEHICLE, 1)
    assert feed(receiver, [header, bodies[0], header, bodies[1], header, bodies[2], header, *bodies, header]) == [TO_VEHICLE]
    kinds = [(reply.data[0], reply.data[2]) for reply in receiver.replies]
    assert kinds[:7] == [(0, 0), (1, 1), (0, 1), (1, 2), (0, 2), (2, 3), (2, 3)]
    assert kinds[7:] == [(2, 3), (2, 3)]


def test_a_sender_that_was_switched_off_is_not_taken_for_its_past() -> None:
    """Same number, same header, other content: the receiver thinks of a repetition, the sender knows better."""
    receiver = Receiver(Node.VEHICLE)
    for data in (b"before", b"after!"):
        sender = MessageSender(Node.GPS)
        message = TO_VEHICLE._replace(data=data)
        assert exchange(sender, receiver, sender.start(message, 0.0)) == [message]
        assert list(sender.outcomes) == [Outcome(message)]


@pytest.mark.parametrize("others", range(1, 40))
def test_numbers_that_come_round_between_two_messages_lose_neither(others: int) -> None:
    sender, receiver = MessageSender(Node.GPS), Receiver(Node.VEHICLE)
    sent = [TO_VEHICLE._replace(id=i) for i in range(4)]
    got = []
    for message in sent:
        got += exchange(sender, receiver, sender.start(message, 0.0))
        for _ in range(others):
            sender.start(TO_VEHICLE._replace(destination=Node.BROADCAST), 0.0)
    assert got == sent
    assert list(sender.outcomes) == [Outcome(message) for message in sent]


def test_a_late_acknowledgement_does_not_end_the_message_of_31_others_later() -> None:
    """Numbers are of 5 bits. A node that counted all of its messages together gave the next one of a stream the number of the
    last one again after 31 others: it took the late copy of an acknowledgement for that of a message that was lost."""
    sender, receiver = MessageSender(Node.GPS), Receiver(Node.VEHICLE)
    message = TO_VEHICLE._replace(data=b"")
    assert exchange(sender, receiver, sender.start(message, 0.0)) == [message]
    late = ack(message, Ack.COMPLETE, 1, 1)
    for priority in range(31):
        sender.start(message._replace(priority=priority + 1), 0.0)
    sender.outcomes.clear()
    (header,) = sender.start(message, 0.0)
    number = dsor_fields(header.arb).sequence
    assert sender.feed(ack(message, Ack.HEADER, number, 0), 0.0)  # its only segment, which is lost
    assert sender.feed(late, 0.0) == []
    assert not sender.outcomes


def test_a_message_half_sent_before_switching_off_is_not_mixed_with_the_next() -> None:
    receiver = Receiver(Node.VEHICLE)
    feed(receiver, segments(TO_VEHICLE._replace(data=b"before the restart"), 1)[:2])
    receiver.replies.clear()
    sender = MessageSender(Node.GPS)
    message = TO_VEHICLE._replace(data=b"after this restart")
    assert exchange(sender, receiver, sender.start(message, 0.0)) == [message]
    assert list(sender.outcomes) == [Outcome(message)]
    assert receiver.errors == {"wrong CRC": 1}


def test_acknowledgements_of_other_messages_move_nothing() -> None:
    sender = MessageSender(Node.GPS)
    sender.start(TO_VEHICLE, 0.0)
    for frame in (
        ack(TO_VEHICLE, Ack.HEADER, 2, 0),  # other message
        ack(TO_VEHICLE, Ack.HEADER, 1, 3),  # there are segments 0..2
        ack(TO_VEHICLE, Ack.BODY, 1, 0),
        ack(TO_VEHICLE, Ack.BODY, 1, 1),  # segment 0 was not sent yet
        ack(TO_VEHICLE, Ack.REFUSED, 1, 0),
        ack(TO_VEHICLE, 9, 1, 0),
        ack(TO_VEHICLE._replace(priority=1), Ack.HEADER, 1, 0),
        ack(TO_VEHICLE, Ack.HEADER, 1, 0)._replace(data=b"\0\1\0"),
    ):
        assert sender.feed(frame, 0.0) == []
    assert sender.feed(ack(TO_VEHICLE, Ack.HEADER, 1, 0), 0.0) == segments(TO_VEHICLE, 1)[1:2]
    assert sender.feed(ack(TO_VEHICLE, Ack.COMPLETE, 1, 3), 0.0) == []
    assert not sender.outcomes


def test_late_acknowledgements_do_not_send_a_segment_again() -> None:
    sender = MessageSender(Node.GPS)
    header, *bodies = segments(TO_VEHICLE, 1)
    assert sender.start(TO_VEHICLE, 0.0) == [header]
    assert sender.feed(ack(TO_VEHICLE, Ack.HEADER, 1, 0), 0.0) == bodies[:1]
    assert sender.feed(ack(TO_VEHICLE, Ack.BODY, 1, 1), 0.0) == bodies[1:2]
    assert sender.feed(ack(TO_VEHICLE, Ack.BODY, 1, 1), 0.0) == []
    assert sender.feed(ack(TO_VEHICLE, Ack.HEADER, 1, 0), 0.0) == []
    assert sender.feed(ack(TO_VEHICLE, Ack.BODY, 1, 2), 0.0) == bodies[2:3]
    assert sender.feed(ack(TO_VEHICLE, Ack.BODY, 1, 3), 0.0) == [header]  # the receiver awaits more than there is
    assert sender.feed(ack(TO_VEHICLE, Ack.COMPLETE, 1, 0), 0.0) == []  # can't be old: it was acknowledged before
    assert sender.feed(ack(TO_VEHICLE, Ack.COMPLETE, 1, 3), 0.0) == []
    assert list(sender.outcomes) == [Outcome(TO_VEHICLE)]


def test_the_sender_refuses_what_it_cannot_send() -> None:
    sender = MessageSender(Node.GPS, queue_max=2)
    with pytest.raises(FormatError, match="does not send messages of node"):
        sender.start(NAVIGATION, 0.0)
    sender.start(TO_VEHICLE, 0.0)
    sender.start(TO_VEHICLE, 0.0)
    with pytest.raises(Refused, match="2 messages are already waiting"):
        sender.start(TO_VEHICLE, 0.0)


def test_broadcast_by_a_sender_is_sent_whole_with_consecutive_numbers() -> None:
    sender = MessageSender(Node.NAVIGATION)
    numbers = []
    for _ in range(40):
        frames = sender.start(NAVIGATION, 0.0)
        assert feed(Receiver(0), frames) == [NAVIGATION]
        numbers.append(dsor_fields(frames[0].arb).sequence)
    assert numbers == [i % 32 for i in range(1, 41)]
    assert sender.next_due_s == float("inf")


def test_two_receivers_of_one_node_do_not_answer_for_each_other() -> None:
    first, second = Receiver(0, lambda m: m.id == 1), Receiver(0, lambda m: m.id == 2)
    sender = MessageSender(Node.GPS)
    sent = [TO_VEHICLE._replace(id=i % 2 + 1, data=bytes([i]) * i) for i in range(30)]
    frames = [f for message in sent for f in sender.start(message, 0.0)]
    got = []
    while frames:
        got += feed(first, frames) + feed(second, frames)
        replies = [*first.replies, *second.replies]
        assert len(replies) == 1
        first.replies.clear()
        second.replies.clear()
        frames = sender.feed(replies[0], 0.0)
    assert got == sent
    assert not first.errors + second.errors


# A bad bus


class BadBus:
    """Loses, doubles, delays and corrupts frames; each with its probability. Delay reorders."""

    def __init__(self, seed: int, lost: float, doubled: float, delayed: float, corrupted: float) -> None:
        self.random = random.Random(seed)
        self.lost, self.doubled, self.delayed, self.corrupted = lost, doubled, delayed, corrupted
        self.under_way: list[tuple[float, int, Frame]] = []
        self.count = itertools.count()

    def send(self, frames: Iterable[Frame], now_s: float) -> None:
        for frame in frames:
            for _ in range(2 if self.random.random() < self.doubled else 1):
                if self.random.random() >= self.lost:
                    delay_s = 0.0005 + (self.random.random() * 0.05 if self.random.random() < self.delayed else 0.0)
                    heapq.heappush(self.under_way, (now_s + delay_s, next(self.count), self.worn(frame)))

    def worn(self, frame: Frame) -> Frame:
        if self.random.random() >= self.corrupted:
            return frame
        bit = self.random.randrange(29 + 8 * len(frame.data))
        return frame._replace(arb=frame.arb ^ 8 << bit) if bit < 29 else flipped(frame, bit - 29)

    def arrived(self, now_s: float) -> list[Frame]:
        frames = []
        while self.under_way and self.under_way[0][0] <= now_s:
            frames.append(heapq.heappop(self.under_way)[2])
        return frames


def converse(bus: BadBus, senders: list[MessageSender], receiver: Receiver, clock: ManualClock) -> list[Message]:
    """Until every sender knows how each of its messages ended and the bus is empty."""
    got: list[Message] = []
    while bus.under_way or any(sender.next_due_s < float("inf") for sender in senders):
        due_s = min([sender.next_due_s for sender in senders] + [entry[0] for entry in bus.under_way[:1]])
        clock.advance(max(0.0001, due_s - clock.monotonic_s()))
        now_s = clock.monotonic_s()
        assert now_s < 600.0, "the conversation does not end"
        for frame in bus.arrived(now_s):
            if (message := receiver.feed(frame, now_s)) is not None:
                got.append(message)
            for sender in senders:
                bus.send(sender.feed(frame, now_s), now_s)
        bus.send(receiver.replies, now_s)
        receiver.replies.clear()
        receiver.expire(now_s)
        for sender in senders:
            bus.send(sender.poll(now_s), now_s)
    return got


@pytest.mark.parametrize("seed", range(24))
@pytest.mark.parametrize(
    ("lost", "doubled", "delayed", "corrupted"),
    [(0.1, 0.0, 0.0, 0.0), (0.0, 0.3, 0.3, 0.0), (0.0, 0.0, 0.0, 0.02), (0.1, 0.1, 0.1, 0.01), (0.4, 0.2, 0.2, 0.05)],
    ids=["lost", "doubled and delayed", "corrupted", "all", "hopeless"],
)
def test_once_and_intact_or_told(seed: int, lost: float, doubled: float, delayed: float, corrupted: float) -> None:
    chance = random.Random(seed)
    bus, clock, receiver = BadBus(seed, lost, doubled, delayed, corrupted), ManualClock(), Receiver(0)
    senders = [MessageSender(1), MessageSender(2)]
    sent = []
    for i in range(16):
        message = Message(0x40 + i % 3, 1 + i % 2, 0, i, chance.randbytes(chance.choice([0, 1, 4, 5, 20, 90])))
        sent.append(message)
        bus.send(senders[i % 2].start(message, 0.0), 0.0)
    got = converse(bus, senders, receiver, clock)
    outcomes = [outcome for sender in senders for outcome in sender.outcomes]
    assert sorted(o.message for o in outcomes) == sorted(sent)  # each is told, once
    assert max(Counter(got).values(), default=1) == 1  # none arrives twice
    assert set(got) <= set(sent)  # and none that was not sent so
    assert {o.message for o in outcomes if not o.failure} <= set(got)  # what is said to be there is there
    if lost == 0.1 and not corrupted:
        assert len(got) == len(sent)  # five retransmissions cope with a tenth of the frames lost
