"""Every way in which the page tells a boat something, from the key or the menu to what the vehicle obeyed: the real page,
gateway, link and vehicle.

The ways are read from the page's own source: one that has no row here fails, and so does a row that is nobody's way.
"""

import asyncio
import itertools
import re
import time
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from delfim.base.modes import Mode
from delfim.parts.mavlink.codec import wire
from delfim.parts.mavlink.codec.ownorders import own_offers
from delfim.vehicle import console
from tests.console import scenes
from tests.console.chain import PATIENCE_S, Boat, Sea, afternoon, ordered, select, shown_mode
from tests.console.fingers import Fingers
from tests.console.pads import plug, unplug
from tests.services.browser import Page

SOURCE = Path(__file__).parents[2] / "delfim/console/web/src"
METHOD = re.compile(r"^(?:  )?(?:(?:private|async|export|function) )*(\w+)\(.*\{$")
TELLS = re.compile(
    r"(?:actions\.(?=(?:stop|stopAll|mode|command|speed|faster|turn|headTo|setSpeed|setThrust|profile|mission)\()"
    r"|screen\.(?=enterMode\()|this\.(?:planning\.)?(?=(?:sail|send)\(boat\b))(\w+\((?:[^()]|\([^()]*\))*\))"
)
PASSED_ON = {"mode(boat, mode)", "command(boat.id, name)"}  # where the page has come to from one of the ways
NAMED = re.compile(r'command\("([^"]+)", "\w+"')  # of the menu that makes its entries by a function
NORTH_M = 1 / 111_111
PLACES = ((40.0, 0.0), (40.0, 30.0), (70.0, 30.0))  # of waypoints, metres north and east of the boat; home is beside the first
HOME = (20.0, -20.0)
FREE_M = itertools.count(-40.0, 12.0)  # north of the boat: where other waypoints are drawn
ENTERED = "document.querySelector('.selected .mode').dataset.state === 'on'"  # the mode that was asked for
OTHER = 199  # another console


def ways() -> set[str]:
    """Where the page tells a boat something, and how: file, method, and what the menu calls it."""
    found = set()
    modes = re.findall(r'\{ key: "(\w)", mode: "(\w+)", title: "([^"]+)"', (SOURCE / "keys.ts").read_text())
    for file in sorted(each for each in SOURCE.glob("*.ts") if each.name != "actions.ts"):
        method = ""
        for line in file.read_text().splitlines():
            if match := METHOD.match(line):
                method = match[1]
            title = re.search(r'title: ["`]([^"`$]+)', line)
            for call in TELLS.findall(line):
                if call in ("enterMode(boat, mode)", "sail(boat, mode)"):
                    if title is None and file.stem != "main":
                        found |= {f"{file.stem}.{method}: {key if file.stem == 'keys' else name}" for key, _, name in modes}
                elif call not in PASSED_ON:
                    called = f"{title[1].strip()}: " if title else ""
                    found.add(f"{file.stem}.{method}: {called}{call.partition(', {')[0].rstrip(')')}")
            found |= {f"{file.stem}.{method}: {name}" for name in NAMED.findall(line)}
    return found


class Row(NamedTuple):
    """A way. `told`: what the vehicle is told, as its log has it."""

    way: Callable[[Sea, Page, Boat], Awaitable[object]]
    told: dict[str, Any] | None = None


async def choose(page: Page, *titles: str) -> None:
    """Through the open menu, by the fingers of who has them."""
    await (page.choose(*titles) if isinstance(page, Fingers) else scenes.choose(page, *titles))


def keys(*pressed: str, held: tuple[str, ...] = ()) -> Callable[[Sea, Page, Boat], Awaitable[object]]:
    async def way(sea: Sea, page: Page, boat: Boat) -> None:
        for each in pressed[:-1]:  # until the boat is as it has to be
            count = len(boat.told())
            await page.press(each)
            await told(boat, count)
        await page.press(pressed[-1], held)

    return way


