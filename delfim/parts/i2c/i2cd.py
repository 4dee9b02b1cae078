"""i2cd: reads the sensors on the computer's I2C buses, and tells them as NMEA 0183 to a port of the boat (docs/i2c.md).

A transfer on I2C blocks, so this is a process of its own, with a thread for each bus. What hangs there costs its sensors, which
then are silent, and the boat knows what to do without a compass.
"""

import asyncio
import contextlib
import errno
import logging
import socket
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Final

from delfim.base.clock import Clock
from delfim.base.errors import FormatError, PermanentFailure, in_words
from delfim.base.ranges import address
from delfim.parts.i2c.bmp390 import Bmp390
from delfim.parts.i2c.bno085 import Bno085
from delfim.parts.i2c.buses import I2cBus, KernelBus
from delfim.parts.i2c.chips import I2cChip, sentences
from delfim.parts.i2c.icm20948 import Icm20948
from delfim.parts.i2c.ina226 import Ina226
from delfim.parts.i2c.table import I2cSensor, I2cTable
from delfim.services.runtime import Runtime

CHIPS: Final[dict[str, Callable[[I2cSensor], I2cChip]]] = {
    "bno085": Bno085,
    "ina226": Ina226,
    "bmp390": Bmp390,
    "icm20948": Icm20948,
}
FAILURES: Final = 3  # in a row that are a trouble; one lost transfer is none
SILENT_S: Final = 3.0  # without a new measurement, after which a chip is set up anew
AGAIN_S: Final = 1.0  # to the next try with a chip, or a bus, that failed
HANGS_S: Final = 2.0  # for one round of a bus
LEAST_S: Final = 0.005  # between two rounds
WORDS: Final = {
    **dict.fromkeys((errno.ENXIO, errno.EREMOTEIO, errno.ENODEV), "nothing answers there: is it wired, and has it power?"),
    errno.EOPNOTSUPP: "this bus has the transfers of SMBus alone, and the chip needs others",
    errno.EIO: "its answer broke off: are wires and pull-ups sound?",
    errno.ETIMEDOUT: "the bus hangs: something holds its clock or data low",
    errno.EBUSY: "a driver of the kernel has it",
    errno.ENOENT: "there is no such bus: is I2C switched on? (docs/i2c.md)",
}

log = logging.getLogger(__name__)


def _why(error: OSError | FormatError) -> str:
    return WORDS.get(getattr(error, "errno", None) or 0) or in_words(error)


class WatchedSensor:
    """A sensor, set up when it is there, and anew when it failed or fell silent. Only `step` may block."""

    def __init__(self, name: str, table: I2cSensor) -> None:
        self.name, self.table, self._chip = name, table, CHIPS[table.chip](table)
        self.due_s = 0.0
        self.heard_s: float | None = None
        self.told, self.failed, self.trouble = 0, 0, "not heard yet"
        self.begun, self._row, self._since_s = False, 0, 0.0  # it is set up; failures in a row; when it was set up, or heard

    def step(self, bus: I2cBus, now_s: float) -> bytes:
        """Read it; returns what is to be told. Raises nothing."""
        self.due_s = max(self.due_s + self._chip.period_s, now_s)
        try:
            if not self.begun:
                self._chip.begin(bus)
                self.begun, self._since_s = True, now_s
                return b""
            reading = self._chip.read(bus, now_s)
        except (OSError, FormatError) as error:
            self._row, self.failed = self._row + 1, self.failed + 1
            if self._row >= FAILURES or not self.begun:
                self.fail(_why(error), now_s)
            return b""
        self._row = 0
        if reading is not None:
            self.heard_s = self._since_s = now_s
            self.told += 1
            self._tell("")
            return sentences(self.name, reading)
        if now_s - self._since_s > SILENT_S:
            self.fail(f"it answers, and measures nothing new for {SILENT_S:.0f} s", now_s)
        return b""

    def found(self) -> dict[str, object]:
        """What a chip finds out about itself: the calibration of a compass."""
        return {"calibration": self._chip.calibration()} if isinstance(self._chip, Icm20948) else {}

    def fail(self, why: str, now_s: float) -> None:
        """Set it up anew, a little later."""
        self._row, self.begun, self.due_s = 0, False, now_s + AGAIN_S
        self._tell(why)

    def _tell(self, trouble: str) -> None:
        if trouble != self.trouble:
            word = f"i2c: {self.name} ({self.table.chip} at {self.table.at:#x} of {self.table.bus}): {trouble or 'measures'}"
            log.log(logging.WARNING if trouble else logging.INFO, "%s", word)
        self.trouble = trouble


