"""What the console and the cameras say to each other."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.errors import FormatError
from delfim.parts.camera import wire

KEY = wire.mac_key(b"1" * 32)
U32, U64 = st.integers(0, 2**32 - 1), st.integers(0, 2**64 - 1)
asks = st.builds(wire.PictureAsk, U64, st.integers(0, wire.RATE_MAX), st.integers(0, 255), st.binary(min_size=8, max_size=8))


def pieces_of(picture: bytes, step: int) -> list[wire.PicturePiece]:
    cut = enumerate(wire.cut(picture, step))
    return [wire.PicturePiece(9, 8, 7, 6, 5, 4, 3, len(picture), step, at, 0, data) for at, data in cut]


@given(asks)
def test_an_ask_comes_as_it_was_said(ask: wire.PictureAsk) -> None:
    assert wire.read_ask(KEY, wire.ask_bytes(KEY, ask)) == ask


@given(st.lists(st.from_regex(r"[a-z]{1,32}", fullmatch=True), max_size=4), st.text("abc :", max_size=80))
def test_an_answer_comes_as_it_was_said(names: list[str], why: str) -> None:
    told = wire.PictureTold(1, bytes(8), tuple(names), why)
    assert wire.read_answer(KEY, wire.told_bytes(KEY, told)) == told


@given(st.binary(min_size=1, max_size=20_000), st.integers(1, wire.PIECE_MAX), st.randoms())
def test_a_picture_is_whole_though_of_each_group_one_piece_is_lost(picture: bytes, step: int, chance: object) -> None:
    assert hasattr(chance, "choice")
    assert hasattr(chance, "shuffle")
    pieces = pieces_of(picture, step)
    count = -(-len(picture) // step)
    groups = [[*range(at, min(at + wire.GROUP, count)), count + at // wire.GROUP] for at in range(0, count, wire.GROUP)]
    lost = {chance.choice(group) for group in groups}
    left = [piece for piece in pieces if piece.at not in lost]
    chance.shuffle(left)
    joining, whole = wire.Joining(left[0]), None
    for piece in left:
        whole = whole or joining.add(wire.read_answer(KEY, wire.piece_bytes(KEY, piece)))  # type: ignore[arg-type]
    assert whole == picture


@given(st.binary(max_size=200))
def test_anything_else_is_refused(data: bytes) -> None:
    for read in (wire.read_ask, wire.read_answer):
        with pytest.raises(FormatError):
            read(KEY, data)


@given(asks, st.integers(0, 300), st.integers(1, 255))
def test_one_changed_byte_is_refused(ask: wire.PictureAsk, at: int, by: int) -> None:
    for data, read in (
        (wire.ask_bytes(KEY, ask), wire.read_ask),
        (wire.piece_bytes(KEY, pieces_of(b"x" * 100, 60)[1]), wire.read_answer),
    ):
        changed = bytearray(data)
        changed[at % len(data)] ^= by
        with pytest.raises(FormatError):
            read(KEY, bytes(changed))


@pytest.mark.parametrize(
    "field", [{"size": 0}, {"size": wire.PICTURE_MAX + 1}, {"step": 0}, {"step": 5000}, {"at": 99}, {"data": b""}]
)
def test_a_piece_beyond_its_picture_is_refused(field: dict[str, object]) -> None:
    piece = pieces_of(b"x" * 100, 60)[0]._replace(**field)
    with pytest.raises(FormatError):
        wire.read_answer(KEY, wire.piece_bytes(KEY, piece))


def test_who_has_another_key_is_not_heard() -> None:
    with pytest.raises(FormatError):
        wire.read_ask(KEY, wire.ask_bytes(wire.mac_key(b""), wire.PictureAsk(1, 1, 0, bytes(8))))
