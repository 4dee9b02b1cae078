"""Each screen, in four themes, without a finding of axe-core (WCAG 2.2 A and AA); sizes of words; and no value moves anything.

axe-core comes with the page's tools (`make page`); it is not part of the page.
"""

import base64
import contextlib
import math
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Final

import pytest

from delfim.parts.camera.played import PlayedPictures
from tests.console.scenes import Day, alert, at_work, begun, choose, opened, shipping_lane, show, survey
from tests.console.sheet import rows, trial
from tests.console.standin import Message, Standin, place, reference
from tests.kit.page import shown
from tests.services.browser import Page, tab

AXE: Final = Path(__file__).parents[2] / "delfim/console/web/node_modules/axe-core/axe.min.js"
THEMES: Final = ("bright", "day", "dusk", "night")
DESK, TABLET, PHONE, LYING = (1440, 860), (1024, 768), (390, 844), (844, 390)
SIZES: Final = pytest.mark.parametrize("size", [DESK, TABLET, PHONE], ids=["desk", "tablet", "phone"])
LOOK: Final = """(async () => {
  const runOnly = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"];
  const { violations } = await axe.run(document, { runOnly, resultTypes: ["violations"] });
  const words = (id, { html, failureSummary }) => `${id}: ${html.slice(0, 160)} ${failureSummary.split("\\n")[1]}`;
  return violations.flatMap(({ id, nodes }) => nodes.map((node) => words(id, node)));
})()"""


async def findings(page: Page, gateway: Standin, screen: str) -> list[str]:
    """While axe looks, the page hears nothing: it must be back in touch before and after."""
    found = []
    for theme in THEMES:
        await page.value(f"document.documentElement.dataset.theme = '{theme}'")
        await shown(page, gateway, f"document.getElementById('offline').hidden && delfim.at_s() >= {gateway.at_s}")
        found += [f"{screen}, {theme}: {each}" for each in await page.value(LOOK)]
    await shown(page, gateway, f"document.getElementById('offline').hidden && delfim.at_s() >= {gateway.at_s}")
    return found


async def with_axe(page: Page) -> None:
    if not AXE.exists():
        pytest.skip("axe-core is missing (make page installs it, where there is npm)")
    await page.call("Page.setBypassCSP", enabled=True)
    await page.value(AXE.read_text())


@SIZES
@pytest.mark.long
async def test_axe_finds_nothing_on_any_screen_in_any_theme(size: tuple[int, int]) -> None:
    gateway = at_work()
    async with gateway.serving(), tab() as page:
        day = Day(gateway)
        await day.sail(0.1)
        await opened(page, gateway, width=size[0], height=size[1])
        await with_axe(page)
        found = await findings(page, gateway, "hint")
        await page.value("document.querySelector('#hint button').click()")
        await page.press("Tab")
        await show(page, -250, -330, 330, 560)
        began = {"at_s": gateway.at_s - 40}
        low = began | alert(2, 2, "alarm", "battery low: 18 %: stop", "unacknowledged")
        lost = began | alert(1, 1, "warning", "link lost: nothing is heard from it", "acknowledged", "Ana")
        await gateway.tell({"t": "alerts", "alerts": [low, lost]})
        gateway.boat(2).update(forced="battery low: 18 %", battery_pct=18)
        gateway.boat(1)["age_s"] = dict.fromkeys(gateway.boat(1)["age_s"], 2.5)
        gateway.boat(1)["link"].update(loss_pct=35.0)
        await shipping_lane(gateway, day)
        found += await findings(page, gateway, "traffic and alerts")
        await page.press("Enter")
        await page.press("ArrowDown")
        found += await findings(page, gateway, "menu")
        await choose(page, "Speed…")
        found += await findings(page, gateway, "form")
        await page.press("Escape")
        for key, what in (("F1", "keys"), ("a", "alerts")):
            await page.press(key)
            found += await findings(page, gateway, what)
            await page.press("Escape")
        await page.mouse((0.6 * size[0], 0.45 * size[1]))
        await choose(page, "Screen", "Log of the watch")
        found += await findings(page, gateway, "log")
        assert found == []
        await page.nothing_amiss()


@contextlib.asynccontextmanager
async def at_a_task(size: tuple[int, int], gateway: Standin) -> AsyncIterator[tuple[Page, Day]]:
    """A page of this size with axe; its second boat is selected."""
    async with gateway.serving(), tab() as page:
        day = await begun(page, gateway, width=size[0], height=size[1])
        await with_axe(page)
        yield page, day
        await page.nothing_amiss()


