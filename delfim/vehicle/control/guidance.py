"""Line-of-sight guidance with integral action (ILOS), for straight legs and arcs.

    heading = gamma - atan((y + s) / D) - crab        ds/dt = sigma D y / ((y + s)^2 + D^2)

gamma is the tangent of the path at its nearest point, y the cross-track error (positive: boat to starboard of the path), D the
lookahead distance, sigma the integral gain: Borhaug, Pavlov and Pettersen, "Integral LOS control for path following of
underactuated marine surface vessels in the presence of constant ocean currents", IEEE CDC 2008; see also Fossen and Lekkas,
Int. J. Adaptive Control and Signal Processing 31, 2017. crab is the measured angle from heading to course over ground,
smoothed: it answers a new leg within seconds, and the integral removes the remaining error.
"""

import math

from delfim import config
from delfim.base.geodesy import wrap
from delfim.vehicle.control.autopilot import clamp, steer, surge_mps
from delfim.vehicle.control.memory import LineOfSight, Memory, Settings
from delfim.vehicle.state import Motion, Reference, Wanted, Waypoint

CRAB_MAX_RAD = math.radians(60.0)
NEAR = 0.25  # farther off the path than this fraction of the lookahead, the integral would only wind up
COURSE_MPS = 0.4  # below this speed ahead over ground the course does not tell the crab angle
CREEP_MPS = 0.3  # slowest approach to the point where the boat will stop

_new = tuple.__new__  # a third of the time of Reference(...): this is on the critical path


def course_to_steer(
    was: LineOfSight, motion: Motion, tangent_rad: float, cross_m: float, path: config.PathTable, dt_s: float
) -> tuple[LineOfSight, float]:
    """The heading that brings the boat onto the path and keeps it there."""
    measured_rad = 0.0
    if surge_mps(motion) > COURSE_MPS:
        measured_rad = wrap(math.atan2(motion.east_mps, motion.north_mps) - motion.heading_rad)
        measured_rad = clamp(measured_rad, -CRAB_MAX_RAD, CRAB_MAX_RAD)
    crab_rad = was.crab_rad + (measured_rad - was.crab_rad) * min(dt_s / path.crab_s, 1.0)
    ahead_m, shift_m = path.lookahead_m, was.shift_m
    shifted_m = cross_m + shift_m
    if abs(cross_m) < NEAR * ahead_m:
        shift_m += path.integral_gain * ahead_m * cross_m / (shifted_m * shifted_m + ahead_m * ahead_m) * dt_s
        shift_m = clamp(shift_m, -ahead_m, ahead_m)
    return _new(LineOfSight, (crab_rad, shift_m)), tangent_rad - math.atan2(shifted_m, ahead_m) - crab_rad


def turn_onto(motion: Motion, tangent_rad: float, cross_m: float, ahead_m: float, most_mps: float) -> float:
    """The rate of turn, rad/s, of the course to steer while the boat nears the line, or leaves it, at up to `most_mps`: without
    it the heading comes late by the autopilot's lag, and the boat crosses the line to and fro."""
    aside_mps = clamp(motion.east_mps * math.cos(tangent_rad) - motion.north_mps * math.sin(tangent_rad), -most_mps, most_mps)
    return -aside_mps * ahead_m / (ahead_m * ahead_m + cross_m * cross_m)


def along(motion: Motion, north_m: float, east_m: float, to_north_m: float, to_east_m: float) -> tuple[float, float, float]:
    """(bearing, cross-track, left to go) of the boat on a line: rad, m to starboard of it, m to its end along it."""
    bearing_rad = math.atan2(to_east_m - east_m, to_north_m - north_m)
    ahead_north, ahead_east = math.cos(bearing_rad), math.sin(bearing_rad)
    off_north, off_east = motion.north_m - to_north_m, motion.east_m - to_east_m
    return bearing_rad, off_east * ahead_north - off_north * ahead_east, -(off_north * ahead_north + off_east * ahead_east)


def leg(
    memory: Memory, motion: Motion, to: Waypoint, last: bool, settings: Settings, dt_s: float, override_mps: float | None
) -> tuple[Memory, Reference, Wanted, bool]:
    """One step along the line from where the leg began to its waypoint; True when the waypoint is reached.

    Reached means within the acceptance radius, or just passed abeam within twice that, so that a narrow miss is not repeated.
    A wide miss starts a new line from here. On the last leg the boat slows down so that it can stop. The operator's
    speed, if set, overrides the waypoint's.
    """
    bearing_rad, cross_m, left_m = along(motion, memory.north_m, memory.east_m, to.north_m, to.east_m)
    distance_m = math.hypot(cross_m, left_m)
    reached = distance_m <= to.acceptance_m or (left_m <= 0.0 and distance_m <= 2.0 * to.acceptance_m)
    if left_m <= 0.0 and not reached:
        memory = memory._replace(north_m=motion.north_m, east_m=motion.east_m)
        bearing_rad, cross_m, left_m = along(motion, motion.north_m, motion.east_m, to.north_m, to.east_m)
    course, heading_rad = course_to_steer(memory.course, motion, bearing_rad, cross_m, settings.control.path, dt_s)
    speed_mps = to.speed_mps if override_mps is None else override_mps
    if last:
        speed_mps = min(speed_mps, max(math.sqrt(settings.control.speed.ramp_mps2 * distance_m), CREEP_MPS))
    integrals, wanted = steer(memory.integrals, motion, heading_rad, speed_mps, settings, dt_s)
    told = wrap(heading_rad), speed_mps, cross_m, distance_m, to.north_m, to.east_m, memory.leg, False, "", None, to.line
    return _new(Memory, (integrals, course, *memory[2:])), _new(Reference, told), wanted, reached
