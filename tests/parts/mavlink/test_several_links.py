"""Frames of one speaker that come by several links: each is taken once, in any order, for as long as it may be on the way."""

import random

from hypothesis import given
from hypothesis import strategies as st

from delfim.base.clock import ManualClock
from delfim.parts.mavlink.codec import wire
from delfim.parts.mavlink.codec.signing import OVERTAKEN_S, Signing
from delfim.parts.mavlink.codec.wire import dialect
from delfim.parts.mavlink.sequences import SOURCES, Sequences

KEY = bytes(range(32))
NOW_NS = 1_800_000_000_000_000_000


def frames(count: int, every_s: float) -> list[bytes]:
    """So many of one console, signed so far apart."""
    clock = ManualClock(time_ns=NOW_NS)
    sender = wire.Sender(250, 190, KEY, Signing(KEY, clock).stamp, link=7)
    made = []
    for _ in range(count):
        clock.advance(every_s)
        made.append(sender.pack(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)))
    return made


@given(st.integers(0, 1000), st.integers(1, 60))
def test_each_frame_is_taken_once_in_any_order(seed: int, count: int) -> None:
    sent = frames(count, OVERTAKEN_S / 100)
    order = [*sent[1:], *sent[1:]]
    random.Random(seed).shuffle(order)
    boat = Signing(KEY, ManualClock(time_ns=NOW_NS))
    assert boat.judge(sent[0], "first").fault == ""
    taken = [frame for frame in order if not boat.judge(frame, "way").fault]
    assert sorted(taken) == sorted(sent[1:])
    assert all(boat.judge(frame, "another way").fault == "replayed" for frame in sent)


def test_a_frame_that_was_overtaken_long_ago_is_not_taken() -> None:
    first, held, *others = frames(50, OVERTAKEN_S / 10)
    boat = Signing(KEY, ManualClock(time_ns=NOW_NS))
    assert [boat.judge(each).fault for each in (first, *others)] == [""] * 49
    assert boat.judge(held).fault == "replayed"


def test_after_a_restart_nothing_that_was_signed_before_the_last_frame_is_taken() -> None:
    first, held, last, fresh = frames(4, 0.1)
    boat = Signing(KEY, ManualClock(time_ns=NOW_NS))
    assert [boat.judge(each).fault for each in (first, last)] == ["", ""]
    again = Signing(KEY, ManualClock(time_ns=NOW_NS), boat.kept())
    assert [again.judge(each).fault for each in (held, last, fresh)] == ["replayed", "replayed", ""]


def test_what_is_known_of_a_speaker_is_bounded() -> None:
    boat = Signing(KEY, ManualClock(time_ns=NOW_NS))
    for frame in frames(3000, 1e-5):
        assert boat.judge(frame).fault == ""
    (recent,) = boat._recent.values()
    assert len(recent._came) == len(recent._order) == 1024
    sequences = Sequences()
    for number in range(1000):
        assert not sequences.is_overtaken(wire.Speaker(250, 190, number), 7)
    assert len(sequences._ordered) == SOURCES


def test_an_older_order_is_overtaken_and_one_of_a_clock_set_back_is_not() -> None:
    sequences, source = Sequences(), wire.Speaker(250, 190, 7)
    assert [sequences.is_overtaken(source, stamp) for stamp in (1_000_000, 999_999, 1_000_000, 1_000_001)] == [
        False,
        True,
        False,
        False,
    ]
    assert not sequences.is_overtaken(source, 100), "days before"
    assert not sequences.is_overtaken(source, 101)
