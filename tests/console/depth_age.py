"""How old a sounding is when the page draws it, through the real chain, and what depths take of the link:
`python -m tests.console.depth_age [radio]`. A boat's programs, the console's and Chromium run on this machine, by one clock.
"""

import asyncio
import contextlib
import csv
import signal
import sys
import tempfile
from collections.abc import AsyncIterator
from datetime import datetime
from pathlib import Path
from statistics import median
from typing import Any

from delfim.console.boats.depths import DepthGrid
from tests.console.chain import PATIENCE_S, Boat, Radio, _messages, afloat
from tests.console.test_depths import SOUNDER
from tests.console.test_first_voyage import DESK, Gateway
from tests.services.browser import tab

CYCLES = 250  # of the boat's navigation, five a second
HEARD = "document.getElementById('strips').textContent.includes('hdg ')"
WATCH = """(() => {
  window.grown = [];
  let was = delfim.depths()[0];
  setInterval(() => {
    const now = delfim.depths()[0];
    for (; was < now; was++) grown.push(Date.now() / 1000);
  }, 20);
  return was;
})()"""


class Counted(Radio):
    """A link that counts the bytes of the depths."""

    depth_bytes = all_bytes = 0

    def _from_boat(self, data: bytes, address: tuple[str, int]) -> None:
        super()._from_boat(data, address)
        self.all_bytes += len(data)
        kinds = [message.get_type() for message in _messages(data)]
        if "WATER_DEPTH" in kinds:
            self.depth_bytes += len(data) if len(kinds) == 1 else sum(len(m.get_msgbuf()) for m in _depths(data))


def _depths(data: bytes) -> list[Any]:
    return [message for message in _messages(data) if message.get_type() == "WATER_DEPTH"]


@contextlib.asynccontextmanager
async def linked(folder: Path) -> AsyncIterator[tuple[Counted, int, str]]:
    """A console, and the link to it: the link, its port, and where the page is."""
    gateway = Gateway(folder)
    radio = Counted(gateway.boats)
    port = await radio.open()
    try:
        yield radio, port, await asyncio.to_thread(gateway.start)
    finally:
        gateway.end(signal.SIGTERM)
        radio.close()


async def measured(folder: Path, profile: str) -> None:
    """Prints the ages on a profile of the link, and the bytes a second."""
    settings = (*SOUNDER, f'mavlink.profile="{profile}"')
    async with linked(folder) as (radio, port, url), tab() as page:
        await page.open(url, width=DESK[0], height=DESK[1], scale=1.0)
        with afloat(folder / "1", 1, port, settings) as boat:
            await boat.until(lambda state: state["measured"].get("depth_m") and state["log"]["writable"])
            await page.until("delfim.depths()[0] > 0", PATIENCE_S)
            await page.call("Page.bringToFront")
            await page.value("document.querySelector('#hint button')?.click()")
            await page.until(HEARD, PATIENCE_S)
            await page.press("h")
            await boat.until(lambda state: state["mode"] == "heading")
            await page.press("6")
            began_s, seen = await page.value("Date.now() / 1000"), await page.value(WATCH)
            before, whole = radio.depth_bytes, radio.all_bytes
            await boat.sails_on(CYCLES)
            took_s = await page.value("Date.now() / 1000") - began_s
            taken, every = (radio.depth_bytes - before) / took_s, (radio.all_bytes - whole) / took_s
            grown = await page.value("grown")
        made = (await pinged(boat, folder))[seen:]
    ages = [drawn_s - pinged_s for drawn_s, pinged_s in zip(grown, made, strict=False)]
    print(f"{len(grown)} of {len(made)} cells, age {median(ages):.2f} s (median), {max(ages):.2f} s at most; ", end="")
    print(f"depths {taken:.0f} bytes/s of {every:.0f}", flush=True)


async def pinged(boat: Boat, folder: Path) -> list[float]:
    """When the first sounding of each cell of the page was made, by the boat's own log, s since 1970, in their order."""
    file = folder / "soundings.csv"
    command = sys.executable, "-m", "delfim", "log", "export", "soundings", str(boat.place / "log"), "--output", str(file)
    program = await asyncio.create_subprocess_exec(*command, stdout=asyncio.subprocess.DEVNULL)
    assert await program.wait() == 0
    grid, cells, found = DepthGrid(), set[tuple[int, ...]](), list[float]()
    for row in csv.DictReader(file.open()):
        if row["latitude [deg]"]:
            grid.add(*(float(row[name]) for name in ("latitude [deg]", "longitude [deg]", "depth_m [m]")))
            new = {(*each["tile"], cell) for each in grid.changes() for cell, _ in each["cells"]} - cells
            cells |= new
            found += [datetime.fromisoformat(row["utc"]).timestamp()] * len(new)
    return found


async def main() -> None:
    with tempfile.TemporaryDirectory(prefix="depth-age-", ignore_cleanup_errors=True) as folder:
        await measured(Path(folder), *(sys.argv[1:] or ["wifi"]))


if __name__ == "__main__":
    asyncio.run(main())
