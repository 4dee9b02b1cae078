"""The gateway from outside: real UDP, a real WebSocket client, boats on loopback."""

import asyncio
import contextlib
import itertools
import json
import math
import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any

import aiohttp
import msgspec
import pytest
from PIL import Image
from pymavlink.dialects.v20 import common as mavlink

from delfim.base.clock import Clock, ManualClock, SystemClock, WakefulClock
from delfim.base.errors import ConfigError
from delfim.base.eventloop import new_event_loop
from delfim.console.boats.boat import MEASURED_MAX, Boat
from delfim.console.gateway import browser
from delfim.console.gateway.gateway import PAGES_MAX, Gateway
from delfim.console.gateway.serving import serve
from delfim.console.pages.admission import kept_token, own_number
from delfim.console.tapes.replay import open_tapes
from delfim.console.watch.alerts import AlertList
from delfim.parts.mavlink.codec import ardupilot, wire
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
        async with asyncio.timeout(200):
            while True:
                message = await page.receive_json()
                self.heard.append(message)
                if is_so(message):
                    return message  # type: ignore[no-any-return]


def visitor() -> aiohttp.ClientSession:
    """A browser, as far as cookies go."""
    return aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True))


async def let_in(session: aiohttp.ClientSession, url: str) -> str:
    """The console's address without the token, which is a cookie from now on."""
    async with session.get(url) as answer:
        assert answer.status in (200, 404), "404 where the page was not built"
    return url.partition("?")[0]


@contextlib.asynccontextmanager
async def opened(tmp_path: Path, clock: Clock | None = None, *, key: str = "", **more: Any) -> AsyncIterator[Opened]:
    """`key`: of an operator, where there are some."""
    gateway = Gateway(clock or SystemClock(), tmp_path / "missions", vehicle=VEHICLE, **more)
    ready = asyncio.get_running_loop().create_future()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    async with asyncio.TaskGroup() as group, visitor() as session:
        console = group.create_task(serve(gateway, ("127.0.0.1", port), ("127.0.0.1", 0), ready.set_result))
        url = await let_in(session, (await ready).replace("token=KEY", f"token={key}"))
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


async def test_a_page_sees_both_boats_and_commands_one(tmp_path: Path) -> None:
    async with opened(tmp_path) as sea, sea.session.ws_connect(sea.url + "ws") as page:
        assert (await page.receive_json())["t"] == "hello"
        await sea.until(page, lambda m: boat_in(m, 1) and boat_in(m, 2))
        await page.send_json({"t": "command", "seq": 7, "boat": 2, "command": "mode", "mode": "hold"})
        answer = await sea.until(page, lambda m: m["t"] == "answer")
        assert answer == {"t": "answer", "seq": 7, "ok": True, "reason": ""}
        assert (sea.boats[0].mode, sea.boats[1].mode) == (4, 5)
        await page.send_json({"t": "command", "seq": 8, "boat": "all", "command": "stop"})
        await sea.until(page, lambda m: m["t"] == "answer" and m["seq"] == 8)
        await page.send_json({"t": "command", "seq": 9, "boat": "all", "command": "play"})
        assert (await sea.until(page, lambda m: m["t"] == "answer" and m["seq"] == 9))["ok"] is False


async def test_a_page_knows_where_boats_are_heard_and_plans_before_one_is(tmp_path: Path) -> None:
    async with opened(tmp_path) as sea, sea.session.ws_connect(sea.url + "ws") as page:
        assert (await page.receive_json())["heard_on"] == sea.gateway.heard_on
        assert re.fullmatch(r"127\.0\.0\.1:\d+", sea.gateway.heard_on[0])
        at = {"latitude_deg": 38.69, "longitude_deg": -9.21, "speed_mps": 0, "acceptance_m": 0, "hold_s": 0}
        mission = {"name": "early", "waypoints": [at], "fence": [], "obstacles": [], "home": None}
        await page.send_json({"t": "mission", "seq": 1, "boat": 0, "do": "save", "mission": mission})
        assert (await sea.until(page, lambda m: m["t"] == "answer"))["ok"]
        await page.send_json({"t": "mission", "seq": 2, "boat": 0, "do": "load", "name": "early"})
        loaded = await sea.until(page, lambda m: m["t"] == "mission" and m["boat"] == 0)
        assert loaded["mission"]["waypoints"][0]["latitude_deg"] == 38.69
        assert (await sea.until(page, lambda m: m["t"] == "answer" and m["seq"] == 2))["ok"]


