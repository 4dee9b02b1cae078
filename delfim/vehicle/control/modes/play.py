"""Play: the mission's waypoints in order, along the lines between them, from any leg on. Then the boat holds.

Where the mission says so the boat stays at a waypoint for a while before it goes on, as in hold mode; where a sample is taken
there, until that is over.
"""

from delfim.vehicle.control.autopilot import entered
from delfim.vehicle.control.guidance import leg
from delfim.vehicle.control.memory import Memory, Settings
from delfim.vehicle.control.modes import hold
from delfim.vehicle.control.safe import STOP
from delfim.vehicle.state import Motion, Reference, Setpoint, Wanted

NEEDS = frozenset({"position", "heading", "velocity"})
SENTENCE = "Goes to each waypoint of the mission in turn, stays there where told, then holds."


def lacks(setpoint: Setpoint) -> str | None:
    waypoints = setpoint.plan.waypoints if setpoint.plan is not None else ()
    if not waypoints:
        return "no mission loaded"
    if not 0 <= setpoint.leg < len(waypoints):
        return f"no leg {setpoint.leg + 1}: the mission has legs 1 to {len(waypoints)}"
    return None


def enter(motion: Motion, setpoint: Setpoint, settings: Settings) -> Memory:
    return Memory(entered(motion), north_m=motion.north_m, east_m=motion.east_m, leg=setpoint.leg)


def step(
    memory: Memory, motion: Motion, setpoint: Setpoint, settings: Settings, dt_s: float
) -> tuple[Memory, Reference, Wanted]:
    if setpoint.plan is None:
        return memory, Reference(), STOP
    waypoints = setpoint.plan.waypoints
    if memory.leg >= len(waypoints):
        return memory, Reference(leg=memory.leg, done=True), STOP
    to = waypoints[memory.leg]
    last = memory.leg + 1 == len(waypoints)
    if memory.left_s > 0.0:
        memory, reference, wanted = hold.step(memory, motion, setpoint, settings, dt_s)
        reference, left_s = reference._replace(leg=memory.leg), memory.left_s - dt_s
        if to.tries and setpoint.sampled == memory.leg + 1:
            left_s = 0.0
    else:
        stops = last or to.hold_s > 0.0
        memory, reference, wanted, reached = leg(memory, motion, to, stops, settings, dt_s, setpoint.override_mps)
        if not reached:
            return memory, reference, wanted
        memory, left_s = memory._replace(north_m=to.north_m, east_m=to.east_m, heading_rad=None), to.hold_s
    if left_s > 0.0:
        return memory._replace(left_s=left_s), reference, wanted
    if last:
        return memory, reference._replace(done=True), wanted
    return memory._replace(leg=memory.leg + 1, driving=0, left_s=0.0), reference, wanted