def menu(
    *titles: str, after: tuple[str, ...] = (), form: tuple[str, ...] = ()
) -> Callable[[Sea, Page, Boat], Awaitable[object]]:
    """The boat's menu; then the keys that fill in a form."""

    async def way(sea: Sea, page: Page, boat: Boat) -> None:
        if after:
            await keys(*after)(sea, page, boat)
            await page.until(ENTERED)
        await page.press("Enter")
        await choose(page, *titles)
        for each in form:
            await page.press(each)

    return way


def on_map(north_m: float, east_m: float, *titles: str) -> Callable[[Sea, Page, Boat], Awaitable[object]]:
    """The menu of what is drawn there, or of the bare map, as soon as no message covers it."""

    async def way(sea: Sea, page: Page, boat: Boat) -> None:
        x, y = at = await pixel(page, north_m, east_m)
        await page.until(f"document.elementFromPoint({x}, {y}).tagName === 'CANVAS'", PATIENCE_S)
        await page.mouse(at)
        await choose(page, *titles)

    return way


def corner(name: str) -> Callable[[Sea, Page, Boat], Awaitable[object]]:
    async def way(sea: Sea, page: Page, boat: Boat) -> None:
        await page.mouse(await middle(page, name))

    return way


def pad(*sticks: dict[str, Any], mode: str = "") -> Callable[[Sea, Page, Boat], Awaitable[object]]:
    """A gamepad, its stick here and there one after the other, and unplugged again."""

    async def way(sea: Sea, page: Page, boat: Boat) -> None:
        if mode:
            await page.press(mode)
            await page.until(ENTERED)
        for stick in sticks:
            await plug(page, **stick)
        await unplug(page)

    return way


async def middle(page: Page, name: str) -> tuple[float, float]:
    x, y = await page.value(
        f"(r => [r.x + r.width / 2, r.y + r.height / 2])(document.getElementById('{name}').getBoundingClientRect())"
    )
    return x, y


async def pixel(page: Page, north_m: float, east_m: float) -> tuple[float, float]:
    """Of a place beside where the boat was when the plan was drawn."""
    latitude_deg, longitude_deg = await page.value("window.origin")
    x, y = await page.value(f"delfim.pixel({latitude_deg + north_m * NORTH_M}, {longitude_deg + east_m * NORTH_M / 0.7806})")
    return x, y


async def says(page: Page, words: str) -> None:
    await page.until(f"document.getElementById('messages').textContent.includes({words!r})", PATIENCE_S)


async def badge(page: Page, words: str) -> None:
    await page.until(f"document.querySelector('.selected .badge').textContent === {words!r}", PATIENCE_S)


async def put(sea: Sea, page: Page, boat: Boat) -> None:
    """The gateway compares the plan with what is aboard."""
    await other_plan(sea, page, boat)
    await page.press("z", ("Control",))
    await badge(page, "same")


async def fetched(sea: Sea, page: Page, boat: Boat) -> None:
    await other_plan(sea, page, boat)
    await menu("Mission", "Read from the boat")(sea, page, boat)
    await badge(page, "same")


async def dry_run(sea: Sea, page: Page, boat: Boat) -> None:
    await menu("Mission", "Dry run")(sea, page, boat)
    await page.until("!document.getElementById('dryrun').hidden", PATIENCE_S)


async def saved(sea: Sea, page: Page, boat: Boat) -> None:
    await menu("Mission", "Save")(sea, page, boat)
    await says(page, "saved: ")
    assert list((sea.folder / "missions").glob("*.toml"))


async def loaded(sea: Sea, page: Page, boat: Boat) -> None:
    """What was saved, in place of a plan that has a waypoint more; files hold no home."""
    await saved(sea, page, boat)
    name = next((sea.folder / "missions").glob("*.toml")).stem
    count = await page.value("delfim.drawn().plan")
    await other_plan(sea, page, boat)
    await menu("Mission", "Load", name)(sea, page, boat)
    await page.until(f"delfim.drawn().plan === {count}", PATIENCE_S)
    await menu("Mission", "Read from the boat")(sea, page, boat)
    await badge(page, "same")


