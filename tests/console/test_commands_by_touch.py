"""Every command that has a place on the screen, given by a finger on a touch screen: the rows of the other ways, but for those
of keys and of a gamepad, each tapped through the real page, gateway and link to what the vehicle obeyed. A row that is new
there is one here.
"""

import asyncio
from collections.abc import Iterator
from typing import cast

import pytest

from tests.console.chain import Sea, afternoon
from tests.console.fingers import Fingers
from tests.console.test_commands import ROWS, planned, said_and_obeyed
from tests.services.browser import Page

HANDS = "keys.", "key: ", "gamepad."  # that are no fingers


@pytest.fixture(scope="module")
def afloat(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[asyncio.Runner, Sea]]:
    with afternoon(tmp_path_factory.mktemp("touched")) as (runner, its):
        runner.run(touched(its))
        yield runner, its


@pytest.fixture
def its(runner: asyncio.Runner, afloat: tuple[asyncio.Runner, Sea]) -> Sea:
    return afloat[1]


async def touched(sea: Sea) -> None:
    """The page is loaded again on a touch screen."""
    await sea.page.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=1)
    await sea.page.call("Emulation.setEmitTouchEventsForMouse", enabled=False)
    await sea.load()
    assert await sea.page.value("matchMedia('(pointer: coarse)').matches")
    await planned(sea)


@pytest.mark.long
@pytest.mark.parametrize("way", [way for way in ROWS if not way.startswith(HANDS)])
async def test_what_a_finger_says_is_what_the_vehicle_obeys(its: Sea, way: str) -> None:
    hands = list[Fingers]()

    def hand(page: Page) -> Page:
        hands.append(Fingers(page))
        return cast(Page, hands[-1])

    await said_and_obeyed(its, [ROWS[way]], hand)
    assert hands[0].taps, "it was given by no finger"
