"""The socketcand protocol without a socket, and the broadcast manager in user space."""

from itertools import pairwise
from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.errors import FormatError
from delfim.base.frames import Frame, extended, standard
from delfim.canproxy import socketcand
from delfim.canproxy.cantcp import bcm
from delfim.canproxy.cantcp.bcm import JOBS_MAX, Cycles, Subscription
from delfim.canproxy.socketcand import (
    ELEMENT_BYTES,
    Cycle,
    Delete,
    Enter,
    Hangup,
    Open,
    Reply,
    SocketcandSession,
    Subscribe,
    TellTraffic,
    Transmit,
    Unsubscribe,
    Update,
    bcm_text,
    parse_frame,
    raw_text,
    send_text,
)

frames = st.builds(
    Frame,
    st.integers(0, 0x7FF).map(standard) | st.integers(0, 0x1FFFFFFF).map(extended),
    st.binary(max_size=8),
    st.integers(0, 2**62).map(lambda t_ns: t_ns // 1000 * 1000),
    st.just(0),
    st.just(False),
)


def session(mode: str = "bcm") -> SocketcandSession:
    one = SocketcandSession(["can0", "vcan1"])
    list(one.feed(b"< open can0 >" if mode == "bcm" else f"< open can0 >< {mode}mode >".encode()))
    assert one.mode == mode
    return one


@pytest.mark.parametrize(
    ("text", "actions"),
    [
        ("< open can0 >", [Open("can0")]),
        ("< open can0 >< rawmode >", [Open("can0"), Enter("raw")]),
        ("< open can7 >", [Hangup(socketcand.NO_SUCH_BUS)]),
        ("< rawmode >", [Hangup(socketcand.NO_SUCH_BUS)]),
        ("< echo >", [Hangup(socketcand.NO_SUCH_BUS)]),
        ("< can0 B 500000 875 25 37 32 20 40 1 >", [Reply(socketcand.UNKNOWN)]),
        ("< can0 C 1 0 0 >< open vcan1 >", [Reply(socketcand.UNKNOWN), Open("vcan1")]),
        ("< open can7 >< open can0 >", [Hangup(socketcand.NO_SUCH_BUS)]),
        ("<>", []),
    ],
)
def test_a_connection_begins_without_a_bus(text: str, actions: list[object]) -> None:
    assert list(SocketcandSession(["can0", "vcan1"]).feed(text.encode())) == actions


@pytest.mark.parametrize(
    ("mode", "text", "action"),
    [
        ("raw", "< send 123 0 >", Transmit(standard(0x123), b"")),
        ("raw", "< send 00000123 2 a FF >", Transmit(extended(0x123), b"\x0a\xff")),
        ("raw", "< send 12 1 00 >", Transmit(standard(0x12), b"\0")),
        ("raw", "< echo >", Reply(b"< echo >")),
        ("raw", "< bcmmode >", Enter("bcm")),
        ("raw", "< controlmode >", Enter("control")),
        ("raw", "< rawmode >", Reply(socketcand.UNKNOWN)),
        ("raw", "< isotpmode >", Reply(socketcand.UNKNOWN)),
        ("raw", "< subscribe 0 0 123 >", Reply(socketcand.UNKNOWN)),
        ("bcm", "< send 7FF 8 1 2 3 4 5 6 7 8 >", Transmit(standard(0x7FF), bytes(range(1, 9)))),
        ("bcm", "< add 1 500000 123 2 AB CD >", Cycle(standard(0x123), b"\xab\xcd", 1.5)),
        ("bcm", "< add 0 0 123 0 >", Cycle(standard(0x123), b"", 0.001)),
        ("bcm", "< update 123 1 EE >", Update(standard(0x123), b"\xee")),
        ("bcm", "< delete 123 >", Delete(standard(0x123))),
        ("bcm", "< subscribe 0 500000 123 >", Subscribe(standard(0x123), 0.5)),
        ("bcm", "< unsubscribe 00000123 >", Unsubscribe(extended(0x123))),
        ("bcm", "< filter 0 0 123 2 FF 0F >", Subscribe(standard(0x123), 0.0, (0xFF0F << 48,))),
        (
            "bcm",
            "< muxfilter 2 0 123 2 FF 00 00 00 00 00 00 00 01 FF 00 00 00 00 00 00 >",
            Subscribe(standard(0x123), 2.0, (0xFF << 56, 0x01FF << 48)),
        ),
        ("control", "< statistics 500 >", TellTraffic(0.5)),
        ("control", "< statistics 0 >", TellTraffic(0.0)),
        ("control", "< send 123 0 >", Reply(socketcand.UNKNOWN)),
    ],
)
def test_commands(mode: str, text: str, action: object) -> None:
    assert list(session(mode).feed(text.encode())) == [action]


@pytest.mark.parametrize(
    "text",
    [
        "< send >",
        "< send 123 >",
        "< send 123 9 1 2 3 4 5 6 7 8 9 >",
        "< send 123 1 >",  # what python-can makes of a remote frame
        "< send 123 1 1 2 >",
        "< send 800 0 >",
        "< send xyz 0 >",
        "< send 1_2 0 >",
        "< send -1 0 >",
        "< send 123 -1 >",
        "< send 123 1 GG >",
        "< send \xff 0 >",
        "< add 1 123 0 >",
        "< add 1 x 123 0 >",
        "< delete >",
        "< delete 1 2 >",
        "< subscribe 0 0 >",
        "< subscribe 0 123456789012345678901 123 >",
        "< filter 0 0 123 1 >",
        "< muxfilter 0 0 123 1 00 00 00 00 00 00 00 00 >",
        "< muxfilter 0 0 123 2 00 >",
        "<>",
        ">",
        "no element >",
    ],
)
def test_what_is_malformed_gets_no_answer_and_is_counted(text: str) -> None:
    one = session()
    assert list(one.feed(text.encode("latin-1"))) == []
    assert one.malformed == 1


@pytest.mark.parametrize("digits", [8, 16])
def test_savvycan_sends_signed_numbers_as_wide_as_they_get(digits: int) -> None:
    """QString::number(int, 16) of a signed char, and of an identifier with bit 31 set."""
    wide = "f" * (digits - 2)
    identifier = "92345678".rjust(digits, "f")
    text = f"< send {identifier} 3 {wide}80 7f {wide}ff >"
    assert list(session("raw").feed(text.encode())) == [Transmit(extended(0x12345678), b"\x80\x7f\xff")]


def test_elements_come_split_merged_with_newlines_and_blanks() -> None:
    one = SocketcandSession(["can0"])
    assert list(one.feed(b"< open can0 >\n< rawmode >\n<  send   123 1 11  ><echo>\r\n< se")) == [
        Open("can0"),
        Enter("raw"),
        Transmit(standard(0x123), b"\x11"),
        Reply(socketcand.ECHO),
    ]
    assert list(one.feed(b"nd 12345678 0  >")) == [Transmit(extended(0x12345678), b"")]
    assert one.malformed == 0


def test_an_element_without_end_is_thrown_away_and_the_next_one_counts() -> None:
    one = session("raw")
    for _ in range(100):
        assert list(one.feed(b"< send " + b"0" * 500)) == []
    assert one.malformed >= 100 * 507 // (ELEMENT_BYTES + 507) - 1
    assert list(one.feed(b"< rubbish < echo >")) == [Reply(socketcand.ECHO)]


names = ["open", "can0", "rawmode", "bcmmode", "controlmode", "isotpmode", "echo", "send", "add", "update", "delete"]
names += ["subscribe", "unsubscribe", "filter", "muxfilter", "statistics"]
tokens = st.sampled_from([*names, *"012899", "123", "7FF", "800", "12345678", "ffffffffffffff80", "FF", "zz", "-1", "1_0"])
elements = st.lists(tokens, max_size=12).map(lambda words: f"< {' '.join(words)} >".encode())


@given(st.lists(st.binary(max_size=600) | elements, max_size=30), st.booleans())
def test_no_input_is_an_exception_and_none_is_kept_for_long(pieces: list[bytes], is_open: bool) -> None:
    one = session() if is_open else SocketcandSession(["can0"])
    for piece in pieces:
        for action in one.feed(piece):
            if isinstance(action, Transmit | Cycle | Update):
                assert len(action.data) <= 8
            if isinstance(action, Cycle):
                assert 0.001 <= action.interval_s <= 86_400
        assert len(one._splitter._rest) <= ELEMENT_BYTES


@given(st.lists(elements, max_size=20), st.data())
def test_where_the_stream_is_cut_does_not_matter(pieces: list[bytes], data: st.DataObject) -> None:
    stream = b"< open can0 >" + b"".join(pieces)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=10)))
    parts = [stream[start:end] for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    whole, cut = SocketcandSession(["can0"]), SocketcandSession(["can0"])
    assert list(whole.feed(stream)) == [action for part in parts for action in cut.feed(part)]


def test_texts_are_those_of_the_reference_server() -> None:
    frame = Frame(standard(0x12), b"\x1a\x22\x03", 1_262_304_000_000_123_999)
    assert raw_text(frame) == b"< frame 012 1262304000.000123 1A2203 >"
    assert bcm_text(frame) == b"< frame 012 1262304000.000123 1A 22 03  >"
    empty = Frame(extended(0x12345), b"", 1_000_000_000)
    assert raw_text(empty) == b"< frame 00012345 1.000000  >"
    assert bcm_text(empty) == b"< frame 00012345 1.000000  >"


@given(frames)
def test_text_there_and_back(frame: Frame) -> None:
    for text in (raw_text(frame), bcm_text(frame)):
        assert parse_frame(text.decode()[1:-1].split()) == frame
    (action,) = session("raw").feed(send_text(frame.arb, frame.data))
    assert action == Transmit(frame.arb, frame.data)


@pytest.mark.parametrize("text", ["frame", "frame 123", "frame 123 x 00", "frame 123 1.0 0", "frame 123 1.0 " + "00" * 9])
def test_what_a_server_says_is_read_with_suspicion(text: str) -> None:
    with pytest.raises(FormatError, match="not a frame"):
        parse_frame(text.split())
    assert parse_frame(["ok"]) is None


# The broadcast manager.


def test_a_subscription_tells_the_newest_late_rather_than_never() -> None:
    watch = Subscription(1.0, ())
    assert watch.offer(b"1", b"", 10.0) == b"1"
    assert watch.offer(b"2", b"", 10.1) is None
    assert watch.offer(b"3", b"", 10.9) is None
    assert watch.due_s == 11.0
    assert list(watch.take(10.99)) == []
    assert list(watch.take(11.0)) == [b"3"]
    assert watch.due_s == inf
    assert watch.offer(b"4", b"", 11.5) is None
    assert watch.offer(b"5", b"", 12.0) == b"5"
    assert watch.due_s == inf  # what waited is outdated


def test_a_subscription_without_interval_tells_all() -> None:
    watch = Subscription(0.0, ())
    assert [watch.offer(text, b"", 1.0) for text in (b"1", b"2", b"3")] == [b"1", b"2", b"3"]


def test_a_filter_tells_changes_under_its_mask() -> None:
    watch = Subscription(0.0, (0xF0 << 56,))
    assert watch.offer(b"first", b"\x10", 1.0) == b"first"
    assert watch.offer(b"same", b"\x1f\xff", 2.0) is None
    assert watch.offer(b"changed", b"\x20", 3.0) == b"changed"
    assert watch.offer(b"shorter", b"", 4.0) == b"shorter"


def test_a_muxfilter_keeps_the_rows_apart() -> None:
    watch = Subscription(0.0, (0xFF << 56, 0x01FF << 48, 0x02FF << 48))
    assert watch.offer(b"1a", b"\x01\x10", 1.0) == b"1a"
    assert watch.offer(b"2a", b"\x02\x10", 1.0) == b"2a"
    assert watch.offer(b"1a", b"\x01\x10", 1.0) is None
    assert watch.offer(b"2b", b"\x02\x11", 1.0) == b"2b"
    assert watch.offer(b"3", b"\x03\x10", 1.0) is None


@given(st.floats(0.0, 5.0), st.lists(st.tuples(st.floats(0.0, 3.0), st.binary(max_size=2)), max_size=50))
def test_the_last_frame_is_always_told_and_never_too_often(interval_s: float, steps: list[tuple[float, bytes]]) -> None:
    watch, now_s, told = Subscription(interval_s, ()), 0.0, []
    for number, (step_s, data) in enumerate(steps):
        now_s += step_s
        if watch.due_s <= now_s:
            due_s = max(watch.due_s, now_s - step_s)
            told += [(due_s, text) for text in watch.take(due_s + 1e-9)]
        if text := watch.offer(b"%d" % number, data, now_s):
            told.append((now_s, text))
    if watch.due_s < inf:
        told += [(watch.due_s, text) for text in watch.take(watch.due_s + 1e-9)]
    if steps:
        assert told[-1][1] == b"%d" % (len(steps) - 1)
    times_s = [at_s for at_s, _ in told]
    assert all(later - sooner >= interval_s - 1e-6 for sooner, later in pairwise(times_s))


def test_cycles() -> None:
    cycles = Cycles()
    assert cycles.due_s == inf
    assert cycles.add(1, b"a", 0.5, 10.0)
    assert cycles.add(2, b"b", 1.0, 10.0)
    assert list(cycles.take(10.0, 32)) == [(1, b"a"), (2, b"b")]
    assert cycles.due_s == 10.5
    cycles.update(1, b"c")
    cycles.update(3, b"nothing")
    assert list(cycles.take(11.0, 32)) == [(1, b"c"), (2, b"b")]
    assert list(cycles.take(15.2, 32)) == [(1, b"c"), (2, b"b")]  # once, however late
    cycles.delete(1)
    assert list(cycles.take(20.0, 32)) == [(2, b"b")]
    assert cycles.add(2, b"d", 1.0, 20.5)
    assert list(cycles.take(20.5, 32)) == [(2, b"d")]
    assert list(cycles.take(21.2, 32)) == []  # the cycle that was replaced is over
    cycles.clear()
    assert cycles.due_s == inf


def test_cycles_are_bounded() -> None:
    cycles = Cycles()
    assert all(cycles.add(arb, b"", 1.0, 0.0) for arb in range(JOBS_MAX))
    assert not cycles.add(JOBS_MAX, b"", 1.0, 0.0)
    for _ in range(10 * JOBS_MAX):
        assert cycles.add(7, b"", 1.0, 0.0)
    assert len(cycles._due) <= 4 * bcm.JOBS_MAX
    assert len(list(cycles.take(0.0, 1000))) == JOBS_MAX == len(cycles)
    assert list(cycles.take(0.0, 0)) == []