async def test_a_closed_page_releases_what_it_steered(tmp_path: Path) -> None:
    async with opened(tmp_path) as sea:
        async with sea.session.ws_connect(sea.url + "ws") as page:
            await sea.until(page, lambda m: boat_in(m, 1))
            for n in range(3):
                await page.send_json({"t": "input", "boat": 1, "n": n, "port_pct": 30, "starboard_pct": 30})
            async with asyncio.timeout(200):
                while len(sea.boats[0].thrust) < 3:
                    await asyncio.sleep(0.01)
        async with asyncio.timeout(200):
            while sea.boats[0].thrust[-1] != (0, 0):
                await asyncio.sleep(0.01)
        assert sea.boats[0].thrust == [(300, 0)] * 3 + [(0, 0)]
        assert sea.boats[1].thrust == []


@pytest.mark.parametrize(
    "nonsense", ["{", "[]", '"x"', '{"t": "dance", "seq": 1}', '{"t": "command", "seq": 1}', '{"t": "input"}', "[" * 10_000]
)
async def test_nonsense_of_a_page_is_answered_or_passed_over(tmp_path: Path, nonsense: str) -> None:
    async with opened(tmp_path) as sea, sea.session.ws_connect(sea.url + "ws") as page:
        await page.send_str(nonsense)
        await page.send_json({"t": "mission", "seq": 2, "boat": 1, "do": "list"})
        answer = await sea.until(page, lambda m: m["t"] == "answer" and m["seq"] == 2)
        assert answer["ok"]
        assert [m["names"] for m in sea.heard if m["t"] == "missions"] == [[]]


async def test_missions_are_saved_loaded_uploaded_and_compared(tmp_path: Path) -> None:
    plan = {
        "name": "two points",
        "waypoints": [{"latitude_deg": 38.69, "longitude_deg": -9.21}, {"latitude_deg": 38.691, "longitude_deg": -9.21}],
        "fence": [],
        "obstacles": [],
        "home": None,
    }
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
    assert "38.691" in (tmp_path / "missions" / "two points.toml").read_text()


async def test_a_dry_run_says_how_long_and_how_far(tmp_path: Path) -> None:
    corners = [(38.6901, -9.2152), (38.6905, -9.2152), (38.6905, -9.2148)]
    plan = {"name": "dry", "waypoints": [{"latitude_deg": a, "longitude_deg": b} for a, b in corners]}
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


HERE, LOCAL = "127.0.0.1:{port}", "localhost:{port}"


@pytest.mark.parametrize(
    ("host", "origin", "cookie", "status"),
    [
        (HERE, None, True, 200),
        (HERE, "http://127.0.0.1:{port}", True, 200),
        (LOCAL, "http://localhost:{port}", True, 200),
        ("LOCALHOST:{port}", None, True, 200),
        ("[::1]:{port}", None, True, 200),
        (HERE, None, False, 403),
        (HERE, "http://127.0.0.1:{port}", False, 403),
        (HERE, "http://elsewhere.example", True, 403),
        (HERE, "https://127.0.0.1:{port}", True, 403),
        (HERE, "http://localhost:{port}", True, 403),
        (HERE, "http://127.0.0.1:1", True, 403),
        (HERE, "null", True, 403),
        (HERE, "", True, 403),
        ("evil.example:{port}", "http://evil.example:{port}", True, 403),
        ("evil.example:{port}", None, True, 403),
        ("127.0.0.1.evil.example:{port}", None, True, 403),
        ("127.0.0.1", None, True, 403),
        ("localhost", None, True, 403),
        ("", "null", True, 403),
        ("", None, True, 403),
    ],
)
async def test_only_pages_of_this_console_speak_with_it(tmp_path, host, origin, cookie, status):
    async with opened(tmp_path) as sea:
        port = sea.url.rstrip("/").rpartition(":")[2]
        headers = {"Host": host.format(port=port)} | ({} if origin is None else {"Origin": origin.format(port=port)})
        headers |= {"Cookie": f"delfim-{port}={sea.gateway.token}"} if cookie else {}
        async with aiohttp.ClientSession(cookie_jar=aiohttp.DummyCookieJar()) as stranger:
            for place in ("api/boats", "background/none", "console.js"):
                async with stranger.get(sea.url + place, headers=headers) as answer:
                    assert (answer.status == 403) == (status == 403), (place, answer.status, await answer.text())
            refused = pytest.raises(aiohttp.WSServerHandshakeError, match="403")
            with refused if status == 403 else contextlib.nullcontext():
                await stranger.ws_connect(sea.url + "ws", headers=headers)


