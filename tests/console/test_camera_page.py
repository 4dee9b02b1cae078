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
from typing import Any

import pytest
from PIL import Image

from delfim import config
from delfim.base.clock import ManualClock
from delfim.console.gateway import page_messages
from delfim.console.gateway.picturedesk import PictureDesk
from delfim.console.tapes.replay import TapePlayer, open_tapes
from delfim.parts.camera.jpegblocks import size_of
from delfim.parts.camera.kept import PictureKeeper
from delfim.parts.camera.played import PlayedPictures
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle.log.logbook import Logbook
from tests.console.scenes import choose
from tests.console.standin import Message, Standin
from tests.kit.page import gateway, page, shown
from tests.services.browser import Page, tab

__all__ = ["gateway", "page"]
ROOT = Path(__file__).parents[2]
PATIENCE_S = 200.0
# The clock in a picture, in ms.
CLOCK = """
const canvas = document.createElement('canvas');
window.clock_of = (image, width, height) => {
  [canvas.width, canvas.height] = [width, height];
  const drawing = canvas.getContext('2d', { willReadFrequently: true });
  drawing.drawImage(image, 0, 0);
  const data = drawing.getImageData(0, 0, width, height).data;
  let time = 0;
  for (let row = 0; row < 4; row++)
    for (let column = 0; column < 10; column++) {
      const [x, y] = [Math.floor((column + 0.5) / 10 * width), Math.floor((row + 0.5) / 11 * height)];
      time = 2 * time + (data[4 * (y * width + x)] > 128 ? 1 : 0);
    }
  return time;
};
"""
# The time since each picture was drawn, in ms, once it is on the screen: `glass`, from the clock in the picture.
GLASS = f"""{CLOCK}
window.glass = [];
const image = document.querySelector('#picture img');
image.addEventListener('load', () => requestAnimationFrame(() => {{
  const [width, height] = [image.naturalWidth, image.naturalHeight];
  glass.push([Date.now() % 2 ** 40 - clock_of(image, width, height), width]);
}}));
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


async def of_a_replay(its: Page, url: str, boats: int = 1) -> None:
    """The page of a replay of so many boats, the camera of the first open."""
    await its.open(url, width=1280, height=800, scale=1.0)
    await its.until(f"document.querySelectorAll('.chip').length >= {boats}", PATIENCE_S)
    await its.press("Enter")
    await choose(its, "Camera")


async def replayed(url: str) -> None:
    """The clock in the picture is that of the replay, but for the second between two that were kept."""
    async with tab() as its:
        await of_a_replay(its, url)
        await its.value(GLASS.replace("Date.now()", "Math.round(1000 * delfim.at_s())"))
        await its.until("glass.some(([off_ms]) => off_ms > -1000 && off_ms < 10000)", PATIENCE_S)
        await its.nothing_amiss()


def logged(folder: Path, number: int, width: int, name: str = "") -> Path:
    """A boat's logs of ten seconds, with pictures of this width."""
    called = f'boat.name="{name or f"number-{number}"}"'
    more = f'log.directory="{folder}"', 'log.state_method="write"', f"boat.id={number}", called
    settings = config.load(ROOT / "etc/delfimx.toml", more)
    run = Lockstep(settings, 1, lambda clock: Logbook(settings, clock))
    run.sail((ROOT / "etc/missions/doca.toml").read_text(), 10.0)
    run.close()
    tape = open_tapes([folder])[0]
    keeper, camera = PictureKeeper(folder, "bow", 1 << 30), PlayedPictures(width, 88)
    for taken_s in range(int(tape.from_s), int(tape.to_s) + 1):
        keeper.put(taken_s * 1000, camera.picture(taken_s * 1000))
    keeper.close()
    return folder


async def paused(its: Page, after_s: float) -> None:
    """The replay, so long after its beginning."""
    await its.press(" ")
    slider = "const slider = document.querySelector('#replay input')"
    there = f"slider.value = Number(slider.min) + {after_s}"
    await its.value(
        f"(() => {{ {slider}; {there}; for (const each of ['input', 'change']) slider.dispatchEvent(new Event(each)); }})()"
    )
    await its.until(f"Math.abs(delfim.at_s() - document.querySelector('#replay input').min - {after_s}) < 0.2", PATIENCE_S)


def test_of_several_boats_each_has_its_own_pictures_in_a_replay(tmp_path: Path) -> None:
    """Those of the time that is replayed, with the age that their own clock says."""

    async def scenario(url: str) -> None:
        async with tab() as its:
            await of_a_replay(its, url, boats=2)
            await its.value(GLASS.replace("Date.now() % 2 ** 40 - ", ""))
            await paused(its, 4.5)
            old_s = "(1000 * delfim.at_s() % 2 ** 40 - glass.at(-1)[0]) / 1000"
            for width in (160, 240):
                await its.until(f"glass.at(-1)?.[1] === {width} && {old_s} >= 0 && {old_s} < 1", PATIENCE_S)
                await its.until(f"Math.abs(parseFloat({AGE}) - {old_s}) < 0.06 && !{IS_OLD}", PATIENCE_S)
                await its.value("glass.splice(0)")
                await its.press("Tab")
            await its.nothing_amiss()

    trees = [logged(tmp_path / name, number, width) for name, number, width in (("otter", 1, 160), ("heron", 2, 240))]
    with console(tmp_path, "console", "--replay", *map(str, trees)) as url:
        asyncio.run(scenario(url))


def test_pictures_in_a_folder_with_the_logs_of_several_boats_are_nobodys(tmp_path: Path) -> None:
    logged(tmp_path, 1, 160)
    told = list[dict[str, Any]]()
    clock = ManualClock()
    tapes = open_tapes([logged(tmp_path, 2, 240)])
    desk = PictureDesk(TapePlayer(tapes, clock, told.append), b"", clock, tmp_path)
    desk.replays(tapes)
    desk.ask(1, page_messages.See(1), told.append)
    clock.advance(1.0)
    desk.tick()
    assert told[-1]["why"] == "logs of several boats are in one folder: nobody knows whose pictures those are"


def test_two_recorded_boats_of_one_number_have_each_their_own_pictures(tmp_path: Path) -> None:
    """The second gets a number that none has, and the console says so when it starts."""
    trees = [logged(tmp_path / name, 1, width, name) for name, width in (("heron", 240), ("otter", 160))]
    told = list[dict[str, Any]]()
    clock = ManualClock()
    tapes = open_tapes(trees)
    player = TapePlayer(tapes, clock, told.append)
    assert {number: boat.name for number, boat in player.boats.items()} == {1: "heron", 2: "otter"}
    assert [tape.complaint for tape in tapes] == ["", "otter: its number 1 is heron’s, too; here it has 2"]
    desk = PictureDesk(player, b"", clock, tmp_path)
    desk.replays(tapes)
    for number in (1, 2):
        desk.ask(1, page_messages.See(number), told.append)
    clock.advance(1.0)
    player.tick()
    desk.tick()
    shown = [each for each in told if each.get("jpeg")]
    assert [(each["boat"], size_of(base64.b64decode(each["jpeg"]))[0]) for each in shown] == [(1, 240), (2, 160)]


@pytest.mark.long
def test_the_picture_of_a_simulated_boat_live_frozen_and_replayed(tmp_path: Path) -> None:
    with simulation(tmp_path) as url:
        asyncio.run(live(url, tmp_path))
    with console(tmp_path, "console", "--replay", str(tmp_path / "sim/log")) as url:
        asyncio.run(replayed(url))
