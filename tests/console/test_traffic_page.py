"""Other vessels on the console's page, in a real browser: on the map, in the table, heard, and acknowledged."""

import asyncio

import pytest

from tests.console.scenes import choose, pixel
from tests.console.standin import Message, Standin, nearness, vessel
from tests.kit.page import second_of_moving, shown
from tests.services.browser import Page

LINE = "document.querySelector('#traffic .said').textContent"
ROWS = "[...document.querySelectorAll('#traffic tr[data-vessel]')].map(row => row.dataset.vessel).join()"
TONES = "window.tones"
FAKE_SOUND = """
window.tones = 0;
window.AudioContext = class {
  state = "running"; currentTime = 0; destination = null;
  resume() {}
  createOscillator() { return { frequency: {}, connect: (to) => to, start: () => window.tones++, stop() {} }; }
  createGain() {
    return { gain: { setValueAtTime() {}, linearRampToValueAtTime() {}, exponentialRampToValueAtTime() {} }, connect() {} };
  }
};
"""


async def tell(gateway: Standin, *vessels: Message, reported_s: float | None = 3.0) -> None:
    gateway.vessels, gateway.reported_s = list(vessels), reported_s
    await gateway.look()
    await gateway.frame()


def seen(state: str) -> str:
    return f"document.querySelector('#traffic').dataset.state === {state!r}"


def words(text: str) -> str:
    return f"document.querySelector('#traffic').textContent.includes({text!r})"


async def test_the_line_says_who_is_heard_and_that_silence_is_no_clear_water(page: Page, gateway: Standin) -> None:
    await tell(gateway, reported_s=None)
    await shown(page, gateway, f"{LINE} === 'AIS: nobody heard yet. Sees only who transmits.'")
    await tell(gateway, vessel("MARIA", north_m=60), vessel("TEJO", north_m=80))
    await shown(page, gateway, f"/^AIS: 2 targets, last report [0-9]+ s ago. Sees only who transmits.$/.test({LINE})")
    await tell(gateway, reported_s=400.0)
    await shown(page, gateway, f"{LINE} === 'AIS: 0 targets, last report 7 min ago. Sees only who transmits.'")
    for each in gateway.boats:
        each["link"]["profile"] = "lean"
    await tell(gateway, reported_s=None)
    await shown(page, gateway, f"{LINE} === 'AIS: not told on a lean link. Sees only who transmits.'")


async def test_the_table_is_in_the_order_of_the_gateway_and_a_row_tells_all(page: Page, gateway: Standin) -> None:
    calm, near = vessel("ZULU"), vessel("BRAVO", size_known=False, kind="B", boats=[nearness(2, 20.0, 130.0, "near")])
    await tell(gateway, near, calm)
    await shown(page, gateway, f"{seen('near')} && {ROWS} === 'BRAVO'")
    await page.value("document.querySelector('#traffic .said').click()")
    await shown(page, gateway, f"{ROWS} === 'BRAVO,ZULU' && {words('size unknown')} && {words('in 130 s')}")
    await asyncio.sleep(0.4)  # a menu that opened sooner is not meant
    row = "document.querySelector('#traffic tr[data-vessel]')"
    await page.value(f"{row}.dispatchEvent(new PointerEvent('pointerup', {{ bubbles: true, clientX: 500, clientY: 300 }}))")
    told = "document.querySelector('.popup').textContent"
    for each in (
        "BRAVO",
        "AIS class B",
        "size unknown, taken as 40 × 8 m",
        "DelfimX: CPA 20 m in 130 s",
        "last report 4 s ago",
    ):
        await shown(page, gateway, f"{told}.includes({each!r})")


async def test_a_click_on_a_vessel_tells_of_it(page: Page, gateway: Standin) -> None:
    await tell(gateway, vessel("MARIA", north_m=60, lost=True, age_s=90.0))
    await shown(page, gateway, "delfim.vessels().length === 1")
    await page.mouse(await pixel(page, 60, 0))
    await shown(page, gateway, "document.querySelector('.popup b').textContent === 'MARIA'")
    await shown(page, gateway, "document.querySelector('.popup').textContent.includes('LOST: last report 90 s ago')")


async def test_a_thing_that_stands_and_a_swimmer_say_who_saw_them(page: Page, gateway: Standin) -> None:
    rests = {"course_deg": None, "heading_deg": None, "speed_mps": 0.0, "margin_m": 2.0}
    buoy = vessel("lidar", north_m=60, **rests, kind="thing", length_m=2.0, beam_m=2.0) | {"key": "thing 12"}
    swimmer = vessel("camera", north_m=30, east_m=60, **rests, kind="person", length_m=1.0, beam_m=1.0) | {"key": "person 3"}
    kayak = vessel("KAYAK", north_m=-60, kind="payload") | {"key": "payload KAYAK"}  # without a transponder, seen by a lidar
    await tell(gateway, buoy, swimmer, kayak)
    await shown(page, gateway, "delfim.vessels().length === 3")
    line = "AIS: 0 targets, last report 3 s ago. Sees only who transmits. Seen by programs: 3."
    await shown(page, gateway, f"{LINE} === {line!r}")
    await page.mouse(await pixel(page, 60, 0))
    told = "document.querySelector('.popup').textContent"
    for words_ in ("stands, seen by lidar", "radius 1 m, ± 2 m", "last seen 4 s ago"):
        await shown(page, gateway, f"{told}.includes({words_!r})")
    await page.press("Escape")
    await page.mouse(await pixel(page, 30, 60))
    await shown(page, gateway, f"{told}.includes('a swimmer, seen by camera')")


