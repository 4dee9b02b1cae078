"""Play: the mission's waypoints in order, along the lines between them, from any leg on. Then the boat holds."""

from delfim.vehicle.control.autopilot import entered
from delfim.vehicle.control.guidance import leg
from delfim.vehicle.control.memory import Memory, Settings
from delfim.vehicle.safe import STOP
from delfim.vehicle.state import Actuation, Motion, Reference, Setpoint

NEEDS = frozenset({"position", "heading", "velocity"})
SENTENCE = "Goes to each waypoint of the mission in turn, then holds."


def lacks(setpoint: Setpoint) -> str | None:
    waypoints = setpoint.plan.waypoints if setpoint.plan is not None else ()
    if not waypoints:
        return "no mission loaded"
    if not 0 <= setpoint.leg < len(waypoints):
        return f"no leg {setpoint.leg}: the mission has legs 0 to {len(waypoints) - 1}"
    return None


def enter(motion: Motion, setpoint: Setpoint, settings: Settings) -> Memory:
    return Memory(entered(motion), north_m=motion.north_m, east_m=motion.east_m, leg=setpoint.leg)


def step(
    memory: Memory, motion: Motion, setpoint: Setpoint, settings: Settings, dt_s: float
) -> tuple[Memory, Reference, Actuation]:
    if setpoint.plan is None:
        return memory, Reference(), STOP
    waypoints = setpoint.plan.waypoints
    if memory.leg >= len(waypoints):
        return memory, Reference(leg=memory.leg, done=True), STOP
    to = waypoints[memory.leg]
    last = memory.leg + 1 == len(waypoints)
    memory, reference, actuation, reached = leg(memory, motion, to, last, settings, dt_s, setpoint.override_mps)
    if not reached:
        return memory, reference, actuation
    if last:
        return memory, reference._replace(done=True), actuation
    return memory._replace(north_m=to.north_m, east_m=to.east_m, leg=memory.leg + 1), reference, actuation
