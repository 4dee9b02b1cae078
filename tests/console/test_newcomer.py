"""The page for somebody who is new to it, in a real browser at a real gateway: before a boat is heard, without a pointer, in a
recording. Boats are a few lines that speak MAVLink; the whole vehicle is met in test_first_voyage.py.
"""

import asyncio
import contextlib
import io
import math
import socket
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from pymavlink.dialects.v20 import common as mavlink

from delfim.base.clock import ManualClock, SystemClock
from delfim.base.modes import Mode
from delfim.console.boats.fleet import Fleet
from delfim.console.gateway.gateway import Gateway
from delfim.console.gateway.serving import serve
from delfim.console.link.session import Session
from delfim.console.tapes.replay import open_tapes
from delfim.console.tapes.tape import Tape
from tests.console.fakeboat import FakeBoat
from tests.console.scenes import choose
from tests.services.browser import Page, tab

PLANNED = "delfim.drawn().plan"
SHOWN_MODE = "document.querySelector('.chip.selected').dataset.mode"
SMALL_TEXT = """[...document.querySelectorAll('body *')].filter((each) => each.getClientRects().length &&
  [...each.childNodes].some((node) => node.nodeType === Node.TEXT_NODE && node.data.trim()) &&
  parseFloat(getComputedStyle(each).fontSize) < 12).map((each) => each.outerHTML)"""
NAMELESS = """[...document.querySelectorAll('button, input')].filter((each) => each.getClientRects().length &&
  !(each.getAttribute('aria-label') || each.textContent.trim())).map((each) => each.outerHTML)"""


class Console:
    """A gateway, the page that it serves, and boats that may appear."""

    def __init__(self, gateway: Gateway, port: int, url: str, page: Page, folder: Path) -> None:
        self.gateway, self.port, self.url, self.page, self.folder = gateway, port, url, page, folder
        self.boats: list[FakeBoat] = []
        self._links: list[socket.socket] = []

    def boat(self, number: int) -> FakeBoat:
        """It is heard from now on."""
        link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        link.setblocking(False)
        link.connect(("127.0.0.1", self.port))
        boat = FakeBoat(number, SystemClock(), link.send)  # type: ignore[arg-type]
        asyncio.get_running_loop().add_reader(link, lambda: boat.hear(link.recv(2048)))
        self._links.append(link)
        self.boats.append(boat)
        return boat

    async def speak(self) -> None:
        """The boats speak, whatever the test waits for."""
        while True:
            for boat in self.boats:
                boat.tick()
            await asyncio.sleep(0.05)

    async def said(self, words: str) -> None:
        await self.page.until(f"document.getElementById('messages').textContent.includes({words!r})")

    def hang_up(self) -> None:
        for link in self._links:
            asyncio.get_running_loop().remove_reader(link)
            link.close()


@contextlib.asynccontextmanager
async def console(
    folder: Path, tapes: list[Tape] | None = None, vehicle: Path | None = None, *, dark: bool = False
) -> AsyncIterator[Console]:
    gateway = Gateway(SystemClock(), folder / "missions", tapes=tapes or (), vehicle=vehicle, charts=folder / "charts")
    ready = asyncio.get_running_loop().create_future()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    async with asyncio.TaskGroup() as group, tab() as page:
        task = group.create_task(serve(gateway, None if tapes else ("127.0.0.1", port), ("127.0.0.1", 0), ready.set_result))
        it = Console(gateway, port, await ready, page, folder)
        speaking = group.create_task(it.speak())
        try:
            await page.open(it.url, width=1200, height=760, scale=1.0, dark=dark)
            await it.page.until("delfim.online()")
            yield it
            assert await page.value(SMALL_TEXT) == []
            assert await page.value(NAMELESS) == []
            sized = await page.value("document.querySelector('meta[name=viewport]').content")
            assert "user-scalable" not in sized, "two fingers make it larger"
        finally:
            speaking.cancel()
            it.hang_up()
            task.cancel()


@pytest.fixture
def it(tmp_path: Path) -> contextlib.AbstractAsyncContextManager[Console]:
    return console(tmp_path)


async def test_without_a_boat_the_page_says_so_and_stop_and_modes_answer(it: Console) -> None:
    words = f"No boat heard on 127.0.0.1:{it.port} yet"
    assert words in await it.page.value("document.getElementById('nobody').innerText")
    for key in (" ", "y"):
        await it.page.press(key)
        await it.said(f"{words}: nothing to command")
        await it.page.value("document.querySelectorAll('.message').forEach((each) => each.remove())")
        await it.page.value("new Promise(done => setTimeout(done, 3100))")  # the same again within 3 s is not shown twice
    it.boat(3)
    await it.page.until("document.getElementById('nobody').hidden")


