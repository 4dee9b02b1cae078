"""Rangefinders on a DroneCAN bus that look over the water: the nearest thing in a beam is one that stands (docs/traffic.md).

Nobody tells what it is, so that a swimmer is one of them. What the boat believes of it, and how long, is the look-out's.
"""

import math
from typing import Final

from delfim import config
from delfim.base.echoes import CONFIDENCE, EVERY_S, STALE_S, radius_m
from delfim.base.geodesy import from_plane
from delfim.base.vessels import ThingSeen
from delfim.canproxy.dronecan.datatypes import RangeMeasured
from delfim.parts.dronecan.table import Dronecan
from delfim.vehicle.state import State

KINDS: Final = {1: "sonar", 2: "lidar", 3: "radar"}


class Rangefinders:
    """All that the vehicle's file has a row of. Others, as one that looks down, are counted and see nothing."""

    def __init__(self, settings: config.Vehicle) -> None:
        self._rows = {(row.node, row.sensor): row for row in settings.of(Dronecan).rangefinders}
        self._heard_s = dict.fromkeys(self._rows, -math.inf)

    def hear(self, state: State, node: int, told: RangeMeasured, now_s: float) -> None:
        """Take a measurement. Costs the same whatever it says."""
        row = self._rows.get((node, told.sensor))
        if row is None:
            state.count("dronecan_other_rangefinders")
            return
        far_m, motion = told.distance_m, state.motion
        if far_m is None or not row.least_m <= far_m <= row.most_m or now_s - self._heard_s[node, told.sensor] < EVERY_S:
            return
        if state.origin is None or not {"position", "heading"} <= motion.has or now_s - state.navigation_s > STALE_S:
            state.count("dronecan_ranges_without_place")
            return
        self._heard_s[node, told.sensor] = now_s
        wide_m = radius_m(far_m, 0.5 * told.beam_rad)
        c, s, angle_rad = math.cos(motion.heading_rad), math.sin(motion.heading_rad), math.radians(row.angle_deg)
        ahead_m = row.forward_m + (far_m + wide_m) * math.cos(angle_rad)
        aside_m = row.starboard_m + (far_m + wide_m) * math.sin(angle_rad)
        north_m, east_m = motion.north_m + c * ahead_m - s * aside_m, motion.east_m + s * ahead_m + c * aside_m
        seen = ThingSeen(*from_plane(state.origin, north_m, east_m), wide_m, "thing", CONFIDENCE)
        name = f"{KINDS.get(told.kind, 'rangefinder')} {node}.{told.sensor}"
        state.hear(seen, "dronecan", now_s, name)
