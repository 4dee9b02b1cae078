"""Motor controllers on a DroneCAN bus, with the servos of what they turn: they obey and report as an ESC of AP_Periph does.

A motor turns once its controller was armed and told zero since; it stops when nobody speaks, and goes on with the next command.
A controller without power is silent. Sources: DroneCAN specification, chapter 7; docs/dronecan.md.
"""

import math
from typing import Final

from delfim import config
from delfim.base.errors import FormatError
from delfim.base.frames import CAN_IDE, Frame
from delfim.canproxy.dronecan.datatypes import (
    ARMING_STATUS,
    ARRAY_COMMAND,
    ESC_STATUS,
    NODE_STATUS,
    ON,
    RAW_COMMAND,
    RAW_MAX,
    RPM_COMMAND,
    CommandKind,
    node_status,
)
from delfim.canproxy.dronecan.fields import pack, unpack
from delfim.canproxy.dronecan.transfers import STATUS, Publisher, TransferReceiver
from delfim.parts.dronecan.table import Dronecan
from delfim.simulator.model import Model
from delfim.simulator.nodes.period import TOLERANCE_S, Period, patience_s
from delfim.simulator.tables import Simulation

FIRST_NODE: Final = 20
KELVIN: Final = 273.15
REPORT_S: Final = 0.04
WORD_S: Final = 1.0  # between two words of a node on itself
_new = tuple.__new__  # a third of the time of Frame(...)
SILENT_S: Final = 0.25  # without a command, after which a motor stops


class Esc:
    """A motor controller of a row, and the servo that turns its thruster."""

    def __init__(self, model: Model, row: config.ThrusterTable, node: int) -> None:
        self._model, self._row, self._drive = model, row, model.drives[row.name]
        self._sign = -1.0 if row.reversed else 1.0
        self._report, self._word = Publisher(ESC_STATUS, node, STATUS), Publisher(NODE_STATUS, node, STATUS)
        self._armed = self._seen_zero = False
        self._angle_rad = 0.0
        self.commanded_s = -math.inf

    def arm(self, on: bool) -> None:
        self._armed, self._seen_zero = on, self._seen_zero and on
        if not on:
            self.stop()

    def turn(self, part: float, now_s: float) -> None:
        """Take a command, -1 to 1 of full power."""
        self.commanded_s = now_s
        self._seen_zero = self._seen_zero or (self._armed and not part)
        obeys = self._armed and self._seen_zero
        self._model.push(self._row.name, self._sign * part if obeys else 0.0, self._angle_rad, obeys)

    def turn_rpm(self, rpm: float, now_s: float) -> None:
        self.turn(rpm / self._drive.rpm_max, now_s)

    def steer(self, kind: float, value: float) -> None:
        if (steer := self._row.steer) is not None and math.isfinite(value):
            sign, middle_rad, most_rad = steer.as_told
            self._angle_rad = sign * ((value if kind == CommandKind.POSITION else value * most_rad) - middle_rad)

    def stop(self) -> None:
        self._model.push(self._row.name, 0.0, self._angle_rad, False)

    def reports(self) -> list[tuple[int, bytes]]:
        drive = self._drive
        if not drive.powered:
            return []
        rpm, percent = round(self._sign * drive.rpm), min(round(100.0 * abs(drive.part)), 126)  # 127 is unknown
        told = 0, drive.voltage_v, drive.motor_a, drive.temperature_c + KELVIN, rpm, percent, self._row.address
        return self._report.frames(pack(ESC_STATUS, told))

    def words(self, uptime_s: float) -> list[tuple[int, bytes]]:
        return self._word.frames(node_status(uptime_s)) if self._drive.powered else []


