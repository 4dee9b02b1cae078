"""The whole chain: a real browser, the page, the gateway as a process, a radio link to each boat, and boats that run their own
programs. What a boat did is read from its own logs, by its own clock.
"""

import asyncio
import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, cast

from delfim.base.errors import DelfimError
from delfim.canproxy.dsor import messages
from delfim.logging.candump import parse_line
from delfim.logging.liblog import in_order
from delfim.logging.reading import read_log
from delfim.parts.mavlink.codec import wire
from delfim.vehicle.operator.link import Link
from tests.kit.processes import ENDS_WITH_US
from tests.services.browser import Page, tab

ROOT = Path(__file__).parents[2]
VEHICLE = ROOT / "etc/delfimx.toml"
PATIENCE_S = 200.0
BERTHS = ((38.6907, -9.2153), (38.6907, -9.2165), (38.6907, -9.2177))  # a hundred metres apart


class Turning(NamedTuple):
    """A command to a propeller on the bus."""

    t_ns: int
    arb: int
    rpm: float  # 0 where it is switched off


class Boat:
    """One of the boats, asked over its own command socket, and its logs."""

    def __init__(self, place: Path, number: int) -> None:
        self.place, self.number = place, number
        self._heard = dict[Path, list[dict[str, Any]]]()  # of each file of its log
        self._read = dict[Path, int]()  # bytes

    def state(self) -> dict[str, Any]:
        with Link(self.place / "command") as link:
            return link.ask("state")

    async def until(self, is_so: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
        state: dict[str, Any] = {}
        try:
            async with asyncio.timeout(PATIENCE_S):
                while True:
                    with contextlib.suppress(OSError, DelfimError):
                        state = await asyncio.to_thread(self.state)
                    if state and is_so(state):
                        return state
                    await asyncio.sleep(0.05)
        except TimeoutError:
            raise AssertionError(f"it never was so; it was told {self.told()[-3:]}; at last: {state}") from None

    async def delfim(self, *words: str, env: dict[str, str] | None = None) -> str:
        """A command of the operator's that speaks to this boat; what it printed."""
        there = "--set", f'console.socket="{self.place}/command"', "--set", f'runtime.run_directory="{self.place}"'
        command = [sys.executable, "-m", "delfim", words[0], str(VEHICLE), *there, *words[1:]]
        done = await asyncio.to_thread(
            subprocess.run, command, capture_output=True, text=True, timeout=PATIENCE_S, env=env, check=False
        )
        return done.stdout + done.stderr

    async def sails_on(self, cycles: int) -> dict[str, Any]:
        """So many cycles of its navigation, five a second."""
        cycle = (await asyncio.to_thread(self.state))["cycle"]
        return await self.until(lambda state: state["cycle"] >= cycle + cycles)

    def told(self) -> list[dict[str, Any]]:
        """The commands that it heard: with when, ns since 1970, and why it refused them."""
        found = []
        for event in self._events():
            if event["event"] == "command" and event["value"]["command"] != "alive":
                taken_ns = event["t_ns"] - round((event["monotonic_s"] - event["at_s"]) * 1e9)
                found.append(event["value"] | {"taken_ns": taken_ns, "refused": event["refused"]})
        return found

    def pushes(self) -> list[tuple[int, bool]]:
        """The manual commands that it obeyed: when, and whether they asked for thrust."""
        manual = (each for each in self.told() if each["command"] == "manual" and not each["refused"])
        return [(each["taken_ns"], bool(each["port"] or each["starboard"])) for each in manual]

    def _events(self) -> Iterator[dict[str, Any]]:
        for file in in_order((self.place / "log").glob("*/state/*.meta.jsonl")):
            with file.open("rb") as opened:
                opened.seek(self._read.get(file, 0))
                whole, end, _ = opened.read().rpartition(b"\n")
            self._read[file] = self._read.get(file, 0) + len(whole + end)
            heard = self._heard.setdefault(file, [])
            heard += map(json.loads, whole.splitlines())
            yield from heard

    async def turnings(self, until_ns: int) -> list[Turning]:
        """What its black box has of the propellers, as soon as that reaches to this time."""
        async with asyncio.timeout(PATIENCE_S):
            while not (found := self._turnings()) or found[-1].t_ns < until_ns:
                await asyncio.sleep(0.2)
        return found

    def _turnings(self) -> list[Turning]:
        found = []
        for file in in_order((self.place / "log").glob("*/*/*.log*")):
            for line in read_log(file)[0].decode().splitlines(keepends=True):
                if line.endswith("\n"):
                    frame = parse_line(line)[1]
                    if frame.arb in (messages.PROPELLER_PORT, messages.PROPELLER_STARBOARD):
                        told = messages.unpack_propeller_command(frame.data)
                        found.append(Turning(frame.t_ns, frame.arb, told.rpm if told.run else 0))
        return found


def turning(port: int, starboard: int) -> Callable[[dict[str, Any]], bool]:
    """Whether the vehicle commands the propellers to give this, percent."""

    def is_so(state: dict[str, Any]) -> bool:
        asked = ("port", port), ("starboard", starboard)
        return all(abs(state["thrusters"][name]["thrust"] - percent / 100) < 0.004 for name, percent in asked)

    return is_so


@contextlib.contextmanager
def afloat(
    place: Path, number: int, port: int, more: tuple[str, ...] = (), env: dict[str, str] | None = None
) -> Iterator[Boat]:
    """A boat's nodes and its program, as at sea but for the bus. `more` of its settings; `env` of another program than ours."""
    place.mkdir()
    latitude_deg, longitude_deg = BERTHS[number - 1]
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
        f"simulation.latitude_deg={latitude_deg}",
        f"simulation.longitude_deg={longitude_deg}",
        *more,
    )
    words = [str(VEHICLE), *(word for value in values for word in ("--set", value))]
    delfim = *ENDS_WITH_US, sys.executable, "-m", "delfim"
    programs = [subprocess.Popen([*delfim, name, *words], env=env) for name in ("nodes", "supervise")]
    try:
        yield Boat(place, number)
    finally:
        for program in reversed(programs):
            program.send_signal(signal.SIGTERM)
            program.wait(200)


