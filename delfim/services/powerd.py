"""powerd: notices that the power will be cut, and has everything ended in order (thesis 3.3).

It listens for the shutdown frame, looks at a button and at the batteries, and hands each order to the supervisor, which ends
the programs, the vehicle first, unmounts the log partition and acknowledges: docs/powerd.md. All it knows comes from the
bus and, on a boat with batteries or motors that are not DelfimX's own, from the vehicle's report, as a console hears it: it
does the same in the runtime and in a process of its own. Batteries and commands on DelfimX's own bus are not left to that:
empty batteries must end the computer in order also where the vehicle is dead, and no report is made for a boat that needs none.
"""

import asyncio
import contextlib
import logging
import os
import struct
from collections.abc import Mapping
from math import inf
from typing import Final

from delfim import config
from delfim.base.clock import Clock
from delfim.base.errors import FormatError
from delfim.base.frames import Frame
from delfim.canproxy.dsor.messages import (
    PROPELLER_PORT,
    PROPELLER_STARBOARD,
    SHUTDOWN,
    SHUTDOWN_ACKNOWLEDGE,
    BatteriesStatus,
    Node,
    ShutdownAcknowledge,
    ShutdownStage,
    pack_shutdown_acknowledge,
    sysstat_arb,
    unpack_propeller_command,
    unpack_shutdown,
    unpack_sysstat,
)
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import CanAddress
from delfim.services.report_feed import watch
from delfim.services.runtime import Runtime
from delfim.services.supervision import shutdown
from delfim.services.tables import PowerdTable
from delfim.vehicle.failsafe.nodehealth import NAMES
from delfim.vehicle.failsafe.troubles import DEAD_V
from delfim.vehicle.report import BoatReport

LOOK_S: Final = 0.25  # between two looks at button and batteries
FRAMES_PER_READ: Final = 64
FRESH_S: Final = 5.0  # a battery, or a vehicle, that was silent for longer says nothing
BATTERIES: Final = {sysstat_arb(node): node for node in (Node.BATTERIES_STARBOARD, Node.BATTERIES_PORT)}
INPUT_EVENT: Final = struct.Struct("llHHi")  # linux/input.h
EV_KEY, KEY_POWER = 1, 116
EVENTS_BYTES: Final = 64 * INPUT_EVENT.size

log = logging.getLogger(__name__)


