"""The last ten minutes of the selected boat at the foot of the page."""

from tests.console.scenes import at_work, choose
from tests.kit.page import sailing, shown


async def test_the_last_ten_minutes_have_values_changes_of_mode_and_messages_and_nothing_older() -> None:
    gateway = at_work()
    async with sailing(gateway) as page:
        await page.press("Tab")
        await page.mouse((700.0, 120.0))
        await choose(page, "Screen", "The last ten minutes")
        told = gateway.boat(2)
        marks = "[...document.querySelectorAll('#timeline .marks i')].map((each) => each.title.slice(9)).join()"
        for depth_m in (4.0, 5.0, 6.0):
            told["measured"] = {"depth_m": {"value": depth_m, "age_s": 0.1}}
            await gateway.frame(2.0)
        await gateway.tell({"t": "text", "boat": 2, "severity": 4, "text": "guest silent", "at_s": gateway.at_s})
        await gateway.tell({"t": "text", "boat": 1, "severity": 4, "text": "of the other", "at_s": gateway.at_s})
        told["mode"] = "hold"
        await gateway.frame(2.0)
        await shown(page, gateway, f"{marks} === 'guest silent,hold'")
        values = "[...document.querySelectorAll('#timeline figcaption')].map((each) => each.textContent).join()"
        await shown(page, gateway, f"{values}.includes('depth 6.0 m  (4 to 6)') && {values}.includes('speed')")
        told["measured"] = {}
        for _ in range(2):
            await gateway.frame(301.0)
        await shown(page, gateway, f"{marks} === '' && !{values}.includes('depth')")
        await page.mouse((420.0, 120.0))  # beside the messages
        await choose(page, "Screen", "The last ten minutes")
        await shown(page, gateway, "document.getElementById('timeline').hidden")
        await page.nothing_amiss()
