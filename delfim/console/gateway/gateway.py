"""The gateway between the boats and the page, one process on the operator's computer: informs pages, answers their requests.

The messages of the WebSocket stand in docs/console.md. Every decision about a boat is in `Fleet`.
"""

import asyncio
import json
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import msgspec
from aiohttp import WSMsgType, web

from delfim import __version__
from delfim.base.clock import Clock
from delfim.base.errors import DelfimError, Refused, in_words
from delfim.console.boats.fleet import Fleet
from delfim.console.boats.othervessels import around
from delfim.console.boats.soundings import SoundingFiles
from delfim.console.charts.charts import Charts
from delfim.console.charts.dropping import ChartDrop
from delfim.console.gateway import foxglove, page_messages
from delfim.console.gateway.aboard import AboardDesk
from delfim.console.gateway.adopting import Adoption
from delfim.console.gateway.bridging import BridgeDesk
from delfim.console.gateway.onwatch import WatchKeeper
from delfim.console.gateway.picturedesk import PictureDesk
from delfim.console.gateway.plan_files import PlanFiles
from delfim.console.gateway.plan_tools import Desk
from delfim.console.gateway.surveys import SurveyDesk
from delfim.console.link.mavlink import Key
from delfim.console.link.radio import radio
from delfim.console.link.session import Session
from delfim.console.link.udp import Udp
from delfim.console.pages.admission import Admission, own_number
from delfim.console.pages.installable import built, manifest_route
from delfim.console.pages.page import Page, encoded
from delfim.console.pages.pushing import PushDesk
from delfim.console.tapes.replay import TapePlayer
from delfim.console.tapes.tape import Tape
from delfim.console.watch.alerts import WARNING
from delfim.console.watch.operators import OperatorsFile
from delfim.parts.fleet.broker import DOWN, BrokerLine

PAGE: Final = Path(__file__).parents[1] / "page"
SHOW_TICKS: Final = 2  # ten times a second, for up to ...
SHOWN: Final = 32  # ... this many boats; for more of them less often, so that a page gets as many states a second
DEPTH_TICKS: Final = 20  # once a second
VESSEL_TICKS: Final = 20  # once a second
CHUNK: Final = 500  # points of a track in one message
PAGES_MAX: Final = 8
PING_S: Final = 5.0  # a page that answers none within half of this is gone
MESSAGE_BYTES: Final = 1 << 20
Answer = Callable[[bool, str], None]