async def test_a_mission_is_planned_by_keys_before_a_boat_is_heard_and_is_the_first_boats(it: Console) -> None:
    page = it.page
    await page.value("delfim.fit(38.689, -9.217, 38.691, -9.213)")
    await page.press("w")
    await page.press("w")
    await it.page.until(f"{PLANNED} === 1")
    for _ in range(6):
        await page.press("ArrowRight")
    await page.press("w")
    await it.page.until(f"{PLANNED} === 2")
    await page.press("Enter")
    await page.until("document.querySelector('.popup .item') !== null")
    assert "Waypoint 2" in await page.value("document.querySelector('.popup header').textContent"), "it is under the crosshair"
    await page.press("Escape")
    await page.press("ArrowUp")
    await page.press("ArrowUp")
    await page.press("Enter")
    await choose(page, "Mission", "Save under a new name…")
    await page.until("document.activeElement.matches('.name')")
    for letter in "Yay":
        await page.call("Input.insertText", text=letter)
    await page.press("Enter")
    await it.said("saved: Yay")
    assert "Yay" in [each.stem for each in (it.folder / "missions").glob("*.toml")]
    await page.press("Escape")
    it.boat(3)
    await it.page.until(f"document.querySelector('.chip') !== null && {PLANNED} === 2")
    await it.page.until("document.querySelector('.badge').textContent === 'not sent'")
    assert len(it.gateway.fleet.missions[3]["here"]["waypoints"]) == 2
    assert it.boats[0].obeyed == []


async def test_space_stops_while_a_name_is_typed_and_letters_are_no_modes(it: Console) -> None:
    boat = it.boat(1)
    await it.page.until("document.querySelector('.chip') !== null")
    for _ in range(2):
        await it.page.press("w")
    await it.page.press("Escape")
    await it.page.value("document.querySelector('.chip').click()")
    await choose(it.page, "Mission", "Save under a new name…")
    await it.page.until("document.activeElement.matches('.name')")
    for key in ("m", "y", "3"):
        await it.page.press(key)
    await it.page.press(" ")
    await it.page.until("document.querySelector('.popup').hidden")
    async with asyncio.timeout(200):
        while not boat.obeyed:
            await asyncio.sleep(0.02)
    assert {command for command, *_ in boat.obeyed} == {mavlink.MAV_CMD_DO_SET_MODE}
    assert {mode for _, _, mode in boat.obeyed} == {4}, "idle, and nothing else"


async def test_a_refusal_is_shown_once(it: Console) -> None:
    boat = it.boat(1)
    boat.refuse = "heading refused: gps has not reported"
    await it.page.until("document.querySelector('.chip') !== null")
    await it.page.press("h")
    await it.said("gps has not reported")
    await it.page.value("new Promise(done => setTimeout(done, 800))")
    shown = await it.page.value("[...document.querySelectorAll('.message')].map((each) => each.textContent)")
    assert [each for each in shown if "refused" in each] == ["boat 1heading refused: gps has not reported"]


@pytest.mark.long
async def test_what_is_aboard_is_drawn_and_a_mode_that_would_sail_it_asks_first(it: Console) -> None:
    boat = it.boat(1)
    boat.aboard[0] = [
        mavlink.MAVLink_mission_item_int_message(1, 1, n, 6, 16, 0, 1, 0, 3, 0, 0, 386_900_000 + 2000 * n, -92_150_000, 0)
        for n in range(3)
    ]
    await it.page.until("delfim.drawn().aboard === 3 && delfim.drawn().plan === 3")
    await it.page.press("y")
    await until(boat, 1)
    await it.page.until(f"{SHOWN_MODE} === 'play'")
    boat.mode = Mode.IDLE
    await it.page.until(f"{SHOWN_MODE} === 'idle'")  # or a mode of before is taken for the one that comes
    for _ in range(2):
        await it.page.press("w")
    await it.page.press("Escape")
    await it.page.until(f"{PLANNED} === 4 && document.querySelector('.badge').textContent === 'differs'")
    boat.obeyed.clear()
    for key in "ypg":
        await it.page.press(key)
        await it.page.until("document.querySelector('.popup header')?.textContent.includes('The plan is not aboard')")
        await it.page.press("Escape")
    await it.page.press("h")
    await until(boat, 1)
    assert boat.obeyed[0]["command"] == "heading"
    await it.page.until(f"{SHOWN_MODE} === 'heading'")
    boat.obeyed.clear()
    boat.mode = Mode.PLAY
    await it.page.until(f"{SHOWN_MODE} === 'play'")
    await it.page.press("y")
    await choose(it.page, "Hold, send the plan, then play it")
    await until(boat, 2)
    assert boat.obeyed == [{"command": "mode", "mode": "hold"}, {"command": "play"}]
    assert len(boat.aboard[0]) == 4, "it was sent before"
    assert await it.page.value("delfim.drawn().aboard") == 4


