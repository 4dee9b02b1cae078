"""`make pictures`: the page of a simulated boat as a phone and a desk see it. Needs Chromium."""

import asyncio
import contextlib
import sys
import tempfile
from pathlib import Path

import aiohttp

from tests.services.browser import browser, shrink

ROOT = Path(__file__).parents[2]
PORT = 18_480
SAILED_CYCLES = 150
VIEWS = (
    ("page-phone.png", 390, 1.5, "day"),
    ("page-desktop.png", 1280, 1.0, "day"),
    ("page-bright.png", 640, 1.0, "bright"),
    ("page-dusk.png", 640, 1.0, "dusk"),
    ("page-night.png", 640, 1.0, "night"),
)
CHOOSE = "((box) => { box.value = %r; box.dispatchEvent(new Event('change')); })(document.getElementById('colours'))"


async def main(folder: Path) -> None:
    with tempfile.TemporaryDirectory(prefix="boat-", ignore_cleanup_errors=True) as place:
        await _drawn(folder, Path(place))


async def _drawn(folder: Path, place: Path) -> None:
    words = ("sim", str(ROOT / "etc/delfimx.toml"), "--json", "--output", str(place / "sim"))
    settings = (f'simulation.httpd="127.0.0.1:{PORT}"', 'simulation.interface="canloop:pictures"')
    overrides = (word for setting in settings for word in ("--set", setting))
    boat = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "delfim", *words, *overrides, stdout=asyncio.subprocess.DEVNULL
    )
    try:
        await _sailed(f"http://127.0.0.1:{PORT}/api/state")
        async with browser(place / "browser") as page:
            for name, width, scale, theme in VIEWS:
                await page.open(f"http://127.0.0.1:{PORT}/", width=width, height=844, scale=scale)
                await page.value(CHOOSE % theme)
                (folder / name).write_bytes(await page.picture({390: 1700, 640: 900}.get(width)))
    finally:
        boat.terminate()
        await boat.wait()
    shrink(folder / name for name, *_ in VIEWS)


async def _sailed(url: str) -> None:
    """Wait until the boat has sailed for a while."""
    async with asyncio.timeout(120), aiohttp.ClientSession() as session:
        while True:
            with contextlib.suppress(aiohttp.ClientError):
                async with session.get(url) as answer:
                    vehicle = (await answer.json())["vehicle"]
                    if vehicle and vehicle["mode"] == "play" and vehicle["cycle"] > SAILED_CYCLES:
                        return
            await asyncio.sleep(0.5)


if __name__ == "__main__":
    asyncio.run(main(Path(sys.argv[1])))
