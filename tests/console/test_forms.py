"""Forms of the page, in a real browser against a stand-in gateway: what is typed, refused, and changed afterwards."""

import math

import pytest

from tests.console.scenes import choose, pixel, survey, waypoints
from tests.console.standin import M_PER_DEG, Message, Standin, place
from tests.kit.page import SQUARE, close, planned, settled
from tests.services.browser import Page

WORDS = "document.querySelector('.popup .words').textContent"


async def type_in(page: Page, title: str, words: str) -> None:
    """Click into a field, unless it is the first, and type over what is there."""
    field = f"document.querySelector('.field input[aria-label=\"{title}\"]')"
    await page.until("document.activeElement.matches('.field input')")
    if not await page.value(f"document.activeElement === {field}"):
        x, y = await page.value(f"(r => [r.x + r.width / 2, r.y + r.height / 2])({field}.getBoundingClientRect())")
        await page.value("new Promise(done => setTimeout(done, 320))")  # a sooner click is not meant
        await page.mouse((x, y))
    else:
        await page.value(f"{field}.select()")
    await page.until(
        f"document.activeElement === {field} && {field}.selectionEnd - {field}.selectionStart === {field}.value.length"
    )
    await page.call("Input.insertText", text=words)


async def value(page: Page, title: str) -> str:
    shown: str = await page.value(f"document.querySelector('.field input[aria-label=\"{title}\"]').value")
    return shown


async def test_numbers_are_typed_and_those_that_cannot_be_are_refused_with_their_range(page: Page, gateway: Standin) -> None:
    await page.mouse(await pixel(page, 20, 0))
    await choose(page, "Pattern", "Lawn-mower…")
    await page.until("document.activeElement.matches('.field input')")
    for key in "600":
        await page.press(key)
    await page.call("Input.insertText", text="600")  # the keys above type nothing in a headless browser, and are no speeds
    await page.until(f"{WORDS}.startsWith('10 waypoints')")
    await type_in(page, "Spacing", "1")
    await page.until(f"{WORDS} === 'Spacing: 2 to 20000 m'")
    await page.press("Enter")
    assert await page.value("document.querySelector('.field') !== null"), "it is not taken"
    await type_in(page, "Spacing", "12,5")
    await type_in(page, "Width", "9000")
    await page.until(f"{WORDS} === '1442 waypoints: a mission has 1000 at most'")
    await page.press("Enter")
    await type_in(page, "Width", "50")
    await page.press("Tab")
    assert await page.value("document.activeElement.ariaLabel") == "Spacing"
    assert await value(page, "Spacing") == "12.5 m"
    await page.press("Enter")
    mission = await planned(gateway, lambda w: len(w) == 10)
    assert close(mission["waypoints"][0], (-280, -25), within_m=0.5)
    assert [each["t"] for each in gateway.said if each["t"] == "command"] == []


COORDINATES = ("38.6905", "-9.2149"), ("38 41.430N", "9 12.894W"), ("N38°41′25.8″", "W9°12′53.64″"), ("38,6905", "009-12.894W")


async def test_a_waypoint_is_put_where_its_coordinates_say(page: Page, gateway: Standin) -> None:
    mission = {**survey(), "name": "Square", "waypoints": waypoints(SQUARE), "fence": [], "obstacles": [], "home": None}
    for latitude, longitude in COORDINATES:
        gateway.forget()
        await gateway.tell({"t": "mission", "boat": 1, "where": "here", "mission": mission})  # it is where it was
        await settled(page, gateway)
        await page.mouse(await pixel(page, *SQUARE[2]))
        await choose(page, "Position…")
        await type_in(page, "Latitude", latitude)
        await type_in(page, "Longitude", "somewhere")
        await page.until(f"{WORDS} === 'Longitude: -180 to 180 °'")
        await type_in(page, "Longitude", longitude)
        await page.press("Enter")
        moved = await planned(gateway, lambda w: not close(w[2], SQUARE[2]))
        at = [round(moved["waypoints"][2][name], 6) for name in ("latitude_deg", "longitude_deg")]
        assert at == [38.6905, -9.2149], latitude


def extent_m(waypoints: list[Message]) -> float:
    """How far the farthest is from where the pattern was put."""
    return max(math.dist((each["latitude_deg"], each["longitude_deg"]), place(20, 0)) * M_PER_DEG for each in waypoints)


@pytest.mark.parametrize(
    ("title", "least", "field", "more"),
    [
        ("Circle", 3, "Radius", "80"),
        *(
            pytest.param(*each, marks=pytest.mark.long)
            for each in (("Lawn-mower", 10, "Width", "120"), ("Spiral", 60, "Radius", "80"))
        ),
    ],
)
async def test_a_pattern_is_changed_as_one_until_a_point_of_it_was_moved(page, gateway, title, least, field, more):
    await page.mouse(await pixel(page, -110, -110))
    await choose(page, "Add waypoint")
    await planned(gateway, lambda w: len(w) == 1)
    await page.mouse(await pixel(page, 20, 0))
    await choose(page, "Pattern", f"{title}…")
    await page.press("Enter")
    before = await planned(gateway, lambda w: len(w) >= 1 + least)
    first = before["waypoints"][1]
    gateway.forget()
    await page.reload()
    await page.until("window.delfim && delfim.drawn().plan > 0")
    await settled(page, gateway)  # its map stands where it stood: a click before that would miss
    await page.mouse(await page.value(f"delfim.pixel({first['latitude_deg']}, {first['longitude_deg']})"))
    await choose(page, f"Change the {title.lower()}…")
    await type_in(page, field, more)
    await page.press("Enter")
    after = await planned(gateway, lambda w: w != before["waypoints"])
    assert close(after["waypoints"][0], (-110, -110)), "what is before it stays"
    assert extent_m(after["waypoints"][1:]) > 1.3 * extent_m(before["waypoints"][1:])
    gateway.forget()
    first = after["waypoints"][1]
    x, y = await page.value(f"delfim.pixel({first['latitude_deg']}, {first['longitude_deg']})")
    await page.mouse((x, y), (x + 12, y + 12))
    await planned(gateway, lambda w: w[1] != first)
    await page.mouse((x + 12, y + 12))
    await page.until("document.querySelector('.item') !== null")
    assert "Change the" not in await page.value("document.querySelector('.popup').textContent")
