"""A survey divided among two boats on the page, and again when one of them goes home. With a folder on its command line it
keeps a picture for docs/survey.md (`make pictures`).
"""

import asyncio
import contextlib
import json
import sys
import tempfile
from pathlib import Path

import pytest

from tests.console.chain import PATIENCE_S, Boat, Radio, afloat
from tests.console.test_first_voyage import Visit, console
from tests.console.test_survey_page import FIELDS, Picture, around, nothing, said, typed
from tests.kit.pictures import keeper
from tests.services.browser import shrink, tab

DESK = (1200, 800)
OUTLINE = ((20.0, -170.0), (20.0, 60.0), (110.0, 60.0), (110.0, -170.0))  # metres north and east of the first boat
TAKES_PART = f"[...{FIELDS}].slice(1).map(each => each.value).join()"


async def heard(you: Visit, boat: Boat) -> Boat:
    await you.sees(f"boat{boat.number}")
    await boat.until(lambda state: state["age_s"]["navigation"] is not None)
    return boat


async def surveyed(you: Visit, boat: Boat) -> int:
    """The lines of an area, as the plan of the boat that is selected."""
    page, outline = you.page, [[east, north] for north, east in around(boat, OUTLINE)]
    words = json.dumps({"type": "Polygon", "coordinates": [[*outline, outline[0]]]})
    await page.value(f"delfim.loadArea('lake.geojson', {json.dumps(words)})")
    await typed(page, 0, "15")
    await typed(page, 3, "180")
    await said(page, "15.0 m apart, 000°")
    await page.press("Enter")
    await page.until("delfim.drawn().plan > 10")
    return int(await page.value("delfim.drawn().plan"))


async def divide(you: Visit, boat: Boat) -> str:
    """By the map's menu; what the form says."""
    await you.taps_the_sea(around(boat, ((-25.0, -60.0),))[0])
    await you.chooses("Survey")
    await you.chooses("Divide among the boats")
    return await said(you.page, "covered, all together: 100.0 %")


async def sent(you: Visit, boat: Boat) -> int:
    """The plan of the boat that is selected goes to it, and is sailed; where it sails already, after a hold."""
    page = you.page
    count = int(await page.value("delfim.drawn().plan"))
    await page.press("p")
    await you.chooses("end the plan, then follow it")
    await boat.until(lambda state: state["mode"] == "path" and state["legs"] == count)
    return count


async def voyage(folder: Path, picture: Picture) -> None:
    async with console(folder) as (gateway, _, port, url), tab() as page:
        await page.open(url, width=DESK[0], height=DESK[1], scale=1.0)
        await page.call("Page.bringToFront")
        you = Visit(page, lambda name: picture(page, name), False)
        with contextlib.ExitStack() as boats:
            other = Radio(gateway.boats)  # a link of its own
            boats.callback(other.close)
            ports = port, await other.open()
            one, two = [await heard(you, boats.enter_context(afloat(folder / f"{n}", n, to))) for n, to in enumerate(ports, 1)]
            await page.value("document.querySelector('#hint button')?.click()")
            whole = await surveyed(you, one)
            words = await divide(you, one)
            assert "boat1: 8 lines" in words, words
            assert "boat2: 8 lines" in words, words
            await you.picture("survey-divided")
            await page.press("Enter")
            await page.until(f"delfim.drawn().plan < {whole}")
            first = await sent(you, one)
            await page.press("Tab")
            await page.until("delfim.drawn().plan > 10")
            second = await sent(you, two)
            assert first + second < whole + 10
            await page.press("l")
            await two.until(lambda state: state["reason"] == "home done")
            await page.until("document.querySelector('[data-boat=\"2\"] .mode').textContent === 'hold'", PATIENCE_S)
            await page.press("Tab")
            words = await divide(you, one)
            assert await page.value(TAKES_PART) == "takes part,stays out"
            assert "boat2" not in words
            assert "0 of 16 lines done" in words
            await page.press("Enter")
            await page.until(f"delfim.drawn().plan === {whole}", PATIENCE_S)
            assert await sent(you, one) == whole


@pytest.mark.long
def test_lines_are_divided_among_boats_and_again_when_one_goes_home(tmp_path: Path) -> None:
    asyncio.run(voyage(tmp_path, nothing))


def main(folder: Path) -> None:
    with tempfile.TemporaryDirectory(prefix="divided-", ignore_cleanup_errors=True) as place:
        asyncio.run(voyage(Path(place), keeper(folder, "console")))
    shrink(folder.glob("console-survey-divided.png"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