@pytest.mark.parametrize("by_key", [True, pytest.param(False, marks=pytest.mark.long)])
async def test_a_danger_sounds_until_somebody_takes_note_and_stays_red(page: Page, gateway: Standin, by_key: bool) -> None:
    await page.value(FAKE_SOUND)
    await page.press("w")  # sounds are allowed once the page was touched
    await page.press("Escape")
    await tell(gateway, vessel("MARIA", boats=[nearness(1, 20.0, 300.0, "near")]))
    await shown(page, gateway, f"{seen('near')} && {TONES} === 1")
    await tell(gateway, vessel("MARIA", boats=[nearness(1, 20.0, 60.0, "danger")]))
    await shown(page, gateway, f"{seen('alarm')} && {TONES} >= 5")
    await shown(page, gateway, f"{TONES} >= 9")  # again
    if by_key:
        await page.press("k")
    else:
        await page.value("document.querySelector('#traffic .main').click()")
    await shown(page, gateway, f"{seen('danger')} && document.querySelector('#traffic .main').hidden")
    told = await page.value(TONES)
    await tell(gateway, vessel("MARIA", boats=[nearness(1, 20.0, 50.0, "danger")]))
    await shown(page, gateway, "delfim.vessels().join() === 'MARIA,danger'")
    assert await page.value(TONES) == told
    await tell(gateway, vessel("MARIA"))
    await shown(page, gateway, seen("calm"))
    await tell(gateway, vessel("MARIA", boats=[nearness(1, 20.0, 50.0, "danger")]))
    await shown(page, gateway, f"{seen('alarm')} && {TONES} > {told}")  # it is another danger


async def test_a_guard_zone_of_the_page_marks_whom_nobody_else_finds_near(page: Page, gateway: Standin) -> None:
    await tell(gateway, vessel("MARIA", north_m=-60, east_m=-60))  # 30 m from Delfim
    await shown(page, gateway, seen("calm"))
    await page.mouse(await pixel(page, 80, 80))
    await choose(page, "Screen", "Guard zone", "50 m")
    await shown(page, gateway, f"{seen('near')} && delfim.vessels().join() === 'MARIA,near'")
    await tell(gateway, vessel("MARIA", north_m=-37, east_m=-60))  # 53 m: at its edge nothing flickers
    await shown(page, gateway, seen("near"))
    await tell(gateway, vessel("MARIA", north_m=0, east_m=-60))
    await shown(page, gateway, seen("calm"))


async def test_the_order_of_a_boat_and_a_guard_that_is_off_are_said(page: Page, gateway: Standin) -> None:
    order = "giving way to MARIA, head-on, port to port, CPA 62 m"
    gateway.boat(1).update(order={"course_deg": 30.0, "words": order}, guard="on")
    gateway.boat(2).update(order=None, guard="off", mode="manual")
    await tell(gateway, vessel("MARIA", north_m=60))
    await shown(page, gateway, words(f"Delfim: {order}"))
    await shown(page, gateway, words("DelfimX: does not keep clear of others in manual"))
    gateway.boat(1).update(order=None)
    gateway.boat(2).update(guard="cannot avoid")
    await shown(page, gateway, f"!{words(order)} && {words('DelfimX: cannot keep clear of others')}")


@pytest.mark.long
@pytest.mark.parametrize(("how", "wanted"), [("dragged", 30), ("zoomed", 15)])
async def test_the_map_with_two_hundred_vessels_follows_the_hand(page: Page, gateway: Standin, how: str, wanted: int) -> None:
    """Each second they come anew. It waits for a second with so many drawings, as the test of ten boats does."""
    near = [nearness(1, 20.0, 60.0, "near")]
    crowd = [vessel(f"V{i}", north_m=60 * (i // 20) - 300, east_m=60 * (i % 20) - 600, course_deg=float(i)) for i in range(200)]
    await tell(gateway, *(each | ({"boats": near} if i % 4 == 0 else {}) for i, each in enumerate(crowd)))
    await shown(page, gateway, "delfim.vessels().length === 200")
    drawn = [0]
    async with asyncio.timeout(200):
        while max(drawn) < wanted:
            await gateway.look()
            drawn.append(await second_of_moving(page, gateway, how))
    print(f"{how}: {max(drawn)} drawings of the map in a second")
