"""Path following: lines and arcs, with a cross-track error bounded as `docs/control.md` states.

A boat goes to the beginning of the first piece, or of the one that it is told to begin with, wherever it is. At a corner the
boat leaves a line early by R tan(angle / 2), where a turn of radius R begins that ends on the next one. A boat that kept clear
of others comes back at 45 degrees. A piece at whose end the boat stays for a while is sailed to its end, slowly at last, and
the boat stays there as in hold mode. At a corner the integral of the guidance keeps what of it lies aside of the next piece:
wind and water push from another side there. A survey's line that was interrupted goes on where it was left, with a run-in.
"""

import math
from collections.abc import Sequence

from delfim.base.geodesy import wrap
from delfim.vehicle.control.autopilot import entered, steer
from delfim.vehicle.control.guidance import CREEP_MPS, along, course_to_steer, turn_onto
from delfim.vehicle.control.memory import LineOfSight, Memory, Settings
from delfim.vehicle.control.modes import hold
from delfim.vehicle.control.safe import STOP
from delfim.vehicle.state import Arc, Line, Motion, Plan, Reference, Setpoint, Wanted

NEEDS = frozenset({"position", "heading", "velocity"})
SENTENCE = "Follows the mission's lines and arcs, stays at their ends where told, then holds."

APPROACH = -1  # leg: on the way to where the first piece begins; to the second it is -2, and so on
TURN_S = 3.0  # radius of a turn at a corner, over speed
CORNER_MAX_RAD = math.radians(120.0)
RUN_IN = 2.5  # lookaheads: one for the corner where the boat comes onto its line, the others to settle on it
STRAIGHT_RAD = 0.01
TURNED_RAD = 0.5  # a boat that has turned so far beyond her arc turns no farther with it: she would go round and round
BEFORE_LINE = 4  # pieces, from a run-out to the next line


def lacks(setpoint: Setpoint) -> str | None:
    if setpoint.plan is None:
        return "no mission loaded"
    pieces = len(setpoint.plan.path)
    if not pieces:
        return "the mission has no path: it needs two waypoints, or pieces of a path"
    return None if setpoint.piece < pieces else f"no piece {setpoint.piece + 1}: the path has pieces 1 to {pieces}"


def enter(motion: Motion, setpoint: Setpoint, settings: Settings) -> Memory:
    return Memory(entered(motion), north_m=motion.north_m, east_m=motion.east_m, leg=APPROACH - setpoint.piece)


def piece_of(leg: int) -> int:
    """The piece that the boat is on, or on the way to."""
    return max(leg, APPROACH - leg)


def piece_before(plan: Plan, line: int) -> int | None:
    """The piece with which a boat begins that is to sail a line of a survey: the run-in, where there is one. None: the path has
    no such line."""
    found = next((number for number, piece in enumerate(plan.path) if piece.line == line), None)
    return found if not found or plan.path[found - 1].line else found - 1


def resumed(memory: Memory, motion: Motion, plan: Plan, settings: Settings) -> Memory:
    """The memory with which an interrupted path goes on: on a survey's line, or shortly before one, from a run-in before where
    it was left, as far as the way before that is straight: a boat that has drifted onto the line begins before it."""
    ahead = plan.path[memory.leg : memory.leg + BEFORE_LINE] if memory.leg >= 0 else ()
    if not memory.line_m or not any(piece.line for piece in ahead):
        return memory
    piece, before = plan.path[memory.leg], plan.path[memory.leg - 1] if memory.leg else None
    straight_m = _length_m(piece)
    if before is not None and abs(wrap(_start_tangent_rad(piece) - _start_tangent_rad(before))) < STRAIGHT_RAD:
        straight_m += _length_m(before)
    line_m = min(memory.line_m + RUN_IN * settings.control.path.lookahead_m, straight_m)
    return memory._replace(leg=APPROACH - memory.leg, north_m=motion.north_m, east_m=motion.east_m, line_m=line_m)


def goal(memory: Memory, path: Sequence[Line | Arc]) -> tuple[float, float]:
    """(north_m, east_m) of where a boat begins that is on its way to the path."""
    piece = path[piece_of(memory.leg)]
    if not memory.line_m:
        return start(piece)
    tangent_rad, (north_m, east_m) = _start_tangent_rad(piece), end_of(piece)
    return north_m - memory.line_m * math.cos(tangent_rad), east_m - memory.line_m * math.sin(tangent_rad)


def _length_m(piece: Line | Arc) -> float:
    """Of a line; 0 of an arc."""
    return math.dist(piece[:2], piece[2:4]) if isinstance(piece, Line) else 0.0


