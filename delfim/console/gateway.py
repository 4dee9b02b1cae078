"""`delfim console`: the gateway between the boats and the page, one process on the operator's computer.

Boats by UDP, the page and its WebSocket by HTTP on loopback; other devices need the token. What is said on the WebSocket stands
in docs/console.md. All that decides anything is in `Fleet`; here are sockets and time.
"""

import argparse
import asyncio
import hmac
import json
import logging
import secrets
import signal
import socket
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from ipaddress import ip_address
from pathlib import Path
from typing import Any, Final, cast

from aiohttp import WSMsgType, web

from delfim import __version__
from delfim.clock import Clock, WakefulClock
from delfim.console.browser import show
from delfim.console.charts import Charts
from delfim.console.dryrun import dry_run
from delfim.console.fleet import Fleet
from delfim.console.library import Library
from delfim.console.mavlink import Key
from delfim.console.radio import radio
from delfim.console.replay import Replay, open_tapes
from delfim.console.session import Session
from delfim.console.tape import Tape
from delfim.errors import ConfigError, DelfimError, FormatError, Refused

PAGE: Final = Path(__file__).with_name("page")
TICK_S: Final = 0.05
SHOW_TICKS: Final = 2  # ten times a second
CHUNK: Final = 500  # points of a track in one message
BACKLOG_BYTES: Final = 1 << 20  # a page that is so far behind misses what is not the newest
IPTOS_LOWDELAY: Final = 0x10
PAGES_MAX: Final = 8
DRY_RUNS_MAX: Final = 2
QUEUE_MAX: Final = 1000  # messages to one of them
MESSAGE_BYTES: Final = 1 << 20

log = logging.getLogger(__name__)


class Udp(asyncio.DatagramProtocol):
    """One UDP socket for all boats: whoever speaks to it is answered there."""

    def __init__(self, receive: Callable[[Any, bytes], None]) -> None:
        self._receive = receive
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)
        with suppress(OSError, AttributeError):  # not every system lets a program set it
            transport.get_extra_info("socket").setsockopt(socket.IPPROTO_IP, socket.IP_TOS, IPTOS_LOWDELAY)

    def datagram_received(self, data: bytes, address: Any) -> None:
        self._receive(("udp", *address[:2]), data)

    def error_received(self, exc: Exception) -> None:
        """Nobody at the other end, now: the ages say it."""

    def send(self, address: Any, data: bytes) -> None:
        if self._transport is not None:
            self._transport.sendto(data, address[1:])


class Page:
    """One browser. Messages beyond BACKLOG_BYTES are left out, but for answers."""

    def __init__(self, link: web.WebSocketResponse, request: web.Request) -> None:
        self._link, self._request = link, request
        self.queue: asyncio.Queue[str | None] = asyncio.Queue(maxsize=QUEUE_MAX + 1)  # None: the end
        self.steers: set[int] = set()  # boats that this page gives input to

    def tell(self, message: dict[str, Any]) -> None:
        transport = self._request.transport
        behind = transport is None or transport.get_write_buffer_size() > BACKLOG_BYTES
        if self.queue.qsize() >= QUEUE_MAX or (behind and message["t"] in ("boats", "progress")):
            return
        self.queue.put_nowait(json.dumps(message))

    def end(self) -> None:
        self.queue.put_nowait(None)

    async def write(self) -> None:
        """Until the connection ends."""
        with suppress(ConnectionError):
            while (text := await self.queue.get()) is not None:
                await self._link.send_str(text)


