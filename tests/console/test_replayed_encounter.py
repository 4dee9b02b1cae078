"""A boat keeps clear of a ship, and afterwards its log is opened on the real page. With a folder on its command line it keeps
a picture of that (`make pictures`).
"""

import asyncio
import base64
import itertools
import sys
import tempfile
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from delfim.base.clock import ManualClock
from delfim.console.gateway.gateway import Gateway
from delfim.console.tapes.replay import TapePlayer, open_tapes
from delfim.vehicle import console as orders
from tests.console.scenes import show
from tests.console.test_newcomer import Console, console
from tests.logging.sailing import Day
from tests.services.browser import shrink

AT_SEA = (
    'sensors.names=["sysstat", "nmea2000"]',
    "simulation.heading_deg=180.0",
    "simulation.traffic.vessel=["
    '{name="MARIA", transponder="A", length_m=30.0, beam_m=6.0, north_m=-300.0, east_m=-960.0, course_deg=90.0, speed_mps=3.0},'
    '{name="TEJO", transponder="B", north_m=100.0, east_m=320.0, course_deg=200.0, speed_mps=1.2, silent_from_s=40.0},'
    '{name="PILAR 7", transponder="A", length_m=40.0, beam_m=8.0, north_m=-330.0, east_m=230.0, course_deg=300.0}]',
)
BEGINS_S, MEETS_S, ENDS_S = 120.0, 240.0, 400.0  # it sails, it gives way, its log ends
GRAPH_S = 60.0  # of thruster speed are in the strip
WORDS = "giving way to MARIA, crossing from starboard, passing astern, CPA "
TEXT = "document.querySelector('{}').innerText"
AT = "(line => line.value - line.min)(document.querySelector('#replay input'))"
SEEK = """((line, at_s) => {
  line.value = Number(line.min) + at_s;
  for (const kind of ["input", "change"]) line.dispatchEvent(new Event(kind));
})(document.querySelector("#replay input"), %s)"""


def kept_clear(place: Path) -> None:
    """The log of a boat that gives way to a ship, with one that lies and one that has fallen silent."""
    day = Day(place, *AT_SEA)
    day.sail(BEGINS_S)
    assert day.command(orders.Course(course_deg=180.0, speed_mps=1.5)) is None
    for _ in range(round((ENDS_S - BEGINS_S) / 2.0)):
        day.command(orders.Alive())
        day.sail(2.0)
    day.end()


async def replayed(place: Path, picture: Callable[[Console], Awaitable[None]]) -> None:
    kept_clear(place / "log")
    async with console(place, open_tapes([place / "log"])) as it:
        page = it.page
        await page.value("document.querySelector('#hint button').click()")
        await page.value(SEEK % (MEETS_S - GRAPH_S))
        for _ in range(4):
            await page.press("ArrowUp")  # 30 times as fast
        await page.until(f"{AT} > {MEETS_S - 2.0}")
        await page.press(" ")  # time stands still
        await page.value(SEEK % MEETS_S)
        await page.until(f"{AT} === {MEETS_S}")
        await page.until(f"{TEXT.format('#traffic')}.includes({WORDS!r})")
        said = f"{TEXT.format('#traffic')}.match(/AIS: 3 targets, last report [0-9]+ s ago. Sees only who transmits./)"
        await page.until(f"Boolean({said})")
        assert sorted(await page.value("delfim.vessels().map(([name]) => name)")) == ["MARIA", "PILAR 7", "TEJO"]
        await page.value("document.querySelector('.chip [aria-expanded=false]').click()")
        await page.until(f"{TEXT.format('.chip')}.includes('log')")
        strip = await page.value(TEXT.format(".chip"))
        assert "from the boat's own log" in strip
        assert not [words for words in ("not ready", "not read", "signed", "% ·", "wifi") if words in strip], strip
        await page.value("document.querySelector('#traffic .said').click()")
        await page.until(f"{TEXT.format('#traffic')}.includes('lost 3 min')")
        assert await page.value("document.querySelector('#traffic .main').hidden"), "nobody has to take note of what is over"
        await show(page, -440, -480, 40, 480)
        await picture(it)
        await page.value(SEEK % ENDS_S)
        await page.until(f"!{TEXT.format('#traffic')}.includes({WORDS!r})")


async def nothing(it: Console) -> None:
    """No picture is kept."""


@pytest.mark.long
def test_the_log_of_a_boat_that_kept_clear_is_seen_on_the_page(tmp_path: Path) -> None:
    asyncio.run(replayed(tmp_path, nothing))


@pytest.mark.long
def test_in_a_fast_replay_the_vessels_keep_up_with_the_boat(tmp_path: Path) -> None:
    kept_clear(tmp_path / "log")
    clock, told = ManualClock(), list[dict[str, Any]]()
    gateway = Gateway(clock, tmp_path, tapes=open_tapes([tmp_path / "log"]))
    gateway.viewers.append(told.append)
    player = gateway.fleet
    assert isinstance(player, TapePlayer)
    for rate, most_s in ((1.0, 1.0), (10.0, 1.0), (60.0, 6.0)):
        told.clear()
        player.steer(player.from_s + BEGINS_S, rate)
        begun_s = player.at_s
        gateway.tick()
        assert {"boats", "vessels"} <= {each["t"] for each in told}, "at once after a jump"
        for _ in range(60):
            clock.advance(0.05)
            gateway.tick()
        times = [each["at_s"] for each in told if each["t"] == "vessels"]
        assert times[-1] - begun_s == pytest.approx(3.0 * rate, abs=most_s)
        assert max(b - a for a, b in itertools.pairwise(times)) < most_s + 0.01
    gateway.close()


def main(folder: Path) -> None:
    file = folder / "console-traffic-replay.png"

    async def picture(it: Console) -> None:
        await it.page.value("new Promise(done => setTimeout(done, 900))")
        taken = await it.page.call("Page.captureScreenshot", format="png")
        file.write_bytes(base64.b64decode(taken["data"]))

    with tempfile.TemporaryDirectory(prefix="replay-", ignore_cleanup_errors=True) as place:
        asyncio.run(replayed(Path(place), picture))
    shrink([file])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
