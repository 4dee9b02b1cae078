"""Home: back along the driven track, newest point first, then hold. A straight line home may lead through a pier; the driven
track does not."""

from delfim.vehicle.control.autopilot import entered
from delfim.vehicle.control.guidance import leg
from delfim.vehicle.control.memory import Memory, Settings
from delfim.vehicle.control.safe import STOP
from delfim.vehicle.state import Motion, Reference, Setpoint, Wanted, Waypoint

NEEDS = frozenset({"position", "heading", "velocity"})
SENTENCE = "Goes back along the driven track to where it began, then holds."


def lacks(setpoint: Setpoint) -> str | None:
    return None if setpoint.track else "no driven track to go back along"


def enter(motion: Motion, setpoint: Setpoint, settings: Settings) -> Memory:
    return Memory(entered(motion), north_m=motion.north_m, east_m=motion.east_m, leg=len(setpoint.track) - 1)


def step(
    memory: Memory, motion: Motion, setpoint: Setpoint, settings: Settings, dt_s: float
) -> tuple[Memory, Reference, Wanted]:
    if not 0 <= memory.leg < len(setpoint.track):
        return memory, Reference(done=True), STOP
    north_m, east_m = setpoint.track[memory.leg]
    home = settings.control.home
    to = Waypoint(north_m, east_m, home.speed_mps, settings.control.path.acceptance_m)
    memory, reference, wanted, reached = leg(memory, motion, to, memory.leg == 0, settings, dt_s, setpoint.override_mps)
    if not reached:
        return memory, reference, wanted
    if memory.leg == 0:
        return memory, reference._replace(done=True), wanted
    return memory._replace(north_m=north_m, east_m=east_m, leg=memory.leg - 1), reference, wanted
