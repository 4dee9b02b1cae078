"""Trial: each thruster has its own thrust and angle, piece by piece, for finding out about the boat (docs/adopt.md). The
manoeuvre ends with its last piece, and at once where the boat would leave its circle or turns too fast. The operator must go on
asking for it.
"""

import math
from typing import Final

from delfim.vehicle.control.memory import Memory, Settings
from delfim.vehicle.control.safe import STOP
from delfim.vehicle.state import Motion, Reference, Setpoint, TrialPieces, Wanted

NEEDS = frozenset({"position", "heading", "velocity"})
SENTENCE = "Tries the motors, for delfim adopt."

WAY_S: Final = 2.5  # the boat's way that must end within the circle
FAR: Final = 1.25  # radii; beyond it also a manoeuvre that comes back ends


def lacks(setpoint: Setpoint) -> str | None:
    return None if setpoint.trial is not None else "no manoeuvre: delfim adopt gives them"


def enter(motion: Motion, setpoint: Setpoint, settings: Settings) -> Memory:
    """The first step begins the first piece."""
    trial = setpoint.trial
    return Memory(leg=-1) if trial is None else Memory(north_m=trial.north_m, east_m=trial.east_m, leg=-1)


def step(
    memory: Memory, motion: Motion, setpoint: Setpoint, settings: Settings, dt_s: float
) -> tuple[Memory, Reference, Wanted]:
    trial = setpoint.trial
    if trial is None:
        raise ValueError
    if words := ended(trial, motion):
        return memory, Reference(done=True, reason=words), STOP
    leg, left_s = (0, trial.pieces[0][0]) if memory.leg < 0 else (memory.leg, memory.left_s - dt_s)
    while left_s <= 0.0 and leg < len(trial.pieces):
        leg += 1
        left_s += trial.pieces[leg][0] if leg < len(trial.pieces) else 0.0
    if leg >= len(trial.pieces):  # and it stays so, until the loop has seen it
        return memory._replace(leg=leg, left_s=0.0), Reference(done=True, reason="trial done"), STOP
    far_m = math.dist((trial.north_m, trial.east_m), (motion.north_m, motion.east_m))
    reference = Reference(distance_m=far_m, north_m=trial.north_m, east_m=trial.east_m, leg=leg)
    return memory._replace(leg=leg, left_s=left_s), reference, Wanted(parts=trial.pieces[leg][1])


def ended(trial: TrialPieces, motion: Motion) -> str:
    """Why the manoeuvre must end now, in words; empty: it goes on."""
    north_m, east_m = motion.north_m - trial.north_m, motion.east_m - trial.east_m
    far_m, radius_m = math.hypot(north_m, east_m), trial.radius_m
    if far_m > FAR * radius_m:
        return f"trial ended: {far_m:.0f} m from the middle of its circle of {radius_m:.0f} m"
    if abs(motion.yaw_rate_radps) > trial.turn_radps:
        most_dps = math.degrees(trial.turn_radps)
        return f"trial ended: turns at {math.degrees(abs(motion.yaw_rate_radps)):.0f} deg/s, {most_dps:.0f} are allowed"
    goes_out = north_m * motion.north_mps + east_m * motion.east_mps > 0.0
    to_m = math.hypot(north_m + WAY_S * motion.north_mps, east_m + WAY_S * motion.east_mps)
    if goes_out and to_m > radius_m and not trial.comes_back:
        return f"trial ended: edge of the circle, {far_m:.0f} m from its middle"
    return ""
