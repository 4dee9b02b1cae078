"""httpd: the boat's page (thesis 3.3), live; the same as JSON and for Prometheus; the logs to take away. It changes nothing.

A cooperative service: what is slow is done elsewhere, the look at the computer in a child (`delfim.services.computer`), files
in two workers. The vehicle is asked over its local command socket, and only while somebody looks, so that the page is the same
from the runtime and from a process of its own. Nobody is waited for: connections, headers, idle time and what is not read are
bounded. How it is used: docs/httpd.md.
"""

import asyncio
import contextlib
import json
import logging
import os
import re
import sys
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from html import escape
from ipaddress import ip_address
from typing import Any, Final, TypeVar, cast
from urllib.parse import quote, unquote

import msgspec
from aiohttp import web

from delfim import config
from delfim.errors import DelfimError, FormatError
from delfim.logging.tree import readable
from delfim.services.door import Door, bulk
from delfim.services.jail import Jail
from delfim.services.runtime import Runtime
from delfim.services.web import api, document, files, metrics, page
from delfim.services.web.api import Computer, Report, Server, Service, State

ANSWER_S: Final = 2.0  # that the vehicle has to answer
FRESH_S: Final = 0.9  # what is younger is not asked for again
EVERY_S: Final = (1.0, 60.0)  # between two events of a page
IDLE_S: Final = 15.0  # for a request to arrive, and between two of them
STALL_S: Final = 20.0  # a client that reads nothing for so long is gone
AGAIN_S: Final = 5.0  # before a look at the computer that failed is tried again
WAY_MAX: Final = 160  # points: their line takes 60 µs to write
CHUNK_BYTES: Final = 64 << 10  # of a file
ANSWER_BYTES: Final = 1 << 20  # of the vehicle or the child, at most
BACKLOG: Final = 16
HEADERS: Final = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": document.POLICY,
    "Referrer-Policy": "no-referrer",
    "Server": "delfim",
    "X-Content-Type-Options": "nosniff",
}

_PORT: Final = re.compile(r":\d+$")
_LOCAL: Final = re.compile(r"[a-z0-9_-]+(\.(local|lan|internal|home\.arpa))?")
log = logging.getLogger(__name__)
T = TypeVar("T")


