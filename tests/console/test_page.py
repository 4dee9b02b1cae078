"""The console's page in a real browser against a stand-in gateway: what an operator does, and what the gateway hears of it."""

import asyncio
import base64
import hashlib
import io
import json
import math
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image

from tests.console.scenes import SURVEY, at_work, caught_up, choose, fleet, hour, opened, pixel, survey, waypoints
from tests.console.standin import Message, Standin, place
from tests.kit.page import (
    SQUARE,
    close,
    foreign,
    near,
    planned,
    sailing,
    second_of_moving,
    settled,
    shown,
    text_of,
    two,
)
from tests.services.browser import Page, tab

ROOT = Path(__file__).parents[2]
PAGE_BYTES = 600_000
WEB, BUILT = ROOT / "delfim/console/web", ROOT / "delfim/console/page"


def is_input(port: float, starboard: float, number: int = 1) -> Callable[[Message], bool]:
    wanted = {"t": "input", "boat": number, "port_pct": port, "starboard_pct": starboard}
    return lambda m: wanted.items() <= m.items()


async def test_each_mode_key_asks_the_selected_boat_for_its_mode(page: Page, gateway: Standin) -> None:
    for key, command in zip("imhgpyxr", ("idle", "manual", "heading", "goto", "path", "play", "grex", "reset"), strict=True):
        gateway.forget()
        await page.press(key)
        asked = await gateway.command(command)
        assert [m for m in gateway.said if m["t"] == "command"] == [asked]
        if command == "heading":
            assert asked["heading_deg"] == 40


async def test_tab_changes_the_boat_and_says_nothing(page: Page, gateway: Standin) -> None:
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


async def test_digits_set_the_speed_and_nine_does_nothing(page: Page, gateway: Standin) -> None:
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


async def test_manual_keys_move_both_thrusters_or_one(page: Page, gateway: Standin) -> None:
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


async def test_thrust_is_set_from_the_menu_too(page: Page, gateway: Standin) -> None:
    await page.press("m")
    await gateway.until(is_input(0, 0))
    await page.value("document.querySelector('.chip').click()")
    await choose(page, "Thrust…")
    for key in ("ArrowRight", "ArrowRight", "ArrowDown", "ArrowLeft", "Enter"):
        await page.press(key)
    await gateway.until(is_input(10, -5))


async def test_a_boat_left_in_manual_keeps_its_own_thrust(page: Page, gateway: Standin) -> None:
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


@pytest.mark.parametrize("event", ["blur", "pagehide", "freeze"])
async def test_a_page_that_is_left_releases_and_does_not_resume(page: Page, gateway: Standin, event: str) -> None:
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


async def test_a_hidden_page_sends_no_thrust(page: Page, gateway: Standin) -> None:
    await page.press("m")
    await page.press("4")
    await gateway.until(is_input(40, 40))
    await page.value(
        "Object.defineProperty(document, 'hidden', {value: true}), document.dispatchEvent(new Event('visibilitychange'))"
    )
    assert (await gateway.until(lambda m: m["t"] == "release"))["why"] == "the page is hidden"


async def test_a_page_that_slept_releases_and_waits_for_the_operator(page: Page, gateway: Standin) -> None:
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


async def test_thrust_that_the_gateway_let_go_waits_for_the_operator(page: Page, gateway: Standin) -> None:
    await page.press("m")
    await page.press("4")
    await gateway.until(is_input(40, 40))
    gateway.boat(1)["released"] = True
    await shown(page, gateway, f"{text_of(1, '.speed')} === 'thrust 0'")
    await page.press("1")
    await gateway.until(is_input(10, 10))


async def test_after_a_lost_gateway_nothing_moves_by_itself(page: Page, gateway: Standin) -> None:
    await page.press("m")
    await page.press("4")
    await gateway.until(is_input(40, 40))
    await gateway.hang_up()
    await page.until("!document.getElementById('offline').hidden")
    gateway.forget()
    await shown(page, gateway, "document.getElementById('offline').hidden")
    await shown(page, gateway, f"{text_of(1, '.speed')} === 'thrust 0'")
    assert [m for m in gateway.said if m["t"] == "input"] == []


