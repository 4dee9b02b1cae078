"""What nobody can see is not drawn: the page draws its map when something has moved by a pixel, and no oftener."""

import asyncio

import pytest

from tests.console.scenes import show
from tests.console.standin import Standin, vessel
from tests.kit.page import settled, shown, two
from tests.services.browser import Page

CENTIMETRE = 1e-7  # degrees, about
FRAMES = 20


@pytest.fixture
def gateway() -> Standin:
    """With two boats under way and a vessel that goes by."""
    gateway = Standin(two())
    gateway.vessels = [vessel("Cacilhas", north_m=40, east_m=40, speed_mps=2.0)]
    return gateway


async def drawn_anew(gateway: Standin, page: Page, step: float) -> int:
    """How often the map was drawn while all have moved by so much for each of some frames."""
    before: int = await page.value("delfim.drawings()")
    for _ in range(FRAMES):
        for each in gateway.boats:
            each["latitude_deg"] += step
        for each in gateway.vessels:
            each["longitude_deg"] += step
        await gateway.frame()
        await gateway.look()
        await page.value("new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
    await settled(page, gateway)
    after: int = await page.value("delfim.drawings()")
    return after - before


async def test_steps_of_less_than_a_pixel_are_not_drawn(gateway, page):
    gateway.reported_s = 1.0
    await gateway.look()
    await show(page, -600, -600, 600, 600)
    await shown(page, gateway, "delfim.vessels().length === 1")
    async with asyncio.timeout(100):
        while await drawn_anew(gateway, page, CENTIMETRE) > 1:  # the page still takes charts and names
            pass
    assert await drawn_anew(gateway, page, 300 * CENTIMETRE) >= FRAMES // 2, "steps of three metres are drawn"