@SIZES
@pytest.mark.long
async def test_axe_finds_nothing_where_a_boat_is_set_up(size: tuple[int, int]) -> None:
    """Its settings, its camera, its trial, and the file of a new one."""
    gateway = at_work()
    async with at_a_task(size, gateway) as (page, _):
        await page.press("Enter")
        await choose(page, "More", "Settings…")
        differs, refused = {"file": 9.0}, {"refused": "0.05 to 30.0"}
        first, second, *others = rows()
        await gateway.tell({"t": "aboard", "boat": 2, "of": "settings", "rows": [first | differs, second | refused, *others]})
        await page.until("document.querySelectorAll('#panes tr').length > 3")
        found = await findings(page, gateway, "settings")
        await page.press("Escape")
        await page.press("Enter")
        await choose(page, "More", "Camera")
        await gateway.until(lambda message: message["t"] == "see")
        still = base64.b64encode(PlayedPictures(320, 176).picture(1)).decode()
        picture = {"t": "picture", "boat": 2, "camera": "bow", "cameras": ["bow"], "kbps": 240, "why": "", "jpeg": still}
        for what, age in (("camera", {"age_s": 0.1, "same_s": 0}), ("old picture", {"age_s": 44.0, "same_s": 0})):
            await gateway.tell(picture | age | {"taken_s": 1.0})
            await page.until(f"document.querySelector('#picture').classList.contains('old') === {str('old' in what).lower()}")
            found += await findings(page, gateway, what)
        whole = "(e => e.scrollWidth <= e.clientWidth)(document.querySelector('#picture header'))"
        assert await page.value(whole), "a button is cut off"
        await page.value("[...document.querySelectorAll('#picture button')].at(-1).click()")
        for what, more in (("question", {}), ("end", {"is_running": False, "question": "", "end": "the circle is not free"})):
            await gateway.tell(trial() | more)
            await page.until("!document.querySelector('#adopt').hidden")
            found += await findings(page, gateway, f"trial, {what}")
        await gateway.tell(trial() | {"boat": None})
        await page.until("document.querySelector('#adopt').hidden")
        assert found + await of_a_new_boat(page, gateway, size) == []


async def of_a_new_boat(page: Page, gateway: Standin, size: tuple[int, int]) -> list[str]:
    await page.mouse((0.6 * size[0], 0.45 * size[1]))
    await choose(page, "Screen", "A boat’s file…")
    form = "document.getElementById('newboat')"
    found = list[str]()
    for what, words in (("kinds", "Which boat"), ("name", "Name of the boat"), ("refused", "a name is a letter")):
        await shown(page, gateway, f"{form}.innerText.includes({words!r})")
        found += await findings(page, gateway, f"new boat, {what}")
        if what == "name":
            await page.call("Input.dispatchKeyEvent", type="char", text="7")
        if what == "kinds":
            await page.value(f"[...{form}.querySelectorAll('.item')].find(each => each.innerText.startsWith('own')).click()")
        else:
            await page.press("Enter")
    await page.press("Escape")
    return found


def lines() -> Message:
    """Of a survey of two lines."""
    ends = [[place(20.0, 40.0), place(20.0, 90.0)], [place(40.0, 90.0), place(40.0, 40.0)]]
    words = {"counts": "", "mission": survey(), "energy_wh": 12.0, "time_s": 240.0, "covered": [1.0, 0.97], "heading_deg": 90.0}
    sizes = {"spacing_m": 20.0, "line_m": 100.0, "way_m": 160.0, "room_m": 4.0, "across": 0, "rough": 1, "known_across": 0}
    return (
        {
            "t": "survey",
            "boat": 2,
            "lines": ends,
            "way": [each for line in ends for each in line],
            "done": [],
            "known": [],
            "shares": [],
        }
        | words
        | sizes
    )


@SIZES
@pytest.mark.long
async def test_axe_finds_nothing_where_a_voyage_is_planned_and_watched(size: tuple[int, int]) -> None:
    """A survey's form, what a mission lacks of energy, the way home, and values by colour and as graphs."""
    gateway = at_work()
    async with at_a_task(size, gateway) as (page, day):
        for step in range(13):
            gateway.boat(2)["measured"] = {"water_c": {"value": 18.0 + step / 3, "age_s": 0.1}}
            await day.sail(1.0)
        await shown(page, gateway, "delfim.values().water_c >= 10")
        bare = 0.6 * size[0], 0.45 * size[1]
        await page.mouse(bare)
        await choose(page, "Screen", "Colour of the tracks", "water_c")
        await page.mouse(bare)
        await choose(page, "Screen", "The last ten minutes")
        await shown(page, gateway, "document.querySelector('#timeline figcaption')?.textContent.includes('water 22.0 °C')")
        found = await findings(page, gateway, "values")
        gateway.boat(2).update(mode="hold", energy={"left_wh": 80.0, "home_wh": 31.0, "range_m": [900.0, 700.0, 500.0, 700.0]})
        gateway.refusals["afford"] = "takes 120 Wh with the way home, 80 Wh are left"
        await gateway.frame()
        await page.press("Enter")
        home = {"points": [place(100.0, 205.0), place(0.0, 0.0)], "whole": True, "speed_mps": 1.5}
        await gateway.tell({"t": "way_home", "boat": 2, **home})
        await shown(page, gateway, "delfim.wayHome(2).endsWith(', 31 of 80 Wh')")
        found += await findings(page, gateway, "energy")
        await page.press("Escape")
        await page.press("y")
        await shown(page, gateway, "document.body.innerText.includes('120 Wh with the way home')")
        found += await findings(page, gateway, "what the mission lacks")
        await choose(page, "Cancel")
        await page.mouse(bare)
        await choose(page, "Survey", "Area around here…")
        found += await findings(page, gateway, "area")
        await page.press("Enter")
        await page.mouse(bare)
        await choose(page, "Survey", "Lines…")
        await gateway.until(lambda message: message["t"] == "survey")
        await gateway.tell(lines())
        await page.press("ArrowRight")  # the form asks again, and what was told stands on it
        await shown(page, gateway, "document.querySelector('.popup .words').textContent.includes(' lines, ')")
        assert found + await findings(page, gateway, "survey") == []


