"""A turn to a new heading that the boat can follow: a reference goes from the heading that she has to the one that is asked
for, with a bounded rate of turn and a bounded change of it, which adoption finds.

A heading that jumps asks for more than motors give, and what they could not give in time goes beyond the new heading. The
reference asks for what they give. Its moment is fed forward, and the error that the heading loop sees is the one from where the
reference was when it caused what is measured now.
"""

import math
from typing import Final

from delfim.base.geodesy import wrap
from delfim.vehicle.control.autopilot import STAYS_RADPS, clamp, steer, surge_mps
from delfim.vehicle.control.memory import Memory, Settings
from delfim.vehicle.state import Motion, Wanted

WAITS_RAD: Final = 0.35  # from a boat that cannot follow: the reference turns no faster
ANEW_RAD: Final = 0.7  # from a boat that was turned away: the reference begins anew where she is
TAIL_PER_S: Final = 0.7  # of what is left of a turn: it ends slowly, for drift and delay are not known as well as that


def follow(
    memory: Memory, motion: Motion, heading_rad: float, speed_mps: float, settings: Settings, dt_s: float
) -> tuple[Memory, Wanted]:
    """One step towards a heading and a speed, as `steer`, for a boat whose `turn_dps` and `turn_dps2` are known."""
    table, hull, integrals = settings.control.heading, settings.hull, memory.integrals
    late_s, at_rad = hull.late_s, motion.heading_rad
    was_rad, was_radps = memory.heading_rad, memory.turn_radps
    if was_rad is None or abs(wrap(was_rad - was_radps * late_s - at_rad)) > ANEW_RAD:
        was_rad, was_radps = wrap(at_rad + late_s * motion.yaw_rate_radps), motion.yaw_rate_radps
    change = math.radians(table.turn_dps2 or 0.0) * dt_s
    radps = _rate(wrap(heading_rad - was_rad) - 0.5 * was_radps * dt_s, math.radians(table.turn_dps or 0.0), change, dt_s)
    if abs(behind_rad := wrap(was_rad - was_radps * late_s - at_rad)) > WAITS_RAD and behind_rad * radps > 0.0:
        radps = 0.0
    radps = clamp(radps, was_radps - change, was_radps + change)
    goes_rad, radps2 = wrap(was_rad + 0.5 * (was_radps + radps) * dt_s), (radps - was_radps) / dt_s if dt_s > 0.0 else 0.0
    due_rad = wrap(goes_rad - radps * late_s + 0.5 * radps2 * late_s * late_s)
    after, wanted = steer(integrals, motion, due_rad, speed_mps, settings, dt_s, radps)
    if abs(radps) > STAYS_RADPS:
        after = after._replace(yaw_nm=integrals.yaw_nm)
    d_nm, turn_nm, grows = settings.gains.d_nm_per_radps, settings.gains.turn_nm_per_radps, table.ahead_per_mps
    here = (1.0 + grows * max(surge_mps(motion), 0.0)) / (1.0 + grows * settings.control.speed.cruise_mps)
    fed_nm = (turn_nm + d_nm) * (here - 1.0) * radps + (hull.inertia_kgm2 - d_nm * late_s) * radps2
    memory = memory._replace(integrals=after, heading_rad=goes_rad, turn_radps=radps)
    return memory, wanted._replace(yaw_nm=wanted.yaw_nm + fed_nm)


def _rate(left_rad: float, most_radps: float, change: float, dt_s: float) -> float:
    """The rate of turn from which the reference still comes to rest where nothing is left, at the end of this step."""
    stops = math.sqrt(2.0 * change / dt_s * abs(left_rad) + 0.25 * change * change) - 0.5 * change if dt_s > 0.0 else 0.0
    return math.copysign(min(max(stops, 0.0), most_radps, TAIL_PER_S * abs(left_rad)), left_rad)