class Feed(asyncio.Protocol):
    """The vehicle's words, asked for one at a time."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._transport: asyncio.Transport | None = None
        self._answer: asyncio.Future[bytes] | None = None
        self._buffer = bytearray()

    async def ask(self) -> State:
        """The present state. Raises DelfimError in words."""
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(ANSWER_S):
                if self._transport is None:
                    await loop.create_unix_connection(lambda: self, self._path)
                assert self._transport is not None
                self._answer = loop.create_future()
                self._transport.write(b'{"command": "state"}\n')
                return _ANSWER.decode(await self._answer).state
        except (OSError, TimeoutError) as error:
            self.close()
            reason = error.strerror if isinstance(error, OSError) and error.strerror else "it says nothing"
            raise DelfimError(f"the vehicle does not answer: {reason}") from None
        except msgspec.DecodeError as error:
            raise DelfimError(f"the vehicle's answer is not understood: {error}") from None

    def close(self) -> None:
        if self._transport is not None:
            self._transport.abort()
            self._transport = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)  # uvloop's are none by descent
        self._buffer.clear()

    def connection_lost(self, exc: Exception | None) -> None:
        self._transport = None
        if self._answer is not None and not self._answer.done():
            self._answer.set_exception(ConnectionResetError(0, "it went away"))

    def data_received(self, data: bytes) -> None:
        self._buffer += data
        if data.endswith(b"\n") and self._answer is not None and not self._answer.done():
            self._answer.set_result(bytes(self._buffer))
            self._buffer.clear()
        elif len(self._buffer) > ANSWER_BYTES:
            self.close()


class _Answer(msgspec.Struct):
    state: State


_ANSWER: Final = msgspec.json.Decoder(_Answer)
_COMPUTER: Final = msgspec.json.Decoder(Computer)
_encode: Final = msgspec.json.Encoder().encode


class Look(asyncio.SubprocessProtocol):
    """The child that looks at the computer, and what it saw last."""

    def __init__(self, settings: config.Vehicle, clock_s: Callable[[], float]) -> None:
        words = (settings.log.directory, settings.log.free_bytes_min, settings.runtime.run_directory, settings.httpd.scan_s)
        self._command = (sys.executable, "-m", "delfim.services.computer", *map(str, words))
        self._clock_s = clock_s
        self._buffer = bytearray()
        self._transport: asyncio.SubprocessTransport | None = None
        self._ended = asyncio.Event()
        self.computer: Computer | None = None
        self.at_s = 0.0

    async def start(self) -> None:
        """Nothing happens while it runs. Raises OSError."""
        if self._transport is None:
            loop = asyncio.get_running_loop()
            self._ended.clear()
            self._transport, _ = await loop.subprocess_exec(lambda: self, *self._command, stderr=None)

    async def close(self) -> None:
        """Nothing is left behind."""
        if self._transport is not None:
            self._transport.close()
            await self._ended.wait()

    def pipe_data_received(self, fd: int, data: bytes) -> None:
        self._buffer += data
        if data.endswith(b"\n"):
            with contextlib.suppress(msgspec.DecodeError):  # it died in the middle of a word
                self.computer, self.at_s = _COMPUTER.decode(self._buffer.splitlines()[-1]), self._clock_s()
            self._buffer.clear()
        elif len(self._buffer) > ANSWER_BYTES and self._transport is not None:
            self._transport.kill()

    def process_exited(self) -> None:
        if self._transport is not None:
            self._transport.close()
            self._transport = None
        self._buffer.clear()
        self._ended.set()


class Way:
    """Where the boat was while somebody looked: at most WAY_MAX points. When they are full, every second one goes, and the next
    ones come half as often."""

    def __init__(self) -> None:
        self.points: list[tuple[float, float]] = []
        self._every, self._seen = 1, 0

    def add(self, vehicle: State) -> None:
        if vehicle.latitude_deg is None or vehicle.longitude_deg is None:
            return
        self._seen += 1
        if self._seen % self._every:
            return
        self.points.append((vehicle.latitude_deg, vehicle.longitude_deg))
        if len(self.points) >= WAY_MAX:
            del self.points[1::2]
            self._every *= 2


class Board:
    """What all visitors see: asked for and rendered once, whoever looks, and never while nobody does."""

    def __init__(self, runtime: Runtime, look: Look, door: Door) -> None:
        self._runtime, self._look, self._door = runtime, look, door
        self._settings, self._clock = runtime.config, runtime.clock
        self.feed = Feed(runtime.config.console.socket)
        self._lock = asyncio.Lock()
        self._report: Report | None = None
        self._report_s = self._sections_s = -1e9
        self._sections: dict[str, str] = {}
        self.requests = 0
        self._way = Way()
        self._due_s = dict.fromkeys((section.id for section in page.SECTIONS), -1e9)

    def figures(self) -> dict[str, int]:
        door = self._door
        return {"connections": door.inside.total(), "requests": self.requests, "refused": door.refused}

    async def report(self) -> Report:
        async with self._lock:
            return await self._asked()

    async def sections(self) -> dict[str, str]:
        """HTML by id. A callback renders one section, so that none is long."""
        async with self._lock:
            now_s = self._clock.monotonic_s()
            if now_s - self._sections_s < FRESH_S:
                return self._sections
            view = page.View(await self._asked(), self._settings, self._way.points)
            now, due_s = {**self._sections, "head": page.head(view)}, dict[str, float]()
            for section in page.SECTIONS:
                if now_s >= self._due_s[section.id]:
                    await asyncio.sleep(0)  # a visitor may leave here: nothing has changed yet
                    now[section.id] = section.render(view)
                    due_s[section.id] = now_s + section.every_s - 0.1
            self._due_s |= due_s
            self._sections, self._sections_s = now, now_s
            return now

    async def _asked(self) -> Report:
        now_s = self._clock.monotonic_s()
        if self._report is None or now_s - self._report_s >= FRESH_S:
            vehicle, reason = None, ""
            try:
                vehicle = await self.feed.ask()
                self._way.add(vehicle)
            except DelfimError as error:
                reason = str(error)
            own = msgspec.convert(self._runtime.report()["services"], dict[str, Service])
            look = self._look
            self._report = Report(
                utc_ns=self._clock.time_ns(),
                vehicle=vehicle,
                reason=reason,
                services={**(vehicle.services if vehicle else {}), **own},
                computer=look.computer,
                computer_age_s=round(now_s - look.at_s, 1) if look.computer else None,
                server=Server(**self.figures()),
            )
            self._report_s = now_s
        return self._report


class Connection(web.RequestHandler):
    """aiohttp's connection behind our door."""

    __slots__ = ("_address", "_door")

    def __init__(self, server: web.Server, door: Door) -> None:
        loop = asyncio.get_running_loop()
        super().__init__(
            server,
            loop=loop,
            keepalive_timeout=IDLE_S,
            lingering_time=0.0,  # nobody has anything to upload here
            max_line_size=2048,
            max_field_size=4096,
            max_headers=64,
            read_bufsize=16 << 10,
            access_log=None,  # type: ignore[arg-type]
            logger=log,
        )
        self._door, self._address = door, ""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        transport = cast(asyncio.Transport, transport)  # uvloop's are none by descent
        address = str((transport.get_extra_info("peername") or ("",))[0])
        if not self._door.enter(address):
            transport.write(b"HTTP/1.1 503 Busy\r\nRetry-After: 5\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
            transport.close()
            return
        self._address = address
        bulk(transport.get_extra_info("socket"), STALL_S)
        super().connection_made(transport)

    def connection_lost(self, exc: BaseException | None) -> None:
        if self._address:
            self._door.leave(self._address)
            super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        if self._address:
            super().data_received(data)

    def handle_error(
        self, request: web.BaseRequest, status: int = 500, exc: BaseException | None = None, message: str | None = None
    ) -> web.StreamResponse:
        """A visitor's own mistakes are told to nobody else: he could fill the log with them."""
        if status >= 500:
            return super().handle_error(request, status, exc, message)
        refused = web.Response(status=status, text=message)
        refused.force_close()
        return refused


class Site:
    """What is answered. One method a place."""

    def __init__(self, settings: config.Vehicle, board: Board) -> None:
        self._board, self._console = board, settings.httpd.console
        self._jail = Jail(settings.log.directory)
        self._workers = ThreadPoolExecutor(2, "httpd")
        self._places: dict[str, Callable[[web.BaseRequest], Awaitable[web.StreamResponse]]] = {
            "/": self._boat,
            "/events": self._events,
            "/checks": self._checks,
            "/metrics": self._metrics,
            "/api/state": self._state,
            "/api/checks": self._api_checks,
            "/api/schema": self._schema,
        }

    def close(self) -> None:
        self._workers.shutdown(wait=False, cancel_futures=True)

    async def answer(self, request: web.BaseRequest) -> web.StreamResponse:
        self._board.requests += 1
        if not _is_ours(request.headers.get("Host", "")):
            return _refused(403, "Open this page by the boat's address.")
        path = unquote(request.rel_url.raw_path, errors="surrogateescape")
        if request.method not in ("GET", "HEAD"):
            refusal = _refused(405, "Here is only something to read.", {"Allow": "GET, HEAD"})
            refusal.force_close()  # and what was to be uploaded is not read
            return refusal
        if place := self._places.get(path):
            return await place(request)
        if path == "/logs":
            return web.Response(status=308, headers={**HEADERS, "Location": "/logs/"})
        if path.startswith("/logs/"):
            try:
                return await self._logs(request, path.removeprefix("/logs"))
            except (DelfimError, OSError):
                pass
        return _refused(404, "There is nothing here.")

    async def _boat(self, request: web.BaseRequest) -> web.StreamResponse:
        return _html(document.live(await self._board.sections(), _every_s(request), self._console))

    async def _events(self, request: web.BaseRequest) -> web.StreamResponse:
        """Server-sent events: the sections that have changed. A client that is behind misses some; there is no queue."""
        every_s = _every_s(request)
        response = web.StreamResponse(headers={**HEADERS, "Content-Type": "text/event-stream"})
        await response.prepare(request)
        sent: dict[str, str] = {}
        behind_s = 0.0
        while request.method == "GET" and request.transport is not None and behind_s < STALL_S:
            if request.transport.get_write_buffer_size():
                behind_s += every_s
            else:
                behind_s = 0.0
                now = await self._board.sections()
                changed = {id_: html for id_, html in now.items() if sent.get(id_) != html}
                await response.write(b"data: " + _encode(changed) + b"\n\n")
                sent = dict(now)
            await asyncio.sleep(every_s)
        if request.transport is not None and behind_s:
            request.transport.abort()
        return response

    async def _checks(self, request: web.BaseRequest) -> web.StreamResponse:
        report = await self._board.report()
        return _html(_checks_page(report))

    async def _metrics(self, request: web.BaseRequest) -> web.StreamResponse:
        text = metrics.metrics(await self._board.report())
        return web.Response(body=text.encode(), headers={**HEADERS, "Content-Type": metrics.CONTENT_TYPE})

    async def _state(self, request: web.BaseRequest) -> web.StreamResponse:
        return _json(_encode(await self._board.report()))

    async def _api_checks(self, request: web.BaseRequest) -> web.StreamResponse:
        vehicle = (await self._board.report()).vehicle
        return _json(_encode(vehicle.checks if vehicle else ()))

    async def _schema(self, request: web.BaseRequest) -> web.StreamResponse:
        return _json(json.dumps(await self._work(api.schema)).encode())

    async def _logs(self, request: web.BaseRequest, path: str) -> web.StreamResponse:
        """A directory as a page, a file in the ranges that were asked for."""
        if path.endswith("/"):
            found, is_all = await self._work(files.entries, self._jail, path)
            return _html(_listing(path, found, is_all))
        if await self._work(files.is_directory, self._jail, path):
            return web.Response(status=308, headers={**HEADERS, "Location": quote(os.fsencode(f"/logs{path}/"))})
        file = await self._work(files.opened, self._jail, path)
        try:
            return await self._send(request, file, path)
        finally:
            os.close(file.fd)

    async def _send(self, request: web.BaseRequest, file: files.Opened, path: str) -> web.StreamResponse:
        asked = request.headers.get("Range")
        if request.headers.get("If-Range", file.tag) != file.tag:
            asked = None  # it has grown or is another one: all of it
        try:
            part = files.byte_range(asked, file.bytes)
        except FormatError:
            return _refused(416, "Not so long.", {"Content-Range": f"bytes */{file.bytes}"})
        start, stop = part or (0, file.bytes)
        response = web.StreamResponse(status=206 if part else 200, headers=HEADERS)
        response.headers["Content-Type"] = "application/octet-stream"
        response.headers["Content-Disposition"] = f"attachment; filename*=UTF-8''{quote(readable(path.rpartition('/')[2]))}"
        response.headers["Accept-Ranges"], response.headers["ETag"] = "bytes", file.tag
        if part:
            response.headers["Content-Range"] = f"bytes {start}-{stop - 1}/{file.bytes}"
        response.content_length = stop - start
        await response.prepare(request)
        while request.method == "GET" and start < stop:
            chunk = await self._work(os.pread, file.fd, min(CHUNK_BYTES, stop - start), start)
            if not chunk:
                raise ConnectionResetError("the file was cut while it was sent")
            start += len(chunk)
            try:
                async with asyncio.timeout(STALL_S):
                    await response.write(chunk)
            except TimeoutError:
                if request.transport is not None:
                    request.transport.abort()
                raise ConnectionResetError("nobody reads") from None
        return response

    async def _work(self, do: Callable[..., T], *arguments: Any) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._workers, do, *arguments)


