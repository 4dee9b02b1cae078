"""The mode. Its functions are pure: no clock, no input, no wait; the memory goes in and comes out."""

import math

from delfim.api import Memory, Motion, Reference, Setpoint, Settings, Vehicle, Wanted, entered, steer
from example_mode import WeaveTable


class Weave:
    NEEDS = frozenset({"heading", "velocity"})  # of position, heading and velocity
    SENTENCE = "Weaves about the course that it has."

    def __init__(self, table: WeaveTable) -> None:
        self._table = table

    def lacks(self, setpoint: Setpoint) -> str | None:
        """The set point that it needs and does not have, in words; None: nothing is missing."""
        return None

    def enter(self, motion: Motion, setpoint: Setpoint, settings: Settings) -> Memory:
        return Memory(entered(motion), heading_rad=motion.heading_rad)

    def step(
        self, memory: Memory, motion: Motion, setpoint: Setpoint, settings: Settings, dt_s: float
    ) -> tuple[Memory, Reference, Wanted]:
        table, phase_rad = self._table, memory.swept_rad + math.tau * dt_s / self._table.period_s
        heading_rad = (memory.heading_rad or 0.0) + math.radians(table.width_deg) * math.sin(phase_rad)
        integrals, wanted = steer(memory.integrals, motion, heading_rad, table.speed_mps, settings, dt_s)
        after = memory._replace(integrals=integrals, swept_rad=math.remainder(phase_rad, math.tau))
        return after, Reference(heading_rad, table.speed_mps), wanted


def open_mode(settings: Vehicle) -> Weave:
    return Weave(settings.of(WeaveTable))
