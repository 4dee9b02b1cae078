"""An operator at the page, seen at the vehicle: keys, missions by mouse and by touch, and whatever ends thrust by hand.

Boats, gateway and browser are started once; each story begins with idle boats.
"""

import asyncio
import contextlib
import math
import signal
import statistics
import time
from collections.abc import Awaitable, Callable, Iterator
from typing import Any

import pytest

from delfim.canproxy.dsor import messages
from tests.console.chain import PATIENCE_S, Boat, Sea, afternoon, select, shown_mode, turning, watched
from tests.console.scenes import choose
from tests.services.browser import Page, tab

NORTH_M = 1 / 111_111
THRUST: tuple[tuple[str, tuple[str, ...], int, int], ...] = (  # thesis 4.3: key, held with it, port, starboard, percent
    ("3", (), 30, 30),
    ("ArrowUp", (), 31, 31),
    ("9", (), 31, 31),  # nothing, which the next one shows
    ("ArrowDown", (), 30, 30),
    ("ArrowRight", (), 31, 29),
    ("ArrowLeft", (), 30, 30),
    ("ArrowUp", ("Alt",), 30, 31),
    ("ArrowUp", ("Control",), 31, 31),
    ("5", ("Alt",), 31, 50),
    ("4", ("Control",), 40, 50),
    ("0", (), 0, 0),
    ("ArrowDown", (), -1, -1),
    ("2", ("Control",), 20, -1),
)
WATCHED = 8  # cycles: longer than the page, the gateway and the boat need to do something that they should not
PRESSES = 50
ACK_S = 1.0  # key to acknowledge; the contract says 50 ms, of a machine that has nothing else to do
READ_MS = 350  # a menu takes no tap before
ITEM = "[...document.querySelectorAll('.item')].find(i => i.querySelector('.title').firstChild.data === '{}')"
WITHIN_M = 12.0  # of the last waypoint: its acceptance radius, and that of holding, and the way to stop


@pytest.fixture(scope="module")
def afloat(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[asyncio.Runner, Sea]]:
    with afternoon(tmp_path_factory.mktemp("operating")) as both:
        yield both


@pytest.fixture
def sea(runner: asyncio.Runner, afloat: tuple[asyncio.Runner, Sea]) -> contextlib.AbstractAsyncContextManager[Sea]:
    return watched(afloat[1])


def menu_titles() -> str:
    return "[...document.querySelectorAll('.popup .item .title')].map((each) => each.firstChild.data)"


async def pressed(page: Page, boat: Boat, key: str, mode: str) -> None:
    await page.press(key)
    await boat.until(lambda state: state["mode"] == mode)


# Missions, of boats that have none yet.


@pytest.mark.long
async def test_missions_by_touch_and_by_mouse_are_kept_sent_and_sailed_to_their_ends(sea: Sea) -> None:
    page, one = await sea.at_rest(1)
    ends = [await by_touch(page, one)]
    await sea.load()
    page, two = await sea.at_rest(2)
    await loaded(page, "Mission-2")  # what was drawn for the other boat, and before the page was opened anew
    await sent(page)
    await page.until("document.querySelector('.selected .mission').textContent === 'Mission-2: 2 waypoints'")
    await mission(page, "New mission")
    ends.append(await drawn(page, two, ahead(two, [(12, 0), (24, 8), (34, -2)])))
    await mission(page, "Save")
    await page.until("document.getElementById('messages').textContent.includes('saved: Mission 2')")
    await sent(page)
    await pressed(page, two, "p", "path")
    await select(page, 1)
    await loaded(page, "Mission-2")
    await sent(page)
    await pressed(page, one, "y", "play")
    for leg in (1, 2):
        await page.until(f"document.querySelector('.selected .mission').textContent === 'Mission-2: waypoint {leg} of 2'", 60)
    await page.until("document.getElementById('messages').textContent.includes('hold: play done')", 60)
    for boat, end, done in zip((one, two), ends, ("play done", "path done"), strict=True):
        await boat.until(lambda state: state["mode"] == "hold")
        await shown_mode(page, boat.number, "hold")
        state = await boat.sails_on(WATCHED)
        assert (state["mode"], state["reason"]) == ("hold", done)
        assert distance_m(state, end) < WITHIN_M


