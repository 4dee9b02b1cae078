"""The data of the page: the vehicle's state, asked for over its local socket, and the computer's, sampled by a child."""

import asyncio
import contextlib
import sys
from collections.abc import Callable
from typing import Final, cast

import msgspec

from delfim import config
from delfim.base.errors import DelfimError
from delfim.services.access.connection_limits import ConnectionLimits
from delfim.services.page import page
from delfim.services.page.api import Computer, Report, Server
from delfim.services.runtime import Runtime
from delfim.services.supervision import processes
from delfim.services.tables import Httpd
from delfim.vehicle.report import BoatReport, Service, reported

ANSWER_S: Final = 2.0  # for the vehicle's answer
FRESH_S: Final = 0.9  # a younger answer is used again
WAY_MAX: Final = 160  # points: their line takes 60 µs to write
ANSWER_BYTES: Final = 1 << 20  # of the vehicle or the child, at most


class Feed(asyncio.Protocol):
    """The vehicle's words, asked for one at a time."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._transport: asyncio.Transport | None = None
        self._answer: asyncio.Future[bytes] | None = None
        self._buffer = bytearray()

    async def ask(self) -> BoatReport:
        """The present state. Raises DelfimError in words."""
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(ANSWER_S):
                if self._transport is None:
                    await loop.create_unix_connection(lambda: self, self._path)
                assert self._transport is not None
                self._answer = loop.create_future()
                self._transport.write(b'{"command": "state"}\n')
                return reported(await self._answer)
        except (OSError, TimeoutError) as error:
            self.close()
            reason = error.strerror if isinstance(error, OSError) and error.strerror else "no answer in time"
            raise DelfimError(f"the vehicle does not answer: {reason}") from None
        except msgspec.DecodeError as error:
            raise DelfimError(f"the vehicle's answer is not understood: {error}") from None

    def close(self) -> None:
        if self._transport is not None:
            self._transport.abort()
            self._transport = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)  # uvloop's transports do not inherit asyncio.Transport
        self._buffer.clear()

    def connection_lost(self, exc: Exception | None) -> None:
        self._transport = None
        if self._answer is not None and not self._answer.done():
            self._answer.set_exception(ConnectionResetError(0, "it closed the connection"))

    def data_received(self, data: bytes) -> None:
        self._buffer += data
        if data.endswith(b"\n") and self._answer is not None and not self._answer.done():
            self._answer.set_result(bytes(self._buffer))
            self._buffer.clear()
        elif len(self._buffer) > ANSWER_BYTES:
            self.close()


_COMPUTER: Final = msgspec.json.Decoder(Computer)


class Lookout(asyncio.SubprocessProtocol):
    """The child that samples the computer, and its last sample."""

    def __init__(self, settings: config.Vehicle, clock_s: Callable[[], float]) -> None:
        words = (settings.log.directory, settings.log.free_bytes_min, settings.runtime.run_directory, settings.of(Httpd).scan_s)
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
            start = loop.subprocess_exec(lambda: self, *self._command, stderr=None)
            self._transport, _ = await processes.started(start)

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


class Trail:
    """Where the boat was while somebody looked: at most WAY_MAX points. When they are full, every second one goes, and the next
    ones come half as often."""

    def __init__(self) -> None:
        self.points: list[tuple[float, float]] = []
        self._every, self._seen = 1, 0

    def add(self, vehicle: BoatReport) -> None:
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
    """The data for all visitors: asked for and rendered once for all of them, and never while there is none."""

    def __init__(self, runtime: Runtime, look: Lookout, door: ConnectionLimits) -> None:
        self._runtime, self._look, self._door = runtime, look, door
        self._settings, self._clock = runtime.config, runtime.clock
        self.feed = Feed(runtime.config.console.socket)
        self._lock = asyncio.Lock()
        self._report: Report | None = None
        self._report_s = self._sections_s = -1e9
        self._sections: dict[str, str] = {}
        self.requests = 0
        self._way = Trail()
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
            view = page.PageView(await self._asked(), self._settings, self._way.points)
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
