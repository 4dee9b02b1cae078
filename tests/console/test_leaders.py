"""Names on the map where there is no room beside each boat: they stand aside, with a thin line, and none covers another."""

import itertools

import pytest

from tests.console.scenes import pixel, show
from tests.console.standin import Standin, boat
from tests.kit.page import shown
from tests.services.browser import Page

NAMES = "Arrábida", "Berlenga", "Culatra", "Desertas", "Espichel", "Farilhões"
LETTER_PX = 8
LINE_PX = 14


@pytest.fixture
def gateway() -> Standin:
    """With six boats side by side."""
    return Standin([boat(n + 1, name, "#56b4e9", north_m=0.0, east_m=12.0 * n) for n, name in enumerate(NAMES)])


async def boxes(page: Page) -> list[tuple[float, float, float, float]]:
    """What the names cover: left, top, right, bottom."""
    made = []
    for name, x, y, _ in await page.value("delfim.names()"):
        east_px, north_px = await pixel(page, 0.0, 12.0 * NAMES.index(name))
        wide = 0.8 * LETTER_PX * len(name)
        left = east_px + x - (0 if x > 0 else wide if x < 0 else wide / 2)
        made.append((left, north_px + y - LINE_PX / 2, left + wide, north_px + y + LINE_PX / 2))
    return made


def meet(one: tuple[float, ...], other: tuple[float, ...]) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


async def test_names_without_room_stand_aside_with_a_line_and_cover_nothing(gateway, page):
    await show(page, -300, -300, 300, 300)
    await shown(page, gateway, "delfim.names().length === 6 && delfim.names().some((each) => each[3])")
    for one, other in itertools.combinations(await boxes(page), 2):
        assert not meet(one, other), (one, other)
    await show(page, -30, -30, 30, 100)
    await shown(page, gateway, "delfim.names().length === 6 && !delfim.names().some((each) => each[3])")
