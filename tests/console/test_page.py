"""The console's page in a real browser against a stand-in gateway: what an operator does, and what the gateway hears of it."""

import asyncio
import base64
import contextlib
import hashlib
import io
import json
import math
import shutil
import subprocess
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path

import pytest
from PIL import Image

from tests.console.scenes import SURVEY, at_work, caught_up, choose, fleet, hour, opened, pixel, show, survey, waypoints
from tests.console.standin import M_PER_DEG, Message, Standin, boat, place
from tests.services.browser import PROGRAM, Page, tab

ROOT = Path(__file__).parents[2]
WEB, BUILT = ROOT / "delfim/console/web", ROOT / "delfim/console/page"
SQUARE = [(-40.0, -60.0), (40.0, -60.0), (40.0, 60.0), (-40.0, 60.0)]

Sail = Callable[[Callable[[Page, Standin], Awaitable[None]]], None]


def two() -> list[Message]:
    return [boat(1, "Delfim", "#f4f6f7", north_m=-90, east_m=-60), boat(2, "DelfimX", "#f2c230", north_m=-90, east_m=60)]


@contextlib.asynccontextmanager
async def sailing(gateway: Standin) -> AsyncIterator[Page]:
    async with gateway.serving(), tab() as page:
        await page.call("Network.enable")
        await opened(page, gateway)
        await show(page, -120, -120, 120, 120)
        yield page
        assert foreign(page, gateway) == []


def foreign(page: Page, gateway: Standin) -> list[str]:
    """What the page asked others for."""
    own = "data:", gateway.address, gateway.address.replace("http", "ws")
    return [each for each in page.requests if not each.startswith(own)]


@pytest.fixture
def sail() -> Sail:
    """Runs a story with the page open on two idle boats."""
    assert PROGRAM, "Chromium is missing: make system"

    def run(story: Callable[[Page, Standin], Awaitable[None]]) -> None:
        async def told() -> None:
            gateway = Standin(two())
            async with sailing(gateway) as page:
                await story(page, gateway)

        asyncio.run(told())

    return run


async def shown(page: Page, gateway: Standin, expression: str) -> None:
    """Wait until an expression is true in the page, while the boats go on being told."""
    async with asyncio.timeout(200):
        while not await page.value(expression):
            await gateway.frame()
            await asyncio.sleep(0.02)


async def settled(page: Page, gateway: Standin) -> None:
    """Wait until the page has taken all that it was told: messages arrive in their order."""
    mark = gateway.boat(1)["battery_pct"] = 30 + (gateway.boat(1)["battery_pct"] - 29) % 60
    await shown(page, gateway, f"{text_of(1, '.battery')} === '{mark} %'")


def is_input(port: float, starboard: float, number: int = 1) -> Callable[[Message], bool]:
    wanted = {"t": "input", "boat": number, "port_pct": port, "starboard_pct": starboard}
    return lambda m: wanted.items() <= m.items()


def text_of(number: int, part: str) -> str:
    return f"document.querySelector('[data-boat=\"{number}\"] {part}').textContent"