class WatchedBus:
    """A bus with its sensors. `step` is for its thread."""

    def __init__(
        self, device: str, sensors: tuple[WatchedSensor, ...], clock: Clock, opened: Callable[[str], I2cBus] = KernelBus
    ) -> None:
        self.device, self.sensors, self._clock, self._open = device, sensors, clock, opened
        self._bus: I2cBus | None = None
        self.busy_s: float | None = None  # since when a round lasts

    @property
    def due_s(self) -> float:
        return min(each.due_s for each in self.sensors)

    def step(self) -> bytes:
        """Read all that are due; returns what is to be told. Raises nothing."""
        self.busy_s, told = self._clock.monotonic_s(), b""
        try:
            if self._bus is None:
                self._bus = self._open(self.device)
            for each in self.sensors:
                if each.due_s <= (now_s := self._clock.monotonic_s()):
                    told += each.step(self._bus, now_s)
            if not any(each.begun for each in self.sensors):
                self.close()  # an adapter on USB that was pulled out comes back as another one
        except OSError as error:
            self.close()
            for each in self.sensors:
                each.fail(_why(error), self._clock.monotonic_s())
        self.busy_s = None
        return told

    def close(self) -> None:
        if self._bus is not None:
            self._bus.close()
            self._bus = None

    def report(self) -> dict[str, object]:
        """Of each sensor its age, its trouble in words, and how often it told and failed."""
        now_s, busy_s = self._clock.monotonic_s(), self.busy_s
        hangs = (
            "" if busy_s is None or now_s - busy_s < HANGS_S else f"{self.device} has not come back for {now_s - busy_s:.0f} s"
        )
        return {
            each.name: {
                "chip": each.table.chip,
                "age_s": None if each.heard_s is None else round(now_s - each.heard_s, 1),
                "trouble": hangs or each.trouble,
                "told": each.told,
                "failed": each.failed,
                **each.found(),
            }
            for each in self.sensors
        }


def buses_of(sensors: Mapping[str, I2cSensor], clock: Clock, opened: Callable[[str], I2cBus] = KernelBus) -> list[WatchedBus]:
    """The buses of the vehicle's file, with their sensors."""
    by_bus = dict[str, list[WatchedSensor]]()
    for name, table in sensors.items():
        by_bus.setdefault(table.bus, []).append(WatchedSensor(name, table))
    return [WatchedBus(device, tuple(these), clock, opened) for device, these in by_bus.items()]


async def serve(runtime: Runtime) -> None:
    """Run the service until it is cancelled."""
    status = runtime.status.get("i2cd")
    if status is not None and status.place == "runtime":
        raise PermanentFailure("i2cd: a bus may hang, and the vehicle waits for none; write services.i2cd.place = 'process'")
    table: I2cTable = runtime.config.table("i2c")
    host, port = address(table.to.removeprefix("udp:"))
    buses, loop = buses_of(table.sensors, runtime.clock), asyncio.get_running_loop()

    async def follow(bus: WatchedBus) -> None:
        while True:
            told = await loop.run_in_executor(threads, bus.step)
            with contextlib.suppress(OSError):  # what the boat does not take now is too old later
                if told:
                    way.sendto(told, (host, port))
            await asyncio.sleep(max(bus.due_s - runtime.clock.monotonic_s(), LEAST_S))

    def figures() -> dict[str, object]:
        return {name: told for bus in buses for name, told in bus.report().items()}

    with contextlib.ExitStack() as closing:
        way = closing.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK))
        threads = ThreadPoolExecutor(len(buses), "i2c")
        closing.callback(threads.shutdown, wait=False)  # one that hangs ends with the process
        closing.enter_context(runtime.publishing("i2cd", figures))
        async with asyncio.TaskGroup() as group:
            for bus in buses:
                group.create_task(follow(bus))