async def test_no_line_is_drawn_where_a_boat_was_not_heard_or_cannot_have_been() -> None:
    gateway = Standin(two())
    at_s, points = gateway.at_s - 400, []
    for begun_s, north_m in ((0, 0), (160, 0), (220, 300)):  # a silence of a minute; 300 m away a second later
        points += [[at_s + begun_s + n, *place(north_m + n, 0)] for n in range(60)]
    gateway.history = {1: points}
    async with sailing(gateway) as page:
        assert await page.value("[delfim.pieces(1), delfim.pieces(2)]") == [4, 1], "the last one is where it is now"


async def test_the_track_is_whole_again_after_the_link_to_the_gateway_was_lost() -> None:
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


async def test_space_stops_one_boat_and_repeats_until_it_is_confirmed(page: Page, gateway: Standin) -> None:
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


async def test_shift_space_and_the_corner_stop_all(page: Page, gateway: Standin) -> None:
    await page.press(" ", ("Shift",))
    await gateway.command("stop", "all")
    for name, number in (("stop-all", "all"), ("stop", 1)):
        gateway.forget()
        box = f"document.getElementById('{name}').getBoundingClientRect()"
        x, y, width, height = await page.value(f"(r => [r.x + r.width / 2, r.y + r.height / 2, r.width, r.height])({box})")
        assert min(width, height) >= 64
        await page.mouse((x, y))
        await gateway.command("stop", number)


async def test_stop_works_in_front_of_an_open_menu(page: Page, gateway: Standin) -> None:
    await page.press("Enter")
    await page.until("document.querySelector('.item') !== null")
    await page.press(" ")
    await gateway.command("stop")
    assert await page.value("document.querySelector('.popup').hidden")


async def test_a_menu_is_worked_by_keys_and_shows_the_keys(page: Page, gateway: Standin) -> None:
    await page.press("Enter")
    assert await page.value("[...document.querySelectorAll('.popup kbd')].map(k => k.textContent)") == [
        *("Space", "B", "C", "L", "I", "M", "H", "U", "G", "P", "Y", "X", "0 … 8")
    ]
    for _ in range(13):
        await page.press("ArrowDown")
    await page.press("Enter")
    await page.until("document.querySelector('.field') !== null")
    for _ in range(4):
        await page.press("ArrowRight")
    await page.press("Enter")
    assert (await gateway.command("heading"))["heading_deg"] == 60


async def test_a_mode_that_is_asked_for_is_shown_as_asked_until_the_boat_says_it(page: Page, gateway: Standin) -> None:
    gateway.obedient = False
    await page.press("y")
    await gateway.command("play")
    state = "document.querySelector('[data-boat=\"1\"] .mode').dataset.state"
    await shown(page, gateway, f"{state} === 'asked'")
    await shown(page, gateway, f"{state} === 'late'")
    gateway.boat(1).update(mode="play", asked=None)
    await shown(page, gateway, f"{state} === 'on'")


async def test_a_number_that_is_used_twice_is_a_red_alarm_with_both_addresses(page: Page, gateway: Standin) -> None:
    gateway.boat(1)["twins"] = ["10.0.0.3:14550", "10.0.0.4:14550"]
    await shown(page, gateway, f"{text_of(1, '.trouble.bad')} === 'number 1 is used twice: 10.0.0.3:14550 and 10.0.0.4:14550'")


async def test_the_strip_says_who_else_commands(page: Page, gateway: Standin) -> None:
    for commander, words in ((1, "the hand-set is in control"), (250, "console 250 is in control")):
        gateway.boat(1).update(owner=False, commander=commander)
        await shown(page, gateway, f"{text_of(1, '.trouble')} === '{words}'")


async def test_a_message_that_cannot_be_taken_costs_itself_alone(page: Page, gateway: Standin) -> None:
    for text in ('{"t": "boats", "boats": [{"speed_mps": NaN}]}', "[", "null", "17", '{"t": "boats"}', '{"t": "what"}'):
        for socket in gateway.sockets:
            await socket.send_str(text)
    await settled(page, gateway)
    assert await page.value("delfim.online() && !document.getElementById('failed').hidden")
    page.complaints.clear()


