"""The whole chain: a real browser, the page, the gateway, and two simulated boats that run the vehicle's own program."""

import asyncio
import contextlib
import os
import signal
import socket
import subprocess
import sys
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any

from delfim import config
from delfim.clock import SystemClock
from delfim.console.gateway import Gateway, serve
from delfim.console.link import Link
from tests.console.scenes import choose
from tests.services.browser import Page, browser

VEHICLE = Path(__file__).parents[2] / "etc/delfimx.toml"
NOWHERE = "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"
NORTH_M = 1 / 111_111
RPM_MAX = config.load(VEHICLE).propulsion.rpm_max
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
SAIL_S = 60.0


class Boat:
    """One of the boats, asked over its own command socket."""

    def __init__(self, place: Path) -> None:
        self.place = place

    def state(self) -> dict[str, Any]:
        with Link(self.place / "command") as link:
            return link.ask("state")

    async def until(self, is_so: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
        state: dict[str, Any] = {}
        try:
            async with asyncio.timeout(SAIL_S):
                while True:
                    with contextlib.suppress(OSError):
                        state = await asyncio.to_thread(self.state)
                    if state and is_so(state):
                        return state
                    await asyncio.sleep(0.05)
        except TimeoutError:
            raise AssertionError(f"it never was so; at last: {state}") from None


@contextlib.contextmanager
def afloat(place: Path, number: int, port: int) -> Iterator[Boat]:
    """A boat's nodes and its program, as at sea but for the bus."""
    place.mkdir()
    values = (
        f'boat.name="boat{number}"',
        f"boat.id={number}",
        f'can.interface="canloop:operating-{os.getpid()}-{place.parent.name[-8:]}-{number}"',
        f'console.socket="{place}/command"',
        f'log.directory="{place}/log"',
        f'runtime.run_directory="{place}"',
        'supervisor.hardware_watchdog=""',
        'httpd.listen="127.0.0.1:0"',
        'cantcpd.listen=["127.0.0.1:0"]',
        'guest.listen="127.0.0.1:0"',
        'mavlink.listen="127.0.0.1:0"',
        f'mavlink.peers=["127.0.0.1:{port}"]',
    )
    words = [str(VEHICLE), *(word for value in values for word in ("--set", value))]
    programs = [subprocess.Popen([sys.executable, "-m", "delfim", name, *words]) for name in ("nodes", "supervise")]
    try:
        yield Boat(place)
    finally:
        for program in reversed(programs):
            program.send_signal(signal.SIGTERM)
            program.wait(30)


@contextlib.asynccontextmanager
async def operating(tmp_path: Path) -> AsyncIterator[tuple[str, list[Boat]]]:
    """A gateway, and where its page is; two boats."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    gateway = Gateway(SystemClock(), tmp_path / "missions", vehicle=VEHICLE)
    ready = asyncio.get_running_loop().create_future()
    async with asyncio.TaskGroup() as group:
        console = group.create_task(serve(gateway, ("127.0.0.1", port), ("127.0.0.1", 0), ready.set_result))
        url = await ready
        with afloat(tmp_path / "1", 1, port) as first, afloat(tmp_path / "2", 2, port) as second:
            yield url, [first, second]
        console.cancel()


@contextlib.asynccontextmanager
async def opened(tmp_path: Path, url: str) -> AsyncIterator[Page]:
    async with browser(tmp_path / "browser", NOWHERE) as page:
        await page.open(url, width=1280, height=800, scale=1.0)
        await page.until("document.querySelectorAll('.chip').length === 2", SAIL_S)
        yield page
        assert page.complaints == []


async def shown_mode(page: Page, number: int, words: str) -> None:
    await page.until(f"document.querySelector('[data-boat=\"{number}\"] .mode').textContent === '{words}'", SAIL_S)


async def pressed(page: Page, boat: Boat, key: str, mode: str) -> None:
    await page.press(key)
    await boat.until(lambda state: state["mode"] == mode)


async def fit_to_go(page: Page, boats: list[Boat]) -> None:
    for number, boat in enumerate(boats, 1):
        await boat.until(lambda state: state["age_s"]["navigation"] is not None and state["age_s"]["navigation"] < 1)
        await page.until(f"document.querySelector('[data-boat=\"{number}\"] .trouble').hidden", SAIL_S)


async def drawn(page: Page, boat: Boat) -> None:
    """A triangle around the selected boat, drawn by mouse and sent."""
    state = boat.state()
    latitude_deg, longitude_deg = state["latitude_deg"], state["longitude_deg"]
    south, north = latitude_deg - 90 * NORTH_M, latitude_deg + 90 * NORTH_M
    await page.value(f"delfim.fit({south}, {longitude_deg - 0.001}, {north}, {longitude_deg + 0.001})")
    for north_m, east_deg in ((60, 0.0), (60, 0.0008), (-60, 0.0008)):
        await page.mouse(await page.value(f"delfim.pixel({latitude_deg + north_m * NORTH_M}, {longitude_deg + east_deg})"))
        await choose(page, "Add waypoint")
    await page.press("Enter")
    await choose(page, "Mission", "Send to the boat")
    await page.until("document.querySelector('.selected .badge').textContent === 'same'", SAIL_S)


def test_an_operator_sails_one_of_two_boats_by_mouse_and_keys(tmp_path: Path) -> None:
    async def story() -> None:
        async with operating(tmp_path) as (url, (first, second)):
            async with opened(tmp_path, url) as page:
                await fit_to_go(page, [first, second])
                if await page.value("document.querySelector('.selected').dataset.boat") == "1":  # the one that was found first
                    await page.press("Tab")
                await page.until("document.querySelector('.selected').dataset.boat === '2'")
                await by_keys(page, second)
                assert first.state()["mode"] == "idle"
            # The browser is gone while it drove by hand.
            await second.until(lambda state: abs(state["port_rpm"]) < 50 and abs(state["starboard_rpm"]) < 50)

    asyncio.run(story())


def turning(port: int, starboard: int) -> Callable[[dict[str, Any]], bool]:
    """Whether the vehicle commands the propellers to give this, percent."""

    def is_so(state: dict[str, Any]) -> bool:
        asked = (state["port_rpm"], port), (state["starboard_rpm"], starboard)
        return all(abs(rpm / RPM_MAX - percent / 100) < 0.004 for rpm, percent in asked)

    return is_so


async def by_keys(page: Page, boat: Boat) -> None:
    await drawn(page, boat)
    for key, mode in (("h", "heading"), ("g", "goto"), ("p", "path"), ("y", "play"), ("i", "idle")):
        await pressed(page, boat, key, mode)
    await page.press("r")
    await page.press("x")
    await page.until("document.getElementById('messages').textContent.includes('grex refused: ')", SAIL_S)
    assert "reset refused" not in await page.value("document.getElementById('messages').textContent")
    await pressed(page, boat, "m", "manual")
    for key, modifiers, port, starboard in THRUST:
        await page.press(key, modifiers)
        await boat.until(turning(port, starboard))
    await page.press(" ")
    await boat.until(lambda state: state["mode"] == "idle" and abs(state["port_rpm"]) < 50)
    await shown_mode(page, 2, "idle")
    await asleep_and_awake(page, boat)


async def asleep_and_awake(page: Page, boat: Boat) -> None:
    """Nothing turns while the laptop sleeps, nor when it wakes up, until the operator acts."""
    await pressed(page, boat, "m", "manual")
    await page.press("4")
    await boat.until(turning(40, 40))
    page.sleep()
    try:
        cycle = (await boat.until(turning(0, 0)))["cycle"]
        await boat.until(lambda state: state["cycle"] > cycle + 5)
    finally:
        page.wake()
    await page.value("document.title")
    woken = boat.state()
    assert turning(0, 0)(woken)
    await boat.until(lambda state: not turning(0, 0)(state) or state["cycle"] > woken["cycle"] + 10)
    assert turning(0, 0)(boat.state())
    await pressed(page, boat, "m", "manual")
    await page.press("4")
    await boat.until(turning(40, 40))
