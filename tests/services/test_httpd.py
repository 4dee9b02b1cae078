"""httpd from outside, on loopback: what it says, what it keeps to itself, and who cannot hurt it."""

import asyncio
import contextlib
import copy
import html
import json
import os
import re
import shutil
import socket
import sys
from collections import Counter
from collections.abc import AsyncIterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import aiohttp
import msgspec
import pytest

from delfim import config
from delfim.base.clock import SystemClock
from delfim.services.access import connection_limits
from delfim.services.page import api, board, httpd, page
from delfim.services.runtime import Runtime
from delfim.services.tables import Httpd
from delfim.vehicle.report import BoatReport
from tests.services.boat import STATE, served, vehicle, vehicle_file
from tests.services.browser import PROGRAM, tab

PLACES = ("/", "/checks", "/system", "/logs/", "/metrics", "/api/state", "/api/checks", "/api/system", "/api/schema")
SAID = (
    ("debug", "cantcpd", "127.0.0.1:4000 left"),
    ("info", "supervisor", "runtime: started as process 17"),
    ("warning", "ftpd", "wrong password for 'Ana <b>' from 10.0.0.9"),
    ("critical", "supervisor", "runtime: beat stopped for 1.0 s: dead-man; it stood in hang"),
    ("critical", "supervisor", "  | File \\x1b[31m, line 3 in hang"),
    ("warning", "ftpd", "ana logged in from 10.0.0.9"),
)


def said(settings: config.Vehicle) -> None:
    """The last lines of the system log, two of which are none."""
    lines = [
        {
            "t_ns": 1_795_231_735_093_121_524 + n,
            "monotonic_s": 5.0 + n,
            "level": level,
            "pid": 17,
            "service": service,
            "text": text,
        }
        for n, (level, service, text) in enumerate(SAID)
    ]
    texts = [json.dumps(line) for line in lines]
    (Path(settings.runtime.run_directory) / "system.1.jsonl").write_text("\n".join([*texts[:2], "{torn", ""]))
    (Path(settings.runtime.run_directory) / "system.jsonl").write_text("\n".join([*texts[2:], '{"t_ns": -1}', ""]))


class Site:
    """The running service and how it is reached."""

    def __init__(self, url: str, state: dict[str, Any], settings: config.Vehicle, session: aiohttp.ClientSession) -> None:
        self.url, self.state, self.settings, self.session = url.rstrip("/"), state, settings, session
        self.writers: list[asyncio.StreamWriter] = []
        self.log = Path(settings.log.directory)
        self.port = int(self.url.rpartition(":")[2])

    async def get(self, path: str, **headers: str) -> tuple[int, aiohttp.typedefs.LooseHeaders, bytes]:
        async with self.session.get(self.url + path, headers=headers, allow_redirects=False) as answer:
            return answer.status, answer.headers, await answer.read()

    async def raw(self, data: bytes, address: str = "127.0.0.1") -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        streams = await asyncio.open_connection("127.0.0.1", self.port, local_addr=(address, 0))
        streams[1].write(data)
        self.writers.append(streams[1])
        return streams

    async def hang_up(self) -> None:
        for writer in self.writers:
            writer.transport.abort()
        await asyncio.sleep(0)


@contextlib.asynccontextmanager
async def site(tmp_path: Path, *, with_vehicle: bool = True, **limits: Any) -> AsyncIterator[Site]:
    settings = vehicle_file(tmp_path, httpd=Httpd(listen="127.0.0.1:0", **limits))
    state = copy.deepcopy(STATE)
    async with contextlib.AsyncExitStack() as stack:
        if with_vehicle:
            await stack.enter_async_context(vehicle(settings, state))
        runtime = await stack.enter_async_context(served(settings, httpd.serve, "httpd"))
        session = await stack.enter_async_context(aiohttp.ClientSession())
        boat = Site(str(runtime.board["httpd"]()["address"]), state, settings, session)
        stack.push_async_callback(boat.hang_up)
        yield boat


