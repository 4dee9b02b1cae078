"""iridiumd: the boat at an Iridium SBD modem (docs/iridium.md): its report out, an order in, each ten minutes.

A process of its own. To the vehicle it is one more console on MAVLink, at an address of this computer, with number 254 and the
boat's key: what it hands on is judged there as everything else, and only whoever commands is obeyed. Its heartbeat, by which
the boat knows that somebody watches, goes as long as sessions with the satellite succeed.
"""

import asyncio
import contextlib
import logging
import math
import socket
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from delfim import config
from delfim.base.clock import Clock
from delfim.base.errors import FormatError, PermanentFailure, in_words
from delfim.base.input.keys import read_key
from delfim.base.ranges import address
from delfim.lines.serialline import SerialLine
from delfim.parts.iridium import orders
from delfim.parts.iridium.modem import OUT_MAX, SbdLine, SbdSession
from delfim.parts.iridium.table import IridiumTable
from delfim.parts.mavlink.codec import ownorders, wire
from delfim.parts.mavlink.codec.signing import Kept, Signing, read_stamps, write_stamps
from delfim.parts.mavlink.codec.wire import dialect
from delfim.parts.mavlink.table import Mavlink
from delfim.services.runtime import Runtime

AGAIN_S: Final = (10.0, 30.0, 60.0, 120.0, 300.0)  # until the next try, after sessions that failed
LOST: Final = 3  # so many times `every_s` without a session, nobody watches the boat by satellite
FRESH_S: Final = 30.0  # an older report is none
HEARTBEAT_S, ASK_S = 1.0, 5.0
ORDER_S, ORDER_LIFE_S = 1.0, 10.0  # between two tries to give the boat an order, and until it is given up
ANSWERS: Final = 4  # that wait for a session
TICK_S: Final = 0.1
DATAGRAM_BYTES: Final = 2048

log = logging.getLogger(__name__)


class PendingOrder:
    """An order on its way to the vehicle."""

    def __init__(self, number: int, words: bytes, now_s: float) -> None:
        self.number, self.words, self.since_s, self.due_s = number, words, now_s, now_s


