"""A person who has read nothing, at the real console: what can be found by looking only, from the first picture to a mission
that is drawn, sent, sailed and stopped. With a folder on its command line it keeps a picture of each step (`make pictures`).
"""

import asyncio
import contextlib
import signal
import sys
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path

import pytest

from delfim.base.errors import Refused
from delfim.vehicle.operator.link import Link
from tests.console.chain import Boat, Gateway, Radio, afloat
from tests.kit.pictures import keeper
from tests.services.browser import Page, shrink, tab

ROOT = Path(__file__).parents[2]
PATIENCE_S = 200.0
NORTH_M = 1 / 111_111
PLACES = ((30.0, 25.0), (55.0, -5.0), (30.0, -35.0))  # metres north and east of the boat: what this person draws
WITHIN_M = 3.0  # of what was meant, when it comes back from the boat
ITEM = "[...document.querySelectorAll('.popup .item .title')].find(each => each.firstChild.data.includes({!r}))"
TEXT = "document.body.innerText"

Picture = Callable[[str], Awaitable[None]]
Size = tuple[int, int, bool]  # width, height, night
DESK: Size = (1200, 760, False)
PHONE: Size = (390, 780, True)


class Visit:
    """Somebody at the page, who sees what is on the screen and knows nothing else."""

    def __init__(self, page: Page, picture: Picture, touch: bool) -> None:
        self.page, self.picture, self._touch = page, picture, touch

    async def sees(self, words: str) -> None:
        """These words are on the screen, and nothing covers them."""
        try:
            await self.page.until(VISIBLE % repr(words), PATIENCE_S)
        except AssertionError:
            raise AssertionError(f"{words!r} is not to be seen; the screen says {await self.page.value(TEXT)!r}") from None

    async def taps(self, at: tuple[float, float]) -> None:
        if self._touch:
            await self.page.touch("Start", at)
            await self.page.touch("End")
        else:
            await self.page.mouse(at)

    async def chooses(self, title: str) -> None:
        """An item of the menu that is open, once it was there long enough to be read."""
        await self.page.until(f"Boolean({ITEM.format(title)})", PATIENCE_S)
        await self.page.value("new Promise(done => setTimeout(done, 350))")
        row = f"{ITEM.format(title)}.closest('.item')"
        await self.page.value(f"{row}.scrollIntoView({{block: 'nearest'}})")
        assert not await self.page.value(f"{row}.hasAttribute('aria-disabled')"), title
        await self.taps(await self.middle_of(row))

    async def middle_of(self, element: str) -> tuple[float, float]:
        x, y = await self.page.value(f"(r => [r.x + r.width / 2, r.y + r.height / 2])({element}.getBoundingClientRect())")
        return x, y

    async def taps_the_sea(self, place: tuple[float, float]) -> None:
        """As soon as the menu before has gone, which a tap would only close, and nothing but words covers the place."""
        x, y = at = await self.pixel(place)
        is_free = f"document.elementFromPoint({x}, {y}).tagName === 'CANVAS'"
        await self.page.until(f"document.querySelector('.popup').hidden && {is_free}", PATIENCE_S)
        await self.taps(at)

    async def pixel(self, place: tuple[float, float]) -> tuple[float, float]:
        x, y = await self.page.value(f"delfim.pixel({place[0]}, {place[1]})")
        return x, y


VISIBLE = """(words => {
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node; (node = walk.nextNode()); ) {
    if (!node.data.includes(words)) continue;
    const its = node.parentElement, box = its.getBoundingClientRect();
    const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
    if (!box.width || x < 0 || y < 0 || x > innerWidth || y > innerHeight) continue;
    const top = document.elementFromPoint(x, y); // what lets the pointer through is not found there
    if (its.contains(top) || getComputedStyle(its).pointerEvents === "none") return true;
  }
  return false;
})(%s)"""


@contextlib.asynccontextmanager
async def console(folder: Path) -> AsyncIterator[tuple[Gateway, Radio, int, str]]:
    gateway = Gateway(folder)
    radio = Radio(gateway.boats)
    port = await radio.open()
    try:
        yield gateway, radio, port, await asyncio.to_thread(gateway.start)
    finally:
        gateway.end(signal.SIGTERM)
        radio.close()


async def voyage(folder: Path, size: Size, picture: Callable[[Page, str], Awaitable[None]]) -> None:
    width, height, night = size
    async with console(folder) as (gateway, _, port, url), tab() as page:
        touch = width < 600
        if touch:
            await page.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=1)
            await page.call("Emulation.setEmitTouchEventsForMouse", enabled=False)
        await page.open(url, width=width, height=height, scale=1.0, dark=night)
        await page.call("Page.bringToFront")
        you = Visit(page, lambda name: picture(page, name), touch)
        await you.sees(f"No boat heard on 127.0.0.1:{gateway.boats[1]} yet")
        await stop(you)
        await you.sees("nothing to command")
        await you.picture("nobody")
        with afloat(folder / "1", 1, port) as boat:
            async with sailing(boat):
                await first_sight(you, boat)
                await drawn(you, boat)
                await sent_and_sailed(you, boat)


