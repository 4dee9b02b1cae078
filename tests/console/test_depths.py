"""Depths on the page: told by a boat, kept over a reload, with what of an area is not covered. With a folder on its command
line it keeps a picture for docs/survey.md (`make pictures`).
"""

import asyncio
import base64
import math
import sys
import tempfile
import time
from array import array
from pathlib import Path
from typing import Any

import pytest

from delfim.base.clock import ManualClock
from delfim.console.boats.depths import CELL_M, SIDE, TILES_MAX, DepthGrid
from delfim.console.boats.soundings import PENDING_MAX, SoundingFiles
from delfim.survey.chart.reduction import good_places
from tests.console.chain import PATIENCE_S, afloat
from tests.console.scenes import opened, show
from tests.console.standin import Standin, boat, place
from tests.console.test_first_voyage import DESK, console
from tests.kit.pictures import keeper
from tests.services.browser import Page, browser, shrink, tab

SOUNDER = 'nmea2000.interface="canloop:depths"', 'sensors.names=["sysstat", "nmea2000"]', "simulation.sea_bed.mean_m=7"
SPACING_M, LONG_M, LINES = 10.0, 180.0, 9


def told(grid: DepthGrid) -> dict[tuple[int, ...], "array[int]"]:
    """The cells of each tile, cm."""
    return {tuple(each["tile"]): array("H", base64.b64decode(each["whole"])) for each in grid.whole()}


def test_a_cell_has_the_mean_of_what_was_told_in_it_and_pages_hear_what_changed() -> None:
    grid = DepthGrid()
    for depth_m in (4.0, 5.0):
        grid.add(38.69, -9.215, depth_m)
    (change,) = grid.changes()
    assert [depth_cm for _, depth_cm in change["cells"]] == [450]
    assert list(grid.changes()) == []
    grid.add(38.69, -9.215, 6.0)
    (change,) = grid.changes()
    ((cell, depth_cm),) = change["cells"]
    assert depth_cm == 500
    assert told(grid)[tuple(change["tile"])][cell] == 500
    west, south, east, north = change["extent"]
    assert (west, south) < (-9.215, 38.69) < (east, north)
    high_m, wide_m = (north - south) * 111_132.0 / SIDE, (east - west) * 111_132.0 * math.cos(math.radians(38.69)) / SIDE
    assert (round(high_m, 2), round(wide_m, 1)) == (CELL_M, CELL_M)


def test_what_is_no_depth_is_dropped_and_the_tiles_are_bounded() -> None:
    grid = DepthGrid()
    for wrong in (
        (95.0, 0.0, 3.0),
        (0.0, 181.0, 3.0),
        (38.0, 0.0, math.nan),
        (38.0, 0.0, -1.0),
        (38.0, 0.0, 1e9),
        (math.nan, 0.0, 3.0),
    ):
        grid.add(*wrong)
    assert list(grid.whole()) == []
    for column in range(TILES_MAX + 5):
        grid.add(38.69, -9.0 + 0.01 * column, 3.0)
    assert len(list(grid.whole())) == TILES_MAX
    for _ in range(70_000):  # more than a cell counts
        grid.add(38.69, -9.0 + 0.01 * 50, 3.0)
    assert max(max(cells) for cells in told(grid).values()) == 300


def test_what_was_heard_is_there_again_after_a_restart_and_a_torn_line_is_cut_off(tmp_path: Path) -> None:
    clock = ManualClock(time_ns=time.time_ns())
    files = SoundingFiles(tmp_path, clock)
    for number in range(5):
        clock.advance(0.5)
        files.put(number % 2 + 1, 38.69 + number * 1e-5, -9.215, 4.0 + number)
    assert [file.name for file in files.files()] == ["1.csv", "2.csv"]
    with (tmp_path / "soundings/1.csv").open("a") as out:
        out.write("1790000000.0,38.69")
    again = SoundingFiles(tmp_path, clock)
    assert sorted(each.depth_m for each in again.read()) == [4.0, 5.0, 6.0, 7.0, 8.0]
    again.put(1, 38.69, -9.215, 9.0)
    places = [round(north_deg, 5) for north_deg, _ in good_places(again.files()[0])]
    assert {38.69002, 38.69004} <= {*places}, "as the log of a boat is read"
    assert len(list(SoundingFiles(tmp_path, clock).read())) == 6
    clock.step(8 * 86400.0)
    assert list(SoundingFiles(tmp_path, clock).read()) == [], "of a survey of last month nothing counts"
    assert SoundingFiles(tmp_path, clock).files() == []
    assert len(list(tmp_path.glob("soundings-*/*.csv"))) == 2


