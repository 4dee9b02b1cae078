"""Cameras on thin links: `python -m bench.camera`; three minutes.

A simulated boat and a console, and between them a relay with the rate of a link, a queue of a second, and 5 % losses both ways.
Printed is, for each rate, what the pictures took, how many came, how long and how old they were, and the round trip of an order
while they came: from the page's message to the boat's answer.
"""

import asyncio
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager, suppress
from pathlib import Path
from statistics import median, quantiles
from typing import Any, Final, cast

import aiohttp

from delfim.parts.camera.table import LIVE_PORTS, PORTS, STREAMS

ROOT: Final = Path(__file__).parents[1]
NUMBER: Final = 77  # of the boat
RATES_KBPS: Final = (4000, 1000, 300, 64, 20)
LOSS, DELAY_S = 0.05, 0.005  # of a radio
SETTLE_S, MEASURE_S = 12.0, 20.0
ORDER_S: Final = 0.5


class Way:
    """One direction: its rate, its losses, a second of queue."""

    def __init__(self, chance: random.Random, loss: float = LOSS, delay_s: float = DELAY_S) -> None:
        self.rate_bps, self._free_s, self._chance, self.loss, self._delay_s = 1e8, 0.0, chance, loss, delay_s

    def carry(self, data: bytes, send: Callable[[bytes], object]) -> None:
        loop = asyncio.get_running_loop()
        free_s = max(self._free_s, loop.time()) + 8.0 * (len(data) + 28) / self.rate_bps
        if free_s - loop.time() < 1.0:
            self._free_s = free_s
            if self._chance.random() >= self.loss:
                loop.call_at(free_s + self._delay_s, send, data)


class Relay(asyncio.DatagramProtocol):
    """Takes datagrams at one address. Whoever sent the last one gets the answers."""

    def __init__(self, way: Way) -> None:
        self._way, self.to, self.other = way, ("", 0), self

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, address: tuple[str, int]) -> None:
        self.to = address
        self._way.carry(data, self.other.send)

    def send(self, data: bytes) -> None:
        if not self.transport.is_closing():
            self.transport.sendto(data, self.to)


@asynccontextmanager
async def relay(
    down: Way, up: Way, from_boat: tuple[str, int], from_shore: tuple[str, int], boat: int, shore: int
) -> AsyncIterator[None]:
    """Between the boat, which speaks to one address, and the shore, which speaks to another one."""
    loop = asyncio.get_running_loop()
    _, one = await loop.create_datagram_endpoint(lambda: Relay(down), local_addr=from_boat)
    _, other = await loop.create_datagram_endpoint(lambda: Relay(up), local_addr=from_shore)
    one.other, other.other = other, one
    one.to, other.to = ("127.0.0.1", boat), ("127.0.0.1", shore)
    try:
        yield
    finally:
        one.transport.close()
        other.transport.close()


@contextmanager
def running(folder: Path, *words: str) -> Iterator[subprocess.Popen[str]]:
    command = (sys.executable, "-m", "delfim", *words)
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=folder) as child:
        try:
            yield child
        finally:
            child.send_signal(signal.SIGINT)
            child.communicate(timeout=60)


async def measured(
    link: aiohttp.ClientWebSocketResponse, number: int, for_s: float
) -> tuple[list[dict[str, Any]], list[float]]:
    """The pictures of so long, and the round trips of orders, in ms."""
    pictures, trips, asked = list[dict[str, Any]](), list[float](), dict[int, float]()
    end_s = time.monotonic() + for_s
    look_s = order_s = 0.0
    while (now_s := time.monotonic()) < end_s:
        if now_s >= look_s:
            look_s = now_s + 1.0
            await link.send_json({"t": "see", "boat": number})
        if now_s >= order_s:
            order_s = now_s + ORDER_S
            asked[len(asked) + 1] = now_s
            await link.send_json({"t": "command", "boat": number, "command": "mode", "mode": "hold", "seq": len(asked)})
        with suppress(TimeoutError):
            async with asyncio.timeout(0.02):
                told = await link.receive_json()
                if told["t"] == "picture" and "jpeg" in told:
                    pictures.append(told)
                elif told["t"] == "answer" and told.get("stage") != "sent" and told["seq"] in asked:
                    trips.append(1e3 * (time.monotonic() - asked[told["seq"]]))
    return pictures, trips


async def tables(url: str, down: Way, up: Way) -> None:
    print("link kbit/s | pictures kbit/s |  a second | bytes | age when it came, ms (median, 95 %) | order, ms (median, 90 %)")
    async with aiohttp.ClientSession() as session, session.ws_connect(url) as link:
        number = 0
        while not number:
            told = await link.receive_json()
            number = next((boat["id"] for boat in told.get("boats", ())), 0)
        for kbps in RATES_KBPS:
            down.rate_bps = up.rate_bps = 1000.0 * kbps
            profile = "lean" if kbps < 200 else "wifi"
            await link.send_json({"t": "profile", "boat": number, "profile": profile})
            await measured(link, number, SETTLE_S)
            pictures, trips = await measured(link, number, MEASURE_S)
            ages = [1e3 * each["age_s"] for each in pictures]
            if not pictures or not trips:
                print(f"{kbps:11} | {len(pictures)} pictures, {len(trips)} orders", flush=True)
                continue
            size = median(len(each["jpeg"]) * 3 / 4 for each in pictures)
            rate = median(each["kbps"] for each in pictures)
            line = f"{kbps:11} | {rate:15.0f} | {len(pictures) / MEASURE_S:9.1f} | {size:5.0f} "
            line += f"| {median(ages):6.0f} {quantiles(ages, n=20)[-1]:6.0f} "
            print(f"{line}| {median(trips):6.0f} {quantiles(trips, n=10)[-1]:6.0f}   ({len(trips)} orders)", flush=True)


@asynccontextmanager
async def at_sea(folder: Path, down: Way, up: Way, more: str = "", film: Way | None = None) -> AsyncIterator[str]:
    """A simulated boat and a console beyond a relay; gives the address of the page. `more` keys has its camera, whose film by
    WebRTC comes by another way, if that is given."""
    (folder / "boat.toml").write_text((ROOT / "etc/lake.toml").read_text() + '\n[camera.bow]\nsource = "test"\n' + more)
    first = LIVE_PORTS + STREAMS * NUMBER
    ways = [(PORTS + NUMBER, down, up), *((first + at, film or down, film or up) for at in range(STREAMS))]
    sets = ('mavlink.listen="127.0.0.1:24555"', 'mavlink.peers=["127.0.0.3:24550"]', f"boat.id={NUMBER}")
    words = ("--boats", "127.0.0.1:24551", "--page", "127.0.0.1:0", *(word for each in sets for word in ("--set", each)))
    async with AsyncExitStack() as relays:
        await relays.enter_async_context(relay(down, up, ("127.0.0.3", 24550), ("127.0.0.2", 24555), 24555, 24551))
        for port, its_down, its_up in ways:
            await relays.enter_async_context(relay(its_down, its_up, ("127.0.0.3", 0), ("127.0.0.2", port), port, 0))
        child = relays.enter_context(running(folder, "sim", "boat.toml", "--console", "--no-browser", "--plain", *words))
        assert child.stdout is not None
        yield next(line for line in child.stdout if "the console is at" in line).split("is at ")[1].split(";")[0]


async def sailed(folder: Path) -> None:
    chance = random.Random(1)
    down, up = Way(chance), Way(chance)
    async with at_sea(folder, down, up) as url:
        await tables(url.replace("/?", "/ws?"), down, up)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        asyncio.run(sailed(Path(name)))
