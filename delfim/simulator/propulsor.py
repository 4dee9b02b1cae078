"""A thruster of the simulated boat: motor controller, motor, batteries, and what turns it."""

import math
from typing import Final, Literal

from delfim.base.geodesy import wrap
from delfim.base.parts import OWN_NODES
from delfim.config import ThrusterTable
from delfim.vehicle.control.thrustcurve import Curve, Law, Points

DriveFault = Literal[
    "dead", "stuck", "reversed", "fouled"
]  # gives nothing; keeps its revolutions while it has current; turns the other way; draws more current

VOLTAGE_V: Final = 48.0  # of a battery bank, half full and at rest
AMBIENT_C: Final = 16.0
RPM: Final = 1000.0  # at full command, of a thruster whose file does not tell
RATE_PER_S: Final = 4.0  # of full command: such a motor changes no faster
W_PER_N: Final = 8.0  # assumed: such a motor draws this, as a T200 does


def curve_of(row: ThrusterTable) -> Curve:
    """The force of a thruster for its part of full command, as the file has it."""
    return Points(row.curve) if row.curve else Law(*row.thrust_n, row.power, row.dead)


class Drive:
    """A thruster: motor controller, motor, propeller, batteries, and what turns it. Without a curve it is a propeller of
    DelfimX, whose thrust falls with the speed of the water; with one its force is the curve's."""

    __slots__ = (
        *("_points", "angle_rad", "charge", "connected", "current_a", "curve", "fault", "motor_a", "reference_rad"),
        *("reference_rpm", "row", "rpm", "rpm_max", "rpm_per_s_max", "run", "temperature_c"),
    )

    def __init__(self, row: ThrusterTable, rpm_max: float, rpm_per_s_max: float) -> None:
        """`rpm_max` and `rpm_per_s_max` are the limits of a motor controller of DelfimX; another thruster has its own."""
        self.row = row
        self.curve: Curve | None = None
        self.rpm_max, self.rpm_per_s_max = rpm_max, rpm_per_s_max
        if row.driver != OWN_NODES:
            self.curve = curve_of(row)
            self.rpm_max = row.rpm_max or RPM
            self.rpm_per_s_max = RATE_PER_S * self.rpm_max
        to_rad = math.radians(row.angle_deg)
        self._points = math.cos(to_rad), math.sin(to_rad)  # where it points as it is mounted
        self.angle_rad = self.reference_rad = 0.0  # from the row's own direction, clockwise
        self.reference_rpm = 0.0
        self.run = False
        self.connected = True  # main contactor; an open one is a motor without current
        self.rpm = 0.0  # positive ahead
        self.motor_a = 0.0  # into the motor controller
        self.current_a = 0.0  # out of the batteries
        self.charge = 1.0  # 0..1; an empty battery is a motor without current
        self.temperature_c = AMBIENT_C
        self.fault: DriveFault | None = None

    def turn(self, h: float) -> None:
        """Turn towards the requested angle for this time."""
        steer = self.row.steer
        if steer is None or self.fault == "stuck":
            return
        most, left = math.radians(steer.rate_dps) * h, self.reference_rad - self.angle_rad
        left = wrap(left) if steer.angle_max_deg >= 180.0 else left
        self.angle_rad += min(max(left, -most), most)

    def push_n(self, part: float) -> tuple[float, float]:
        """The force ahead and to starboard, N, at these revolutions, -1..1 of those at full command, where the curve gives it.
        A rudder turns the stream of a propeller that pushes ahead."""
        row, force_n = self.row, self.curve.force(part) if self.curve is not None else 0.0
        if row.steer is None:
            ahead, aside = self._points
            return force_n * ahead, force_n * aside
        straight = row.steer.kind == "rudder" and force_n < 0.0
        to_rad = math.radians(row.angle_deg) + (0.0 if straight else self.angle_rad)
        return force_n * math.cos(to_rad), force_n * math.sin(to_rad)

    def failing(self) -> tuple[bool, float]:
        """Whether the motor of a thruster with a fault is driven, and its rpm."""
        if self.fault == "stuck":
            return self.powered, self.rpm
        wanted_rpm = -self.reference_rpm if self.fault == "reversed" else self.reference_rpm
        return self.run and self.powered and self.fault != "dead", wanted_rpm

    @property
    def part(self) -> float:
        """The revolutions, -1..1 of those at full command."""
        return self.rpm / self.rpm_max

    @property
    def powered(self) -> bool:
        return self.connected and self.charge > 0.0

    @property
    def voltage_v(self) -> float:
        """The voltage of the batteries, V: 42 empty to 54 full at rest, and 20 mohm within (assumed)."""
        return VOLTAGE_V + 12.0 * (self.charge - 0.5) - 0.02 * self.current_a