class Radio:
    """The link between the gateway and a boat: UDP both ways, until it is cut. What comes meanwhile is held back."""

    def __init__(self, console: tuple[str, int]) -> None:
        self.said: list[bytes] = []  # datagrams of the gateway
        self.unanswered = False  # the gateway's last command, by the boat
        self.through = True
        self._console, self._boat = console, ("", 0)
        self._held: list[bytes] = []

    async def open(self) -> int:
        """The port that the boat speaks to."""
        self._boats_end, self._consoles_end = await _socket(self._from_boat), await _socket(self._from_console)
        return int(self._boats_end.get_extra_info("sockname")[1])

    def close(self) -> None:
        self._boats_end.close()
        self._consoles_end.close()

    def cut(self) -> None:
        self.through = False

    def say(self, frame: bytes) -> None:
        """In the gateway's place."""
        self._boats_end.sendto(frame, self._boat)

    def mend(self) -> None:
        """First of all comes what was on its way, late as it is."""
        self.through = True
        for data in self._held:
            self._boats_end.sendto(data, self._boat)
        self._held.clear()

    def spoken(self, since: int) -> list[Any]:
        """The messages of the gateway from that datagram on."""
        return [message for data in self.said[since:] for message in _messages(data)]

    def obeyed(self, since: int) -> bool:
        """Whether it commanded something from that datagram on, and was answered."""
        return not self.unanswered and any(_has(data, "COMMAND_LONG") for data in self.said[since:])

    def _from_boat(self, data: bytes, address: tuple[str, int]) -> None:
        self._boat = address
        if _has(data, "COMMAND_ACK"):
            self.unanswered = False
        if self.through:
            self._consoles_end.sendto(data, self._console)

    def _from_console(self, data: bytes, _: tuple[str, int]) -> None:
        self.said.append(data)
        if _has(data, "COMMAND_LONG"):
            self.unanswered = True
        if self.through:
            self._boats_end.sendto(data, self._boat)
        else:
            self._held.append(data)