async def test_the_graphs_of_port_and_starboard_have_one_zero_line(page: Page, gateway: Standin) -> None:
    zero = """[...document.querySelectorAll('[data-boat="1"] .graphs canvas')].map((each) => {
      const column = each.getContext('2d').getImageData(4, 0, 1, each.height).data; // older than what is drawn
      return [...Array(each.height).keys()].filter((y) => column[4 * y + 3] > 0);
    })"""
    gateway.boat(1)["rpm"] = [900.0, -300.0]
    await page.value("document.querySelector('.chip.selected .fold').click()")
    await page.value("new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
    await settled(page, gateway)
    port, starboard = await page.value(zero)
    assert port
    assert port == starboard


async def test_a_mission_that_ends_where_it_begins_shows_both_ends(page: Page, gateway: Standin) -> None:
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


async def test_areas_that_the_page_does_not_edit_are_drawn(page: Page, gateway: Standin) -> None:
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


async def test_a_refusal_is_said_in_words(page: Page, gateway: Standin) -> None:
    gateway.refusals["play"] = "no mission aboard"
    await page.press("y")
    await shown(page, gateway, "document.getElementById('messages').textContent.includes('play refused: no mission aboard')")


async def test_a_mission_is_drawn_by_the_mouse_saved_loaded_and_sent(page: Page, gateway: Standin) -> None:
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


async def test_a_mission_is_drawn_by_touch(page: Page, gateway: Standin) -> None:
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


async def test_the_finger_that_opened_a_menu_chooses_nothing_when_it_is_lifted(page: Page, gateway: Standin) -> None:
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


async def test_a_tap_on_the_sea_under_a_message_opens_its_menu(page: Page, gateway: Standin) -> None:
    gateway.refusals["play"] = "no mission aboard"
    await page.press("y")
    await shown(page, gateway, "document.querySelector('.message') !== null")
    box = "document.querySelector('.message').getBoundingClientRect()"
    x, y = await page.value(f"(r => [r.x + r.width / 2, r.y + r.height / 2])({box})")
    await page.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=1)
    await page.touch("Start", (x, y))
    await page.touch("End")
    await shown(page, gateway, "!document.querySelector('.popup').hidden")


async def test_the_second_click_of_two_in_a_row_chooses_nothing(page: Page, gateway: Standin) -> None:
    await page.value(
        "document.querySelector('.chip').click();"
        "const item = document.querySelectorAll('.item')[2];"
        "item.dispatchEvent(new PointerEvent('pointerdown', { bubbles: true }));"
        "item.dispatchEvent(new MouseEvent('click', { bubbles: true, detail: 2 }))"
    )
    await settled(page, gateway)
    assert await page.value("!document.querySelector('.popup').hidden")
    assert [m for m in gateway.said if m["t"] == "command"] == []


async def test_waypoints_are_ordered_deleted_and_given_speeds(page: Page, gateway: Standin) -> None:
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


async def test_speeds_are_shown_and_taken_in_knots_where_the_operator_chose_them(page: Page, gateway: Standin) -> None:
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


async def test_values_of_sensors_stand_in_words_with_the_ages_of_old_ones(page: Page, gateway: Standin) -> None:
    values = {"depth_m": (4.25, 0.2), "aws_mps": (5.1, 0.2), "awa_rad": (-0.7854, 0.2), "stw_mps": (1.0, 12.0)}
    values |= {"sigma_m": (0.014, 0.2), "corr_s": (2.0, 0.2)}
    told = {name: {"value": value, "age_s": age_s} for name, (value, age_s) in values.items()}
    gateway.boat(1).update(measured={**told, "turbidity": {"value": 3.14159, "age_s": 0.2}, "air_c": {"value": 1, "age_s": 99}})
    words = (
        "depth 4.3 m · apparent wind 5.1 m/s · apparent wind from 315° · through water 1.0 m/s (12 s ago)"
        " · position ± 0.01 m · corrections since 2 s · turbidity 3.142"
    )
    await shown(page, gateway, f"{text_of(1, '.measured')}.replaceAll('\\u00a0', ' ') === '{words}'")
    gateway.boat(1).update(measured={})
    await shown(page, gateway, "document.querySelector('[data-boat=\"1\"] .measured').hidden")


@pytest.mark.parametrize(
    ("title", "least"),
    [("Lawn-mower…", 10), *(pytest.param(*each, marks=pytest.mark.long) for each in (("Circle…", 3), ("Spiral…", 60)))],
)
async def test_patterns_become_waypoints_around_the_point(page: Page, gateway: Standin, title: str, least: int) -> None:
    await page.mouse(await pixel(page, 20, 0))
    await choose(page, "Pattern", title)
    await page.until("document.querySelector('.field') !== null")
    await page.press("Enter")
    mission = await planned(gateway, lambda w: True)
    assert len(mission["waypoints"]) >= least
    assert all(close(each, (20, 0), within_m=75) for each in mission["waypoints"])