async def until(boat: FakeBoat, commands: int) -> None:
    """Until the boat has obeyed so many."""
    async with asyncio.timeout(200):
        while len(boat.obeyed) < commands:
            await asyncio.sleep(0.02)


@pytest.mark.long
async def test_hints_lead_from_the_first_menu_to_a_mission_and_do_not_come_again(it: Console) -> None:
    hint = "document.querySelector('#hint:not([hidden]) span')?.textContent ?? ''"

    async def hinted(words: str) -> None:
        await it.page.until(f"({hint}).includes({words!r})")

    await hinted("a menu opens")
    await it.page.mouse((600.0, 300.0))
    await hinted("Draw a mission")
    await choose(it.page, "Add waypoint")
    assert await it.page.value("document.getElementById('nobody').classList.contains('aside')"), "the plan is seen"
    await it.page.mouse((700.0, 200.0))
    await choose(it.page, "Add waypoint")
    await hinted("“Save”")
    boat = it.boat(3)
    await hinted("“Send to the boat”")
    await it.page.press("Enter")
    await choose(it.page, "Mission", "Send to the boat")
    await hinted("“Play mission”")
    boat.mode = 10  # of its own accord
    await it.page.until("document.querySelector('.mode').textContent === 'mission'")
    await hinted("“Play mission”")
    await it.page.press("y")
    await hinted("stops the boat")
    await it.page.press(" ")
    await it.page.until("document.getElementById('hint').hidden")
    await it.page.press("F1")
    text = await it.page.value("document.getElementById('card').innerText")
    assert "where the boat is steering" in text
    assert "Play mission" in text
    await it.page.open(it.url, width=1200, height=760, scale=1.0)
    await it.page.until("delfim.online() && document.querySelector('.chip') !== null")
    assert await it.page.value("document.getElementById('hint').hidden")


async def test_hints_end_for_good_when_they_are_closed(it: Console) -> None:
    for _ in range(2):
        await it.page.value("document.querySelector('#hint button').click()")
        assert await it.page.value("document.getElementById('hint').hidden")
        await it.page.open(it.url, width=1200, height=760, scale=1.0)
        await it.page.until("delfim.online()")


@pytest.mark.parametrize("dark", [False, pytest.param(True, marks=pytest.mark.long)])
async def test_there_are_land_and_harbours_without_a_network_until_they_would_be_taken_for_a_chart(it, dark):
    async def colours(page: Page, *places: tuple[float, float]) -> list[tuple[int, ...]]:
        await page.value("new Promise(done => setTimeout(done, 300))")  # the view stands still, and is drawn
        picture = Image.open(io.BytesIO(await page.picture())).convert("RGB")
        pixels = [await page.value(f"delfim.pixel{place}") for place in places]
        return [picture.getpixel((round(x), round(y))) for x, y in pixels]  # type: ignore[misc]

    page, base = it.page, "document.getElementById('base').textContent"
    await page.open(it.url, width=1200, height=760, scale=1.0, dark=dark)
    await page.until("delfim.land() > 1000")
    await page.value("document.getElementById('nobody').style.display = 'none', 0")
    await page.value("delfim.fit(35.0, -12.0, 44.0, 2.0)")
    spain, atlantic, majorca, sea = await colours(page, (40.3, -3.3), (37.3, -10.7), (39.75, 3.0), (38.4, 3.1))
    assert (spain, atlantic) == (majorca, sea)
    assert abs(sum(spain) - sum(atlantic)) > 30, "land is seen"
    await page.until("delfim.harbours() === 1081")
    vigo, barcelona = await colours(page, (42.242, -8.726), (41.355, 2.169))
    assert vigo == barcelona, "harbours are dots"
    assert vigo not in (spain, atlantic)
    words = await page.value(base)
    assert "Natural Earth" in words
    assert "not for navigation" in words
    await page.value("delfim.fit(40.30, -3.31, 40.31, -3.29)")
    assert await colours(page, (40.303, -3.303)) == [atlantic], "the grid alone"
    await page.value("delfim.fit(38.695, -9.165, 38.705, -9.155)")
    assert await colours(page, (38.7002, -9.1602)) == [atlantic], "no harbour either"
    assert await page.value(base) == "No chart here. How to add one: Screen in the menu"
    await page.mouse((600.0, 300.0))
    await choose(page, "Screen")
    await page.until("document.querySelector('.popup').textContent.includes('Colours')")
    assert f"put charts into the folder {it.folder}" in await page.value("document.querySelector('.popup').textContent")