class SatelliteConsole:
    """No socket and no line: `to_vehicle` and `to_modem` take bytes. `last` is the stamp of the last order, `keep` takes the
    next one."""

    def __init__(
        self,
        settings: config.Vehicle,
        key: bytes,
        clock: Clock,
        to_vehicle: Callable[[bytes], object],
        to_modem: Callable[[bytes], object],
        last: int,
        keep: Callable[[int], object],
    ) -> None:
        self._table, self._system, self._key, self._clock = settings.of(IridiumTable), settings.boat.id, key, clock
        self._to_vehicle, self._last, self._keep = to_vehicle, last, keep
        self._signing = Signing(key, clock)
        self._pack = orders.pack(self._signing)
        self.line = SbdLine(to_modem)
        self.counts = dict.fromkeys(("sessions", "failed", "orders", "refused"), 0)
        self._report, self._report_s = b"", -math.inf
        self._answers = deque[bytes](maxlen=ANSWERS)
        self._saying: list[bytes] = []  # the answers in the message that is under way
        self._order: PendingOrder | None = None
        self._met_s = -math.inf  # the last session
        self._failed = 0  # sessions, since then
        self._due_s, self._beat_s, self._ask_s = clock.monotonic_s() + FRESH_S, -math.inf, -math.inf

    def from_vehicle(self, datagram: bytes) -> None:
        """Takes frames of the vehicle: its report, and its answer to an order."""
        for frame in wire.frames(datagram)[0]:
            try:
                message = wire.decode(frame)
            except FormatError:
                continue
            if message is None or message.get_srcSystem() != self._system:
                continue
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_HIGH_LATENCY2:
                self._report, self._report_s = frame, self._clock.monotonic_s()
            elif message.get_msgId() == ownorders.EXTENSION and message.message_type == ownorders.ANSWER:
                self._answered(message, frame)

    def _answered(self, message: Any, frame: bytes) -> None:
        order = self._order
        if order is not None and (message.target_system, ownorders.numbered(message)[0]) == (orders.SATELLITE, order.number):
            self._order = None
            self._answer(frame)

    def _answer(self, frame: bytes) -> None:
        """An answer for the shore, with a new report, at once."""
        self._answers.append(frame)
        self._due_s = self._clock.monotonic_s() + 2.0  # the report that follows knows of it

    def from_modem(self, data: bytes) -> None:
        over = self.line.feed(data, self._clock.monotonic_s())
        if over is not None:
            self._ended(over)

    def tick(self) -> None:
        """Due ten times a second."""
        now_s = self._clock.monotonic_s()
        if self.line.tick(now_s):
            self._ended(None)
        if now_s >= self._beat_s + HEARTBEAT_S and now_s - self._met_s < LOST * self._table.every_s:
            self._beat_s = now_s
            kinds = dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID, 0, 0, dialect.MAV_STATE_ACTIVE
            self._say(dialect.MAVLink_heartbeat_message(*kinds, 3))
        if now_s >= self._ask_s + ASK_S:
            self._ask_s = now_s
            asked = dialect.MAV_CMD_CONTROL_HIGH_LATENCY, 0, 1.0, *(0.0,) * 6
            self._say(dialect.MAVLink_command_long_message(self._system, 1, *asked))
        self._give(now_s)
        if now_s >= self._due_s and not self.line.is_busy:
            self._begin(now_s)

    def report(self) -> dict[str, object]:
        """The report, JSON-ready."""
        now_s = self._clock.monotonic_s()
        silent = "the vehicle has told no report" if now_s - self._report_s > FRESH_S else ""
        troubles = {"modem": self.line.reason, "vehicle": silent}
        met_s = None if self._met_s == -math.inf else round(now_s - self._met_s, 1)
        return {
            "troubles": {part: words for part, words in troubles.items() if words},
            "session_age_s": met_s,
            "counts": dict(self.counts),
        }

    def _say(self, message: wire.Message) -> None:
        self._to_vehicle(self._pack(message))

    def _give(self, now_s: float) -> None:
        """The order that came, to the vehicle, until it answers."""
        order = self._order
        if order is None or now_s < order.due_s:
            return
        if now_s - order.since_s > ORDER_LIFE_S:
            self._order = None
            self._refuse(order.number, "the vehicle does not answer")
            return
        order.due_s = now_s + ORDER_S
        self._say(ownorders.order((self._system, 1), order.number, order.words))

    def _refuse(self, number: int, why: str) -> None:
        self.counts["refused"] += 1
        log.warning("iridium: order refused: %s", why)
        self._answer(self._pack(ownorders.answer((orders.SATELLITE, orders.COMPONENT), number, why)))

    def _begin(self, now_s: float) -> None:
        message, self._saying = self._report if now_s - self._report_s <= FRESH_S else b"", []
        for answer in self._answers:
            if len(message) + len(answer) <= OUT_MAX:
                message += answer
                self._saying.append(answer)
        self._due_s = now_s + self._table.every_s
        self.line.begin(message, now_s)

    def _ended(self, over: SbdSession | None) -> None:
        now_s = self._clock.monotonic_s()
        if over is None or not over.is_sent:
            self.counts["failed"] += 1
            self._due_s = now_s + min(AGAIN_S[min(self._failed, len(AGAIN_S) - 1)], self._table.every_s)
            self._failed += 1
            return
        self.counts["sessions"] += 1
        self._met_s, self._failed = now_s, 0
        for answer in self._saying:
            with contextlib.suppress(ValueError):  # newer ones took its place
                self._answers.remove(answer)
        if over.queued or self._answers:
            self._due_s = now_s
        for frame in wire.frames(over.heard)[0]:
            self._take(frame, now_s)

    def _take(self, frame: bytes, now_s: float) -> None:
        """An order, which is answered. One that is not by a holder of the key is counted, and nothing is said."""
        try:
            stamp = orders.opened(frame, self._key, self._last, self._table.order_age_s, self._clock.time_ns())
        except FormatError as error:
            self.counts["refused"] += 1
            log.warning("iridium: message refused: %s", error)
            return
        self._last = stamp
        self._keep(stamp)
        try:
            number, words = orders.order_in(frame, self._system)
        except FormatError as error:
            self._refuse(0, str(error))
            return
        self.counts["orders"] += 1
        self._order = PendingOrder(number, words, now_s)


async def serve(runtime: Runtime) -> None:
    """Run the service until it is cancelled."""
    settings, loop = runtime.config, asyncio.get_running_loop()
    table, vehicle = settings.of(IridiumTable), address(settings.of(Mavlink).listen)
    kept = Path(settings.log.directory) / "iridium-stamps"
    with contextlib.ExitStack() as links:
        family = socket.AF_INET6 if ":" in vehicle[0] else socket.AF_INET
        door = links.enter_context(socket.socket(family, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK))
        try:
            key = read_key(settings.of(Mavlink).key)
            door.connect(vehicle)  # it hears this address alone
            port = SerialLine(table.device, table.baud, runtime.clock, may_lack=True)
        except OSError as error:
            raise PermanentFailure(f"iridium: {in_words(error)}") from None
        links.callback(port.close)

        def to_vehicle(frame: bytes) -> None:
            with contextlib.suppress(OSError):  # no vehicle yet: it is said again
                door.send(frame)

        def keep(stamp: int) -> None:
            with contextlib.suppress(OSError):  # no disk: the check of the log reports it
                write_stamps(kept, Kept(stamp))

        console = SatelliteConsole(settings, key, runtime.clock, to_vehicle, port.write, read_stamps(kept).sent, keep)

        def hear() -> None:
            with contextlib.suppress(BlockingIOError, ConnectionError):
                console.from_vehicle(door.recv(DATAGRAM_BYTES))

        for file, callback in ((door, hear), (port, lambda: console.from_modem(port.read()))):
            loop.add_reader(file.fileno(), callback)
            links.callback(loop.remove_reader, file.fileno())
        links.enter_context(runtime.publishing("iridiumd", console.report))
        opened_s = -math.inf
        while True:
            if runtime.clock.monotonic_s() - opened_s >= 1.0:
                opened_s = runtime.clock.monotonic_s()
                await loop.run_in_executor(None, port.rebind)
            console.tick()
            await asyncio.sleep(TICK_S)
