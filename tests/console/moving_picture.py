"""`make pictures`: a voyage as a moving picture, of the real page, gateway and boat: a mission is drawn and sailed, a ferry
crosses, the boat gives way, goes on, and is stopped. Each three seconds of the voyage are a frame. Needs Chromium.
"""

import asyncio
import base64
import io
import itertools
import os
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image

from tests.console.chain import PATIENCE_S, Boat, afloat
from tests.console.scenes import choose
from tests.console.test_first_voyage import console
from tests.services.browser import Page, tab

SIZE, SCALE = (1200, 720), 0.8
METRES = 1 / 111_200
PLACES = ((100.0, 0.0), (250.0, 10.0), (270.0, -70.0))  # of waypoints, metres north and east of the boat
BEGINS_S = 75.0  # after its start the boat sails, so that it meets the ferry
EVERY_S, SHOWN_MS, LOOK_MS, LAST_MS = 3.0, 130, 900, 3000
READ = 5  # frames between two times that the operator takes note of alarms
COLOURS, SAMPLES = 128, 6
FERRY = (
    'boat.name="Delfim"',
    'sensors.names=["sysstat", "nmea2000"]',
    f'nmea2000.interface="canloop:moving-{os.getpid()}"',
    "simulation.heading_deg=0.0",
    'simulation.traffic.heard="perfect"',
    'simulation.traffic.vessel=[{name="FERRY", transponder="A", length_m=40.0, beam_m=9.0, north_m=190.0, east_m=640.0, '
    "course_deg=270.0, speed_mps=3.0}]",
)


class Film:
    """Frames of a page, each with the time for which it is shown."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._frames: list[Image.Image] = []
        self._shown_ms: list[int] = []

    async def look(self, shown_ms: int = LOOK_MS) -> None:
        await self._page.value("new Promise(done => setTimeout(done, 200))")
        taken = await self._page.call("Page.captureScreenshot", format="png")
        self._frames.append(Image.open(io.BytesIO(base64.b64decode(taken["data"]))).convert("RGB"))
        self._shown_ms.append(shown_ms)

    def save(self, file: Path) -> None:
        """With one palette for all of them: half for what covers most of the screen, half for what is least like the rest,
        such as the colours of alerts."""
        width, height = self._frames[0].size
        sample = Image.new("RGB", (width, height * SAMPLES))
        for at in range(SAMPLES):
            sample.paste(self._frames[at * (len(self._frames) - 1) // (SAMPLES - 1)], (0, at * height))
        halves = Image.Quantize.MEDIANCUT, Image.Quantize.MAXCOVERAGE
        chosen = [sample.quantize(COLOURS // 2, each, dither=Image.Dither.NONE).getpalette() or [] for each in halves]
        palette = Image.new("P", (1, 1))
        palette.putpalette([*chosen[0], *chosen[1]])
        first, *others = (each.quantize(palette=palette, dither=Image.Dither.NONE) for each in self._frames)
        first.save(file, save_all=True, append_images=others, duration=self._shown_ms, loop=0, optimize=True)


async def filmed(folder: Path) -> Film:
    begun_s = time.monotonic()
    async with console(folder) as (_, _, port, url), tab() as page:
        await page.open(url, width=SIZE[0], height=SIZE[1], scale=SCALE)
        with afloat(folder / "1", 1, port, FERRY) as boat:
            state = await boat.until(lambda state: all(each["ok"] for each in state["checks"] if each["name"] != "link"))
            here = state["latitude_deg"], state["longitude_deg"]
            corners = (*place(here, -60.0, -260.0), *place(here, 330.0, 330.0))
            await page.until("document.querySelector('.selected .mode') !== null", PATIENCE_S)
            await page.value(f"delfim.fit({', '.join(map(str, corners))})")
            await page.value("document.querySelector('#hint button').click()")
            film = Film(page)
            await drawn(page, film, here)
            await asyncio.sleep(max(begun_s + BEGINS_S - time.monotonic(), 0.0))
            await sailed(page, film, boat)
    return film


async def drawn(page: Page, film: Film, here: tuple[float, float]) -> None:
    await film.look()
    for number, (north_m, east_m) in enumerate(PLACES):
        latitude_deg, longitude_deg = place(here, north_m, east_m)
        x, y = await page.value(f"delfim.pixel({latitude_deg}, {longitude_deg})")
        await page.mouse((x, y))
        await film.look(LOOK_MS if not number else LOOK_MS // 2)
        await choose(page, "Add waypoint")
        await film.look(LOOK_MS // 2)
    await page.press("Enter")
    await film.look()
    await choose(page, "Mission")
    await film.look()
    await choose(page, "Send to the boat")
    await page.until(f"delfim.drawn().aboard === {len(PLACES)}", PATIENCE_S)
    await film.look()


async def sailed(page: Page, film: Film, boat: Boat) -> None:
    """It plays, gives way, comes back to its leg, and is stopped."""
    await page.press("y")
    await boat.until(lambda state: state["mode"] == "play")
    has_given_way, due_s = False, time.monotonic()
    for count in itertools.count(1):
        await film.look(SHOWN_MS)
        if count % READ == 0:
            await page.press("k")
        state = await asyncio.to_thread(boat.state)
        gives_way = bool(state["traffic"] and state["traffic"]["order"])
        has_given_way |= gives_way
        if has_given_way and not gives_way and state["reference"]["leg"] == len(PLACES) - 1:
            break
        due_s += EVERY_S
        await asyncio.sleep(max(due_s - time.monotonic(), 0.0))
    await page.press(" ")
    await film.look(SHOWN_MS)
    await boat.until(lambda state: state["mode"] == "idle")
    await film.look(LAST_MS)


def place(here: tuple[float, float], north_m: float, east_m: float) -> tuple[float, float]:
    return here[0] + north_m * METRES, here[1] + east_m * METRES / 0.7806


def main(file: Path) -> None:
    with tempfile.TemporaryDirectory(prefix="moving-", ignore_cleanup_errors=True) as folder:
        film = asyncio.run(filmed(Path(folder)))
    film.save(file)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
