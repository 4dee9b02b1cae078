"""What nobody can see is not drawn: the page draws its map when something has moved by a pixel, and no oftener. While nobody
touches it it does so twice a second, unless it is what an operator waits for."""

import asyncio
from collections.abc import Callable

import pytest

from tests.console.scenes import caught_up, show
from tests.console.standin import Message, Standin, vessel
from tests.kit.page import settled, shown, two
from tests.services.browser import Page

CENTIMETRE = 1e-7  # degrees, about
FRAMES = 20
DRAWN = "delfim.drawings()"

TROUBLES = """(() => {
  window.troubles = 0;
  const at = document.querySelector('[data-boat="1"] .trouble');
  new MutationObserver(() => troubles++).observe(at, { attributes: true, attributeFilter: ['hidden'] });
})()"""

PICTURES = """(() => {
  window.pictures = 0;
  const draw = CanvasRenderingContext2D.prototype.drawImage;
  CanvasRenderingContext2D.prototype.drawImage = function (image, ...where) {
    if (this.canvas.isConnected && image.width > this.canvas.width) pictures++;
    draw.call(this, image, ...where);
  };
})()"""

AGED = """(() => {
  window.shown_ms = window.aged_ms = 0;
  const speed = ({ target }) => (target.parentElement ?? target).closest('.speed') ?? target.closest?.('.speed');
  new MutationObserver((all) => {
    if (all.some(speed)) [shown_ms, aged_ms] = [performance.now(), 0];
    else aged_ms ||= performance.now();
  }).observe(document.getElementById('strips'), { subtree: true, childList: true, characterData: true });
})()"""

LOOKS = """(() => {
  window.looks = 0;
  const gamepads = navigator.getGamepads.bind(navigator);
  navigator.getGamepads = () => (looks++, gamepads());
})()"""

WASTED = """(() => {
  window.wasted = [];
  const words = (nodes) => [...nodes].map((each) => each.outerHTML ?? each.data).join('|');
  const called = ({ target, attributeName }) => `${attributeName ?? 'words'} of ${target.outerHTML.slice(0, 80)}`;
  const same = ({ type, target, attributeName, oldValue, addedNodes, removedNodes }) =>
    type === 'attributes'
      ? oldValue === target.getAttribute(attributeName)
      : removedNodes.length > 0 && words(addedNodes) === words(removedNodes);
  new MutationObserver((all) => wasted.push(...all.filter(same).map(called))).observe(document, {
    subtree: true, childList: true, attributes: true, attributeOldValue: true,
  });
  const keep = Storage.prototype.setItem;
  Storage.prototype.setItem = function (name, value) {
    if (this.getItem(name) === value) wasted.push(`${name} is kept`);
    keep.call(this, name, value);
  };
})()"""


@pytest.fixture
def gateway() -> Standin:
    """With two boats under way and a vessel that goes by."""
    gateway = Standin(two())
    gateway.vessels = [vessel("Cacilhas", north_m=40, east_m=40, speed_mps=2.0)]
    return gateway


