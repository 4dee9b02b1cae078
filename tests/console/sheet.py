"""`make pictures`: every screen of the console in its four themes, on a desk, a tablet and a phone, a sheet for each. Boats are
those of the stand-in gateway. Needs Chromium.
"""

import asyncio
import base64
import io
import sys
import tempfile
from collections.abc import Awaitable, Callable
from pathlib import Path

from PIL import Image

from delfim.parts.camera.played import PlayedPictures
from tests.console.scenes import alert, at_work, begun, caught_up, choose, shipping_lane, show
from tests.console.standin import Message, Standin, place
from tests.services.browser import Page, browser, shrink

SIZES = {"desk": (1440, 860, 5), "tablet": (1024, 768, 4), "phone": (390, 844, 2)}  # and by how much the sheet is smaller
THEMES = ("bright", "day", "dusk", "night")
GAP_PX = 8
Shot = Callable[[Standin], Awaitable[None]]


def orders(gateway: Standin) -> list[Message]:
    """A log of the watch."""
    told = (
        ("Ana", "order", "play"),
        ("boat", "notice", "play: operator"),
        ("Ana", "note", "weed at the slip"),
        ("Ana", "order", "speed"),
    )
    return [
        {"at_s": gateway.at_s - 60.0 * n, "boat": 2, "name": "DelfimX", "who": who, "what": what, "text": text}
        for n, (who, what, text) in enumerate(told)
    ]


def rows() -> list[Message]:
    """Keys of a boat's file."""
    names = ("control.speed.cruise_mps", "control.speed.max_mps", "control.path.acceptance_m", "control.hold.radius_m")
    fixed = {"file": 1.5, "allowed": "0.05 to 30.0", "words": "", "refused": "", "meaning": "what a boat does", "unit": "m/s"}
    return [{"key": name, "value": 1.0 + n / 2.0} | fixed for n, name in enumerate(names)]


async def at_sea(page: Page, size: tuple[int, int], shot: Shot) -> None:
    async with at_work().serving() as gateway:
        day = await begun(page, gateway, width=size[0], height=size[1])
        await show(page, -250, -330, 250, 360)
        await shipping_lane(gateway, day)
        stop = alert(2, 1, "alarm", "BRAVO: CPA 12 m in 41 s", "unacknowledged") | {"at_s": gateway.at_s - 40}
        await gateway.tell({"t": "alerts", "alerts": [stop]})
        await gateway.tell({"t": "log", "all": True, "lines": orders(gateway)})
        await caught_up(page, gateway)
        await shot(gateway)
        await page.press("a")
        await shot(gateway)
        await page.press("a")
        await page.press("Enter")
        await shot(gateway)
        await choose(page, "More")
        await shot(gateway)
        await choose(page, "Settings…")
        await gateway.tell({"t": "aboard", "boat": 2, "of": "settings", "rows": rows()})
        await page.until("document.querySelectorAll('#panes tr').length > 3")
        await shot(gateway)
        await page.press("Escape")
        await page.press("Enter")
        await choose(page, "Speed…")
        await shot(gateway)
        await page.press("Escape")
        await page.press("F1")
        await shot(gateway)
        await page.press("Escape")
        await page.mouse((0.6 * size[0], 0.45 * size[1]))
        await shot(gateway)
        await choose(page, "Screen", "Log of the watch")
        await shot(gateway)
        await page.press("Escape")
        await page.press("j")
        await shot(gateway)
        await page.call("Page.navigate", url="about:blank")  # before its gateway ends


async def replayed(page: Page, size: tuple[int, int], shot: Shot) -> None:
    gateway = at_work()
    begins_s = gateway.at_s - 300.0
    noted = {"at_s": begins_s + 500.0, "boat": 2, "severity": 6, "text": "Ana: weed", "note": True}
    gateway.hello["replay"] = {"from_s": begins_s, "to_s": begins_s + 1800.0, "events": [noted]}
    async with gateway.serving():
        day = await begun(page, gateway, width=size[0], height=size[1])
        values = {"speed_mps": [[begins_s + 6.0 * n, 1.5 + (n % 7) / 40.0] for n in range(300)]}
        await gateway.tell({"t": "graphs", "boat": 2, "graphs": values})
        await show(page, -250, -330, 250, 360)
        await day.sail(60)
        await caught_up(page, gateway)
        await shot(gateway)
        await page.call("Page.navigate", url="about:blank")


