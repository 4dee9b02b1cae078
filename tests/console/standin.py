"""A gateway with boats of a few lines, for tests of the page: it serves what is built, and keeps all that the page says."""

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any, TypeAlias

import msgspec
from aiohttp import WSMsgType, web

from delfim.base.errors import FormatError
from delfim.base.modes import Mode
from delfim.console.gateway import page_messages
from delfim.console.gateway.plan_files import PlanFiles
from delfim.parts.mavlink.codec.ownorders import own_offers
from delfim.vehicle import console

PAGE = Path(__file__).parents[2] / "delfim" / "console" / "page"
MODES = {mode: mode.name.lower() for mode in Mode}
DOCA = (38.6902, -9.2150)
M_PER_DEG = 111_111.0
RPM_MOST = 1500.0
_PORTS: list[int] = []  # where the last gateway was: a browser compiles the page's script once for each address

Message: TypeAlias = dict[str, Any]


def boat(number: int, name: str, colour: str, *, north_m: float = 0.0, east_m: float = 0.0, **more: Any) -> Message:
    """A boat as the gateway tells it, lying idle north and east of the Doca."""
    latitude_deg, longitude_deg = place(north_m, east_m)
    return {
        "id": number,
        "name": name,
        "colour": colour,
        "latitude_deg": latitude_deg,
        "longitude_deg": longitude_deg,
        "heading_deg": 40.0,
        "course_deg": 40.0,
        "speed_mps": 0.0,
        "mode": "idle",
        "asked": None,
        "modes": list(MODES.values()),
        "orders": [msgspec.structs.asdict(each) for each in own_offers()],
        "armed": False,
        "owner": True,
        "commander": 0,
        "twins": [],
        "ready": True,
        "reason": "",
        "failsafe": "",
        "rpm": [0.0, 0.0],
        "thrust_pct": [0.0, 0.0],
        "speed_pct": 0,
        "battery_v": 49.6,
        "battery_pct": 87,
        "roll_deg": 0.4,
        "pitch_deg": -0.2,
        "satellites": 14,
        "fix": "3D",
        "reference": None,
        "home": None,
        "fence": [],
        "obstacles": [],
        "ghost": None,
        "released": False,
        "driver": 0,
        "age_s": {"heard": 0.1, "position": 0.1, "attitude": 0.1, "rpm": 0.1, "battery": 0.9},
        "link": {"kind": "udp", "profile": "wifi", "rtt_ms": 3.2, "loss_pct": 0.0, "bytes_per_s": 1960, "signed": True},
        "mission": {"name": "", "count": 0, "current": None, "state": "none", "digest": None},
        **more,
    }


def vessel(name: str, *, north_m: float = 0.0, east_m: float = 0.0, **more: Any) -> Message:
    """Another vessel as the gateway tells it, under way to the east at 4 m/s, of no concern."""
    latitude_deg, longitude_deg = place(north_m, east_m)
    return {
        "key": name,
        "name": name,
        "latitude_deg": latitude_deg,
        "longitude_deg": longitude_deg,
        "course_deg": 90.0,
        "speed_mps": 4.0,
        "heading_deg": 90.0,
        "length_m": 40.0,
        "beam_m": 8.0,
        "size_known": True,
        "margin_m": 11.0,
        "kind": "A",
        "status": 0,
        "age_s": 4.0,
        "lost": False,
        "domain_m": [173.0, 77.0],
        "boats": [nearness(1)],
        **more,
    }


def nearness(boat: int, cpa_m: float = 640.0, tcpa_s: float = 300.0, danger: str = "none") -> Message:
    return {"boat": boat, "cpa_m": cpa_m, "tcpa_s": tcpa_s, "nearness": cpa_m / 100.0, "danger": danger, "words": ""}


def place(north_m: float, east_m: float) -> tuple[float, float]:
    """Latitude and longitude, degrees, of a place beside the Doca."""
    return DOCA[0] + north_m / M_PER_DEG, DOCA[1] + east_m / (M_PER_DEG * math.cos(math.radians(DOCA[0])))


