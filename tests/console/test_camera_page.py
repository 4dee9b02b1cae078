"""The pictures of a boat's camera on the real page: of a simulated boat, through its process, its link and the gateway; and
what the page says of pictures that are old, do not change, or are of another boat.
"""

import asyncio
import base64
import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest
from PIL import Image

from delfim.parts.camera.played import PlayedPictures
from tests.console.scenes import choose
from tests.console.standin import Message, Standin
from tests.kit.page import gateway, page, shown
from tests.services.browser import Page, tab

__all__ = ["gateway", "page"]
ROOT = Path(__file__).parents[2]
PATIENCE_S = 200.0
# The time since each picture was drawn, in ms, once it is on the screen: `glass`, from the clock in the picture.
GLASS = """
window.glass = [];
const image = document.querySelector('#picture img'), canvas = document.createElement('canvas');
image.addEventListener('load', () => requestAnimationFrame(() => {
  const [width, height] = [canvas.width, canvas.height] = [image.naturalWidth, image.naturalHeight];
  const drawing = canvas.getContext('2d', { willReadFrequently: true });
  drawing.drawImage(image, 0, 0);
  const data = drawing.getImageData(0, 0, width, height).data;
  let time = 0;
  for (let row = 0; row < 4; row++)
    for (let column = 0; column < 10; column++) {
      const [x, y] = [Math.floor((column + 0.5) / 10 * width), Math.floor((row + 0.5) / 11 * height)];
      time = 2 * time + (data[4 * (y * width + x)] > 128 ? 1 : 0);
    }
  glass.push([Date.now() % 2 ** 40 - time, width]);
}));
"""
AGE = "document.querySelector('#picture output').textContent"
SAID = "document.querySelector('#picture b').textContent"
IS_OLD = "document.querySelector('#picture').classList.contains('old')"


def shot(**more: object) -> Message:
    jpeg = base64.b64encode(PlayedPictures(160, 88).picture(1)).decode()
    told = {"t": "picture", "boat": 1, "camera": "bow", "cameras": ["bow"], "kbps": 20, "why": ""}
    return told | {"age_s": 0.1, "same_s": 0, "taken_s": 1.0, "jpeg": jpeg} | more


@contextlib.asynccontextmanager
async def looking(gateway: Standin, page: contextlib.AbstractAsyncContextManager[Page]) -> AsyncIterator[Page]:
    async with page as its:
        await its.press("Enter")
        await choose(its, "More", "Camera")
        await gateway.until(lambda message: message["t"] == "see" and message["boat"] == 1)
        yield its


def test_a_picture_that_does_not_change_is_told(gateway: Standin, page: contextlib.AbstractAsyncContextManager[Page]) -> None:
    async def scenario() -> None:
        async with looking(gateway, page) as its:
            await gateway.tell(shot())
            await shown(its, gateway, f"{AGE}.includes(', 20\\u00a0kbit/s')")
            assert await its.value(SAID) == ""
            await gateway.tell(shot(same_s=9))
            await shown(its, gateway, f"{SAID}.startsWith('picture has not changed for ')")

    asyncio.run(scenario())


def test_an_old_picture_is_grey_and_says_why(gateway: Standin, page: contextlib.AbstractAsyncContextManager[Page]) -> None:
    async def scenario() -> None:
        async with looking(gateway, page) as its:
            await gateway.tell(shot(age_s=4.2))
            await shown(its, gateway, f"{SAID} === 'picture is 4 s old'")
            assert await its.value(IS_OLD)
            await gateway.tell(shot())
            await shown(its, gateway, f"!{IS_OLD} && {SAID} === ''")

    asyncio.run(scenario())


def test_the_picture_of_another_boat_is_never_shown(
    gateway: Standin, page: contextlib.AbstractAsyncContextManager[Page]
) -> None:
    async def scenario() -> None:
        async with looking(gateway, page) as its:
            await gateway.tell(shot())
            await shown(its, gateway, "document.querySelector('#picture img').src !== ''")
            await its.press("Tab")
            await gateway.until(lambda message: message["t"] == "see" and message["boat"] == 2)
            assert await its.value("document.querySelector('#picture img').getAttribute('src')") is None
            await gateway.tell(shot())
            await gateway.tell(shot(boat=2, jpeg=None, why="no camera of this boat answers"))
            await shown(its, gateway, f"{SAID} === 'no camera of this boat answers'")
            assert await its.value("document.querySelector('#picture img').getAttribute('src')") is None

    asyncio.run(scenario())