async def test_a_person_with_a_wrong_token_is_told_where_the_right_one_is(tmp_path: Path) -> None:
    async with opened(tmp_path) as sea, aiohttp.ClientSession(cookie_jar=aiohttp.DummyCookieJar()) as stranger:
        async with stranger.get(f"{sea.url}?token=wrong", headers={"Accept": "text/html,*/*"}) as answer:
            assert (answer.status, answer.content_type) == (403, "text/html")
            text = await answer.text()
        assert "?token=…" in text
        assert "<style>" in text
        assert sea.gateway.token not in text
        async with stranger.get(f"{sea.url}api/boats?token=wrong") as answer:
            assert (answer.status, answer.content_type) == (403, "text/plain"), "programs get a line"


def test_the_token_is_kept_so_that_a_page_finds_its_console_again(tmp_path: Path) -> None:
    file = tmp_path / "state" / "console.token"
    token = kept_token(file)
    assert (kept_token(file), len(token), file.stat().st_mode & 0o777) == (token, 16, 0o600)
    file.write_bytes(b"\xff short")
    assert kept_token(file) not in (token, "")
    assert kept_token(tmp_path / "state" / "console.token" / "below"), "no file there: it is of this run"


def test_a_console_draws_a_number_of_its_own_and_keeps_it(tmp_path: Path) -> None:
    tokens = [kept_token(tmp_path / str(n)) for n in range(200)]
    numbers = [own_number(token) for token in tokens]
    assert numbers == [own_number(kept_token(tmp_path / str(n))) for n in range(200)]
    assert len(set(numbers)) > 20
    assert set(numbers) <= set(range(200, 255))
    for asked, number in ((None, numbers[0]), (231, 231)):
        gateway = Gateway(SystemClock(), tmp_path, token=tokens[0], number=asked)
        assert gateway.me == number
        gateway.close()


