"""Heading and speed to forces: two PI(D) loops, for a yaw moment and a surge force. The thrusters share them out elsewhere.

    yaw    = sat(Kp e) + Kd (turn - r) + Kt turn + I    e = wrap(heading asked for - heading), r yaw rate
    surge  = drag(u_d) + Kp (u_d - u) + I               u speed over ground along the keel

Where the thrusters cannot give both, yaw is kept and surge gives way (`allocation.py`): a boat that holds its heading and is
slow is safe; a boat off its heading is not. Speed falls with the cosine of the heading error, so that the boat turns first; an
order ahead never asks for surge astern. A force that the thrusters were short of stops the integral that asked for it.
"""

import math

from delfim.base.geodesy import wrap
from delfim.vehicle.control.memory import Integrals, Settings
from delfim.vehicle.state import Motion, Wanted

STAYS_RADPS = math.radians(3.0)  # the heading integral takes lasting errors, not those that the boat is turning away
AHEAD_RAD = 0.5 * math.pi  # beyond this heading error the boat only turns
TURNING_RAD = 0.5  # beyond this heading error the speed integral waits: the boat is turning, not slowed by the sea

_new = tuple.__new__  # half the time of Wanted(...): this is on the critical path


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
    speed, (held_nm, push_n, before_mps, yaw_short_nm, short_n, _, _) = control.speed, was
    p_nm, p_limit_nm, d_nm, turn_nm, i_nm, i_limit_nm, p_n, i_n, i_limit_n = gains
    has, _, _, at_rad, yaw_radps, north_mps, east_mps = motion
    if more := control.heading.ahead_per_mps:
        more = 1.0 + more * max(north_mps * math.cos(at_rad) + east_mps * math.sin(at_rad), 0.0)
        p_nm, i_nm = more * p_nm, more * i_nm
    error_rad = wrap(heading_rad - at_rad)
    change_mps = speed.ramp_mps2 * dt_s
    asked_mps = clamp(clamp(speed_mps, -speed.max_mps, speed.max_mps), before_mps - change_mps, before_mps + change_mps)

    rate_radps = turn_radps - yaw_radps
    yaw_nm = clamp(p_nm * error_rad, -p_limit_nm, p_limit_nm) + d_nm * rate_radps + turn_nm * turn_radps + held_nm
    off_rad = abs(error_rad)
    turns_away = off_rad >= TURNING_RAD
    if not turns_away and abs(rate_radps) < STAYS_RADPS and error_rad * yaw_short_nm <= 0.0:
        held_nm = clamp(held_nm + i_nm * error_rad * dt_s, -i_limit_nm, i_limit_nm)

    wanted_mps = asked_mps * math.cos(error_rad) if off_rad < AHEAD_RAD else 0.0
    lag_mps = wanted_mps - north_mps * math.cos(at_rad) - east_mps * math.sin(at_rad) if "velocity" in has else 0.0
    surge_n = (hull.drag_n_per_mps + hull.drag_n_per_mps2 * abs(wanted_mps)) * wanted_mps + p_n * lag_mps + push_n
    if surge_n < 0.0 <= asked_mps or asked_mps < 0.0 < surge_n:
        surge_n, short_n = 0.0, surge_n
    if not turns_away and lag_mps * short_n <= 0.0:
        push_n = clamp(push_n + i_n * lag_mps * dt_s, -i_limit_n, i_limit_n)
    memory = _new(Integrals, (held_nm, push_n, asked_mps, 0.0, 0.0, 0.0, 0.0))
    return memory, _new(Wanted, (surge_n, 0.0, yaw_nm, True, None, None))


def clamp(value: float, low: float, high: float) -> float:
    """`value` within low..high. NaN stays NaN, for the last gate to refuse."""
    return low if value < low else high if value > high else value