class Gateway:
    """The pages, and what they may ask."""

    def __init__(
        self,
        clock: Clock,
        missions: Path,
        key: Key | None = None,
        token: str = "",
        vehicle: Path | None = None,
        *,
        charts: Path | None = None,
        radios: Sequence[str] = (),
        sessions: Path | None = None,
        tapes: Sequence[Tape] = (),
    ) -> None:
        self.udp = Udp(self._receive)
        self.radios = {each.device: each for each in (radio(words, self._receive) for words in radios)}
        self.session = Session(sessions, clock) if sessions is not None and not tapes else None
        self.charts = Charts(charts)
        self.fleet: Fleet | Replay
        if tapes:
            self.fleet = Replay(tapes, clock, self.tell)
            self.fleet.moved = self._show_tracks_to_all
        else:
            self.fleet = Fleet(clock, self._transmit, self.tell, key)
            if self.session is not None:
                self.fleet.record = self.session.put
        self._complaints: dict[str, str] = {}  # what was said of links and files, not to say it again
        self.token = token
        self._clock, self._library, self._pages = clock, Library(missions), set[Page]()
        self._vehicle, self._dry_runs = vehicle, 0
        self._ticks = 0
        self.app = web.Application(middlewares=[self._admit], client_max_size=MESSAGE_BYTES)
        self.app.router.add_get("/", self._index)
        self.app.router.add_get("/ws", self._socket)
        self.app.router.add_get("/api/boats", self._boats)
        self.charts.routes(self.app)
        if PAGE.is_dir():
            self.app.router.add_static("/", PAGE)

    def close(self) -> None:
        """After the last tick."""
        for each in self.radios.values():
            each.close()
        if self.session is not None:
            self.session.flush()
        self.charts.close()

    def tell(self, message: dict[str, Any]) -> None:
        """To every page."""
        for page in self._pages:
            page.tell(message)

    def tick(self) -> None:
        self.fleet.tick()
        if self.session is not None:
            self.session.tick()
            self._complain("the session is not recorded", self.session.reason)
        for name, each in self.radios.items():
            self._complain(name, each.reason)
        self._ticks += 1
        if self._pages and self._ticks % SHOW_TICKS == 0:
            self.tell({"t": "boats", "at_s": self._utc_s(), "boats": self.fleet.snapshot()})
            for progress in self.fleet.progress():
                self.tell(progress)

    def _complain(self, name: str, reason: str) -> None:
        """Once for each reason."""
        if reason != self._complaints.get(name, ""):
            self._complaints[name] = reason
            self.tell(self._text(f"{name}: {reason or 'all is well again'}"))

    def _text(self, words: str) -> dict[str, Any]:
        """A warning that is no boat's."""
        return {"t": "text", "boat": None, "severity": 4, "text": words, "at_s": self._utc_s()}

    def _receive(self, address: Any, data: bytes) -> None:
        self.fleet.receive(address, data)

    def _transmit(self, address: Any, data: bytes) -> None:
        if address[0] == "serial":
            self.radios[address[1]].send(data)
        else:
            self.udp.send(address, data)

    @web.middleware
    async def _admit(self, request: web.Request, handler: Callable[[web.Request], Any]) -> web.StreamResponse:
        """This computer, and who knows the token. A page of another site may not speak for its visitor."""
        origin = request.headers.get("Origin")
        if origin is not None and origin.partition("://")[2] != request.host:
            raise web.HTTPForbidden(text="another site's page\n")
        if not _is_own(request):
            given = request.query.get("token") or request.cookies.get("token") or ""
            if not self.token or not hmac.compare_digest(given, self.token):
                raise web.HTTPForbidden(text="this console is for its own computer; others open it with ?token=...\n")
        response: web.StreamResponse = await handler(request)
        if self.token and "token" in request.query and not response.prepared:
            response.set_cookie("token", self.token, httponly=True, samesite="Strict")
        return response

    async def _index(self, request: web.Request) -> web.StreamResponse:
        if not (PAGE / "index.html").exists():
            raise web.HTTPNotFound(text="the page was not built: make page\n")
        return web.FileResponse(PAGE / "index.html", headers={"Cache-Control": "no-cache"})

    async def _boats(self, request: web.Request) -> web.Response:
        return web.json_response(self.fleet.snapshot())

    async def _socket(self, request: web.Request) -> web.WebSocketResponse:
        if len(self._pages) >= PAGES_MAX:
            raise web.HTTPServiceUnavailable(text="too many pages are open\n")
        link = web.WebSocketResponse(heartbeat=5.0, max_msg_size=MESSAGE_BYTES)
        await link.prepare(request)
        page = Page(link, request)
        self._greet(page)
        self._pages.add(page)
        try:
            await asyncio.gather(self._listen(page, link), page.write())
        finally:
            self._pages.discard(page)
            for number in page.steers:
                self.fleet.release(number, "the page was closed")
        return link

    async def _listen(self, page: Page, link: web.WebSocketResponse) -> None:
        try:
            async for message in link:
                if message.type is WSMsgType.TEXT:
                    self._hear(page, message.data)
        finally:
            page.end()

    def _greet(self, page: Page) -> None:
        fleet = self.fleet
        page.tell(
            {
                "t": "hello",
                "version": __version__,
                "me": "console",
                "backgrounds": self.charts.backgrounds,
                "boats": fleet.snapshot(),
                "replay": {"from_s": fleet.from_s, "to_s": fleet.to_s} if isinstance(fleet, Replay) else None,
            }
        )
        for fault in (*self.charts.faults, *(f"{name}: {reason}" for name, reason in self._complaints.items() if reason)):
            page.tell(self._text(fault))
        self._show_tracks(page)
        for number, missions in fleet.missions.items():
            for where, mission in missions.items():
                page.tell({"t": "mission", "boat": number, "where": where, "mission": mission})

    def _show_tracks_to_all(self) -> None:
        for page in self._pages:
            self._show_tracks(page)

    def _show_tracks(self, page: Page) -> None:
        for number, boat in self.fleet.boats.items():
            points = list(boat.track)
            for at in range(0, max(len(points), 1), CHUNK):
                page.tell({"t": "track", "boat": number, "start": at == 0, "points": points[at : at + CHUNK]})

    def _hear(self, page: Page, text: str) -> None:
        """A message of a page. What it gets wrong it is told."""
        sequence: Any = None
        try:
            asked = json.loads(text)
            sequence = asked.get("seq")
            self._ask(page, asked, partial(_answer, page, sequence))
        except DelfimError as error:
            _answer(page, sequence, False, str(error))
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            _answer(page, sequence, False, f"not understood: {type(error).__name__}: {error}")

    def _ask(self, page: Page, asked: dict[str, Any], answer: Callable[[bool, str], None]) -> None:
        fleet = self.fleet
        match asked["t"]:
            case "input":
                page.steers.add(int(asked["boat"]))
                fleet.input(int(asked["boat"]), int(asked["n"]), float(asked["port_pct"]), float(asked["starboard_pct"]))
            case "release":
                fleet.release(int(asked["boat"]), str(asked.get("why", ""))[:80])
            case "command" if asked["boat"] == "all":
                if asked["command"] != "stop":
                    raise Refused("only stop is for all boats")
                fleet.release_all("stop")
                for number in list(fleet.boats):
                    fleet.command(number, "stop", {}, answer)
            case "command":
                if asked["command"] == "stop":
                    fleet.release(int(asked["boat"]), "stop")
                fleet.command(int(asked["boat"]), str(asked["command"]), asked, answer)
            case "profile":
                fleet.command(int(asked["boat"]), "profile", {"profile": str(asked["profile"])}, answer)
            case "replay":
                if not isinstance(fleet, Replay):
                    raise Refused("nothing is being replayed")
                fleet.steer(asked)
                answer(True, "")
            case "mission":
                self._mission(page, int(asked["boat"]), asked, answer)
            case other:
                raise FormatError(f"no message {other!r}")

    def _mission(self, page: Page, number: int, asked: dict[str, Any], answer: Callable[[bool, str], None]) -> None:
        fleet = self.fleet
        match asked["do"]:
            case "put":
                fleet.put(number, asked["mission"])
                answer(True, "")
            case "upload":
                if "mission" in asked:
                    fleet.put(number, asked["mission"])
                fleet.upload(number, answer)
            case "download" | "compare":
                fleet.download(number, answer)
            case "dryrun":
                self._dry_run(page, number, asked, answer)
            case "save":
                self._library.save(asked["mission"])
                answer(True, "")
            case "load":
                mission = self._library.load(str(asked["name"]))
                fleet.put(number, mission)
                page.tell({"t": "mission", "boat": number, "where": "here", "mission": mission})
                answer(True, "")
            case "list":
                page.tell({"t": "missions", "names": self._library.names()})
                answer(True, "")
            case other:
                raise FormatError(f"missions cannot {other!r}")

    def _dry_run(self, page: Page, number: int, asked: dict[str, Any], answer: Callable[[bool, str], None]) -> None:
        if self._vehicle is None:
            raise Refused("no dry run without the vehicle's file: delfim console --vehicle FILE")
        if self._dry_runs >= DRY_RUNS_MAX:
            raise Refused("dry runs are under way already")
        boat = self.fleet.boats.get(number)
        known = boat is not None and boat.values.get("latitude_deg") is not None
        start = (boat.values["latitude_deg"], boat.values["longitude_deg"]) if boat is not None and known else None
        self._dry_runs += 1

        def ended(future: "asyncio.Future[dict[str, Any]]") -> None:
            self._dry_runs -= 1
            if not future.cancelled():
                result = future.result()
                page.tell({"t": "dryrun", "boat": number, "seq": asked.get("seq"), **result})
                answer(result["well"], "" if result["well"] else result["end"])

        loop = asyncio.get_running_loop()
        loop.run_in_executor(None, dry_run, self._vehicle, asked["mission"], start).add_done_callback(ended)

    def _utc_s(self) -> float:
        """The time that pages show."""
        return round(self.fleet.at_s if isinstance(self.fleet, Replay) else self._clock.time_ns() / 1e9, 3)


