"""How the page draws a million soundings: `python -m tests.console.million_depths` prints frames a second while the map is
dragged, and what they take on the socket. In a headless Chromium, which draws without a graphics card.
"""

import asyncio
import json
import tempfile
import time
from pathlib import Path

from delfim.console.boats.depths import SIDE, TILE_DEG, DepthGrid, wide_deg
from tests.console.scenes import opened
from tests.console.standin import DOCA, Standin, boat
from tests.kit.page import second_of_moving
from tests.services.browser import browser

TILES = 10  # each way


def gridded(tiles: int = TILES) -> DepthGrid:
    """A depth in each of a million cells, or in those of fewer rows of tiles."""
    grid, first = DepthGrid(), int(DOCA[0] / TILE_DEG)
    for row in range(first, first + tiles):
        wide = wide_deg(row)
        west = int(DOCA[1] / wide) * wide
        for down in range(SIDE):
            for right in range(TILES * SIDE):
                place = (row + (down + 0.5) / SIDE) * TILE_DEG, west + (right + 0.5) / SIDE * wide
                grid.add(*place, 5.0 + (right + 7 * down) % 97 / 10.0)
    return grid


async def main() -> None:
    """Measure, and print."""
    begun_s = time.process_time()
    grid = gridded()
    gridded_s = time.process_time() - begun_s
    told = list(grid.whole())
    size = sum(len(json.dumps(each)) for each in told)
    print(f"gridded in {1e6 * gridded_s / 1e6:.2f} us each; told in {len(told)} messages of {size / len(told) / 1000:.0f} kB")
    with tempfile.TemporaryDirectory(prefix="depths-", ignore_cleanup_errors=True) as folder:
        async with Standin([boat(1, "Delfim", "#2e86ab")]).serving() as gateway, browser(Path(folder)) as page:
            await opened(page, gateway)
            begun_s = time.monotonic()
            for each in told:
                await gateway.tell(each)
            await page.until(f"delfim.depths()[0] === {SIDE * SIDE * TILES * TILES}", 120.0)
            print(f"on the page after {time.monotonic() - begun_s:.1f} s")
            for far, name in ((0.045, "all of them"), (0.005, "a twentieth")):
                await page.value(f"delfim.fit({DOCA[0]}, {DOCA[1]}, {DOCA[0] + far}, {DOCA[1] + far})")
                frames = [await second_of_moving(page, gateway, "dragged") for _ in range(3)]
                print(f"{name} in sight, dragged: {frames} frames a second")


if __name__ == "__main__":
    asyncio.run(main())