async def serve(runtime: Runtime) -> None:
    """The service."""
    settings, loop = runtime.config, asyncio.get_running_loop()
    door = Door(settings.httpd.connections, settings.httpd.connections_per_address)
    look = Look(settings, runtime.clock.monotonic_s)
    board = Board(runtime, look, door)
    site = Site(settings, board)
    server = web.Server(site.answer, handler_cancellation=True)
    async with contextlib.AsyncExitStack() as links:
        links.callback(site.close)
        links.push_async_callback(look.close)
        links.callback(board.feed.close)
        links.callback(_hang_up, server)
        place = config.address(settings.httpd.listen)
        listener = await loop.create_server(lambda: Connection(server, door), *place, backlog=BACKLOG)
        links.callback(listener.close)
        address = "http://{}:{}/".format(*listener.sockets[0].getsockname()[:2])
        runtime.board["httpd"] = lambda: {"address": address, **board.figures()}
        links.callback(runtime.board.pop, "httpd")
        log.warning("httpd: %s", address)
        while True:
            with contextlib.suppress(OSError):  # no room for a child now: the page says how old the last look is
                await look.start()
            await asyncio.sleep(AGAIN_S)


def _hang_up(server: web.Server) -> None:
    for connection in server.connections:
        if connection.transport is not None:
            connection.transport.abort()  # its handler is cancelled


