"""GREX: the guest computer's heading and speed (thesis 3.4). Without a set point the boat stands still."""

from delfim.vehicle.control.autopilot import entered, steer
from delfim.vehicle.control.memory import Memory, Settings
from delfim.vehicle.control.safe import STOP
from delfim.vehicle.state import Motion, Reference, Setpoint, Wanted

NEEDS = frozenset({"heading"})
SENTENCE = "Holds the heading and speed that the guest computer asks for."


def lacks(setpoint: Setpoint) -> str | None:
    return "no set point from the guest computer" if setpoint.guest_heading_rad is None else None


def enter(motion: Motion, setpoint: Setpoint, settings: Settings) -> Memory:
    return Memory(entered(motion))


def step(
    memory: Memory, motion: Motion, setpoint: Setpoint, settings: Settings, dt_s: float
) -> tuple[Memory, Reference, Wanted]:
    heading_rad, speed_mps = setpoint.guest_heading_rad, setpoint.guest_speed_mps
    if heading_rad is None:
        return memory, Reference(), STOP
    integrals, wanted = steer(memory.integrals, motion, heading_rad, speed_mps, settings, dt_s)
    return Memory(integrals, *memory[1:]), Reference(heading_rad, speed_mps), wanted