@pytest.fixture
def boat(tmp_path: Path) -> contextlib.AbstractAsyncContextManager[Site]:
    return site(tmp_path)


async def ended(reader: asyncio.StreamReader) -> bytes:
    """What was said until the server hung up."""
    async with asyncio.timeout(200):
        try:
            return await reader.read()
        except ConnectionResetError:
            return b""


async def test_every_place_answers_and_nothing_comes_from_elsewhere(boat):
    for place in PLACES:
        status, headers, body = await boat.get(place)
        assert status == 200, place
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert headers["Server"] == "delfim"
        text = body.decode().replace("http://www.w3.org/2000/svg", "")
        assert not re.search(r"(src|href)=.?(https?:)?//", text), "everything is on the page itself"
    assert (await boat.get("/nothing"))[0] == 404
    assert (await boat.get("/logs"))[1]["Location"] == "/logs/"


async def test_the_page_says_without_a_script_what_a_person_must_know(boat):
    text = (await boat.get("/"))[2].decode()
    for words in (
        "<h1>Play</h1>",
        "Doca, leg 1 of 12",
        "batteries port at 12 %: home",
        "bad overheated",
        "waiting: bus off",
        "restarted 4 times",
        "navigation jumps",
        "never heard",
        "98.00% within 100 µs",
        "640 µs",
        '<noscript><meta http-equiv="refresh"',
    ):
        assert words in text
    checks = (await boat.get("/checks"))[2].decode()
    assert "1 of 2 not in order" in checks
    assert "disk full" in checks


async def test_the_way_is_drawn_as_it_was_seen_and_stays_short(tmp_path):
    way = board.Trail()
    for n in range(1000):
        way.add(BoatReport(mode="play", reason="", latitude_deg=38.0 + n / 1e5, longitude_deg=-9.0))
    way.add(BoatReport(mode="play", reason=""))
    assert board.WAY_MAX / 2 <= len(way.points) < board.WAY_MAX
    assert way.points == sorted(way.points)
    assert (way.points[0][0], round(way.points[-1][0], 3)) == (38.0, 38.01)
    async with site(tmp_path) as boat:
        text = (await boat.get("/"))[2].decode()
        assert 'class="figure map"' in text
        assert "Console" not in text.partition("<footer>")[2]


async def test_the_page_leads_to_the_console_where_the_file_says_where_it_is(tmp_path):
    async with site(tmp_path, console="http://127.0.0.1:8765/") as boat:
        text = (await boat.get("/"))[2].decode()
        assert '<a href="http://127.0.0.1:8765/">Console</a>' in text.partition("<footer>")[2]


async def test_logs_are_listed_with_what_they_are(boat):
    for name in ("20261122/state/101530.state.gz", "20261122/can0/101530.log.gz", "20269999/x"):
        (boat.log / name).parent.mkdir(parents=True, exist_ok=True)
        (boat.log / name).write_text("x")
    for place, words in (
        ("/logs/", ("22 November 2026", ">20269999/<")),
        ("/logs/20261122/", ("each cycle of the boat’s state", "each frame of this bus", '<a href="../">Logs</a>')),
        (
            "/logs/20261122/state/",
            ("state log, compressed from 10:15:30", '<a href="../../">Logs</a> › <a href="../">20261122</a>'),
        ),
        ("/logs/20261122/can0/", ("frames, as candump writes them, compressed from 10:15:30",)),
    ):
        text = (await boat.get(place))[2].decode()
        assert all(each in text for each in words), place


async def test_words_from_outside_are_not_markup(boat):
    boat.state["reason"] = boat.state["mission"] = "<script>alert(1)</script>"
    boat.state["counts"] = {"<img src=x>": 1}
    (boat.log / "<b>&.log").write_text("x")
    for place in ("/", "/logs/"):
        text = (await boat.get(place))[2].decode()
        assert "<script>alert" not in text
        assert "<img" not in text
        assert "<b>&.log" not in text