def _is_ours(host: str) -> bool:
    """Whether this can be the boat's name: an address, or a name of a local network. Of a name of the Internet somebody else
    may say that it points here, and a page of his would read the boat."""
    name = host.rpartition(":")[0] if _PORT.search(host) else host
    try:
        return bool(ip_address(name.strip("[]")))
    except ValueError:
        return bool(_LOCAL.fullmatch(name.lower()))


def _every_s(request: web.BaseRequest) -> float:
    """/?every=10: for a thin radio."""
    try:
        asked_s = float(request.rel_url.query.get("every", ""))
    except ValueError:
        return EVERY_S[0]
    return min(max(asked_s, EVERY_S[0]), EVERY_S[1]) if asked_s == asked_s else EVERY_S[0]


def _html(text: str) -> web.Response:
    return web.Response(body=text.encode(), headers={**HEADERS, "Content-Type": "text/html; charset=utf-8"})


def _json(body: bytes) -> web.Response:
    return web.Response(body=body, headers={**HEADERS, "Content-Type": "application/json"})


def _refused(status: int, words: str, more: dict[str, str] | None = None) -> web.Response:
    return web.Response(status=status, text=words + "\n", headers={**HEADERS, **(more or {})})


def _checks_page(report: Report) -> str:
    lines = report.vehicle.checks if report.vehicle else ()
    bad = [line for line in lines if not line.ok]
    if not lines:
        mood, title = "bad", "Not known"
    elif bad:
        mood, title = "warn", f"{len(bad)} of {len(lines)} not in order"
    else:
        mood, title = "good", "All in order"
    rows = "".join(
        f'<li class="{kind}"><b>{mark} {escape(line.name)}</b> {escape(line.reason)}</li>'
        for line in lines
        for kind, mark in [("good", "✓") if line.ok else ("bad", "✗")]
    )
    reason = f"<p>{escape(report.reason or page.GONE)}</p>" if report.vehicle is None else ""
    boat = escape(report.vehicle.boat) if report.vehicle else ""
    head = f'<div class="band {mood}"><p>{boat}</p><h1>{title}</h1><p class="why">Before the start</p></div>'
    return document.plain("Before the start", f'{reason}<ul class="lines checks">{rows}</ul>', head)


