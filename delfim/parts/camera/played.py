"""`python -m delfim.parts.camera.played`: a camera that is played, for simulation and tests.

Its pictures hold a clock: above, 4 rows of 10 squares, which are the bits of the time, milliseconds since 1970, white is 1, the
highest first. Below is noise that moves, so that they are as long as those of a real camera. Told on the command line: the rate
in hertz, then WIDTHxHEIGHT:FD for each size, to which the pictures go as ffmpeg's `mpjpeg` writes them.
"""

import os
import random
import sys
import time
from contextlib import suppress
from typing import Final

from delfim.parts.camera import jpegblocks

COLUMNS, ROWS, OF_ROWS = 10, 4, 11  # of the clock; the picture has 11 rows of squares
BITS: Final = COLUMNS * ROWS
NOISE: Final = 10  # numbers in a block
TEXTURES: Final = 251


class PlayedPictures:
    """Pictures of one size."""

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height
        chance = random.Random(1)
        self._textures = [jpegblocks.noise(chance.choices(range(16), k=NOISE)) for _ in range(TEXTURES)]

    def picture(self, now_ms: int) -> bytes:
        """The picture of this time."""
        columns, rows = self.width // 8, self.height // 8
        bits = f"{now_ms % (1 << BITS):0{BITS}b}"
        above = [(2 * row + 1) * OF_ROWS // (2 * rows) for row in range(rows)]
        across = [(2 * column + 1) * COLUMNS // (2 * columns) for column in range(columns)]
        clock = [235 if bits[row * COLUMNS + column] == "1" else 20 for row in above if row < ROWS for column in across]
        rest = columns * rows - len(clock)
        shift = now_ms // 40
        textures = [jpegblocks.END] * len(clock) + [self._textures[(at * 7 + shift) % TEXTURES] for at in range(rest)]
        return jpegblocks.jpeg_of(self.width, self.height, clock + [110] * rest, textures)


def mpjpeg(picture: bytes) -> bytes:
    return b"--ffmpeg\r\nContent-type: image/jpeg\r\nContent-length: %d\r\n\r\n%b\r\n" % (len(picture), picture)


def main() -> None:
    period_s, outs = 1.0 / float(sys.argv[1]), list[tuple[PlayedPictures, int]]()
    for word in sys.argv[2:]:
        size, _, out = word.partition(":")
        width, _, height = size.partition("x")
        outs.append((PlayedPictures(int(width), int(height)), int(out)))
    due_s = time.monotonic()
    with suppress(BrokenPipeError):
        while True:
            now_ms = time.time_ns() // 1_000_000
            for pictures, fd in outs:
                rest = memoryview(mpjpeg(pictures.picture(now_ms)))
                while rest:
                    rest = rest[os.write(fd, rest) :]
            due_s = max(due_s + period_s, time.monotonic())
            time.sleep(max(due_s - time.monotonic(), 0.0))


if __name__ == "__main__":
    main()