@pytest.mark.parametrize(
    ("asked", "found"),
    [
        ("", (5, 4, 3, 2, 1)),
        ("?level=debug", (5, 4, 3, 2, 1, 0)),
        ("?level=warning&text=FTPD", (5, 2)),
        ("?level=error", (4, 3)),
        ("?text=10.0.0.9", (5, 2)),
        ("?level=nonsense&text=no%20such%20thing", ()),
    ],
)
async def test_the_system_log_is_shown_by_level_and_text_newest_first(boat, asked, found):
    said(boat.settings)
    told = json.loads((await boat.get(f"/api/system{asked}"))[2])
    assert [(line["level"], line["service"]) for line in told] == [SAID[n][:2] for n in found]
    text = html.unescape((await boat.get(f"/system{asked}"))[2].decode())
    assert re.findall(r"</b> (.*?)</li>", text) == [line["text"] for line in told]


async def test_words_from_outside_in_the_system_log_are_neither_markup_nor_control(boat, tmp_path):
    line = {
        "t_ns": 1,
        "monotonic_s": 1.0,
        "level": "info",
        "pid": 1,
        "service": "<b>",
        "text": "\x1b[2J<img src=x>\r\u202e",
    }
    (tmp_path / "system.jsonl").write_text(json.dumps(line) + "\n")
    page = (await boat.get("/system?text=%3Cimg%20src%3Dx%3E"))[2].decode()
    assert "<img" not in page
    assert "<b>&lt;b&gt;</b> \\x1b[2J&lt;img src=x&gt;\\x0d\\x202e</li>" in page
    assert json.loads((await boat.get("/api/system"))[2])[0]["text"].isprintable()


async def test_state_is_as_the_schema_says(boat):
    report = msgspec.json.decode((await boat.get("/api/state"))[2], type=api.Report, strict=True)
    assert report.vehicle is not None
    assert report.vehicle.heading_deg == 131.65
    assert report.vehicle.latency.histogram[-1] == (704.0, 1)
    schema = msgspec.json.decode((await boat.get("/api/schema"))[2])
    assert set(schema["$defs"]["Report"]["properties"]) == {f.name for f in msgspec.structs.fields(api.Report)}
    named = set(re.findall(r"#/\$defs/(\w+)", str(schema)))
    assert named <= set(schema["$defs"])


async def test_metrics_are_what_prometheus_reads(tmp_path):
    label = r'[a-z]+="(\\.|[^"\\])*"'
    line = re.compile(rf"(# (HELP|TYPE) [a-z_]+ .+|[a-z_]+(\{{{label}(,{label})*\}})? -?[0-9.e+-]+)")
    async with site(tmp_path) as boat:
        boat.state["counts"] = {'a "quoted"\\\nname': 1}
        _, headers, body = await boat.get("/metrics")
        assert headers["Content-Type"].startswith("text/plain; version=0.0.4")
        lines = body.decode().splitlines()
        assert [each for each in lines if not line.fullmatch(each.replace('le="+Inf"', 'le="1"'))] == []
        samples = [each.rpartition(" ")[0] for each in lines if not each.startswith("#")]
        assert len(set(samples)) == len(samples)
        buckets = [int(each.split()[-1]) for each in lines if "_bucket" in each]
        assert buckets == sorted(buckets)
        assert buckets[-1] == 1000
        assert 'delfim_service_restarts_total{service="canzlogd"} 4' in lines


@pytest.mark.parametrize("mute", [False, True], ids=["gone", "mute"])
async def test_a_vehicle_that_does_not_answer_is_said_to_be_so(tmp_path, monkeypatch, mute):
    monkeypatch.setattr(board, "ANSWER_S", 0.05)
    async with site(tmp_path, with_vehicle=False) as boat:
        if mute:
            path = boat.settings.console.socket
            silent = await asyncio.start_unix_server(lambda _, writer: boat.writers.append(writer), path)
        text = (await boat.get("/"))[2].decode()
        assert "No answer" in text
        assert "the vehicle does not answer" in text
        assert "delfim_up 0" in (await boat.get("/metrics"))[2].decode()
        assert msgspec.json.decode((await boat.get("/api/state"))[2])["vehicle"] is None
        if mute:
            silent.close()


