"""Words from outside are words on the page, whoever says them: markup in each of them runs nothing and is shown as it is."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path

from PIL import Image

from tests.console.fakeboat import FakeBoat
from tests.console.scenes import choose
from tests.console.test_gateway import Opened, opened
from tests.services.browser import PROGRAM, Page, tab

MARK = "<img src=x onerror=owned=1>"
ITEMS = "[...document.querySelectorAll('.item .title')].map(each => each.firstChild.data)"
PLAN = {"name": MARK, "waypoints": [{"latitude_deg": 38.69, "longitude_deg": -9.215}]}


@contextlib.asynccontextmanager
async def alive(boats: list[FakeBoat]) -> AsyncIterator[None]:
    """They go on speaking."""

    async def speak() -> None:
        while True:
            for boat in boats:
                boat.tick()
            await asyncio.sleep(0.1)

    async with asyncio.TaskGroup() as group:
        speaking = group.create_task(speak())
        yield
        speaking.cancel()


async def put(sea: Opened) -> None:
    """A plan that another page made."""
    async with sea.session.ws_connect(sea.url + "ws") as other:
        await sea.until(other, lambda m: m["t"] == "boats" and m["boats"])
        await other.send_json({"t": "mission", "seq": 1, "boat": 1, "do": "put", "mission": PLAN})
        assert (await sea.until(other, lambda m: m["t"] == "answer"))["ok"]


async def says(page: Page, place: str, words: str = MARK) -> None:
    await page.until(f"document.querySelector({place!r})?.textContent.includes({words!r})")


async def test_markup_in_names_and_texts_is_text(tmp_path: Path) -> None:
    """The boat's name, what it says and why it refuses; names of missions, of their files, of charts and of a radio."""
    assert PROGRAM, "Chromium is missing: make system"
    for folder in ("missions", "charts"):
        (tmp_path / folder).mkdir()
    (tmp_path / "missions" / f"{MARK}.toml").write_text("version = 1")
    Image.new("RGB", (20, 10)).save(tmp_path / "charts" / f"{MARK}.png")
    (tmp_path / "charts" / f"{MARK}.pgw").write_text("0.001 0 0 -0.001 -9.2195 38.6995")
    Image.new("RGB", (20, 10)).save(tmp_path / "charts" / f"lost {MARK}.png")
    async with (
        opened(tmp_path, charts=tmp_path / "charts", radios=[f"{MARK}:9600"]) as sea,
        alive(sea.boats),
        tab() as page,
    ):
        boat = sea.boats[0]
        boat.name = boat.refuse = MARK
        await put(sea)
        await page.open(f"{sea.url}?token={sea.gateway.token}", width=1280, height=800, scale=1.0)
        await page.call("Page.bringToFront")
        await says(page, '[data-boat="1"] b')
        await says(page, "#messages", f"lost {MARK}.png")
        await page.press("h")
        await says(page, "#messages", MARK)
        await page.press("Enter")
        await says(page, ".popup")
        await choose(page, "Mission", "Load", MARK)
        await says(page, "#messages", "is no name for a mission")
        await page.press("Escape")
        await page.mouse((500.0, 600.0))
        await choose(page, "Screen")
        await page.until(f"{ITEMS}.includes('Chart: {MARK}')")
        await choose(page, "Log of the watch")
        await says(page, "#log")
        assert await page.value(
            "[window.owned ?? 0, document.querySelectorAll('img:not(#picture > img), body script').length]"
        ) == [0, 0]
