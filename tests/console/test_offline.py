"""Planning with no boat anywhere, at the real gateway and in the real page: missions are drawn, checked by the boat's own code,
saved, loaded, and copied out of a recording.
"""

import asyncio
import os
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from pymavlink.dialects.v20 import common as mavlink

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.cooperative import Sliced
from delfim.base.errors import DelfimError
from delfim.base.input.untrusted import TEXT_BYTES
from delfim.console.boats.fleet import Fleet
from delfim.console.link.session import Session
from delfim.console.plans.dry_run import dry_run
from delfim.console.plans.plan_check import NO_FILE, verdict
from delfim.console.tapes.replay import open_tapes
from tests.console.fakeboat import FakeBoat
from tests.console.scenes import choose
from tests.console.test_gateway import opened
from tests.console.test_newcomer import PLANNED, Console, console

VEHICLE = Path(__file__).parents[2] / "etc/delfimx.toml"
CHECKED = "document.querySelector('#check:not([hidden])')?.innerText ?? ''"
SOUTH, WEST, NORTH, EAST = 38.680, -9.240, 38.690, -9.220
ENDLESS = "".join(f"[k{i}.a.b.c.d.e]\n" for i in range(55_000))  # takes all the time that a reader has


def place(north: float, east: float) -> dict[str, float]:
    return {"latitude_deg": SOUTH + north * 0.01, "longitude_deg": WEST + east * 0.02}


def plan(*places: tuple[float, float], **more: Any) -> dict[str, Any]:
    return {"name": "survey", "waypoints": [place(*each) for each in places], "fence": [], "obstacles": [], **more}


FENCE = [list(place(*each).values()) for each in ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))]
ROCK = place(0.5, 0.5) | {"radius_m": 20.0}
ABOUT = "19 min"  # 1.7 km
INSIDE = (0.2, 0.2), (0.2, 0.8), (0.8, 0.8)
WRONG = {
    "fence": plan(*INSIDE[:2], (1.2, 0.8), fence=FENCE),
    "obstacle": plan((0.2, 0.2), (0.8, 0.8), fence=FENCE, obstacles=[ROCK]),
    "no room to turn": plan((0.2, 0.2), (0.9999, 0.2), fence=FENCE),
    "too fast": plan(*INSIDE) | {"waypoints": [place(0.2, 0.2), place(0.3, 0.2) | {"speed_mps": 20.0}]},
    "one place twice": plan((0.2, 0.2), (0.2, 0.2)),
    "too far": plan((0.2, 0.2), (30.0, 0.2)),
    "crossed fence": plan(*INSIDE, fence=[FENCE[0], FENCE[2], FENCE[1], FENCE[3]]),
}


def judged(asked: dict[str, Any], vehicle: config.Vehicle | None = None, charts: tuple[dict[str, Any], ...] = ()) -> str:
    try:
        return f"well: {Sliced(verdict(asked, None, vehicle, charts)).finish()}"
    except DelfimError as error:
        return str(error)


@pytest.mark.parametrize("what", WRONG)
def test_the_check_refuses_in_the_words_of_the_boat_that_loads_the_plan(what: str) -> None:
    """A whole simulated boat loads it for the dry run."""
    asked = WRONG[what]
    first = asked["waypoints"][0]
    its = dry_run(VEHICLE, asked, (first["latitude_deg"], first["longitude_deg"]))
    assert not its["well"]
    assert its["track"] == []
    assert judged(asked, config.load(VEHICLE)).partition(": ")[2] == its["end"].partition(": ")[2]


def test_the_check_says_what_is_on_no_chart_and_whose_limits_it_took() -> None:
    west, south, east, north = WEST, SOUTH, WEST + 0.01, SOUTH + 0.01
    charts = ({"extent": (west, south, east, north)}, {"extent": (0.0, 0.0, 1.0, 1.0)})
    assert judged(plan(*INSIDE)) == f"well: about {ABOUT}; {NO_FILE}"
    assert judged(plan(*INSIDE), config.load(VEHICLE), charts) == f"well: about {ABOUT}; on no chart: waypoints 2, 3"
    assert judged(plan(INSIDE[0]), config.load(VEHICLE), charts) == "well: "
    many = [(0.05 * number, 0.9) for number in range(12)]
    words = judged(plan(*many), config.load(VEHICLE), charts)
    assert words.endswith("; on no chart: waypoints 1, 2, 3, 4, 5 and 7 more")


async def test_the_gateway_goes_on_while_a_mission_is_read_and_reads_none_that_is_too_long(tmp_path: Path) -> None:
    async with opened(tmp_path) as sea, sea.session.ws_connect(sea.url + "ws") as page:
        folder = tmp_path / "missions"
        folder.mkdir()
        (folder / "endless.toml").write_text(ENDLESS)
        (folder / "long.toml").write_text("#" * (TEXT_BYTES + 1))
        os.mkfifo(folder / "pipe.toml")
        answers: list[dict[str, Any]] = []
        for number, name in enumerate(("endless", "long", "pipe")):
            await page.send_json({"t": "mission", "seq": number, "boat": 0, "do": "load", "name": name})
        await page.send_json({"t": "mission", "seq": 3, "boat": 0, "do": "check", "mission": plan(*INSIDE)})
        while len(answers) < 4:
            answers.append(await sea.until(page, lambda m: m["t"] == "answer"))
        reasons = {each["seq"]: each["reason"] for each in answers}
        assert answers[-1]["seq"] == 0, "the others were answered while it was read"
        assert "too much time or memory" in reasons[0]
        assert "are not read" in reasons[1]
        assert "this is a pipe" in reasons[2]
        assert reasons[3] == f"about {ABOUT}"


