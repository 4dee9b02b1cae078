"""Binary frames in a stream of bytes: what begins like one, is as long as it says, and whose sum is right.

Nothing here raises: what is no sound frame is passed over byte by byte and counted. Less than one frame is kept.
"""

from binascii import crc_hqx
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

HEAD_MAX: Final = 80  # bytes that `Framing.size` is shown; no protocol here needs more for a frame's length
_MIRRORED: Final = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


class Framing(NamedTuple):
    """How a protocol puts its frames on a line."""

    begin: bytes  # of each frame; empty: `size` alone tells
    size: Callable[[bytes], int | None]  # of a frame that begins so; None: more bytes are needed; 0: no frame begins so
    sound: Callable[[bytes], bool]  # whether the sum of a whole frame is right


def mirrored_crc(data: bytes) -> int:
    """The CRC of 16 bits with the polynomial 0x1021, each byte and the result with the low bit first (CRC-16/KERMIT)."""
    crc = crc_hqx(data.translate(_MIRRORED), 0)
    return _MIRRORED[crc & 0xFF] << 8 | _MIRRORED[crc >> 8]


class BinaryFrames:
    """The frames of one line. `refused` counts what began as a frame and is none."""

    def __init__(self, framing: Framing) -> None:
        self._framing, self._rest, self.refused = framing, b"", 0

    def feed(self, data: bytes) -> Iterator[bytes]:
        """The whole frames that end in these bytes."""
        begin, size_of, sound = self._framing
        stream, at = self._rest + data, 0
        while (at := stream.find(begin, at)) >= 0:
            size = size_of(stream[at : at + HEAD_MAX])
            if size is None or at + size > len(stream):
                break
            if size and sound(frame := stream[at : at + size]):
                yield frame
                at += size
            else:
                self.refused += bool(size or begin)
                at += 1
        if at < 0:
            at = len(stream) - (len(begin) > 1 and stream.endswith(begin[:1]))
        self._rest = stream[at:]
