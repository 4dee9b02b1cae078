"""What an operator sees of the boats at a glance, in a real browser against a stand-in gateway: on a desk, on a phone."""

import asyncio
import json
from collections.abc import Awaitable, Callable

import pytest

from tests.console.scenes import opened
from tests.console.standin import Message, Standin, boat, reference
from tests.console.test_page import shown, text_of, two
from tests.services.browser import Page, tab

DESK, PHONE, LANDSCAPE = (1440, 860), (390, 844), (844, 390)

Story = Callable[[Page, Standin], Awaitable[None]]


def look(gateway: Standin, size: tuple[int, int], story: Story, *, touch: bool = False) -> None:
    """Runs a story with the page open in a window of this size."""

    async def told() -> None:
        async with gateway.serving(), tab() as page:
            await page.call("Emulation.setTouchEmulationEnabled", enabled=touch)
            await opened(page, gateway, width=size[0], height=size[1])
            await story(page, gateway)
            assert page.complaints == []

    asyncio.run(told())


@pytest.mark.parametrize("size", [DESK, PHONE], ids=["desk", "phone"])
def test_a_weak_link_is_amber_with_its_cause_and_with_what_it_means_for_a_stop(size: tuple[int, int]) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        weak = "document.querySelector('[data-boat=\"1\"] .weak')"
        bars = "document.querySelector('[data-boat=\"1\"] .bars')"
        for link, words, count in (
            ({"rtt_ms": 3.2, "loss_pct": 0.0}, "", "4"),
            ({"rtt_ms": 600.0, "loss_pct": 4.0}, "", "3"),
            ({"rtt_ms": 3.2, "loss_pct": 10.0}, "link weak: 10 % lost; a stop may take 1\u00a0s", "2"),
            ({"rtt_ms": 1000.0, "loss_pct": 0.0}, "link weak: 1.0 s round trip; a stop may take 2\u00a0s", "2"),
            ({"rtt_ms": 1600.0, "loss_pct": 35.0}, "link weak: 35 % lost, 1.6 s round trip; a stop may take 3\u00a0s", "1"),
            ({"rtt_ms": None, "loss_pct": 80.0}, "link weak: 80 % lost; a stop may take 7\u00a0s", "1"),
        ):
            gateway.boat(1)["link"].update(link)
            await shown(page, gateway, f"{text_of(1, '.weak')} === {json.dumps(words)} && {bars}.dataset.bars === '{count}'")
            assert await page.value(f"{bars}.getClientRects().length") == 1
            assert await page.value(f"{weak}.getClientRects().length") == bool(words)
        gateway.boat(1)["age_s"]["heard"] = 9.0
        await shown(page, gateway, f"{bars}.dataset.bars === '0'")
        gateway.boat(1)["link"].update(kind="log")
        await shown(page, gateway, f"{bars}.hidden && {text_of(1, '.weak')} === ''")

    look(Standin(two()), size, story)


OUTSIDE = """[...document.querySelectorAll('.chip *, .popup *')].filter((each) => {
  const [box, its] = [each.closest('.chip, .popup').getBoundingClientRect(), each.getBoundingClientRect()];
  const cut = each.scrollWidth > each.clientWidth + 1 && getComputedStyle(each).display !== 'inline';
  return its.width && (its.right > box.right || its.left < box.left || (cut && !each.closest('.graph')));
}).map((each) => each.outerHTML)"""


def three() -> list[Message]:
    """Under way, with the longest words that they say."""
    boats = [
        boat(n, name, "#f2c230", mode="play", armed=True, speed_mps=1.6)
        for n, name in enumerate(("Alfa", "Bravo", "Charlie"), 1)
    ]
    for each in boats:
        each["reference"] = reference(latitude_deg=38.69, longitude_deg=-9.2, distance_m=99_900.0)
        each["mission"] = {"name": "Survey", "count": 800, "current": 799, "state": "differs", "digest": "1"}
        each["link"].update(profile="radio", rtt_ms=12_345.0, loss_pct=35.0)
    boats[2]["reference"] = None
    boats[2]["age_s"] = dict.fromkeys(boats[2]["age_s"], 23.0)
    return boats


@pytest.mark.parametrize("size", [DESK, PHONE, LANDSCAPE], ids=["desk", "phone", "landscape"])
def test_three_boats_are_all_in_sight_and_no_words_run_over_their_boxes(size: tuple[int, int]) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        await page.press("Tab")
        for name in ("Survey", "The-whole-bay-in-lines-of-five-metres"):
            for each in gateway.boats:
                each["mission"]["name"] = name
            await shown(page, gateway, f"{text_of(2, '.mission')} === '{name}: waypoint 800 of 800'")
            assert await page.value(
                "[...document.querySelectorAll('.mission')].map((each) => each.offsetHeight < 20).every(Boolean)"
            )
        outside = [each for each in await page.value(OUTSIDE) if "The-whole-bay" not in each]
        assert outside == []
        edge = 0.42 * size[1] if size is PHONE else size[1]
        for number in (1, 2, 3):
            chip = f"document.querySelector('[data-boat=\"{number}\"]')"
            assert await page.value(f"{chip}.getBoundingClientRect().bottom") <= edge
            for part in ("b", ".mode", ".age", ".bars"):
                assert await page.value(f"{chip}.querySelector('{part}').getClientRects().length") == 1, part
        for part in (".ages", ".link"):
            assert await page.value(f"document.querySelector('.selected {part}').getClientRects().length") == 1, part

    look(Standin(three()), size, story)


@pytest.mark.parametrize("touch", [False, True])
def test_a_menu_on_a_touch_screen_shows_no_keys_and_leaves_a_part_of_the_map(touch: bool) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        await page.press("Enter")
        await page.until("document.querySelector('.item kbd') !== null")
        assert bool(await page.value("document.querySelector('.item kbd').getClientRects().length")) is not touch
        if touch:
            assert await page.value("document.querySelector('.popup').offsetHeight") < 0.6 * PHONE[1]
        assert await page.value(OUTSIDE) == []

    look(Standin(two()), PHONE if touch else DESK, story, touch=touch)