COVERED: Final = """[...document.querySelectorAll('#replay button, #picture button')].flatMap((each) => {
  const { x, y, width, height } = each.getBoundingClientRect();
  return each.contains(document.elementFromPoint(x + width / 2, y + height / 2)) ? [] : [each.textContent];
})"""


@pytest.mark.parametrize("size", [DESK, TABLET, PHONE, LYING], ids=["desk", "tablet", "phone", "lying"])
@pytest.mark.long
async def test_axe_finds_nothing_in_a_replay(size: tuple[int, int]) -> None:
    gateway = at_work()
    begins_s = gateway.at_s - 300.0
    said: list[Message] = [
        {"at_s": begins_s + 120.0, "boat": 2, "severity": 2, "text": "battery low: home"},
        {"at_s": begins_s + 500.0, "boat": 2, "severity": 6, "text": "Ana: weed", "note": True},
    ]
    gateway.hello["replay"] = {"from_s": begins_s, "to_s": begins_s + 1800.0, "events": said}
    async with at_a_task(size, gateway) as (page, day):
        speeds = [[begins_s + 6.0 * n, 1.5 + (n % 7) / 40.0] for n in range(300)]
        await gateway.tell({"t": "graphs", "boat": 2, "graphs": {"speed_mps": speeds}})
        await day.sail(60)
        found = await findings(page, gateway, "replay")
        await page.press("Enter")
        found += await findings(page, gateway, "menu of a replay")
        await choose(page, "Camera")
        await page.until("!document.getElementById('picture').hidden")
        covered = await page.value(COVERED)
        assert (found, covered) == ([], []), "of the replay and of the camera each button can be pressed"


MEASURED: Final = ".selected :is(.figure, .thruster, .orders button), #bar > *"
LAYOUT: Final = f"""[...document.querySelectorAll('{MEASURED}')].flatMap((each) => {{
  const {{ x, y, width, height }} = each.getBoundingClientRect();
  return width ? [[each.className || each.id, x, y, width, height]] : [];
}})"""


@pytest.mark.parametrize("size", [DESK, PHONE], ids=["desk", "phone"])
async def test_no_value_moves_anything(size: tuple[int, int]) -> None:
    """The least and the longest words of each figure."""
    gateway = at_work()
    async with gateway.serving(), tab() as page:
        await opened(page, gateway, width=size[0], height=size[1])
        await page.press("Tab")
        await page.until("document.fonts.status === 'loaded' && document.fonts.check('28px B612')")
        told = gateway.boat(2)
        seen = []
        for speed, heading, battery, rpm, left, asked in (
            (0.0, 0.0, 0, 0.0, 0.0, None),
            (1.1, 111.0, 11, 111.0, 11.0, 1.1),
            (12.8, 359.6, 100, -3888.0, 98_765.0, 14.4),
            (None, None, None, None, None, None),
        ):
            told.update(speed_mps=speed, heading_deg=heading, battery_pct=battery, rpm=[rpm, rpm], mode="play")
            told.update(thrust_pct=[None if rpm is None else math.copysign(100.0, rpm)] * 2)
            told["reference"] = reference(distance_m=left, speed_mps=asked, heading_deg=asked and 359.0)
            words = "–" if speed is None else f"{speed:.1f}"
            await shown(page, gateway, f"document.querySelector('.selected .figure b').textContent === '{words}'")
            seen.append(await page.value(LAYOUT))
        moved = [(was, its) for each in seen[1:] for was, its in zip(seen[0], each, strict=True) if was != its]
        assert moved == []
        inside = "(e => e.scrollWidth <= e.clientWidth + 1)"
        assert await page.value(f"[...document.querySelectorAll('.selected .figure p')].every({inside})")


async def test_words_have_three_sizes_of_one_face() -> None:
    gateway = at_work()
    async with gateway.serving(), tab() as page:
        await opened(page, gateway)
        await page.press("Tab")
        await page.press("Enter")
        faces = await page.value(
            "[...new Set([...document.querySelectorAll('body *')].filter((e) => e.getClientRects().length && e.textContent)"
            ".map((e) => getComputedStyle(e)).map((s) => `${s.fontFamily.split(',')[0]} ${s.fontSize}`))].sort()"
        )
        assert faces == ["B612 12px", "B612 14px", "B612 28px"]
