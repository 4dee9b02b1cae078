"""Go to: a free point, or the mission's first waypoint (thesis chapter 4, key G). There the mode is done and the boat holds."""

from delfim.vehicle.control.autopilot import entered
from delfim.vehicle.control.guidance import leg
from delfim.vehicle.control.memory import Memory, Settings
from delfim.vehicle.safe import STOP
from delfim.vehicle.state import Actuation, Motion, Reference, Setpoint, Waypoint

NEEDS = frozenset({"position", "heading", "velocity"})
SENTENCE = "Goes to a point, or to the first waypoint, and holds there."


def lacks(setpoint: Setpoint) -> str | None:
    return "no point to go to and no mission loaded" if _target(setpoint) is None else None


def enter(motion: Motion, setpoint: Setpoint, settings: Settings) -> Memory:
    return Memory(entered(motion), north_m=motion.north_m, east_m=motion.east_m)


def step(
    memory: Memory, motion: Motion, setpoint: Setpoint, settings: Settings, dt_s: float
) -> tuple[Memory, Reference, Actuation]:
    target = _target(setpoint)
    if target is None:
        return memory, Reference(), STOP
    memory, reference, actuation, reached = leg(memory, motion, target, True, settings, dt_s, setpoint.override_mps)
    return memory, reference._replace(done=True) if reached else reference, actuation


def _target(setpoint: Setpoint) -> Waypoint | None:
    if setpoint.target is not None:
        return setpoint.target
    return setpoint.plan.waypoints[0] if setpoint.plan is not None and setpoint.plan.waypoints else None