async def test_plans_do_not_leak_from_boat_to_boat(page: Page, gateway: Standin) -> None:
    await page.mouse(await pixel(page, *SQUARE[0]))
    await choose(page, "Add waypoint")
    await planned(gateway, lambda w: True)
    await page.press("Tab")
    await page.mouse(await pixel(page, *SQUARE[2]))
    await choose(page, "Add waypoint")
    await planned(gateway, lambda w: True, 2)
    near(gateway.plans[1], [SQUARE[0]])
    near(gateway.plans[2], [SQUARE[2]])


async def test_what_differs_aboard_is_badged_and_can_be_taken(page: Page, gateway: Standin) -> None:
    gateway.stored["aboard"] = {**survey(), "name": "Aboard"}
    gateway.boat(1)["mission"] = {"name": "Aboard", "count": 10, "current": None, "state": "differs", "digest": "2"}
    await shown(page, gateway, f"{text_of(1, '.badge')} === 'differs'")
    await page.press("Enter")
    await choose(page, "Mission", "Read from the boat")
    assert (await gateway.until(lambda m: m.get("do") == "put"))["mission"]["name"] == "Aboard"


async def test_a_line_that_ends_at_a_hole_is_one_line_though_its_end_is_a_leg_of_its_own(page: Page, gateway: Standin) -> None:
    ends = [each | {"line": line} for each, line in zip(waypoints(SQUARE), (None, 1, 2, 2), strict=True)]
    await gateway.tell({"t": "mission", "boat": 1, "where": "here", "mission": {**survey(), "waypoints": ends}})
    await shown(page, gateway, "document.body.innerText.includes('survey: 2 lines · ')")


async def test_a_long_reason_of_the_check_is_not_covered_by_what_is_told_of_vessels(page: Page, gateway: Standin) -> None:
    gateway.refusals["check"] = (
        "mission refused: the leg to waypoint 2 leads through no-go water; " + 9 * "missions keep 6 m away, "
    )
    await gateway.tell({"t": "vessels", "at_s": 1.0, "heard_s": None, "vessels": []})
    await gateway.tell({"t": "mission", "boat": 1, "where": "here", "mission": survey()})
    await shown(page, gateway, "document.getElementById('check').textContent.includes('6 m away')")
    box = "document.getElementById('{}').getBoundingClientRect().{}"
    await shown(page, gateway, f"{box.format('check', 'bottom')} < {box.format('traffic', 'top')}")
    assert await page.value(f"{box.format('check', 'height')} > 90")


async def test_a_dry_run_says_time_and_distance(page: Page, gateway: Standin) -> None:
    await gateway.tell({"t": "mission", "boat": 1, "where": "here", "mission": survey()})
    await settled(page, gateway)
    gateway.plans[1] = survey()
    await page.press("Enter")
    await choose(page, "Mission", "Dry run")
    await shown(page, gateway, "document.getElementById('dryrun').textContent === 'dry run12 min 34 s1.11 km'")


async def test_a_silent_boat_stays_in_the_list_with_its_age(page: Page, gateway: Standin) -> None:
    gateway.boat(1)["age_s"] = dict.fromkeys(gateway.boat(1)["age_s"], 42.0)
    await shown(page, gateway, "document.querySelector('[data-boat=\"1\"]').dataset.age === 'lost'")
    assert (await page.value(text_of(1, ".age"))).startswith("42")
    assert await page.value("document.querySelector('.selected').dataset.boat") == "1"
    del gateway.boats[0]
    await gateway.frame()
    assert await page.value("document.querySelectorAll('.chip').length") == 2


async def test_on_a_phone_every_boat_is_in_sight_and_nothing_is_cut_off() -> None:
    gateway = Standin(fleet(10))
    async with gateway.serving(), tab() as page:
        await opened(page, gateway, width=390, height=780)
        await page.press("Tab")
        await shown(page, gateway, f"{text_of(2, 'b')} === document.querySelector('.selected b').textContent")
        all_boxes = "[...document.querySelectorAll('.chip, .chip .head b')].map(each => each.getBoundingClientRect())"
        boxes = await page.value(f"{all_boxes}.map(({{ left, right, bottom }}) => [left, right, bottom])")
        assert len(boxes) == 20
        assert all(left >= 0 and right <= 390 and bottom <= 780 * 0.38 for left, right, bottom in boxes)


