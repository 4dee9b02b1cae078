"""Fill the gaps: what a survey has left by the depths that the console heard, on the page, also after console and page were
started again. With a folder on its command line it keeps a picture for docs/survey.md (`make pictures`).
"""

import asyncio
import json
import math
import signal
import sys
import tempfile
from pathlib import Path

import msgspec
import pytest

from delfim import config
from delfim.console.boats.soundings import HEAD
from delfim.survey.preview import answered
from tests.console.chain import PATIENCE_S, VEHICLE, Boat
from tests.console.test_first_voyage import PHONE, Size, Visit
from tests.console.test_survey_page import DESK, Picture, around, nothing, said, typed, with_boat
from tests.kit.pictures import keeper
from tests.services.browser import shrink

OUTLINE = ((15.0, -60.0), (15.0, 60.0), (105.0, 60.0), (105.0, -60.0))  # metres north and east of the boat
SPACING_M, STEP_M = 15.0, 1.5
DONE = 2.5  # lines
Corner = tuple[float, float]


def planned(outline: list[Corner]) -> list[list[Corner]]:
    """The lines, as the console makes them."""
    asked = {"areas": [(outline, [])], "spacing_m": SPACING_M, "heading_deg": 90.0}
    lines: list[list[Corner]] = answered(msgspec.json.encode(asked), config.load(VEHICLE))["lines"]
    return lines


def heard(lines: list[list[Corner]], folder: Path) -> None:
    """The first lines as a console has written them down, the last of them in part, with a gap where the link was lost."""
    rows, at_s = [HEAD], 1_790_000_000.0
    for number, (a, b) in enumerate(lines[: math.ceil(DONE)]):
        long_m = math.dist(a, b) * 111_111 * 0.78
        for step in range(int(long_m * min(1.0, DONE - number) / STEP_M)):
            part, at_s = step * STEP_M / long_m, at_s + 1.0
            if number == 0 and 0.5 < part < 0.7:
                continue
            place = (a[k] + part * (b[k] - a[k]) for k in (0, 1))
            rows.append(f"{at_s:.3f},{next(place):.7f},{next(place):.7f},{4.0 + number + 2.0 * part:.3f}\n")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "1.csv").write_text("".join(rows) + "1790001000.000,38.6")  # the power went while it was written


async def surveyed(you: Visit, boat: Boat) -> list[list[Corner]]:
    """An area, its lines, sent."""
    page, outline = you.page, around(boat, OUTLINE)
    ring = [[east, north] for north, east in outline]
    words = json.dumps({"type": "Polygon", "coordinates": [[*ring, ring[0]]]})
    await page.value(f"delfim.loadArea('lake.geojson', {json.dumps(words)})")
    await typed(page, 0, f"{SPACING_M:g}")
    await typed(page, 3, "90")
    await said(page, f"{SPACING_M:.1f} m apart, 090°")
    await page.press("Enter")
    await page.until("delfim.drawn().plan > 10")
    await sent(you, boat)
    return planned(outline)


async def sent(you: Visit, boat: Boat) -> None:
    count = await you.page.value("delfim.drawn().plan")
    await you.page.press("Enter")
    await you.chooses("Mission")
    await you.chooses("Send to the boat")
    await boat.until(lambda state: state["legs"] == count)
    await you.page.until(f"delfim.drawn().aboard === {count}", PATIENCE_S)


async def filled(you: Visit, boat: Boat, lines: int) -> None:
    """By the button beside the legend: what is left is on the map, and OK makes it the plan, which is sent and ordered."""
    page = you.page
    await page.until("delfim.depths()[0] > 40 && delfim.depths()[1] > 0.2", PATIENCE_S)
    await you.taps(await you.middle_of("document.querySelector('#depths button')"))
    words = await said(page, "is a gap")
    assert f"1 of {lines} lines done, 2 in part, {lines - 3} not begun" in words
    assert float(words.partition("covered, all together: ")[2].partition(" %")[0]) >= 90.0, words
    left = await page.value("delfim.survey()")
    assert left == lines - 1, "two of them in part"
    await you.picture("survey-gaps")
    before = await page.value("delfim.drawn().plan")
    await page.press("Escape")
    assert await page.value("delfim.drawn().plan") == before
    await you.taps(await you.middle_of("document.querySelector('#depths button')"))
    await said(page, "is a gap")
    await page.press("Enter")
    await page.until(f"delfim.drawn().plan < {before}")
    await sent(you, boat)
    await page.press("p")
    await boat.until(lambda state: state["mode"] == "path")
    await page.press(" ")
    await boat.until(lambda state: state["mode"] == "idle")


async def beside_the_area(you: Visit, boat: Boat) -> None:
    """The map's menu."""
    south, north = around(boat, ((-20.0, -120.0), (140.0, 120.0)))
    await you.page.value(f"delfim.fit({south[0]}, {south[1]}, {north[0]}, {north[1]})")
    await you.taps_the_sea(around(boat, ((130.0, 0.0),))[0])


async def another_operator(you: Visit, boat: Boat, lines: int) -> None:
    """A page that knows the mission alone, as it was read from the boat."""
    page = you.page
    await page.reload()
    await page.until("window.delfim && delfim.drawn().plan > 6 && delfim.areas() === 0", PATIENCE_S)
    await beside_the_area(you, boat)
    await you.chooses("Survey")
    await you.chooses("Fill the gaps")
    words = await said(page, "is a gap")
    assert f"0 of {lines - 1} lines done" in words, "none of those was sounded since"
    assert f"{SPACING_M:.1f} m apart" in words
    await page.press("Escape")


async def forgotten(you: Visit, folder: Path, boat: Boat) -> None:
    await beside_the_area(you, boat)
    await you.chooses("Screen")
    await you.chooses("Forget the depths")
    await you.page.until("delfim.depths()[0] === 0 && document.getElementById('depths').hidden", PATIENCE_S)
    assert [file.parent.name[:10] for file in folder.glob("sessions/soundings*/1.csv")] == ["soundings-"]


async def voyage(folder: Path, size: Size, picture: Picture) -> None:
    async with with_boat(folder, size, picture) as (you, boat, gateway):
        lines = await surveyed(you, boat)
        gateway.end(signal.SIGKILL)
        heard(lines, folder / "sessions/soundings")
        await asyncio.to_thread(gateway.start)
        await filled(you, boat, len(lines))
        gateway.end(signal.SIGKILL)
        await asyncio.to_thread(gateway.start)
        await another_operator(you, boat, len(lines))
        await forgotten(you, folder, boat)
        you.page.calls_in_vain = True


@pytest.mark.long
def test_the_gaps_of_a_survey_are_filled_also_after_console_and_page_were_started_again(tmp_path: Path) -> None:
    asyncio.run(voyage(tmp_path, PHONE, nothing))


def main(folder: Path) -> None:
    with tempfile.TemporaryDirectory(prefix="gaps-", ignore_cleanup_errors=True) as place:
        asyncio.run(voyage(Path(place), DESK, keeper(folder, "console")))
    shrink(folder.glob("console-survey-gaps.png"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
