"""TDK's ICM-20948: gyro and accelerometer, and the magnetometer AK09916 at an address of its own (data sheets DS-000189,
016014242-E-02). It reckons nothing itself: the heading is that of `delfim.vehicle.navigation.magnetic`.

Registers lie in banks; numbers of gyro and accelerometer have their high byte first, those of the magnetometer their low one.
The magnetometer's axes are x ahead, y to the right, z down; those of the others x ahead, y to the left, z up.
"""

import math
import struct
from typing import Final

from delfim.base.errors import FormatError
from delfim.parts.i2c.buses import I2cBus
from delfim.parts.i2c.chips import ChipTurn
from delfim.parts.i2c.table import MAGNETOMETER, I2cSensor
from delfim.vehicle.navigation.magnetic import GRAVITY_MPS2, Calibration, FieldCircle, Tilt, Vector, attitude, magnetic_heading

BANK: Final = 0x7F
CHIP, POWER, PINS, STATUS, DATA = 0x00, 0x06, 0x0F, 0x1A, 0x2D  # in bank 0
ICM: Final = 0xEA
AWAKE, BYPASS, READY = 0x01, 0x02, 0x01  # BYPASS: the magnetometer is on the bus
GYRO_DIVIDER, GYRO_RANGE, FORCE_RANGE = 0x00, 0x01, 0x14  # in bank 2
DIVIDER, SMOOTH_500_DPS, SMOOTH_4_G = 10, 0x1B, 0x1B  # 102 a second; below 51 Hz
RATE_STEP: Final = math.radians(1.0 / 65.5)  # rad/s
FORCE_STEP: Final = GRAVITY_MPS2 / 8192.0
_DATA: Final = struct.Struct(">3h3h")
MAKER, FIELD, MODE = 0x01, 0x10, 0x31  # of the magnetometer
AK09916: Final = 0x09
CONTINUOUS: Final = 0x08  # 100 times a second
_FIELD: Final = struct.Struct("<B3hBB")  # whether it is new, the field, nothing, whether it is too strong
NEW, TOO_STRONG = 0x01, 0x08
FIELD_STEP_T: Final = 0.15e-6
LEVEL_S: Final = 60.0  # over so long a boat rolls and pitches as much to one side as to the other: the rest is the gyro's bias


class Icm20948:
    """Its x axis lies `turned_deg` clockwise from the bow, z is up."""

    def __init__(self, table: I2cSensor) -> None:
        self._at, self.period_s, self._arrow_rad = table.at, 1.0 / table.rate_hz, math.radians(table.turned_deg)
        self._iron = Calibration(table.hard_iron_ut, table.soft_iron)
        self._circle: FieldCircle | None = None
        self._tilt, self._bias, self._samples = Tilt(), (0.0, 0.0), 0

    def begin(self, bus: I2cBus) -> None:
        self._put(bus, BANK, 0x00)
        if (chip := bus.registers(self._at, CHIP, 1)[0]) != ICM:
            raise FormatError(f"no ICM-20948 answers there: the chip's number is {chip:#04x}, not {ICM:#04x}")
        self._put(bus, POWER, AWAKE)
        self._put(bus, PINS, BYPASS)
        self._put(bus, BANK, 0x20)
        for register, value in ((GYRO_DIVIDER, DIVIDER), (GYRO_RANGE, SMOOTH_500_DPS), (FORCE_RANGE, SMOOTH_4_G)):
            self._put(bus, register, value)
        self._put(bus, BANK, 0x00)
        if (maker := bus.registers(MAGNETOMETER, MAKER, 1)[0]) != AK09916:
            raise FormatError(f"its magnetometer's number is {maker:#04x}, not {AK09916:#04x}")
        bus.put(MAGNETOMETER, MODE, bytes((CONTINUOUS,)))

    def read(self, bus: I2cBus, now_s: float) -> ChipTurn | None:
        if not bus.registers(self._at, STATUS, 1)[0] & READY:
            return None
        ax, ay, az, p, q, r = _DATA.unpack(bus.registers(self._at, DATA, _DATA.size))
        rates = self._unbiased((p * RATE_STEP, -q * RATE_STEP, -r * RATE_STEP))
        rate_radps = self._tilt.feed(rates, (ax * FORCE_STEP, -ay * FORCE_STEP, -az * FORCE_STEP), now_s)
        down = self._tilt.down
        if down is None:
            return None
        return ChipTurn(self._heading(bus, down), rate_radps, attitude(down, self._arrow_rad))

    def calibration(self) -> dict[str, list[float]] | None:
        """`hard_iron_ut` and `soft_iron` of a boat that was turned through a circle; None: it was not."""
        return None if self._circle is None else self._circle.calibration()

    def _heading(self, bus: I2cBus, down: Vector) -> float | None:
        is_new, x, y, z, _, strength = _FIELD.unpack(bus.registers(MAGNETOMETER, FIELD, _FIELD.size))
        if not is_new & NEW or strength & TOO_STRONG:
            return None
        field_t = x * FIELD_STEP_T, y * FIELD_STEP_T, z * FIELD_STEP_T
        if self._circle is None:
            self._circle = FieldCircle(field_t)
        self._circle.add(field_t)
        heading_rad = magnetic_heading(self._iron.undone(field_t), down, self._arrow_rad)
        return None if heading_rad is None else heading_rad % math.tau

    def _unbiased(self, rates: Vector) -> Vector:
        """Take off the bias of roll and pitch: that of the turn is found by the estimator, which has the compass for it."""
        self._samples += 1
        part = max(1.0 / self._samples, self.period_s / LEVEL_S)
        p, q = self._bias = (
            self._bias[0] + part * (rates[0] - self._bias[0]),
            self._bias[1] + part * (rates[1] - self._bias[1]),
        )
        return rates[0] - p, rates[1] - q, rates[2]

    def _put(self, bus: I2cBus, register: int, value: int) -> None:
        bus.put(self._at, register, bytes((value,)))