@pytest.mark.parametrize(
    ("host", "status"),
    [
        *(
            (host, 200)
            for host in ("127.0.0.1", "192.168.0.7:8080", "[fe80::1]:8080", "[::1]", "boat", "Delfim.local:8080", "localhost")
        ),
        *(
            (host, 403)
            for host in ("evil.example:8080", "127.0.0.1.evil.example", "boat.local.evil.example", "", ":8080", "a b")
        ),
    ],
)
async def test_a_name_of_the_internet_is_not_the_boats(boat, host, status):
    """Whoever owns it can let it point to the boat, and read the boat by a page of his."""
    for place in ("/", "/events", "/logs/", "/api/state"):
        async with boat.session.get(boat.url + place, headers={"Host": host}) as answer:
            assert answer.status == status, place


def test_a_visitor_who_leaves_while_the_page_is_made_costs_the_next_none_of_it(tmp_path):
    settings = vehicle_file(tmp_path)
    connection_limits = SimpleNamespace(inside=Counter[str](), refused=0)

    async def left_after(steps: int) -> set[str]:
        runtime = Runtime(settings, SystemClock(), alone=True)
        told = board.Board(runtime, board.Lookout(settings, runtime.clock.monotonic_s), connection_limits)
        visitor = asyncio.create_task(told.sections())
        for _ in range(steps):
            await asyncio.sleep(0)
        visitor.cancel()
        await asyncio.gather(visitor, return_exceptions=True)
        return set(await told.sections())

    for steps in range(len(page.SECTIONS) + 3):
        assert asyncio.run(left_after(steps)) == {"head", *(section.id for section in page.SECTIONS)}


async def test_events_bring_all_sections_once_and_then_what_has_changed(tmp_path, monkeypatch):
    monkeypatch.setattr(httpd, "EVERY_S", (0.02, 60.0))
    monkeypatch.setattr(board, "FRESH_S", 0.0)
    async with site(tmp_path) as boat, boat.session.get(boat.url + "/events") as events:
        assert events.headers["Content-Type"] == "text/event-stream"

        async def event() -> dict[str, str]:
            line = await events.content.readline()
            assert await events.content.readline() == b"\n"
            return msgspec.json.decode(line.removeprefix(b"data: "))

        first = await event()
        assert {"head", "motion", "inputs", "latency", "processes"} <= set(first)
        boat.state["mode"] = "hold"
        async with asyncio.timeout(200):
            while "head" not in (changed := await event()):
                pass
        assert "Hold" in changed["head"]
        assert "motion" not in changed


async def test_a_page_that_is_not_read_costs_nothing_and_is_hung_up(tmp_path, monkeypatch):
    monkeypatch.setattr(httpd, "EVERY_S", (0.005, 60.0))
    monkeypatch.setattr(board, "FRESH_S", 0.0)
    monkeypatch.setattr(httpd, "STALL_S", 0.3)
    monkeypatch.setattr(connection_limits, "UNSENT_BYTES", 4096)
    async with site(tmp_path) as boat:
        link = socket.socket()
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        link.connect(("127.0.0.1", boat.port))
        link.sendall(b"GET /events HTTP/1.1\r\nHost: x\r\n\r\n")
        async with asyncio.timeout(200):
            while (await shown(boat))["connections"] < 2:
                boat.state["heading_deg"] = (boat.state["heading_deg"] + 1) % 360
                await asyncio.sleep(0.01)
            while (await shown(boat))["connections"] > 1:
                boat.state["heading_deg"] = (boat.state["heading_deg"] + 1) % 360
                await asyncio.sleep(0.01)
        link.close()


async def shown(boat: Site) -> dict[str, int]:
    server: dict[str, int] = msgspec.json.decode((await boat.get("/api/state"))[2])["server"]
    return server