def test_a_disk_that_takes_nothing_is_told_and_the_rows_wait_bounded(tmp_path: Path) -> None:
    (tmp_path / "soundings").write_text("no folder")
    files = SoundingFiles(tmp_path, ManualClock())
    for _ in range(PENDING_MAX + 5):
        files.put(1, 38.69, -9.215, 4.0)
    files.tick()
    assert "soundings" in files.reason
    (tmp_path / "soundings").unlink()
    files.flush()
    assert files.reason == ""
    assert len((tmp_path / "soundings/1.csv").read_text().splitlines()) == PENDING_MAX + 1


async def heard(folder: Path) -> None:
    async with console(folder) as (_, _, port, url), tab() as page:
        await page.open(url, width=DESK[0], height=DESK[1], scale=1.0)
        with afloat(folder / "1", 1, port, SOUNDER) as boat:
            state = await boat.until(lambda state: state["measured"].get("depth_m"))
            await page.until("delfim.depths()[0] > 0", PATIENCE_S)
            labels = await page.value("document.getElementById('depths').innerText")
            assert "m" in labels
            assert not await page.value("document.getElementById('depths').hidden")
            count = (await page.value("delfim.depths()"))[0]
            await page.reload()
            await page.until(f"window.delfim !== undefined && delfim.depths()[0] >= {count}", PATIENCE_S)
            assert state


@pytest.mark.long
def test_the_depths_of_a_boat_are_on_the_page_and_there_again_after_a_reload(tmp_path: Path) -> None:
    asyncio.run(heard(tmp_path))


def surveyed(lines: int) -> DepthGrid:
    """So many lines to the north, a sounding a metre and a half, over a slope with a bank."""
    grid = DepthGrid()
    for line in range(lines):
        for step in range(int(LONG_M / 1.5)):
            north_m, east_m = 1.5 * step, SPACING_M * line
            bank_m = 3.5 * math.exp(-((north_m - 110.0) ** 2 + (east_m - 50.0) ** 2) / 900.0)
            grid.add(*place(north_m, east_m), 4.0 + north_m / 40.0 + east_m / 60.0 - bank_m)
    return grid


def area() -> dict[str, Any]:
    outline = [
        list(place(*corner))
        for corner in ((0.0, -5.0), (LONG_M, -5.0), (LONG_M, SPACING_M * LINES - 5.0), (0.0, SPACING_M * LINES - 5.0))
    ]
    values = [SPACING_M, 0, 20, 0, 0, 0, 0, 0, 0, 0]
    return {
        "name": "Bay",
        "waypoints": [],
        "fence": [],
        "obstacles": [],
        "home": None,
        "survey": {"areas": [[outline, []]], "values": values},
    }


async def shown(page: Page, folder: Path | None) -> None:
    """Six of nine lines are sounded: the rest is a gap, and the page says how much is covered."""
    async with Standin([boat(1, "Delfim", "#2e86ab", north_m=90, east_m=55)]).serving() as gateway:
        gateway.plans[1] = area()
        await opened(page, gateway, width=DESK[0], height=DESK[1])
        await show(page, -20, -60, LONG_M + 20, 160)
        for each in surveyed(6).whole():
            await gateway.tell(each)
        await caught_up_with(page, gateway, "delfim.depths()[1] > 0")
        cells, covered = await page.value("delfim.depths()")
        assert 200 < cells < 240
        assert abs(covered - 6 / 9) < 0.06
        assert "% covered" in await page.value("document.getElementById('depths').innerText")
        if folder is not None:
            await keeper(folder, "console")(page, "depths")
        for each in surveyed(LINES).whole():
            await gateway.tell(each)
        await caught_up_with(page, gateway, "delfim.depths()[1] === 1")


async def caught_up_with(page: Page, gateway: Standin, expression: str) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while not await page.value(expression):
            await gateway.frame()
            await asyncio.sleep(0.05)


@pytest.mark.long
async def test_the_page_tells_what_of_an_area_is_covered_and_shows_the_gaps() -> None:
    async with tab() as page:
        await shown(page, None)


def main(folder: Path) -> None:
    async def keep() -> None:
        with tempfile.TemporaryDirectory(prefix="depths-", ignore_cleanup_errors=True) as place_of_browser:
            async with browser(Path(place_of_browser)) as page:
                await shown(page, folder)

    asyncio.run(keep())
    shrink(folder.glob("console-depths.png"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
