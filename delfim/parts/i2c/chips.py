"""What a chip on I2C is to the service, and what it measures."""

import math
from typing import Final, NamedTuple, Protocol

from delfim.lines.nmea0183.framing import framed
from delfim.parts.i2c.buses import I2cBus

PASCALS_PER_BAR: Final = 1e5


class ChipTurn(NamedTuple):
    """Heading and attitude of the boat. None: the chip is not sure of it."""

    heading_rad: float | None = None  # from magnetic north
    rate_radps: float | None = None  # positive to starboard
    attitude: tuple[float, float] | None = None  # roll, starboard down positive; pitch, bow up positive


class Supply(NamedTuple):
    """A battery."""

    voltage_v: float
    current_a: float  # positive: discharging
    charge: float | None = None  # 0..1


class Air(NamedTuple):
    """The air at the chip."""

    pressure_pa: float
    celsius: float


I2cReading = ChipTurn | Supply | Air


class I2cChip(Protocol):
    """A chip at its address. Both methods may block, and raise OSError, or FormatError for an answer that makes no sense."""

    period_s: float  # from one reading to the next

    def begin(self, bus: I2cBus) -> None: ...  # set it up; also after it was reset
    def read(self, bus: I2cBus, now_s: float) -> I2cReading | None: ...  # None: it has measured nothing new


def sentences(name: str, told: I2cReading) -> bytes:
    """A reading as NMEA 0183: HDG, ROT, and XDR with transducers of the sensor's name."""
    match told:
        case Supply(voltage_v, current_a, charge):
            left = "" if charge is None else f",E,{100.0 * charge:.1f},P,{name}"
            return framed(f"IIXDR,U,{voltage_v:.3f},V,{name},I,{current_a:.3f},A,{name}{left}")
        case Air(pressure_pa, celsius):
            return framed(f"WIXDR,P,{pressure_pa / PASCALS_PER_BAR:.6f},B,{name},C,{celsius:.1f},C,{name}")
        case ChipTurn(heading_rad, rate_radps, attitude):
            said = b"" if rate_radps is None else framed(f"TIROT,{math.degrees(rate_radps) * 60.0:.1f},A")
            if attitude is not None:
                roll_deg, pitch_deg = map(math.degrees, attitude)
                said += framed(f"YXXDR,A,{pitch_deg:.2f},D,{name}_pitch,A,{roll_deg:.2f},D,{name}_roll")
            if heading_rad is not None:
                said += framed(f"HCHDG,{round(math.degrees(heading_rad) * 100.0) % 36_000 / 100.0:.2f},,,,")
            return said