@pytest.mark.long
async def test_scale_and_position_do_not_overlap_at_any_zoom(it: Console) -> None:
    await it.page.point(700, 300)
    for _ in range(9):
        await it.page.press("+")
        await it.page.value("new Promise(done => setTimeout(done, 200))")
        await it.page.point(701, 300)
        right, left = await it.page.value(
            "[document.querySelector('.ol-scale-line').getBoundingClientRect().right,"
            "document.getElementById('where').getBoundingClientRect().left]"
        )
        assert right < left


async def test_a_replay_says_so_with_its_keys_its_whole_way_and_its_events(tmp_path: Path) -> None:
    clock = ManualClock(100.0)
    session = Session(tmp_path / "sessions", clock)
    fleet = Fleet(clock, lambda address, data: None, lambda message: None)
    fleet.record = session.put
    boat = FakeBoat(1, clock, lambda data: fleet.receive(1, data))
    for step in range(600):
        clock.advance(0.1)
        boat.position[0] += 10
        boat.tick()
        if step == 300:
            boat.say(mavlink.MAVLink_statustext_message(2, b"failsafe: battery low", 0, 0))
        fleet.tick()
        session.tick()
    session.flush()

    way = [(38.6901, -9.215), (38.6901 + 600e-6, -9.215)]
    async with console(tmp_path, open_tapes([tmp_path / "sessions"])) as it:
        page = it.page
        assert "REPLAY" in await page.value("document.getElementById('replay').innerText")
        marks: Any = await page.value(
            "[...document.querySelectorAll('.marks i')].map((each) => [each.dataset.severity, each.style.left, each.title])"
        )
        assert [(severity, 49 < float(left.rstrip("%")) < 52) for severity, left, _ in marks] == [("grave", True)]
        assert marks[0][2].endswith("failsafe: battery low")
        assert await page.value("delfim.ways()") == 60, "also what was not played yet"
        (first, last), (bar,) = (
            await page.value(f"[{', '.join(f'delfim.pixel({place[0]}, {place[1]})' for place in way)}]"),
            await page.value("[document.getElementById('replay').getBoundingClientRect().top]"),
        )
        assert all(270 < x < 1200 and 0 < y < bar for x, y in (first, last)), "the whole way is in sight"
        assert math.dist(first, last) > 300, "and fills the map"
        assert await page.value("document.querySelectorAll('.values figure').length") == 2, "speed and battery"
        await page.press("f")
        await page.value(f"delfim.fit({way[0][0] + 1.0}, {way[0][1]}, {way[0][0] + 1.001}, {way[0][1] + 0.001})")
        await page.until(f"(([x, y]) => x > 0 && x < 1200 && y > 0 && y < 760)(delfim.pixel({way[0][0]}, {way[0][1]}))")
        await page.press("f")
        for _ in range(5):
            await page.press("ArrowUp")
        await page.until("delfim.points(1) >= 40")
        assert await page.value("delfim.points(1)") <= 61, "a point for each second, though it plays a minute in one"
        await page.press(" ")
        await page.press("F1")
        text = await page.value("document.getElementById('card').innerText")
        assert "10 s on, 10 s back" in text
        assert "Play mission" not in text
        await page.value("document.querySelector('.marks i').click()")
        await page.until("/· (29|30|31) s of/.test(document.querySelector('#replay output').textContent)")


CORNER = """[...document.querySelectorAll('#map canvas')].some((each) => {
  const [width, height] = [each.width / 4, each.height / 4];
  return each.getContext('2d').getImageData(3 * width, 3 * height, width, height).data.some((part) => part);
})"""


@pytest.mark.parametrize("scale", [pytest.param(0.5, marks=pytest.mark.long), 0.75, pytest.param(2.0, marks=pytest.mark.long)])
async def test_the_map_fills_the_window_at_any_zoom_of_the_browser(it: Console, scale: float) -> None:
    page = it.page
    await page.open(it.url, width=1200, height=760, scale=scale)
    await page.until("delfim.online()")
    await page.value("delfim.fit(38.689, -9.217, 38.691, -9.213)")
    await page.until(CORNER)
    boxes = "[...document.querySelectorAll('#map canvas')].map((each) => each.getBoundingClientRect().toJSON())"
    assert {(each["width"], each["height"]) for each in await page.value(boxes)} == {(1200, 760)}
