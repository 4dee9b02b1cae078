"""An official chart on the page: what `delfim charts` makes is shown, a plan across it is refused with place and reason. With a
folder on its command line it keeps pictures for docs/charts.md (`make pictures`).
"""

import asyncio
import lzma
import sys
import tempfile
from pathlib import Path

import pytest

from delfim.__main__ import main as delfim
from tests.console.test_first_voyage import Visit
from tests.console.test_newcomer import console
from tests.console.test_survey_page import Picture, nothing
from tests.kit.pictures import keeper
from tests.services.browser import Page, shrink

ROOT = Path(__file__).parents[2]
CELL = ROOT / "tests/data/charts/US5OH10M.000.xz"
WEST, EAST = (41.760, -82.700), (41.760, -82.660)  # Pelee Island lies between them
WHARF = 41.762379, -82.692076
CHECKED = "document.getElementById('check').innerText"


def charted(folder: Path) -> Path:
    """The chart beside the console's own, and a boat's file that names it."""
    cell = folder / "US5OH10M.000"
    cell.write_bytes(lzma.decompress(CELL.read_bytes()))
    (folder / "charts").mkdir()
    words = ["--at", "41.76,-82.68", "--draught", "0.5", "--air-draught", "2", "-o", str(folder / "charts/pelee")]
    assert delfim(["charts", str(cell), *words]) == 0
    file = folder / "boat.toml"
    text = (ROOT / "etc/boats/otter.toml").read_text().replace("../missions", str(ROOT / "etc/missions"))
    file.write_text(f'{text}\n[fence]\nchart = "/log/upload/pelee.clearance"\n')
    return file


async def around(page: Page, place: tuple[float, float]) -> str:
    """A picture of what is drawn there."""
    x, y = await page.value(f"delfim.pixel({place[0]}, {place[1]})")
    clip = {"x": x - 15, "y": y - 15, "width": 30, "height": 30, "scale": 1}
    return str((await page.call("Page.captureScreenshot", clip=clip))["data"])


async def seen(folder: Path, picture: Picture, *, dark: bool) -> None:
    async with console(folder, vehicle=charted(folder), dark=dark) as it:
        page = it.page
        you = Visit(page, lambda name: picture(page, name), False)
        await page.value("delfim.fit(41.752, -82.705, 41.770, -82.655)")
        await page.until(f"delfim.why({WHARF[0]}, {WHARF[1]})?.startsWith('beacon Pelee Island West Wharf') ?? false", 200.0)
        assert await page.value("delfim.why(41.760, -82.703)") is None
        at = "document.getElementById('not-for-navigation').getBoundingClientRect()"
        assert await page.value(f"document.elementsFromPoint({at}.x + 9, {at}.y + 9)[0].closest('#map') !== null"), (
            "nothing covers it"
        )
        await you.sees("not for navigation")
        before = await around(page, WEST)
        await you.taps_the_sea(WEST)
        await you.chooses("Add waypoint")
        await page.until(f"{CHECKED}.includes('1 waypoint')", 200.0)
        await you.taps_the_sea(EAST)
        await you.chooses("Add waypoint")
        refused = f"{CHECKED}.includes('no-go water of chart US5OH10M edition 25') && {CHECKED}.includes('zone of confidence')"
        await page.until(f"{refused} && delfim.crossed() !== null", 200.0)  # a page that was cut off asks once more
        north, east = await page.value("delfim.crossed()")
        assert WEST[1] < east < EAST[1]
        assert abs(north - WEST[0]) < 1e-4
        await page.value("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
        assert await around(page, WEST) != before, "the chart lies below the plan"
        await you.picture("dangers-night" if dark else "dangers")
        await page.nothing_amiss()


@pytest.mark.parametrize("dark", [False, True], ids=["day", "night"])
@pytest.mark.long
def test_a_plan_across_an_island_is_refused_with_the_place_and_the_reason(dark: bool, tmp_path: Path) -> None:
    asyncio.run(seen(tmp_path, nothing, dark=dark))


def main(folder: Path) -> None:
    for dark in (False, True):
        with tempfile.TemporaryDirectory(prefix="dangers-") as place:
            asyncio.run(seen(Path(place), keeper(folder, "console"), dark=dark))
    shrink(folder.glob("console-dangers*.png"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