async def test_one_visitor_cannot_take_all_connections(tmp_path):
    async with site(tmp_path, connections=6, connections_per_address=4) as boat:
        held = [await boat.raw(b"GET / HT", "127.0.0.2") for _ in range(6)]
        answers = [asyncio.wait_for(reader.read(), 0.3) for reader, _ in held]
        told = await asyncio.gather(*answers, return_exceptions=True)
        assert sum(isinstance(each, bytes) and each.startswith(b"HTTP/1.1 503") for each in told) == 2
        assert (await boat.get("/"))[0] == 200
        assert (await shown(boat))["refused"] == 2


async def test_half_a_request_is_hung_up_while_others_are_served(tmp_path, monkeypatch):
    """Slow-loris: a byte now and then does not hold a connection."""
    monkeypatch.setattr(httpd, "IDLE_S", 0.3)
    async with site(tmp_path) as boat:
        reader, writer = await boat.raw(b"GET / HTTP/1.1\r\n", "127.0.0.2")
        dripping = True

        async def drip() -> None:
            while dripping:
                writer.write(b"X: y\r\n")
                await asyncio.sleep(0.05)

        async def visit() -> list[int]:
            return [(await boat.get("/api/checks"))[0] for _ in range(5)]

        drops = asyncio.create_task(drip())
        statuses = await visit()
        assert await ended(reader) == b""
        dripping = False
        await drops
        assert statuses == [200] * 5


