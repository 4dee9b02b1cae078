"""What a laser scanner of ROS 2 sees, as things that stand in the water, told by the guest's line (docs/ros2.md)."""

import math
from collections.abc import Iterator
from typing import Final

from delfim.base import geodesy
from delfim.base.echoes import CONFIDENCE, EVERY_S, nearest
from delfim.base.errors import FormatError
from delfim.parts.ros.rosmessages import LaserScan
from delfim.vehicle.grex import SeenVessel
from delfim.vehicle.report import BoatReport

SCAN_S: Final = 0.5  # a scan counts so long
NEAREST: Final = 6  # things of a report, the nearest ones: the vehicle reads eight lines at once


class Seeing:
    """Keeps the newest scan. `now_s` is monotonic. It has no socket."""

    def __init__(self) -> None:
        self._scan: LaserScan | None = None
        self._scan_s = self._told_s = -math.inf

    def on_scan(self, scan: LaserScan, now_s: float) -> None:
        """Take a scan. Raises FormatError for directions that are none."""
        if not math.isfinite(scan.first_rad + scan.step_rad) or abs(scan.step_rad) > math.tau:
            raise FormatError("a scan without directions")
        self._scan, self._scan_s = scan, now_s

    def step(self, state: BoatReport, now_s: float) -> list[SeenVessel]:
        """What is to be told now of the scan, from where the boat is."""
        scan, at = self._scan, (state.latitude_deg, state.longitude_deg, state.heading_deg)
        if scan is None or now_s - self._scan_s > SCAN_S or now_s - self._told_s < EVERY_S or None in at:
            return []
        self._scan, self._told_s = None, now_s
        latitude_deg, longitude_deg, heading_deg = (float(each or 0.0) for each in at)
        here = geodesy.origin(math.radians(latitude_deg), math.radians(longitude_deg))
        return list(_things(scan, here, math.radians(heading_deg)))


def _things(scan: LaserScan, here: geodesy.Origin, heading_rad: float) -> Iterator[SeenVessel]:
    """The nearest echoes, each as wide as its direction."""
    echoes = (
        (far_m, heading_rad - (scan.first_rad + i * scan.step_rad))
        for i, far_m in enumerate(scan.ranges_m)
        if scan.least_m <= far_m <= scan.most_m
    )
    for north_m, east_m, radius_m in nearest(echoes, 0.5 * abs(scan.step_rad), NEAREST):
        north_deg, east_deg = (math.degrees(each) for each in geodesy.from_plane(here, north_m, east_m))
        yield SeenVessel("scan", north_deg, east_deg, kind="thing", radius_m=radius_m, confidence=CONFIDENCE)