async def continued(sea: Sea, page: Page, boat: Boat) -> None:
    await keys("h", "b")(sea, page, boat)
    await shown_mode(page, 2, "hold")
    await page.until(ENTERED)
    await menu("Continue")(sea, page, boat)


async def sent_first(sea: Sea, page: Page, boat: Boat) -> None:
    """Another plan is drawn, and played; the one before is sent again afterwards."""
    await other_plan(sea, page, boat)
    await page.press("y")
    await choose(page, "Send the plan, then play it")
    await badge(page, "same")
    await boat.until(lambda state: state["mode"] == "play")


def changed(way: Callable[[Page], Awaitable[object]]) -> Callable[[Sea, Page, Boat], Awaitable[object]]:
    """A waypoint is added while the mission is sailed, and sent; the boat sails on."""

    async def sent(sea: Sea, page: Page, boat: Boat) -> None:
        await page.press("y")
        await shown_mode(page, 2, "mission")
        await page.until(ENTERED)
        await other_plan(sea, page, boat)
        legs = boat.state()["legs"]
        await way(page)
        await badge(page, "same")
        await boat.until(lambda state: state["mode"] == "play" and state["legs"] != legs)
        assert await page.value("document.querySelector('.selected .changes').hidden")

    return sent


async def asked_to_play(page: Page) -> None:
    await page.press("y")
    await choose(page, "Send changes")


async def button_pressed(page: Page) -> None:
    at = "(r => [r.x + r.width / 2, r.y + r.height / 2])(document.querySelector('.selected .changes').getBoundingClientRect())"
    x, y = await page.value(at)
    await page.mouse((x, y))


def row_of_orders(title: str, after: str = "") -> Callable[[Sea, Page, Boat], Awaitable[object]]:
    """The buttons at the selected boat."""

    async def way(sea: Sea, page: Page, boat: Boat) -> None:
        its = f"[...document.querySelectorAll('.selected .orders button')].find((each) => each.textContent === {title!r})"
        if after:
            await keys(*(("h", "b") if after == "b" else after))(sea, page, boat)
            await page.until(ENTERED)
        await page.until(f"{its}.getAttribute('aria-disabled') !== 'true'", PATIENCE_S)
        await page.mouse(
            tuple(await page.value(f"(r => [r.x + r.width / 2, r.y + r.height / 2])({its}.getBoundingClientRect())"))
        )

    return way


async def held_first(sea: Sea, page: Page, boat: Boat) -> None:
    """Another plan is drawn while one is sailed, and played from its second waypoint on."""
    await page.press("y")
    await shown_mode(page, 2, "mission")
    await page.until(ENTERED)
    await other_plan(sea, page, boat)
    await on_map(*PLACES[1], "Play from here")(sea, page, boat)
    await choose(page, "Hold, send the plan, then play it")
    await badge(page, "same")
    await boat.until(lambda state: state["mode"] == "play" and state["reference"]["leg"] == 1)


async def killed_and_cleared(sea: Sea, page: Page, boat: Boat) -> None:
    await menu("More", "Kill: idle until it is cleared")(sea, page, boat)
    await boat.until(lambda state: state["killed"]["reason"] == "operator: commanded")
    await menu("More", "Clear the kill")(sea, page, boat)
    await boat.until(lambda state: not state["killed"]["reason"])


async def other_plan(sea: Sea, page: Page, boat: Boat) -> None:
    """With a waypoint more, where none was before."""
    await on_map(next(FREE_M), -50.0, "Add waypoint")(sea, page, boat)
    await badge(page, "differs")


async def profile(sea: Sea, page: Page, boat: Boat) -> None:
    for name in ("radio", "wifi"):
        await menu("More", f"Link: {name}")(sea, page, boat)
        await page.until(f"document.querySelector('.selected .link').textContent.startsWith('{name} ')", PATIENCE_S)


async def taken(sea: Sea, page: Page, boat: Boat) -> None:
    """From another console that speaks by the same link."""
    other = wire.Sender(OTHER, 190, None, lambda: 0)
    sea.radios[1].say(other.pack(ordered(2, 32100, 0, 1, 1)))
    await page.until(f"document.querySelector('.selected .trouble').textContent.includes('console {OTHER} ')", PATIENCE_S)
    await menu("More", "Take control")(sea, page, boat)