@pytest.mark.parametrize(
    "said",
    [
        "{",
        "[]",
        "17",
        '"text"',
        "null",
        "[" * 5000,
        '{"t":"input","boat":1e999,"n":1,"port_pct":0,"starboard_pct":0}',
        '{"t":"input","boat":1,"n":1,"port_pct":NaN,"starboard_pct":0}',
        '{"t":"input","boat":1,"n":1,"port_pct":1e999,"starboard_pct":0}',
        '{"t":"command","boat":1e999,"command":"stop"}',
        '{"t":"command","boat":-1,"command":"stop"}',
        '{"t":"command","boat":"1","command":"stop"}',
        '{"t":"command","boat":1}',
        '{"t":"command","boat":1,"command":"goto","latitude_deg":1e999,"longitude_deg":0}',
        '{"t":"command","boat":"all","command":"play"}',
        '{"t":"profile","boat":1,"profile":"fast"}',
        '{"t":"release","boat":1,"why":3}',
        '{"t":"replay","at_s":1}',
        '{"t":"mission","boat":1,"do":"sink"}',
        '{"t":"mission","boat":1,"do":"put"}',
        '{"t":"mission","boat":1,"do":"put","mission":[]}',
        '{"t":"mission","boat":1,"do":"put","mission":{"name":"a","waypoints":[[]]}}',
        '{"t":"mission","boat":1,"do":"put","mission":{"name":"a","waypoints":[],"fence":[[1]]}}',
        '{"t":"mission","boat":1,"do":"save","mission":{"waypoints":[]}}',
        '{"t":"mission","boat":1,"do":"put","mission":{"name":"a","waypoints":['
        + ",".join(['{"latitude_deg":1,"longitude_deg":1}'] * 1001)
        + "]}}",
        '{"t":"mission","boat":1,"do":"load","name":"../../etc/passwd"}',
        '{"t":"what"}',
        '{"t":7}',
        "{}",
    ],
)
async def test_whatever_a_page_says_wrong_is_answered_in_words(tmp_path: Path, said: str) -> None:
    """And the boat hears nothing of it; the socket goes on."""
    async with opened(tmp_path) as sea, sea.session.ws_connect(sea.url + "ws") as page:
        await sea.until(page, lambda m: boat_in(m, 1))
        await page.send_str(said.replace("{", '{"seq":5,', 1) if said.startswith('{"') else said)
        if said.startswith('{"'):
            answer = await sea.until(page, lambda m: m["t"] == "answer" and m["seq"] == 5)
            assert not answer["ok"]
            assert answer["reason"]
        await page.send_json({"t": "mission", "seq": 6, "boat": 1, "do": "list"})
        assert (await sea.until(page, lambda m: m["t"] == "answer" and m["seq"] == 6))["ok"]
        assert (sea.boats[0].obeyed, sea.boats[0].thrust) == ([], [])


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
async def test_a_number_that_is_not_finite_is_not_known(tmp_path: Path, number: float) -> None:
    """Of one boat: pages hear of it and of the others all the same."""
    async with opened(tmp_path) as sea, sea.session.ws_connect(sea.url + "ws") as page:
        boat = sea.boats[0]
        boat.say(
            mavlink.MAVLink_attitude_message(0, number, number, number, number, number, number),
            mavlink.MAVLink_raw_rpm_message(0, number),
            mavlink.MAVLink_position_target_global_int_message(0, 6, 0, 386900000, -92150000, *[number] * 9),
            mavlink.MAVLink_nav_controller_output_message(number, number, 0, 90, 7, number, number, number),
            mavlink.MAVLink_named_value_float_message(0, b"OVERRIDE", number),
            mavlink.MAVLink_named_value_float_message(0, b"aws_mps", number),
            mavlink.MAVLink_vfr_hud_message(number, number, 0, 33, number, number),
        )
        item = mavlink.MAVLink_mission_item_int_message(250, 190, 0, 6, 16, 0, 1, *[number] * 4, 386900000, -92150000, number)
        boat.aboard[0] = [item]
        await sea.until(page, lambda m: boat_in(m, 1).get("speed_pct") == 33 and boat_in(m, 2))
        await page.send_json({"t": "mission", "seq": 1, "boat": 1, "do": "download"})
        await sea.until(page, lambda m: m["t"] == "answer" and m["ok"])
        shown = boat_in(await sea.until(page, lambda m: boat_in(m, 2)), 1)
        assert (shown["roll_deg"], shown["rpm"][0], shown["reference"]["cross_track_m"]) == (None, None, None)
        assert (shown["mission"]["count"], shown["measured"]) == (1, {})
        async with sea.session.get(sea.url + "api/boats") as answer:
            assert len(json.loads(await answer.text(), parse_constant=pytest.fail)) == 2


def test_values_of_sensors_have_the_age_of_their_measurement() -> None:
    """Depth comes in a message of its own, too; a boat that invents names fills no memory."""
    boat = Boat(1, 0.0)

    def says(message: Any, now_s: float) -> dict[str, Any]:
        frame = wire.Sender(1, 1, None, lambda: 0).pack(message)
        boat.receive(wire.decode(frame), now_s, now_s)
        shown: dict[str, Any] = boat.snapshot(now_s)["measured"]
        return shown

    def named(name: bytes, value: float, stamp_ms: int) -> Any:
        return mavlink.MAVLink_named_value_float_message(stamp_ms, name, value)

    assert says(named(b"aws_mps", 5.0, 100), 1.0) == {"aws_mps": {"value": 5.0, "age_s": 0.0}}
    assert says(named(b"aws_mps", 5.0, 100), 4.0) == {"aws_mps": {"value": 5.0, "age_s": 3.0}}, "the same measurement"
    assert says(named(b"OVERRIDE", 1.0, 100), 4.0).keys() == {"aws_mps"}
    depth = ardupilot.WaterDepth(200, 0, 1, 0, 0, 0.0, 0.0, 0.0, 0.0, 4.25, math.nan)
    assert says(depth, 4.0)["depth_m"] == {"value": 4.25, "age_s": 0.0}
    for number in range(99):
        shown = says(named(b"v%d" % number, 1.0, 1), 5.0)
    assert len(shown) == MEASURED_MAX
    assert "aws_mps" not in says(named(b"aws_mps", math.nan, 300), 6.0)


