"""The played camera's pictures, and what cuts them out of a stream."""

import io

import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from delfim.base.errors import FormatError
from delfim.parts.camera import jpegblocks, played
from delfim.parts.camera.grabber import PictureStream
from delfim.parts.camera.wire import PICTURE_MAX

NOW_MS = 1_790_000_000_123


def clock_in(picture: bytes) -> int:
    """The time in a picture, as whoever sees it reads it."""
    image = Image.open(io.BytesIO(picture)).convert("L")
    width, height = image.size
    places = ((column, row) for row in range(played.ROWS) for column in range(played.COLUMNS))
    bits = 0
    for column, row in places:
        place = int((column + 0.5) / played.COLUMNS * width), int((row + 0.5) / played.OF_ROWS * height)
        grey = image.getpixel(place)
        assert isinstance(grey, int)
        bits = bits << 1 | (grey > 128)
    return bits


@pytest.mark.parametrize("size", [(640, 360), (320, 176), (160, 88), (1280, 720)])
def test_the_clock_in_the_picture_is_read_by_others(size: tuple[int, int]) -> None:
    picture = played.PlayedPictures(*size).picture(NOW_MS)
    assert jpegblocks.size_of(picture) == size
    assert clock_in(picture) == NOW_MS % (1 << played.BITS)


@given(st.lists(st.integers(0, 255), min_size=12, max_size=12))
def test_flat_blocks_are_of_their_greys(greys: list[int]) -> None:
    image = Image.open(io.BytesIO(jpegblocks.jpeg_of(32, 24, greys))).convert("L")
    found = [image.getpixel((8 * (at % 4) + 4, 8 * (at // 4) + 4)) for at in range(12)]
    assert all(abs(one - other) <= 1 for one, other in zip(found, greys, strict=True) if isinstance(one, int))


@given(st.binary(max_size=300))
def test_what_is_no_jpeg_has_no_size(data: bytes) -> None:
    with pytest.raises(FormatError):
        jpegblocks.size_of(b"\xff\xd8" + data)


@given(st.integers(1, 997))
def test_pictures_are_cut_out_of_a_stream_however_it_comes(step: int) -> None:
    pictures = [played.PlayedPictures(160, 88).picture(NOW_MS + at) for at in range(3)]
    stream, found = PictureStream(), list[bytes]()
    whole = b"".join(map(played.mpjpeg, pictures))
    for at in range(0, len(whole), step):
        found += stream.feed(whole[at : at + step])
    assert found == pictures


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"x" * 600, "it writes no pictures"),
        (b"--ffmpeg\r\n\r\n", "it writes no pictures"),
        (b"--ffmpeg\r\nContent-length: %d\r\n\r\n" % (PICTURE_MAX + 1), "allowed"),
        (b"--ffmpeg\r\nContent-length: 4\r\n\r\nabcd", "no JPEG"),
    ],
)
def test_a_stream_of_something_else_is_refused(data: bytes, words: str) -> None:
    with pytest.raises(FormatError, match=words):
        PictureStream().feed(data)
