"""`delfim console`: the gateway between the boats and the page, one process on the operator's computer.

Boats by UDP, the page and its WebSocket by HTTP on loopback; other devices need the token. What is said on the WebSocket stands
in docs/console.md. All that decides anything is in `Fleet`; here are sockets and time.
"""

import argparse
import asyncio
import errno
import hashlib
import hmac
import json
import logging
import os
import re
import secrets
import signal
import socket
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from ipaddress import IPv4Address, IPv6Address, ip_address
from pathlib import Path
from typing import Any, Final, cast

import msgspec
from aiohttp import WSMsgType, web
from aiohttp.http_exceptions import HttpProcessingError

from delfim import __version__
from delfim.clock import Clock, WakefulClock
from delfim.console import said
from delfim.console.browser import show
from delfim.console.charts import Charts
from delfim.console.dryrun import dry_run
from delfim.console.fleet import Fleet
from delfim.console.library import Library
from delfim.console.mavlink import Key
from delfim.console.orders import OFFERED
from delfim.console.radio import radio
from delfim.console.replay import Replay, open_tapes
from delfim.console.session import Session
from delfim.console.tape import Tape
from delfim.errors import ConfigError, DelfimError, FormatError, Refused
from delfim.eventloop import new_event_loop
from delfim.outside import read_text

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
TOKEN_BYTES: Final = 12
NUMBERS: Final = range(200, 255)  # of consoles; QGroundControl and MAVProxy have 255
_TOKEN: Final = re.compile(r"[\w-]{16}", re.ASCII)
LOOPBACK: Final = ("127.0.0.1", "localhost", "[::1]")

log = logging.getLogger(__name__)