async def counted(gateway: Standin, page: Page, what: str, each: Callable[[int], None], touched: bool = False) -> float:
    """How much this number of the page has grown while the boats were told some times, changed so each time."""
    before: float = await page.value(what)
    for n in range(FRAMES):
        each(n)
        if touched and n % 5 == 0:
            await page.point(700.0 + n, 400.0)
        await gateway.frame(0.001)
        await page.value("new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
    await settled(page, gateway)
    after: float = await page.value(what)
    return after - before


def north(gateway: Standin, step: float) -> Callable[[int], None]:
    def move(_: int) -> None:
        for each in gateway.boats:
            each["latitude_deg"] += step

    return move


def to_and_fro(gateway: Standin) -> Callable[[int], None]:
    """By two pixels of what is in sight: more than what is not drawn, and less than what is far."""

    def move(n: int) -> None:
        north(gateway, 300 * CENTIMETRE * (-1) ** n)(n)

    return move


async def at_rest(gateway: Standin, page: Page) -> None:
    """1.2 km in sight, and all taken that changes it but what the test tells."""
    await show(page, -600, -600, 600, 600)
    async with asyncio.timeout(100):
        while await counted(gateway, page, DRAWN, north(gateway, CENTIMETRE)) > 1:  # the page still takes charts and names
            pass


async def test_steps_of_less_than_a_pixel_are_not_drawn(gateway, page):
    gateway.reported_s = 1.0
    await gateway.look()
    await shown(page, gateway, "delfim.vessels().length === 1")
    await at_rest(gateway, page)
    assert await counted(gateway, page, DRAWN, north(gateway, CENTIMETRE)) <= 1
    assert await counted(gateway, page, DRAWN, north(gateway, 600 * CENTIMETRE)) >= FRAMES // 2, "steps of six metres are drawn"


async def test_a_page_at_rest_is_drawn_twice_a_second(gateway, page):
    """Each message would be drawn, if somebody touched it."""
    await at_rest(gateway, page)
    begun_ms = await page.value("performance.now()")
    drawn = await counted(gateway, page, DRAWN, to_and_fro(gateway))
    took_s = (await page.value("performance.now()") - begun_ms) / 1000
    assert drawn <= 2 * took_s + 2
    assert await counted(gateway, page, DRAWN, to_and_fro(gateway), touched=True) >= FRAMES // 2


async def test_ages_alone_are_written_only_where_nothing_arrives(gateway, page):
    """Between two showings nothing is: the next brings them with it."""
    await at_rest(gateway, page)
    await page.value(AGED)
    for speed_mps in 1.1, 1.2, 1.3:
        await page.value("new Promise(done => setTimeout(done, 600))")  # what comes now does not wait for its showing
        await page.value("shown_ms = 0")
        gateway.boat(1)["speed_mps"] = speed_mps
        sent_ms = await page.value("performance.now()")  # the page counts from when it came, and may take a while to show it
        await gateway.frame()
        await page.until("shown_ms && aged_ms", 10.0)
        assert await page.value("aged_ms") - sent_ms >= 600


async def test_a_gamepad_is_looked_for_once_a_second(page):
    await page.value(LOOKS)
    await page.value("new Promise(done => setTimeout(done, 2000))")
    assert 1 <= await page.value("looks") <= 4


async def test_the_last_that_was_told_is_shown_without_another_message(gateway, page):
    await at_rest(gateway, page)
    heard_by = set(gateway.sockets)
    for _ in range(3):
        await gateway.frame(0.001)
    await caught_up(page, gateway)
    assert gateway.sockets == heard_by, "it was told anew, because it took the gateway for dead"


@pytest.mark.parametrize(
    "trouble",
    [
        {"failsafe": "battery low: home"},
        pytest.param({"ready": False, "reason": "no fix"}, marks=pytest.mark.long),
        pytest.param({"owner": False, "commander": 7}, marks=pytest.mark.long),
    ],
)
async def test_a_trouble_is_shown_with_the_message_that_tells_it(gateway, page, trouble: Message):
    usual = {name: gateway.boat(1)[name] for name in trouble}

    def change(n: int) -> None:
        gateway.boat(1).update(usual if n % 2 else trouble)

    await at_rest(gateway, page)
    await page.value(TROUBLES)
    assert await counted(gateway, page, "troubles", change) >= FRAMES // 2


async def test_nothing_is_written_that_stands_there_already(gateway, page):
    """What is written is laid out and painted anew, be it the same."""
    await page.press("F1")
    await page.press("Escape")
    await settled(page, gateway)
    await page.value(WASTED)
    await counted(gateway, page, DRAWN, to_and_fro(gateway), touched=True)
    await gateway.look()
    await settled(page, gateway)
    assert await page.value("wasted") == []


async def test_no_picture_is_drawn_of_nothing(gateway, page):
    """Of vessels there is one as large as the map and half as large again."""
    await page.value(PICTURES)
    await counted(gateway, page, DRAWN, to_and_fro(gateway), touched=True)
    assert await page.value("pictures") == 0
    gateway.reported_s = 1.0
    await gateway.look()
    await shown(page, gateway, "delfim.vessels().length === 1")
    await counted(gateway, page, DRAWN, to_and_fro(gateway), touched=True)
    assert await page.value("pictures") > 0
