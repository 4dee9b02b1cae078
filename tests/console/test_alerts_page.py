"""Alerts on the page: the gravest in the bar, all in the list, taken note of and silenced by key and by touch. With a folder on
its command line it keeps pictures for docs/operator.md (`make pictures`).
"""

import asyncio
import sys
from pathlib import Path

import pytest

from tests.console.scenes import a_minute_at_work, alert, at_work, choose, opened, pixel
from tests.console.standin import Message, Standin
from tests.console.test_bridge_page import word
from tests.kit.page import sailing, settled, shown
from tests.kit.pictures import keeper
from tests.services.browser import Page, shrink, tab

DEAD = "port propeller turns 1 instead of 945 rpm: stop"
LINE = "document.querySelector('#bar p').textContent"
ROWS = "[...document.querySelectorAll('#alerts table:first-of-type tr')].slice(1).map((each) => each.textContent)"
DESK = (1200, 640)


def standing(at_s: float) -> list[Message]:
    """One of each priority but an emergency, and of several states."""
    return [
        alert(7, 2, "alarm", DEAD, "unacknowledged") | {"at_s": at_s - 12},
        alert(6, None, "warning", "recording of the session: the disk is full", "rectified") | {"at_s": at_s - 90},
        alert(4, 1, "warning", "link lost: nothing is heard from it", "transferred", "Rui") | {"at_s": at_s - 1000},
        alert(3, 2, "caution", "link weak: a stop may come late", "acknowledged") | {"at_s": at_s - 60},
    ]


def past(at_s: float) -> list[Message]:
    told = [
        alert(1, 1, "alarm", "depth 0.80 m, least 1.50 m: hold", "normal", "Ana"),
        alert(2, 1, "warning", "guest silent for 2.0 s: warn", "normal", "Rui"),
    ]
    return [each | {"at_s": at_s - 3000 + 60 * each["id"], "until_s": at_s - 2000 + 60 * each["id"]} for each in told]


async def watched(page: Page, gateway: Standin) -> None:
    await gateway.tell({"t": "ended", "all": True, "alerts": past(gateway.at_s)})
    await gateway.tell({"t": "alerts", "alerts": standing(gateway.at_s)})
    await shown(page, gateway, f"{LINE}.includes({DEAD!r})")
    await page.press("a")
    await shown(page, gateway, f"{ROWS}.length === 4")


async def test_the_bar_has_the_gravest_that_nobody_has_seen_and_keys_take_note_of_it_alone() -> None:
    gateway = at_work()
    async with sailing(gateway) as page:
        await watched(page, gateway)
        rows = await page.value(ROWS)
        assert f"{DEAD}not acknowledged" in rows[0]
        assert "the disk is fullover, not acknowledged" in rows[1]
        assert "Rui answers for it" in rows[2]
        assert await page.value("document.querySelectorAll('#alerts table:last-of-type tr').length") == 3
        counts = await page.value("[...document.querySelectorAll('.counts .of')].map((each) => each.textContent).join()")
        assert counts == "0,1,2,1"
        for key, said in (("s", {"t": "quiet", "ids": [7]}), ("k", {"t": "acknowledge", "ids": [7]})):
            await page.press(key)
            await gateway.until(lambda m, said=said: said.items() <= m.items())
        await gateway.tell({"t": "alerts", "alerts": standing(gateway.at_s)[1:]})
        await shown(page, gateway, f"{LINE}.includes('the disk is full')")
        assert await page.value("document.querySelectorAll('#bar .plain')[1].disabled"), "nothing sounds"
        await gateway.tell({"t": "alerts", "alerts": standing(gateway.at_s)[2:]})
        await shown(page, gateway, f"{LINE} === 'All alerts are acknowledged'")
        await page.press("Escape")
        assert await page.value("document.getElementById('alerts').hidden")


async def test_a_finger_takes_note_too_and_the_bar_does_not_change_its_height() -> None:
    gateway = at_work()
    async with gateway.serving(), tab() as page:
        await opened(page, gateway, width=390, height=780)
        high = "document.getElementById('bar').offsetHeight"
        before = await page.value(high)
        await gateway.tell({"t": "alerts", "alerts": standing(gateway.at_s)})
        await shown(page, gateway, f"{LINE}.includes({DEAD!r})")
        assert await page.value(high) == before
        box = "(({x, y, width, height}) => [x + width / 2, y + height / 2])({}.getBoundingClientRect())"
        for selector, said in ((".plain", {"t": "acknowledge", "ids": [7]}), (".plain + .plain", {"t": "quiet", "ids": [7]})):
            x, y = await page.value(box.replace("{}", f"document.querySelector('#bar {selector}')"))
            await page.touch("Start", (x, y))
            await page.touch("End")
            await gateway.until(lambda m, said=said: said.items() <= m.items())


@pytest.mark.parametrize("words", ["BRAVO: CPA 12 m in 41 s", "battery low: 18 %: stop"])
async def test_the_words_of_an_alert_are_read_whole_on_a_phone(words: str) -> None:
    gateway = at_work()
    async with gateway.serving(), tab() as page:
        await opened(page, gateway, width=390, height=780)
        told = alert(7, 2, "alarm", words, "unacknowledged") | {"at_s": gateway.at_s}
        await gateway.tell({"t": "alerts", "alerts": [told]})
        await shown(page, gateway, f"{LINE}.includes({words!r})")
        cut = "(e => e.scrollHeight > e.clientHeight + 1 || e.scrollWidth > e.clientWidth + 1)"
        parts = "[...document.querySelectorAll('#bar p, #bar p span')]"
        assert await page.value(f"{parts}.filter((each) => getComputedStyle(each).display !== 'inline').some({cut})") is False
        assert await page.value("document.getElementById('bar').scrollWidth <= innerWidth")


async def test_the_words_of_an_alert_have_room_beside_all_else_in_the_bar() -> None:
    gateway = at_work()
    async with gateway.serving(), tab() as page:
        await opened(page, gateway, width=1200, height=760)
        await gateway.tell(word(1, granted=1, grant=1))
        await gateway.tell({"t": "alerts", "alerts": standing(gateway.at_s)})
        for width in (1200, 1366, 1440, 1920):
            await page.call("Emulation.setDeviceMetricsOverride", width=width, height=760, deviceScaleFactor=1.0, mobile=False)
            await page.until(f"innerWidth === {width}")
            await settled(page, gateway)
            await shown(page, gateway, f"{LINE}.includes({DEAD!r})")
            cut = "[...document.querySelectorAll('#bar p *')].filter((each) => each.scrollWidth > each.clientWidth + 1).length"
            assert await page.value(f"getComputedStyle(document.querySelector('#bar p')).display !== 'none' && {cut}") == 0
            assert await page.value("document.getElementById('bar').scrollWidth <= innerWidth")


async def test_the_time_in_the_bar_is_the_consoles() -> None:
    gateway = at_work()
    async with sailing(gateway) as page:
        await gateway.frame(3600.0 - gateway.at_s % 3600.0)
        await shown(page, gateway, "/^[0-9]{2}:00:0[0-9] UTC$/.test(document.querySelector('#utc b').textContent)")


def main(folder: Path) -> None:
    async def keep() -> None:
        picture = keeper(folder, "console")
        async with a_minute_at_work(*DESK) as (page, gateway):
            await watched(page, gateway)
            await picture(page, "alerts")
            await page.press("a")
            await page.mouse(await pixel(page, -210, 60))
            await choose(page, "Screen", "Colours", "Night")
            await page.press("a")
            await picture(page, "alerts-night")

    asyncio.run(keep())
    shrink(folder.glob("console-alerts*.png"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
