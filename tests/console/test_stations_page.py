"""Stations on the page: edited in a waypoint's form, and on the map with what the boat says of their samples. With a folder on
its command line it keeps a picture for docs/missions.md (`make pictures`).
"""

import asyncio
import sys
import tempfile
from pathlib import Path

from delfim.console.boats.boat import Boat
from tests.console.scenes import opened, show, waypoints
from tests.console.standin import Message, Standin, place
from tests.console.standin import boat as boat_of_page
from tests.kit.page import planned, sailing, shown
from tests.kit.pictures import keeper
from tests.services.browser import Page, browser, shrink

DESK = (1200, 760)
CORNERS = [(-60, -60), (30, -60), (60, 10), (0, 30)]
FIELDS = "document.querySelectorAll('.popup .field input')"
WAITS = "sample 4 is asked for, try 2 of 3"


def test_a_station_is_what_the_boat_said_of_it_last() -> None:
    boat = Boat(1, 0.0)
    for words in (
        "station: waypoint 1: sample 1 is asked for, try 1 of 2",
        "station: waypoint 1: payload pump has sample 1: 500 ml",
        "station: waypoint 2: sample 2 is asked for, try 1 of 2",
        "station: waypoint 2: payload pump: no water",
        "station: waypoint 2: sample 3 is asked for, try 2 of 2",
        "station: waypoint 2: no sample: no answer for 20 s",
        "station: waypoint 3: sample 4 is asked for, try 1 of 1",
        "station: waypoint 3: payload pump: is wet",
        "station: waypoint 4: something else",
        "station: waypoint 9999: sample 4 is asked for, try 1 of 1",
        "play: operator",
    ):
        boat.take_station(words)
    states = {number: each["state"] for number, each in boat.snapshot(1.0)["stations"].items()}
    assert states == {1: "sampled", 2: "failed", 3: "waiting"}
    assert boat.stations[1]["words"] == "payload pump has sample 1: 500 ml"


def sea() -> Standin:
    gateway = Standin([boat_of_page(1, "Delfim", "#2e86ab", north_m=25, east_m=-50, mode="play")])
    gateway.plans[1] = {"name": "Samples", "waypoints": waypoints(CORNERS), "fence": [], "obstacles": [], "home": None}
    return gateway


async def typed(page: Page, field: int, words: str) -> None:
    await page.value(f"(i => {{ i.value = '{words}'; i.dispatchEvent(new Event('input')); }})({FIELDS}[{field}])")


async def edited(page: Page, gateway: Standin) -> Message:
    """Three tries of a minute at the second waypoint, and then a servo; the keyboard does it, too."""
    await shown(page, gateway, "delfim.drawn().plan === 4")
    assert await page.value("delfim.stations()") == []
    x, y = await page.value("delfim.pixel({}, {})".format(*place(*CORNERS[1])))
    await page.mouse((x, y))
    for key in ("ArrowDown", "ArrowDown", "Enter"):
        await page.press(key)
    for field, words in enumerate(("3", "40", "183", "9", "1900")):
        await typed(page, field, words)
    await page.press("Enter")
    return await planned(gateway, lambda stops: stops[1].get("tries") == 3)


async def voyage(page: Page, gateway: Standin, folder: Path | None) -> None:
    mission = await edited(page, gateway)
    stop = mission["waypoints"][1]
    assert (stop["hold_s"], stop["actions"]) == (40, [{"command": 183, "params": [9, 1900, 0, 0]}])
    await shown(page, gateway, "delfim.stations().join() === 'ahead'")
    for number, tries in ((0, 1), (2, 2)):
        mission["waypoints"][number] |= {"tries": tries, "hold_s": 60.0}
    its = gateway.boats[0]
    its["mission"] = {"name": "Samples", "count": 4, "current": 1, "state": "same", "digest": "1"}
    its["stations"] = {"1": {"state": "sampled", "words": "500 ml"}, "2": {"state": "waiting", "words": WAITS}}
    gateway.plans[1] = gateway.aboard[1] = mission
    await gateway.tell({"t": "mission", "boat": 1, "where": "aboard", "mission": mission})
    await gateway.tell({"t": "mission", "boat": 1, "where": "here", "mission": mission})
    await shown(page, gateway, "delfim.stations().join() === 'sampled,waiting,ahead'")
    x, y = await page.value("delfim.pixel({}, {})".format(*place(*CORNERS[1])))
    await page.mouse((x, y))
    await shown(
        page, gateway, f"document.querySelector('.popup').innerText.includes('3 tries of 40 s · action 183 servo · {WAITS}')"
    )
    for key in ("ArrowDown", "ArrowDown", "Enter"):
        await page.press(key)
    assert [await page.value(f"{FIELDS}[{field}].value") for field in range(4)] == ["3", "40 s", "183 servo", "9"]
    if folder is not None:
        await page.value("document.querySelector('#hint button')?.click()")
        await keeper(folder, "console")(page, "stations")
    await page.press("Escape")
    its["stations"]["2"] = {"state": "failed", "words": "no sample: no answer for 40 s"}
    await shown(page, gateway, "delfim.stations().join() === 'sampled,failed,ahead'")


async def test_a_station_is_edited_in_the_form_of_its_waypoint_and_shown_as_it_is_sampled() -> None:
    gateway = sea()
    async with sailing(gateway) as page:
        await voyage(page, gateway, None)


def main(folder: Path) -> None:
    async def keep() -> None:
        gateway = sea()
        with tempfile.TemporaryDirectory(prefix="stations-", ignore_cleanup_errors=True) as home:
            async with gateway.serving(), browser(Path(home)) as page:
                await opened(page, gateway, width=DESK[0], height=DESK[1])
                await show(page, -120, -120, 120, 120)
                await voyage(page, gateway, folder)

    asyncio.run(keep())
    shrink(folder.glob("console-stations.png"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
