"""nmea2000d: makes the boat a device of its NMEA 2000 bus, which sends others what it knows (docs/nmea2000.md).

A process of its own, which watches the vehicle as a console does and hands nothing back: whatever is said on that bus, it does
not reach the vehicle from here.
"""

import contextlib
import logging
from collections import Counter, deque
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Final

from delfim import config
from delfim.base.clock import Clock
from delfim.base.errors import BusError, FormatError, PermanentFailure, in_words
from delfim.base.input.untrusted import read_text
from delfim.canproxy.nmea2000.device import FIRST, Device, facts_of
from delfim.canproxy.nmea2000.parcels import NOBODY, Parcel, frames
from delfim.canproxy.nmea2000.pgns import ADDRESS_MAX
from delfim.canproxy.opening import open_bound
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.parts.nmea2000.nmea2000rows import TOLD, Alerts, Telling, pgns_of
from delfim.parts.nmea2000.table import Nmea2000
from delfim.services.report_feed import watch
from delfim.services.runtime import Runtime
from delfim.vehicle.report import BoatReport

TICK_S: Final = 0.02
REBIND_TICKS: Final = 50
FRAMES_A_LOOK: Final = 64
WAITING: Final = 64  # messages that wait for the bus
OLD_S: Final = 1.0  # a message that waited for longer is not sent any more
EARLY_S: Final = 0.03  # a state that comes so much before a message is due is in time: states come every 0.1 s, more or less
AWAY_S: Final = 2.0  # a bus that took nothing for so long is joined anew: others may have come or gone
FULL: Final = "the bus takes no frames: it is overloaded, or nobody acknowledges them"
log = logging.getLogger(__name__)


class ParcelQueue:
    """Messages that are to be sent on the bus, in their order, as fast as it takes them."""

    def __init__(self, bus: CanSocket) -> None:
        self._bus = bus
        self._waiting = deque[tuple[float, Parcel, deque[tuple[int, bytes]]]]()
        self._sequences = Counter[int]()
        self.sent = Counter[int]()  # messages, by PGN
        self.lost = Counter[str]()  # messages, by reason
        self.trouble = ""  # why nothing can be sent, in words
        self._away_s: float | None = None  # since when
        self.has_returned = False  # after a while away; whoever joins the bus anew clears it

    def put(self, parcel: Parcel, now_s: float) -> None:
        if len(self._waiting) >= WAITING:
            self.lost["too many wait"] += 1
            return
        self._waiting.append((now_s, parcel, deque(frames(parcel, self._sequences[parcel.pgn]))))
        self._sequences[parcel.pgn] += 1

    def drain(self, source: int, now_s: float) -> None:
        """Send what the bus takes. `source`: the device's address now; messages under an address that it lost stay here."""
        while self._waiting:
            born_s, parcel, left = self._waiting[0]
            if now_s - born_s > OLD_S:
                self._drop("too old")
            elif parcel.source not in (source, NOBODY):
                self._drop("address lost")
            else:
                try:
                    while left:
                        self._bus.sendto(left[0][1], CanAddress(left[0][0]))
                        left.popleft()
                except BlockingIOError:
                    return self._fail(FULL, now_s)
                except OSError as error:
                    self._drop("bus")
                    return self._fail(in_words(error), now_s)
                self.sent[parcel.pgn] += 1
                self._waiting.popleft()
                self._succeed(now_s)
        return None

    def _drop(self, why: str) -> None:
        self.lost[why] += 1
        self._waiting.popleft()

    def _fail(self, why: str, now_s: float) -> None:
        self._away_s = now_s if self._away_s is None else self._away_s
        if now_s - self._away_s > OLD_S and not self.trouble:
            self.trouble = why
            log.warning("nmea2000d: %s", why)

    def _succeed(self, now_s: float) -> None:
        if self._away_s is None:
            return
        if now_s - self._away_s > AWAY_S:
            self.has_returned = True
            self.lost["bus"] += len(self._waiting)
            self._waiting.clear()
        self._away_s, self.trouble = None, ""


