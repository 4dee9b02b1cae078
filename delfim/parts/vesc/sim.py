"""VESC motor controllers on their bus: they obey duty, current and speed, send status 1, 4 and 5, and release their motors when
no command comes. One without power is silent. Source: bldc's documentation/comm_can.md; docs/vesc.md."""

import math
from typing import Final

from delfim import config
from delfim.base.frames import Frame, extended
from delfim.canproxy.socket import CanAddress
from delfim.parts.vesc.driver import (
    HEAT,
    SET_CURRENT,
    SET_DUTY,
    SET_RPM,
    SPEED,
    STATUS_1,
    STATUS_4,
    STATUS_5,
    VALUE,
    VOLTAGE,
)
from delfim.parts.vesc.table import Vesc
from delfim.simulator.model import Model
from delfim.simulator.nodes.period import TOLERANCE_S, Period, patience_s
from delfim.simulator.tables import Simulation

REPORT_S: Final = 0.05
SILENT_S: Final = 0.5  # without a command, after which it releases its motor, as docs/vesc.md says to set it
_MOST: Final = (1 << 15) - 1


class PlayedVesc:
    """The controller of a row."""

    def __init__(self, model: Model, row: config.ThrusterTable, table: Vesc) -> None:
        self._model, self._row, self._drive, self._pole_pairs = model, row, model.drives[row.name], table.pole_pairs
        self._sign = -1.0 if row.reversed else 1.0
        full = {
            SET_DUTY: table.duty_max * 1e5,
            SET_CURRENT: table.current_max_a * 1e3,
            SET_RPM: self._drive.rpm_max * table.pole_pairs,
        }
        self.commands = {extended(kind << 8 | row.address): value for kind, value in full.items()}
        self.commanded_s = -math.inf

    def obey(self, frame: Frame, now_s: float) -> None:
        if len(frame.data) >= VALUE.size:
            self.commanded_s = now_s
            (value,) = VALUE.unpack_from(frame.data)
            self._model.push(self._row.name, self._sign * value / self.commands[frame.arb])

    def release(self) -> None:
        self._model.push(self._row.name, 0.0, run=False)

    def reports(self) -> list[Frame]:
        drive = self._drive
        if not drive.powered:
            return []
        rpm = round(self._sign * drive.rpm * self._pole_pairs)
        motor_a, transistors_c = _tenths(drive.motor_a), _tenths(drive.temperature_c)
        told = (
            (STATUS_1, SPEED.pack(rpm, motor_a, round(1000.0 * self._sign * drive.part))),
            (STATUS_4, HEAT.pack(transistors_c, transistors_c, motor_a, 0)),
            (STATUS_5, VOLTAGE.pack(0, _tenths(drive.voltage_v))),
        )
        return [Frame(extended(kind << 8 | self._row.address), data) for kind, data in told]


def _tenths(value: float) -> int:
    return min(max(round(10.0 * value), -_MOST), _MOST)


class PlayedVescs:
    """All controllers of the bus."""

    def __init__(self, settings: config.Vehicle, model: Model) -> None:
        self.interface = settings.of(Vesc).interface
        self._vescs = [PlayedVesc(model, row, settings.of(Vesc)) for row in settings.thrusters if row.driver == "vesc"]
        self._commanded = {arb: each for each in self._vescs for arb in each.commands}
        self.hears = tuple(map(CanAddress, self._commanded))
        self._silent_s, self._period = patience_s(SILENT_S, settings), Period(REPORT_S)

    @property
    def due_s(self) -> float:
        return self._period.due_s

    def feed(self, frame: Frame, now_s: float) -> None:
        """Take a frame of the bus. One that makes no sense changes nothing."""
        if (each := self._commanded.get(frame.arb)) is not None:
            each.obey(frame, now_s)

    def step(self, now_s: float, utc_ns: int) -> list[Frame]:
        for each in self._vescs:
            if now_s - each.commanded_s > self._silent_s + TOLERANCE_S:
                each.release()
        return [frame for each in self._vescs for frame in each.reports()] if self._period.passed(now_s) else []


def devices_of(settings: config.Vehicle, model: Model, seed: int) -> PlayedVescs | None:
    return PlayedVescs(settings, model) if settings.of(Simulation).motors else None


class VescCommands:
    """The commands of the boat to its motors, for a replay to compare."""

    def __init__(self, settings: config.Vehicle) -> None:
        rows = [row for row in settings.thrusters if row.driver == "vesc"]
        told = [(extended(kind << 8 | row.address), row.name) for row in rows for kind in (SET_DUTY, SET_CURRENT, SET_RPM)]
        self._names = dict(told)
        self.hears = tuple(map(CanAddress, self._names))

    def is_own(self, frame: Frame) -> bool:
        return frame.arb in self._names

    def command(self, frame: Frame) -> tuple[str, bytes]:
        return self._names[frame.arb], bytes((frame.identifier >> 8 & 0xFF,)) + frame.data


def commands_of(settings: config.Vehicle) -> VescCommands:
    return VescCommands(settings)
