"""Torqeedo motors as thrusters: the boat is the master of each line, commands ten times a second and asks in between.

One message is under way at a time, because both ends share the wires: a motor has 25 ms for its reply. A motor that hears no
command stops by itself, and says so; how long that takes, the maker does not publish.
"""

import errno
import math
from typing import Final

from delfim import config
from delfim.base.errors import FormatError
from delfim.lines.binaryframes import BinaryFrames
from delfim.parts.torqeedo.table import BAUD, TorqeedoTable
from delfim.parts.torqeedo.tqframes import (
    ERRORS,
    FRAMING,
    PARAMETERS,
    STATUS,
    TorqeedoParameters,
    TorqeedoStatus,
    asked,
    drive,
    replied,
)
from delfim.vehicle.links import Links, ReadableLine
from delfim.vehicle.state import Actuation, State, ThrusterReport

REPLY_S: Final = 0.03  # after a message nothing but a stop is sent
STOP: Final = drive(0.0, 0)
QUESTIONS: Final = tuple(map(asked, (STATUS, PARAMETERS)))


class TorqeedoMotor:
    """The motor of a row."""

    def __init__(self, index: int, row: config.ThrusterTable, power_percent: int, line: ReadableLine) -> None:
        self.input, self._index, self._name, self._power = line, index, row.name, power_percent
        self._sign = -1.0 if row.reversed else 1.0
        self._frames, self._command = BinaryFrames(FRAMING), STOP
        self._said_s, self._turn = -math.inf, 0

    def send(self, sent: Actuation, now_s: float) -> bool:
        """Whether the command was taken. It waits for the next turn while a reply may be under way, but for a stop."""
        self._command = drive(self._sign * sent.thrust[self._index], self._power) if sent.run else STOP
        return (self._command is not STOP and self._is_answering(now_s)) or self._say(self._command, now_s)

    def repeat(self, now_s: float) -> bool:
        """Say what is due: the command each second time, and in between a question."""
        if self._is_answering(now_s):
            return True
        self._turn = self._turn + 1 & 3
        return self._say(self._command if self._turn & 1 else QUESTIONS[self._turn >> 1], now_s)

    def stop(self) -> bool:
        return self.input.write(STOP)

    def _is_answering(self, now_s: float) -> bool:
        return 0.0 <= now_s - self._said_s < REPLY_S

    def _say(self, message: bytes, now_s: float) -> bool:
        self._said_s = now_s
        return self.input.write(message)

    def read(self, state: State, now_s: float) -> None:
        """Take its replies. Malformed ones are counted."""
        before = self._frames.refused
        while data := self.input.read():
            for frame in self._frames.feed(data):
                try:
                    told = replied(frame)
                except FormatError:
                    state.count("torqeedo_malformed")
                    continue
                if told is not None:
                    self._take(told, state, now_s)
            if self.input.fileno() >= 0:
                break
        if self._frames.refused > before:
            state.count("torqeedo_malformed", self._frames.refused - before)

    def _take(self, told: TorqeedoStatus | TorqeedoParameters, state: State, now_s: float) -> None:
        """Take what this reply has; the rest stays as it was last told."""
        last = state.thrusters.get(self._name, ThrusterReport(now_s))
        if isinstance(told, TorqeedoStatus):
            faults = tuple(words for bit, words in enumerate(ERRORS) if told.errors >> bit & 1) or None
            refuses = "its emergency stop is pulled" if told.stopped else ""
            state.thrusters[self._name] = last._replace(heard_s=now_s, faults=faults, refuses=refuses)
            return
        state.thrusters[self._name] = last._replace(
            heard_s=now_s,
            rpm=self._sign * told.rpm,
            current_a=told.current_a,
            voltage_v=told.voltage_v,
            temperature_c=told.temperature_c,
        )


class Torqeedos:
    """The motors of the rows that name them."""

    name = "torqeedo"
    period_s: float | None = 0.05  # of a message; a command is every second one

    def __init__(self, motors: tuple[TorqeedoMotor, ...]) -> None:
        self._motors = self.inputs = motors

    def send(self, sent: Actuation, now_s: float) -> int:
        return sum(not each.send(sent, now_s) for each in self._motors)

    def repeat(self, now_s: float) -> int:
        return sum(not each.repeat(now_s) for each in self._motors)

    def stop(self) -> None:
        taken = [each.stop() for each in self._motors]  # all of them, whatever the first one does
        if not all(taken):
            raise OSError(errno.ENOTCONN, "a Torqeedo motor does not take the stop")

    def disconnect(self, names: tuple[str, ...]) -> None:
        """Do nothing: the bus has no message for that."""

    def report(self) -> dict[str, object]:
        return {}


def open_actuator(settings: config.Vehicle, links: Links) -> Torqeedos:
    """Open the driver. Raises DelfimError."""
    table = settings.of(TorqeedoTable)
    rows = [(index, row) for index, row in enumerate(settings.thrusters) if row.driver == Torqeedos.name]
    return Torqeedos(
        tuple(
            TorqeedoMotor(index, row, table.power_percent, links.line(table.ports[row.name].device, BAUD))
            for index, row in rows
        )
    )