def heading(turned_deg: float) -> dict[str, Any]:
    return {"command": "heading", "turned_deg": turned_deg}


STOP = {"command": "stop"}
GO_HOME = {"command": "mode", "mode": "home"}
PAUSE, CONTINUE = {"command": "pause"}, {"command": "continue"}
MODES = {
    "I": ("Idle", STOP),
    "M": ("Manual", {"command": "mode", "mode": "manual"}),
    "H": ("Heading", heading(0.0)),
    "L": ("Go home", GO_HOME),
    "U": ("Unstick", {"command": "mode", "mode": "unstick"}),
    "G": ("Go to waypoint 1", {"command": "goto", "latitude_deg": None}),
    "P": ("Path following", {"command": "mode", "mode": "path"}),
    "Y": ("Play mission", {"command": "play", "leg": 0}),
    "X": ("GREX", {"command": "mode", "mode": "grex", "refused": "no set point from the guest"}),
}
ROWS: dict[str, Row] = {
    "corner.: stop(state.selected": Row(corner("stop"), STOP),
    "corner.: stopAll(": Row(corner("stop-all"), STOP),
    "keys.stop: stop(this.state.boat.id": Row(keys(" "), STOP),
    "keys.stop: stopAll(": Row(keys(" ", held=("Shift",)), STOP),
    **{f"keys.letter: {key}": Row(keys(key.lower()), what) for key, (_, what) in MODES.items()},
    "keys.letter: command(boat.id, order.command": Row(keys("r"), {"command": "reset", "node": 127}),
    "keys.digit: speed(this.state.boat, which(event), 10 * Number(digit": Row(
        keys("h", "3"), {"command": "speed", "speed_pct": 30}
    ),
    "keys.arrow: faster(boat, which(event), 1": Row(keys("h", "3", "ArrowUp"), {"command": "speed", "speed_pct": 31}),
    "keys.arrow: faster(boat, which(event), -1": Row(keys("h", "3", "ArrowDown"), {"command": "speed", "speed_pct": 29}),
    "keys.arrow: turn(boat, which(event), 1": Row(keys("h", "ArrowRight"), heading(1.0)),
    "keys.arrow: turn(boat, which(event), -1": Row(keys("h", "ArrowLeft"), heading(-1.0)),
    "gamepad.look: stop(boat.id": Row(pad({}, {"stop": True}), STOP),
    "gamepad.thrust: setThrust(boat, port, starboard": Row(
        pad({}, {"right": 0.1, "ahead": 0.2}, mode="m"), told={"command": "manual", "port": 0.3, "starboard": 0.1}
    ),
    'gamepad.steer: turn(boat, "both", Math.round(right * TURN_DEG': Row(pad({}, {"right": 0.3}, mode="h"), heading(1.0)),
    'gamepad.steer: faster(boat, "both", Math.round(ahead * FASTER_PCT': Row(
        pad({}, {"ahead": 0.3}, mode="h"),
        {"command": "speed"},  # how often the page looks meanwhile, and so how much, is the machine's
    ),
    'main.planned: mission(boat, "put"': Row(put),
    "menus.boat: Stop: stop(boat.id": Row(menu("Stop"), STOP),
    "menus.boat: Pause: hold here": Row(menu("Pause: hold here", after=("h",)), PAUSE),
    "menus.boat: Continue": Row(continued, CONTINUE),
    **{f"menus.boat: {title}": Row(menu(title), what) for title, what in MODES.values()},
    "menus.headingForm: command(boat.id, mode": Row(
        menu("Course over ground…", form=("ArrowRight", "Enter")), {"command": "course"}
    ),
    "menus.headingForm: headTo(boat, heading": Row(menu("Heading…", after=("h",), form=("ArrowLeft", "Enter")), heading(-5.0)),
    'menus.speedForm: speed(boat, "both", speed': Row(
        menu("Speed…", after=("h", "3"), form=("ArrowRight", "Enter")),
        {"command": "speed", "speed_pct": 35},
    ),
    "menus.thrustForm: setThrust(boat, ...thrust": Row(
        menu("Thrust…", after=("m",), form=("ArrowRight", "ArrowDown", "ArrowLeft", "Enter")),
        told={"command": "manual", "port": 0.05, "starboard": -0.05},
    ),
    'menus.more: Hold this position: mode(boat, "hold"': Row(
        menu("More", "Hold this position"), {"command": "mode", "mode": "hold"}
    ),
    "menus.more: Arm": Row(menu("More", "Arm"), {"command": "arm"}),
    "menus.more: Disarm": Row(menu("More", "Disarm", after=("h",)), STOP),
    "menus.offered: command(boat.id, command, words": Row(menu("More", "Reset the peripherals"), {"command": "reset"}),
    "menus.more: Take control": Row(taken, {"command": "take"}),
    "menus.more: Link:: profile(boat.id, name": Row(profile),
    "planning.mission: Send: send(boat": Row(menu("Mission", "Send to the boat"), told={"command": "upload"}),
    'planning.fetch: mission(boat.id, "download"': Row(fetched),
    'planning.dryRun: mission(boat.id, "dryrun"': Row(dry_run),
    'planning.save: mission(boat.id, "save", name': Row(saved),
    'planning.save: mission(boat.id, "list"': Row(loaded),
    'planning.stored: mission(boat.id, "load", name': Row(loaded),
    'planning.here: Send: command(boat.id, "goto"': Row(
        on_map(-30.0, -30.0, "Send boat2 here"), {"command": "goto", "place": (-30.0, -30.0)}
    ),
    'planning.waypoint: Play from here: sail(boat, "play", index': Row(
        on_map(*PLACES[2], "Play from here"), {"command": "play", "leg": 2}
    ),
    'planning.waypoint: Follow the path from here: sail(boat, "path", index': Row(
        on_map(*PLACES[1], "Follow the path from here"), {"command": "mode", "mode": "path", "piece": 1}
    ),
    'planning.waypoint: Go to this point: command(boat.id, "goto"': Row(
        on_map(*PLACES[1], "Go to this point"), {"command": "goto", "place": PLACES[1]}
    ),
    'planning.home: Go home: mode(boat, "home"': Row(on_map(*HOME, "Go home"), GO_HOME),
    # What another plan than the one aboard needs first.
    'planning.send: mission(boat.id, "upload"': Row(sent_first, {"command": "play", "leg": 0}),
    "planning.sail: Send changes: send(boat": Row(changed(asked_to_play), told={"command": "upload"}),
    'orders.constructor: command(this.boat.id, "pause"': Row(row_of_orders("Pause", after="h"), PAUSE),
    'orders.constructor: command(this.boat.id, "continue"': Row(row_of_orders("Continue", after="b"), CONTINUE),
    'orders.constructor: enterMode(this.boat, "home"': Row(row_of_orders("Home"), GO_HOME),
    'orders.constructor: enterMode(this.boat, "play"': Row(row_of_orders("Play"), {"command": "play", "leg": 0}),
    'strip.constructor: mission(this.boat.id, "upload"': Row(changed(button_pressed), told={"command": "upload"}),
    "planning.replace: send(boat": Row(sent_first, told={"command": "upload"}),
    'planning.replace: command(boat.id, "mode"': Row(held_first, {"command": "mode", "mode": "hold"}),
    'planning.sail: command(boat.id, "play"': Row(held_first, {"command": "play", "leg": 1}),
    'planning.sail: command(boat.id, "mode"': Row(
        on_map(*PLACES[0], "Follow the path from here"), {"command": "mode", "mode": "path", "piece": 0}
    ),
    "key: B": Row(keys("h", "b"), PAUSE),
    "key: C": Row(keys("h", "b", "c"), CONTINUE),
    # Entries that the boat offers, as it offers the reset.
    "key: O": Row(keys("o"), {"command": "overrule"}),
    "menu: Kill": Row(killed_and_cleared, {"command": "kill"}),
    "menu: Clear the kill": Row(killed_and_cleared, {"command": "clear"}),
}


