"""A boat that is not as its file says is adopted by the page alone: `delfim sim --truth --console`, a real browser, gateway,
link and boat, in real time. STOP interrupts the trial, *Adopt…* goes on with it; what was found is written and shown, and the
boat that is started again with it sails the proof. With a folder on its command line it keeps pictures (`make pictures`).
"""

import asyncio
import contextlib
import json
import signal
import subprocess
import sys
import tempfile
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import pytest

from bench.layouts import LAYOUTS
from delfim import config
from delfim.adoption.writing import Key, changed
from delfim.simulator.tables import Simulation
from tests.adoption.test_several import text_of
from tests.console.test_adopt_page import BOX, Picture, begun, button, nothing
from tests.console.test_first_voyage import DESK, Visit, stop
from tests.kit.pictures import keeper
from tests.services.browser import Page, shrink, tab

ROOT = Path(__file__).parents[2]
STARTS_S, WHOLE_S = 120.0, 1500.0
OUTPUT, FOUND_AT = "output.txt", "the console is at "
AGAIN = 6  # times that a trial may be begun: a busy machine falls silent, and the boat ends it
GOES_ON, TRIES_AGAIN = "the same goes on with it", "the same command tries again"  # what it says then
REFUSED = "The hull is not adopted: the motion does not follow from the commands"
NOISE = {"position_noise_m": 0.5, "speed_noise_mps": 0.03, "heading_noise_deg": 1.0}
OFFSET_DEG, HARD = 9.0, 0.08  # of the compass of the boat in the water

# What is otherwise in the water than the files say.
TWIN: dict[Key, Any] = {
    ("thrusters", "starboard", "address"): 1,
    ("thrusters", "port", "address"): 0,
    ("thrusters", "port", "reversed"): True,
    ("thrusters", "starboard", "thrust_n"): [-18.0, 34.0],
    ("thrusters", "port", "thrust_n"): [-18.0, 32.0],
    ("thrusters", "starboard", "dead"): 0.06,
    ("thrusters", "port", "dead"): 0.06,
}
STEERED: dict[Key, Any] = {
    ("thrusters", "outboard", "reversed"): True,
    ("thrusters", "outboard", "steer"): {
        "kind": "azimuth",
        "address": 1,
        "angle_max_deg": 35.0,
        "rate_dps": 20.0,
        "reversed": True,
    },
    ("boat", "mass_kg"): 340.0,
}
BENT: dict[Key, Any] = {("compass", "hard_ahead"): HARD, ("compass", "offset_deg"): OFFSET_DEG}
PAIRS: dict[Key, Any] = {  # a motor of starboard and one of port are exchanged
    ("thrusters", "bow_starboard", "address"): 1,
    ("thrusters", "bow_port", "address"): 0,
    ("thrusters", "bow_port", "reversed"): True,
    ("thrusters", "stern_port", "reversed"): True,
}
CORNERS: dict[Key, Any] = {  # all but one stand elsewhere
    ("thrusters", "bow_starboard", "address"): 2,
    ("thrusters", "bow_port", "address"): 0,
    ("thrusters", "stern_starboard", "address"): 1,
    ("thrusters", "stern_starboard", "reversed"): True,
}
BOATS = {"heron": TWIN | BENT, "skiff": STEERED | BENT, "pairs": PAIRS | BENT, "float": CORNERS}


def files(folder: Path, boat: str) -> tuple[Path, Path]:
    """The boat's file, and that of the boat in the water."""
    text = text_of(LAYOUTS[boat]) if boat in LAYOUTS else (ROOT / f"etc/boats/{boat}.toml").read_text()
    mission = str(ROOT / "etc/missions/doca.toml")
    told: dict[Key, Any] = {("simulation", key): value for key, value in NOISE.items()} | {("simulation", "mission"): mission}
    told |= {("adopted", "proven"): False}
    mine, truth = folder / f"{boat}.toml", folder / "truth.toml"
    for file, keys in ((mine, told), (truth, told | BOATS[boat])):
        file.write_text(changed(text, {key: (value, "of a test") for key, value in keys.items()}, boat))
        config.load(file)
    return mine, truth


