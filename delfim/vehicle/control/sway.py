"""Keeping a point and a heading, for a boat that pushes sideways: two speed loops as the autopilot's, ahead and to starboard.

    force = Kp (u_d - u) + I        u_d = distance / CLOSE_S, at most the speed of hold; u speed over ground

Yaw is the autopilot's. The integrals carry current and wind; one that the thrusters could not follow waits. In calm water the
noise of position and heading would start the thrusters for nothing: less than LEAST is not asked for.
"""

import math
from typing import Final

from delfim.vehicle.control.autopilot import clamp, steer
from delfim.vehicle.control.memory import Integrals, Settings
from delfim.vehicle.state import Motion, Wanted

CLOSE_S: Final = 8.0  # speed is distance over this
ASIDE: Final = 2.0  # mass with its added mass in sway, per that in surge: a slender hull carries its own weight of water aside
LEAST: Final = 0.05  # of full thrust ahead and of the most yaw
HALF: Final = 0.5  # of the sway that the boat has, at most, for what lasts


def keep(
    was: Integrals, motion: Motion, heading_rad: float, north_m: float, east_m: float, settings: Settings, dt_s: float
) -> tuple[Integrals, Wanted]:
    """One step towards a heading, and the point that is so far to the north and east."""
    gains, most_mps = settings.gains, settings.control.hold.speed_mps
    turning, wanted = steer(was, motion, heading_rad, 0.0, settings, dt_s)
    far_m = math.hypot(north_m, east_m)
    per_s = 1.0 / CLOSE_S if far_m <= most_mps * CLOSE_S else most_mps / far_m
    lag_north_mps, lag_east_mps = per_s * north_m - motion.north_mps, per_s * east_m - motion.east_mps
    c, s = math.cos(motion.heading_rad), math.sin(motion.heading_rad)
    ahead_mps, aside_mps = lag_north_mps * c + lag_east_mps * s, lag_east_mps * c - lag_north_mps * s
    surge_n, sway_n = was.surge_n, was.sway_n
    push_n, aside_n = gains.p_n_per_mps * ahead_mps + surge_n, ASIDE * gains.p_n_per_mps * aside_mps + sway_n
    worth = math.hypot(push_n, aside_n) / settings.hull.ahead_n + abs(wanted.yaw_nm) / settings.hull.turn_nm
    wanted = wanted._replace(surge_n=push_n, sway_n=aside_n) if worth > LEAST else Wanted()
    if ahead_mps * was.surge_short_n <= 0.0:
        surge_n = clamp(surge_n + gains.i_n_per_m * ahead_mps * dt_s, -gains.i_limit_n, gains.i_limit_n)
    if aside_mps * was.sway_short_n <= 0.0:
        limit_n = HALF * settings.hull.aside_n
        sway_n = clamp(sway_n + ASIDE * gains.i_n_per_m * aside_mps * dt_s, -limit_n, limit_n)
    return turning._replace(surge_n=surge_n, sway_n=sway_n, speed_mps=0.0), wanted