def test_every_way_has_a_row_and_every_row_is_a_way() -> None:
    assert {each for each in ROWS if not each.startswith(("key: ", "menu: "))} == ways()


def test_each_order_of_a_console_is_said_by_the_page_and_each_mode_is_entered() -> None:
    told = [row.told for row in ROWS.values() if row.told is not None]
    orders = {word for word, kind in console.KINDS.items() if issubclass(kind, console.OperatorOrder)}
    assert orders - {each["command"] for each in told} == {"order", "payload", "trial"}, "which programs have"
    entered = {each.get("mode") or console.KINDS[each["command"]].ENTERS for each in told}
    assert entered >= {mode.name.lower() for mode in Mode} - {"trial"}, "which a program gives"


def test_a_key_does_one_thing() -> None:
    modes = re.findall(r'\{ key: "(\w)", mode:', (SOURCE / "keys.ts").read_text())
    pressed = ["K", "W", *modes, *(each.key for each in own_offers() if each.key)]
    assert len(pressed) == len(set(pressed)) > 9


async def told(boat: Boat, count: int) -> None:
    """More than so many things."""
    async with asyncio.timeout(PATIENCE_S):
        while len(boat.told()) <= count:
            await asyncio.sleep(0.05)


@pytest.fixture(scope="module")
def afloat(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[asyncio.Runner, Sea]]:
    """Two boats, the second with a mission and a home that were drawn and sent."""
    with afternoon(tmp_path_factory.mktemp("commands")) as (runner, its):
        runner.run(planned(its))
        yield runner, its