class Gateway:
    """Serves the pages."""

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
        frames: bool = True,
        tapes: Sequence[Tape] = (),
        number: int | None = None,
        trials: Path = Path("adopt"),
        operators: OperatorsFile | None = None,
    ) -> None:
        self.udp = Udp(self._receive)
        self.radios = {each.device: each for each in (radio(words, self._receive) for words in radios)}
        self.session = Session(sessions, clock, frames) if sessions is not None and not tapes else None
        self.soundings = SoundingFiles(sessions, clock) if self.session is not None and sessions is not None else None
        self.charts = Charts(charts)
        admission = Admission(token, operators)
        self.token, self.me = admission.token, number or own_number(admission.token)
        self._clock, self._pages = clock, set[Page]()
        self.push: PushDesk | None = None
        self.ping_s, self._built = PING_S, built(PAGE)
        self.viewers: list[Callable[[dict[str, Any]], None]] = []  # other programs that hear what pages hear
        self.fleet: Fleet | TapePlayer
        self.watch = WatchKeeper(self._broadcast, self._utc_s, self._name, sessions if self.session is not None else None)
        self.bridge = BridgeDesk(admission.operators, partial(self.watch.note, None), self._handed)
        if tapes:
            self.fleet = TapePlayer(tapes, clock, self.tell)
            self.fleet.moved = self._show_jump
            if sessions is not None:
                self.watch.recall(self.fleet, sessions, clock.time_ns() / 1e9)
        else:
            self.fleet = Fleet(clock, self._transmit, self.tell, key, self.me)
            if self.session is not None:
                self.fleet.record = self.session.put
            self.fleet.troubles, self.watch.aboard = self.watch.alerts.troubles, self.fleet.note
            self.watch.resume()
            if self.soundings is not None:
                for heard in self.soundings.read():
                    self.fleet.depths.add(*heard[1:])
                self.fleet.sounded = self.soundings.put
        self.adoption = Adoption(self.fleet, vehicle, trials, self.tell) if isinstance(self.fleet, Fleet) else None
        secret, folder = b"" if key is None else key.secret, sessions or Path("sessions")
        self.pictures = PictureDesk(self.fleet, secret, clock, folder)
        self.broker: BrokerLine | None = None
        self._complaints: dict[str, str] = {}  # the last complaint about each link and file, to say it once
        self.heard_on: list[str] = [*self.radios]  # addresses and radios, for the page
        self._desk, self._surveys = Desk(self.fleet, missions, vehicle, self.charts), SurveyDesk(vehicle, self._heard)
        self.aboard = AboardDesk(self.fleet, vehicle, self.tell)
        self._drop = ChartDrop(self.charts, vehicle, lambda: self.aboard.logs, self._desk.renew, self.tell)
        self._ticks = self._opened = 0
        self.app = web.Application(middlewares=[admission.admit], client_max_size=MESSAGE_BYTES)
        self._route()

    def _route(self) -> None:
        self.app.router.add_get("/", self._index)
        self.app.router.add_get("/ws", self._socket)
        self.app.router.add_get("/api/boats", self._boats)
        self.app.router.add_get("/foxglove.json", self._layout)
        self.app.router.add_get("/watch.csv", self.watch.serve)
        self.app.router.add_post("/area", self._surveys.read)
        self.app.router.add_get("/kept.toml", self.aboard.keep)
        PlanFiles().routes(self.app)
        if self.adoption is not None:
            self.app.router.add_get("/adoption.html", self.adoption.serve_report)
            self.app.router.add_get("/adopted.toml", self.adoption.serve_file)
        self._drop.routes(self.app)
        if PAGE.is_dir():
            manifest_route(self.app, PAGE)
            self.app.router.add_static("/", PAGE)

    def close(self) -> None:
        """Called after the last tick."""
        for each in self.radios.values():
            each.close()
        if self.session is not None:
            self.session.flush()
            self._keep()
        self.watch.close()
        if self.soundings is not None:
            self.soundings.flush()
        for desk in (self._drop, self.charts, self._surveys, self.aboard, self.adoption):
            if desk is not None:
                desk.close()

    def tell(self, message: dict[str, Any]) -> None:
        """Sends to every page and viewer; a text is kept in the log of the watch."""
        self._broadcast(message)
        if message["t"] == "text" and not isinstance(self.fleet, TapePlayer):
            self.watch.hear(message)

    def _broadcast(self, message: dict[str, Any]) -> None:
        for page in self._pages:
            page.tell(message)
        for view in self.viewers:
            view(message)

    def _name(self, number: int) -> str:
        return self.fleet.boats[number].name if number in self.fleet.boats else ""

    def tick(self) -> None:
        self.fleet.tick()
        if isinstance(self.fleet, Fleet):
            self.watch.tick(self.fleet.boats.values(), self._clock.monotonic_s())
        self.bridge.tick(self._pages, self._clock.monotonic_s())
        self.pictures.tick()
        self.aboard.tick(self._clock.monotonic_s())
        self._complain("file of operators", self.bridge.operators.reason)
        if self.session is not None:
            if self.session.tick():
                self._keep()
            self._complain("recording of the session", self.session.reason)
            self._complain("log of the watch", self.watch.log.reason)
            self._complain("file of alerts", self.watch.file.reason if self.watch.file is not None else "")
        if self.soundings is not None:
            self.soundings.tick()
            self._complain("recording of the depths", self.soundings.reason)
        for name, each in self.radios.items():
            self._complain(name, each.reason)
        if self.broker is not None:
            self._complain("the broker", self.broker.reason)
        if self.push is not None:
            self.push.look(self.watch.alerts.standing, self._name)
            self._complain("push", self.push.reason)
        self._ticks += 1
        if (self._pages or self.viewers) and self._ticks % (SHOW_TICKS * math.ceil(len(self.fleet.boats) / SHOWN or 1)) == 0:
            self.tell({"t": "boats", "at_s": self._utc_s(), "boats": self.fleet.snapshot()})
            for progress in self.fleet.progress():
                self.tell(progress)
        if self._pages and self._ticks % DEPTH_TICKS == 0 and isinstance(self.fleet, Fleet):
            for depths in self.fleet.depths.changes():
                self.tell(depths)
        if (self._pages or self.viewers) and self._ticks % self._vessel_ticks() == 0:
            self.tell(self._vessels())

    def wakes(self, desk: PushDesk) -> None:
        """Operators whose page is closed are woken by this desk."""
        self.push = desk
        desk.routes(self.app)

    def attended_only(self, silent_s: float) -> None:
        """Boats hear of this console only while somebody is at a page, or was within `silent_s`."""
        self.ping_s = silent_s / 1.5  # the answer has half of it
        if isinstance(self.fleet, Fleet):
            self.fleet.attended = lambda: bool(self._pages)

    def report(self) -> dict[str, object]:
        """What a boat's page tells of it, JSON-ready."""
        troubles = {name: reason for name, reason in self._complaints.items() if reason}
        return {"troubles": troubles, "counts": {"pages": len(self._pages), "boats": len(self.fleet.boats)}}

    def _keep(self) -> None:
        """Writes the log of the watch beside the frames."""
        if self.session is not None and self.session.file is not None:
            self.watch.log.write(self.session.file.with_suffix(".csv"))

    def _heard(self) -> list[Path]:
        """The files of the depths that were heard."""
        return self.soundings.files() if self.soundings is not None else []

    def _forget_depths(self) -> None:
        """Raises OSError."""
        if self.soundings is not None:
            self.soundings.put_aside()
        if isinstance(self.fleet, Fleet):
            self.fleet.depths.forget()
        self.tell({"t": "no_depths"})

    def _complain(self, name: str, reason: str) -> None:
        """Tells the pages once for each reason."""
        before = self._complaints.get(name, "")
        if reason == before:
            return
        self._complaints[name] = reason
        well = self._text(f"{name}: works again", 6)
        self.tell(self._text(f"{name}: {reason}") | {"alarm": "console"} if reason else well)
        for words, is_so in ((before, False), (reason, True)):
            if words:
                self.watch.alerts.hold(None, WARNING, f"{name}: {words}", is_so)

    def _text(self, words: str, severity: int = WARNING) -> dict[str, Any]:
        """Words of the console itself."""
        return {"t": "text", "boat": None, "severity": severity, "text": words, "at_s": self._utc_s()}

    def _receive(self, address: Any, data: bytes) -> None:
        self.fleet.receive(address, data)

    def hear_of(self, topic: str, data: bytes) -> None:
        """Frames at the broker, of the boat that the topic names."""
        self.fleet.receive(("broker", topic.split("/")[1]), data)

    def _transmit(self, address: Any, data: bytes) -> None:
        if address[0] == "serial":
            self.radios[address[1]].send(data)
        elif address[0] == "broker":
            assert self.broker is not None
            self.broker.put(self.broker.place.topic(address[1], DOWN), data)
        else:
            self.udp.send(address, data)

    async def _index(self, request: web.Request) -> web.StreamResponse:
        if not (PAGE / "index.html").exists():
            raise web.HTTPNotFound(text="the page was not built: make page\n")
        return web.FileResponse(PAGE / "index.html", headers={"Cache-Control": "no-cache"})

    async def _boats(self, request: web.Request) -> web.Response:
        return web.json_response(self.fleet.snapshot(), dumps=encoded)

    async def _layout(self, request: web.Request) -> web.Response:
        """A layout of Foxglove for the boats that are known now, as a file to import."""
        boats = [boat["name"] for boat in self.fleet.snapshot()]
        return web.json_response(foxglove.layout(boats), headers={"Content-Disposition": "attachment"})

    async def _socket(self, request: web.Request) -> web.WebSocketResponse:
        if len(self._pages) >= PAGES_MAX:
            raise web.HTTPServiceUnavailable(text="too many pages are open: close one\n")
        link = web.WebSocketResponse(heartbeat=self.ping_s, max_msg_size=MESSAGE_BYTES)
        await link.prepare(request)
        self._opened += 1
        page = Page(link, request, self._opened)
        self._greet(page)
        self._pages.add(page)
        self.watch.note(None, page.who, "page", "opened")
        try:
            await asyncio.gather(self._listen(page, link), page.write())
        finally:
            self._pages.discard(page)
            self.watch.note(None, page.who, "page", "closed")
            self.bridge.gone(page.number, self._clock.monotonic_s())
            self.fleet.release_all("the page was closed", page.number)
            if self.adoption is not None and not self._pages:
                self.adoption.pages_gone()
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
                "built": self._built,
                "wakes": self.push is not None,
                "me": self.me,
                "page": page.number,
                "backgrounds": self.charts.backgrounds,
                "charts": self.charts.folder,
                "boats": fleet.snapshot(),
                "heard_on": self.heard_on,
                "adopts": self.adoption.boat if self.adoption is not None else None,
                "replay": self.watch.time_line(fleet) if isinstance(fleet, TapePlayer) else None,
            }
        )
        for fault in (*self.charts.faults, *(f"{name}: {reason}" for name, reason in self._complaints.items() if reason)):
            page.tell(self._text(fault))
        self.watch.greet(page.tell)
        if self.adoption is not None and self.adoption.shown is not None:
            page.tell(self.adoption.shown)
        page.tell(self._vessels())
        self._show_tracks(page)
        if isinstance(fleet, Fleet):
            for depths in fleet.depths.whole():
                page.tell(depths)
        if isinstance(fleet, TapePlayer):
            for number, track in fleet.tracks().items():
                for points in _chunks(track):
                    page.tell({"t": "whole_track", "boat": number, "points": points})
            for number, graphs in fleet.graphs().items():
                page.tell({"t": "graphs", "boat": number, "graphs": graphs})
        for number, missions in fleet.missions.items():
            for where, mission in missions.items():
                page.tell({"t": "mission", "boat": number, "where": where, "mission": mission})

    def _vessels(self) -> dict[str, Any]:
        """Other vessels."""
        fleet = self.fleet
        now_s = fleet.at_s if isinstance(fleet, TapePlayer) else self._clock.monotonic_s()
        return {"t": "vessels", "at_s": self._utc_s(), **around(list(fleet.boats.values()), now_s)}

    def _vessel_ticks(self) -> int:
        """Between two times that the pages are told of other vessels: in a fast replay they are not left behind."""
        rate = self.fleet.rate if isinstance(self.fleet, TapePlayer) else 1.0
        return max(round(VESSEL_TICKS / max(rate, 1.0)), SHOW_TICKS)

    def _show_jump(self) -> None:
        """The time of a replay has jumped: all tracks now, and with the next tick boats and vessels."""
        for page in self._pages:
            self._show_tracks(page)
        self._ticks = -1

    def _show_tracks(self, page: Page) -> None:
        for number, boat in self.fleet.boats.items():
            for at, points in enumerate(_chunks(list(boat.track))):
                page.tell({"t": "track", "boat": number, "start": at == 0, "points": points})

    def _hear(self, page: Page, text: str) -> None:
        """Takes a message of a page, and answers a wrong one with the reason."""
        sequence: Any = None
        try:
            asked = json.loads(text)  # it accepts infinity, so that the message's number is found all the same
            sequence = asked.get("seq") if isinstance(asked, dict) else None
            self._ask(page, msgspec.convert(asked, page_messages.Message), asked, partial(_answer, page, sequence))
        except (DelfimError, OSError) as error:
            _answer(page, sequence, False, in_words(error))
        except (msgspec.MsgspecError, ValueError, TypeError, KeyError, RecursionError) as error:
            _answer(page, sequence, False, f"not understood: {error}")

    def _ask(self, page: Page, asked: page_messages.Message, words: dict[str, Any], answer: Answer) -> None:
        answer = self.watch.ordered(page.who, asked, words, answer)
        if reason := self.bridge.refusal(page, asked):
            answer(False, reason)
        elif isinstance(asked, page_messages.Here | page_messages.Handover):
            self.bridge.ask(page, asked, self._pages, self._clock.monotonic_s())
            answer(True, "")
        else:
            self._obey(page, asked, words, answer)

    def _obey(self, page: Page, asked: page_messages.Message, words: dict[str, Any], answer: Answer) -> None:
        fleet = self.fleet
        match asked:
            case page_messages.Input(boat=number):
                fleet.input(number, asked.n, asked.port_pct, asked.starboard_pct, page.number)
            case page_messages.Release(boat=number, why=why):
                fleet.release(number, why[:80], page.number)
            case page_messages.Command(boat="all"):
                if asked.command != "stop":
                    raise Refused("only stop can be given to all boats")
                self._acted(None, "STOP of all boats")
                self._stop_all(answer)
            case page_messages.Command(boat=int(number)):
                self._acted(number, "STOP" if asked.command == "stop" else f"{asked.command}, by {page.who}")
                if asked.command == "stop":
                    fleet.release(number, "stop")
                numbers = {name: value for name, value in words.items() if name not in page_messages.NO_NUMBERS}
                fleet.command(number, asked.command, numbers, answer, page.number)
            case page_messages.Profile(boat=number, profile=profile):
                fleet.command(number, "profile", {"profile": profile}, answer)
            case page_messages.Forget(boat=number):
                if number in fleet.boats:  # else its alerts are of a session before
                    fleet.forget(number)
                self.watch.alerts.forget(number, page.who)
                self.tell({"t": "forgotten", "boat": number})
                answer(True, "")
            case page_messages.Home(boat=number):
                fleet.ask_home(number)
                answer(True, "")
            case page_messages.Afford(boat=number):
                fleet.afford(number, answer)
            case page_messages.Acknowledge() | page_messages.Quiet() | page_messages.Note():
                self.watch.ask(page.who, asked)
                answer(True, "")
            case page_messages.Replay():
                if not isinstance(fleet, TapePlayer):
                    raise Refused("nothing is being replayed")
                fleet.steer(asked.at_s, asked.rate)
                answer(True, "")
            case page_messages.Mission():
                self._desk.ask(asked, words.get("mission"), page.tell, answer)
            case page_messages.Survey():
                self._surveys.ask(page.who, asked, page.tell, answer)
            case page_messages.Depths():
                self._forget_depths()
                answer(True, "")
            case page_messages.Logs(do="chart" | "unsent") if isinstance(fleet, Fleet):
                self._drop.ask(fleet.boat(asked.boat), asked.do, asked.chart, self._clock.monotonic_s(), answer)
            case page_messages.Itself() | page_messages.Logs():
                self.aboard.ask(asked, page.tell, answer)
            case page_messages.See() | page_messages.Snapshot():
                answer(True, self.pictures.ask(page.number, asked, page.tell))
            case page_messages.Adopt():
                if self.adoption is None:
                    raise Refused("nothing is adopted in a replay")
                self.adoption.ask(asked, answer)

    def _handed(self, name: str, before: int) -> None:
        """Somebody else commands, or nobody (""): no thrust of the page that did."""
        self.fleet.release_all("the command was handed over", before)
        if name:
            self.watch.alerts.transfer(name)
        else:
            self.watch.alerts.give_back()

    def _acted(self, boat: int | None, what: str) -> None:
        """A page gives an order: the trial of that boat, or of any (None), is over before it goes out."""
        if self.adoption is not None:
            self.adoption.acted(boat, what)

    def _stop_all(self, answer: Callable[[bool, str], None]) -> None:
        """Answers when all boats have stopped, or one has failed to."""
        fleet = self.fleet
        fleet.release_all("stop")
        waiting, names = set(fleet.boats), {number: boat.name for number, boat in fleet.boats.items()}

        def stopped(number: int, well: bool, why: str) -> None:
            waiting.discard(number)
            if not well:
                answer(False, f"{names[number]}: {why}")
            elif not waiting:
                answer(True, "")

        for number in sorted(waiting):
            fleet.command(number, "stop", {}, partial(stopped, number))
        if not fleet.boats:
            answer(False, "no boat has been heard")

    def _utc_s(self) -> float:
        """The time that pages show."""
        return round(self.fleet.at_s if isinstance(self.fleet, TapePlayer) else self._clock.time_ns() / 1e9, 3)


def _answer(page: Page, sequence: Any, well: bool, reason: str) -> None:
    if sequence is not None:
        page.tell({"t": "answer", "seq": sequence, "ok": well, "reason": reason})


def _chunks(points: list[tuple[float, float, float]]) -> Iterator[list[tuple[float, float, float]]]:
    """A track in chunks; one at least."""
    for at in range(0, max(len(points), 1), CHUNK):
        yield points[at : at + CHUNK]
