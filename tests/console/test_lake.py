"""The depth of a lake (docs/lake.md), by the page alone: `delfim sim`, its console, its boat and its sounder, as a newcomer has
them. With a folder on its command line it keeps a picture of each step (`make pictures`).
"""

import asyncio
import contextlib
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.console.test_first_voyage import DESK, PATIENCE_S, Visit, stop
from tests.console.test_survey_page import Picture, nothing, said, typed
from tests.kit.pictures import keeper
from tests.services.browser import shrink, tab

ROOT = Path(__file__).parents[2]
LAKE = str(ROOT / "etc/lake.toml")
AREA = ((6.0, -8.0), (6.0, -56.0), (40.0, -54.0), (42.0, -6.0))  # metres north and east of where the boat lies
ISLAND = ((22.0, -30.0), (22.0, -33.0), (25.0, -33.0), (25.0, -30.0))
SPACING_M, SPEED_MPS = 10, 2
PLUGGED, HOME = 0.15, 0.3  # of the area that is covered, when the plug is pulled, and when the boat goes home
NORTH_M = 1 / 111_132
MODE = "document.querySelector('.chip .mode').textContent.toLowerCase()"
COVERED = "delfim.depths()[1]"


def command(*words: str) -> list[str]:
    return [sys.executable, "-m", "delfim", *words]


@contextlib.contextmanager
def simulation(folder: Path) -> Iterator[str]:
    """`delfim sim etc/lake.toml --console` in a terminal of its own, until Ctrl-C; the console's address."""
    ports = "--page", "127.0.0.1:0", "--output", str(folder)
    bus = "--set", f"simulation.interface=canloop:lake-{folder.parent.name[-12:]}"
    words = command("sim", LAKE, "--console", "--no-browser", "--plain", *ports, *bus)
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, bufsize=1) as running:
        assert running.stdout is not None
        try:
            yield next(line for line in running.stdout if "the console is at " in line).split("is at ")[1].split(";")[0]
        finally:
            running.send_signal(signal.SIGINT)
            running.communicate(timeout=60.0)


def place(north_m: float, east_m: float) -> tuple[float, float]:
    """That many metres from the boat's start."""
    return 38.6907 + north_m * NORTH_M, -9.2153 + east_m * NORTH_M / 0.7806


async def rung(you: Visit, corners: tuple[tuple[float, float], ...], title: str) -> None:
    """Corners by click, the first one again at last."""
    places = [place(*corner) for corner in corners]
    await you.taps_the_sea(places[0])
    await you.chooses("Survey")
    await you.chooses(title)
    for each in (*places, places[0]):
        await you.taps_the_sea(each)


async def planned(you: Visit) -> None:
    """An area, then its hole; both times the form shows the lines."""
    page = you.page
    await rung(you, AREA, "Draw an area")
    await typed(page, 0, str(SPACING_M))
    await typed(page, 9, str(SPEED_MPS))
    await said(page, f"{SPACING_M}.0 m apart")
    await you.picture("area")
    await page.press("Enter")
    await rung(you, ISLAND, "Draw a hole")
    words = await said(page, "about holes and fences are left")
    assert "covered: 9" in words or "covered: 100" in words
    await you.picture("lines")
    await page.press("Enter")
    await you.sees("in order")


async def sailed(you: Visit) -> None:
    """Sent and ordered in one; depths come, and the boat's program dies on the way."""
    page = you.page
    await page.press("p")
    await you.sees("The plan is not aboard")
    await you.picture("asked")
    await you.chooses("Send the plan, then follow it")
    await page.until(f"{MODE} === 'path'", PATIENCE_S)
    await page.until(f"{COVERED} > {PLUGGED}", PATIENCE_S)


async def restarted(you: Visit, folder: Path) -> None:
    """The plug is pulled: the boat comes back with its survey, holds, and goes on when it is told to."""
    page = you.page
    done = await asyncio.to_thread(
        subprocess.run, command("fault", LAKE, "restarted", "--sim-in", str(folder)), capture_output=True, text=True, check=True
    )
    assert "starts again by itself" in done.stdout
    await you.sees("restarted: it was in path")
    await you.picture("plug")
    await page.press("k")
    await page.press("c")
    await page.until(f"{MODE} === 'path'", PATIENCE_S)


async def filled(you: Visit, whole: bool) -> None:
    """Home before the end; then what is left: the whole of it, or its beginning."""
    page = you.page
    await page.until(f"{COVERED} > {0.4 if whole else HOME}", PATIENCE_S)
    await you.picture("depths")
    await page.press("l")
    await page.until(f"{MODE} === 'home'", PATIENCE_S)
    await page.until(f"{MODE} === 'hold'", PATIENCE_S)
    await you.taps(await you.middle_of("document.querySelector('#depths button')"))
    await said(page, "is a gap")
    await you.picture("gaps")
    await page.press("Enter")
    await you.sees("in order")
    await page.press("p")
    await you.chooses("Send the plan, then follow it")
    await page.until(f"{MODE} === 'path'", PATIENCE_S)
    await page.until(f"{MODE} === 'hold'" if whole else f"{COVERED} > {HOME + 0.1}", PATIENCE_S)
    assert not whole or await page.value(COVERED) > 0.7
    await you.picture("covered")
    await stop(you)
    await page.until(f"{MODE} === 'idle'", PATIENCE_S)


async def charted(you: Visit, folder: Path) -> None:
    """The report of the chart, in the browser."""
    chart = folder.parent / "chart"
    words = command("survey", "chart", str(folder), "-o", str(chart))
    done = await asyncio.to_thread(subprocess.run, words, capture_output=True, text=True, check=True)
    assert "soundings" in done.stdout
    await you.page.open((chart / "report.html").as_uri(), width=DESK[0], height=DESK[1], scale=1.0)
    await you.picture("report")


async def lake(folder: Path, picture: Picture, whole: bool = False) -> None:
    with simulation(folder / "sim") as url:
        async with tab() as page:
            await page.open(url, width=DESK[0], height=DESK[1], scale=1.0)
            await page.call("Page.bringToFront")
            you = Visit(page, lambda name: picture(page, name), False)
            await you.sees("Depth")
            await you.sees("no mission aboard")
            low, high = place(-4.0, -75.0), place(52.0, 35.0)
            await page.value(f"delfim.fit({low[0]}, {low[1]}, {high[0]}, {high[1]})")
            await you.picture("boat")
            await planned(you)
            await sailed(you)
            await restarted(you, folder / "sim")
            await filled(you, whole)
            await page.nothing_amiss()
    async with tab() as page:
        await charted(Visit(page, lambda name: picture(page, name), False), folder / "sim")
        await page.nothing_amiss()


@pytest.mark.long
def test_who_follows_the_document_has_the_depth_of_a_lake(tmp_path: Path) -> None:
    asyncio.run(lake(tmp_path, nothing))


def main(folder: Path) -> None:
    with tempfile.TemporaryDirectory(prefix="lake-", ignore_cleanup_errors=True) as place:
        asyncio.run(lake(Path(place), keeper(folder, "lake"), whole=True))
    shrink(folder.glob("lake-*.png"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