@contextlib.contextmanager
def running(folder: Path, file: Path, truth: Path) -> Iterator[subprocess.Popen[bytes]]:
    words = [str(file), "--truth", str(truth), "--console", "--no-browser", "--plain", "--output", str(folder / "sim")]
    with (folder / OUTPUT).open("w") as told:
        command = [sys.executable, "-u", "-m", "delfim", "sim", *words]
        program = subprocess.Popen(command, cwd=folder, stdout=told, stderr=subprocess.STDOUT)
        try:
            yield program
        finally:
            program.send_signal(signal.SIGINT)
            program.wait(200)


@contextlib.asynccontextmanager
async def simulation(folder: Path, file: Path, truth: Path) -> AsyncIterator[str]:
    """The boat, the boat in the water, and the console; where its page is."""
    with running(folder, file, truth) as program:
        async with asyncio.timeout(STARTS_S):
            while FOUND_AT not in (told := (folder / OUTPUT).read_text()):
                assert program.poll() is None, told
                await asyncio.sleep(0.1)
        yield told.split(FOUND_AT)[1].split()[0].rstrip(";")


@contextlib.asynccontextmanager
async def visit(url: str, name: str, picture: Picture) -> AsyncIterator[Visit]:
    width, height, night = DESK
    async with tab() as page:
        await page.open(url, width=width, height=height, scale=1.0, dark=night)
        await page.call("Page.bringToFront")
        you = Visit(page, lambda step: picture(page, step), False)
        await you.sees(name)
        await page.until("Boolean(document.querySelector('[data-boat] .mode')?.textContent)")
        await page.value("document.querySelector('#hint button')?.click()")
        yield you


async def answered(you: Visit, *, stops: bool = False) -> str:
    """Answer each question with yes until the trial is over; what stands in its box then. `stops`: STOP in the slow circle."""
    asked = f"({BOX}.querySelector('.question')?.textContent ?? '')"
    over = f"{BOX}.querySelector('header span')?.textContent === 'over'"
    circle = f"{json.dumps(stops)} && [...{BOX}.querySelectorAll('li')].some(each => each.textContent.includes('circle'))"
    while True:
        await you.page.until(f"{asked} !== '' || {over} || {circle}", WHOLE_S)
        if not await you.page.value(over) and await you.page.value(circle):
            await stop(you)
            await you.page.until(over, WHOLE_S)
        if await you.page.value(over):
            return str(await you.page.value(f"{BOX}.innerText"))
        was = await you.page.value(asked)
        await button(you.page, "Yes")
        await you.page.until(f"{asked} !== {json.dumps(was)}")


async def whole(you: Visit) -> str:
    """Begin, be stopped in a slow circle, go on until all was sailed and is written."""
    is_stopped = False
    for _ in range(AGAIN):
        await begun(you)
        if is_stopped:
            assert "Goes on with" in await you.page.value(f"{BOX}.innerText")
        told = await answered(you, stops=not is_stopped)
        if GOES_ON not in told:
            assert is_stopped, told
            return told
        is_stopped = is_stopped or "The trial ended: STOP" in told
        await closed(you)
    raise AssertionError(f"it was never whole: {told}")


async def motors_found(folder: Path, boat: str) -> None:
    """The whole way of a boat whose hull is kept as its file has it."""
    file, truth = files(folder, boat)
    its = folder / "sim/console" / file.name
    async with simulation(folder, file, truth) as url, visit(url, config.load(file).boat.name, nothing) as you:
        told = await gone_through(you, GOES_ON)
        assert "The motor that bow_port reaches is that of stern_starboard." in told
        assert "Hull, compass and gains stay as they are: her thrusters push across" in told
        _wired(config.load(its), config.load(truth))
        await you.page.nothing_amiss()


