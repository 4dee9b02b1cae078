"""Go to a point (thesis chapter 4, key G). There the mode is done and the boat holds. Without a point the boat
waits for one, where it is, as in hold mode. Where zones are in the way it goes by points round them (`detour.py`).
"""

from delfim.vehicle.control.autopilot import entered
from delfim.vehicle.control.guidance import leg
from delfim.vehicle.control.memory import Memory, Settings
from delfim.vehicle.control.modes import hold
from delfim.vehicle.state import Motion, Reference, Setpoint, Wanted

NEEDS = frozenset({"position", "heading", "velocity"})
SENTENCE = "Goes to a point and holds there; waits where it is until there is one."


def lacks(setpoint: Setpoint) -> str | None:
    return None


def enter(motion: Motion, setpoint: Setpoint, settings: Settings) -> Memory:
    if setpoint.target is None:
        return hold.enter(motion, setpoint, settings)
    return Memory(entered(motion), north_m=motion.north_m, east_m=motion.east_m)


def step(
    memory: Memory, motion: Motion, setpoint: Setpoint, settings: Settings, dt_s: float
) -> tuple[Memory, Reference, Wanted]:
    target = setpoint.target
    if target is None:
        return hold.step(memory, motion, setpoint, settings, dt_s)
    if memory.leg < len(setpoint.via):
        by = setpoint.via[memory.leg]
        memory, reference, wanted, reached = leg(memory, motion, by, False, settings, dt_s, setpoint.override_mps)
        if reached:
            memory = memory._replace(north_m=by.north_m, east_m=by.east_m, leg=memory.leg + 1)
        return memory, reference, wanted
    memory, reference, wanted, reached = leg(memory, motion, target, True, settings, dt_s, setpoint.override_mps)
    return memory, reference._replace(done=True) if reached else reference, wanted
