"""Manual: the operator sets each propeller's thrust as a fraction of its maximum."""

from delfim.vehicle.control.autopilot import clamp
from delfim.vehicle.control.memory import Memory, Settings
from delfim.vehicle.state import Actuation, Motion, Reference, Setpoint

NEEDS: frozenset[str] = frozenset()
SENTENCE = "Thrust of each propeller is set at the console."


def lacks(setpoint: Setpoint) -> str | None:
    return None


def enter(motion: Motion, setpoint: Setpoint, settings: Settings) -> Memory:
    return Memory()


def step(
    memory: Memory, motion: Motion, setpoint: Setpoint, settings: Settings, dt_s: float
) -> tuple[Memory, Reference, Actuation]:
    starboard, port = clamp(setpoint.starboard, -1.0, 1.0), clamp(setpoint.port, -1.0, 1.0)
    return memory, Reference(), Actuation((starboard, port), (0.0, 0.0), True)
