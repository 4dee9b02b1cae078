"""Hold: stay near a point.

Inside the radius, or the part of it that the fence leaves, the boat rests and drifts; outside it drives back, turned to the
point, or astern when the point is close behind it. Each drive ends near the point, and a drive that would have to turn in
place turns first, so the boat never circles. After the first return it lies with the bow into the drift, and each further
return is a straight push ahead.

A boat whose thrusters push it sideways without turning it does not rest: it keeps the point itself, on the heading that it had
when it came there. Where current and wind are stronger than its push to the side it leaves the radius, drives back as
any boat, and goes on with the bow into the drift.
"""

import math

from delfim.base.geodesy import wrap
from delfim.vehicle.control.autopilot import entered, steer
from delfim.vehicle.control.memory import Integrals, Memory, Settings
from delfim.vehicle.control.sway import keep
from delfim.vehicle.state import Motion, Reference, Setpoint, Wanted

NEEDS = frozenset({"position", "heading", "velocity"})
SENTENCE = "Stays where it is."

STOPPING_S = 3.0  # the boat needs about this long to stop: the point is set that far ahead
ASTERN_RAD = math.radians(120.0)  # a point this far round is behind
ASTERN_RADII = 3.0  # and is backed to when this close
APPROACH_S = 5.0  # speed is distance over this


def lacks(setpoint: Setpoint) -> str | None:
    return None


def enter(motion: Motion, setpoint: Setpoint, settings: Settings) -> Memory:
    north_m, east_m = motion.north_m + STOPPING_S * motion.north_mps, motion.east_m + STOPPING_S * motion.east_mps
    return Memory(entered(motion), north_m=north_m, east_m=east_m)


def step(
    memory: Memory, motion: Motion, setpoint: Setpoint, settings: Settings, dt_s: float
) -> tuple[Memory, Reference, Wanted]:
    hold = settings.control.hold
    radius_m = memory.room * hold.radius_m
    north_m, east_m = memory.north_m - motion.north_m, memory.east_m - motion.east_m
    distance_m, bearing_rad = math.hypot(north_m, east_m), math.atan2(east_m, north_m)
    driving = memory.driving
    if driving and distance_m < 0.4 * radius_m:
        driving = 0
    elif not driving and distance_m > radius_m:
        behind = abs(wrap(bearing_rad - motion.heading_rad)) > ASTERN_RAD and distance_m < ASTERN_RADII * radius_m
        driving = -1 if behind else 1
    if not driving and settings.hull.aside_n:
        heading_rad = motion.heading_rad if memory.driving or memory.heading_rad is None else memory.heading_rad
        integrals, wanted = keep(memory.integrals, motion, heading_rad, north_m, east_m, settings, dt_s)
        reference = Reference(heading_rad, 0.0, None, distance_m, memory.north_m, memory.east_m)
        return memory._replace(driving=0, integrals=integrals, heading_rad=heading_rad), reference, wanted
    if not driving:
        resting = memory._replace(driving=0, integrals=Integrals(surge_n=memory.integrals.surge_n))
        return resting, Reference(None, 0.0, None, distance_m, memory.north_m, memory.east_m), Wanted()
    heading_rad = bearing_rad if driving > 0 else wrap(bearing_rad + math.pi)
    speed_mps = driving * min(distance_m / APPROACH_S, hold.speed_mps)
    integrals, wanted = steer(memory.integrals, motion, heading_rad, speed_mps, settings, dt_s)
    reference = Reference(heading_rad, speed_mps, None, distance_m, memory.north_m, memory.east_m)
    return memory._replace(driving=driving, integrals=integrals), reference, wanted