def ahead(boat: Boat, places: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Metres north and east of the boat, for metres ahead and to starboard of it."""
    heading = math.radians(boat.state()["heading_deg"])
    c, s = math.cos(heading), math.sin(heading)
    return [(a * c - b * s, a * s + b * c) for a, b in places]


def distance_m(state: dict[str, Any], end: tuple[float, float]) -> float:
    east = math.cos(math.radians(end[0]))
    return math.hypot(state["latitude_deg"] - end[0], (state["longitude_deg"] - end[1]) * east) / NORTH_M


async def shown(page: Page, boat: Boat, places: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Bring these places, metres north and east of the boat, onto the screen: latitude and longitude, degrees."""
    state = boat.state()
    here = state["latitude_deg"], state["longitude_deg"]
    east = NORTH_M / math.cos(math.radians(here[0]))
    found = [(here[0] + north_m * NORTH_M, here[1] + east_m * east) for north_m, east_m in places]
    lats, lons = zip(here, *found, strict=True)
    await page.value(f"delfim.fit({min(lats)}, {min(lons)}, {max(lats)}, {max(lons)})")
    return found


async def drawn(page: Page, boat: Boat, places: list[tuple[float, float]]) -> tuple[float, float]:
    """Waypoints by mouse, metres north and east of the selected boat; where the last one is."""
    found = await shown(page, boat, places)
    for place in found:
        x, y = await page.value(f"delfim.pixel({place[0]}, {place[1]})")
        await page.until(f"document.elementFromPoint({x}, {y}).tagName === 'CANVAS'")  # no message covers it any more
        await page.mouse((x, y))
        await choose(page, "Add waypoint")
    return found[-1]


async def by_touch(page: Page, boat: Boat) -> tuple[float, float]:
    """The same by a finger: long presses, taps, and the name under which it is saved."""
    found = await shown(page, boat, ahead(boat, [(12, 0), (24, 6)]))
    await page.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=1)
    for place in found:
        await page.touch("Start", await page.value(f"delfim.pixel({place[0]}, {place[1]})"))
        await page.until("!document.querySelector('.popup').hidden")
        await page.touch("End")
        await tapped(page, "Add waypoint")
    await tap(page, "document.querySelector('.selected .head')")
    await tapped(page, "Mission")
    await tapped(page, "Save under a new name…")
    await page.value(f"new Promise(done => setTimeout(done, {READ_MS}))")
    await tap(page, "document.querySelector('.choice .main')")
    await page.until("document.getElementById('messages').textContent.includes('saved: Mission-2')")
    await page.call("Emulation.setTouchEmulationEnabled", enabled=False)
    return found[-1]


async def tapped(page: Page, title: str) -> None:
    """Tap on an item of the open menu, once it was there long enough to be read."""
    await page.until(f"Boolean({ITEM.format(title)})")
    await page.value(f"new Promise(done => setTimeout(done, {READ_MS}))")
    await tap(page, ITEM.format(title))


async def tap(page: Page, element: str) -> None:
    await page.until(f"Boolean({element})")
    x, y = await page.value(f"(r => [r.x + r.width / 2, r.y + r.height / 2])({element}.getBoundingClientRect())")
    await page.touch("Start", (x, y))
    await page.touch("End")


async def mission(page: Page, *titles: str) -> None:
    """From the menu of the selected boat."""
    await page.press("Escape")
    await page.press("Enter")
    await choose(page, "Mission", *titles)


async def loaded(page: Page, name: str) -> None:
    """Another mission than the one aboard."""
    await mission(page, "Load", name)
    await page.until("['differs', 'unread', 'not sent'].includes(document.querySelector('.selected .badge').textContent)")


