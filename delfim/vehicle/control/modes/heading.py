"""Heading: hold a heading at a speed. Works without position; without velocity, speed follows from the revolutions alone."""

from delfim.vehicle.control.autopilot import entered, steer
from delfim.vehicle.control.memory import Memory, Settings
from delfim.vehicle.control.turning import follow
from delfim.vehicle.state import Motion, Reference, Setpoint, Wanted

NEEDS = frozenset({"heading"})
SENTENCE = "Holds a heading at a speed."


def lacks(setpoint: Setpoint) -> str | None:
    return None


def enter(motion: Motion, setpoint: Setpoint, settings: Settings) -> Memory:
    return Memory(entered(motion))


def step(
    memory: Memory, motion: Motion, setpoint: Setpoint, settings: Settings, dt_s: float
) -> tuple[Memory, Reference, Wanted]:
    if settings.control.heading.turn_dps is not None:
        after, wanted = follow(memory, motion, setpoint.heading_rad, setpoint.speed_mps, settings, dt_s)
        return after, Reference(setpoint.heading_rad, setpoint.speed_mps), wanted
    integrals, wanted = steer(memory.integrals, motion, setpoint.heading_rad, setpoint.speed_mps, settings, dt_s)
    return Memory(integrals, *memory[1:]), Reference(setpoint.heading_rad, setpoint.speed_mps), wanted
