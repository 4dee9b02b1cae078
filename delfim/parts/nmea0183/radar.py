"""What a radar tracks, by TTM and TLL: vessels without a number, in the name of the port (docs/traffic.md)."""

import math
from typing import Final

from delfim.base.geodesy import from_plane
from delfim.base.vessels import Report, VesselFacts, VesselPosition
from delfim.lines.nmea0183.sentences import RadarTarget
from delfim.vehicle.state import State

STALE_S: Final = 2.0  # a radar tells where a target is from the boat: an older place of the boat is none


def hear(state: State, told: Report | RadarTarget | str, port: str, now_s: float) -> None:
    """A report of AIS, or a target of a radar, into the state."""
    if not isinstance(told, RadarTarget):
        state.hear(told, port, now_s)
        return
    place = told.place or _place(told, state, now_s)
    if place is None:
        state.hear("radar target while the boat does not know where it is, and how it lies", port, now_s)
        return
    key, name = f"payload {port} {told.number}", told.name or f"{port} {told.number}"
    state.hear(VesselPosition(0, *place, told.course_rad, told.speed_mps, None, None, "payload"), port, now_s, key)
    state.hear(VesselFacts(0, name, None, None, None, None, None, None), port, now_s, key)


def _place(told: RadarTarget, state: State, now_s: float) -> tuple[float, float] | None:
    """(latitude_rad, longitude_rad) of a target by its distance and bearing; None: unknown."""
    motion, needs = state.motion, {"position", "heading"} if told.is_from_bow else {"position"}
    if state.origin is None or not needs <= motion.has or now_s - state.navigation_s > STALE_S:
        return None
    bearing_rad = told.bearing_rad + (motion.heading_rad if told.is_from_bow else 0.0)
    north_m = motion.north_m + told.distance_m * math.cos(bearing_rad)
    return from_plane(state.origin, north_m, motion.east_m + told.distance_m * math.sin(bearing_rad))
