"""From the clock in a camera's picture to its pixels in a real Chromium: `python -m tests.console.glass_to_glass`; two minutes.

Between the boat and the console is a relay as a LAN: 100 Mbit/s, 2 ms there and 2 ms back, 0.5 % of all packets lost. First by
stills, then by WebRTC, which needs aiortc.
"""

import asyncio
import json
import random
import tempfile
from pathlib import Path
from statistics import median, quantiles

from bench.camera import Way, at_sea
from tests.console.filming import FILM, IS_FILM
from tests.console.test_camera_page import AGE, opened
from tests.services.browser import Page, browser

LOSS, DELAY_S = 0.005, 0.002
SETTLE_S, MEASURE_S = 12.0, 5.0


async def measured(page: Page, way: str, seen: str) -> None:
    for _ in range(3):
        await asyncio.sleep(SETTLE_S)
        await page.value(f"{seen}.splice(0)")
        await asyncio.sleep(MEASURE_S)
        shown_ms = [each for each, *_ in json.loads(await page.value(f"JSON.stringify({seen})"))]
        print(f"{way}: median {median(shown_ms):.0f} ms, 95 % {quantiles(shown_ms, n=20)[-1]:.0f} ms", end=", ")
        rate = (await page.value(AGE)).rpartition(", ")[2]
        print(f"{len(shown_ms) / MEASURE_S:.1f} pictures a second, {rate}", flush=True)


async def main(folder: Path, more: str) -> None:
    chance = random.Random(1)
    down, up = (Way(chance, LOSS, DELAY_S) for _ in range(2))
    async with at_sea(folder, down, up, more) as url, browser(folder / "chromium") as page:
        await opened(page, url)
        if more:
            await page.until(IS_FILM, 60.0)
            await page.value(FILM)
        await measured(page, "WebRTC" if more else "stills", "film" if more else "glass")


if __name__ == "__main__":
    for keys in ("", "webrtc = true\n"):
        with tempfile.TemporaryDirectory() as name:
            asyncio.run(main(Path(name), keys))
