"""A survey by the page alone: an area is drawn or loaded, its form shows the lines on the map, and the boat gets them. With a
folder on its command line it keeps pictures for docs/survey.md (`make pictures`).
"""

import asyncio
import contextlib
import json
import sys
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from tests.console.chain import PATIENCE_S, Boat, afloat
from tests.console.test_first_voyage import NORTH_M, PHONE, TEXT, Size, Visit, console
from tests.kit.pictures import keeper
from tests.services.browser import Page, shrink, tab

ROOT = Path(__file__).parents[2]
DESK: Size = (1200, 800, False)
OUTLINE = ((20.0, -50.0), (25.0, 60.0), (95.0, 75.0), (115.0, 5.0), (80.0, -60.0))  # metres north and east of the boat
FIELDS = "document.querySelectorAll('.popup .field input')"
WORDS = "document.querySelector('.popup .words').textContent"
BASIN = (ROOT / "etc/areas/basin.geojson").read_text()

Picture = Callable[[Page, str], Awaitable[None]]


async def typed(page: Page, field: int, words: str) -> None:
    """Into a field of the form that is open."""
    await page.value(f"(i => {{ i.value = '{words}'; i.dispatchEvent(new Event('input')); }})({FIELDS}[{field}])")


async def said(page: Page, words: str) -> str:
    """What the form says once it says these words."""
    try:
        await page.until(f"Boolean(document.querySelector('.popup .words')) && {WORDS}.includes({words!r})", PATIENCE_S)
    except AssertionError:
        raise AssertionError(f"{words!r} was never said; the screen says {await page.value(TEXT)!r}") from None
    return str(await page.value(WORDS))


def around(boat: Boat, places: tuple[tuple[float, float], ...]) -> list[tuple[float, float]]:
    state = boat.state()
    here = state["latitude_deg"], state["longitude_deg"]
    return [(here[0] + north_m * NORTH_M, here[1] + east_m * NORTH_M / 0.78) for north_m, east_m in places]


async def drawn(you: Visit, boat: Boat) -> None:
    """Corner by corner, with a hole; the form's lines follow each number, and Esc leaves the plan as it was."""
    page, places = you.page, around(boat, OUTLINE)
    await page.value(f"delfim.fit({places[0][0] - 3e-4}, {places[4][1] - 3e-4}, {places[3][0]}, {places[2][1] + 3e-4})")
    await you.taps_the_sea(places[0])
    await you.chooses("Survey")
    await you.chooses("Draw an area")
    for place in (*places, places[0]):
        await you.taps_the_sea(place)
    assert "10.0 m apart" in await said(page, "covered: 100.0 %")
    assert " min " in await said(page, " Wh")
    assert await page.value("[delfim.areas(), delfim.survey()]") == [5, 10]
    await page.press("Escape")
    assert await page.value("[delfim.areas(), delfim.survey(), delfim.drawn().plan]") == [5, 0, 0]
    middle = around(boat, ((65.0, 0.0),))[0]
    await you.taps_the_sea(middle)
    await you.chooses("Survey")
    await you.chooses("Hole around here")
    await typed(page, 0, "16")
    await page.press("Enter")
    assert await page.value("delfim.areas()") == 9
    await you.taps_the_sea(places[2])  # one of its corners
    await you.chooses("Lines")
    await typed(page, 0, "0")
    assert await said(page, "say a spacing") == "say a spacing, or a swath"
    assert await page.value("document.querySelector('.popup .main').disabled")
    await page.press("Enter")  # is refused, too
    await typed(page, 1, "10")
    await said(page, "8.0 m apart")
    await typed(page, 4, "40")
    await typed(page, 3, "90")
    assert " across" in await said(page, "8.0 m apart, 090°")
    await you.picture("survey-form")
    await page.press("Enter")
    await page.until("delfim.drawn().plan > 30")


async def sent(you: Visit, boat: Boat) -> None:
    """The lines are the plan; the boat takes them, with the hole as a zone of its fence."""
    page = you.page
    count = await page.value("delfim.drawn().plan")
    await you.sees("in order")
    await page.press("Enter")
    await you.chooses("Mission")
    await you.chooses("Send to the boat")
    await boat.until(lambda state: state["legs"] == count)
    await page.until(f"delfim.drawn().aboard === {count}", PATIENCE_S)
    await you.sees("same")
    await you.picture("survey-aboard")
    await page.reload()
    await page.until(f"window.delfim && delfim.areas() === 9 && delfim.drawn().plan === {count}", PATIENCE_S)


async def loaded(you: Visit) -> None:
    """Files, a broken one too, and an undo."""
    page = you.page
    assert (await page.value(f"delfim.loadArea('bad.kml', {json.dumps(BASIN)})")).startswith("bad.kml: not XML")
    await page.value(f"delfim.loadArea('basin.geojson', {json.dumps(BASIN)})")
    await said(page, "covered: ")
    assert await page.value("delfim.areas()") == 9 + 14
    await page.press("Escape")
    await page.press("z", ("Control",))
    assert await page.value("delfim.areas()") == 9


@contextlib.asynccontextmanager
async def with_boat(folder: Path, size: Size, picture: Picture) -> AsyncIterator[tuple[Visit, Boat, Any]]:
    """A page of this size and a boat that knows where it is, the first hint away: visit, boat, and the console's program."""
    width, height, night = size
    async with console(folder) as (gateway, _, port, url), tab() as page:
        await page.open(url, width=width, height=height, scale=1.0, dark=night)
        await page.call("Page.bringToFront")
        you = Visit(page, lambda name: picture(page, name), width < 600)
        if width < 600:
            await page.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=1)
            await page.call("Emulation.setEmitTouchEventsForMouse", enabled=False)
        with afloat(folder / "1", 1, port) as boat:
            await you.sees("boat1")
            await boat.until(lambda state: state["age_s"]["navigation"] is not None)
            await page.value("document.querySelector('#hint button')?.click()")
            yield you, boat, gateway


async def surveyed(folder: Path, size: Size, picture: Picture) -> None:
    async with with_boat(folder, size, picture) as (you, boat, _):
        await drawn(you, boat)
        await sent(you, boat)
        await loaded(you)


async def nothing(page: Page, name: str) -> None:
    """No picture is kept."""


@pytest.mark.long
def test_an_area_is_drawn_its_lines_are_seen_while_the_form_changes_and_the_boat_gets_them(tmp_path: Path) -> None:
    asyncio.run(surveyed(tmp_path, DESK, nothing))


def main(folder: Path) -> None:
    for size, keep in ((DESK, keeper(folder, "console")), (PHONE, keeper(folder, "console-phone", "survey-form"))):
        with tempfile.TemporaryDirectory(prefix="survey-", ignore_cleanup_errors=True) as place:
            asyncio.run(surveyed(Path(place), size, keep))
    shrink(folder.glob("console*-survey-*.png"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
