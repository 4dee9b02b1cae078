"""httpd: the boat's page (thesis 3.3), live; the same as JSON and for Prometheus; the logs to take away. It changes nothing.

A cooperative service: slow work is done elsewhere, the look at the computer in a child (`delfim.services.computer`), files
in two workers. The vehicle is asked over its local command socket, and only while somebody looks, so that the page is the same
from the runtime and from a process of its own. No client is waited for: connections, headers, idle time and unread data are
bounded. How to use it: docs/httpd.md.
"""

import asyncio
import contextlib
import json
import logging
import os
import re
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from ipaddress import ip_address
from typing import Any, Final, TypeVar, cast
from urllib.parse import quote, unquote

import msgspec
from aiohttp import web

from delfim import config
from delfim.base.errors import DelfimError, FormatError
from delfim.base.ranges import address
from delfim.logging import systemlog
from delfim.logging.ashore.tree import readable
from delfim.services.access.connection_limits import ConnectionLimits, bulk
from delfim.services.files.jail import Jail
from delfim.services.files.threads import worked
from delfim.services.page import api, document, files, metrics, saidlines
from delfim.services.page.board import Board, Lookout
from delfim.services.page.subpages import checks_page, listing, system_page
from delfim.services.runtime import Runtime
from delfim.services.tables import Httpd

EVERY_S: Final = (1.0, 60.0)  # between two events of a page
IDLE_S: Final = 15.0  # for a request to arrive, and between two of them
STALL_S: Final = 20.0  # a client that reads nothing for so long is gone
AGAIN_S: Final = 5.0  # before a look at the computer that failed is tried again
CHUNK_BYTES: Final = 64 << 10  # of a file
SLICE: Final = 50  # lines of the system log that a callback looks at
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
_encode: Final = msgspec.json.Encoder().encode


class HttpConnection(web.RequestHandler):
    """aiohttp's connection with our connection limits."""

    __slots__ = ("_address", "_door")

    def __init__(self, server: web.Server, door: ConnectionLimits) -> None:
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
        transport = cast(asyncio.Transport, transport)  # uvloop's transports do not inherit asyncio.Transport
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
        """Answer a visitor's mistake without logging it: he could fill the log with them."""
        if status >= 500:
            return super().handle_error(request, status, exc, message)
        refused = web.Response(status=status, text=message)
        refused.force_close()
        return refused


