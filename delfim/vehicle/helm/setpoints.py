"""Set points from the words of an operator, completed by the state of the boat."""

import math

from delfim import config
from delfim.base import geodesy
from delfim.base.errors import Refused
from delfim.base.modes import Mode
from delfim.vehicle.console import Course, Goto, Heading
from delfim.vehicle.control.guidance import COURSE_MPS
from delfim.vehicle.control.memory import Memory
from delfim.vehicle.control.modes import path
from delfim.vehicle.plans.mission import FAR_MAX_M
from delfim.vehicle.plans.zones import Point
from delfim.vehicle.state import Motion, Setpoint, State, Waypoint


def speed(asked_mps: float | None, speeds: config.SpeedTable) -> float:
    """The operator's speed, limited to the boat's; cruising speed if none was given."""
    return min(speeds.cruise_mps if asked_mps is None else asked_mps, speeds.max_mps)


def onwards(mode: Mode, state: State, speeds: config.SpeedTable) -> Setpoint:
    """The set points of heading or course mode until others come: those that it has, or else the boat's heading or course,
    where it makes one, and present speed; cruising speed for a boat at rest."""
    motion = state.motion
    if state.mode is mode:
        return state.setpoint
    sails = state.mode not in (Mode.IDLE, Mode.MANUAL, Mode.HOLD)
    speed_mps = speed(state.reference.speed_mps if sails else None, speeds)
    makes_one = mode is Mode.COURSE and math.hypot(motion.north_mps, motion.east_mps) > COURSE_MPS
    ahead_rad = math.atan2(motion.east_mps, motion.north_mps) if makes_one else motion.heading_rad
    return state.setpoint._replace(heading_rad=ahead_rad, speed_mps=speed_mps)


def headed(asked: Heading | Course, state: State, speeds: config.SpeedTable) -> tuple[Mode, Setpoint]:
    """The mode and the set points that the operator asks for; a speed that is not told stays."""
    mode, asked_deg = (Mode.HEADING, asked.heading_deg) if isinstance(asked, Heading) else (Mode.COURSE, asked.course_deg)
    found = onwards(mode, state, speeds)._replace(heading_rad=math.radians(asked_deg % 360.0))
    return mode, found if asked.speed_mps is None else found._replace(speed_mps=speed(asked.speed_mps, speeds))


def target(asked: Goto, state: State, control: config.ControlTable) -> Waypoint:
    """A free point of the operator; where none is given, the mission's first waypoint. Raises Refused."""
    if asked.latitude_deg is None or asked.longitude_deg is None:
        plan = state.setpoint.plan
        if plan is None:
            raise Refused("goto refused: name a point or load a mission")
        return plan.waypoints[0]
    if state.origin is None:
        raise Refused("goto refused: no position yet")
    place = math.radians(asked.latitude_deg), math.radians(asked.longitude_deg)
    return Waypoint(*geodesy.to_plane(state.origin, *place), speed(asked.speed_mps, control.speed), control.path.acceptance_m)


def first(mode: Mode, memory: Memory, setpoint: Setpoint) -> tuple[float, float] | None:
    """(north_m, east_m) of the point that a mode goes to at its beginning; None where it has none."""
    plan, to = setpoint.plan, setpoint.target if mode is Mode.GOTO else None
    if mode is Mode.PLAY and plan is not None:
        to = plan.waypoints[setpoint.leg]
    if mode is Mode.PATH and plan is not None and memory.leg < 0:
        return path.goal(memory, plan.path)
    return None if to is None else (to.north_m, to.east_m)


def too_far(to: Point | None, motion: Motion) -> str | None:
    """Why the point that a mode goes to first is too far away, in words."""
    far_m = 0.0 if to is None else math.dist(to, (motion.north_m, motion.east_m))
    return f"{far_m / 1e3:.1f} km to go; up to {FAR_MAX_M / 1e3:.0f} km are allowed" if far_m > FAR_MAX_M else None