@contextlib.asynccontextmanager
async def sailing(boat: Boat) -> AsyncIterator[None]:
    """As `delfim sim` has it: a mission aboard and under way, and its operator heard until a console takes over."""
    await boat.until(lambda state: state["age_s"]["navigation"] is not None)
    with Link(boat.place / "command") as link:
        link.ask("mission", text=(ROOT / "etc/missions/doca.toml").read_text())
        await boat.until(lambda state: link.ask("alive") and all(check["ok"] for check in state["checks"]))
        link.ask("play")
        await boat.until(lambda state: state["mode"] == "play")
        heard = asyncio.create_task(present(link))
        try:
            yield
        finally:
            heard.cancel()


async def present(link: Link) -> None:
    with contextlib.suppress(Refused):
        while link.ask("alive")["operator"] == "local":
            await asyncio.sleep(1.0)


async def first_sight(you: Visit, boat: Boat) -> None:
    """Name, mission and way of the boat, without a click."""
    await you.sees("boat1")
    await you.sees("waypoint 1 of 12")
    await you.sees("To go")
    await you.sees("Heading")
    await you.sees("a menu opens")
    await you.page.until("delfim.drawn().aboard === 12 && delfim.drawn().plan === 12", PATIENCE_S)
    state = boat.state()
    x, y = await you.pixel((state["latitude_deg"], state["longitude_deg"]))
    width, height = await you.page.value("[innerWidth, innerHeight]")
    assert 0 < x < width, "the boat is in sight"
    assert 0 < y < height
    await you.picture("first")


async def drawn(you: Visit, boat: Boat) -> None:
    """A tap on the sea opens a menu; what it says leads to a mission of one's own."""
    state = boat.state()
    here = state["latitude_deg"], state["longitude_deg"]
    places = [(here[0] + north_m * NORTH_M, here[1] + east_m * NORTH_M / 0.78) for north_m, east_m in PLACES]
    await you.page.value(f"delfim.fit({here[0] - 0.0004}, {here[1] - 0.0006}, {here[0] + 0.0007}, {here[1] + 0.0006})")
    await you.taps_the_sea(places[0])
    await you.sees("Add waypoint")
    await you.picture("menu")
    await you.sees("Draw a mission")
    await you.chooses("Mission")
    await you.chooses("New mission")
    for place in places:
        await you.taps_the_sea(place)
        await you.chooses("Add waypoint")
    await you.page.until("delfim.drawn().plan === 3 && delfim.drawn().aboard === 12")
    await you.sees("differs")
    await you.picture("drawn")


async def sent_and_sailed(you: Visit, boat: Boat) -> None:
    await you.taps(await you.middle_of("document.querySelector('.chip .head')"))
    await you.chooses("Play mission")
    await you.sees("The plan is not aboard")
    assert boat.state()["legs"] == 12, "nothing was changed before the answer"
    await you.picture("asked")
    await you.chooses("Hold, send the plan, then play it")
    await boat.until(lambda state: state["mode"] == "play" and state["legs"] == 3)
    await you.sees("waypoint 1 of 3")
    await you.sees("same")
    await you.page.until("delfim.drawn().aboard === 3")
    await boat.until(lambda state: state["speed_mps"] > 1.0)
    await you.picture("sailed")
    await stop(you)
    await boat.until(lambda state: state["mode"] == "idle" and not any(each["thrust"] for each in state["thrusters"].values()))
    await you.page.until("document.getElementById('stop').dataset.state === 'idle'", PATIENCE_S)
    await you.picture("stopped")


async def stop(you: Visit) -> None:
    await you.taps(await you.middle_of("document.getElementById('stop')"))


async def nothing(page: Page, name: str) -> None:
    """No picture is kept."""


@pytest.mark.long
@pytest.mark.parametrize("size", [pytest.param(DESK, id="desk"), pytest.param(PHONE, id="phone")])
def test_who_has_read_nothing_draws_sends_sails_and_stops_a_mission(tmp_path: Path, size: Size) -> None:
    asyncio.run(voyage(tmp_path, size, nothing))


def main(folder: Path) -> None:
    its = keeper(folder, "voyage-phone", "first", "menu", "asked", "sailed")
    for size, picture in ((DESK, keeper(folder, "voyage")), (PHONE, its)):
        with tempfile.TemporaryDirectory(prefix="voyage-", ignore_cleanup_errors=True) as place:
            asyncio.run(voyage(Path(place), size, picture))
    shrink(folder.glob("voyage-*.png"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