def _answer(page: Page, sequence: Any, well: bool, reason: str) -> None:
    if sequence is not None:
        page.tell({"t": "answer", "seq": sequence, "ok": well, "reason": reason})


def _is_own(request: web.Request) -> bool:
    try:
        return ip_address(request.remote or "").is_loopback
    except ValueError:
        return False


async def serve(gateway: Gateway, boats: tuple[str, int] | None, page: tuple[str, int], ready: Callable[[str], None]) -> None:
    """Until cancelled; without `boats` no UDP is heard. Raises ConfigError for an address that cannot be had."""
    loop = asyncio.get_running_loop()
    runner = web.AppRunner(gateway.app, access_log=None, shutdown_timeout=1.0)
    transport: asyncio.DatagramTransport | None = None
    try:
        if boats is not None:
            with _refused("--boats", boats):
                transport, _ = await loop.create_datagram_endpoint(lambda: gateway.udp, local_addr=boats)
        await runner.setup()
        with _refused("--page", page):
            await web.TCPSite(runner, *page).start()
        for each in gateway.radios.values():
            each.start()
        port = runner.addresses[0][1]
        ready(f"http://{page[0]}:{port}/" + (f"?token={gateway.token}" if gateway.token else ""))
        while True:
            await asyncio.sleep(TICK_S)
            gateway.tick()
    finally:
        gateway.fleet.release_all("the console ended")
        await runner.cleanup()
        if transport is not None:
            transport.close()
        gateway.close()


