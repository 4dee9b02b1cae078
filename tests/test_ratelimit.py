"""How much a line may say in a second: any flood in any pieces leaves whole sentences, and all of it is accounted for."""

import math
from itertools import cycle

from hypothesis import given
from hypothesis import strategies as st

from delfim.base.clock import ManualClock
from delfim.base.input.ratelimit import BURST_S, LONGEST, PIECE_BYTES, UNREAD_BYTES, Allowance
from delfim.lines.nmea0183.framing import Sentences


def flood(count: int) -> bytes:
    """Sentences without checksums, of several lengths: any two halves would make a third one."""
    return b"".join(
        b"$GPHDT,%d,T\r\n" % (each * 7919 % 360) + b"$HEHDT,%d.%d,T\r\n" % (each % 360, each) for each in range(count)
    )


@given(
    rate=st.integers(1, 12_000),
    sizes=st.lists(st.integers(5, PIECE_BYTES), min_size=1, max_size=30),
    waits_s=st.lists(st.sampled_from((0.0, 0.0, 0.0, 0.001, 0.01, 0.1, 1.0)), min_size=1, max_size=30),
)
def test_what_is_left_of_a_flood_is_whole_sentences_and_the_rest_is_counted(rate, sizes, waits_s):
    said, clock, line = flood(100), ManualClock(), Sentences(needs_checksum=False)
    truth = iter([float(text.split(b",")[1]) for text in said.splitlines()])
    allowance, at, kept, heard = Allowance(rate, clock.monotonic_s), 0, 0, list[float]()
    for size, wait_s in zip(cycle(sizes), cycle(waits_s), strict=False):
        clock.advance(wait_s)
        data = said[at : at + allowance.at_once(size)]
        if not data:
            break
        at += len(data)
        used = allowance.of(data)
        assert data.endswith(used)
        kept += len(used)
        heard += [math.degrees(one.message.true_rad or 0.0) for one in line.feed(used)]
    assert kept + allowance.bytes == len(said)
    assert kept <= rate * (BURST_S + clock.monotonic_s()) + PIECE_BYTES
    assert line.refused == {}
    assert 0 <= len(heard) + allowance.sentences - 200 <= len(sizes) * 200, "one that ends with the last byte is in both"
    assert all(any(abs(each - other) < 1e-9 for other in truth) for each in heard), "in their order, and no other"


def test_it_is_told_until_a_second_passes_without_it():
    clock = ManualClock()
    allowance = Allowance(4000, clock.monotonic_s)

    def say(data: bytes) -> bytes:
        allowance.at_once(PIECE_BYTES)
        return allowance.of(data)

    for _ in range(20):
        say(b"$GPHDT,1,T\r\n" * 10)
    assert allowance.words == ""
    allowance.look()
    assert allowance.words == "more than it may say: 110 sentences dropped, 1,320 bytes"
    clock.advance(1.0)
    for _ in range(20):
        say(b"$GPHDT,1,T\r\n" * 10)
    allowance.look()
    assert allowance.words == "more than it may say: 221 sentences dropped, 2,652 bytes"
    clock.advance(1.0)
    assert say(b"T\r\n$GPHDT,2,T\r\n") == b"$GPHDT,2,T\r\n", "the end of a dropped one is no sentence"
    allowance.look()
    assert allowance.words != ""
    assert say(b"$GPHDT,3,T\r\n") == b"$GPHDT,3,T\r\n"
    allowance.look()
    assert allowance.words == ""
    assert allowance.sentences == 222


def test_a_line_without_sentences_goes_on_after_a_flood():
    clock = ManualClock()
    allowance = Allowance(4000, clock.monotonic_s)
    allowance.of(bytes(1001))
    assert allowance.at_once(64) == UNREAD_BYTES
    assert allowance.of(bytes(50)) == b""
    clock.advance(1.0)
    assert allowance.at_once(64) == 64
    assert b"".join(allowance.of(b"x" * 60) for _ in range(5)) == b"x" * (300 - LONGEST)


def test_a_flood_leaves_its_part_of_each_tenth_of_a_second():
    """A receiver that babbles is heard all the time: it is no silence of a second and more."""
    clock = ManualClock()
    allowance = Allowance(100_000, clock.monotonic_s)
    used = [0] * 20
    for number in range(20_000):
        clock.advance(0.0001)
        used[number // 1000] += len(allowance.of(b"$GPHDT,1,T\r\n" * (allowance.at_once(PIECE_BYTES) // 12)))
    assert all(8_000 < each < 12_000 for each in used[4:]), used


def test_without_a_bound_nothing_is_dropped():
    allowance = Allowance()
    for _ in range(100):
        allowance.at_once(PIECE_BYTES)
        assert len(allowance.of(bytes(10_000))) == 10_000
    allowance.look()
    assert allowance.words == ""