async def test_stop_for_all_is_answered_when_every_boat_has_answered(tmp_path: Path) -> None:
    async with opened(tmp_path) as sea, sea.session.ws_connect(sea.url + "ws") as page:
        await sea.until(page, lambda m: boat_in(m, 1) and boat_in(m, 2))
        hear, sea.boats[1].hear = sea.boats[1].hear, lambda data: None  # type: ignore[method-assign]
        await page.send_json({"t": "command", "seq": 1, "boat": "all", "command": "stop"})
        for _ in range(5):
            await sea.until(page, lambda m: m["t"] == "boats")
        assert not [each for each in sea.heard if each["t"] == "answer"]
        assert sea.boats[0].obeyed, "the first one stopped at once"
        sea.boats[1].hear = hear  # type: ignore[method-assign]
        assert (await sea.until(page, lambda m: m["t"] == "answer"))["ok"]


async def test_two_hundred_pages_are_served_or_refused_in_words(tmp_path: Path) -> None:
    async with opened(tmp_path) as sea:
        served, refused = [], []
        for _ in range(200):
            try:
                served.append(await sea.session.ws_connect(sea.url + "ws"))
            except aiohttp.WSServerHandshakeError as error:
                refused.append(error.status)
        assert (len(served), refused) == (PAGES_MAX, [503] * (200 - PAGES_MAX))
        async with sea.session.get(sea.url + "ws") as answer:
            assert await answer.text() == "too many pages are open: close one\n"
        for page in served:
            await page.close()
        async with sea.session.ws_connect(sea.url + "ws") as page:
            assert (await page.receive_json())["t"] == "hello", "there is room again"


def test_two_hundred_sockets_that_say_nothing_or_nonsense_cost_bounded_memory_and_no_log(tmp_path: Path) -> None:
    """A process of its own; a page is served meanwhile, and after each kind of them."""
    with program(tmp_path, 0) as (gateway, url), contextlib.ExitStack() as held:
        place, _, token = url.removeprefix("http://").partition("/?")
        host, _, port = place.partition(":")
        asked = f"GET /ws?{token} HTTP/1.1\r\nHost: {place}\r\n"
        upgrade = "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
        upgrade += "Sec-WebSocket-Key: MTIzNDU2Nzg5MDEyMzQ1Ng==\r\n"
        endless = b"\x81\xff" + (1 << 40).to_bytes(8, "big") + bytes(4) + b"a" * 30_000
        words = (b"", f"{asked}X: {'x' * 7000}".encode(), f"{asked}{upgrade}\r\n".encode() + endless, b"GET /" + b"a" * 30_000)
        asyncio.run(_visited(url))
        before = memory_kib(gateway.pid)
        for said in words:
            for _ in range(200):
                link = held.enter_context(socket.create_connection((host, int(port)), 10, ("127.0.0.2", 0)))
                with contextlib.suppress(ConnectionError):  # more than one address may have open at once
                    link.sendall(said)
            asyncio.run(_visited(url))
            assert memory_kib(gateway.pid) - before < 32 << 10, said[:20]
    assert b"Traceback" not in (tmp_path / "errors").read_bytes()


async def _visited(url: str) -> None:
    async with visitor() as session, asyncio.timeout(200), session.get(url) as answer:
        assert answer.status in (200, 404), "404 where the page was not built"


