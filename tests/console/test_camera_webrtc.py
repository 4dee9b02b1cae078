"""A boat's camera by WebRTC on the real page: the film of a simulated boat, through its program, a relay and a real browser;
and that stills go on as soon as it is in doubt.
"""

import asyncio
import contextlib
import json
import os
import random
import signal
import socket
import subprocess
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from PIL import Image

from bench.camera import Way, at_sea
from delfim.console.gateway import page_messages
from delfim.parts.camera.played import BITS
from tests.console.filming import FILM, IS_FILM
from tests.console.standin import Standin
from tests.console.test_camera_page import AGE, IS_OLD, PATIENCE_S, SAID, camera_of, looking, opened, shot
from tests.kit.page import gateway, page, shown
from tests.parts.camera.film import aiortc
from tests.parts.camera.test_pictures import clock_in
from tests.services.browser import Page, tab

__all__ = ["aiortc", "gateway", "page"]
STILLS = "document.querySelector('#picture video').hidden && !document.querySelector('#picture img').hidden"
WAY_S = 0.15  # there, and as long back: a film that were told to be young would be found out
LAG_MS = 60  # the page tells the age ten times a second, in tenths, and takes all of the way there for age
PEERS = """
window.peers = [];
RTCPeerConnection = class extends RTCPeerConnection { constructor() { super(); peers.push(this); } };
"""
KEEP = "[...document.querySelectorAll('#picture button')].find(each => each.textContent === 'Keep').click()"
ANSWER = {"t": "live", "boat": 1, "host": "127.0.0.1", "port": 9, "ssrc": 1, "certificate": "00" * 32}
LOGIN = {"user": "abcd", "password": "p" * 24}


@pytest.fixture
def network() -> None:
    """A browser offers nothing where there is no network but the machine itself, as in a worker's room."""
    if any(name != "lo" for _, name in socket.if_nameindex()):
        return
    for words in ("link add name delfim0 type bridge", "addr add 10.9.9.9/24 dev delfim0", "link set delfim0 up"):
        if subprocess.run(["ip", *words.split()], capture_output=True, check=False).returncode:
            pytest.skip("a network beside the loopback needs root, and the kernel's bridge")


@contextlib.asynccontextmanager
async def filmed(folder: Path, film: Way | None = None) -> AsyncIterator[Page]:
    """The page with the film of a simulated boat's camera, which may come by a way of its own."""
    ways = [Way(random.Random(1), 0.0, 0.002) for _ in range(2)]
    async with at_sea(folder, *ways, "webrtc = true\n", film) as url, tab() as its:
        await opened(its, url)
        await its.until(IS_FILM, PATIENCE_S)
        await its.value(FILM)
        await its.until("film.length > 20", PATIENCE_S)
        yield its


@pytest.mark.long
def test_the_film_comes_and_a_camera_that_hangs_is_not_taken_for_a_live_one(
    tmp_path: Path, aiortc: None, network: None
) -> None:
    """And no picture is told to be younger than the clock in it says; what is kept is what was seen."""

    async def scenario() -> None:
        async with filmed(tmp_path, Way(random.Random(3), 0.0, WAY_S)) as its:
            seen = json.loads(await its.value("JSON.stringify(film)"))
            clocks_ms = [clock_ms for *_, clock_ms in seen]
            assert clocks_ms == sorted(clocks_ms)
            assert len(set(clocks_ms)) > 10, "it moves"
            assert min(off_ms for off_ms, *_ in seen) >= 1000 * WAY_S
            assert all(told_ms >= off_ms - LAG_MS for off_ms, _, told_ms, _ in seen), seen
            assert {width for _, width, *_ in seen} <= {640, 320}
            await its.value(KEEP)
            await its.until(f"{AGE}.startsWith('kept as ')", PATIENCE_S)
            file = Path((await its.value(AGE)).removeprefix("kept as "))
            assert clocks_ms[-1] <= clock_in((tmp_path / file).read_bytes()) < time.time() * 1000 % (1 << BITS)
            with Image.open(tmp_path / file) as image:
                assert image.width == seen[-1][1]
                assert image.getexif().get_ifd(0x8825)[1] == "N"

            camera = camera_of(tmp_path)
            os.kill(camera, signal.SIGSTOP)
            await its.until(f"{STILLS} && {IS_OLD} && {SAID}.startsWith('picture is ')", PATIENCE_S)
            await its.value("glass.splice(0)")
            await its.until(f"glass.length > 0 && !{IS_OLD}", PATIENCE_S)
            await its.nothing_amiss()

    asyncio.run(scenario())


@pytest.mark.long
def test_where_the_boat_is_not_reached_any_more_stills_go_on(tmp_path: Path, aiortc: None, network: None) -> None:
    async def scenario() -> None:
        way = Way(random.Random(2), 0.0, 0.002)
        async with filmed(tmp_path, way) as its:
            way.loss = 1.0
            await its.until(STILLS, PATIENCE_S)
            await its.value("glass.splice(0)")
            await its.until(f"glass.length > 5 && !{IS_OLD}", PATIENCE_S)
            await its.nothing_amiss()

    asyncio.run(scenario())


@pytest.mark.long
def test_where_the_boat_is_never_reached_stills_go_on_as_before(tmp_path: Path, aiortc: None, network: None) -> None:
    async def scenario() -> None:
        ways = [Way(random.Random(1), 0.0, 0.002) for _ in range(3)]
        ways[2].loss = 1.0
        async with at_sea(tmp_path, ways[0], ways[1], "webrtc = true\n", ways[2]) as url, tab() as its:
            await opened(its, url)
            await its.value(PEERS)
            await its.until("peers.length > 0 && peers[0].connectionState === 'closed'", PATIENCE_S)
            assert await its.value(STILLS)
            await its.value("glass.splice(0)")
            await its.until(f"glass.length > 5 && !{IS_OLD}", PATIENCE_S)
            await its.nothing_amiss()

    asyncio.run(scenario())


def test_a_page_offers_only_what_a_connection_needs_and_goes_on_with_stills(
    gateway: Standin, page: contextlib.AbstractAsyncContextManager[Page]
) -> None:
    """It asks for a film when it is told that this is wise, and not again soon when there is none."""

    async def scenario() -> None:
        async with looking(gateway, page) as its:
            await gateway.tell(shot(live=True))
            asked = await gateway.until(lambda message: message["t"] == "see" and "live" in message)
            offer = asked["live"]
            assert page_messages.SeeLive(**offer).shown is False
            assert len(offer["certificate"]) == 64
            await gateway.tell(ANSWER | LOGIN | {"of": "another", "why": ""})
            await gateway.tell(ANSWER | LOGIN | {"of": offer["user"], "why": "2 look at it already"})
            gateway.forget()
            await gateway.tell(shot(live=True))
            await shown(its, gateway, f"{STILLS} && {AGE}.includes(', 20')")
            assert "live" not in await gateway.until(lambda message: message["t"] == "see")

    asyncio.run(scenario())
