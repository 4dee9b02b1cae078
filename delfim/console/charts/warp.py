"""`python -m delfim.console.charts.warp IMAGE PNG`: redraws an image that is rotated, or in another plane, with north up and
rows that are parallels, as pages show it. A process of its own, because it takes seconds.
"""

import math
import sys
from pathlib import Path
from typing import Final

from PIL import Image

from delfim.base.errors import DelfimError
from delfim.console.charts.georeference import Placed, placed

SIDE_MAX: Final = 4096  # pixels; what every browser can still draw
CELL: Final = 64  # pixels; inside a cell the map between the planes is taken as bilinear


def size_of(image: Placed) -> tuple[int, int]:
    """Width and height of the new one: as fine as the old one where that is not too large."""
    west, south, east, north = image.extent()
    stretch = math.cos(math.radians((south + north) / 2.0))
    width, height = image.size
    (x0, y0), (x1, y1) = image.degrees(0, 0), image.degrees(width, height)
    per_degree = math.hypot(width, height) / math.hypot((x1 - x0) * stretch, y1 - y0)
    wide, high = (east - west) * stretch * per_degree, (north - south) * per_degree
    shrink = min(1.0, SIDE_MAX / max(wide, high))
    return max(1, round(wide * shrink)), max(1, round(high * shrink))


def warp(source: Path, target: Path) -> None:
    """Raises DelfimError, OSError."""
    image = placed(source)
    west, south, east, north = image.extent()
    width, height = size_of(image)

    def pixel(column: int, row: int) -> tuple[float, float]:
        return image.pixel(west + (east - west) * column / width, north - (north - south) * row / height)

    cells = []
    for top in range(0, height, CELL):
        for left in range(0, width, CELL):
            right, bottom = min(left + CELL, width), min(top + CELL, height)
            corners = pixel(left, top), pixel(left, bottom), pixel(right, bottom), pixel(right, top)
            cells.append(((left, top, right, bottom), tuple(value for corner in corners for value in corner)))
    with Image.open(source) as opened:
        drawn = opened.convert("RGBA").transform((width, height), Image.Transform.MESH, cells, Image.Resampling.BILINEAR)
    drawn.save(target, "PNG", compress_level=3)


def main(words: list[str]) -> int:
    try:
        warp(Path(words[0]), Path(words[1]))
    except (DelfimError, OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
