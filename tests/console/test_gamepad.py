"""A gamepad at the page, seen at the vehicle. Chromium has none here: tests/console/pads.py stands for it in the page, and
what is behind that is real."""

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Iterator

import pytest

from tests.console.chain import Boat, Sea, afternoon, select, turning, watched
from tests.console.pads import looked, plug, unplug
from tests.services.browser import Page

LONG = pytest.mark.long
WATCHED = 8  # cycles: longer than the page, the gateway and the boat need to do something that they should not


@pytest.fixture(scope="module")
def afloat(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[asyncio.Runner, Sea]]:
    with afternoon(tmp_path_factory.mktemp("gamepad")) as both:
        yield both


@pytest.fixture
def sea(runner: asyncio.Runner, afloat: tuple[asyncio.Runner, Sea]) -> contextlib.AbstractAsyncContextManager[Sea]:
    return unplugged(afloat[1])


@contextlib.asynccontextmanager
async def unplugged(sea: Sea) -> AsyncIterator[Sea]:
    """Before a story and after it."""
    async with watched(sea):
        await unplug(sea.page)
        yield sea
        await unplug(sea.page)


async def by_hand(sea: Sea, number: int = 2) -> tuple[Page, Boat]:
    """In manual mode, by a gamepad whose stick is at rest."""
    page, boat = await sea.at_rest(number)
    await plug(page)
    await page.press("m")
    await boat.until(lambda state: state["mode"] == "manual")
    await looked(page)
    return page, boat


async def nothing_moves(boat: Boat) -> None:
    began_ns = time.time_ns()
    await boat.sails_on(WATCHED)
    assert [each for each in await boat.turnings(time.time_ns()) if each.t_ns > began_ns and each.rpm] == []


async def test_the_stick_is_the_thrust_and_springs_back_to_none(sea: Sea) -> None:
    page, boat = await by_hand(sea)
    for right, ahead, port, starboard in ((0.0, 0.4, 40, 40), (0.1, 0.4, 50, 30), (-0.3, -0.1, -40, 20), (0.0, 0.0, 0, 0)):
        await plug(page, right, ahead)
        await boat.until(turning(port, starboard))
    await page.press("2")
    await boat.until(turning(20, 20))
    await looked(page)
    assert turning(20, 20)(boat.state()), "a stick at rest leaves the keys alone"


async def test_in_heading_mode_it_turns_and_sets_the_speed_and_its_button_stops(sea: Sea) -> None:
    page, boat = await sea.at_rest(2)
    await plug(page)
    await page.press("h")
    first = (await boat.until(lambda state: state["mode"] == "heading"))["reference"]["heading_deg"]
    await looked(page)
    await plug(page, right=1.0)
    await boat.until(lambda state: (state["reference"]["heading_deg"] - first) % 360 > 10)
    await plug(page, ahead=1.0)
    await boat.until(lambda state: (state["reference"]["speed_override_mps"] or 0.0) > 0.2)
    await plug(page, ahead=1.0, stop=True)
    await boat.until(lambda state: state["mode"] == "idle" and turning(0, 0)(state))
    await plug(page, ahead=1.0)
    await nothing_moves(boat)


@pytest.mark.parametrize(
    "how", ["unplugged", *(pytest.param(how, marks=LONG) for how in ("stopped", "hidden", "another boat"))]
)
async def test_it_lets_go_and_drives_again_only_from_rest(sea: Sea, how: str) -> None:
    page, boat = await by_hand(sea)
    await plug(page, ahead=0.4)
    await boat.until(turning(40, 40))
    await (
        unplug(page)
        if how == "unplugged"
        else page.hide()
        if how == "hidden"
        else page.press(" ")
        if how == "stopped"
        else select(page, 1)
    )
    await boat.until(turning(0, 0))
    if how == "hidden":
        await page.show()
    if how == "another boat":
        await select(page, 2)
    if how == "stopped":
        await boat.until(lambda state: state["mode"] == "idle")
        await page.press("m")
        await boat.until(lambda state: state["mode"] == "manual")
    await plug(page, ahead=0.4)
    await nothing_moves(boat)
    await plug(page)
    await plug(page, ahead=0.3)
    await boat.until(turning(30, 30))


async def test_a_mode_that_is_entered_while_the_stick_is_held_moves_nothing(sea: Sea) -> None:
    page, boat = await sea.at_rest(2)
    await plug(page, ahead=0.6)
    await page.press("m")
    await boat.until(lambda state: state["mode"] == "manual")
    await nothing_moves(boat)
    assert "gamepad" in await page.value("document.getElementById('messages').textContent")