async def test_a_mission_with_a_fence_is_drawn_checked_saved_and_loaded_without_a_boat(tmp_path: Path) -> None:
    charts = tmp_path / "charts"
    charts.mkdir()
    Image.new("RGB", (8, 8)).save(charts / "harbour.png")
    (charts / "harbour.pgw").write_text(f"0.00125\n0\n0\n-0.00125\n{WEST}\n{NORTH}\n")
    async with console(tmp_path) as it:
        page = it.page
        await view(it)
        await at(it, 0.5, 0.5, "Fence, obstacle, home", "Fence around here…")
        await page.press("Enter")
        await at(it, 0.47, 0.48, "Add waypoint")
        await it.page.until(f"({CHECKED}).includes('1 waypoint ') && ({CHECKED}).includes('in order')")
        await at(it, 0.9, 0.9, "Add waypoint")
        await it.page.until(
            f"({CHECKED}).includes('the leg to waypoint 2 leads out of the mission’s keep-in zone'.replace('’', \"'\"))"
        )
        assert await page.value("document.getElementById('check').dataset.state") == "wrong"
        await page.press("z", ("Control",))
        await at(it, 0.53, 0.52, "Add waypoint")
        await it.page.until(f"({CHECKED}).includes('2 waypoints') && ({CHECKED}).includes('in order')")
        assert NO_FILE in await page.value(CHECKED)
        await at(it, 0.48, 0.55, "Fence, obstacle, home", "Set home here")
        await named(it, "Yard", 0.1, 0.9, "Mission", "Save under a new name…")
        await it.said("saved: Yard; its home is not in the file")
        await page.open(it.url, width=1200, height=760, scale=1.0)
        await page.until("delfim.online()")
        await view(it)
        assert await page.value(PLANNED) == 0
        await at(it, 0.1, 0.9, "Mission", "Load", "Yard")
        await it.page.until(f"{PLANNED} === 2")
        await at(it, 0.9, 0.9, "Add waypoint")
        await it.page.until(f"({CHECKED}).includes('keep-in zone')")
        assert it.boats == []


@pytest.mark.long
def test_a_recorded_mission_and_a_recorded_track_become_plans(tmp_path: Path) -> None:
    clock = ManualClock(100.0)
    session = Session(tmp_path / "sessions", clock)
    fleet = Fleet(clock, lambda address, data: boat.hear(data), lambda message: None)
    fleet.record = session.put
    boat = FakeBoat(1, clock, lambda data: fleet.receive(1, data))
    boat.aboard[0] = [
        mavlink.MAVLink_mission_item_int_message(1, 1, n, 6, 16, 0, 1, 0, 3, 0, 0, 386_900_000 + 2000 * n, -92_150_000, 0)
        for n in range(3)
    ]
    for number in range(900):  # half a minute north, half a minute east, half a minute north
        clock.advance(0.1)
        boat.position[1 if 300 <= number < 600 else 0] += 300 // 20
        boat.tick()
        fleet.tick()
        session.tick()
    session.flush()

    async def told() -> None:
        async with console(tmp_path, open_tapes([tmp_path / "sessions"])) as it:
            page = it.page
            await page.until("document.querySelector('.chip') !== null")
            await page.press("End")
            await page.value("document.querySelector('#replay input').value = 1e12, 0")
            await it.page.until("delfim.ways() > 50")
            await named(it, "Again", None, None, "Copy its track as a mission…")
            await it.said("saved: Again")
            await page.press("ArrowRight")
            await it.page.until("delfim.drawn().plan === 3")
            await named(it, "Same", None, None, "Copy its mission…")
            await it.said("saved: Same")

    async def loaded() -> None:
        async with console(tmp_path) as it:
            await view(it)
            for name, count in (("Again", 4), ("Same", 3)):
                await at(it, 0.1, 0.9, "Mission", "Load", name)
                await it.page.until(f"{PLANNED} === {count} && ({CHECKED}).includes('in order')")

    asyncio.run(told())
    asyncio.run(loaded())


async def view(it: Console) -> None:
    await it.page.value(f"delfim.fit({SOUTH}, {WEST}, {NORTH}, {EAST})")


async def at(it: Console, north: float, east: float, *titles: str) -> None:
    """The menu of a place, by mouse."""
    where = place(north, east)
    x, y = await it.page.value(f"delfim.pixel({where['latitude_deg']}, {where['longitude_deg']})")
    await it.page.mouse((x, y))
    await choose(it.page, *titles)


async def named(it: Console, name: str, north: float | None, east: float | None, *titles: str) -> None:
    """An entry that asks for a name: of a place, or of the recorded boat."""
    if north is not None and east is not None:
        await at(it, north, east, *titles)
    else:
        await it.page.value("document.querySelector('.chip').click()")
        await choose(it.page, *titles)
    await it.page.until("document.activeElement.matches('.name')")
    await it.page.value("document.activeElement.select()")
    await it.page.call("Input.insertText", text=name)
    await it.page.press("Enter")