class Button:
    """A power button: an input device that sends KEY_POWER, or a file whose first characters show it."""

    def __init__(self, path: str, text: str) -> None:
        self._path, self._text = path, text.encode()
        self._is_device = path.startswith("/dev/input/")
        self._fd = -1
        self.is_pressed = False
        self.reason = "" if path else "none"  # why it cannot be read, in words

    def pressed(self) -> bool:
        """Whether it is pressed now. A button that cannot be read is not pressed, and is tried again."""
        if not self._path:
            return False
        try:
            if self._fd < 0:
                self._fd = os.open(self._path, os.O_RDONLY | os.O_NONBLOCK)
            self.is_pressed = self._keys() if self._is_device else os.pread(self._fd, 64, 0).startswith(self._text)
            self.reason = ""
        except OSError as error:
            self.close()
            if not self.reason:
                log.error("powerd: button %s: %s", self._path, error.strerror)
            self.reason, self.is_pressed = error.strerror or str(error), False
        return self.is_pressed

    def _keys(self) -> bool:
        """The state of the button at the end of the device's queue."""
        state = self.is_pressed
        with contextlib.suppress(BlockingIOError):
            while data := os.read(self._fd, EVENTS_BYTES):
                for _, _, kind, code, value in INPUT_EVENT.iter_unpack(data):
                    if (kind, code) == (EV_KEY, KEY_POWER):
                        state = value != 0
        return state

    def close(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


class Powerd:
    """The state of the inputs. `order` and `reason` are set when the power is to be cut. `watches`: the vehicle's report is
    used, too, and while it is silent its motors count as driven, because nobody knows."""

    def __init__(self, settings: PowerdTable, clock: Clock, watches: bool = False) -> None:
        self._settings, self._clock, self._watches = settings, clock, watches
        self.order: shutdown.Word | None = None
        self.reason = ""
        self.malformed = 0
        self.button = Button(settings.button, settings.button_pressed)
        self._charges = dict[str, tuple[float, float]]()  # by battery: charge, and when it was reported
        self._voltages = dict[str, tuple[float, float]]()  # by battery or thruster: the same in V
        self._pressed_s = inf  # when the button was first seen pressed
        self._told_s = -inf  # when the vehicle last told its state
        self._silence = "it has not answered yet" if watches else ""
        self._driven_s = self._enough_s = clock.monotonic_s()  # when a propeller last was to run, the batteries had enough

    def on_frame(self, frame: Frame) -> None:
        """Take a frame of the bus. Malformed ones are counted."""
        now_s = self._clock.monotonic_s()
        try:
            if frame.arb == SHUTDOWN:
                order = unpack_shutdown(frame.data)
                self._ask("reboot" if order.reboot else "off", "shutdown frame")
            elif frame.arb in (PROPELLER_STARBOARD, PROPELLER_PORT):
                if unpack_propeller_command(frame.data).run:
                    self._driven_s = now_s
            elif (node := BATTERIES.get(frame.arb)) is not None:
                status = unpack_sysstat(node, frame.data)
                if isinstance(status, BatteriesStatus) and status.charge is not None:
                    self._charges[NAMES[node]] = status.charge, now_s
        except FormatError:
            self.malformed += 1

    def on_state(self, state: BoatReport) -> None:
        """Take the vehicle's state: batteries on any bus, the voltage at each thruster, and whether thrusters are to run."""
        self._told_s = now_s = self._clock.monotonic_s()
        self._silence = ""
        if state.run:
            self._driven_s = now_s
        for name, node in state.sysstat.items():
            self._take(name, node.charge, node.voltage_v, state.age_s.get(name), now_s)
        for name, facts in state.thrusters.items():
            self._take(name, None, facts.voltage_v, facts.age_s, now_s)

    def _take(self, name: str, charge: float | None, voltage_v: float | None, age_s: float | None, now_s: float) -> None:
        if age_s is None:
            return
        if charge is not None:
            self._charges[name] = charge, now_s - age_s
        if voltage_v is not None and voltage_v > DEAD_V:  # less is no battery's voltage, but a controller's without one
            self._voltages[name] = voltage_v, now_s - age_s

    def on_silence(self, why: str) -> None:
        """Note, in words, why the vehicle does not answer."""
        self._silence = why

    def look(self) -> None:
        """Check the button and the batteries; due every LOOK_S."""
        now_s, settings = self._clock.monotonic_s(), self._settings
        self._pressed_s = min(self._pressed_s, now_s) if self.button.pressed() else inf
        if now_s - self._pressed_s >= settings.button_s:
            self._ask("off", "button")
        if self._watches and now_s - self._told_s > FRESH_S:
            self._driven_s = now_s
        if not (empty := self._empty(now_s)):
            self._enough_s = now_s
        elif now_s - max(self._enough_s, self._driven_s) >= settings.battery_s:
            self._ask("off", empty)

    def _empty(self, now_s: float) -> str:
        """The reason, in words, why the batteries are empty; empty while they are not, or nobody reports."""
        charge, voltage_v, settings = _least(self._charges, now_s), _least(self._voltages, now_s), self._settings
        if settings.battery_charge and charge <= settings.battery_charge:
            return f"batteries at {charge:.0%}"
        return f"batteries at {voltage_v:.1f} V" if settings.battery_v and voltage_v <= settings.battery_v else ""

    def _ask(self, word: shutdown.Word, reason: str) -> None:
        if self.order is None:
            self.order, self.reason = word, reason

    def report(self) -> dict[str, object]:
        """The report, JSON-ready."""
        now_s = self._clock.monotonic_s()
        charge, voltage_v = _least(self._charges, now_s), _least(self._voltages, now_s)
        return {
            "shutdown": self.reason,
            "button": self.button.reason or ("pressed" if self.button.is_pressed else "not pressed"),
            "battery_charge": None if charge == inf else charge,
            "battery_v": None if voltage_v == inf else voltage_v,
            "vehicle": self._silence,
            "malformed": self.malformed,
        }


def _least(told: Mapping[str, tuple[float, float]], now_s: float) -> float:
    """The least value that was reported lately; infinite where none was."""
    return min((value for value, at_s in told.values() if now_s - at_s < FRESH_S), default=inf)


def is_told_by_vehicle(settings: config.Vehicle) -> bool:
    """Whether batteries or motors of this boat are unknown on DelfimX's own bus, or its voltage matters."""
    others = any(settings.facts("batteries")) or any(part.batteries for part in settings.sensing)
    return bool(others or settings.of(PowerdTable).battery_v or settings.driven("nodes", False))


async def serve(runtime: Runtime) -> None:
    """Run the service until it is cancelled."""
    settings = runtime.config
    watches = is_told_by_vehicle(settings)
    heard = Powerd(settings.of(PowerdTable), runtime.clock, watches)
    with contextlib.ExitStack() as links:
        links.callback(heard.button.close)
        can = links.enter_context(open_can(settings.can.interface))
        can.setblocking(False)
        can.bind(*(CanAddress(arb) for arb in (SHUTDOWN, PROPELLER_STARBOARD, PROPELLER_PORT, *BATTERIES)))

        def on_readable() -> None:
            for _ in range(FRAMES_PER_READ):
                frame = can.receive()
                if frame is None:
                    break
                heard.on_frame(frame)
                if frame.arb == SHUTDOWN and heard.order:
                    act()

        acted, begun = asyncio.Event(), pack_shutdown_acknowledge(ShutdownAcknowledge(ShutdownStage.BEGUN, 0))

        def act() -> None:
            """For each order: a repeated one is acknowledged again."""
            with contextlib.suppress(OSError):  # a bus that is full or gone: the computer ends all the same
                can.sendto(begun, CanAddress(SHUTDOWN_ACKNOWLEDGE))
            if not acted.is_set():
                acted.set()
                ask(runtime, heard.order or "off", heard.reason)

        def look() -> None:
            can.rebind()
            heard.look()
            if heard.order and not acted.is_set():
                act()

        links.enter_context(runtime.reading(can.fileno(), on_readable))
        links.enter_context(runtime.publishing("powerd", heard.report))
        links.enter_context(runtime.ticking(LOOK_S, look))
        if watches:
            await watch(settings.console.socket, heard.on_state, heard.on_silence)
        await asyncio.Event().wait()


def ask(runtime: Runtime, word: shutdown.Word, reason: str) -> None:
    """Have everything ended in order. Without a supervisor this process does it: the boat is stopped in any case."""
    try:
        shutdown.request(shutdown.socket_path(runtime.config.runtime.run_directory), word, reason)
    except OSError as error:
        runtime.stop(f"{reason}; no supervisor to end the other programs: {error.strerror}")