def _listing(path: str, found: list[files.Entry], is_all: bool) -> str:
    rows = []
    for each in found:
        slash = "/" if each.is_directory else ""
        at = datetime.fromtimestamp(each.mtime_s, UTC)
        length = "" if each.is_directory else page.size(each.bytes)
        link = f'<a href="{quote(os.fsencode("./" + each.name), safe="./")}{slash}">{escape(readable(each.name))}{slash}</a>'
        what = escape(files.meaning(path, each))
        rows.append(f'<tr><th>{link}</th><td class="what">{what}</td><td>{length}</td><td>{at:%Y-%m-%d %H:%M:%S}</td></tr>')
    head = '<thead><tr><th>name</th><td class="what">what it is</td><td>size</td><td>last written, UTC</td></tr></thead>'
    more = "" if is_all else f'<p class="small">The first {files.ENTRIES_MAX}; the rest over FTP or SFTP.</p>'
    table = document.table([head, *rows]) if rows else '<p class="none">empty</p>'
    return document.plain(f"Logs {readable(path)}", f'<p class="trail">{_trail(path)}</p>{table}{more}')


def _trail(path: str) -> str:
    """The way back up, each step a link."""
    steps = [step for step in path.split("/") if step]
    links = [
        f'<a href="{"../" * (len(steps) - n) or "./"}">{escape(readable(step))}</a>' for n, step in enumerate(["Logs", *steps])
    ]
    return " › ".join(links)