class Site:
    """The answers of the site, one method for each path."""

    def __init__(self, settings: config.Vehicle, board: Board) -> None:
        self._board, self._console = board, settings.of(Httpd).console
        self._jail, self._run_directory = Jail(settings.log.directory), settings.runtime.run_directory
        self._workers = ThreadPoolExecutor(2, "httpd")
        self._places: dict[str, Callable[[web.BaseRequest], Awaitable[web.StreamResponse]]] = {
            "/": self._boat,
            "/events": self._events,
            "/checks": self._checks,
            "/system": self._system,
            "/metrics": self._metrics,
            "/api/state": self._state,
            "/api/checks": self._api_checks,
            "/api/system": self._api_system,
            "/api/schema": self._schema,
        }

    def close(self) -> None:
        self._workers.shutdown(wait=False, cancel_futures=True)

    async def answer(self, request: web.BaseRequest) -> web.StreamResponse:
        self._board.requests += 1
        if not _is_ours(request.headers.get("Host", "")):
            return _refused(403, "Open this page by the boat's IP address.")
        path = unquote(request.rel_url.raw_path, errors="surrogateescape")
        if request.method not in ("GET", "HEAD"):
            refusal = _refused(405, "This page is read-only.", {"Allow": "GET, HEAD"})
            refusal.force_close()  # and its body is not read
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
        return _refused(404, "No such page.")

    async def _boat(self, request: web.BaseRequest) -> web.StreamResponse:
        return _html(document.live(await self._board.sections(), _every_s(request), self._console))

    async def _events(self, request: web.BaseRequest) -> web.StreamResponse:
        """Send server-sent events: the sections that have changed. A client that is behind misses some; there is no queue."""
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
        return _html(checks_page(report))

    async def _metrics(self, request: web.BaseRequest) -> web.StreamResponse:
        text = metrics.metrics(await self._board.report())
        return web.Response(body=text.encode(), headers={**HEADERS, "Content-Type": metrics.CONTENT_TYPE})

    async def _state(self, request: web.BaseRequest) -> web.StreamResponse:
        return _json(_encode(await self._board.report()))

    async def _api_checks(self, request: web.BaseRequest) -> web.StreamResponse:
        vehicle = (await self._board.report()).vehicle
        return _json(_encode(vehicle.checks if vehicle else ()))

    async def _system(self, request: web.BaseRequest) -> web.StreamResponse:
        return _html(system_page(*await self._said(request)))

    async def _api_system(self, request: web.BaseRequest) -> web.StreamResponse:
        return _json(_encode((await self._said(request))[1]))

    async def _said(self, request: web.BaseRequest) -> tuple[saidlines.WantedLines, list[api.LogLine]]:
        """The last lines of the system log that a visitor wants."""
        query = request.rel_url.query
        wanted, found = saidlines.wanted(query.get("level", ""), query.get("text", "")), list[api.LogLine]()
        for count, line in enumerate(saidlines.parsed(await self._work(systemlog.recent, self._run_directory))):
            if count % SLICE == 0:
                await asyncio.sleep(0)
            if line is not None and wanted.has(line):
                found.append(line)
                if len(found) == saidlines.LINES_MAX:
                    break
        return wanted, found

    async def _schema(self, request: web.BaseRequest) -> web.StreamResponse:
        return _json(json.dumps(await self._work(api.schema)).encode())

    async def _logs(self, request: web.BaseRequest, path: str) -> web.StreamResponse:
        """Send a directory as a page, or a file in the requested ranges."""
        if path.endswith("/"):
            found, is_all = await self._work(files.entries, self._jail, path)
            return _html(listing(path, found, is_all))
        if await self._work(files.is_directory, self._jail, path):
            return web.Response(status=308, headers={**HEADERS, "Location": quote(os.fsencode(f"/logs{path}/"))})
        with contextlib.ExitStack() as closing:
            return await self._send(request, await self._work(files.opened, closing, self._jail, path), path)

    async def _send(self, request: web.BaseRequest, file: files.OpenFile, path: str) -> web.StreamResponse:
        asked = request.headers.get("Range")
        if request.headers.get("If-Range", file.tag) != file.tag:
            asked = None  # it has grown or is another one: send all of it
        try:
            part = files.byte_range(asked, file.bytes)
        except FormatError:
            return _refused(416, "The file is shorter.", {"Content-Range": f"bytes */{file.bytes}"})
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
                raise ConnectionResetError("the client does not read") from None
        return response

    async def _work(self, do: Callable[..., T], *arguments: Any) -> T:
        return await worked(self._workers, do, *arguments)


async def serve(runtime: Runtime) -> None:
    """Run the service until it is cancelled."""
    settings, loop = runtime.config, asyncio.get_running_loop()
    door = ConnectionLimits(settings.of(Httpd).connections, settings.of(Httpd).connections_per_address)
    look = Lookout(settings, runtime.clock.monotonic_s)
    board = Board(runtime, look, door)
    site = Site(settings, board)
    server = web.Server(site.answer, handler_cancellation=True)
    async with contextlib.AsyncExitStack() as links:
        links.callback(site.close)
        links.push_async_callback(look.close)
        links.callback(board.feed.close)
        links.callback(_hang_up, server)
        place = address(settings.of(Httpd).listen)
        listener = await loop.create_server(lambda: HttpConnection(server, door), *place, backlog=BACKLOG)
        links.callback(listener.close)
        url = "http://{}:{}/".format(*listener.sockets[0].getsockname()[:2])
        links.enter_context(runtime.publishing("httpd", lambda: {"address": url, **board.figures()}))
        log.warning("httpd: %s", url)
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
    """The period of `/?every=10`, s, for a thin radio."""
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