class BoatDevice:
    """The device with the messages that the boat sends."""

    def __init__(self, bus: CanSocket, settings: config.Vehicle, clock: Clock, address: int, chance: Random) -> None:
        told = settings.of(Nmea2000).send
        self.device = Device(facts_of(settings), pgns_of(told), chance, address)
        self.parcels = ParcelQueue(bus)
        self._bus, self._settings, self._clock = bus, settings, clock
        self._rows = [row for name in told for row in TOLD[name]]
        self._due_s = dict.fromkeys((row.pgn for row in self._rows), -1e9)
        self._alerts = Alerts(self.device.name)
        self._cycle, self._silence = -1, "the vehicle has not answered yet"
        self._send(self.device.begin(clock.monotonic_s()))

    def on_frames(self) -> None:
        now_s = self._clock.monotonic_s()
        with contextlib.suppress(BusError):  # the bus is opened anew by and by
            for _ in range(FRAMES_A_LOOK):
                if (frame := self._bus.receive()) is None:
                    break
                self.device.feed(frame, now_s)
        self.tick()

    def tick(self) -> None:
        """Send what is due; call it some tens of times a second."""
        now_s = self._clock.monotonic_s()
        if self.parcels.has_returned:
            self.parcels.has_returned = False
            self._send(self.device.begin(now_s))
        self._send(self.device.step(now_s))
        self.parcels.drain(self.device.source, now_s)

    @property
    def is_quick(self) -> bool:
        """Whether any message is due more often than states come five times a second."""
        return any(row.period_s < 0.2 for row in self._rows)

    def heard(self, state: BoatReport) -> None:
        """Take a state that the vehicle just published."""
        self._silence = ""
        now_s, device = self._clock.monotonic_s(), self.device
        age_s = state.age_s.get("navigation")
        is_new = state.cycle != self._cycle and age_s is not None and age_s <= self._settings.navigation.stale_s
        self._cycle = state.cycle
        if not device.is_claimed:
            return
        telling = Telling(state, self._settings, self._alerts)
        for row in self._rows:
            is_due = now_s + EARLY_S >= self._due_s[row.pgn] or row.pgn in device.wanted
            if is_due and (is_new or not row.of_navigation):
                due_s = self._due_s[row.pgn]
                self._due_s[row.pgn] = (due_s if now_s - due_s <= row.period_s else now_s) + row.period_s
                self._send([Parcel(pgn, data, device.address, priority) for pgn, data, priority in row.make(telling)])
        device.wanted.clear()
        self.parcels.drain(device.source, now_s)

    def silent(self, why: str) -> None:
        """Note that the vehicle does not answer: nothing is sent of it."""
        self._silence = why

    def _send(self, parcels: list[Parcel]) -> None:
        for parcel in parcels:
            self.parcels.put(parcel, self._clock.monotonic_s())

    def report(self) -> dict[str, object]:
        """The report, JSON-ready."""
        troubles = {"NMEA 2000": self.parcels.trouble or self.device.trouble, "navigation": self._silence}
        return {
            "troubles": {part: words for part, words in troubles.items() if words},
            **self.device.report(),
            "sent": {str(pgn): count for pgn, count in sorted(self.parcels.sent.items())},
            "lost": dict(self.parcels.lost),
        }


class Memory:
    """Keeps the address on the disk: the device has the same one tomorrow."""

    def __init__(self, place: Path) -> None:
        self._place, self.address, self._kept = place, FIRST, -1
        try:
            self._kept = int(read_text(place))
            self.address = self._kept if 0 <= self._kept <= ADDRESS_MAX else FIRST
        except (OSError, FormatError, ValueError):  # there is none, or it is damaged: it gets one
            pass

    def keep(self, device: Device) -> None:
        if not device.is_claimed or device.address == self._kept:
            return
        self._kept = device.address
        log.info("nmea2000d: this is device %d of the bus, %016x", device.address, device.name)
        try:
            self._place.write_text(f"{device.address}\n")
        except OSError as error:
            log.warning("nmea2000d: %s; the address may be another one tomorrow", in_words(error))


async def serve(runtime: Runtime) -> None:
    """Run the service until it is cancelled."""
    status, settings = runtime.status.get("nmea2000d"), runtime.config
    if status is not None and status.place == "runtime":
        raise PermanentFailure("nmea2000d: it waits for the disk, which the runtime must not; write place = 'process'")
    filters = tuple(CanAddress(arb, mask) for arb, mask in Device.FILTERS)
    with contextlib.ExitStack() as links:
        bus = links.enter_context(open_bound(settings.can, settings.of(Nmea2000).interface, filters))
        memory = Memory(Path(settings.log.directory) / "nmea2000-address")
        speaker = BoatDevice(bus, settings, runtime.clock, memory.address, Random())
        links.enter_context(runtime.reading(bus.fileno(), speaker.on_frames, TICK_S))
        links.enter_context(runtime.ticking(TICK_S, speaker.tick))
        links.enter_context(runtime.ticking(TICK_S * REBIND_TICKS, _maintain(bus, memory, speaker.device)))
        links.enter_context(runtime.publishing("nmea2000d", speaker.report))
        await watch(settings.console.socket, speaker.heard, speaker.silent, quick=speaker.is_quick)


def _maintain(bus: CanSocket, memory: Memory, device: Device) -> Callable[[], None]:
    def maintain() -> None:
        bus.rebind()
        memory.keep(device)

    return maintain