def step(
    memory: Memory, motion: Motion, setpoint: Setpoint, settings: Settings, dt_s: float
) -> tuple[Memory, Reference, Wanted]:
    path = setpoint.plan.path if setpoint.plan is not None else ()
    if memory.leg >= len(path):
        return memory, Reference(leg=memory.leg, done=True), STOP
    onwards = memory.leg + 1 if memory.leg >= 0 else piece_of(memory.leg)
    if memory.left_s > 0.0:
        return _stay(memory, motion, setpoint, settings, dt_s, onwards == len(path))
    piece = path[memory.leg] if memory.leg >= 0 else _approach(memory, path)
    tangent_rad, cross_m, left_m, swept_rad = nearest(piece, motion, memory.swept_rad)
    ahead_m, stops = settings.control.path.lookahead_m, onwards == len(path) or piece.hold_s > 0.0
    is_gentle = abs(cross_m) > ahead_m and not (stops and left_m < abs(cross_m))  # onto it at 45 degrees, but for its end
    off_m = math.copysign(ahead_m, cross_m) if is_gentle else cross_m
    course, heading_rad = course_to_steer(memory.course, motion, tangent_rad, off_m, settings.control.path, dt_s)
    speed_mps = piece.speed_mps if setpoint.override_mps is None else setpoint.override_mps
    if stops:
        speed_mps = min(speed_mps, max(math.sqrt(settings.control.speed.ramp_mps2 * max(left_m, 0.0)), CREEP_MPS))
    turn_radps = 0.0
    if isinstance(piece, Arc) and abs(cross_m) <= piece.radius_m:  # farther off it the boat comes back straight
        beyond_rad = math.copysign(1.0, piece.turn_rad) * wrap(motion.heading_rad - heading_rad)
        if beyond_rad < TURNED_RAD:
            turn_radps = math.copysign(speed_mps / piece.radius_m, piece.turn_rad)
    elif isinstance(piece, Line) and not is_gentle:
        turn_radps = turn_onto(motion, tangent_rad, cross_m, ahead_m, speed_mps)
    integrals, wanted = steer(memory.integrals, motion, heading_rad, speed_mps, settings, dt_s, turn_radps)
    north_m, east_m = end_of(piece)
    reference = Reference(wrap(heading_rad), speed_mps, cross_m, max(left_m, 0.0), north_m, east_m, piece_of(memory.leg))
    line_m = memory.line_m if memory.leg < 0 else max(left_m, 0.0) if isinstance(piece, Line) else 0.0
    after = Memory(integrals, course, *memory[2:5], swept_rad, line_m=line_m)
    if piece.line:
        reference = reference._replace(line=piece.line)
    if stops and (left_m > 0.0 or not piece.hold_s):
        return after, reference._replace(done=True) if left_m <= 0.0 else reference, wanted
    if stops:
        return after._replace(north_m=north_m, east_m=east_m, heading_rad=None, left_s=piece.hold_s), reference, wanted
    corner_rad = abs(wrap(_start_tangent_rad(path[onwards]) - tangent_rad))
    if left_m > wheel_over_m(corner_rad, speed_mps, ahead_m):
        return after, reference, wanted
    course = LineOfSight(course.crab_rad, course.shift_m * max(math.cos(corner_rad), 0.0))
    return after._replace(leg=onwards, swept_rad=0.0, course=course), reference, wanted


def _stay(
    memory: Memory, motion: Motion, setpoint: Setpoint, settings: Settings, dt_s: float, last: bool
) -> tuple[Memory, Reference, Wanted]:
    """Stay at the end of a piece."""
    memory, reference, wanted = hold.step(memory, motion, setpoint, settings, dt_s)
    reference, left_s = reference._replace(leg=piece_of(memory.leg)), memory.left_s - dt_s
    if left_s > 0.0:
        return memory._replace(left_s=left_s), reference, wanted
    if last:
        return memory, reference._replace(done=True), wanted
    return memory._replace(leg=memory.leg + 1, swept_rad=0.0, driving=0, left_s=0.0), reference, wanted


def _approach(memory: Memory, path: Sequence[Line | Arc]) -> Line:
    to_north_m, to_east_m = goal(memory, path)
    return Line(memory.north_m, memory.east_m, to_north_m, to_east_m, path[piece_of(memory.leg)].speed_mps)


def nearest(piece: Line | Arc, motion: Motion, swept_rad: float) -> tuple[float, float, float, float]:
    """(tangent, cross-track, left to go, swept) at the point of the piece that is nearest to the boat. The angle swept so far
    tells the turns of an arc apart.
    """
    if isinstance(piece, Line):
        return *along(motion, piece.north_m, piece.east_m, piece.to_north_m, piece.to_east_m), 0.0
    side = math.copysign(1.0, piece.turn_rad)
    off_north, off_east = motion.north_m - piece.north_m, motion.east_m - piece.east_m
    bearing_rad = math.atan2(off_east, off_north)
    swept_rad += side * wrap(bearing_rad - piece.start_rad - side * swept_rad)
    cross_m = side * (piece.radius_m - math.hypot(off_north, off_east))
    return bearing_rad + side * math.pi / 2.0, cross_m, (abs(piece.turn_rad) - swept_rad) * piece.radius_m, swept_rad


def wheel_over_m(corner_rad: float, speed_mps: float, at_most_m: float) -> float:
    """How far before its end a piece is left for the next one; zero where they join smoothly."""
    return min(speed_mps * TURN_S * math.tan(min(corner_rad, CORNER_MAX_RAD) / 2.0), at_most_m)


def _start_tangent_rad(piece: Line | Arc) -> float:
    if isinstance(piece, Line):
        return math.atan2(piece.to_east_m - piece.east_m, piece.to_north_m - piece.north_m)
    return piece.start_rad + math.copysign(math.pi / 2.0, piece.turn_rad)


def start(piece: Line | Arc) -> tuple[float, float]:
    return (piece.north_m, piece.east_m) if isinstance(piece, Line) else arc_point(piece, 0.0)


def end_of(piece: Line | Arc) -> tuple[float, float]:
    return (piece.to_north_m, piece.to_east_m) if isinstance(piece, Line) else arc_point(piece, piece.turn_rad)


def arc_point(arc: Arc, turned_rad: float) -> tuple[float, float]:
    """(north_m, east_m) of the arc's point after a turn, positive clockwise."""
    bearing_rad = arc.start_rad + turned_rad
    return arc.north_m + arc.radius_m * math.cos(bearing_rad), arc.east_m + arc.radius_m * math.sin(bearing_rad)