@contextlib.contextmanager
def console(folder: Path, *words: str) -> Iterator[str]:
    """A command with a console, until Ctrl-C; the console's address."""
    command = [sys.executable, "-m", "delfim", *words, "--page", "127.0.0.1:0", "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, bufsize=1, cwd=folder) as running:
        assert running.stdout is not None
        try:
            yield next(line for line in running.stdout if "the console is at " in line).split("is at ")[1].split(";")[0]
        finally:
            running.send_signal(signal.SIGINT)
            running.communicate(timeout=60.0)


def simulation(folder: Path) -> contextlib.AbstractContextManager[str]:
    """`delfim sim --console` of a boat with a camera."""
    file = folder / "boat.toml"
    file.write_text((ROOT / "etc/lake.toml").read_text() + '\n[camera.bow]\nsource = "/dev/video0"\n')
    bus = "--set", f"simulation.interface=canloop:camera-{folder.name[-12:]}"
    return console(folder, "sim", str(file), "--console", "--plain", "--output", str(folder / "sim"), *bus)


def camera_of(folder: Path) -> int:
    """The process that plays its camera."""
    for each in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if (
                b"delfim.parts.camera.played" in (each / "cmdline").read_bytes()
                and (each / "cwd").resolve() == folder.resolve()
            ):
                return int(each.name)
    raise AssertionError("no camera is played")


async def opened(its: Page, url: str) -> None:
    await its.open(url, width=1280, height=800, scale=1.0)
    await its.until("document.querySelectorAll('.chip').length > 0", PATIENCE_S)
    await its.press("Enter")
    await choose(its, "More", "Camera")
    await its.value(GLASS)
    await its.until("glass.length > 0", PATIENCE_S)


async def live(url: str, folder: Path) -> None:
    async with tab() as its:
        await opened(its, url)
        assert min(each for each, _ in json.loads(await its.value("JSON.stringify(glass)"))) >= 0
        os.kill(camera_of(folder), signal.SIGSTOP)
        await its.until(f"{IS_OLD} && {SAID}.startsWith('picture is ')", PATIENCE_S)
        await its.value("glass.splice(0)")
        await its.until(f"glass.length > 0 && !{IS_OLD}", PATIENCE_S)  # ended as one that hangs, and started again
        await its.value("[...document.querySelectorAll('#picture button')].find(each => each.textContent === 'Keep').click()")
        snapshots = folder / "sim"
        await its.until(f"{AGE}.startsWith('kept as ')", PATIENCE_S)
        (file,) = snapshots.rglob("*.jpg")
        with Image.open(file) as image:
            place = image.getexif().get_ifd(0x8825)
        assert (place[1], place[3]) == ("N", "W")
        assert float(place[2][0]) == 38.0
        await its.nothing_amiss()


async def replayed(url: str) -> None:
    """The clock in the picture is that of the replay, but for the second between two that were kept."""
    async with tab() as its:
        await its.open(url, width=1280, height=800, scale=1.0)
        await its.until("document.querySelectorAll('.chip').length > 0", PATIENCE_S)
        await its.press("Enter")
        await choose(its, "Camera")
        await its.value(GLASS.replace("Date.now()", "Math.round(1000 * delfim.at_s())"))
        await its.until("glass.some(([off_ms]) => off_ms > -1000 && off_ms < 10000)", PATIENCE_S)
        await its.nothing_amiss()


@pytest.mark.long
def test_the_picture_of_a_simulated_boat_live_frozen_and_replayed(tmp_path: Path) -> None:
    with simulation(tmp_path) as url:
        asyncio.run(live(url, tmp_path))
    with console(tmp_path, "console", "--replay", str(tmp_path / "sim/log")) as url:
        asyncio.run(replayed(url))