def memory_kib(pid: int) -> int:
    """That a process has in use."""
    return int(Path(f"/proc/{pid}/status").read_text().partition("VmRSS:")[2].split()[0])


@pytest.mark.filterwarnings(
    "ignore:.*UVHandle:pytest.PytestUnraisableExceptionWarning"
)  # uvloop forgets the one it could not bind
def test_a_port_that_is_taken_has_a_reason_and_what_to_do(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        address = taken.getsockname()
        with pytest.raises(ConfigError, match=r"another program has it, .* choose with --boats"):
            served(Gateway(SystemClock(), tmp_path), address, ("127.0.0.1", 0))
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(ConfigError, match=r"another program has it, .* choose with --page"):
            served(Gateway(SystemClock(), tmp_path), None, taken.getsockname())


def served(gateway: Gateway, boats: tuple[str, int] | None, page: tuple[str, int]) -> None:
    """As the command does: uvloop's errors are not those of asyncio."""
    with asyncio.Runner(loop_factory=new_event_loop) as runner:
        runner.run(serve(gateway, boats, page, lambda url: None))


def test_a_console_goes_on_behind_one_that_ended_with_a_warning_of_its_own(tmp_path: Path) -> None:
    """As of a radio that was not plugged in: it is over, until this console finds it again."""
    alerts = AlertList(lambda: 1.0)
    assert alerts.hold(None, 2, "/dev/ttyUSB9: no such port", True)
    (tmp_path / "alerts.json").write_bytes(msgspec.json.encode(alerts.kept()))
    gateway = Gateway(SystemClock(), tmp_path / "missions", sessions=tmp_path)
    assert [each.text for each in gateway.watch.alerts.kept().alerts if each.lasts] == []
    assert "/dev/ttyUSB9: no such port" in [line.text for line in gateway.watch.log.lines if line.what == "over"]
    gateway.close()


async def test_a_page_learns_of_charts_and_of_those_that_are_wrong(tmp_path: Path) -> None:
    Image.new("RGB", (20, 10)).save(tmp_path / "harbour.png")
    (tmp_path / "harbour.pgw").write_text("0.001 0 0 -0.001 -9.2195 38.6995")
    Image.new("RGB", (20, 10)).save(tmp_path / "lost.png")
    async with opened(tmp_path, charts=tmp_path) as sea, sea.session.ws_connect(sea.url + "ws") as page:
        (chart,) = (await page.receive_json())["backgrounds"]
        assert (chart["name"], chart["kind"]) == ("harbour", "image")
        assert chart["extent"] == pytest.approx([-9.22, 38.69, -9.20, 38.70])
        text = await sea.until(page, lambda m: m["t"] == "text")
        assert "lost.png" in text["text"]
        async with sea.session.get(sea.url + "background/harbour") as answer:
            assert await answer.read() == (tmp_path / "harbour.png").read_bytes()


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


async def test_a_radio_that_is_not_there_is_told_to_the_page(tmp_path: Path) -> None:
    async with opened(tmp_path, radios=[f"{tmp_path}/none:9600"]) as sea, sea.session.ws_connect(sea.url + "ws") as page:
        text = await sea.until(page, lambda m: m["t"] == "text" and "No such file" in m["text"])
        assert text["boat"] is None


def test_a_gateway_that_is_killed_says_nothing_more(tmp_path: Path) -> None:
    """The last step of the dead-man before the boat's own: no process is left that repeats thrust."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    boat_end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    boat_end.setblocking(False)
    boat_end.connect(("127.0.0.1", port))
    with boat_end, program(tmp_path, port) as (gateway, url):
        asyncio.run(_steered(url, boat_end, gateway))


@contextlib.contextmanager
def program(folder: Path, port: int) -> Iterator[tuple["subprocess.Popen[bytes]", str]]:
    """The console in a process of its own, which hears boats on this port, and its address."""
    words = ["console", "--no-browser", "--token=token", "--page", "127.0.0.1:0", "--boats", f"127.0.0.1:{port}"]
    command, environment = [sys.executable, "-m", "delfim", *words], os.environ | {"PYTHONPATH": str(ROOT)}
    with (
        (folder / "errors").open("wb") as errors,
        subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=errors, env=environment) as gateway,
    ):
        try:
            assert gateway.stdout is not None
            url = re.search(rb"http://[^;]+", gateway.stdout.readline())
            assert url is not None
            yield gateway, url[0].decode()
        finally:
            gateway.kill()


async def _steered(url: str, boat_end: socket.socket, gateway: "subprocess.Popen[bytes]") -> None:
    """Thrust by hand from a page, until the gateway is killed."""
    boat, loop = FakeBoat(1, SystemClock(), boat_end.send), asyncio.get_running_loop()  # type: ignore[arg-type]

    def readable() -> None:
        with contextlib.suppress(OSError):
            boat.hear(boat_end.recv(2048))

    loop.add_reader(boat_end, readable)
    async with visitor() as session, asyncio.timeout(200), session.ws_connect(await let_in(session, url) + "ws") as page:
        for n in itertools.count():  # as a page does it: an input that came late is dropped, another follows it
            if boat.thrust:
                break
            with contextlib.suppress(OSError):
                boat.tick()
            if boat.heartbeats:
                await page.send_json({"t": "input", "boat": 1, "n": n, "port_pct": 30, "starboard_pct": 30})
            await asyncio.sleep(0.05)
        gateway.kill()
        await asyncio.to_thread(gateway.wait)
        await asyncio.sleep(0.1)  # what was under way on loopback
        said = len(boat.thrust)
        await asyncio.sleep(1.0)
        assert len(boat.thrust) == said
    loop.remove_reader(boat_end)


async def test_a_gateway_that_slept_sends_nothing_old_when_it_wakes(tmp_path: Path) -> None:
    """What the page said before the laptop slept, and what it goes on saying, is heard after it woke up."""
    clock = ManualClock(100.0)
    async with opened(tmp_path, clock) as sea, sea.session.ws_connect(sea.url + "ws") as page:
        boat = sea.boats[0]

        async def steer(count: int) -> None:
            await page.send_json({"t": "input", "boat": 1, "n": count, "port_pct": 30, "starboard_pct": 30})

        async def ask(command: str, **words: str) -> dict[str, Any]:
            await page.send_json({"t": "command", "seq": 1, "boat": 1, "command": command, **words})
            return await sea.until(page, lambda m: m["t"] == "answer")

        await sea.until(page, lambda m: boat_in(m, 1))
        await ask("mode", mode="manual")
        await steer(0)
        async with asyncio.timeout(200):
            while not boat.thrust:
                await asyncio.sleep(0.01)
        clock.advance(8.0)
        for count in range(1, 6):
            await steer(count)
        assert (await ask("play"))["reason"] == "the console's computer slept: give the command again"
        await sea.until(page, lambda m: boat_in(m, 1).get("released"))
        assert (await ask("stop"))["ok"]
        assert boat.thrust == [(300, 0), (0, 0)]
        assert boat.obeyed == [{"command": "mode", "mode": "manual"}, (176, 1, 4)], "manual before, and stop"
        for _ in range(3):
            clock.advance(0.5)
            now_s = clock.time_ns() / 1e9
            await sea.until(page, lambda m, now_s=now_s: m["t"] == "boats" and m["at_s"] >= round(now_s, 3))
        assert (await ask("mode", mode="manual"))["ok"], "the operator took it again"


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


async def test_a_gateway_that_is_ended_in_order_says_zero_and_keeps_the_session(tmp_path: Path) -> None:
    async with opened(tmp_path, sessions=tmp_path / "sessions") as sea, sea.session.ws_connect(sea.url + "ws") as page:
        await sea.until(page, lambda m: boat_in(m, 1))
        await page.send_json({"t": "input", "boat": 1, "n": 0, "port_pct": 30, "starboard_pct": 30})
        async with asyncio.timeout(200):
            while not sea.boats[0].thrust:
                await asyncio.sleep(0.01)
        sea.gateway.fleet.release_all("the console ended")
        async with asyncio.timeout(200):
            while sea.boats[0].thrust[-1] != (0, 0):
                await asyncio.sleep(0.01)
    (tape,) = open_tapes([tmp_path / "sessions"])
    assert tape.to_s > tape.from_s