async def gone_through(you: Visit, again: str) -> str:
    """Begin, and begin again where it says so; what is told at the end."""
    for _ in range(AGAIN):
        await begun(you)
        if again not in (told := await answered(you)):
            break
        await closed(you)
    return told


async def closed(you: Visit) -> None:
    await button(you.page, "Close")
    await you.page.until(f"{BOX}.hidden")


async def seen(page: Page, link: str) -> str:
    """What a link of the box leads to."""
    found = f"[...{BOX}.querySelectorAll('a')].find(each => each.textContent === '{link}').href"
    return str(await page.value(f"fetch({found}).then(answer => answer.text())"))


async def adopted(folder: Path, boat: str, picture: Picture) -> None:
    """The whole way of a boat."""
    file, truth = files(folder, boat)
    name, its = config.load(file).boat.name, folder / "sim/console" / file.name
    async with simulation(folder, file, truth) as url, visit(url, name, picture) as you:
        told = await whole(you)
        assert await seen(you.page, "Download her file") == its.read_text()
        _wired(config.load(its), config.load(truth))
        assert "found" not in file.read_text(), "what is found of a simulated boat is not written into the file of the real one"
        if REFUSED in told:  # in real time on a busy machine she moves later than her commands say
            assert not config.load(its).of(Simulation).hull.mass_kg, "nothing of a refused fit is written"
            return
        assert "then goes on with the proof sail" in told, told
        report = await seen(you.page, "Report")
        assert "Gains, tried on the twin" in report
        await you.page.nothing_amiss()
        await you.picture("adopted")
        href = await you.page.value(f"[...{BOX}.querySelectorAll('a')].find(each => each.textContent === 'Report').href")
        await you.page.open(href, width=DESK[0], height=DESK[1], scale=1.0)
        await you.picture("adopted-report")
    _bent(config.load(its))
    await proven(folder, its, truth, picture)


async def proven(folder: Path, its: Path, truth: Path, picture: Picture) -> None:
    """The boat is started again with what was found, and sails the proof."""
    async with simulation(folder, its, truth) as url, visit(url, config.load(its).boat.name, picture) as you:
        told = await gone_through(you, TRIES_AGAIN)
        gains = config.load(its).control.heading.p_nm_per_rad
        if "Not proven: she" in told:  # in real time on a busy machine she obeys later than her twin
            assert "The gains before are in" in told
            assert gains is None
        else:
            assert "Proven: she does as her twin foretold, or better." in told, told
            assert gains is not None
        await you.page.nothing_amiss()
        await you.picture("proven")


def _wired(found: config.Vehicle, true: config.Vehicle) -> None:
    assert found.adopted.proven
    assert [(row.address, row.reversed) for row in found.thrusters] == [(row.address, row.reversed) for row in true.thrusters]


def _bent(found: config.Vehicle) -> None:
    assert found.compass.offset_deg == pytest.approx(OFFSET_DEG, abs=1.0)
    assert found.compass.hard_ahead == pytest.approx(HARD, abs=0.03)


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_a_boat_is_adopted_by_the_page_alone_interrupted_and_gone_on_with(tmp_path: Path) -> None:
    asyncio.run(adopted(tmp_path, "heron", nothing))  # the skiff takes half as long again, and is for the pictures


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_the_motors_of_a_boat_with_four_thrusters_are_found_by_the_page_alone(tmp_path: Path) -> None:
    asyncio.run(motors_found(tmp_path, "float"))


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_a_boat_with_a_pair_at_each_side_is_adopted_by_the_page_alone(tmp_path: Path) -> None:
    asyncio.run(adopted(tmp_path, "pairs", nothing))


def main(folder: Path) -> None:
    with tempfile.TemporaryDirectory(prefix="adopt-", ignore_cleanup_errors=True) as place:
        asyncio.run(adopted(Path(place), "skiff", keeper(folder, "console", "adopted", "adopted-report")))
    shrink(folder.glob("console-adopted*.png"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
