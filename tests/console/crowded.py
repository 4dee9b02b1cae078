"""How the page draws all that it promises at once: ten boats, two hundred vessels and a hundred thousand soundings; and what it
takes when nobody touches it: steady, and swaying, with values that are others in each message, as measured ones are.
`python -m tests.console.crowded` prints all. A headless Chromium draws without a graphics card.
"""

import asyncio
import random
import tempfile
import time
from pathlib import Path

from tests.console.million_depths import gridded
from tests.console.scenes import fleet, opened, show
from tests.console.standin import Standin, vessel
from tests.kit.page import second_of_moving
from tests.services.browser import Page, browser

REST_S = 20.0
BUSY = "Performance.getMetrics"


async def busy_s(page: Page) -> float:
    """Processor time of the page, all its threads."""
    metrics = (await page.call(BUSY))["metrics"]
    return next(float(each["value"]) for each in metrics if each["name"] == "ProcessTime")


def sway(gateway: Standin, drawn: random.Random) -> None:
    """Each boat by what waves and sensors make of a steady course."""
    for each in gateway.boats:
        each["speed_mps"] = 1.5 + drawn.uniform(0.0, 0.1)
        each["heading_deg"] = (each["course_deg"] + drawn.uniform(0.0, 2.0)) % 360.0
        each["rpm"] = [800.0 + drawn.uniform(0.0, 20.0), 830.0 + drawn.uniform(0.0, 20.0)]
        each["thrust_pct"] = [40.0 + drawn.uniform(0.0, 3.0)] * 2
        each["battery_v"] = 49.0 + drawn.uniform(0.0, 0.2)
        each["link"]["rtt_ms"] = drawn.uniform(1.0, 5.0)
        each["age_s"] = {group: round(drawn.uniform(0.0, 0.2), 2) for group in each["age_s"]}


async def at_rest(page: Page, gateway: Standin, swaying: bool) -> float:
    """Its share of a core while ten boats and all vessels are told as they are at sea."""
    drawn = random.Random(1)
    begun_s, before_s = time.monotonic(), await busy_s(page)
    n = 0
    while (since_s := time.monotonic() - begun_s) < REST_S:
        if n <= since_s * 10:
            n += 1
            for each in gateway.boats:
                each["latitude_deg"] += 1e-6
            if swaying:
                sway(gateway, drawn)
            await gateway.frame()
            if n % 10 == 0:
                for each in gateway.vessels:
                    each["longitude_deg"] += 1e-5
                await gateway.look()
        await asyncio.sleep(0.01)
    return (await busy_s(page) - before_s) / since_s


async def main() -> None:
    """Measure, and print."""
    told = list(gridded(1).whole())
    with tempfile.TemporaryDirectory(prefix="crowd-", ignore_cleanup_errors=True) as folder:
        async with Standin(fleet(10)).serving() as gateway, browser(Path(folder)) as page:
            await page.call("Performance.enable")
            await opened(page, gateway)
            for each in told:
                await gateway.tell(each)
            places = ((60.0 * (n % 20) - 600.0, 120.0 * (n // 20) - 600.0) for n in range(200))
            gateway.vessels = [vessel(f"V{n}", north_m=at[0], east_m=at[1], speed_mps=2.0) for n, at in enumerate(places)]
            gateway.reported_s = 1.0
            await gateway.look()
            await page.until("delfim.depths()[0] === 100000 && delfim.vessels().length === 200", 120.0)
            await show(page, -600, -600, 600, 600)
            frames = [await second_of_moving(page, gateway, "dragged") for _ in range(5)]
            print(f"dragged: {frames} frames a second")
            for swaying, how in (False, "steady"), (True, "swaying"):
                print(f"nobody at the mouse, {how}: {100 * await at_rest(page, gateway, swaying):.1f} % of a core")
            await page.call("Page.navigate", url="about:blank")


if __name__ == "__main__":
    asyncio.run(main())