@contextmanager
def _refused(option: str, address: tuple[str, int]) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise ConfigError(option, f"{address[0]}:{address[1]}", str(error.strerror)) from None


def run(asked: argparse.Namespace) -> int:
    """The command."""
    host, port = _address(asked.page)
    token = "" if ip_address(host).is_loopback else secrets.token_urlsafe(12)
    tapes = open_tapes([Path(each) for each in asked.replay]) if asked.replay else []
    gateway = Gateway(
        WakefulClock(),
        Path(asked.missions),
        Key(Path(asked.key)) if asked.key else None,
        token,
        Path(asked.vehicle) if asked.vehicle else None,
        charts=Path(asked.charts),
        radios=() if tapes else asked.radio,
        sessions=Path(asked.sessions),
        tapes=tapes,
    )

    def ready(url: str) -> None:
        what = (
            f"{len(tapes)} recordings are replayed" if tapes else f"boats are heard on {', '.join([asked.boats, *asked.radio])}"
        )
        print(f"delfim: the console is at {url}; {what}", flush=True)
        for complaint in filter(None, [*gateway.charts.faults, *(tape.complaint for tape in tapes)]):
            print(f"delfim: {complaint}", file=sys.stderr)
        if asked.browser:
            show(url)

    signal.signal(signal.SIGTERM, signal.default_int_handler)  # in order: zero to what is steered, the session to the disk
    with suppress(KeyboardInterrupt):
        asyncio.run(serve(gateway, None if tapes else _address(asked.boats), (host, port), ready))
    return 0


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    try:
        ip_address(host)
        if not 0 <= int(port) < 1 << 16:
            raise ValueError
        return host, int(port)
    except ValueError:
        raise ConfigError("command line", text, "no address", "ADDRESS:PORT") from None
