"""The console's page in a real browser against a stand-in gateway: opened, waited for, and what it plans."""

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Callable

import pytest

from tests.console.scenes import opened, show
from tests.console.standin import M_PER_DEG, Message, Standin, boat, place
from tests.services.browser import PROGRAM, Page, tab

SQUARE = [(-40.0, -60.0), (40.0, -60.0), (40.0, 60.0), (-40.0, 60.0)]


def two() -> list[Message]:
    return [boat(1, "Delfim", "#f4f6f7", north_m=-90, east_m=-60), boat(2, "DelfimX", "#56b4e9", north_m=-90, east_m=60)]


@contextlib.asynccontextmanager
async def sailing(gateway: Standin) -> AsyncIterator[Page]:
    async with gateway.serving(), tab() as page:
        await page.call("Network.enable")
        await opened(page, gateway)
        await show(page, -120, -120, 120, 120)
        yield page
        assert foreign(page, gateway) == []


def foreign(page: Page, gateway: Standin) -> list[str]:
    """What the page asked others for."""
    own = "data:", gateway.address, gateway.address.replace("http", "ws")
    return [each for each in page.requests if not each.startswith(own)]


async def shown(page: Page, gateway: Standin, expression: str) -> None:
    """Wait until an expression is true in the page, while the boats go on being told."""
    async with asyncio.timeout(200):
        while not await page.value(expression):
            await gateway.frame()
            await asyncio.sleep(0.06)


async def settled(page: Page, gateway: Standin) -> None:
    """Wait until the page has taken all that it was told: messages arrive in their order."""
    mark = gateway.boat(1)["battery_pct"] = 30 + (gateway.boat(1)["battery_pct"] - 29) % 60
    await shown(page, gateway, f"{text_of(1, '.battery')} === '{mark} %'")


def text_of(number: int, part: str) -> str:
    return f"document.querySelector('[data-boat=\"{number}\"] {part}').textContent"


async def planned(gateway: Standin, wanted: Callable[[list[Message]], bool], number: int = 1) -> Message:
    """Wait until the gateway was handed a plan with such waypoints."""

    def is_it(message: Message) -> bool:
        return message.get("do") == "put" and message["boat"] == number and wanted(message["mission"]["waypoints"])

    return (await gateway.until(is_it))["mission"]


def near(mission: Message, corners: list[tuple[float, float]]) -> None:
    assert len(mission["waypoints"]) == len(corners)
    assert all(close(each, corner) for each, corner in zip(mission["waypoints"], corners, strict=True)), mission["waypoints"]


def close(each: Message, corner: tuple[float, float], within_m: float = 2.0) -> bool:
    """Within two metres: what a pixel is on this screen."""
    at = place(*corner)
    east = M_PER_DEG * math.cos(math.radians(at[0]))
    return math.hypot((each["latitude_deg"] - at[0]) * M_PER_DEG, (each["longitude_deg"] - at[1]) * east) < within_m


async def second_of_moving(page: Page, gateway: Standin, how: str) -> int:
    """How often the map was drawn while the pointer moved it for a second, with all boats under way and told ten times."""
    clock = asyncio.get_running_loop().time
    begun_s, told = clock(), 0
    if how == "dragged":
        await page.pointer("mousePressed", (700.0, 400.0), 1)
    while (since_s := clock() - begun_s) < 1.0:
        if told <= since_s * 10:
            told += 1
            for each in gateway.boats:
                each["latitude_deg"] += 1e-6
            await gateway.frame()
        x, y = 700 + 200 * math.sin(6 * since_s), 400 + 100 * math.sin(4 * since_s)
        if how == "dragged":
            await page.pointer("mouseMoved", (x, y), 1)
        else:
            turned = math.copysign(40, math.sin(6 * since_s))
            await page.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=turned)
    drawn: int = await page.value("delfim.frames()")
    if how == "dragged":
        await page.pointer("mouseReleased", (x, y), 0)
    return drawn


@pytest.fixture
def gateway() -> Standin:
    """With two idle boats."""
    return Standin(two())


@pytest.fixture
def page(gateway: Standin) -> contextlib.AbstractAsyncContextManager[Page]:
    """Open on the boats of that gateway while the test runs."""
    assert PROGRAM, "Chromium is missing: make system"
    return sailing(gateway)
