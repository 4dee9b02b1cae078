"""VESC motor controllers on a CAN bus of their own: commands out, status 1, 4 and 5 in (docs/vesc.md).

Extended identifier = command << 8 | controller id; data big endian; speeds are electrical: revolutions of the shaft x pole
pairs. Source: bldc's documentation/comm_can.md and comm/comm_can.c.

A controller releases its motor when it has heard no command for its time-out, but any command renews it, and a repeated one
does: nothing here repeats longer than the loop lives.
"""

import errno
import struct
from collections.abc import Sequence
from typing import Final, NamedTuple

from delfim import config
from delfim.base.errors import FormatError
from delfim.base.frames import extended
from delfim.canproxy.socket import BATCH, CanAddress, CanSocket
from delfim.parts.vesc.table import Vesc
from delfim.vehicle.links import Links, received
from delfim.vehicle.state import Actuation, State, ThrusterReport

SET_DUTY, SET_CURRENT, SET_RPM = 0, 1, 3  # commands
STATUS_1, STATUS_4, STATUS_5 = 9, 16, 27  # what it says of itself
VALUE: Final = struct.Struct(">i")
_LIMIT: Final = (1 << 31) - 1
SPEED: Final = struct.Struct(">ihh")  # electrical rpm, motor current in 0.1 A, duty in 0.001
HEAT: Final = struct.Struct(">hhhh")  # transistors and motor in 0.1 degrees, input current in 0.1 A, position in 0.02 degrees
VOLTAGE: Final = struct.Struct(">ih")  # tachometer in sixths of an electrical turn, input in 0.1 V


class VescStatus(NamedTuple):
    """The values of a status. None: this one does not have it."""

    controller: int
    electrical_rpm: float | None = None
    current_a: float | None = None  # out of the battery, below 0 into it
    voltage_v: float | None = None  # of the battery
    temperature_c: float | None = None  # of the transistors


def pack_duty(controller: int, fraction: float) -> tuple[int, bytes]:
    """The frame (arbitration field, data) of a part of the battery's voltage, -1 to 1. 0 shorts the motor, which brakes it."""
    return _packed(SET_DUTY, controller, fraction * 1e5)


def pack_current(controller: int, current_a: float) -> tuple[int, bytes]:
    """The frame of a current in the motor, A. 0 lets it turn freely."""
    return _packed(SET_CURRENT, controller, current_a * 1e3)


def pack_rpm(controller: int, electrical_rpm: float) -> tuple[int, bytes]:
    """The frame of a speed, electrical rpm."""
    return _packed(SET_RPM, controller, electrical_rpm)


def _packed(command: int, controller: int, value: float) -> tuple[int, bytes]:
    return extended(command << 8 | controller), VALUE.pack(max(-_LIMIT, min(_LIMIT, round(value))))


_PACK: Final = {"duty": pack_duty, "current": pack_current, "rpm": pack_rpm}


def unpack_status(identifier: int, data: bytes) -> VescStatus | None:
    """Unpack a status; None for a frame that is none of the three. Raises FormatError for one that is too short."""
    kind, controller = identifier >> 8, identifier & 0xFF
    try:
        if kind == STATUS_1:
            rpm, _, _ = SPEED.unpack_from(data)
            return VescStatus(controller, electrical_rpm=rpm)
        if kind == STATUS_4:
            transistors, _, current, _ = HEAT.unpack_from(data)
            return VescStatus(controller, temperature_c=transistors / 10, current_a=current / 10)
        if kind == STATUS_5:
            _, voltage = VOLTAGE.unpack_from(data)
            return VescStatus(controller, voltage_v=voltage / 10)
    except struct.error:
        raise FormatError(f"status {kind} of a VESC has only {len(data)} bytes") from None
    return None


class Vescs:
    """The controllers of the rows that name them."""

    name = "vesc"
    period_s: float | None = 0.2  # a controller may wait for no more than 0.5 s

    def __init__(self, settings: config.Vehicle, socket: CanSocket) -> None:
        self._socket, self._send_many = socket, socket.send_many
        self._table, self._last = settings.of(Vesc), list[tuple[int, bytes]]()
        rows = [(index, row) for index, row in enumerate(settings.thrusters) if row.driver == self.name]
        self._motors = tuple((index, row.address, _full(settings.of(Vesc), row)) for index, row in rows)
        self._stops = [pack_duty(row.address, 0.0) for _, row in rows]
        self._rows = {row.address: (row.name, -1.0 if row.reversed else 1.0) for _, row in rows}
        self.input, self.inputs = socket, (self,)

    def send(self, sent: Actuation, now_s: float) -> int:
        pack, thrust = _PACK[self._table.command], sent.thrust
        # at rest always duty 0: with a speed of 0 a motor would turn freely
        moving = ((address, full * thrust[index]) for index, address, full in self._motors)
        frames = [pack(address, value) if value else pack_duty(address, 0.0) for address, value in moving]
        self._last = frames if sent.run else self._stops
        return self._put(self._last)

    def repeat(self, now_s: float) -> int:
        return self._put(self._last)

    def stop(self) -> None:
        if self._put(self._stops):
            raise OSError(errno.ENOBUFS, f"{self._socket.name} does not take the stop of the motors")

    def disconnect(self, names: tuple[str, ...]) -> None:
        """Do nothing: a VESC has no contactor."""

    def read(self, state: State, now_s: float) -> None:
        """Read status frames into `State.thrusters`. Malformed ones are counted."""
        for frame in received(self._socket, state, self.name):
            try:
                if (told := unpack_status(frame.identifier, frame.data)) is not None and told.controller in self._rows:
                    self._take(told, state, now_s)
            except FormatError:
                state.count("vesc_malformed")

    def report(self) -> dict[str, object]:
        return {}

    def _put(self, frames: Sequence[tuple[int, bytes]]) -> int:
        return sum(self._send_many(frames[at : at + BATCH]) for at in range(0, len(frames), BATCH))

    def _take(self, told: VescStatus, state: State, now_s: float) -> None:
        """Take the part of the values that this status has; the others stay as they were last reported."""
        name, sign = self._rows[told.controller]
        last = state.thrusters.get(name, ThrusterReport(now_s))
        rpm = told.electrical_rpm
        state.thrusters[name] = ThrusterReport(
            heard_s=now_s,
            rpm=last.rpm if rpm is None else sign * rpm / self._table.pole_pairs,
            current_a=last.current_a if told.current_a is None else told.current_a,
            voltage_v=last.voltage_v if told.voltage_v is None else told.voltage_v,
            temperature_c=last.temperature_c if told.temperature_c is None else told.temperature_c,
        )


def _full(table: Vesc, row: config.ThrusterTable) -> float:
    """The full command of a row, in the unit of `table.command`."""
    full = {"duty": table.duty_max, "current": table.current_max_a, "rpm": row.rpm_max * table.pole_pairs}[table.command]
    return -full if row.reversed else full


def open_actuator(settings: config.Vehicle, links: Links) -> Vescs:
    """Open the driver. Raises DelfimError."""
    ids = [row.address for row in settings.thrusters if row.driver == Vescs.name]
    heard = [CanAddress(extended(kind << 8 | each)) for each in ids for kind in (STATUS_1, STATUS_4, STATUS_5)]
    return Vescs(settings, links.bus(settings.of(Vesc).interface, tuple(heard)))
