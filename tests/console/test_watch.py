"""A watch over three boats, at the real page: one falls silent under way, one goes home by a key, one loses a propeller;
what is wrong stays on the screen until somebody has taken note of it, and the log outlives the page. With a folder on its
command line it keeps a picture of each step.
"""

import asyncio
import base64
import re
import signal
import sys
import tempfile
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from tests.console.chain import PATIENCE_S, Sea, operating, select
from tests.console.scenes import choose
from tests.console.test_operating import drawn, pressed, sent
from tests.services.browser import shrink

ALERTS = "delfim.alerts().filter(([text]) => text.includes({!r}))"
FIRST = "document.querySelector('#bar p').textContent"
SAID = "document.getElementById('said').children.length"

Picture = Callable[[str], Awaitable[None]]


def of(number: int, what: str) -> str:
    return f"document.querySelector('[data-boat=\"{number}\"] {what}')"


async def alert(sea: Sea, words: str, state: str) -> None:
    """`state`: as IEC 62923 names it; "": it is not there any more."""
    found = ALERTS.format(words)
    await sea.page.until(f"{found}[0]?.[1] === {state!r}" if state else f"!{found}.length", PATIENCE_S)


async def noted(sea: Sea, words: str) -> None:
    """K takes the alerts one by one, the gravest first, until this one has been taken note of."""
    first = await sea.page.value(FIRST)
    while words not in first:
        await sea.page.press("k")
        await sea.page.until(f"{FIRST} !== {first!r}", PATIENCE_S)
        first = await sea.page.value(FIRST)
    await sea.page.press("k")


async def a_boat_falls_silent(sea: Sea, picture: Picture) -> None:
    """The map goes on, the alarm stays until it is seen, and then as long as the boat is silent."""
    page, boat = sea.page, sea.boats[0]
    await select(page, 1)
    await drawn(page, boat, [(60, -30), (60, 30), (-40, 30)])
    await sent(page)
    await pressed(page, boat, "y", "play")
    await page.until(f"{of(1, '.left')}.textContent.endsWith('to go')")
    sea.radios[0].cut()
    await alert(sea, "link lost", "unacknowledged")
    await page.value("new Promise(done => setTimeout(done, 1100))")
    assert await page.value("delfim.frames()") > 0, "of the last second"
    await picture("silent")
    await noted(sea, "link lost")
    await alert(sea, "link lost", "acknowledged")


async def a_boat_goes_home(sea: Sea, picture: Picture) -> None:
    page, boat = sea.page, sea.boats[1]
    await select(page, 2)
    await pressed(page, boat, "h", "heading")
    await page.press("5")
    await boat.until(lambda state: state["speed_mps"] > 0.5)
    await boat.sails_on(20)
    await pressed(page, boat, "l", "home")
    await page.until(f"{of(2, '.mode')}.textContent === 'home'")
    await picture("home")


async def a_boat_loses_a_propeller(sea: Sea, picture: Picture) -> None:
    """It stops itself; why is not pushed away by what others say, nor by a reload."""
    page, boat = sea.page, sea.boats[2]
    await select(page, 3)
    await pressed(page, boat, "h", "heading")
    await page.press("5")
    await boat.until(lambda state: state["speed_mps"] > 0.5)
    assert "thruster_dead" in await boat.delfim("fault", "thruster_dead", "port")
    await boat.until(lambda state: state["mode"] == "idle")
    await page.until(f"{of(3, '.trouble.bad')}?.textContent.startsWith('stopped: ')")
    why = await page.value(f"{of(3, '.trouble.bad')}.textContent.slice(9, 30)")
    await alert(sea, why, "unacknowledged")
    for key in ("g", "p", "y", "x", "g"):  # it has no mission: each is refused
        await page.press(key)
    await page.until(f"{SAID} > 2")
    await alert(sea, why, "unacknowledged")
    await picture("stopped")
    await page.reload()
    await sea.page.until("window.delfim?.online() && document.querySelectorAll('.chip').length === 3")
    await alert(sea, why, "unacknowledged")
    assert await page.value(f"{of(3, '.trouble.bad')}.textContent.includes({why!r})")
    await page.press("s")
    await alert(sea, why, "silenced")
    await noted(sea, why)
    await alert(sea, why, "acknowledged")
    await page.press("a")
    await page.until(f"[...document.querySelectorAll('#alerts tr')].some((each) => each.textContent.includes({why!r}))")
    await picture("alerts")
    await page.press("Escape")
    await boat.delfim("fault", "end")
    await alert(sea, why, "")


