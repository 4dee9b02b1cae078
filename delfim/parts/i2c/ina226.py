"""Texas Instruments' INA226, which measures a battery's voltage, and its current by the drop across a shunt (SBOS547).

Registers are words, high byte first.
"""

from typing import Final

from delfim.base.errors import FormatError
from delfim.parts.i2c.buses import I2cBus
from delfim.parts.i2c.chips import Supply
from delfim.parts.i2c.table import I2cSensor

CONFIGURATION, SHUNT, BUS, FLAGS, MAKER = 0x00, 0x01, 0x02, 0x06, 0xFE
TEXAS: Final = 0x5449  # "TI"
CONTINUOUS: Final = 0x4727  # both, each for 1.1 ms, the mean of 64: 141 ms
READY: Final = 0x0008  # a measurement is new; reading it clears it
SHUNT_V, BUS_V = 2.5e-6, 1.25e-3  # of a step
SHUNT_MOST: Final = 0x7FFF  # steps: as much, or more


class Ina226:
    period_s = 1.0

    def __init__(self, table: I2cSensor) -> None:
        self._table, self._sign = table, -1.0 if table.reversed else 1.0

    def begin(self, bus: I2cBus) -> None:
        if (maker := self._word(bus, MAKER)) != TEXAS:
            raise FormatError(f"no INA226 answers there: its maker's number is {maker:#06x}, not {TEXAS:#06x}")
        bus.put(self._table.at, CONFIGURATION, CONTINUOUS.to_bytes(2, "big"))

    def read(self, bus: I2cBus, now_s: float) -> Supply | None:
        if not self._word(bus, FLAGS) & READY:
            return None
        drop, volts = self._word(bus, SHUNT), self._word(bus, BUS)
        drop -= (drop & 0x8000) << 1
        if volts & 0x8000:
            raise FormatError("a voltage below zero")
        if abs(drop) >= SHUNT_MOST:
            raise FormatError(
                f"more current than {SHUNT_MOST * SHUNT_V / self._table.shunt_ohm:.0f} A, which its shunt can tell"
            )
        voltage_v, current_a = volts * BUS_V, self._sign * drop * SHUNT_V / self._table.shunt_ohm
        return Supply(voltage_v, current_a, self._charge(voltage_v, current_a))

    def _charge(self, voltage_v: float, current_a: float) -> float | None:
        """By the voltage that the battery would have at rest."""
        table = self._table
        if not table.full_v:
            return None
        rest_v = voltage_v + current_a * table.inner_ohm
        return min(max((rest_v - table.empty_v) / (table.full_v - table.empty_v), 0.0), 1.0)

    def _word(self, bus: I2cBus, register: int) -> int:
        return int.from_bytes(bus.registers(self._table.at, register, 2), "big")
