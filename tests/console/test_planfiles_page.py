"""Plans of other programs on the page: dropped, sent to a boat, and saved as a file, through the real gateway."""

import asyncio
import json
from pathlib import Path

import pytest

from delfim.console.plans.planfile import read_plan
from tests.console.chain import PATIENCE_S, Boat, afloat
from tests.console.test_first_voyage import DESK, Visit, console
from tests.console.test_planfile import BOMB, KML, LINE, PLACES, at
from tests.services.browser import Page, tab
from tests.survey.test_areafile import FEATURE

SAID = "document.getElementById('said').innerText"
DROP = """(() => {
  const data = new DataTransfer();
  data.items.add(new File([%s], %s));
  window.dispatchEvent(new DragEvent("drop", { dataTransfer: data, cancelable: true }));
})()"""


async def dropped(page: Page, name: str, text: str) -> None:
    await page.value(DROP % (json.dumps(text), json.dumps(name)))


async def said(page: Page, words: str) -> None:
    await page.until(f"{SAID}.includes({words!r})", PATIENCE_S)


async def menu(you: Visit) -> None:
    """The menu of files, from the boat's."""
    await you.page.press("Enter")
    await you.chooses("Mission")
    await you.chooses("Files of other programs")


async def saved(you: Visit, title: str, file: Path) -> None:
    await menu(you)
    await you.chooses(title)
    async with asyncio.timeout(PATIENCE_S):
        while not file.exists():
            await asyncio.sleep(0.05)


async def walked(folder: Path, you: Visit, boat: Boat) -> None:
    page = you.page
    await dropped(page, "dock.kml", KML)
    await page.until(f"delfim.drawn().plan === {len(PLACES)}", PATIENCE_S)
    await said(page, "plan of dock.kml")
    await dropped(page, "bomb.kml", BOMB)
    await said(page, "it declares entities")
    await dropped(page, "notes.csv", "a")
    await said(page, "not a plan")
    track = {**LINE["geometry"], "coordinates": [[-9.2153 + n * 1e-5, 38.6907 + n % 2 * 1e-4] for n in range(1501)]}  # type: ignore[dict-item]
    await dropped(page, "track.geojson", json.dumps(track))
    await said(page, "1501 points became")
    await page.press("z", ("Control",))
    await page.until(f"delfim.drawn().plan === {len(PLACES)}", PATIENCE_S)
    await saved(you, "Save as QGroundControl", folder / "dock.plan")
    assert at(read_plan(folder / "dock.plan")) == PLACES
    await page.press("Enter")
    await you.chooses("Mission")
    await you.chooses("Send to the boat")
    await boat.until(lambda state: state["legs"] == len(PLACES))
    await dropped(page, "area.geojson", json.dumps(FEATURE))
    await you.sees("Survey lines")
    await page.nothing_amiss()


async def visited(folder: Path) -> None:
    async with console(folder) as (_, _, port, url), tab() as page:
        await page.open(url, width=DESK[0], height=DESK[1], scale=1.0)
        await page.call("Page.bringToFront")
        await page.call("Page.setDownloadBehavior", behavior="allow", downloadPath=str(folder))
        with afloat(folder / "1", 1, port) as boat:
            you = Visit(page, lambda name: asyncio.sleep(0), False)
            await you.sees("boat1")
            await boat.until(lambda state: state["age_s"]["navigation"] is not None)
            await page.value("document.querySelector('#hint button')?.click()")
            await walked(folder, you, boat)


@pytest.mark.long
def test_a_plan_of_another_program_is_dropped_sent_and_saved(tmp_path: Path) -> None:
    asyncio.run(visited(tmp_path))