async def sent(page: Page) -> None:
    """To the selected boat, which has another one or none, and read back."""
    await page.until("document.querySelector('.selected .badge').textContent !== 'same'")
    await mission(page, "Send to the boat")
    await page.until("document.querySelector('.selected .badge').textContent === 'same'", 60)


# Keys.


@pytest.mark.long
async def test_each_key_of_the_thesis_is_seen_at_the_vehicle(sea: Sea) -> None:
    page, boat = await sea.at_rest(2)
    await drawn(page, boat, [(60, -69), (60, 69), (-60, 69)])
    await sent(page)
    for key, mode in (("h", "heading"), ("g", "goto"), ("p", "path"), ("y", "play"), ("i", "idle")):
        await pressed(page, boat, key, mode)
    await boat.until(lambda state: all(abs(each["rpm"] or 0.0) < 50.0 for each in state["thrusters"].values()))  # they coast
    await page.press("r")
    await page.press("x")
    await page.until("document.getElementById('messages').textContent.includes('grex refused: ')")
    assert "reset refused" not in await page.value("document.getElementById('messages').textContent")
    await pressed(page, boat, "m", "manual")
    for key, modifiers, port, starboard in THRUST:
        await page.press(key, modifiers)
        await boat.until(turning(port, starboard))
    await page.press(" ")
    await boat.until(lambda state: state["mode"] == "idle" and turning(0, 0)(state))
    await shown_mode(page, 2, "idle")


@pytest.mark.long
async def test_a_boat_that_falls_silent_under_way_leaves_the_map_to_all(sea: Sea) -> None:
    page, boat = await sea.at_rest(1)
    await drawn(page, boat, [(60, -69), (60, 69), (-60, 69)])
    await sent(page)
    await pressed(page, boat, "y", "play")
    await page.until("document.querySelector('.selected .left').textContent.endsWith('to go')")
    sea.radios[0].cut()
    try:
        await page.until("document.querySelector('[data-boat=\"1\"]').dataset.age === 'lost'")
        await page.value("new Promise(done => setTimeout(done, 1100))")
        assert await page.value("delfim.frames()") > 0, "of the last second"
        assert await page.value("document.getElementById('failed').hidden")
    finally:
        sea.radios[0].mend()
    await page.until("document.querySelector('[data-boat=\"1\"]').dataset.age === 'fresh'")


@pytest.mark.long
async def test_a_boat_goes_home_along_its_track_though_no_home_is_planned(sea: Sea) -> None:
    page, boat = await sea.at_rest(1)
    await pressed(page, boat, "h", "heading")
    await page.press("5")
    await boat.until(lambda state: state["speed_mps"] > 0.5)
    await boat.sails_on(20)
    await pressed(page, boat, "l", "home")
    await pressed(page, boat, "i", "idle")
    await page.press("Enter")
    assert (await page.value(menu_titles()))[:4] == ["Stop", "Pause: hold here", "Continue", "Go home"]
    await page.until("delfim.wayHome(1).startsWith('home: ')", PATIENCE_S)  # drawn before it is ordered
    await page.press("Escape")
    await page.until("!delfim.wayHome(1)", PATIENCE_S)
    await page.press("Enter")
    await choose(page, "Go home")
    await boat.until(lambda state: state["mode"] == "home")
    await page.until("delfim.wayHome(1).startsWith('home: ')", PATIENCE_S)  # and while it is sailed
    await pressed(page, boat, "i", "idle")
    await page.until("!delfim.wayHome(1)")


async def test_nobody_but_the_selected_boat_is_told_anything(sea: Sea) -> None:
    for number in (1, 2):
        page, boat = await sea.at_rest(number)
        before = [len(radio.said) for radio in sea.radios]
        await pressed(page, boat, "m", "manual")
        await page.press("2")
        await boat.until(turning(20, 20))
        await page.press("0")
        await boat.until(turning(0, 0))
        await pressed(page, boat, "h", "heading")
        await page.press("1")
        await boat.until(lambda state: state["reference"]["speed_override_mps"])
        await pressed(page, boat, "i", "idle")
        heard = [radio.spoken(since) for radio, since in zip(sea.radios, before, strict=True)]
        spoken = [{message.get_type() for message in its if not is_note(message)} for its in heard]
        assert spoken[number - 1] >= {"MANUAL_CONTROL", "COMMAND_LONG", "V2_EXTENSION"}
        assert spoken[2 - number] <= {"HEARTBEAT", "TIMESYNC"}
    for number, radio in enumerate(sea.radios, 1):
        named = [(m.get_type(), addressee(m)) for m in radio.spoken(0)]
        assert {whom for kind, whom in named if kind not in ("HEARTBEAT", "TIMESYNC")} == {number}


