"""How the page draws all that it promises at once: ten boats, two hundred vessels and a hundred thousand soundings; and what it
takes when nobody touches it. `python -m tests.console.crowded` prints both. A headless Chromium draws without a graphics card.
"""

import asyncio
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


async def at_rest(page: Page, gateway: Standin) -> float:
    """Its share of a core while ten boats and all vessels are told as they are at sea."""
    begun_s, before_s = time.monotonic(), await busy_s(page)
    n = 0
    while (since_s := time.monotonic() - begun_s) < REST_S:
        if n <= since_s * 10:
            n += 1
            for each in gateway.boats:
                each["latitude_deg"] += 1e-6
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
            print(f"nobody at the mouse: {100 * await at_rest(page, gateway):.1f} % of a core")
            await page.call("Page.navigate", url="about:blank")


if __name__ == "__main__":
    asyncio.run(main())
