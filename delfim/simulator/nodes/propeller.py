"""The propellers' motor controllers."""

import math
from typing import Final

from delfim import config
from delfim.base.errors import FormatError
from delfim.base.frames import Frame
from delfim.canproxy.dsor.messages import (
    PROPELLER_PORT,
    PROPELLER_STARBOARD,
    PROPELLER_TIMEOUT_S,
    RESET,
    Fault,
    Node,
    PropellerStatus,
    Status,
    pack_propeller_status,
    sysstat_arb,
    unpack_propeller_command,
)
from delfim.simulator.model import Model
from delfim.simulator.nodes.period import TOLERANCE_S, Period

PROPELLER_STATUS_S: Final = 0.2
_new = tuple.__new__  # a third of the time of Frame(...)
_WELL: Final = Status.GOOD, Fault(0)


class PropellerNode:
    """A motor controller. It obeys its commands and stops by itself when no new one comes for PROPELLER_TIMEOUT_S.

    A command with an unchanged counter is obeyed but does not count as new: a frozen sender must not keep a motor running.
    """

    def __init__(self, model: Model, row: config.ThrusterTable) -> None:
        self._model, self._name = model, row.name
        self._drive = model.drives[row.name]
        self._node = (Node.PROPELLER_STARBOARD, Node.PROPELLER_PORT)[row.address]
        self._arb = sysstat_arb(self._node)
        self._sign = -1 if row.reversed else 1
        self.hears = ((PROPELLER_STARBOARD, PROPELLER_PORT)[row.address], RESET)
        self._status = Period(PROPELLER_STATUS_S)
        self._silent_s = -math.inf  # it stops then
        self._heard_counter = -1
        self._counter = 0
        self.malformed = 0
        self.silent = self.bad = False

    @property
    def due_s(self) -> float:
        return min(self._status.due_s, self._silent_s) if self._drive.run else self._status.due_s

    def feed(self, frame: Frame, now_s: float) -> None:
        """Take a command to this side. Malformed ones are counted and change nothing."""
        if frame.arb == RESET:
            self._status.reset(frame.data, self._node, now_s)
            return
        try:
            rpm, run, counter = unpack_propeller_command(frame.data)
        except FormatError:
            self.malformed += 1
            return
        if counter != self._heard_counter:
            self._heard_counter, self._silent_s = counter, now_s + PROPELLER_TIMEOUT_S
        self._model.command(self._name, self._sign * rpm, run and now_s + TOLERANCE_S < self._silent_s)

    def step(self, now_s: float, utc_ns: int) -> list[Frame]:
        silent, drive = now_s + TOLERANCE_S >= self._silent_s, self._drive
        if silent:
            self._model.command(self._name, 0.0, False)
        if not self._status.passed(now_s) or self.silent:
            return []
        status, faults = self._faulty(silent) if silent or self.bad or not drive.powered else _WELL
        self._counter += 1
        rpm = self._sign * round(drive.rpm)
        told = status, faults, rpm, drive.motor_a, round(drive.temperature_c), self._counter
        return [_new(Frame, (self._arb, pack_propeller_status(_new(PropellerStatus, told)), 0, 0, False))]

    def _faulty(self, silent: bool) -> tuple[Status, Fault]:
        faults = Fault.NO_COMMAND if silent else Fault(0)
        if not self._drive.powered:
            faults |= Fault.LOW_VOLTAGE
        return Status.BAD, faults | Fault.HARDWARE if self.bad else faults


def nodes(settings: config.Vehicle, model: Model, seed: int) -> dict[str, PropellerNode]:
    rows = [row for _, row in settings.driven("nodes")]
    return {("propeller_starboard", "propeller_port")[row.address]: PropellerNode(model, row) for row in rows}
