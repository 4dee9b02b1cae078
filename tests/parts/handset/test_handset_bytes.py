"""SBUS and CRSF: known bytes, every value, pieces of every size, damaged and foreign bytes."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.lines.radiocontrol.crsf import Crsf
from delfim.lines.radiocontrol.sbus import Sbus
from tests.parts.handset import receivers

ALL_MIDDLE = (1500.0,) * 16
ELEVEN_BITS = st.lists(st.integers(0, 2047), min_size=16, max_size=16)


def in_us(values: list[int]) -> tuple[float, ...]:
    return tuple(1500.0 + (value - 992) * 0.625 for value in values)


def test_the_middle_is_1500_us():
    assert Crsf().feed(receivers.MIDDLE_CRSF) == [ALL_MIDDLE]
    assert Sbus().feed(2 * receivers.MIDDLE_SBUS) == [ALL_MIDDLE, ALL_MIDDLE]


def test_the_frames_of_these_tests_are_those_of_the_specifications():
    assert receivers.crsf({}) == receivers.MIDDLE_CRSF
    assert receivers.sbus({}) == receivers.MIDDLE_SBUS


@given(ELEVEN_BITS, st.integers(1, 60))
def test_every_value_arrives_in_pieces_of_any_size(values, size):
    channels = receivers.packed(values)
    for decoder, frame in (
        (Crsf(), receivers.crsf_frame(0x16, channels)),
        (Sbus(), b"\x0f" + channels + b"\x00\x00"),
    ):
        stream = 3 * frame
        found = [pulses for at in range(0, len(stream), size) for pulses in decoder.feed(stream[at : at + size])]
        assert found == [in_us(values)] * 3


@pytest.mark.parametrize("end", [0x00, 0x04, 0x14, 0x24, 0x34])
def test_sbus2_ends_are_ends(end):
    assert len(Sbus().feed(2 * (receivers.MIDDLE_SBUS[:-1] + bytes((end,))))) == 2


def test_sbus_tells_a_lost_radio_by_a_flag_though_positions_come():
    decoder = Sbus()
    decoder.feed(2 * receivers.sbus({}))
    assert decoder.feed(receivers.sbus({3: 2000.0}, flags=0x0C)) == []
    assert decoder.lost == "the receiver's failsafe flag"
    assert len(decoder.feed(receivers.sbus({}))) == 1
    assert not decoder.lost


def test_positions_that_sbus_repeats_for_a_lost_frame_are_not_fresh():
    decoder = Sbus()
    decoder.feed(2 * receivers.sbus({}))
    assert decoder.feed(receivers.sbus({}, flags=0x04)) == []
    assert not decoder.lost
    assert len(decoder.feed(receivers.sbus({}, flags=0x03))) == 1, "these two are switches"
    assert not decoder.lost


def test_sbus_counts_again_after_two_frames_in_a_row():
    decoder, frame = Sbus(), receivers.MIDDLE_SBUS
    assert decoder.feed(frame) == []
    assert decoder.feed(frame[:5]) == []
    assert len(decoder.feed(frame[5:])) == 2
    assert decoder.feed(b"\x0e" + frame[1:]) == []
    assert decoder.feed(frame) == []
    assert len(decoder.feed(frame)) == 2
    assert decoder.feed(b"\x0e" + frame[1:]) == decoder.feed(frame + 25 * b"\xff") == [], "it is alone"
    assert len(Sbus().feed(b"\x0f" + 2 * frame)) == 2


def test_crsf_tells_a_lost_radio_by_its_quality():
    decoder = Crsf()
    assert decoder.feed(receivers.crsf_link(99) + receivers.crsf({})) == [ALL_MIDDLE]
    assert decoder.quality_pct == 99
    assert decoder.feed(receivers.crsf_link(0) + receivers.crsf({})) == []
    assert decoder.lost == "the quality of its radio is 0 %"
    assert decoder.feed(receivers.crsf_link(40) + receivers.crsf({})) == [ALL_MIDDLE]


def test_other_frames_of_crsf_are_passed_over():
    shortest, longest = receivers.crsf_frame(0xAB, b""), receivers.crsf_frame(0x08, receivers.MIDDLE_CRSF + bytes(34))
    assert Crsf().feed(shortest + b"\x30" + receivers.MIDDLE_CRSF) == [ALL_MIDDLE]
    assert Crsf().feed(longest + receivers.MIDDLE_CRSF + longest) == [ALL_MIDDLE]


@pytest.mark.parametrize("address", [0xC8, 0x00, 0xEA, 0xEC, 0xEE])
def test_crsf_begins_with_one_of_its_addresses_and_a_length_that_it_may_have(address):
    assert Crsf().feed(bytes((address, 63)) + bytes((address,)) + receivers.MIDDLE_CRSF[1:]) == [ALL_MIDDLE]


@pytest.mark.parametrize("bit", range(8))
@pytest.mark.parametrize("place", range(26))
def test_crsf_takes_no_frame_with_a_wrong_bit(place, bit):
    frame = bytearray(receivers.crsf({1: 1800.0, 3: 1200.0}))
    frame[place] ^= 1 << bit
    assert set(Crsf().feed(bytes(frame) + 3 * receivers.MIDDLE_CRSF)) == {ALL_MIDDLE}


@given(st.binary(max_size=60))
def test_after_noise_sbus_needs_two_frames_in_a_row(noise):
    decoder = Sbus()
    for piece in (noise, *[receivers.MIDDLE_SBUS] * 8):
        found = decoder.feed(piece)
    assert found
    assert set(found) == {ALL_MIDDLE}


@given(st.lists(st.binary(max_size=80), max_size=20))
def test_no_bytes_raise_or_are_kept(pieces):
    for decoder in (Sbus(), Crsf()):
        for piece in pieces:
            for pulses in decoder.feed(piece):
                assert len(pulses) == 16
                assert all(880.0 <= us <= 2160.0 for us in pulses)
        assert len(decoder._rest) < 64


def test_a_noisy_line_costs_frames_and_gives_no_wrong_ones_by_crsf():
    chance = random.Random(4)
    decoder, stream = Crsf(), bytearray()
    for number in range(500):
        frame = bytearray(receivers.crsf({1: 1700.0}))
        if number % 10 == 0:
            frame[chance.randrange(len(frame))] ^= 1 << chance.randrange(8)
        stream += frame + (chance.randbytes(chance.randint(0, 5)) if number % 7 == 0 else b"")
    found = decoder.feed(bytes(stream))
    assert set(found) == {in_us(receivers.values({1: 1700.0}))}
    assert len(found) > 400