def trial() -> Message:
    """Of a boat that is asked about on its water."""
    seen = ("The motors, one at a time", "done"), ("Ahead and astern", "under way")
    each = {"name": "", "reason": "", "far_m": 12.0, "elapsed_s": 74.0}
    steps = [each | {"words": words, "state": state} for words, state in seen]
    circle = dict(zip(("latitude_deg", "longitude_deg"), place(-30, 0), strict=True)) | {"radius_m": 60.0}
    lines = ["The port motor turned the bow to starboard.", "  port   ahead   1.2 m/s", "         astern  0.7 m/s"]
    told = {"t": "adoption", "boat": 2, "is_running": True, "circle": circle, "steps": steps, "part": 0.4, "end": ""}
    return told | {
        "lines": lines,
        "question": "Is the water about her still free?",
        "file": "",
        "is_written": False,
        "report": False,
    }


async def at_tasks(page: Page, size: tuple[int, int], shot: Shot) -> None:
    """The camera, a trial, and an area to be surveyed."""
    async with at_work().serving() as gateway:
        await begun(page, gateway, width=size[0], height=size[1])
        await show(page, -250, -330, 250, 360)
        await page.press("Enter")
        await choose(page, "More", "Camera")
        await gateway.until(lambda message: message["t"] == "see")
        still = base64.b64encode(PlayedPictures(320, 176).picture(1)).decode()
        told = {"t": "picture", "boat": 2, "camera": "bow", "cameras": ["bow"], "kbps": 240, "why": ""}
        await gateway.tell(told | {"age_s": 0.1, "same_s": 0, "taken_s": 1.0, "jpeg": still})
        await page.until("document.querySelector('#picture img').complete")
        await shot(gateway)
        await page.value("[...document.querySelectorAll('#picture button')].at(-1).click()")
        await gateway.tell(trial())
        await page.until("!document.querySelector('#adopt').hidden")
        await shot(gateway)
        await gateway.tell({**trial(), "boat": None})
        await page.until("document.querySelector('#adopt').hidden")
        await page.press("Tab")
        await page.mouse((0.6 * size[0], 0.5 * size[1]))
        await choose(page, "Survey", "Area around here…")
        await shot(gateway)
        await page.call("Page.navigate", url="about:blank")


async def seen(name: str) -> list[list[Image.Image]]:
    """Each screen in each theme."""
    width, height, smaller = SIZES[name]
    taken = list[list[bytes]]()
    for scene in (at_sea, replayed, at_tasks):
        with tempfile.TemporaryDirectory(prefix="page-", ignore_cleanup_errors=True) as place:
            async with browser(Path(place)) as page:

                async def shot(gateway: Standin, page: Page = page) -> None:
                    taken.append([])
                    for theme in THEMES:
                        await page.value(f"delfim.theme('{theme}')")
                        await gateway.frame()
                        await caught_up(page, gateway)
                        await page.value("new Promise(done => requestAnimationFrame(() => setTimeout(done, 100)))")
                        told = await page.call("Page.captureScreenshot", format="png")
                        taken[-1].append(base64.b64decode(told["data"]))

                await scene(page, (width, height), shot)
    size = width // smaller, height // smaller
    opened = [[Image.open(io.BytesIO(each)).convert("RGB") for each in row] for row in taken]
    return [[each.resize(size, Image.Resampling.LANCZOS) for each in row] for row in opened]


def sheet(shots: list[list[Image.Image]], across: int) -> Image.Image:
    """`across`: screens in a row, each in its themes."""
    wide, high = (side + GAP_PX for side in shots[0][0].size)
    whole = Image.new("RGB", (across * len(THEMES) * wide, -(-len(shots) // across) * high), "white")
    for n, row in enumerate(shots):
        for m, each in enumerate(row):
            whole.paste(each, ((n % across * len(THEMES) + m) * wide, n // across * high))
    return whole


async def main(folder: Path) -> None:
    for name in SIZES:
        sheet(await seen(name), 2 if name == "phone" else 1).save(folder / f"console-sheet-{name}.png")


if __name__ == "__main__":
    asyncio.run(main(Path(sys.argv[1])))
    shrink(Path(sys.argv[1]).glob("console-sheet-*.png"))
