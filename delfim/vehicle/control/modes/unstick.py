"""Unstick: astern, out by the way it came, from weeds, nets or ground.

The boat points its stern at the driven track and backs along it, until it is `distance_m` from where it began or `time_s` have
passed: then the mode is done. One that was turned round meanwhile, so that the way lies ahead, drives ahead. Without a track,
as on the way home, it goes straight astern.
"""

import math
from typing import Final

from delfim.base.geodesy import wrap
from delfim.vehicle.control.autopilot import entered, steer
from delfim.vehicle.control.memory import Memory, Settings
from delfim.vehicle.control.safe import STOP
from delfim.vehicle.state import Motion, Reference, Setpoint, Wanted

NEEDS = frozenset({"position", "heading", "velocity"})
SENTENCE = "Goes astern, out by the way it came, then holds or goes home."

AHEAD_RAD: Final = math.radians(60.0)  # a way that is no farther round lies ahead


def lacks(setpoint: Setpoint) -> str | None:
    return None


def enter(motion: Motion, setpoint: Setpoint, settings: Settings) -> Memory:
    leg = _next(len(setpoint.track) - 1, motion, setpoint, settings)
    is_ahead = leg >= 0 and abs(wrap(_bearing(motion, setpoint.track[leg]) - motion.heading_rad)) <= AHEAD_RAD
    return Memory(
        entered(motion),
        north_m=motion.north_m,
        east_m=motion.east_m,
        leg=leg,
        driving=1 if is_ahead else -1,
        left_s=settings.control.unstick.time_s,
        heading_rad=motion.heading_rad,
    )


def step(
    memory: Memory, motion: Motion, setpoint: Setpoint, settings: Settings, dt_s: float
) -> tuple[Memory, Reference, Wanted]:
    limits, left_s = settings.control.unstick, memory.left_s - dt_s
    far_m = math.hypot(motion.north_m - memory.north_m, motion.east_m - memory.east_m)
    if far_m >= limits.distance_m or left_s <= 0.0:
        words = f"{far_m:.0f} m away" if far_m >= limits.distance_m else f"still stuck after {limits.time_s:.0f} s"
        return memory, Reference(distance_m=max(limits.distance_m - far_m, 0.0), done=True, reason=words), STOP
    leg, heading_rad = _next(memory.leg, motion, setpoint, settings), memory.heading_rad or 0.0
    if leg >= 0:
        bearing_rad = _bearing(motion, setpoint.track[leg])
        heading_rad = bearing_rad if memory.driving > 0 else wrap(bearing_rad + math.pi)
    speed_mps = memory.driving * limits.speed_mps
    integrals, wanted = steer(memory.integrals, motion, heading_rad, speed_mps, settings, dt_s)
    north_m, east_m = setpoint.track[leg] if leg >= 0 else (None, None)
    reference = Reference(heading_rad, speed_mps, None, limits.distance_m - far_m, north_m, east_m)
    return memory._replace(integrals=integrals, leg=leg, left_s=left_s), reference, wanted


def _next(leg: int, motion: Motion, setpoint: Setpoint, settings: Settings) -> int:
    """The newest point of the track, up to this one, that is far enough away to steer for; -1: there is none."""
    here = motion.north_m, motion.east_m
    leg = min(leg, len(setpoint.track) - 1)
    while leg >= 0 and math.dist(setpoint.track[leg], here) < settings.control.home.spacing_m:
        leg -= 1
    return leg


def _bearing(motion: Motion, to: tuple[float, float]) -> float:
    return math.atan2(to[1] - motion.east_m, to[0] - motion.north_m)