@pytest.fixture
def its(runner: asyncio.Runner, afloat: tuple[asyncio.Runner, Sea]) -> Sea:
    return afloat[1]


async def planned(sea: Sea) -> None:
    page, boat = await sea.at_rest(2)
    state = boat.state()
    await page.value(f"window.origin = [{state['latitude_deg']}, {state['longitude_deg']}], 0")
    south, west, north, east = -50.0 * NORTH_M, -60.0 * NORTH_M, 90.0 * NORTH_M, 60.0 * NORTH_M
    await page.value(f"(([a, b]) => delfim.fit(a + {south}, b + {west}, a + {north}, b + {east}))(window.origin)")
    for place in PLACES:
        await on_map(*place, "Add waypoint")(sea, page, boat)
    await on_map(*HOME, "Fence, obstacle, home", "Set home here")(sea, page, boat)
    await menu("Mission", "Send to the boat")(sea, page, boat)
    await badge(page, "same")


SHOWN_DEG = "Number(/hdg (\\d+)/.exec(document.querySelector('.selected').textContent)[1])"


# What the page says by these is what another row has it say, or `test_page.py` and `test_gamepad.py` look at it.
LONG = (
    *(
        "gamepad.thrust",
        "gamepad.steer",
        "keys.arrow: faster(boat, which(event), -1",
        "keys.arrow: turn(boat, which(event), -1",
    ),
    *(f"keys.letter: {key}" for key in "MLUGPX"),
    *(
        "menus.boat: Pause",
        "menus.boat: Continue",
        "menus.speedForm",
        "menus.headingForm: headTo",
        "menus.more: Hold",
        "key: B",
    ),
    *(
        "planning.dryRun",
        'planning.save: mission(boat.id, "save"',
        "planning.fetch",
        "planning.waypoint: Follow",
        "planning.waypoint: Go to",
        "planning.sail: command",
    ),
    *("planning.home", "orders.constructor: enterMode", "strip.constructor"),
)


def stories() -> list[Any]:
    """The rows, those together that are ways of one story. Long, too: what a menu's entry and a letter enter alike."""
    of = dict[Any, list[str]]()
    found = list[Any]()
    for name, row in ROWS.items():
        of.setdefault(row.way, []).append(name)
    twice = {f"menus.boat: {title}" for title, _ in MODES.values()} - {"menus.boat: Play mission"}
    for names in of.values():
        long = twice.issuperset(names) or names[0].startswith(LONG)
        found.append(pytest.param([ROWS[name] for name in names], id=" + ".join(names), marks=pytest.mark.long if long else ()))
    return found


