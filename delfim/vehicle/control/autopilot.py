"""Heading and speed to forces: two PI(D) loops, for a yaw moment and a surge force. What the thrusters make of them is theirs.

    yaw    = sat(Kp e) + Kd (turn - r) + Kt turn + I    e = wrap(heading asked for - heading), r yaw rate
    surge  = drag(u_d) + Kp (u_d - u) + I               u speed over ground along the keel

Where the thrusters cannot give both, yaw is kept and surge gives way (`allocation.py`): a boat that holds its heading and is
slow is safe; a boat off its heading is not. Speed falls with the cosine of the heading error, so that the boat turns first; an
order ahead never asks for surge astern. What the thrusters were short of stops the integral that asked for it.
"""

import math

from delfim.geodesy import wrap
from delfim.vehicle.control.memory import Integrals, Settings
from delfim.vehicle.state import Motion, Wanted

STAYS_RADPS = math.radians(3.0)  # the heading integral takes lasting errors, not those that the boat is turning away
TURNING_RAD = 0.5  # beyond this heading error the speed integral waits: the boat is turning, not slowed by the sea


def entered(motion: Motion) -> Integrals:
    """The autopilot's memory at the moment of entering a mode: the speed ramp starts at the speed the boat has."""
    return Integrals(speed_mps=surge_mps(motion))


def surge_mps(motion: Motion) -> float:
    """Speed over ground along the keel; zero where velocity is not known."""
    return motion.north_mps * math.cos(motion.heading_rad) + motion.east_mps * math.sin(motion.heading_rad)


def steer(
    was: Integrals,
    motion: Motion,
    heading_rad: float,
    speed_mps: float,
    settings: Settings,
    dt_s: float,
    turn_radps: float = 0.0,
) -> tuple[Integrals, Wanted]:
    """One step towards a heading and a speed over ground (negative: astern). `turn_radps` is the rate of turn of the path
    itself. Without velocity the speed loop is open: feed-forward alone.
    """
    control, gains, hull = settings
    speed, (held_nm, push_n, before_mps, yaw_short_nm, short_n) = control.speed, was
    error_rad = wrap(heading_rad - motion.heading_rad)
    change_mps = speed.ramp_mps2 * dt_s
    asked_mps = clamp(clamp(speed_mps, -speed.max_mps, speed.max_mps), before_mps - change_mps, before_mps + change_mps)

    rate_radps = turn_radps - motion.yaw_rate_radps
    yaw_nm = (
        clamp(gains.p_nm_per_rad * error_rad, -gains.p_limit_nm, gains.p_limit_nm)
        + gains.d_nm_per_radps * rate_radps
        + gains.turn_nm_per_radps * turn_radps
        + held_nm
    )
    turns_away = abs(error_rad) >= TURNING_RAD
    if not turns_away and abs(rate_radps) < STAYS_RADPS and error_rad * yaw_short_nm <= 0.0:
        held_nm = clamp(held_nm + gains.i_nm_per_rad_s * error_rad * dt_s, -gains.i_limit_nm, gains.i_limit_nm)

    wanted_mps = asked_mps * max(math.cos(error_rad), 0.0)
    lag_mps = wanted_mps - surge_mps(motion) if "velocity" in motion.has else 0.0
    surge_n = (hull.drag_n_per_mps + hull.drag_n_per_mps2 * abs(wanted_mps)) * wanted_mps + gains.p_n_per_mps * lag_mps + push_n
    if surge_n < 0.0 <= asked_mps or asked_mps < 0.0 < surge_n:
        surge_n, short_n = 0.0, surge_n
    if not turns_away and lag_mps * short_n <= 0.0:
        push_n = clamp(push_n + gains.i_n_per_m * lag_mps * dt_s, -gains.i_limit_n, gains.i_limit_n)
    return Integrals(held_nm, push_n, asked_mps), Wanted(surge_n, 0.0, yaw_nm)


def clamp(value: float, low: float, high: float) -> float:
    """`value` within low..high. NaN stays NaN, for the last gate to refuse."""
    return low if value < low else high if value > high else value