def encoded(message: Any) -> str:
    """JSON, in which a number that is not finite is null: a browser takes nothing else."""
    return msgspec.json.encode(message).decode()


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
        self.queue.put_nowait(encoded(message))

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
        number: int | None = None,
    ) -> None:
        self.udp = Udp(self._receive)
        self.radios = {each.device: each for each in (radio(words, self._receive) for words in radios)}
        self.session = Session(sessions, clock) if sessions is not None and not tapes else None
        self.charts = Charts(charts)
        self.token = token or secrets.token_urlsafe(TOKEN_BYTES)
        self.me = number or own_number(self.token)
        self.fleet: Fleet | Replay
        if tapes:
            self.fleet = Replay(tapes, clock, self.tell)
            self.fleet.moved = self._show_tracks_to_all
        else:
            self.fleet = Fleet(clock, self._transmit, self.tell, key, self.me)
            if self.session is not None:
                self.fleet.record = self.session.put
        self._complaints: dict[str, str] = {}  # what was said of links and files, not to say it again
        self.heard_on: list[str] = [*self.radios]  # where boats are, in words
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
        """Who knows the token, which is in the address that the console prints, and then in a cookie. A page of another site
        may not speak for its visitor. On this computer only its own names count: of another its owner may say that it is here.
        """
        host, (own, port) = request.headers.get("Host", ""), _end(request)
        if own.is_loopback and host.lower() not in {f"{name}:{port}" for name in (_bracketed(own), *LOOPBACK)}:
            raise web.HTTPForbidden(text=f"this console is at http://{_bracketed(own)}:{port}/\n")
        if request.headers.get("Origin", f"http://{host}") != f"http://{host}" or not host:
            raise web.HTTPForbidden(text="another site's page\n")
        cookie = f"delfim-{port}"  # a browser keeps cookies by host, and several consoles may be on one
        given = request.query.get("token") or request.cookies.get(cookie) or ""
        if not hmac.compare_digest(given.encode(), self.token.encode()):
            raise web.HTTPForbidden(text="this console opens by the address that it printed when it started: ...?token=...\n")
        response: web.StreamResponse = await handler(request)
        if "token" in request.query and not response.prepared:
            response.set_cookie(cookie, self.token, httponly=True, samesite="Lax")  # the boat's page has a link to here
        return response

    async def _index(self, request: web.Request) -> web.StreamResponse:
        if not (PAGE / "index.html").exists():
            raise web.HTTPNotFound(text="the page was not built: make page\n")
        return web.FileResponse(PAGE / "index.html", headers={"Cache-Control": "no-cache"})

    async def _boats(self, request: web.Request) -> web.Response:
        return web.json_response(self.fleet.snapshot(), dumps=encoded)

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
                "me": self.me,
                "backgrounds": self.charts.backgrounds,
                "boats": fleet.snapshot(),
                "heard_on": self.heard_on,
                "orders": OFFERED,
                "replay": _time_line(fleet) if isinstance(fleet, Replay) else None,
            }
        )
        for fault in (*self.charts.faults, *(f"{name}: {reason}" for name, reason in self._complaints.items() if reason)):
            page.tell(self._text(fault))
        self._show_tracks(page)
        if isinstance(fleet, Replay):
            for number, track in fleet.tracks().items():
                for points in _chunks(track):
                    page.tell({"t": "whole_track", "boat": number, "points": points})
        for number, missions in fleet.missions.items():
            for where, mission in missions.items():
                page.tell({"t": "mission", "boat": number, "where": where, "mission": mission})

    def _show_tracks_to_all(self) -> None:
        for page in self._pages:
            self._show_tracks(page)

    def _show_tracks(self, page: Page) -> None:
        for number, boat in self.fleet.boats.items():
            for at, points in enumerate(_chunks(list(boat.track))):
                page.tell({"t": "track", "boat": number, "start": at == 0, "points": points})

    def _hear(self, page: Page, text: str) -> None:
        """A message of a page. What it gets wrong it is told."""
        sequence: Any = None
        try:
            asked = json.loads(text)  # which knows infinity: the number of the message is found all the same
            sequence = asked.get("seq") if isinstance(asked, dict) else None
            self._ask(page, msgspec.convert(asked, said.Message), asked, partial(_answer, page, sequence))
        except DelfimError as error:
            _answer(page, sequence, False, str(error))
        except (msgspec.MsgspecError, ValueError, TypeError, KeyError, RecursionError) as error:
            _answer(page, sequence, False, f"not understood: {error}")

    def _ask(self, page: Page, asked: said.Message, words: dict[str, Any], answer: Callable[[bool, str], None]) -> None:
        fleet = self.fleet
        match asked:
            case said.Input(boat=number):
                fleet.input(number, asked.n, asked.port_pct, asked.starboard_pct)
                page.steers.add(number)
            case said.Release(boat=number, why=why):
                fleet.release(number, why[:80])
            case said.Command(boat="all"):
                if asked.command != "stop":
                    raise Refused("only stop is for all boats")
                self._stop_all(answer)
            case said.Command(boat=int(number)):
                if asked.command == "stop":
                    fleet.release(number, "stop")
                numbers = {name: value for name, value in words.items() if name not in said.NO_NUMBERS}
                fleet.command(number, asked.command, numbers, answer)
            case said.Profile(boat=number, profile=profile):
                fleet.command(number, "profile", {"profile": profile}, answer)
            case said.Replay():
                if not isinstance(fleet, Replay):
                    raise Refused("nothing is being replayed")
                fleet.steer(asked.at_s, asked.rate)
                answer(True, "")
            case said.Mission():
                self._mission(page, asked, words.get("mission"), answer)

    def _stop_all(self, answer: Callable[[bool, str], None]) -> None:
        """Answered when every boat has answered, or one has not."""
        fleet = self.fleet
        fleet.release_all("stop")
        waiting = set(fleet.boats)

        def stopped(number: int, well: bool, why: str) -> None:
            waiting.discard(number)
            if not well:
                answer(False, f"{fleet.boats[number].name}: {why}")
            elif not waiting:
                answer(True, "")

        for number in sorted(waiting):
            fleet.command(number, "stop", {}, partial(stopped, number))
        if not fleet.boats:
            answer(False, "no boat is heard")

    def _mission(
        self, page: Page, asked: said.Mission, plan: dict[str, Any] | None, answer: Callable[[bool, str], None]
    ) -> None:
        fleet, number = self.fleet, asked.boat
        if plan is None and asked.do in ("put", "dryrun", "save"):
            raise FormatError(f"{asked.do} needs a mission")
        match asked.do:
            case "put":
                fleet.put(number, plan or {})
                answer(True, "")
            case "upload":
                if plan is not None:
                    fleet.put(number, plan)
                fleet.upload(number, answer)
            case "download" | "compare":
                fleet.download(number, answer)
            case "dryrun":
                self._dry_run(page, number, plan or {}, asked.seq, answer)
            case "save":
                self._library.save(plan or {})
                answer(True, "")
            case "load":
                mission = self._library.load(asked.name)
                if number:  # a plan may be made before a boat is heard
                    fleet.put(number, mission)
                page.tell({"t": "mission", "boat": number, "where": "here", "mission": mission})
                answer(True, "")
            case "list":
                page.tell({"t": "missions", "names": self._library.names()})
                answer(True, "")

    def _dry_run(
        self, page: Page, number: int, plan: dict[str, Any], sequence: int | None, answer: Callable[[bool, str], None]
    ) -> None:
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
                page.tell({"t": "dryrun", "boat": number, "seq": sequence, **result})
                answer(result["well"], "" if result["well"] else result["end"])

        loop = asyncio.get_running_loop()
        loop.run_in_executor(None, dry_run, self._vehicle, plan, start).add_done_callback(ended)

    def _utc_s(self) -> float:
        """The time that pages show."""
        return round(self.fleet.at_s if isinstance(self.fleet, Replay) else self._clock.time_ns() / 1e9, 3)


def _answer(page: Page, sequence: Any, well: bool, reason: str) -> None:
    if sequence is not None:
        page.tell({"t": "answer", "seq": sequence, "ok": well, "reason": reason})


def _time_line(replay: Replay) -> dict[str, Any]:
    return {"from_s": replay.from_s, "to_s": replay.to_s, "events": replay.events()}


def _chunks(points: list[tuple[float, float, float]]) -> Iterator[list[tuple[float, float, float]]]:
    """Of a track; one at least."""
    for at in range(0, max(len(points), 1), CHUNK):
        yield points[at : at + CHUNK]