@pytest.mark.parametrize("rows", stories())
async def test_what_the_page_says_is_what_the_vehicle_obeys(its: Sea, rows: list[Row]) -> None:
    await said_and_obeyed(its, rows)


async def steady(page: Page, boat: Boat) -> bool:
    """Whether she does not turn, and the page knows her heading."""
    state = await asyncio.to_thread(boat.state)
    off_deg = (await page.value(SHOWN_DEG) - state["heading_deg"] + 540.0) % 360.0 - 180.0
    return abs(state["turn_dps"]) < 0.5 and abs(off_deg) < 1.5


async def said_and_obeyed(sea: Sea, rows: list[Row], hand: Callable[[Page], Page] = lambda page: page) -> None:
    """The rows of one way. `hand`: what works the page, if it is no mouse and no keys."""
    row = rows[0]
    page, boat = await sea.at_rest(2)
    await select(page, 2)
    if row.told and "turned_deg" in row.told:  # of the heading that it has when the menu is chosen from
        async with asyncio.timeout(PATIENCE_S):  # she drifts on: what the page shows is held against what she says now
            while not await steady(page, boat):
                await asyncio.sleep(0.05)
    if row.told and row.told["command"] == "reset":  # refused while a stopped propeller coasts
        await boat.until(lambda state: all(abs(each["rpm"] or 0.0) < 50.0 for each in state["thrusters"].values()))
    began_ns, before = time.time_ns(), boat.state() | {"origin": await page.value("window.origin")}
    await row.way(sea, hand(page), boat)
    for each in rows:
        if each.told is not None:
            await obeyed(boat, began_ns, before, each.told)
    await sea.nothing_amiss()


async def test_a_refused_plan_is_told_once_and_in_the_boats_words(its: Sea) -> None:
    page, boat = await its.at_rest(2)
    await select(page, 2)
    await page.press("y")
    await shown_mode(page, 2, "mission")
    await page.until(ENTERED)
    await on_map(*PLACES[0], "Delete")(its, page, boat)
    await badge(page, "differs")
    await menu("Mission", "Send changes")(its, page, boat)
    await says(page, "mission refused: waypoint 1 is at another place")
    await page.until("!document.querySelector('.selected').textContent.includes('upload ')")  # the answer has come
    refusals = "[...document.querySelectorAll('.message')].map(m => m.textContent).filter(each => each.includes('refused'))"
    assert len(await page.value(refusals)) == 1, await page.value(refusals)
    await page.press("z", ("Control",))
    await badge(page, "same")


async def obeyed(boat: Boat, began_ns: int, before: dict[str, Any], wanted: dict[str, Any]) -> None:
    """The vehicle is told something like this, and does it unless it is to be refused."""

    def fits(each: dict[str, Any], name: str, value: Any) -> bool:
        if name == "turned_deg":
            return abs((each["heading_deg"] - before["heading_deg"] - value + 180.0) % 360.0 - 180.0) < 3.0
        if name == "place":
            return abs(each["latitude_deg"] - before["origin"][0] - value[0] * NORTH_M) < 3 * NORTH_M
        if name == "refused":
            return value in each["refused"] if value else not each["refused"]
        return bool(each[name] == (pytest.approx(value, abs=1e-3) if isinstance(value, float) else value))

    def is_it(each: dict[str, Any]) -> bool:
        return all(fits(each, name, value) for name, value in ({"refused": ""} | wanted).items())

    heard: list[dict[str, Any]] = []
    try:
        async with asyncio.timeout(PATIENCE_S / 2):
            while not any(map(is_it, heard)):
                heard = [each for each in boat.told() if each["taken_ns"] > began_ns and each["command"] == wanted["command"]]
                await asyncio.sleep(0.05)
    except TimeoutError:
        told = [each for each in boat.told() if each["taken_ns"] > began_ns]
        raise AssertionError(f"wanted {wanted}, and it was told {told}; its heading was {before['heading_deg']}") from None
