"""Each screen, in four themes, without a finding of axe-core (WCAG 2.2 A and AA); sizes of words; and no value moves anything.

axe-core comes with the page's tools (`make page`); it is not part of the page.
"""

import math
from pathlib import Path
from typing import Final

import pytest

from tests.console.scenes import Day, alert, at_work, choose, opened, shipping_lane, show
from tests.console.standin import Standin, reference
from tests.kit.page import shown
from tests.services.browser import Page, tab

AXE: Final = Path(__file__).parents[2] / "delfim/console/web/node_modules/axe-core/axe.min.js"
THEMES: Final = ("bright", "day", "dusk", "night")
DESK, PHONE = (1440, 860), (390, 844)
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


@pytest.mark.parametrize("size", [DESK, PHONE], ids=["desk", "phone"])
@pytest.mark.long
async def test_axe_finds_nothing_on_any_screen_in_any_theme(size: tuple[int, int]) -> None:
    if not AXE.exists():
        pytest.skip("axe-core is missing (make page installs it, where there is npm)")
    gateway = at_work()
    async with gateway.serving(), tab() as page:
        day = Day(gateway)
        await day.sail(0.1)
        await opened(page, gateway, width=size[0], height=size[1])
        await page.call("Page.setBypassCSP", enabled=True)
        await page.value(AXE.read_text())
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
