"""A payload's values on the page of a real boat, by link and gateway: as words, as a graph, by colour along the track; and the
program stopped and started from there. With a folder on its command line it keeps a picture (`make pictures`).
"""

import asyncio
import json
import sys
import tempfile
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from tests.console.chain import afloat
from tests.console.scenes import choose
from tests.console.test_first_voyage import DESK, PATIENCE_S, console
from tests.kit.pictures import keeper
from tests.services.browser import Page, shrink, tab

TELLS = r"""n=1800
while read a && read b; do
  n=$((n + 1))
  echo '{"command": "tell", "values": {"water_c": '$((n / 100)).$((n / 10 % 10))$((n % 10))'}}'
done"""  # warmer with each second line of navigation
PROBE = f"""payload.probe={{command=["/bin/sh", "-c", {json.dumps(TELLS)}], may=["values"], shown=["water_c"]}}"""
Keep = Callable[[Page, str], Awaitable[None]]
BARE = 700.0, 120.0


async def ordered(page: Page, title: str) -> None:
    """From the boat's menu, once it has told its orders."""
    found = f"[...document.querySelectorAll('.item .title')].some(each => each.textContent === '{title}')"
    while not await page.value(found):
        await page.press("Escape")
        await page.press("Enter")
        await choose(page, "More")
    await choose(page, title)


async def voyage(folder: Path, picture: Keep | None) -> None:
    async with console(folder) as (_, _, port, url), tab() as page:
        await page.open(url, width=DESK[0], height=DESK[1], scale=1.0)
        await page.call("Page.bringToFront")
        with afloat(folder / "1", 1, port, (PROBE,)) as boat:
            await page.until("window.delfim !== undefined && delfim.values().water_c > 0", PATIENCE_S)
            await page.press("h")
            await page.press("8")
            await boat.until(lambda state: state["mode"] == "heading" and state["speed_mps"] > 1.0)
            await page.mouse(BARE)
            await choose(page, "Screen", "Colour of the tracks", "water_c")
            await page.mouse(BARE)
            await choose(page, "Screen", "The last ten minutes")
            count = await page.value("delfim.values().water_c")
            await page.until(f"delfim.values().water_c > {count + (30 if picture else 5)}", PATIENCE_S)
            await page.until("document.querySelector('#timeline figcaption')?.textContent.startsWith('water ')", PATIENCE_S)
            assert "°C" in await page.value("document.getElementById('values').innerText")
            if picture:
                await picture(page, "values")
            await ordered(page, "Stop probe")
            state = await boat.until(lambda state: state["resting"] == ["probe"] and state["age_s"]["probe.water_c"] > 3.0)
            last = state["measured"]["probe.water_c"]
            await ordered(page, "Start probe")
            await boat.until(lambda state: state["measured"]["probe.water_c"] < last)
        await page.nothing_amiss()


@pytest.mark.long
def test_a_payloads_values_are_on_the_page_and_it_is_stopped_and_started_there(tmp_path: Path) -> None:
    asyncio.run(voyage(tmp_path, None))


def main(folder: Path) -> None:
    async def kept() -> None:
        with tempfile.TemporaryDirectory(prefix="voyage-", ignore_cleanup_errors=True) as place:
            its = keeper(folder, "console")
            await voyage(Path(place), its)

    asyncio.run(kept())
    shrink(folder.glob("console-values.png"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