def _end(request: web.Request) -> tuple[IPv4Address | IPv6Address, int]:
    """Our end of the connection."""
    if request.transport is None:
        raise web.HTTPForbidden(text="the connection is gone\n")
    host, port = request.transport.get_extra_info("sockname")[:2]
    return ip_address(host.partition("%")[0]), port


def _bracketed(address: IPv4Address | IPv6Address) -> str:
    return f"[{address}]" if address.version == 6 else str(address)


async def serve(gateway: Gateway, boats: tuple[str, int] | None, page: tuple[str, int], ready: Callable[[str], None]) -> None:
    """Until cancelled; without `boats` no UDP is heard. Raises ConfigError for an address that cannot be had."""
    loop = asyncio.get_running_loop()
    visits = logging.getLogger(f"{__name__}.visits")
    visits.addFilter(_is_news)
    runner = web.AppRunner(gateway.app, access_log=None, logger=visits, shutdown_timeout=1.0)
    transport: asyncio.DatagramTransport | None = None
    try:
        if boats is not None:
            with _refused("--boats", boats):
                transport, _ = await loop.create_datagram_endpoint(lambda: gateway.udp, local_addr=boats)
            gateway.heard_on.insert(0, f"{boats[0]}:{boats[1]}")
        await runner.setup()
        with _refused("--page", page):
            await web.TCPSite(runner, *page).start()
        for each in gateway.radios.values():
            each.start()
        port = runner.addresses[0][1]
        ready(f"http://{_bracketed(ip_address(page[0]))}:{port}/?token={gateway.token}")
        while True:
            await asyncio.sleep(TICK_S)
            gateway.tick()
    finally:
        gateway.fleet.release_all("the console ended")
        await runner.cleanup()
        if transport is not None:
            transport.close()
        gateway.close()


def _is_news(record: logging.LogRecord) -> bool:
    """What a visitor sends that is no HTTP is none: he could fill the terminal with it."""
    return not (record.exc_info and isinstance(record.exc_info[1], HttpProcessingError))


@contextmanager
def _refused(option: str, address: tuple[str, int]) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        taken = error.errno == errno.EADDRINUSE
        reason = (
            f"another program has it, perhaps another console; choose with {option} ADDRESS:PORT" if taken else error.strerror
        )
        raise ConfigError(option, f"{address[0]}:{address[1]}", str(reason)) from None


def own_number(token: str) -> int:
    """Of this console, by which boats know it from others: drawn with its token, and kept with it."""
    return NUMBERS[hashlib.sha256(token.encode()).digest()[0] % len(NUMBERS)]


def kept_token(file: Path) -> str:
    """What lets a browser in, the same at each start: a page that is open finds its console again. Where no file can be, it is
    the token of this run."""
    with suppress(OSError, FormatError):
        if _TOKEN.fullmatch(token := read_text(file).strip()):
            return token
    token = secrets.token_urlsafe(TOKEN_BYTES)
    with suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        with open(file, "w", encoding="ascii", opener=partial(os.open, mode=0o600)) as out:
            out.write(f"{token}\n")
    return token


def run(asked: argparse.Namespace) -> int:
    """The command."""
    host, port = _address("--page", asked.page)
    tapes = open_tapes([Path(each) for each in asked.replay]) if asked.replay else []
    gateway = Gateway(
        WakefulClock(),
        Path(asked.missions),
        Key(Path(asked.key)) if asked.key else None,
        kept_token(Path(asked.token).expanduser()),
        Path(asked.vehicle) if asked.vehicle else None,
        charts=Path(asked.charts),
        radios=() if tapes else asked.radio,
        sessions=Path(asked.sessions),
        tapes=tapes,
        number=asked.number,
    )

    def ready(url: str) -> None:
        what = (
            f"{len(tapes)} recordings are replayed" if tapes else f"boats are heard on {', '.join([asked.boats, *asked.radio])}"
        )
        print(f"delfim: the console is at {url}; {what}; it is console {gateway.me}", flush=True)
        for complaint in filter(None, [*gateway.charts.faults, *(tape.complaint for tape in tapes)]):
            print(f"delfim: {complaint}", file=sys.stderr)
        if asked.browser:
            show(url)

    async def until_ended() -> None:
        """In order: zero to what is steered, the session to the disk."""
        serving = asyncio.current_task()
        assert serving is not None
        with suppress(NotImplementedError):  # on Windows Ctrl-C is raised instead
            for number in (signal.SIGINT, signal.SIGTERM):
                asyncio.get_running_loop().add_signal_handler(number, serving.cancel)
        await serve(gateway, None if tapes else _address("--boats", asked.boats), (host, port), ready)

    with suppress(KeyboardInterrupt, asyncio.CancelledError), asyncio.Runner(loop_factory=new_event_loop) as runner:
        runner.run(until_ended())
    return 0


def _address(option: str, text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    try:
        ip_address(host)
        if not 0 <= int(port) < 1 << 16:
            raise ValueError
        return host, int(port)
    except ValueError:
        raise ConfigError(option, text, "no address", "ADDRESS:PORT") from None
