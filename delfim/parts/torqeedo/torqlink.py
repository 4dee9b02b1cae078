"""Torqeedo motors with TorqLink as thrusters, a CAN bus for each, as ArduPilot's script for them knows it (docs/torqeedo.md).

Identifiers are those of J1939: priority 3, group, address. A command has no number of a motor, so each motor has a bus of its
own. A motor turns only while it says that it is ready, and from one way to the other by neutral. What it does when it hears no
command, and what else it tells of itself, the maker does not publish.
"""

import errno
import math
from typing import Final

from delfim import config
from delfim.base.errors import FormatError
from delfim.base.frames import extended
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.parts.torqeedo.table import TorqlinkTable
from delfim.vehicle.links import Links, received
from delfim.vehicle.state import Actuation, State, ThrusterReport

SPEED, GEAR, STATUS = 0xF003, 0xF005, 0xFF13  # groups: of an engine's pedal, of a gear box, Torqeedo's own
ADDRESS: Final = 0xD0  # of who commands
FULL: Final = 250  # of a speed
ASTERN, NEUTRAL, AHEAD = 124, 125, 126  # gears
READY: Final = 0x80  # in byte 4 of the status
SILENT_S: Final = 1.0  # a motor that said no longer that it is ready is not
SETTLE_S: Final = 2.0  # neutral, after a motor became ready
NEUTRAL_S: Final = 1.0  # between ahead and astern
_GROUP: Final = 0x3FFFF00  # in an identifier
_REST: Final = b"\xff" * 6  # of a message: not told
HEARD: Final = CanAddress(extended(STATUS << 8), (0x1FFFFFFF & ~_GROUP) << 3)


def command(speed: int) -> list[tuple[int, bytes]]:
    """The frames of a speed, -FULL to FULL: how fast, then which way."""
    gear = NEUTRAL if speed == 0 else AHEAD if speed > 0 else ASTERN
    return [(_arb(SPEED), bytes((0xFF, abs(speed))) + _REST), (_arb(GEAR), bytes((gear, 0xFF)) + _REST)]


def _arb(group: int) -> int:
    return extended(3 << 26 | group << 8 | ADDRESS)


STOP: Final = command(0)


def is_ready(data: bytes) -> bool:
    """Whether a status says so. Raises FormatError for one that is too short."""
    if len(data) < 5:
        raise FormatError(f"the status of a TorqLink motor has only {len(data)} bytes")
    return bool(data[4] & READY)


class TorqlinkMotor:
    """The motor of a row."""

    def __init__(self, index: int, row: config.ThrusterTable, socket: CanSocket) -> None:
        self.input, self._index, self.name = socket, index, row.name
        self._full = -FULL if row.reversed else FULL
        self._wanted = 0
        self._way, self._way_s = 0, -math.inf  # the last one that was told, and when
        self._ready_s, self._since_s = -math.inf, math.inf  # when it said so last, and since when it does

    def send(self, sent: Actuation, now_s: float) -> int:
        wanted = round(self._full * sent.thrust[self._index]) if sent.run else 0
        self._wanted = min(max(wanted, -FULL), FULL)
        return self.repeat(now_s)

    def repeat(self, now_s: float) -> int:
        """Tell the speed, or neutral while it must not turn; a motor that is not ready takes no other."""
        refuses, speed = self._wanted and self.withheld(now_s), self._wanted
        if refuses or (speed * self._way < 0 and now_s - self._way_s < NEUTRAL_S):
            speed = 0
        elif speed:
            self._way, self._way_s = (1 if speed > 0 else -1), now_s
        return self.input.send_many(command(speed)) + bool(refuses)

    def stop(self) -> int:
        return self.input.send_many(STOP)

    def withheld(self, now_s: float) -> str:
        """Why it is told nothing but neutral; empty: it is told all."""
        if now_s - self._ready_s > SILENT_S:
            return "it does not say that it is ready"
        return "" if now_s - self._since_s >= SETTLE_S else f"it is ready again, and rests for {SETTLE_S:.0f} s"

    def read(self, state: State, now_s: float) -> None:
        """Take its status. Malformed ones are counted."""
        for frame in received(self.input, state, Torqlinks.name):
            try:
                ready = is_ready(frame.data)
            except FormatError:
                state.count("torqlink_malformed")
                continue
            if ready and now_s - self._ready_s > SILENT_S:
                self._since_s = now_s
            self._ready_s = now_s if ready else -math.inf
            state.thrusters[self.name] = ThrusterReport(now_s, refuses=self.withheld(now_s))


class Torqlinks:
    """The motors of the rows that name them."""

    name = "torqlink"
    period_s: float | None = 0.05  # as ArduPilot commands them

    def __init__(self, motors: tuple[TorqlinkMotor, ...]) -> None:
        self._motors = self.inputs = motors
        self._told_s = -math.inf

    def begin(self, state: State, now_s: float) -> None:
        """Note that no motor is ready before it says so: one that is never heard is a thruster that does not obey."""
        state.thrusters |= {each.name: ThrusterReport(now_s, refuses=each.withheld(now_s)) for each in self._motors}

    def send(self, sent: Actuation, now_s: float) -> int:
        self._told_s = now_s
        return sum(each.send(sent, now_s) for each in self._motors)

    def repeat(self, now_s: float) -> int:
        self._told_s = now_s
        return sum(each.repeat(now_s) for each in self._motors)

    def stop(self) -> None:
        untaken = [each.stop() for each in self._motors]  # all of them, whatever the first one does
        if any(untaken):
            raise OSError(errno.ENOBUFS, "the bus of a TorqLink motor does not take the stop")

    def disconnect(self, names: tuple[str, ...]) -> None:
        """Do nothing: the bus has no message for that."""

    def report(self) -> dict[str, object]:
        """The motors that are told nothing but neutral, and why."""
        return {each.name: why for each in self._motors if (why := each.withheld(self._told_s))}


def open_actuator(settings: config.Vehicle, links: Links) -> Torqlinks:
    """Open the driver. Raises DelfimError."""
    ports = settings.of(TorqlinkTable).ports
    rows = [(index, row) for index, row in enumerate(settings.thrusters) if row.driver == Torqlinks.name]
    return Torqlinks(tuple(TorqlinkMotor(index, row, links.bus(ports[row.name].interface, (HEARD,))) for index, row in rows))
