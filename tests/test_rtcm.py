"""RTCM frames in a stream: found whole, in any pieces, among any noise; checked against pyrtcm."""

import random
from io import BytesIO

import pyrtcm
from hypothesis import given
from hypothesis import strategies as st

from delfim.lines.rtcm import FRAME_MAX, NUMBERS_MAX, PREAMBLE, RtcmFrames, crc24q, framed
from tests.mutations import cut, dropped, flipped, spliced

PLACE = bytes.fromhex("d300133ed7d30202980edeef34b4bd62ac0941986f33360b98")  # 1005 of RTCM 10403's example


def test_the_frame_of_the_standard():
    assert [(each.number, each.data) for each in RtcmFrames().feed(PLACE)] == [(1005, PLACE)]
    assert crc24q(PLACE[:-3]) == 0x360B98
    assert framed(PLACE[3:-3]) == PLACE


@given(st.binary(min_size=2, max_size=1023))
def test_pyrtcm_finds_what_is_framed_here(payload):
    raw = framed(payload)
    assert pyrtcm.calc_crc24q(raw) == 0
    assert RtcmFrames().feed(raw)[0].data == raw


def test_pyrtcm_reads_the_same_number():
    _, theirs = pyrtcm.RTCMReader(BytesIO(PLACE)).read()
    assert int(theirs.identity) == RtcmFrames().feed(PLACE)[0].number


@given(
    st.lists(st.binary(max_size=60), min_size=1, max_size=5),
    st.lists(st.integers(1, 90), max_size=20),
    st.lists(st.binary(max_size=20), min_size=6, max_size=6),
)
def test_frames_are_found_in_any_pieces_among_noise(payloads, cuts, noise):
    noise = [each.replace(bytes((PREAMBLE,)), b"") for each in noise]
    frames = [framed(payload) for payload in payloads]
    whole = b"".join(between + frame for between, frame in zip(noise, frames, strict=False)) + noise[5]
    stream, found, at = RtcmFrames(), [], 0
    for length in (*cuts, len(whole)):
        found += stream.feed(whole[at : at + length])
        at += length
    assert [each.data for each in found] == frames
    assert stream.noise == sum(map(len, noise[: len(frames)])) + len(noise[5])


def test_noise_that_looks_like_a_frame_hides_none_for_long():
    stream = RtcmFrames()
    assert stream.feed(b"\xd3\x00\x40" + PLACE) == []
    assert [each.number for each in stream.feed(PLACE * 3)] == [1005] * 4


def test_a_stream_that_was_cut_does_not_go_on():
    stream = RtcmFrames()
    stream.feed(PLACE[:10])
    stream.reset()
    assert [each.number for each in stream.feed(PLACE)] == [1005]
    assert stream.noise == 10


def test_numbers_are_bounded():
    stream = RtcmFrames()
    for number in range(1000, 1000 + 2 * NUMBERS_MAX):
        stream.feed(framed((number << 4).to_bytes(2, "big")))
    assert len(stream.heard) == NUMBERS_MAX + 1
    assert stream.heard[0] == NUMBERS_MAX


def test_damage_raises_nothing_and_passes_no_wrong_frame():
    among, stream = random.Random(1), RtcmFrames()
    frames = [framed(among.randbytes(among.randrange(2, 300))) for _ in range(50)] + [PLACE]
    for _ in range(10_000):
        raw = among.choice(frames)
        for found in stream.feed(among.choice((flipped, cut, dropped, spliced))(raw, among)[: 2 * FRAME_MAX]):
            assert pyrtcm.calc_crc24q(found.data) == 0
    assert stream.noise > 100_000
    stream.feed(bytes(FRAME_MAX))
    assert [each.number for each in stream.feed(PLACE)] == [1005]
