"""Manual: the operator sets the thrust of both sides as a fraction of full command, which no allocation changes."""

import math

from delfim.vehicle.control.autopilot import clamp
from delfim.vehicle.control.memory import Memory, Settings
from delfim.vehicle.state import Motion, Reference, Setpoint, Wanted

NEEDS: frozenset[str] = frozenset()
SENTENCE = "Thrust of each propeller is set at the console."


def lacks(setpoint: Setpoint) -> str | None:
    return None


def enter(motion: Motion, setpoint: Setpoint, settings: Settings) -> Memory:
    return Memory()


def step(
    memory: Memory, motion: Motion, setpoint: Setpoint, settings: Settings, dt_s: float
) -> tuple[Memory, Reference, Wanted]:
    starboard, port = clamp(setpoint.starboard, -1.0, 1.0), clamp(setpoint.port, -1.0, 1.0)
    if not math.isfinite(starboard + port):
        raise ValueError
    return memory, Reference(), Wanted(hand=(starboard, port))
