"""Bosch's BMP390 (and BMP388), which measures the pressure of the air (data sheet BST-BMP390-DS002, chapters 4 and 8)."""

import struct
from typing import Final

from delfim.base.errors import FormatError
from delfim.parts.i2c.buses import I2cBus
from delfim.parts.i2c.chips import Air
from delfim.parts.i2c.table import I2cSensor

CHIP, STATUS, DATA, POWER, OVERSAMPLING, RATE, FILTER, TRIMMING = 0x00, 0x03, 0x04, 0x1B, 0x1C, 0x1D, 0x1F, 0x31
CHIPS: Final = (0x60, 0x50)  # BMP390, BMP388
READY: Final = 0x60  # pressure and temperature are new; reading them clears it
ON: Final = 0x33  # both, one measurement after the other
EIGHTFOLD, AT_12_HZ, SMOOTH = 0x03, 0x04, 0x04
_TRIMMING: Final = struct.Struct("<HHbhhbbHHbbhbb")
OFFSETS: Final = (0, 0, 0, 1 << 14, 1 << 14, *(0,) * 9)
SHIFTS: Final = (-8, 30, 48, 20, 29, 32, 37, -3, 6, 8, 15, 48, 48, 65)  # each number is divided by 2 to the power of this
PRESSURE_PA, CELSIUS = (30_000.0, 125_000.0), (-40.0, 85.0)  # what it can measure


class Trimming:
    """What the maker found of one chip."""

    def __init__(self, data: bytes) -> None:
        """Of TRIMMING and what follows it, 21 bytes."""
        found = zip(_TRIMMING.unpack(data), OFFSETS, SHIFTS, strict=True)
        self._t1, self._t2, self._t3, *self._p = ((value - offset) / 2.0**shift for value, offset, shift in found)

    def air(self, data: bytes) -> Air:
        """Of six bytes of DATA, low ones first. Raises FormatError for what the chip cannot measure."""
        p, raw, warm = self._p, int.from_bytes(data[:3], "little"), int.from_bytes(data[3:], "little") - self._t1
        t = warm * self._t2 + warm * warm * self._t3
        offset = p[4] + t * (p[5] + t * (p[6] + t * p[7]))
        slope = p[0] + t * (p[1] + t * (p[2] + t * p[3]))
        air = Air(offset + raw * (slope + raw * (p[8] + p[9] * t + raw * p[10])), t)
        if not (PRESSURE_PA[0] <= air.pressure_pa <= PRESSURE_PA[1] and CELSIUS[0] <= t <= CELSIUS[1]):
            raise FormatError(f"{air.pressure_pa:.0f} Pa at {t:.0f} degrees: it measures no such air")
        return air


class Bmp390:
    period_s = 1.0

    def __init__(self, table: I2cSensor) -> None:
        self._at = table.at
        self._trimming: Trimming | None = None

    def begin(self, bus: I2cBus) -> None:
        if (chip := bus.registers(self._at, CHIP, 1)[0]) not in CHIPS:
            raise FormatError(f"no BMP390 answers there: the chip's number is {chip:#04x}, not {CHIPS[0]:#04x}")
        self._trimming = Trimming(bus.registers(self._at, TRIMMING, _TRIMMING.size))
        for register, value in ((OVERSAMPLING, EIGHTFOLD), (RATE, AT_12_HZ), (FILTER, SMOOTH), (POWER, ON)):
            bus.put(self._at, register, bytes((value,)))

    def read(self, bus: I2cBus, now_s: float) -> Air | None:
        if self._trimming is None or bus.registers(self._at, STATUS, 1)[0] & READY != READY:
            return None
        return self._trimming.air(bus.registers(self._at, DATA, 6))
