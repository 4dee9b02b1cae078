"""Idle: propellers off, but for the one that is tried alone."""

from delfim.vehicle.control.memory import Memory, Settings
from delfim.vehicle.control.safe import STOP
from delfim.vehicle.state import Motion, Reference, Setpoint, Wanted

NEEDS: frozenset[str] = frozenset()
SENTENCE = "Propellers off."


def lacks(setpoint: Setpoint) -> str | None:
    return None


def enter(motion: Motion, setpoint: Setpoint, settings: Settings) -> Memory:
    return Memory()


def step(
    memory: Memory, motion: Motion, setpoint: Setpoint, settings: Settings, dt_s: float
) -> tuple[Memory, Reference, Wanted]:
    return memory, Reference(), Wanted(hand=(setpoint.alone, 0.0)) if setpoint.alone else STOP