def test_each_mode_key_asks_the_selected_boat_for_its_mode(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        for key, command in zip(
            "imhgpyxr", ("idle", "manual", "heading", "goto", "path", "play", "grex", "reset"), strict=True
        ):
            gateway.forget()
            await page.press(key)
            asked = await gateway.command(command)
            assert [m for m in gateway.said if m["t"] == "command"] == [asked]
            if command == "heading":
                assert asked["heading_deg"] == 40

    sail(story)


def test_tab_changes_the_boat_and_says_nothing(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        gateway.forget()
        await page.press("Tab")
        await shown(page, gateway, "document.querySelector('.selected b').textContent === 'DelfimX'")
        assert gateway.said == []
        await page.press("y")
        await gateway.command("play", 2)
        await page.press("Tab", ("Shift",))
        await page.press("g")
        await gateway.command("goto", 1)
        assert {m["command"] for m in gateway.said if m["boat"] == 2} == {"play"}

    sail(story)


def test_digits_set_the_speed_and_nine_does_nothing(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        await page.press("h")
        await gateway.command("heading")
        await gateway.frame()
        gateway.forget()
        for digit in "123456789":
            await page.press(digit)
        await page.press("0")
        await gateway.until(lambda m: m.get("speed_pct") == 0)
        assert [m["speed_pct"] for m in gateway.said] == [10, 20, 30, 40, 50, 60, 70, 80, 0]
        await page.press("ArrowUp")
        assert (await gateway.until(lambda m: m.get("speed_pct") == 1))["command"] == "speed"
        await page.press("ArrowRight")
        assert (await gateway.command("heading"))["heading_deg"] == 41

    sail(story)


def test_manual_keys_move_both_thrusters_or_one(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        await page.press("m")
        await gateway.until(is_input(0, 0))
        for key, modifiers, expected in (
            ("3", (), (30, 30)),
            ("ArrowUp", (), (31, 31)),
            ("ArrowDown", (), (30, 30)),
            ("ArrowRight", (), (31, 29)),
            ("ArrowLeft", (), (30, 30)),
            ("ArrowUp", ("Alt",), (30, 31)),
            ("ArrowUp", ("Control",), (31, 31)),
            ("ArrowRight", ("Alt",), (31, 30)),
            ("ArrowRight", ("Control",), (32, 30)),
            ("5", ("Alt",), (32, 50)),
            ("4", ("Control",), (40, 50)),
            ("9", (), (40, 50)),
            ("0", (), (0, 0)),
        ):
            gateway.forget()
            await page.press(key, modifiers)
            await gateway.until(is_input(*expected))
        gateway.forget()
        for expected in ((-1, -1), (-2, -2)):
            await page.press("ArrowDown")
            await gateway.until(is_input(*expected))
        numbers = [m["n"] for m in gateway.said if m["t"] == "input"]
        assert numbers == sorted(set(numbers))

    sail(story)


def test_thrust_is_set_from_the_menu_too(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        await page.press("m")
        await gateway.until(is_input(0, 0))
        await page.value("document.querySelector('.chip').click()")
        await choose(page, "Thrust…")
        for key in ("ArrowRight", "ArrowRight", "ArrowDown", "ArrowLeft", "Enter"):
            await page.press(key)
        await gateway.until(is_input(10, -5))

    sail(story)


def test_a_boat_left_in_manual_keeps_its_own_thrust(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        await page.press("m")
        await gateway.until(is_input(0, 0))
        await page.press("2")
        await gateway.until(is_input(20, 20))
        await page.press("Tab")
        await page.press("7")
        await gateway.until(lambda m: m.get("speed_pct") == 70 and m["boat"] == 2)
        gateway.forget()
        await gateway.until(is_input(20, 20))
        assert [m for m in gateway.said if m["boat"] == 2] == []

    sail(story)


@pytest.mark.parametrize("event", ["blur", "pagehide", "freeze"])
def test_a_page_that_is_left_releases_and_does_not_resume(sail: Sail, event: str) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        await page.press("m")
        await gateway.until(is_input(0, 0))
        await page.press("6")
        await gateway.until(is_input(60, 60))
        target = "document" if event == "freeze" else "window"
        await page.value(f"{target}.dispatchEvent(new Event('{event}'))")
        await gateway.until(lambda m: m["t"] == "release" and m["boat"] == 1)
        gateway.forget()
        await shown(page, gateway, f"{text_of(1, '.speed')} === 'thrust 0'")
        for _ in range(20):
            await gateway.frame()
            await asyncio.sleep(0.02)
        assert gateway.said == []
        await page.press("ArrowUp")
        await gateway.until(is_input(1, 1))

    sail(story)


def test_a_hidden_page_sends_no_thrust(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        await page.press("m")
        await page.press("4")
        await gateway.until(is_input(40, 40))
        await page.value(
            "Object.defineProperty(document, 'hidden', {value: true}), document.dispatchEvent(new Event('visibilitychange'))"
        )
        assert (await gateway.until(lambda m: m["t"] == "release"))["why"] == "the page is hidden"

    sail(story)


def test_a_page_that_slept_releases_and_waits_for_the_operator(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        await page.press("m")
        await page.press("4")
        await gateway.until(is_input(40, 40))
        await page.value("(() => { const end = Date.now() + 1500; while (Date.now() < end); })()")
        assert (await gateway.until(lambda m: m["t"] == "release"))["why"] == "the page slept"
        for _ in range(20):
            await gateway.frame()
            await asyncio.sleep(0.02)
        assert gateway.said[-1]["t"] == "release"
        await page.press("1")
        await gateway.until(is_input(10, 10))

    sail(story)


def test_thrust_that_the_gateway_let_go_waits_for_the_operator(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        await page.press("m")
        await page.press("4")
        await gateway.until(is_input(40, 40))
        gateway.boat(1)["released"] = True
        await shown(page, gateway, f"{text_of(1, '.speed')} === 'thrust 0'")
        await page.press("1")
        await gateway.until(is_input(10, 10))

    sail(story)


def test_after_a_lost_gateway_nothing_moves_by_itself(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        await page.press("m")
        await page.press("4")
        await gateway.until(is_input(40, 40))
        await gateway.hang_up()
        await page.until("!document.getElementById('offline').hidden")
        gateway.forget()
        await shown(page, gateway, "document.getElementById('offline').hidden")
        await shown(page, gateway, f"{text_of(1, '.speed')} === 'thrust 0'")
        assert [m for m in gateway.said if m["t"] == "input"] == []

    sail(story)


def test_no_line_is_drawn_where_a_boat_was_not_heard_or_cannot_have_been() -> None:
    async def told() -> None:
        gateway = Standin(two())
        at_s, points = gateway.at_s - 400, []
        for begun_s, north_m in ((0, 0), (160, 0), (220, 300)):  # a silence of a minute; 300 m away a second later
            points += [[at_s + begun_s + n, *place(north_m + n, 0)] for n in range(60)]
        gateway.history = {1: points}
        async with sailing(gateway) as page:
            assert await page.value("[delfim.pieces(1), delfim.pieces(2)]") == [4, 1], "the last one is where it is now"

    asyncio.run(told())


def test_the_track_is_whole_again_after_the_link_to_the_gateway_was_lost() -> None:
    async def told() -> None:
        gateway = Standin(two())
        gateway.history = {1: hour(gateway.boats[0])}
        async with sailing(gateway) as page:
            assert await page.value("delfim.points(1)") >= 3600
            *_, last = gateway.history[1]
            gateway.history[1] += [[last[0] + 1 + n, *last[1:]] for n in range(60)]
            gateway.at_s += 60.0
            await gateway.hang_up()
            while gateway.sockets:
                await asyncio.sleep(0.01)
            while not gateway.sockets:
                await asyncio.sleep(0.01)
            await gateway.frame()
            await caught_up(page, gateway)
            assert await page.value("delfim.points(1)") >= 3660

    asyncio.run(told())


def test_space_stops_one_boat_and_repeats_until_it_is_confirmed(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        gateway.refusals["stop"] = "lost on the way"
        await page.press(" ")
        await shown(page, gateway, "document.getElementById('stop').dataset.state === 'idle'")
        gateway.boat(1)["mode"] = "play"
        await gateway.frame()
        gateway.forget()
        await page.press(" ")
        for _ in range(3):
            gateway.forget()
            await gateway.command("stop")
        assert await page.value("document.getElementById('stop').dataset.state") == "stopping"
        gateway.refusals.clear()
        await shown(page, gateway, "document.getElementById('stop').dataset.state === 'idle'")
        assert {m["boat"] for m in gateway.said} == {1}

    sail(story)


def test_shift_space_and_the_corner_stop_all(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        await page.press(" ", ("Shift",))
        await gateway.command("stop", "all")
        for name, number in (("stop-all", "all"), ("stop", 1)):
            gateway.forget()
            box = f"document.getElementById('{name}').getBoundingClientRect()"
            x, y, width, height = await page.value(f"(r => [r.x + r.width / 2, r.y + r.height / 2, r.width, r.height])({box})")
            assert min(width, height) >= 64
            await page.mouse((x, y))
            await gateway.command("stop", number)

    sail(story)


def test_stop_works_in_front_of_an_open_menu(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        await page.press("Enter")
        await page.until("document.querySelector('.item') !== null")
        await page.press(" ")
        await gateway.command("stop")
        assert await page.value("document.querySelector('.popup').hidden")

    sail(story)


def test_a_menu_is_worked_by_keys_and_shows_the_keys(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        await page.press("Enter")
        assert await page.value("[...document.querySelectorAll('.popup kbd')].map(k => k.textContent)") == [
            *("Space", "B", "C", "L", "I", "M", "H", "G", "P", "Y", "X", "0 … 8")
        ]
        for _ in range(12):
            await page.press("ArrowDown")
        await page.press("Enter")
        await page.until("document.querySelector('.field') !== null")
        for _ in range(4):
            await page.press("ArrowRight")
        await page.press("Enter")
        assert (await gateway.command("heading"))["heading_deg"] == 60

    sail(story)


def test_a_mode_that_is_asked_for_is_shown_as_asked_until_the_boat_says_it(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        gateway.obedient = False
        await page.press("y")
        await gateway.command("play")
        state = "document.querySelector('[data-boat=\"1\"] .mode').dataset.state"
        await shown(page, gateway, f"{state} === 'asked'")
        await shown(page, gateway, f"{state} === 'late'")
        gateway.boat(1).update(mode="play", asked=None)
        await shown(page, gateway, f"{state} === 'on'")

    sail(story)


def test_a_number_that_is_used_twice_is_a_red_alarm_with_both_addresses(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        gateway.boat(1)["twins"] = ["10.0.0.3:14550", "10.0.0.4:14550"]
        await shown(
            page, gateway, f"{text_of(1, '.trouble.bad')} === 'number 1 is used twice: 10.0.0.3:14550 and 10.0.0.4:14550'"
        )

    sail(story)


@pytest.mark.parametrize(("commander", "words"), [(1, "the hand-set is in control"), (250, "console 250 is in control")])
def test_the_strip_says_who_else_commands(sail: Sail, commander: int, words: str) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        gateway.boat(1).update(owner=False, commander=commander)
        await shown(page, gateway, f"{text_of(1, '.trouble')} === '{words}'")

    sail(story)


def test_a_message_that_cannot_be_taken_costs_itself_alone(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        for text in ('{"t": "boats", "boats": [{"speed_mps": NaN}]}', "[", "null", "17", '{"t": "boats"}', '{"t": "what"}'):
            for socket in gateway.sockets:
                await socket.send_str(text)
        await settled(page, gateway)
        assert await page.value("delfim.online() && !document.getElementById('failed').hidden")
        page.complaints.clear()

    sail(story)


def test_the_graphs_of_port_and_starboard_have_one_zero_line(sail: Sail) -> None:
    zero = """[...document.querySelectorAll('[data-boat="1"] .graphs canvas')].map((each) => {
      const column = each.getContext('2d').getImageData(4, 0, 1, each.height).data; // older than what is drawn
      return [...Array(each.height).keys()].filter((y) => column[4 * y + 3] > 0);
    })"""

    async def story(page: Page, gateway: Standin) -> None:
        gateway.boat(1)["rpm"] = [900.0, -300.0]
        await settled(page, gateway)
        port, starboard = await page.value(zero)
        assert port
        assert port == starboard

    sail(story)


def test_a_mission_that_ends_where_it_begins_shows_both_ends(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        square = [dict(zip(("latitude_deg", "longitude_deg"), place(*at), strict=True)) for at in (*SQUARE, SQUARE[0])]
        gateway.stored["round"] = {"name": "round", "waypoints": square, "fence": [], "obstacles": [], "home": None}
        for socket in gateway.sockets:
            await gateway._mission(socket, {"boat": 1, "do": "load", "name": "round"})
        await page.until("delfim.drawn().plan === 5")
        await settled(page, gateway)
        x, y = await pixel(page, *SQUARE[0])
        taken = await page.call("Page.captureScreenshot", format="png")
        picture = Image.open(io.BytesIO(base64.b64decode(taken["data"]))).convert("RGB")
        first, last, sea = (picture.getpixel((round(x + aside), round(y + 7))) for aside in (0, 25, 60))
        assert first == last != sea

    sail(story)


def test_areas_that_the_page_does_not_edit_are_drawn(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        around = {"kind": "keep_in", "name": "", "polygon": [], "centre": [list(place(0, 0))], "radius_m": 150.0}
        corners = [list(place(*at)) for at in ((40, -100), (100, -100), (100, -40), (40, -40))]
        rock = {"kind": "keep_out", "name": "", "polygon": corners, "centre": [], "radius_m": 0.0}
        empty = {"fence": [], "obstacles": [], "home": None}
        gateway.stored["bay"] = {"name": "bay", "waypoints": waypoints([(0, 0), (0, 60)]), **empty, "zones": [around, rock]}
        for socket in gateway.sockets:
            await gateway._mission(socket, {"boat": 1, "do": "load", "name": "bay"})
        await page.until("delfim.drawn().plan === 2")
        await settled(page, gateway)
        taken = await page.call("Page.captureScreenshot", format="png")
        picture = Image.open(io.BytesIO(base64.b64decode(taken["data"]))).convert("RGB")

        async def seen(north_m: float, east_m: float) -> object:
            x, y = await pixel(page, north_m, east_m)
            return picture.getpixel((round(x), round(y)))

        sea = await seen(-60, -60)
        assert await seen(70, -70) != sea
        drawn = [[await seen(r * math.cos(i / 50), r * math.sin(i / 50)) != sea for i in range(314)] for r in (150.0, 140.0)]
        assert sum(drawn[0]) > 100 > sum(drawn[1]), "a dashed circle, and little beside it"

    sail(story)


def test_a_refusal_is_said_in_words(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        gateway.refusals["play"] = "no mission aboard"
        await page.press("y")
        await shown(
            page, gateway, "document.getElementById('messages').textContent.includes('play refused: no mission aboard')"
        )

    sail(story)


def test_a_mission_is_drawn_by_the_mouse_saved_loaded_and_sent(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        for corner in SQUARE:
            await page.mouse(await pixel(page, *corner))
            await choose(page, "Add waypoint")
        await planned(gateway, lambda w: len(w) == 4)
        near(gateway.plans[1], SQUARE)
        await page.mouse(await pixel(page, *SQUARE[1]), await pixel(page, 60, -30), await pixel(page, 70, -20))
        await planned(gateway, lambda w: len(w) == 4 and close(w[1], (70, -20)))
        await page.mouse(await pixel(page, 0, 60), await pixel(page, 10, 90), await pixel(page, 10, 100))  # the middle of a leg
        await planned(gateway, lambda w: len(w) == 5)
        near(gateway.plans[1], [SQUARE[0], (70, -20), SQUARE[2], (10, 100), SQUARE[3]])
        gateway.forget()
        await page.press("z", ("Control",))
        await planned(gateway, lambda w: len(w) == 4)
        await page.press("Enter")
        await choose(page, "Mission", "Save")
        await gateway.until(lambda m: m.get("do") == "list")
        await settled(page, gateway)
        await page.press("Enter")
        await choose(page, "Mission", "New mission")
        await planned(gateway, lambda w: not w)
        await page.press("Enter")
        await choose(page, "Mission", "Load", "Mission")
        await gateway.until(lambda m: m.get("do") == "load")
        await settled(page, gateway)
        await page.press("Enter")
        await choose(page, "Mission", "Send to the boat")
        await gateway.until(lambda m: m.get("do") == "upload")
        await shown(page, gateway, f"{text_of(1, '.badge')} === 'same'")
        near(gateway.plans[1], [SQUARE[0], (70, -20), *SQUARE[2:]])

    sail(story)


async def planned(gateway: Standin, wanted: Callable[[list[Message]], bool], number: int = 1) -> Message:
    """Wait until the gateway was handed a plan with such waypoints."""

    def is_it(message: Message) -> bool:
        return message.get("do") == "put" and message["boat"] == number and wanted(message["mission"]["waypoints"])

    return (await gateway.until(is_it))["mission"]


def near(mission: Message, corners: list[tuple[float, float]]) -> None:
    assert len(mission["waypoints"]) == len(corners)
    assert all(close(each, corner) for each, corner in zip(mission["waypoints"], corners, strict=True)), mission["waypoints"]


def close(each: Message, corner: tuple[float, float], within_m: float = 2.0) -> bool:
    """Within two metres: what a pixel is on this screen."""
    at = place(*corner)
    east = M_PER_DEG * math.cos(math.radians(at[0]))
    return math.hypot((each["latitude_deg"] - at[0]) * M_PER_DEG, (each["longitude_deg"] - at[1]) * east) < within_m


def test_a_mission_is_drawn_by_touch(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        await page.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)
        for corner in SQUARE[:2]:
            await page.touch("Start", await pixel(page, *corner))
            await page.until("!document.querySelector('.popup').hidden")
            await page.touch("End")
            await choose(page, "Add waypoint")
            await page.until("document.querySelector('.popup').hidden")
        await planned(gateway, lambda w: len(w) == 2)
        await page.touch("Start", await pixel(page, *SQUARE[1]))
        for step in range(1, 6):
            await page.touch("Move", await pixel(page, SQUARE[1][0], SQUARE[1][1] + 10 * step))
        await page.touch("End")
        await planned(gateway, lambda w: len(w) == 2 and close(w[1], (40, -10)))

    sail(story)


def test_the_finger_that_opened_a_menu_chooses_nothing_when_it_is_lifted(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        await page.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)
        corner = 1100.0, 700.0  # the menu has no room beside the finger
        await page.touch("Start", corner)
        await page.until("!document.querySelector('.popup').hidden")
        assert await page.value(f"document.elementFromPoint({corner[0]}, {corner[1]}).closest('.item') !== null")
        heading = await page.value("document.querySelector('.popup header').textContent")
        await page.touch("End")
        await settled(page, gateway)
        assert await page.value("document.querySelector('.popup header').textContent") == heading
        assert [m for m in gateway.said if m["t"] == "command"] == []

    sail(story)


def test_the_second_click_of_two_in_a_row_chooses_nothing(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        await page.value(
            "document.querySelector('.chip').click();"
            "const item = document.querySelectorAll('.item')[2];"
            "item.dispatchEvent(new PointerEvent('pointerdown', { bubbles: true }));"
            "item.dispatchEvent(new MouseEvent('click', { bubbles: true, detail: 2 }))"
        )
        await settled(page, gateway)
        assert await page.value("!document.querySelector('.popup').hidden")
        assert [m for m in gateway.said if m["t"] == "command"] == []

    sail(story)


def test_waypoints_are_ordered_deleted_and_given_speeds(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        mission = {**survey(), "name": "Square", "waypoints": waypoints(SQUARE), "fence": [], "obstacles": [], "home": None}
        await gateway.tell({"t": "mission", "boat": 1, "where": "here", "mission": mission})
        await settled(page, gateway)
        await page.mouse(await pixel(page, *SQUARE[0]))
        await choose(page, "Later in the order")
        await planned(gateway, lambda w: close(w[0], SQUARE[1]))
        await page.mouse(await pixel(page, *SQUARE[3]))
        await choose(page, "Delete")
        await planned(gateway, lambda w: len(w) == 3)
        await page.mouse(await pixel(page, *SQUARE[2]))
        await choose(page, "Speed, acceptance, stay…")
        for key in (*["ArrowRight"] * 12, "ArrowDown", *["ArrowRight"] * 4, "ArrowDown", *["ArrowRight"] * 2, "Enter"):
            await page.press(key)
        last = await planned(gateway, lambda w: w[-1]["speed_mps"] > 0)
        words = [round(last["waypoints"][2][key], 6) for key in ("speed_mps", "acceptance_m", "hold_s")]
        assert words == [1.2, 2, 20]
        await page.mouse(await pixel(page, *SQUARE[2]))
        await choose(page, "Leg to it", "Half circle to port")
        turned = await planned(gateway, lambda w: len(w) == 3 and w[2]["turn"] is not None)
        arc = turned["path"][2]
        assert (close(arc, (0, 0)), round(arc["turn_deg"]), round(arc["radius_m"])) == (True, -180, 72)
        assert not turned["waypoints"][2]["turn"]["clockwise"]

    sail(story)


def test_speeds_are_shown_and_taken_in_knots_where_the_operator_chose_them(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        gateway.boat(1).update(speed_mps=1.5)
        await shown(page, gateway, f"{text_of(1, '.speed')} === '1.5 m/s'")
        await page.press("w")
        await page.press("Enter")
        await choose(page, "Screen", "Knots")
        await shown(page, gateway, f"{text_of(1, '.speed')} === '2.9 kn'")
        mission = {**survey(), "name": "Square", "waypoints": waypoints(SQUARE), "fence": [], "obstacles": [], "home": None}
        await gateway.tell({"t": "mission", "boat": 1, "where": "here", "mission": mission})
        await settled(page, gateway)
        await page.mouse(await pixel(page, *SQUARE[2]))
        await choose(page, "Speed, acceptance, stay…")
        for key in (*["ArrowRight"] * 20, "Enter"):
            await page.press(key)
        last = await planned(gateway, lambda w: w[2]["speed_mps"] > 0)
        assert last["waypoints"][2]["speed_mps"] == 1.029, "2 knots"
        await page.reload()
        there = "document.querySelector('[data-boat=\"1\"]') !== null"
        await shown(page, gateway, f"{there} && {text_of(1, '.speed')} === '2.9 kn'")

    sail(story)


def test_values_of_sensors_stand_in_words_with_the_ages_of_old_ones(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        values = {"depth_m": (4.25, 0.2), "aws_mps": (5.1, 0.2), "awa_rad": (-0.7854, 0.2), "stw_mps": (1.0, 12.0)}
        values |= {"sigma_m": (0.014, 0.2), "corr_s": (2.0, 0.2)}
        told = {name: {"value": value, "age_s": age_s} for name, (value, age_s) in values.items()}
        gateway.boat(1).update(
            measured={**told, "turbidity": {"value": 3.14159, "age_s": 0.2}, "air_c": {"value": 1, "age_s": 99}}
        )
        words = (
            "depth 4.3 m · apparent wind 5.1 m/s · apparent wind from 315° · through water 1.0 m/s (12 s ago)"
            " · position ± 0.01 m · corrections since 2 s · turbidity 3.142"
        )
        await shown(page, gateway, f"{text_of(1, '.measured')}.replaceAll('\\u00a0', ' ') === '{words}'")
        gateway.boat(1).update(measured={})
        await shown(page, gateway, "document.querySelector('[data-boat=\"1\"] .measured').hidden")

    sail(story)


@pytest.mark.parametrize(("title", "least"), [("Lawn-mower…", 10), ("Circle…", 3), ("Spiral…", 60)])
def test_patterns_become_waypoints_around_the_point(sail: Sail, title: str, least: int) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        await page.mouse(await pixel(page, 20, 0))
        await choose(page, "Pattern", title)
        await page.until("document.querySelector('.field') !== null")
        await page.press("Enter")
        mission = await planned(gateway, lambda w: True)
        assert len(mission["waypoints"]) >= least
        assert all(close(each, (20, 0), within_m=75) for each in mission["waypoints"])

    sail(story)


def test_plans_do_not_leak_from_boat_to_boat(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        await page.mouse(await pixel(page, *SQUARE[0]))
        await choose(page, "Add waypoint")
        await planned(gateway, lambda w: True)
        await page.press("Tab")
        await page.mouse(await pixel(page, *SQUARE[2]))
        await choose(page, "Add waypoint")
        await planned(gateway, lambda w: True, 2)
        near(gateway.plans[1], [SQUARE[0]])
        near(gateway.plans[2], [SQUARE[2]])

    sail(story)


def test_what_differs_aboard_is_badged_and_can_be_taken(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        gateway.stored["aboard"] = {**survey(), "name": "Aboard"}
        gateway.boat(1)["mission"] = {"name": "Aboard", "count": 10, "current": None, "state": "differs", "digest": "2"}
        await shown(page, gateway, f"{text_of(1, '.badge')} === 'differs'")
        await page.press("Enter")
        await choose(page, "Mission", "Read from the boat")
        assert (await gateway.until(lambda m: m.get("do") == "put"))["mission"]["name"] == "Aboard"

    sail(story)


def test_a_dry_run_says_time_and_distance(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        await gateway.tell({"t": "mission", "boat": 1, "where": "here", "mission": survey()})
        await settled(page, gateway)
        gateway.plans[1] = survey()
        await page.press("Enter")
        await choose(page, "Mission", "Dry run")
        await shown(page, gateway, "document.getElementById('dryrun').textContent === 'dry run12 min 34 s1.11 km'")

    sail(story)


def test_a_silent_boat_stays_in_the_list_with_its_age(sail: Sail) -> None:
    async def story(page: Page, gateway: Standin) -> None:
        gateway.boat(1)["age_s"] = dict.fromkeys(gateway.boat(1)["age_s"], 42.0)
        await shown(page, gateway, "document.querySelector('[data-boat=\"1\"]').dataset.age === 'lost'")
        assert (await page.value(text_of(1, ".age"))).startswith("42")
        assert await page.value("document.querySelector('.selected').dataset.boat") == "1"
        del gateway.boats[0]
        await gateway.frame()
        assert await page.value("document.querySelectorAll('.chip').length") == 2

    sail(story)


def test_on_a_phone_every_boat_is_in_sight_and_nothing_is_cut_off() -> None:
    async def told() -> None:
        gateway = Standin(fleet(10))
        async with gateway.serving(), tab() as page:
            await opened(page, gateway, width=390, height=780)
            await page.press("Tab")
            await shown(page, gateway, f"{text_of(2, 'b')} === document.querySelector('.selected b').textContent")
            all_boxes = "[...document.querySelectorAll('.chip, .chip b')].map(each => each.getBoundingClientRect())"
            boxes = await page.value(f"{all_boxes}.map(({{ left, right, bottom }}) => [left, right, bottom])")
            assert len(boxes) == 20
            assert all(left >= 0 and right <= 390 and bottom <= 780 * 0.38 for left, right, bottom in boxes)

    asyncio.run(told())


def test_nothing_covers_the_stop_corner_even_on_a_phone() -> None:
    async def told() -> None:
        gateway = Standin(two())
        async with gateway.serving(), tab() as page:
            await opened(page, gateway, width=390, height=780)
            boxes = await page.value(
                "['stop', 'stop-all'].map(id => document.getElementById(id).getBoundingClientRect())"
                ".map(({ x, y, width, height }) => [x + width / 2, y + height / 2])"
            )
            for what in ("map", "boat", "card"):
                if what == "map":
                    await page.mouse((300.0, 640.0))
                else:
                    await page.press("F1" if what == "card" else "Enter")
                await page.until("document.querySelector('.popup:not([hidden]), .card:not([hidden])') !== null")
                for at in boxes:
                    assert await page.value(f"document.elementFromPoint(...{at}).closest('#corner') !== null"), what
                    assert await page.value(f"document.elementsFromPoint(...{at}).every(e => !e.closest('.popup, .card'))"), (
                        what
                    )
                await page.press("Escape")

    asyncio.run(told())


def test_in_a_replay_nothing_is_offered_that_cannot_be_done() -> None:
    async def told() -> None:
        gateway = at_work()
        gateway.hello["replay"] = {"from_s": gateway.at_s - 100, "to_s": gateway.at_s + 100}
        async with sailing(gateway) as page:
            assert await page.value("document.getElementById('stop').getClientRects().length") == 0
            assert await page.value("document.getElementById('replay').getClientRects().length") == 1
            for key in "imhgpyxr5":
                await page.press(key)
            await page.value("document.querySelector('.chip').click()")
            await page.until("document.querySelector('.item') !== null")
            titles = await page.value("[...document.querySelectorAll('.item .title')].map((each) => each.firstChild.data)")
            assert titles[:3] == ["Copy its mission…", "Copy its track as a mission…", "Ruler from here"]
            await page.press("Escape")
            await page.mouse(await pixel(page, *SURVEY[3]))
            await page.until("document.querySelector('.item') !== null")
            assert await page.value("document.querySelector('.item .title').textContent") == "Ruler from here"
            await page.press("Escape")
            await page.press(" ")
            await gateway.until(lambda m: m["t"] == "replay")
            assert {m.get("do", m["t"]) for m in gateway.said} == {"list", "replay"}

    asyncio.run(told())


def test_a_replay_is_moved_by_keys() -> None:
    async def told() -> None:
        gateway = at_work()
        gateway.hello["replay"] = {"from_s": gateway.at_s - 100, "to_s": gateway.at_s + 100}
        async with sailing(gateway) as page:
            for key, rate in ((" ", 0), (" ", 1), ("ArrowUp", 2)):
                await gateway.frame(0)
                await page.press(key)
                await gateway.until(lambda m, rate=rate: m["t"] == "replay" and m.get("rate") == rate)
                gateway.forget()
            before_s = gateway.at_s
            await page.press("ArrowRight")
            ahead = await gateway.until(lambda m: m["t"] == "replay" and "at_s" in m)
            assert 5.0 < ahead["at_s"] - before_s < 15.0, "ten seconds on from the frame that the page saw last"

    asyncio.run(told())


@pytest.mark.parametrize("how", ["dragged", "zoomed"])
def test_ten_boats_with_an_hour_of_track_each_are_drawn_thirty_times_a_second_while_it_moves(how: str) -> None:
    """Waits for a second with so many drawings: when it comes is the machine's other load, that it comes is the page's merit.
    At rest the map is drawn as often as boats are told, ten times a second; the operator's hand needs more."""

    async def told() -> None:
        boats = fleet(10)
        gateway = Standin(boats)
        gateway.history = {each["id"]: hour(each) for each in boats}
        async with sailing(gateway) as page:
            drawn = [await second_of_moving(page, gateway, how) for _ in range(2)]
            async with asyncio.timeout(200):
                while max(drawn) < 30:
                    drawn.append(await second_of_moving(page, gateway, how))
            print(f"{how}: {max(drawn)} drawings of the map in a second")

    asyncio.run(told())


def test_a_page_that_asked_elsewhere_or_missed_something_would_be_noticed() -> None:
    """What the other tests of the page look for at their ends does come."""

    async def told() -> None:
        async with Standin(two()).serving() as gateway, tab() as page:
            await page.call("Network.enable")
            await opened(page, gateway)
            assert (page.complaints, foreign(page, gateway)) == ([], [])
            for number, address in enumerate(("http://198.51.100.7/chart.png", "missing.png"), 1):
                await page.value(f"new Promise(done => Object.assign(new Image(), {{onerror: done, src: {address!r}}}))")
                async with asyncio.timeout(200):
                    while len(page.complaints) < number:
                        await page.value("document.title")
            assert foreign(page, gateway) == ["http://198.51.100.7/chart.png"]
            page.complaints.clear()

    asyncio.run(told())


def test_a_page_that_failed_says_so_until_it_is_loaded_again() -> None:
    """In a timer as the map's drawing, in a promise, and while it takes a message."""

    async def told() -> None:
        wrongs = "setTimeout(() => null.way)", "void Promise.reject(new TypeError('no way'))", ""
        async with Standin(two()).serving() as gateway, tab() as page:
            await opened(page, gateway)
            for wrong in wrongs:
                assert await page.value("document.getElementById('failed').hidden")
                await page.value(wrong)
                if not wrong:
                    await gateway.tell({"t": "boats", "at_s": gateway.at_s})
                await page.until("document.getElementById('failed').innerText.includes('TypeError')")
                assert all("TypeError" in each for each in page.complaints)
                page.complaints.clear()
                await page.reload()
                await page.until("window.delfim !== undefined")

    asyncio.run(told())


async def second_of_moving(page: Page, gateway: Standin, how: str) -> int:
    """How often the map was drawn while the pointer moved it for a second, with all boats under way and told ten times."""
    clock = asyncio.get_running_loop().time
    begun_s, told = clock(), 0
    if how == "dragged":
        await page.pointer("mousePressed", (700.0, 400.0), 1)
    while (since_s := clock() - begun_s) < 1.0:
        if told <= since_s * 10:
            told += 1
            for each in gateway.boats:
                each["latitude_deg"] += 1e-6
            await gateway.frame()
        x, y = 700 + 200 * math.sin(6 * since_s), 400 + 100 * math.sin(4 * since_s)
        if how == "dragged":
            await page.pointer("mouseMoved", (x, y), 1)
        else:
            turned = math.copysign(40, math.sin(6 * since_s))
            await page.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=turned)
    drawn: int = await page.value("delfim.frames()")
    if how == "dragged":
        await page.pointer("mouseReleased", (x, y), 0)
    return drawn


def test_the_page_in_the_wheel_is_that_of_the_sources(tmp_path: Path) -> None:
    """Rebuilt where Node and the packages are; everywhere, the sources are those that the bundle was made of."""
    stamped = json.loads((BUILT / "sources.json").read_text())
    assert stamped == stamp(), "the sources have changed: make page"
    if (WEB / "node_modules").is_dir() and (node := shutil.which("node")):
        subprocess.run([node, WEB / "build.mjs", tmp_path], check=True, capture_output=True, timeout=100)
        for built in BUILT.iterdir():
            assert (tmp_path / built.name).read_bytes() == built.read_bytes(), f"{built.name}: make page"


def stamp() -> dict[str, str]:
    names = ("package-lock.json", "build.mjs", "harbours.tsv", "land.mjs")
    files = [*(WEB / name for name in names), *sorted((WEB / "src").iterdir())]
    return {str(each.relative_to(WEB)): hashlib.sha256(each.read_bytes()).hexdigest() for each in files}
