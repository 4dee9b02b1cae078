"""What the console and the cameras say to each other of WebRTC."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.errors import FormatError
from delfim.parts.camera import livewire, wire

KEY = wire.mac_key(b"1" * 32)
U16, U32, U64 = (st.integers(0, 2**bits - 1) for bits in (16, 32, 64))
prints, users = st.binary(min_size=32, max_size=32), st.from_regex(r"[A-Za-z0-9+/]{4,32}", fullmatch=True)
passwords = st.from_regex(r"[A-Za-z0-9+/]{22,64}", fullmatch=True)
cookies, payloads = st.binary(min_size=8, max_size=8), st.integers(0, 127)
offers = st.builds(
    livewire.LiveOffer, U64, st.integers(0, wire.RATE_MAX), U16, cookies, U32, payloads, prints, users, passwords
)
answers = st.builds(
    livewire.LiveAnswer, U64, U32, st.just(livewire.ANSWERED), U64, U16, U32, prints, users, passwords, st.just("")
)
ends = st.builds(
    livewire.LiveAnswer,
    U64,
    U32,
    st.sampled_from((livewire.WAITS, livewire.ENDED)),
    U64,
    *(st.just(each) for each in (0, 0, bytes(32), "", "", "")),
)


@given(offers)
def test_an_offer_comes_as_it_was_said(offer: livewire.LiveOffer) -> None:
    assert livewire.read_offer(KEY, livewire.offer_bytes(KEY, offer)) == offer


@given(answers | ends)
def test_an_answer_comes_as_it_was_said(answer: livewire.LiveAnswer) -> None:
    assert livewire.read_answer(KEY, livewire.answer_bytes(KEY, answer)) == answer


@given(ends, st.text("abc :", max_size=80))
def test_why_it_has_ended_comes_as_it_was_said(answer: livewire.LiveAnswer, why: str) -> None:
    told = answer._replace(state=livewire.ENDED, why=why)
    assert livewire.read_answer(KEY, livewire.answer_bytes(KEY, told)) == told


@given(st.binary(max_size=300))
def test_anything_else_is_refused(data: bytes) -> None:
    for read in (livewire.read_offer, livewire.read_answer):
        with pytest.raises(FormatError):
            read(KEY, data)
        with pytest.raises(FormatError):  # a body that is signed, and nothing that one says
            read(KEY, wire.signed(KEY, b"DcL1" + data))


@given(offers, answers, st.integers(0, 300), st.integers(1, 255))
def test_one_changed_byte_is_refused(offer: livewire.LiveOffer, answer: livewire.LiveAnswer, at: int, by: int) -> None:
    for data, read in (
        (livewire.offer_bytes(KEY, offer), livewire.read_offer),
        (livewire.answer_bytes(KEY, answer), livewire.read_answer),
    ):
        changed = bytearray(data)
        changed[at % len(data)] ^= by
        with pytest.raises(FormatError):
            read(KEY, bytes(changed))


@given(offers, st.sampled_from(("a\r\na=candidate:1", "", "abc", "a" * 33, "ab cd", "àbcd")))
def test_words_that_would_be_lines_of_a_description_are_refused(offer: livewire.LiveOffer, user: str) -> None:
    with pytest.raises(FormatError):
        livewire.read_offer(KEY, livewire.offer_bytes(KEY, offer._replace(user=user)))


@given(offers)
def test_who_has_another_key_is_not_heard(offer: livewire.LiveOffer) -> None:
    with pytest.raises(FormatError):
        livewire.read_offer(KEY, livewire.offer_bytes(wire.mac_key(b""), offer))


@given(st.lists(st.from_regex(r"[a-z]{1,16}", fullmatch=True), max_size=3), st.text("abc :", max_size=80))
def test_which_cameras_come_so_is_told_beside_the_names(names: list[str], why: str) -> None:
    told = wire.PictureTold(1, bytes(8), ("bow", "stern"), why, tuple(names))
    assert wire.read_answer(KEY, wire.told_bytes(KEY, told)) == told
