"""How far a boat gets, and what its way home takes, on the map while its menu is open or it goes home. With a folder on its
command line it keeps a picture for docs/energy.md (`make pictures`).
"""

import asyncio
import sys
import tempfile
from collections.abc import Awaitable, Callable
from pathlib import Path

from tests.console.chain import PATIENCE_S, Boat, afloat
from tests.console.test_first_voyage import Visit, console
from tests.kit.pictures import keeper
from tests.services.browser import Page, shrink, tab

SEA = (
    *(
        "energy.capacity_wh=200",
        'sensors.names=["sysstat"]',
        "simulation.sea.current_mps=0.4",
        "simulation.sea.current_to_deg=60",
    ),
    *('failsafe.battery_low.action="warn"', 'failsafe.energy.action="warn"'),
)


async def shown(folder: Path, then: Callable[[Page, Boat], Awaitable[None]]) -> None:
    async with console(folder) as (_, _, port, url), tab() as page:
        await page.open(url, width=1200, height=800, scale=1.0)
        await page.call("Page.bringToFront")
        you = Visit(page, nothing, False)
        with afloat(folder / "1", 1, port, SEA) as boat:
            await you.sees("boat1")
            await boat.until(lambda state: (state["energy"] or {}).get("range_m"))
            await page.value("document.querySelector('#hint button')?.click()")
            await page.press("h")
            await boat.until(lambda state: state["mode"] == "heading")
            await page.press("5")
            await boat.until(lambda state: (state["energy"]["home_wh"] or 0.0) > 0.0)
            await page.until("delfim.reach(1).startsWith('reach: ')", PATIENCE_S)
            await page.press("Enter")
            await page.until("delfim.wayHome(1).endsWith(' Wh')", PATIENCE_S)
            await page.press("Escape")
            await then(page, boat)


async def nothing(*_: object) -> None:
    """No picture is kept."""


def test_the_range_and_what_the_way_home_takes_are_drawn_while_the_menu_is_open(tmp_path: Path) -> None:
    asyncio.run(shown(tmp_path, nothing))


def main(folder: Path) -> None:
    async def kept(page: Page, boat: Boat) -> None:
        """Of a boat that goes home, and has learnt of the current meanwhile."""
        await boat.sails_on(500)
        await page.press("l")
        await boat.until(lambda state: state["mode"] == "home")
        state = await boat.sails_on(150)
        far_deg = 1.1 * max(state["energy"]["range_m"]) / 111_200.0
        north, east = state["latitude_deg"], state["longitude_deg"]
        await page.value(f"delfim.fit({north - far_deg}, {east - far_deg}, {north + far_deg}, {east + far_deg})")
        await keeper(folder, "console")(page, "energy")

    with tempfile.TemporaryDirectory(prefix="energy-", ignore_cleanup_errors=True) as place:
        asyncio.run(shown(Path(place), kept))
    shrink(folder.glob("console-energy.png"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
