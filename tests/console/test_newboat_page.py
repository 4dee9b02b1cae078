"""The questions of `delfim new` on the page, through the real gateway: answered, taken back, saved as a file that loads; and a
file that is checked. With a folder on its command line it keeps pictures (`make pictures`).
"""

import asyncio
import json
import sys
import tempfile
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from delfim import config
from tests.console.chain import PATIENCE_S
from tests.console.scenes import choose
from tests.console.test_first_voyage import DESK, console
from tests.kit.pictures import keeper
from tests.services.browser import Page, shrink, tab

FORM = "document.getElementById('newboat')"
CHECKED = """(async () => (await (await fetch('new?name=checked.toml', { method: 'POST', body: %s })).text()))()"""
Keep = Callable[[Page, str], Awaitable[None]]


async def asks(page: Page, words: str) -> None:
    await page.until(f"{FORM}.innerText.includes({words!r})", PATIENCE_S)


async def types(page: Page, words: str) -> None:
    for each in words:
        await page.call("Input.dispatchKeyEvent", type="char", text=each)
    await page.press("Enter")


async def chosen(page: Page, kind: str) -> None:
    title = f"[...{FORM}.querySelectorAll('.item .title')].find((each) => each.firstChild.data === '{kind}')"
    await page.value(f"{title}.click()")


async def asked(folder: Path, picture: Keep | None) -> None:
    async with console(folder) as (_, _, _, url), tab() as page:
        await page.open(url, width=DESK[0], height=DESK[1], scale=1.0)
        await page.call("Page.bringToFront")
        await page.call("Page.setDownloadBehavior", behavior="allow", downloadPath=str(folder))
        await page.until("window.delfim !== undefined && delfim.online()", PATIENCE_S)
        await page.mouse((700.0, 120.0))
        await choose(page, "Screen", "A boat’s file…")
        await asks(page, "Which boat")
        await chosen(page, "own")
        await asks(page, "Name of the boat")
        await types(page, "7up")
        await asks(page, "a name is a letter")
        await types(page, "Ana")
        await asks(page, "Its number")
        await types(page, "12")
        await asks(page, "length over all")
        await page.value(f"[...{FORM}.querySelectorAll('button')].find((each) => each.textContent === 'Back').click()")
        await asks(page, "Its number")
        for answer in ("3", "2.4", "", "", None, "", "", None):
            before = await page.value(f"{FORM}.innerText")
            if answer is None and picture and "Motors" in before:
                await picture(page, "motors")
            await (page.press("Enter") if answer is None else types(page, answer))
            await page.until(f"{FORM}.innerText !== {json.dumps(before)} && {FORM}.querySelector('b') !== null", PATIENCE_S)
        await asks(page, "Where it lies")
        await types(page, "38.69,-9.2")
        await asks(page, "nothing is wrong with this file")
        if picture:
            await picture(page, "written")
        await page.value(f"{FORM}.querySelector('a').click()")
        async with asyncio.timeout(PATIENCE_S):
            while not (folder / "Ana.toml").exists():
                await asyncio.sleep(0.05)
        its = config.load(folder / "Ana.toml").boat
        assert (its.name, its.id, its.length_m) == ("Ana", 3, 2.4)
        told: Any = json.loads(await page.value(CHECKED % json.dumps('[boat]\nname = "A"\nlength_m = -1\nid = 700\n')))
        assert "2 things are wrong" in told["checked"]
        assert "length_m" in told["checked"]
        assert str(tempfile.gettempdir()) not in told["checked"]
        await page.press("Escape")
        await page.until(f"{FORM}.hidden")
        await page.nothing_amiss()


@pytest.mark.long
def test_a_boats_file_is_written_by_questions_saved_and_checked(tmp_path: Path) -> None:
    asyncio.run(asked(tmp_path, None))


def main(folder: Path) -> None:
    with tempfile.TemporaryDirectory(prefix="new-", ignore_cleanup_errors=True) as place:
        asyncio.run(asked(Path(place), keeper(folder, "console-new", "motors")))
    shrink(folder.glob("console-new-*.png"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
