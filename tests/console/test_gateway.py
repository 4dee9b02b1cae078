"""The gateway from outside: real UDP, a real WebSocket client, boats on loopback."""

import asyncio
import contextlib
import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import aiohttp
import pytest
from PIL import Image

from delfim.clock import Clock, ManualClock, SystemClock, WakefulClock
from delfim.console import browser
from delfim.console.gateway import Gateway, serve
from delfim.console.replay import open_tapes
from delfim.errors import ConfigError
from tests.console.fakeboat import FakeBoat

VEHICLE = Path(__file__).parents[2] / "etc" / "delfimx.toml"

ROOT = Path(__file__).parents[2]


class Opened:
    """A console, two boats and one page."""

    def __init__(self, gateway: Gateway, url: str, session: aiohttp.ClientSession, boats: list[FakeBoat]) -> None:
        self.gateway, self.url, self.session, self.boats = gateway, url, session, boats
        self.heard: list[dict[str, Any]] = []

    async def until(self, page: aiohttp.ClientWebSocketResponse, is_so: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
        """The next message of which something is so."""
        async with asyncio.timeout(20):
            while True:
                message = await page.receive_json()
                self.heard.append(message)
                if is_so(message):
                    return message  # type: ignore[no-any-return]


@contextlib.asynccontextmanager
async def opened(tmp_path: Path, clock: Clock | None = None, **more: Any) -> AsyncIterator[Opened]:
    gateway = Gateway(clock or SystemClock(), tmp_path / "missions", vehicle=VEHICLE, **more)
    ready = asyncio.get_running_loop().create_future()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    async with asyncio.TaskGroup() as group, aiohttp.ClientSession() as session:
        console = group.create_task(serve(gateway, ("127.0.0.1", port), ("127.0.0.1", 0), ready.set_result))
        url = await ready
        links, boats = [], []
        loop = asyncio.get_running_loop()
        for number in (1, 2):
            link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            link.setblocking(False)
            link.connect(("127.0.0.1", port))
            boat = FakeBoat(number, SystemClock(), link.send)  # type: ignore[arg-type]
            loop.add_reader(link, lambda boat=boat, link=link: boat.hear(link.recv(2048)))
            links.append(link)
            boats.append(boat)
            boat.tick()
        try:
            yield Opened(gateway, url, session, boats)
        finally:
            for link in links:
                loop.remove_reader(link)
                link.close()
            console.cancel()


def boat_in(message: dict[str, Any], number: int) -> dict[str, Any]:
    return next((boat for boat in message.get("boats", []) if boat["id"] == number), {})


def test_a_page_sees_both_boats_and_commands_one(tmp_path: Path) -> None:
    async def main() -> None:
        async with opened(tmp_path) as sea, sea.session.ws_connect(sea.url + "ws") as page:
            assert (await page.receive_json())["t"] == "hello"
            await sea.until(page, lambda m: boat_in(m, 1) and boat_in(m, 2))
            begun_s = asyncio.get_running_loop().time()
            await page.send_json({"t": "command", "seq": 7, "boat": 2, "command": "hold"})
            answer = await sea.until(page, lambda m: m["t"] == "answer")
            took_s = asyncio.get_running_loop().time() - begun_s
            assert answer == {"t": "answer", "seq": 7, "ok": True, "reason": ""}
            assert (sea.boats[0].mode, sea.boats[1].mode) == (4, 5)
            assert took_s < 1.0  # 2 ms on a quiet machine
            await page.send_json({"t": "command", "seq": 8, "boat": "all", "command": "stop"})
            await sea.until(page, lambda m: m["t"] == "answer" and m["seq"] == 8)
            await page.send_json({"t": "command", "seq": 9, "boat": "all", "command": "play"})
            assert (await sea.until(page, lambda m: m["t"] == "answer" and m["seq"] == 9))["ok"] is False

    asyncio.run(main())


def test_a_closed_page_releases_what_it_steered(tmp_path: Path) -> None:
    async def main() -> None:
        async with opened(tmp_path) as sea:
            async with sea.session.ws_connect(sea.url + "ws") as page:
                await sea.until(page, lambda m: boat_in(m, 1))
                for n in range(3):
                    await page.send_json({"t": "input", "boat": 1, "n": n, "port_pct": 30, "starboard_pct": 30})
                async with asyncio.timeout(20):
                    while len(sea.boats[0].thrust) < 3:
                        await asyncio.sleep(0.01)
            async with asyncio.timeout(20):
                while sea.boats[0].thrust[-1] != (0, 0):
                    await asyncio.sleep(0.01)
            assert sea.boats[0].thrust == [(300, 0)] * 3 + [(0, 0)]
            assert sea.boats[1].thrust == []

    asyncio.run(main())


@pytest.mark.parametrize(
    "nonsense", ["{", "[]", '"x"', '{"t": "dance", "seq": 1}', '{"t": "command", "seq": 1}', '{"t": "input"}', "[" * 10_000]
)
def test_nonsense_of_a_page_is_answered_or_passed_over(tmp_path: Path, nonsense: str) -> None:
    async def main() -> None:
        async with opened(tmp_path) as sea, sea.session.ws_connect(sea.url + "ws") as page:
            await page.send_str(nonsense)
            await page.send_json({"t": "mission", "seq": 2, "boat": 1, "do": "list"})
            answer = await sea.until(page, lambda m: m["t"] == "answer" and m["seq"] == 2)
            assert answer["ok"]
            assert [m["names"] for m in sea.heard if m["t"] == "missions"] == [[]]

    asyncio.run(main())


def test_missions_are_saved_loaded_uploaded_and_compared(tmp_path: Path) -> None:
    plan = {
        "name": "two points",
        "waypoints": [{"latitude_deg": 38.69, "longitude_deg": -9.21}, {"latitude_deg": 38.691, "longitude_deg": -9.21}],
        "fence": [],
        "obstacles": [],
        "home": None,
    }

    async def main() -> None:
        async with opened(tmp_path) as sea, sea.session.ws_connect(sea.url + "ws") as page:
            await sea.until(page, lambda m: boat_in(m, 1))

            async def do(seq: int, what: str, **more: Any) -> dict[str, Any]:
                await page.send_json({"t": "mission", "seq": seq, "boat": 1, "do": what, **more})
                return await sea.until(page, lambda m: m["t"] == "answer" and m["seq"] == seq)

            assert (await do(1, "save", mission=plan))["ok"]
            assert (await do(2, "load", name="two points"))["ok"]
            assert (await do(3, "upload"))["ok"]
            shown = await sea.until(page, lambda m: boat_in(m, 1))
            assert boat_in(shown, 1)["mission"]["state"] == "same"
            assert "no name" in (await do(4, "load", name="../../etc/passwd"))["reason"]
            assert not (await do(5, "save", mission=plan | {"waypoints": []}))["ok"]
            assert not (await do(6, "put", mission={"waypoints": 3}))["ok"]

    asyncio.run(main())
    assert "38.691" in (tmp_path / "missions" / "two points.toml").read_text()


def test_a_dry_run_says_how_long_and_how_far(tmp_path: Path) -> None:
    corners = [(38.6901, -9.2152), (38.6905, -9.2152), (38.6905, -9.2148)]
    plan = {"name": "dry", "waypoints": [{"latitude_deg": a, "longitude_deg": b} for a, b in corners]}

    async def main() -> None:
        async with opened(tmp_path) as sea, sea.session.ws_connect(sea.url + "ws") as page:
            await page.send_json({"t": "mission", "seq": 3, "boat": 1, "do": "dryrun", "mission": plan})
            answer = await sea.until(page, lambda m: m["t"] == "dryrun")
            assert (answer["end"], answer["well"], answer["boat"]) == ("mission done", True, 1)
            assert 60.0 < answer["distance_m"] < 200.0
            assert 30.0 < answer["time_s"] < 300.0
            assert len(answer["track"]) > 20
            await page.send_json(
                {"t": "mission", "seq": 4, "boat": 1, "do": "dryrun", "mission": {"name": "none", "waypoints": []}}
            )
            answer = await sea.until(page, lambda m: m["t"] == "answer" and m["seq"] == 4)
            assert not answer["ok"]
            assert answer["reason"]

    asyncio.run(main())


def test_another_sites_page_is_not_let_in(tmp_path: Path) -> None:
    async def main() -> None:
        async with opened(tmp_path) as sea:
            with pytest.raises(aiohttp.WSServerHandshakeError):
                await sea.session.ws_connect(sea.url + "ws", headers={"Origin": "http://elsewhere.example"})

    asyncio.run(main())


def test_a_port_that_is_taken_has_a_reason(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        address = taken.getsockname()
        with pytest.raises(ConfigError, match="Address already in use"):
            asyncio.run(serve(Gateway(SystemClock(), tmp_path), address, ("127.0.0.1", 0), lambda url: None))


def test_a_page_learns_of_charts_and_of_those_that_are_wrong(tmp_path: Path) -> None:
    Image.new("RGB", (20, 10)).save(tmp_path / "harbour.png")
    (tmp_path / "harbour.pgw").write_text("0.001 0 0 -0.001 -9.2195 38.6995")
    Image.new("RGB", (20, 10)).save(tmp_path / "lost.png")

    async def main() -> None:
        async with opened(tmp_path, charts=tmp_path) as sea, sea.session.ws_connect(sea.url + "ws") as page:
            (chart,) = (await page.receive_json())["backgrounds"]
            assert (chart["name"], chart["kind"]) == ("harbour", "image")
            assert chart["extent"] == pytest.approx([-9.22, 38.69, -9.20, 38.70])
            text = await sea.until(page, lambda m: m["t"] == "text")
            assert "lost.png" in text["text"]
            async with sea.session.get(sea.url + "background/harbour") as answer:
                assert await answer.read() == (tmp_path / "harbour.png").read_bytes()

    asyncio.run(main())


def test_a_session_is_recorded_and_replayed_to_a_page(tmp_path: Path) -> None:
    async def record() -> None:
        async with opened(tmp_path, sessions=tmp_path / "sessions") as sea, sea.session.ws_connect(sea.url + "ws") as page:
            await sea.until(page, lambda m: boat_in(m, 1) and boat_in(m, 2))
            await page.send_json({"t": "replay", "seq": 1, "rate": 2})
            answer = await sea.until(page, lambda m: m["t"] == "answer")
            assert (answer["ok"], answer["reason"]) == (False, "nothing is being replayed")

    async def replay() -> None:
        tapes = open_tapes([tmp_path / "sessions"])
        async with opened(tmp_path, tapes=tapes) as sea, sea.session.ws_connect(sea.url + "ws") as page:
            hello = await page.receive_json()
            assert hello["replay"]["from_s"] <= hello["replay"]["to_s"]
            await page.send_json({"t": "replay", "seq": 1, "at_s": hello["replay"]["to_s"], "rate": 0})
            assert (await sea.until(page, lambda m: m["t"] == "answer"))["ok"]
            shown = await sea.until(page, lambda m: m["t"] == "boats" and boat_in(m, 1))
            assert boat_in(shown, 1)["mode"] == "idle"
            assert shown["at_s"] == pytest.approx(hello["replay"]["to_s"], abs=0.01)
            await page.send_json({"t": "command", "seq": 2, "boat": 1, "command": "play"})
            assert "replay" in (await sea.until(page, lambda m: m["t"] == "answer"))["reason"]

    asyncio.run(record())
    asyncio.run(replay())


def test_a_radio_that_is_not_there_is_told_to_the_page(tmp_path: Path) -> None:
    async def main() -> None:
        async with opened(tmp_path, radios=[f"{tmp_path}/none:9600"]) as sea, sea.session.ws_connect(sea.url + "ws") as page:
            text = await sea.until(page, lambda m: m["t"] == "text" and "No such file" in m["text"])
            assert text["boat"] is None

    asyncio.run(main())


def test_a_gateway_that_is_killed_says_nothing_more(tmp_path: Path) -> None:
    """The last step of the dead-man before the boat's own: no process is left that repeats thrust."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    words = ["console", "--no-browser", "--page", "127.0.0.1:0", "--boats", f"127.0.0.1:{port}"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    boat_end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    boat_end.setblocking(False)
    boat_end.connect(("127.0.0.1", port))
    program = [sys.executable, "-m", "delfim", *words]
    with boat_end, subprocess.Popen(program, cwd=tmp_path, stdout=subprocess.PIPE, env=environment) as gateway:
        try:
            assert gateway.stdout is not None
            url = re.search(rb"http://\S+?/", gateway.stdout.readline())
            assert url is not None
            asyncio.run(_steered(url[0].decode(), boat_end, gateway))
        finally:
            gateway.kill()


async def _steered(url: str, boat_end: socket.socket, gateway: "subprocess.Popen[bytes]") -> None:
    """Thrust by hand from a page, until the gateway is killed."""
    boat, loop = FakeBoat(1, SystemClock(), boat_end.send), asyncio.get_running_loop()  # type: ignore[arg-type]

    def readable() -> None:
        with contextlib.suppress(OSError):
            boat.hear(boat_end.recv(2048))

    loop.add_reader(boat_end, readable)
    async with aiohttp.ClientSession() as session, session.ws_connect(url + "ws") as page, asyncio.timeout(60):
        while not boat.heartbeats:
            with contextlib.suppress(OSError):
                boat.tick()
            await asyncio.sleep(0.05)
        for n in range(3):
            await page.send_json({"t": "input", "boat": 1, "n": n, "port_pct": 30, "starboard_pct": 30})
        while not boat.thrust:
            await asyncio.sleep(0.01)
        gateway.kill()
        await asyncio.to_thread(gateway.wait)
        await asyncio.sleep(0.1)  # what was under way on loopback
        said = len(boat.thrust)
        await asyncio.sleep(1.0)
        assert len(boat.thrust) == said
    loop.remove_reader(boat_end)


def test_a_gateway_that_slept_sends_nothing_old_when_it_wakes(tmp_path: Path) -> None:
    """What the page said before the laptop slept, and what it goes on saying, is heard after it woke up."""
    clock = ManualClock(100.0)

    async def main() -> None:
        async with opened(tmp_path, clock) as sea, sea.session.ws_connect(sea.url + "ws") as page:
            boat = sea.boats[0]

            async def steer(count: int) -> None:
                await page.send_json({"t": "input", "boat": 1, "n": count, "port_pct": 30, "starboard_pct": 30})

            async def ask(command: str) -> dict[str, Any]:
                await page.send_json({"t": "command", "seq": 1, "boat": 1, "command": command})
                return await sea.until(page, lambda m: m["t"] == "answer")

            await sea.until(page, lambda m: boat_in(m, 1))
            await ask("manual")
            await steer(0)
            async with asyncio.timeout(20):
                while not boat.thrust:
                    await asyncio.sleep(0.01)
            clock.advance(8.0)
            for count in range(1, 6):
                await steer(count)
            assert (await ask("play"))["reason"] == "the console slept: say it again"
            await sea.until(page, lambda m: boat_in(m, 1).get("released"))
            assert (await ask("stop"))["ok"]
            assert boat.thrust == [(300, 0), (0, 0)]
            assert [command for command, *_ in boat.obeyed] == [176, 176], "manual before, and stop"
            for _ in range(3):
                clock.advance(0.5)
                now_s = clock.time_ns() / 1e9
                await sea.until(page, lambda m, now_s=now_s: m["t"] == "boats" and m["at_s"] >= round(now_s, 3))
            assert (await ask("manual"))["ok"], "the operator took it again"

    asyncio.run(main())


@pytest.mark.skipif(sys.platform != "linux", reason="CLOCK_BOOTTIME is Linux's")
def test_the_consoles_clock_counts_the_time_asleep() -> None:
    """As CLOCK_BOOTTIME does, and not CLOCK_MONOTONIC."""
    before_s = time.clock_gettime(time.CLOCK_BOOTTIME)
    now_s = WakefulClock().monotonic_s()
    assert before_s <= now_s <= time.clock_gettime(time.CLOCK_BOOTTIME)


@pytest.mark.parametrize("there", [True, False])
def test_the_page_gets_a_window_of_its_own_where_there_is_chromium(monkeypatch: pytest.MonkeyPatch, there: bool) -> None:
    started: list[Any] = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(browser.shutil, "which", lambda name: f"/bin/{name}" if there and name == "chromium" else None)
    monkeypatch.setattr(browser.subprocess, "Popen", lambda words, **more: started.append(words))
    monkeypatch.setattr(browser.webbrowser, "open", lambda url: started.append(url))
    browser.show("http://127.0.0.1:1/")
    assert started == [["/bin/chromium", "--app=http://127.0.0.1:1/"] if there else "http://127.0.0.1:1/"]


def test_without_a_screen_nothing_is_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(browser.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(browser.webbrowser, "open", lambda url: pytest.fail("opened"))
    browser.show("http://127.0.0.1:1/")


def test_a_gateway_that_is_ended_in_order_says_zero_and_keeps_the_session(tmp_path: Path) -> None:
    async def main() -> None:
        async with opened(tmp_path, sessions=tmp_path / "sessions") as sea, sea.session.ws_connect(sea.url + "ws") as page:
            await sea.until(page, lambda m: boat_in(m, 1))
            await page.send_json({"t": "input", "boat": 1, "n": 0, "port_pct": 30, "starboard_pct": 30})
            async with asyncio.timeout(20):
                while not sea.boats[0].thrust:
                    await asyncio.sleep(0.01)
            sea.gateway.fleet.release_all("the console ended")
            async with asyncio.timeout(20):
                while sea.boats[0].thrust[-1] != (0, 0):
                    await asyncio.sleep(0.01)

    asyncio.run(main())
    (tape,) = open_tapes([tmp_path / "sessions"])
    assert tape.to_s > tape.from_s
