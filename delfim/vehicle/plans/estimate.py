"""How long a mission takes by its length and speeds, before anybody has sailed it."""

import math
from itertools import pairwise

from delfim.base.geodesy import origin, to_plane
from delfim.vehicle.plans.mission import Mission


def mission_s(mission: Mission, cruise_mps: float) -> float:
    """Seconds from the first waypoint to the last, straight, with the stays; `cruise_mps` where none names a speed."""
    sailed_s = sum(each.hold_s for each in mission.waypoint)
    for here, there in pairwise(mission.waypoint):
        at = origin(math.radians(here.latitude_deg), math.radians(here.longitude_deg))
        leg_m = math.hypot(*to_plane(at, math.radians(there.latitude_deg), math.radians(there.longitude_deg)))
        sailed_s += leg_m / (there.speed_mps or cruise_mps)
    return sailed_s


def in_hours(seconds: float) -> str:
    """The same for people: "15 h 33 min", "12 min", "40 s"."""
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    hours, minutes = divmod(round(seconds / 60.0), 60)
    return f"{hours} h {minutes:02} min" if hours else f"{minutes} min"
