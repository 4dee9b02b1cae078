"""Settings and checks of a boat, on the real page: changed, refused with the reason, reverted, kept in a file. With a folder on
its command line it keeps pictures for docs/operator.md (`make pictures`).
"""

import asyncio
import sys
import tempfile
import tomllib
from pathlib import Path

import pytest

from tests.console.chain import PATIENCE_S, Boat, Sea, operating, select
from tests.console.scenes import choose
from tests.console.test_survey_page import Picture, nothing
from tests.kit.pictures import keeper
from tests.services.browser import shrink

CRUISE = "control.speed.cruise_mps"


def of(key: str, what: str) -> str:
    return f"document.querySelector('#panes tr[data-key=\"{key}\"] {what}')"


async def shown(sea: Sea, *path: str) -> None:
    await sea.page.press("Enter")
    await choose(sea.page, "More", *path)


async def typed(sea: Sea, key: str, words: str) -> None:
    """Into the field of a key, and Enter."""
    await sea.page.value(f"{of(key, 'input')}.select()")
    await sea.page.call("Input.insertText", text=words)
    await sea.page.press("Enter")


def changed(boat: Boat) -> list[tuple[object, bool]]:
    """The values that it was given, as its own log has them, and whether it refused."""
    return [(each["value"], bool(each["refused"])) for each in boat.told() if each["command"] == "set"]


async def settings(sea: Sea, picture: Picture) -> None:
    page, boat = sea.page, sea.boats[0]
    await shown(sea, "Settings…")
    await page.until("document.querySelectorAll('#panes tr').length > 20", PATIENCE_S)
    assert await page.value("document.querySelector('#panes p').textContent.includes('All are as the boat')")
    await typed(sea, CRUISE, "0,8")
    await page.until(f"{of(CRUISE, 'button')}?.textContent === 'Revert'", PATIENCE_S)
    await typed(sea, CRUISE, "99")
    await page.until(f"{of(CRUISE, 'small.bad')}.textContent.includes('0.05 to 30.0')", PATIENCE_S)
    assert await page.value(f"{of(CRUISE, 'input')}.value") == "0.8", "what is in force, not what was refused"
    await picture(page, "settings")
    kept = tomllib.loads(await page.value("fetch(document.querySelector('#panes a').href).then((answer) => answer.text())"))
    assert kept["control"]["speed"]["cruise_mps"] == 0.8
    await page.press("ArrowUp")
    await page.value(f"{of(CRUISE, 'button')}.click()")
    await page.until("document.querySelector('#panes p').textContent.includes('All are as the boat')", PATIENCE_S)
    async with asyncio.timeout(PATIENCE_S):
        while (changes := changed(boat)) != [(0.8, False), (99.0, True), (1.5, False)]:
            assert len(changes) < 4, changes
            await asyncio.sleep(0.1)
    assert not [each for each in boat.told() if each["command"] == "speed"], "an arrow in a field steers no boat"
    await page.press("Escape")


async def checks(sea: Sea, picture: Picture) -> None:
    page = sea.page
    await shown(sea, "Before the start…")
    await page.until("document.querySelectorAll('#panes tr').length > 5", PATIENCE_S)
    assert await page.value(
        "[...document.querySelectorAll('#panes tr td:first-child')].every((each) => '✓✗'.includes(each.textContent))"
    )
    await picture(page, "checks")
    await page.press("Escape")
    assert await page.value("document.getElementById('panes').hidden")


async def voyage(folder: Path, picture: Picture) -> None:
    async with operating(folder, count=1) as sea:
        await select(sea.page, 1)
        await settings(sea, picture)
        await checks(sea, picture)
        await sea.nothing_amiss()


@pytest.mark.long
def test_settings_and_checks_from_the_page(tmp_path: Path) -> None:
    asyncio.run(voyage(tmp_path, nothing))


if __name__ == "__main__":
    with tempfile.TemporaryDirectory(prefix="panes-", ignore_cleanup_errors=True) as place:
        asyncio.run(voyage(Path(place), keeper(Path(sys.argv[1]), "console")))
    shrink(Path(sys.argv[1]).glob("console-*.png"))
