"""A JPEG of grey blocks of 8 x 8 pixels, written and measured without any library (ITU-T T.81, baseline).

For the played camera: its clock must be drawn wherever the tests run. A block is flat, or bears noise, which is what makes a
real picture long.
"""

import struct
from collections.abc import Sequence
from typing import Final

from delfim.base.errors import FormatError

_DC_LENGTHS: Final = bytes((0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0))  # table K.3
_DC_CODES: Final = ("00", "010", "011", "100", "101", "110", "1110", "11110", "111110", "1111110", "11111110", "111111110")
_AC_LENGTHS: Final = bytes((0, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0))  # ours: the end of a block, and one of 4 bits
_AC_VALUES: Final = bytes((0x00, 0x04))
END: Final = "00"
_SOF: Final = frozenset({0xC0, 0xC1, 0xC2})


def noise(numbers: Sequence[int]) -> str:
    """The bits of a block's texture, of numbers from 0 to 15: one coefficient each, 63 at most."""
    return "".join(f"01{number:04b}" for number in numbers) + ("" if len(numbers) == 63 else END)


def jpeg_of(width: int, height: int, greys: Sequence[int], textures: Sequence[str] = (END,)) -> bytes:
    """A picture of `width` x `height` pixels, multiples of 8. `greys`: of the blocks, 0 to 255, by rows; each has the texture
    of its place, from the first again where there are fewer."""
    bits, before, count = [], 0, len(textures)
    for at, grey in enumerate(greys):
        step, before = grey - 128 - before, grey - 128
        size = abs(step).bit_length()
        value = step if step >= 0 else step + (1 << size) - 1
        bits.append(_DC_CODES[size] + (f"{value:0{size}b}" if size else "") + textures[at % count])
    stream = "".join(bits)
    stream += "1" * (-len(stream) % 8)
    coded = int(stream, 2).to_bytes(len(stream) // 8).replace(b"\xff", b"\xff\0")
    quantized = bytes((8, *(2,) * 63))  # 8: a step of the first coefficient is one grey
    return b"".join(
        (
            b"\xff\xd8",
            _segment(0xDB, b"\0" + quantized),
            _segment(0xC0, struct.pack(">BHHBBBB", 8, height, width, 1, 1, 0x11, 0)),
            _segment(0xC4, b"\x00" + _DC_LENGTHS + bytes(range(12))),
            _segment(0xC4, b"\x10" + _AC_LENGTHS + _AC_VALUES),
            _segment(0xDA, bytes((1, 1, 0, 0, 63, 0))),
            coded,
            b"\xff\xd9",
        )
    )


def _segment(marker: int, body: bytes) -> bytes:
    return struct.pack(">BBH", 0xFF, marker, len(body) + 2) + body


def size_of(picture: bytes) -> tuple[int, int]:
    """Width and height of a JPEG in pixels. Raises FormatError for what is none."""
    if not picture.startswith(b"\xff\xd8") or not picture.endswith(b"\xff\xd9"):
        raise FormatError("no JPEG")
    at = 2
    while at + 9 <= len(picture):
        marker, length = picture[at + 1], int.from_bytes(picture[at + 2 : at + 4])
        if picture[at] != 0xFF or length < 2:
            break
        if marker in _SOF:
            height, width = struct.unpack_from(">HH", picture, at + 5)
            return width, height
        at += 2 + length
    raise FormatError("a JPEG without a size")