class Escs:
    """All controllers of the bus."""

    def __init__(self, settings: config.Vehicle, model: Model) -> None:
        self.interface = settings.of(Dronecan).interface
        rows = [row for row in settings.thrusters if row.driver == "dronecan"]
        numbers = [each for each in range(FIRST_NODE, FIRST_NODE + len(rows) + 1) if each != settings.of(Dronecan).node]
        escs = [Esc(model, row, number) for row, number in zip(rows, numbers, strict=False)]
        self._motors = {row.address: esc for row, esc in zip(rows, escs, strict=True)}
        self._servos = {row.steer.address: esc for row, esc in zip(rows, escs, strict=True) if row.steer is not None}
        self._silent_s = patience_s(SILENT_S, settings)
        self._receiver = TransferReceiver((RAW_COMMAND, RPM_COMMAND, ARRAY_COMMAND, ARMING_STATUS))
        self.hears = self._receiver.filters
        self._reports, self._words = Period(REPORT_S), Period(WORD_S)
        self._began_s: float | None = None

    @property
    def due_s(self) -> float:
        return min(self._reports.due_s, self._words.due_s)

    def feed(self, frame: Frame, now_s: float) -> None:
        """Take a frame of the bus. One that makes no sense changes nothing."""
        transfer = self._receiver.feed(frame, now_s)
        if transfer is None:
            return
        if transfer.type == ARMING_STATUS.id:
            for esc in self._motors.values():
                esc.arm(transfer.payload == ON)
            return
        try:
            self._obey(transfer.type, transfer.payload, now_s)
        except FormatError:
            return

    def _obey(self, kind: int, payload: bytes, now_s: float) -> None:
        """Obey a command. Raises FormatError."""
        if kind == ARRAY_COMMAND.id:
            _, items = unpack(ARRAY_COMMAND, payload)
            for number, what, value in zip(items[::3], items[1::3], items[2::3], strict=True):
                if (esc := self._servos.get(int(number))) is not None:
                    esc.steer(what, value)
            return
        _, values = unpack(RAW_COMMAND if kind == RAW_COMMAND.id else RPM_COMMAND, payload)
        for index, value in enumerate(values):
            if (esc := self._motors.get(index)) is not None:
                if kind == RAW_COMMAND.id:
                    esc.turn(max(value / RAW_MAX, -1.0), now_s)
                else:
                    esc.turn_rpm(value, now_s)

    def step(self, now_s: float, utc_ns: int) -> list[Frame]:
        self._began_s = now_s if self._began_s is None else self._began_s
        for esc in self._motors.values():
            if now_s - esc.commanded_s > self._silent_s + TOLERANCE_S:
                esc.stop()
        said: list[tuple[int, bytes]] = []
        if self._reports.passed(now_s):
            said += [frame for esc in self._motors.values() for frame in esc.reports()]
        if self._words.passed(now_s):
            said += [frame for esc in self._motors.values() for frame in esc.words(now_s - self._began_s)]
        return [_new(Frame, (arb, data, 0, 0, False)) for arb, data in said]


def devices_of(settings: config.Vehicle, model: Model, seed: int) -> Escs | None:
    return Escs(settings, model) if settings.of(Simulation).motors else None


class DronecanCommands:
    """The commands of the boat to its motors, for a replay to compare."""

    def __init__(self, settings: config.Vehicle) -> None:
        kinds = (RAW_COMMAND, RPM_COMMAND, ARRAY_COMMAND, ARMING_STATUS)
        self._names, self._node = {kind.id: kind.name for kind in kinds}, settings.of(Dronecan).node
        self._receiver = TransferReceiver(kinds)
        self.hears = self._receiver.filters

    def is_own(self, frame: Frame) -> bool:
        return bool(frame.arb & CAN_IDE) and frame.identifier & 0x7F == self._node

    def command(self, frame: Frame) -> tuple[str, bytes] | None:
        transfer = self._receiver.feed(frame, frame.t_ns / 1e9)
        return None if transfer is None else (self._names[transfer.type], transfer.payload)


def commands_of(settings: config.Vehicle) -> DronecanCommands:
    return DronecanCommands(settings)
