"""How far a boat gets, and what its way home takes, on the map while its menu is open or it goes home; and a mission that takes
more than is left. With a folder on its
command line it keeps a picture for docs/energy.md (`make pictures`).
"""

import asyncio
import sys
import tempfile
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from delfim.vehicle.operator.link import Link
from tests.console.chain import PATIENCE_S, Boat, afloat
from tests.console.test_first_voyage import Visit, console
from tests.kit.pictures import keeper
from tests.services.browser import Page, shrink, tab

Picture = Callable[[Page, str], Awaitable[None]]

SEA = (
    *(
        "energy.capacity_wh=200",
        'sensors.names=["sysstat"]',
        "simulation.sea.current_mps=0.4",
        "simulation.sea.current_to_deg=60",
    ),
    *('failsafe.battery_low.action="warn"', 'failsafe.energy.action="warn"'),
)


FAR = 'version = 1\nname = "far"\n' + "".join(
    f"[[waypoint]]\nlatitude_deg = {38.69 + 0.02 * (each % 2)}\nlongitude_deg = -9.21\n" for each in range(6)
)


async def shown(folder: Path, then: Callable[[Page, Boat], Awaitable[None]], picture: Picture) -> None:
    async with console(folder) as (_, _, port, url), tab() as page:
        await page.open(url, width=1200, height=800, scale=1.0)
        await page.call("Page.bringToFront")
        you = Visit(page, lambda name: picture(page, name), False)
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
            await page.until(r"/^home: [\d.]+ m, .*\d s, [\d.]+ of \d+ Wh$/.test(delfim.wayHome(1))", PATIENCE_S)
            await page.press("Escape")
            await then(page, boat)
            await asked_about(you, boat)


async def asked_about(you: Visit, boat: Boat) -> None:
    """A mission that takes more than is left, which the page asks about with its figure before it is sailed."""
    await you.page.press("b")
    await boat.until(lambda state: state["mode"] == "hold")
    with Link(boat.place / "command") as link:
        link.ask("mission", text=FAR)
    await you.page.until("delfim.drawn().aboard === 6 && delfim.drawn().plan === 6", PATIENCE_S)
    await you.page.press("y")
    await you.sees("the mission takes ")
    await you.sees("Wh with the way home, ")
    await you.picture("energy-asked")
    await you.chooses("Cancel")
    assert (await boat.sails_on(5))["mode"] == "hold"
    await you.page.press("y")
    await you.chooses("Sail it all the same")
    await boat.until(lambda state: state["mode"] == "play")


async def nothing(*_: object) -> None:
    """No picture is kept."""


@pytest.mark.long
def test_the_range_and_what_the_way_home_takes_are_drawn_while_the_menu_is_open(tmp_path: Path) -> None:
    asyncio.run(shown(tmp_path, nothing, nothing))


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
        await keep(page, "energy")

    keep = keeper(folder, "console")
    with tempfile.TemporaryDirectory(prefix="energy-", ignore_cleanup_errors=True) as place:
        asyncio.run(shown(Path(place), kept, keep))
    shrink(folder.glob("console-energy*.png"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