async def test_a_refusal_of_the_boat_stands_once_and_in_its_own_words(sea: Sea) -> None:
    page, boat = await sea.at_rest(1)
    await page.press("x")
    lines = "[...document.querySelectorAll('.message span')].map(line => line.textContent)"
    told = f"{lines}.filter(line => line.includes('grex'))"
    await page.until(f"{told}.length")
    once = ["grex refused: no set point from the guest computer"]
    assert await page.value(told) == once
    await pressed(page, boat, "h", "heading")  # and so whatever else is said of it has come, too
    assert await page.value(told) in (once, []), "a line goes after a while"
    await pressed(page, boat, "i", "idle")


def is_note(message: Any) -> bool:
    """Whether it is a line for the boat's log: that an alert was acknowledged, whichever boat is selected."""
    return message.get_type() == "V2_EXTENSION" and b'"note"' in bytes(message.payload)


def addressee(message: Any) -> int | None:
    """The system that a message is for."""
    found: int | None = getattr(message, "target_system", getattr(message, "target", None))
    return found


@pytest.mark.long
async def test_from_the_key_to_the_vehicles_acknowledge(sea: Sea) -> None:
    """As the page has it: from the event of the key to the answer, which the gateway passes on when the vehicle has said it."""
    page, _ = await sea.at_rest(1)
    script = await page.call("Page.addScriptToEvaluateOnNewDocument", source=STOPWATCH)
    await sea.load()
    await page.call("Page.removeScriptToEvaluateOnNewDocument", **script)
    await sea.at_rest(1)
    for n in range(1, PRESSES + 1):
        await page.press("i")
        await page.until(f"took_ms.length === {n}")
    took_ms = sorted(await page.value("took_ms"))
    middle, late = statistics.median(took_ms), took_ms[math.ceil(0.95 * PRESSES) - 1]
    print(f"\nkey to acknowledge, {PRESSES} presses: median {middle:.1f} ms, 95 % {late:.1f} ms, worst {took_ms[-1]:.1f} ms")
    assert middle < ACK_S * 1e3


STOPWATCH = """
const took_ms = [], asked = new Map();
let pressed;
addEventListener("keydown", (event) => (pressed = event.timeStamp), true);
window.WebSocket = class extends WebSocket {
  constructor(...words) {
    super(...words);
    this.addEventListener("message", ({ data }) => {
      const heard = JSON.parse(data);
      if (heard.t === "answer" && asked.has(heard.seq)) took_ms.push(performance.now() - asked.get(heard.seq));
    });
  }
  send(data) {
    const said = JSON.parse(data);
    if (said.mode === "idle") asked.set(said.seq, pressed);
    super.send(data);
  }
};
"""