async def test_nothing_covers_the_stop_corner_even_on_a_phone() -> None:
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
                assert await page.value(f"document.elementsFromPoint(...{at}).every(e => !e.closest('.popup, .card'))"), what
            await page.press("Escape")


async def test_in_a_replay_nothing_is_offered_that_cannot_be_done() -> None:
    gateway = at_work()
    gateway.hello["replay"] = {"from_s": gateway.at_s - 100, "to_s": gateway.at_s + 100}
    async with sailing(gateway) as page:
        assert await page.value("document.getElementById('stop').getClientRects().length") == 0
        assert await page.value("document.getElementById('replay').getClientRects().length") == 1
        for key in "imhgpyxr5":
            await gateway.frame(0)  # a page that hears nothing for 3 s is offline
            await page.press(key)
        await page.value("document.querySelector('.chip').click()")
        await page.until("document.querySelector('.item') !== null")
        await gateway.frame(0)
        titles = await page.value("[...document.querySelectorAll('.item .title')].map((each) => each.firstChild.data)")
        assert titles[:3] == ["Copy its mission…", "Copy its track as a mission…", "Ruler from here"]
        await page.press("Escape")
        await page.mouse(await pixel(page, *SURVEY[3]))
        await page.until("document.querySelector('.item') !== null")
        await gateway.frame(0)
        assert await page.value("document.querySelector('.item .title').textContent") == "Ruler from here"
        await page.press("Escape")
        await gateway.frame(0)
        await page.press(" ")
        await gateway.until(lambda m: m["t"] == "replay")
        assert {m.get("do", m["t"]) for m in gateway.said} == {"list", "replay"}


async def test_a_replay_is_moved_by_keys() -> None:
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


@pytest.mark.long
@pytest.mark.parametrize("how", ["dragged", "zoomed"])
async def test_ten_boats_with_an_hour_of_track_each_are_drawn_thirty_times_a_second_while_it_moves(how: str) -> None:
    """Waits for a second with so many drawings: when it comes is the machine's other load, that it comes is the page's merit.
    At rest the map is drawn as often as boats are told, ten times a second; the operator's hand needs more."""
    boats = fleet(10)
    gateway = Standin(boats)
    gateway.history = {each["id"]: hour(each) for each in boats}
    async with sailing(gateway) as page:
        drawn = [await second_of_moving(page, gateway, how) for _ in range(2)]
        async with asyncio.timeout(200):
            while max(drawn) < 30:
                drawn.append(await second_of_moving(page, gateway, how))
        print(f"{how}: {max(drawn)} drawings of the map in a second")


async def test_a_page_that_asked_elsewhere_or_missed_something_would_be_noticed() -> None:
    """What the other tests of the page look for at their ends does come."""
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


async def test_a_page_that_failed_says_so_until_it_is_loaded_again() -> None:
    """In a timer as the map's drawing, in a promise, and while it takes a message."""
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


async def test_page_style_and_program_are_no_more_than_600_kilobytes(page: Page, gateway: Standin) -> None:
    """As a browser unpacked them on its first visit: whatever script or style it asked for. The face, the coast and the
    charts, which come after them, are not counted."""
    counted = "navigation", "link", "script"
    loaded = await page.value(
        "[...performance.getEntriesByType('navigation'), ...performance.getEntriesByType('resource')]"
        ".map(each => [each.name, each.initiatorType, each.decodedBodySize])"
    )
    sizes = {
        name: size for name, kind, size in loaded if kind in counted and size and not name.endswith(("png", "webmanifest"))
    }
    assert len(sizes) >= 3, loaded
    assert sum(sizes.values()) <= PAGE_BYTES, sizes


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
    files = [
        *(WEB / name for name in names),
        *(each for folder in ("face", "icon", "src") for each in (WEB / folder).iterdir()),
    ]
    return {str(each.relative_to(WEB)): hashlib.sha256(each.read_bytes()).hexdigest() for each in files}
