"""The keys of motors and servos that are told by pulses (docs/pwm.md)."""

from typing import Annotated, Any, Literal

import msgspec

from delfim.base.ranges import PLACE, Device, Name
from delfim.base.tables import Table, text

Pulse = Annotated[float, msgspec.Meta(ge=400.0, le=2600.0)]  # us
PwmNumber = Annotated[str, text("([0-9]|1[0-5])", "0 to 15")]


class PwmChannel(Table, frozen=True):
    """The pulses of a motor or a servo. Those of an ESC that only goes ahead have neutral and astern alike."""

    astern_us: Pulse = 1100.0  # full astern; of a servo: as far to port as it goes
    neutral_us: Pulse = 1500.0  # at rest; an ESC arms by it
    ahead_us: Pulse = 1900.0  # full ahead; of a servo: as far to starboard as it goes

    def __post_init__(self) -> None:
        if self.ahead_us == self.neutral_us or (self.ahead_us - self.neutral_us) * (self.astern_us - self.neutral_us) > 0.0:
            raise ValueError(f"neutral_us: {self.neutral_us:g} is not between {self.astern_us:g} and {self.ahead_us:g}")

    def pulse_us(self, fraction: float) -> float:
        """The pulse for -1 (astern) to 1 (ahead)."""
        end_us = self.ahead_us if fraction > 0.0 else self.astern_us
        return self.neutral_us + min(abs(fraction), 1.0) * (end_us - self.neutral_us)


class PwmCut(Table, frozen=True):
    """An output of the computer that takes the motors their pulses or their power: OE of a PCA9685, or a relay. The supervisor
    sets it when the outlet hangs and cannot be ended (docs/pwm.md)."""

    chip: Annotated[str, text("(/dev/gpiochip[0-9]+)?", "/dev/gpiochipNUMBER, or empty")] = ""  # of the pin; empty: none
    line: Annotated[str, text("[^ ]{0,31}", "a name without blanks, as gpioinfo lists it")] = ""  # name of the pin
    at: Literal["high", "low"] = "high"  # the level that cuts them off; the other one is held meanwhile

    def __post_init__(self) -> None:
        if bool(self.chip) != bool(self.line):
            raise ValueError("an output needs both its chip and its line")


class PwmTelemetry(Table, frozen=True):
    """The telemetry wire of one ESC, which speaks by itself (KISS telemetry)."""

    device: Device  # the serial port that it is wired to
    pole_pairs: Annotated[int, msgspec.Meta(ge=1, le=100)] = 7  # of its motor: half of the magnets


class Pwm(Table, frozen=True):
    """Motors and servos that are told by pulses: the kernel's PWM, or a PCA9685 (docs/pwm.md)."""

    chip: Annotated[str, text(PLACE, "an absolute path")] = "/sys/class/pwm/pwmchip0"  # or /dev/i2c-1; * as in a shell
    i2c_address: Annotated[int, msgspec.Meta(ge=0x03, le=0x77)] = 0x40  # of the PCA9685
    clock_hz: Annotated[float, msgspec.Meta(ge=1e6, le=50e6)] = 25e6  # of the PCA9685, whose own is some percent off
    rate_hz: Annotated[float, msgspec.Meta(ge=40.0, le=330.0)] = 50.0  # pulses a second
    arm_s: Annotated[float, msgspec.Meta(ge=0.0, le=60.0)] = 3.0  # neutral for so long after the start: an ESC arms by it
    channel: dict[PwmNumber, PwmChannel] = msgspec.field(default_factory=dict)  # those with other pulses than usual
    cut: PwmCut = PwmCut()
    telemetry: dict[Name, PwmTelemetry] = msgspec.field(default_factory=dict)  # by the names of the thrusters

    @property
    def lines(self) -> dict[str, Table]:
        """The lines of telemetry, by their keys."""
        return {f"pwm.telemetry.{name}": wire for name, wire in self.telemetry.items()}

    def settled(self, vehicle: Any) -> "Pwm":
        names = {row.name for row in vehicle.thrusters if row.driver == "pwm"}
        for name in self.telemetry:
            if name not in names:
                raise ValueError(f"pwm.telemetry: {name} is no thruster that is told by pulses")
        return self
