"""A trial by the page alone: begun in the boat's menu, its questions answered, and ended by STOP. With a folder on its command
line it keeps pictures for docs/adopt.md (`make pictures`).
"""

import asyncio
import sys
import tempfile
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from tests.console.chain import PATIENCE_S, Boat, afloat
from tests.console.test_first_voyage import DESK, PHONE, Size, Visit, console, stop
from tests.kit.pictures import keeper
from tests.services.browser import Page, shrink, tab

Picture = Callable[[Page, str], Awaitable[None]]
BOX = "document.getElementById('adopt')"


async def button(page: Page, title: str) -> None:
    found = f"[...{BOX}.querySelectorAll('button')].find(each => each.textContent === '{title}')"
    await page.until(f"Boolean({found})", PATIENCE_S)
    await page.value(f"{found}.click()")


async def says(page: Page, words: str) -> None:
    await page.until(f"{BOX}.innerText.includes({words!r})", PATIENCE_S)


async def begun(you: Visit) -> None:
    """From the boat's menu to the first question."""
    await you.page.press("Enter")
    await you.chooses("More")
    await you.chooses("Adopt")
    await you.sees("free, upstream and upwind")
    await you.page.press("Enter")
    await says(you.page, "Is the circle free?")


async def ended_by_stop(you: Visit, boat: Boat) -> None:
    page = you.page
    await begun(you)
    await button(page, "No")
    await says(page, "The end: the circle is not free")
    assert boat.state()["mode"] == "idle"
    await button(page, "Close")
    await page.until(f"{BOX}.hidden")
    await begun(you)
    await button(page, "Yes")
    await boat.until(lambda state: state["mode"] == "trial")
    await says(page, "Motors off: what wind, current and noise do.")
    await page.until(f"{BOX}.querySelector('li').dataset.state === 'done'", PATIENCE_S)
    await boat.until(lambda state: any(each["thrust"] for each in state["thrusters"].values()))
    await you.picture("adopt")
    count = len(boat.told())
    await stop(you)
    await boat.until(lambda state: state["mode"] == "idle" and not any(each["thrust"] for each in state["thrusters"].values()))
    await says(page, "The trial ended: STOP")
    assert (await boat.sails_on(5))["mode"] == "idle"
    async with asyncio.timeout(PATIENCE_S):  # until its log has it
        while "stop" not in (told := [each["command"] for each in boat.told()[count:] if not each["refused"]]):
            await asyncio.sleep(0.1)
    assert "trial" not in told[told.index("stop") :]


async def tried(folder: Path, size: Size, picture: Picture) -> None:
    width, height, night = size
    async with console(folder) as (_, _, port, url), tab() as page:
        await page.open(url, width=width, height=height, scale=1.0, dark=night)
        await page.call("Page.bringToFront")
        you = Visit(page, lambda name: picture(page, name), width < 600)
        if you._touch:
            await page.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=1)
            await page.call("Emulation.setEmitTouchEventsForMouse", enabled=False)
        with afloat(folder / "2", 2, port) as boat:  # the number of the console's file
            await you.sees("boat2")
            await boat.until(lambda state: state["age_s"]["navigation"] is not None)
            await page.value("document.querySelector('#hint button')?.click()")
            await ended_by_stop(you, boat)


async def nothing(page: Page, name: str) -> None:
    """No picture is kept."""


@pytest.mark.long
def test_a_trial_is_begun_and_asked_about_on_the_page_and_stop_ends_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    asyncio.run(tried(tmp_path, DESK, nothing))


def main(folder: Path) -> None:
    for size, name in ((DESK, "console"), (PHONE, "console-phone")):
        with tempfile.TemporaryDirectory(prefix="adopt-", ignore_cleanup_errors=True) as place:
            asyncio.run(tried(Path(place), size, keeper(folder, name)))
    shrink(folder.glob("console*-adopt*.png"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