class Standin:
    """Answers each request with yes, puts boats into the modes they are told, keeps plans and missions."""

    def __init__(self, boats: list[Message], *, backgrounds: tuple[Message, ...] = (), replay: Message | None = None) -> None:
        self.boats = boats
        self.hello: Message = {
            "version": "0",
            "me": 250,
            "page": 1,
            "heard_on": ["127.0.0.1:14550"],
            "backgrounds": list(backgrounds),
            "replay": replay,
        }
        self.charts: dict[str, bytes] = {}
        self.said: list[Message] = []
        self.faults: list[str] = []  # what the gateway would not have understood
        self.plans: dict[int, Message] = {}
        self.aboard: dict[int, Message] = {}
        self.stored: dict[str, Message] = {}
        self.refusals: dict[str, str] = {}  # by command, or by what is to be done to a mission
        self.obedient = True  # boats enter the mode they are told
        self.history: dict[int, list[list[float]]] = {}
        self.at_s = 1_790_000_000.0
        self.vessels: list[Message] = []
        self.reported_s: float | None = None  # since the last report of any of them
        self.sockets: set[web.WebSocketResponse] = set()
        self.address = ""

    @contextlib.asynccontextmanager
    async def serving(self) -> AsyncIterator["Standin"]:
        app = web.Application()
        app.add_routes([web.get("/", self._index), web.get("/ws", self._talk), web.get("/background/{name}", self._chart)])
        PlanFiles().routes(app)
        app.router.add_static("/", PAGE)
        runner = web.AppRunner(app, shutdown_timeout=1.0)
        await runner.setup()
        try:
            try:
                await web.TCPSite(runner, "127.0.0.1", next(iter(_PORTS), 0)).start()
            except OSError:  # somebody else has it
                await web.TCPSite(runner, "127.0.0.1", 0).start()
            _PORTS[:] = [runner.addresses[0][1]]
            self.address = f"http://127.0.0.1:{_PORTS[0]}/"
            yield self
        finally:
            await runner.cleanup()
        assert self.faults == []

    async def tell(self, message: Message) -> None:
        for socket in list(self.sockets):
            with contextlib.suppress(ConnectionError, RuntimeError):
                await socket.send_json(message)

    async def frame(self, later_s: float = 0.1) -> None:
        """Tell the boats once, that much later."""
        self.at_s += later_s
        await self.tell({"t": "boats", "at_s": self.at_s, "boats": self.boats})

    async def look(self) -> None:
        """Tell the other vessels once."""
        await self.tell({"t": "vessels", "at_s": self.at_s, "vessels": self.vessels, "heard_s": self.reported_s})

    async def hang_up(self) -> None:
        for socket in list(self.sockets):
            await socket.close()

    async def until(self, wanted: Callable[[Message], bool], timeout_s: float = 200.0) -> Message:
        """The first message since the last `forget` that is as wanted; frames go on meanwhile."""
        try:
            async with asyncio.timeout(timeout_s):
                while not (found := [message for message in self.said if wanted(message)]):
                    await self.frame()
                    await asyncio.sleep(0.06)
        except TimeoutError:
            raise AssertionError(f"not heard; heard was {self.said}") from None
        return found[0]

    async def command(self, command: str, number: int | str = 1) -> Message:
        """Wait for a command to this boat, or for a mode."""
        return await self.until(
            lambda m: m["t"] == "command" and command in (m["command"], m.get("mode")) and m["boat"] == number
        )

    def forget(self) -> None:
        self.said.clear()

    def boat(self, number: int) -> Message:
        return next(each for each in self.boats if each["id"] == number)

    async def _index(self, _request: web.Request) -> web.FileResponse:
        return web.FileResponse(PAGE / "index.html")

    async def _chart(self, request: web.Request) -> web.Response:
        return web.Response(body=self.charts[request.match_info["name"]], content_type="image/png")

    async def _talk(self, request: web.Request) -> web.WebSocketResponse:
        socket = web.WebSocketResponse()
        await socket.prepare(request)
        await socket.send_json({"t": "hello", **self.hello, "boats": self.boats})
        for number, points in self.history.items():
            for first in range(0, len(points), 500):
                chunk = {"t": "track", "boat": number, "start": first == 0, "points": points[first : first + 500]}
                await socket.send_json(chunk)
        for number, mission in self.plans.items():
            await socket.send_json({"t": "mission", "boat": number, "where": "here", "mission": mission})
        for number, mission in self.aboard.items():
            await socket.send_json({"t": "mission", "boat": number, "where": "aboard", "mission": mission})
        self.sockets.add(socket)  # as of the gateway: no frame comes between a track's pieces
        try:
            async for message in socket:
                if message.type is WSMsgType.TEXT:
                    await self._take(socket, message.json())
        finally:
            self.sockets.discard(socket)
        return socket

    async def _take(self, socket: web.WebSocketResponse, message: Message) -> None:
        self.said.append(message)
        self._understand(message)
        if "seq" not in message:
            return
        what = message.get("command") or message.get("do") or message["t"]
        reason = self.refusals.get(what, "")
        if not reason and message["t"] == "command":
            self._obey(message)
        if not reason and message["t"] == "mission":
            await self._mission(socket, message)
        await socket.send_json({"t": "answer", "seq": message["seq"], "ok": not reason, "reason": reason})

    def _understand(self, message: Message) -> None:
        """As the gateway does: the page says nothing that the gateway refuses to hear."""
        try:
            msgspec.convert(message, page_messages.Message)
            if message["t"] == "command":
                numbers = {name: value for name, value in message.items() if name not in page_messages.NO_NUMBERS}
                console.parse(msgspec.json.encode({"command": message["command"]} | numbers))
        except (msgspec.ValidationError, FormatError) as error:
            self.faults.append(f"{error}: {message}")

    def _obey(self, message: Message) -> None:
        command = message["command"]
        for each in self.boats if message["boat"] == "all" else [self.boat(message["boat"])]:
            mode = message.get("mode") or console.KINDS[command].ENTERS
            if mode in MODES.values():
                each["asked"] = mode
                if self.obedient:
                    each["mode"], each["asked"], each["armed"] = mode, None, mode != "idle"
            if command == "speed":
                each["speed_pct"] = message["speed_pct"]
            if command == "heading":
                each["reference"] = reference(heading_deg=message["heading_deg"])

    async def _mission(self, socket: web.WebSocketResponse, message: Message) -> None:
        number, deed = message["boat"], message["do"]
        if deed == "put":
            self.plans[number] = message["mission"]
        elif deed == "save":
            self.stored[message["name"]] = self.plans[number]
        elif deed == "list":
            await socket.send_json({"t": "missions", "names": sorted(self.stored)})
        elif deed == "load":
            self.plans[number] = self.stored[message["name"]]
            await socket.send_json({"t": "mission", "boat": number, "where": "here", "mission": self.plans[number]})
        elif deed == "upload":
            count, name = len(self.plans[number]["waypoints"]), self.plans[number]["name"]
            self.boat(number)["mission"] = {"name": name, "count": count, "current": 0, "state": "same", "digest": "1"}
            await socket.send_json({"t": "mission", "boat": number, "where": "aboard", "mission": self.plans[number]})
        elif deed == "download":
            await socket.send_json({"t": "mission", "boat": number, "where": "aboard", "mission": self.stored["aboard"]})
        elif deed == "dryrun":
            track = [[each["latitude_deg"], each["longitude_deg"]] for each in self.plans[number]["waypoints"]]
            await socket.send_json({"t": "dryrun", "boat": number, "time_s": 754.0, "distance_m": 1108.0, "track": track})


def reference(**known: float) -> Message:
    """The set point of the control, unknown but for what is given."""
    keys = ("speed_mps", "heading_deg", "latitude_deg", "longitude_deg", "cross_track_m", "distance_m", "leg")
    return {key: known.get(key) for key in keys}