def ordered(boat: int, command: int, *numbers: float) -> Any:
    """A COMMAND_LONG."""
    return wire.dialect.MAVLink_command_long_message(boat, 1, command, 0, *numbers, *(0.0,) * (7 - len(numbers)))


def _messages(datagram: bytes) -> list[Any]:
    return [wire.decode(frame) for frame in wire.frames(datagram)[0]]


def _has(datagram: bytes, kind: str) -> bool:
    return any(message.get_type() == kind for message in _messages(datagram))


class _End(asyncio.DatagramProtocol):
    def __init__(self, heard: Callable[[bytes, tuple[str, int]], None]) -> None:
        self._heard = heard

    def datagram_received(self, data: bytes, address: Any) -> None:
        self._heard(data, address)


async def _socket(heard: Callable[[bytes, tuple[str, int]], None]) -> asyncio.DatagramTransport:
    loop = asyncio.get_running_loop()
    return (await loop.create_datagram_endpoint(lambda: _End(heard), local_addr=("127.0.0.1", 0)))[0]


class Gateway:
    """`delfim console`, which finds its boats and its page again on the same ports when it is started anew."""

    def __init__(self, folder: Path, *more: str) -> None:
        self.boats, self._more = ("127.0.0.1", _unused(socket.SOCK_DGRAM)), more
        self._page = _unused(socket.SOCK_STREAM)
        self._folder = folder
        self._program: subprocess.Popen[str] | None = None

    def start(self) -> str:
        """Where the page is, once it is there. Blocks meanwhile."""
        words = [f"--boats=127.0.0.1:{self.boats[1]}", f"--page=127.0.0.1:{self._page}", "--no-browser", f"--vehicle={VEHICLE}"]
        words += [f"--{each}={self._folder}/{each}" for each in ("missions", "charts", "sessions", "token")]
        command = [*ENDS_WITH_US, sys.executable, "-u", "-m", "delfim", "console", *words, *self._more]
        self._program = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        line = cast(Any, self._program.stdout).readline()
        assert "the console is at " in line
        return str(line.split("the console is at ")[1].split(";")[0])

    def end(self, how: signal.Signals) -> None:
        assert self._program is not None
        self._program.send_signal(how)
        self._program.wait(200)
        cast(Any, self._program.stdout).close()


def _unused(kind: socket.SocketKind) -> int:
    """A port that nobody has, below those that the kernel gives away."""
    for port in range(11_000 + os.getpid() % 10_000, 32_000):
        with socket.socket(socket.AF_INET, kind) as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port
    raise AssertionError("there is no port")