@pytest.mark.long
async def test_two_pages_of_one_console_see_who_drives(sea: Sea) -> None:
    """At two windows that both have the focus, as on two computers."""
    line = "document.querySelector('[data-boat=\"2\"] .trouble:not(.weak)')"
    speed = "document.querySelector('[data-boat=\"2\"] .speed').textContent"
    page, boat = await sea.at_rest(2)
    await page.call("Emulation.setFocusEmulationEnabled", enabled=True)
    async with tab() as other:
        await other.call("Emulation.setFocusEmulationEnabled", enabled=True)
        await other.open(sea.url, width=1280, height=800, scale=1.0)
        await other.until("document.querySelectorAll('.chip').length === 2")
        await select(other, 2)
        await pressed(page, boat, "m", "manual")
        await page.press("3")
        await boat.until(turning(30, 30))
        await other.until(f"!{line}.hidden && {line}.textContent.includes('driven from another page')")
        await other.until(f"{speed} === 'P 30 · S 30 %'")
        await other.press("6")
        await other.until("document.getElementById('messages').textContent.includes('press M here to take over')")
        await boat.sails_on(WATCHED)
        assert turning(30, 30)(boat.state())
        await other.press("m")
        await boat.until(turning(0, 0))
        await other.press("6")
        await boat.until(turning(60, 60))
        await other.until(f"{speed} === 'P 60 · S 60 %' && {line}.hidden")
        await page.until(f"{speed} === 'P 60 · S 60 %' && !{line}.hidden")
    await boat.until(turning(0, 0))
    await page.call("Emulation.setFocusEmulationEnabled", enabled=False)
    await page.call("Page.bringToFront")


# The dead-man.


async def by_hand(page: Page, boat: Boat) -> None:
    await pressed(page, boat, "m", "manual")
    await page.press("4")
    await boat.until(turning(40, 40))


async def cut(sea: Sea, how: str, away: Callable[[], Awaitable[object]], back: Callable[[], Awaitable[object]]) -> None:
    """Drive by hand, cut the chain somewhere, mend it: thrust ends in time, and does not come back until somebody acts."""
    page, boat = await sea.at_rest(2)
    await by_hand(page, boat)
    began_ns = time.time_ns()
    await away()
    await boat.until(turning(0, 0))
    await boat.sails_on(WATCHED)
    await back()
    await boat.sails_on(WATCHED)
    ended_ns = time.time_ns()
    await select(sea.page, 2)
    await by_hand(sea.page, boat)
    await sea.at_rest(2)
    all_ = await boat.turnings(ended_ns)
    stops = [
        next(each.t_ns for each in all_ if each.t_ns > began_ns and each.arb == arb and not each.rpm)
        for arb in (messages.PROPELLER_PORT, messages.PROPELLER_STARBOARD)
    ]
    pushed_ns = max(t_ns for t_ns, thrust in boat.pushes() if thrust and t_ns < min(stops))
    print(f"\n{how}: no thrust {(max(stops) - pushed_ns) / 1e9:.2f} s after the last manual command")
    assert [each for each in all_ if max(stops) < each.t_ns < ended_ns and each.rpm] == []


@pytest.mark.long
async def test_a_hidden_tab_ends_thrust(sea: Sea) -> None:
    await cut(sea, "tab hidden", sea.page.hide, sea.page.show)


@pytest.mark.long
async def test_a_laptop_asleep_ends_thrust(sea: Sea) -> None:
    async def away() -> None:
        sea.page.sleep()

    async def back() -> None:
        sea.page.wake()
        await sea.page.value("document.title")

    try:
        await cut(sea, "laptop asleep", away, back)
    finally:
        sea.page.wake()


async def test_a_radio_that_is_cut_ends_thrust(sea: Sea) -> None:
    """When it is back, what was said meanwhile arrives, and what is said now."""
    radio = sea.radios[1]

    async def away() -> None:
        radio.cut()

    async def back() -> None:
        radio.mend()
        await sea.page.until("document.querySelector('[data-boat=\"2\"]').dataset.age === 'fresh'")

    await cut(sea, "radio cut", away, back)


@pytest.mark.long
async def test_a_gateway_that_is_killed_ends_thrust(sea: Sea) -> None:
    async def away() -> None:
        await asyncio.to_thread(sea.gateway.end, signal.SIGKILL)

    async def back() -> None:
        await asyncio.to_thread(sea.gateway.start)
        await sea.page.until("document.getElementById('offline').hidden", 60)
        await sea.found()

    await cut(sea, "gateway killed", away, back)
    sea.page.calls_in_vain = True


@pytest.mark.long
async def test_a_browser_that_is_killed_ends_thrust(sea: Sea) -> None:
    async def away() -> None:
        sea.page.kill()

    await cut(sea, "browser killed", away, sea.browse)