@pytest.mark.parametrize(
    ("request_", "status"),
    [
        (b"GET /" + b"a" * 9000 + b" HTTP/1.1\r\nHost: x\r\n\r\n", b"400"),
        (b"GET / HTTP/1.1\r\nHost: x\r\nX: " + b"a" * 9000 + b"\r\n\r\n", b"400"),
        (b"GET / HTTP/1.1\r\nHost: x\r\n" + b"X: y\r\n" * 500 + b"\r\n", b"400"),
        (b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 1000000000\r\n\r\nabc", b"405"),
        (b"DELETE /logs/x HTTP/1.1\r\nHost: x\r\n\r\n", b"405"),
        (b"\x16\x03\x01\x02\x00 what is this\r\n\r\n", b"400"),
    ],
    ids=["line", "field", "fields", "upload", "delete", "no HTTP"],
)
async def test_what_is_too_much_is_refused_and_fills_no_log(tmp_path, request_, status, caplog):
    async with site(tmp_path) as boat:
        for first in (b"", b"GET /checks HTTP/1.1\r\nHost: x\r\n\r\n"):
            reader, _ = await boat.raw(first + request_)
            assert status in re.findall(rb"HTTP/1.\d (\d+)", await ended(reader))
        assert (await boat.get("/checks"))[0] == 200
    assert not [record for record in caplog.records if record.exc_info]


async def test_it_answers_where_the_file_says_and_nowhere_else(boat):
    assert boat.url.startswith("http://127.0.0.1:")
    with pytest.raises(ConnectionRefusedError):
        await asyncio.open_connection("127.0.0.2", boat.port)


CONTENT = bytes(range(256)) * 1000


@pytest.mark.parametrize(
    ("asked", "status", "part"),
    [
        (None, 200, CONTENT),
        ("bytes=0-99", 206, CONTENT[:100]),
        ("bytes=255990-", 206, CONTENT[255990:]),
        ("bytes=-7", 206, CONTENT[-7:]),
        ("bytes=-999999999", 206, CONTENT),
        ("bytes=100-999999999", 206, CONTENT[100:]),
        ("bytes=0-1,5-6", 200, CONTENT),
        ("lines=1-2", 200, CONTENT),
        ("bytes=256000-", 416, None),
        ("bytes=9-3", 416, None),
    ],
)
async def test_a_log_comes_whole_or_in_the_range_that_was_asked_for(boat, asked, status, part):
    (boat.log / "20260101").mkdir()
    (boat.log / "20260101/a b.log").write_bytes(CONTENT)
    got, headers, body = await boat.get("/logs/20260101/a%20b.log", **({"Range": asked} if asked else {}))
    assert got == status
    if part is None:
        assert headers["Content-Range"] == "bytes */256000"
    else:
        assert body == part
        assert headers["Accept-Ranges"] == "bytes"
    stale = await boat.get("/logs/20260101/a%20b.log", Range="bytes=0-9", **{"If-Range": '"another"'})
    assert (stale[0], len(stale[2])) == (200, len(CONTENT))
    fresh = await boat.get("/logs/20260101/a%20b.log", Range="bytes=0-9", **{"If-Range": stale[1]["ETag"]})
    assert (fresh[0], fresh[2]) == (206, CONTENT[:10])
    async with boat.session.head(boat.url + "/logs/20260101/a%20b.log") as head:
        assert head.headers["Content-Length"] == "256000"


@pytest.mark.skipif(not shutil.which("curl"), reason="needs curl")
async def test_curl_resumes_a_download_that_broke_off(boat, tmp_path):
    (boat.log / "x.log").write_bytes(CONTENT)
    part = tmp_path / "part"
    part.write_bytes(CONTENT[:77_777])
    curl = await asyncio.create_subprocess_exec("curl", "-sS", "-C", "-", "-o", part, boat.url + "/logs/x.log")
    assert await curl.wait() == 0
    assert part.read_bytes() == CONTENT


async def test_a_name_that_is_no_utf8_is_shown_and_leads_to_its_file(boat):
    folder = boat.log / os.fsdecode(b"\xfe")
    folder.mkdir()
    (folder / os.fsdecode(b"\xff <b>.log")).write_bytes(CONTENT)
    assert rb'<a href="./%FE/">\xfe/</a>' in (await boat.get("/logs/"))[2]
    assert (await boat.get("/logs/%FE"))[1]["Location"] == "/logs/%FE/"
    listing = (await boat.get("/logs/%FE/"))[2]
    assert rb'<a href="./%FF%20%3Cb%3E.log">\xff &lt;b&gt;.log</a>' in listing
    status, headers, content = await boat.get("/logs/%FE/%FF%20%3Cb%3E.log")
    assert (status, content) == (200, CONTENT)
    assert headers["Content-Disposition"].endswith("UTF-8''%5Cxff%20%3Cb%3E.log")


@pytest.mark.parametrize(
    "path",
    [
        "/logs/../secret",
        "/logs/%2e%2e/secret",
        "/logs/..%2fsecret",
        "/logs/%252e%252e/secret",
        "/logs/link",
        "/logs/folder/secret",
        "/logs//etc/passwd",
        "/logs/%2fetc/passwd",
        "/logs/secret%00.log",
        "/logs/pipe",
        "/logs/gone",
        "/logs/%ff%fe",
    ],
)
async def test_no_path_leads_out_of_the_logs(boat, tmp_path, path):
    (tmp_path / "secret").write_text("secret")
    (boat.log / "link").symlink_to(tmp_path / "secret")
    (boat.log / "folder").symlink_to(tmp_path)
    os.mkfifo(boat.log / "pipe")
    reader, _ = await boat.raw(f"GET {path} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n".encode())
    told = await ended(reader)
    assert told.split(b" ")[1] == b"404"
    assert b"\r\n\r\nsecret" not in told
    listing = (await boat.get("/logs/"))[2].decode()
    assert "link" not in listing.partition("files")[2]


async def test_a_download_that_nobody_reads_is_given_up(tmp_path, monkeypatch):
    monkeypatch.setattr(httpd, "STALL_S", 0.2)
    async with site(tmp_path) as boat:
        (boat.log / "big").write_bytes(bytes(20 << 20))
        _, writer = await boat.raw(b"")
        writer.transport.pause_reading()
        writer.write(b"GET /logs/big HTTP/1.1\r\nHost: x\r\n\r\n")
        async with asyncio.timeout(200):
            while (await shown(boat))["connections"] < 2:
                await asyncio.sleep(0.02)
            while (await shown(boat))["connections"] > 1:
                await asyncio.sleep(0.02)


async def test_arguments_of_processes_are_nobodys_business(boat):
    words = (sys.executable, "-c", "input()", "--password=sesame")
    child = await asyncio.create_subprocess_exec(*words, stdin=asyncio.subprocess.PIPE)
    try:
        async with asyncio.timeout(200):
            while b'"computer":null' in (text := (await boat.get("/api/state"))[2]):
                await asyncio.sleep(0.1)
        assert b"sesame" not in text
        assert b'"processes":[{' in text
    finally:
        await child.communicate(b"\n")


async def test_the_look_at_the_computer_is_started_again_and_ends_with_the_service(tmp_path, monkeypatch):
    monkeypatch.setattr(httpd, "AGAIN_S", 0.05)
    looks: list[board.Lookout] = []
    start = board.Lookout.start

    async def noted(self: board.Lookout) -> None:
        looks.append(self)
        await start(self)

    monkeypatch.setattr(board.Lookout, "start", noted)
    async with site(tmp_path):
        async with asyncio.timeout(200):
            while looks[0].computer is None:
                await asyncio.sleep(0.02)
            first = looks[0]._transport
            first.kill()
            while looks[0]._transport in (None, first):
                await asyncio.sleep(0.02)
        second = looks[0]._transport
    async with asyncio.timeout(200):
        while second.get_returncode() is None:
            await asyncio.sleep(0.02)


@pytest.mark.skipif(PROGRAM is None, reason="needs Chromium")
async def test_a_browser_shows_the_page_alive_and_says_when_it_is_not(tmp_path):
    async with tab() as page:
        async with site(tmp_path) as boat:
            await page.open(boat.url, width=390, height=844)
            await page.until("document.querySelector('#head h1').textContent === 'Play'")
            boat.state["mode"] = "hold"
            await page.until("document.querySelector('#head h1').textContent === 'Hold'")
            assert await page.value("document.title") == "Hold · Test"
            assert not await page.value("document.body.classList.contains('stale')")
            wide = "document.documentElement.scrollWidth"
            assert await page.value(wide) == 390, "nothing sticks out on a phone"
            assert len(await page.picture()) > 50_000
            await page.nothing_amiss()
        await page.until("document.body.classList.contains('stale')")
        page.complaints.clear()  # about a boat that is gone
        assert "No connection" in await page.value("document.getElementById('late').textContent")


@pytest.mark.skipif(PROGRAM is None, reason="needs Chromium")
async def test_a_person_looks_for_a_line_of_the_system_log(tmp_path):
    async with tab() as page, site(tmp_path) as boat:
        said(boat.settings)
        await page.open(boat.url, width=390, height=844)
        lines = "Array.from(document.querySelectorAll('.log li'), each => each.textContent)"
        await page.until("document.querySelectorAll('#log li').length === 5")
        assert "ftpd ana logged in from 10.0.0.9" in (await page.value(lines))[0]
        await page.call("Runtime.evaluate", expression="document.querySelector('#log a').click()")
        await page.until("document.querySelector('form') !== null")
        filled = "document.querySelector('form select').value = 'warning', document.querySelector('input').value = 'ana'"
        await page.call("Runtime.evaluate", expression=f"{filled}, document.querySelector('button').click()")
        await page.until(f"{lines}.length === 2")
        assert ["wrong password" in line for line in await page.value(lines)] == [False, True]
        assert await page.value("document.querySelector('input').value") == "ana", "what was asked for stands there"
        assert await page.value("document.documentElement.scrollWidth") == 390, "nothing sticks out on a phone"


@pytest.mark.skipif(PROGRAM is None, reason="needs Chromium")
async def test_a_browser_without_script_shows_the_essentials(tmp_path):
    async with tab() as page, site(tmp_path) as boat:
        await page.open(boat.url, width=390, height=844, script=False)
        text = (await page.call("DOM.getDocument", depth=-1))["root"]
        assert "Doca, leg 1 of 12" in str(text)