class Sea:
    """Two boats, and an operator at the page."""

    def __init__(self, folder: Path, gateway: Gateway, url: str, boats: list[Boat], radios: list[Radio]) -> None:
        self.folder, self.gateway, self.url, self.boats, self.radios = folder, gateway, url, boats, radios
        self._tabs = contextlib.AsyncExitStack()
        self.page: Page

    async def browse(self) -> None:
        """A tab of its own, with the page open."""
        self.page = await self._tabs.enter_async_context(tab())
        await self.page.call("Network.enable")
        await self.load()

    async def load(self) -> None:
        """The page, anew."""
        await self.page.open(self.url, width=1280, height=800, scale=1.0)
        await self.page.call("Page.bringToFront")  # an operator who has not clicked yet has the focus elsewhere
        await self.found()

    async def found(self) -> None:
        await self.page.until(f"document.querySelectorAll('.chip').length === {len(self.boats)}", PATIENCE_S)
        for number, boat in enumerate(self.boats, 1):
            await boat.until(lambda state: state["age_s"]["navigation"] is not None and state["age_s"]["navigation"] < 1)
            trouble = f"document.querySelector('[data-boat=\"{number}\"] .trouble:not(.weak):not([hidden])')?.textContent ?? ''"
            said = (
                f"({trouble}).replace(/^stopped: no manual command.*/, '')"  # a stop that was forced stands until somebody acts
            )
            await self.page.until(f"{said} === ''", PATIENCE_S)  # a link that was cut is weak for a while

    async def close(self) -> None:
        await self._tabs.aclose()

    async def at_rest(self, number: int) -> tuple[Page, Boat]:
        """All boats were stopped and have said so, this one is selected; the page, and the boat."""
        page, boat = self.page, self.boats[number - 1]
        await page.press("Escape")
        await page.press("k")
        before = [len(radio.said) for radio in self.radios]
        await page.press(" ", ("Shift",))
        for each, radio, since in zip(self.boats, self.radios, before, strict=True):
            async with asyncio.timeout(PATIENCE_S):
                while not radio.obeyed(since):
                    await asyncio.sleep(0.02)
            await each.until(lambda state: state["mode"] == "idle" and turning(0, 0)(state))
            await page.until(f"document.querySelector('[data-boat=\"{each.number}\"] .mode').dataset.state === 'idle'")
        await select(page, number)
        return page, boat

    async def nothing_amiss(self) -> None:
        """Nothing was missing on the page, and it asked nobody but the gateway."""
        await self.page.nothing_amiss()
        url = self.url.partition("?")[0]
        own = "data:", "about:", url, url.replace("http", "ws")
        assert [each for each in self.page.requests if not each.startswith(own)] == []


async def select(page: Page, number: int) -> None:
    while await page.value("document.querySelector('.selected').dataset.boat") != str(number):
        await page.press("Tab")
    await page.until(f"document.querySelector('.selected').dataset.boat === '{number}'")


async def shown_mode(page: Page, number: int, words: str) -> None:
    await page.until(f"document.querySelector('[data-boat=\"{number}\"] .mode').textContent === '{words}'", PATIENCE_S)


@contextlib.asynccontextmanager
async def operating(
    folder: Path, *more: str, count: int = 2, env: dict[str, str] | None = None, console: tuple[str, ...] = ()
) -> AsyncIterator[Sea]:
    """`count` boats; `more` settings of the boats; `env` of their programs, where they are not ours; `console`: its options."""
    gateway = Gateway(folder, *console)
    radios = [Radio(gateway.boats) for _ in range(count)]
    ports = [await radio.open() for radio in radios]
    try:
        url = await asyncio.to_thread(gateway.start)
        with contextlib.ExitStack() as programs:
            boats = [programs.enter_context(afloat(folder / str(n), n, port, more, env)) for n, port in enumerate(ports, 1)]
            sea = Sea(folder, gateway, url, boats, radios)
            try:
                await sea.browse()
                yield sea
            finally:
                await sea.close()
    finally:
        gateway.end(signal.SIGTERM)
        for radio in radios:
            radio.close()


@contextlib.asynccontextmanager
async def watched(sea: Sea) -> AsyncIterator[Sea]:
    """For a story, after which nothing may be amiss."""
    yield sea
    await sea.nothing_amiss()


@contextlib.contextmanager
def afternoon(
    folder: Path, *more: str, count: int = 2, env: dict[str, str] | None = None
) -> Iterator[tuple[asyncio.Runner, Sea]]:
    """`operating` for all tests of a file: what runs them, and the sea."""
    with asyncio.Runner() as runner:
        chain = operating(folder, *more, count=count, env=env)
        sea = runner.run(chain.__aenter__())
        try:
            yield runner, sea
        finally:
            runner.run(chain.__aexit__(None, None, None))