async def the_log_has_it_all(sea: Sea, picture: Picture) -> None:
    page = sea.page
    sea.radios[0].mend()
    await alert(sea, "link lost", "")
    await page.mouse((640.0, 700.0))
    await choose(page, "Screen", "Log of the watch")
    rows = await page.value(
        "[...document.querySelectorAll('#log tr')].map((each) => [...each.children].map((c) => c.textContent))"
    )
    had = {(boat, what, text) for _, boat, _, what, text in rows[1:]}
    assert {("boat1", "order", "play"), ("boat2", "order", "home"), ("boat1", "notice", "heard again")} <= had
    assert {what for _, what, text in had if "link lost" in text} == {"warning", "acknowledged", "over"}
    assert {what for boat, what, _ in had if boat == "boat3"} >= {"alarm", "refused", "silenced", "acknowledged", "over"}
    await picture("log")
    table = await page.value("fetch(document.querySelector('#log a').href).then((answer) => answer.text())")
    assert re.search(r"boat2,page \d+ at 127\.0\.0\.1,order,home", table)
    await page.press("Escape")


async def watch(folder: Path, keep: Path | None = None) -> None:
    async with operating(folder, "simulation.faults=true", count=3) as sea:

        async def picture(name: str) -> None:
            if keep is not None:
                taken = await sea.page.call("Page.captureScreenshot", format="png")
                (keep / f"watch-{name}.png").write_bytes(base64.b64decode(taken["data"]))

        await a_boat_falls_silent(sea, picture)
        await a_boat_goes_home(sea, picture)
        await a_boat_loses_a_propeller(sea, picture)
        await the_log_has_it_all(sea, picture)
        await sea.nothing_amiss()


@pytest.mark.long
def test_a_watch_over_three_boats(tmp_path: Path) -> None:
    asyncio.run(watch(tmp_path))


async def killed(folder: Path) -> None:
    """The console is killed under a stopped boat: what nobody has seen comes back with its first time, and so does the log."""
    async with operating(folder, "simulation.faults=true", count=1) as sea:
        page, boat = sea.page, sea.boats[0]
        await pressed(page, boat, "h", "heading")
        await page.press("5")
        await boat.until(lambda state: state["speed_mps"] > 0.5)
        await boat.delfim("fault", "thruster_dead", "port")
        await page.until(f"{of(1, '.trouble.bad')}?.textContent.startsWith('stopped: ')")
        why = await page.value(f"{of(1, '.trouble.bad')}.textContent.slice(9, 30)")
        await alert(sea, why, "unacknowledged")
        since = "document.querySelector('#bar small').textContent"
        began = await page.value(since)
        kept = folder / "sessions/alerts.json"
        async with asyncio.timeout(PATIENCE_S):
            while why not in (kept.read_text() if kept.exists() else ""):
                await asyncio.sleep(0.01)
        sea.gateway.end(signal.SIGKILL)
        await page.until("!document.getElementById('offline').hidden")
        await asyncio.to_thread(sea.gateway.start)
        await page.until("document.getElementById('offline').hidden && document.querySelectorAll('.chip').length === 1", 60)
        await alert(sea, why, "unacknowledged")
        assert await page.value(since) == began
        await page.mouse((640.0, 700.0))
        await choose(page, "Screen", "Log of the watch")
        await page.until("[...document.querySelectorAll('#log tr')].some((each) => each.textContent.includes('heading'))")
        await page.press("Escape")
        await noted(sea, why)
        await alert(sea, why, "acknowledged")
        page.calls_in_vain = True


@pytest.mark.long
def test_alerts_and_log_outlive_a_killed_console(tmp_path: Path) -> None:
    asyncio.run(killed(tmp_path))


if __name__ == "__main__":
    with tempfile.TemporaryDirectory(prefix="watch-", ignore_cleanup_errors=True) as place:
        asyncio.run(watch(Path(place), Path(sys.argv[1])))
    shrink(Path(sys.argv[1]).glob("watch-*.png"))
