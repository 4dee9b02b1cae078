"""Each mode steers for its set points, and ends a leg, a drive or itself where docs/control.md says."""

import math
from collections.abc import Iterator
from typing import Final

from delfim.base.geodesy import wrap
from delfim.base.modes import Mode
from delfim.simulator.invariants.cycle import CycleSeen
from delfim.simulator.invariants.fence import PlainFence
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle.control.memory import Integrals, LineOfSight, Memory
from delfim.vehicle.state import Arc, Line, Motion, Setpoint, State, Waypoint

SAME: Final = 1e-6  # m, m/s, rad
CREEP_MPS: Final = 0.3  # docs/control.md
COURSE_MPS: Final = 0.4
CRAB_MAX_RAD: Final = math.radians(60.0)
NEAR: Final = 0.25
STOPS_S: Final = 3.0  # a hold begins so far ahead of the boat
BEHIND_RAD: Final = math.radians(120.0)
STEERED: Final = frozenset(Mode) - {Mode.IDLE, Mode.MANUAL, Mode.TRIAL}
LATE_S: Final = 1.0  # after its time a mode has ended
Point = tuple[float, float]


def onto(a: Point, b: Point, motion: Motion) -> tuple[float, float, float]:
    """(bearing, cross-track error, distance left) of the boat on a line from a to b."""
    bearing_rad = math.atan2(b[1] - a[1], b[0] - a[0])
    off_n, off_e = motion.north_m - b[0], motion.east_m - b[1]
    ahead_n, ahead_e = math.cos(bearing_rad), math.sin(bearing_rad)
    return bearing_rad, off_e * ahead_n - off_n * ahead_e, -(off_n * ahead_n + off_e * ahead_e)


def line_of_sight(
    was: LineOfSight, motion: Motion, bearing_rad: float, cross_m: float, cycle: CycleSeen
) -> tuple[LineOfSight, float]:
    """The line of sight of docs/control.md: its memory after this step, and the heading."""
    path, dt_s = cycle.run.vehicle.helm.limits.control.path, cycle.dt_s
    made_mps = motion.north_mps * math.cos(motion.heading_rad) + motion.east_mps * math.sin(motion.heading_rad)
    crab_rad = 0.0
    if made_mps > COURSE_MPS:
        crab_rad = wrap(math.atan2(motion.east_mps, motion.north_mps) - motion.heading_rad)
        crab_rad = min(max(crab_rad, -CRAB_MAX_RAD), CRAB_MAX_RAD)
    crab_rad = was.crab_rad + (crab_rad - was.crab_rad) * min(dt_s / path.crab_s, 1.0)
    shifted_m, shift_m, ahead_m = cross_m + was.shift_m, was.shift_m, path.lookahead_m
    if abs(cross_m) < NEAR * ahead_m:
        shift_m += dt_s * path.integral_gain * ahead_m * cross_m / (shifted_m**2 + ahead_m**2)
        shift_m = min(max(shift_m, -ahead_m), ahead_m)
    return LineOfSight(crab_rad, shift_m), bearing_rad - math.atan2(shifted_m, ahead_m) - crab_rad


def reached(to: Waypoint, far_m: float, left_m: float) -> bool:
    """Whether a waypoint is reached: within the radius, or abeam within twice of it."""
    return far_m <= to.acceptance_m + SAME or (left_m <= SAME and far_m <= 2.0 * to.acceptance_m + SAME)


def differs(one: float | None, other: float | None) -> bool:
    if one is None or other is None:
        return one is not other
    return abs(one - other) > SAME


def turned(one: float | None, other: float | None) -> bool:
    if one is None or other is None:
        return one is not other
    return abs(wrap(one - other)) > SAME


class Guidance:
    """The heading and the speed that a mode steers for are those of its order, its line or its point."""

    def __init__(self, run: Lockstep) -> None:
        self._looks = {
            Mode.HEADING: self._heading,
            Mode.COURSE: self._course,
            Mode.GREX: self._guest,
            Mode.GOTO: self._goto,
            Mode.PLAY: self._play,
            Mode.HOME: self._home,
            Mode.PATH: self._path,
            Mode.HOLD: self._hold,
            Mode.UNSTICK: self._unstick,
        }

    def look(self, cycle: CycleSeen) -> Iterator[str]:
        state = cycle.state
        if cycle.steered and not state.reference.reason and state.mode in self._looks:
            yield from self._looks[state.mode](cycle)
        elif state.mode is not cycle.was.mode and state.reason.startswith(f"{cycle.was.mode.name.lower()} done"):
            yield from self._done(cycle)

    def _steers(self, cycle: CycleSeen, heading_rad: float | None, speed_mps: float | None) -> Iterator[str]:
        reference, mode = cycle.state.reference, cycle.state.mode.name.lower()
        if turned(reference.heading_rad, heading_rad):
            yield f"{mode} steers {_degrees(reference.heading_rad)}, not {_degrees(heading_rad)}"
        if differs(reference.speed_mps, speed_mps):
            yield f"{mode} asks for {reference.speed_mps} m/s, not {speed_mps}"

    def _heading(self, cycle: CycleSeen) -> Iterator[str]:
        yield from self._steers(cycle, cycle.state.setpoint.heading_rad, cycle.state.setpoint.speed_mps)

    def _course(self, cycle: CycleSeen) -> Iterator[str]:
        state, asked_rad = cycle.state, cycle.state.setpoint.heading_rad
        course, heading_rad = line_of_sight(cycle.was.memory.course, state.motion, asked_rad, 0.0, cycle)
        yield from self._steers(cycle, heading_rad, state.setpoint.speed_mps)
        yield from _remembers(cycle, course)

    def _guest(self, cycle: CycleSeen) -> Iterator[str]:
        yield from self._steers(cycle, cycle.state.setpoint.guest_heading_rad, cycle.state.setpoint.guest_speed_mps)

    def _goto(self, cycle: CycleSeen) -> Iterator[str]:
        setpoint, leg = cycle.state.setpoint, cycle.was.memory.leg
        if setpoint.target is None:
            yield from self._hold(cycle)
        elif leg < len(setpoint.via):
            yield from self._leg(cycle, setpoint.via[leg], stops=False, then=leg + 1)
        else:
            yield from self._leg(cycle, setpoint.target, stops=True, then=None)

    def _play(self, cycle: CycleSeen) -> Iterator[str]:
        plan, leg = cycle.state.setpoint.plan, cycle.was.memory.leg
        if plan is None or cycle.was.memory.left_s or cycle.memory.left_s or leg >= len(plan.waypoints):
            return
        to, is_last = plan.waypoints[leg], leg + 1 == len(plan.waypoints)
        yield from self._leg(cycle, to, stops=is_last or to.hold_s > 0.0, then=None if is_last else leg + 1)

    def _home(self, cycle: CycleSeen) -> Iterator[str]:
        """To save energy the boat slows down after a step: it may have taken this one at the speed before."""
        track, leg, control = cycle.state.setpoint.track, cycle.was.memory.leg, cycle.run.vehicle.helm.limits.control
        if 0 <= leg < len(track):
            to = Waypoint(*track[leg], control.home.speed_mps, control.path.acceptance_m)
            before_mps = cycle.was.setpoint.override_mps
            is_before = not differs(cycle.state.reference.speed_mps, to.speed_mps if before_mps is None else before_mps)
            yield from self._leg(cycle, to, stops=leg == 0, then=leg - 1 if leg else None, is_before=is_before)

    def _leg(self, cycle: CycleSeen, to: Waypoint, *, stops: bool, then: int | None, is_before: bool = False) -> Iterator[str]:
        """Take one step on a leg; `then` is the leg that begins at its end, None: it is the last. `is_before`: at the speed
        that was ordered before the step."""
        state, was, after = cycle.state, cycle.was.memory, cycle.memory
        motion, reference, control = state.motion, state.reference, cycle.run.vehicle.helm.limits.control
        mode, begin, end = state.mode.name.lower(), (was.north_m, was.east_m), (to.north_m, to.east_m)
        bearing_rad, cross_m, left_m = onto(begin, end, motion)
        far_m = math.dist(end, (motion.north_m, motion.east_m))
        is_there = reached(to, far_m, left_m)
        if left_m <= 0.0 and not is_there:  # a wide miss starts a new line from here
            begin = motion.north_m, motion.east_m
            bearing_rad, cross_m, left_m = onto(begin, end, motion)
        course, heading_rad = line_of_sight(was.course, motion, bearing_rad, cross_m, cycle)
        override_mps = (cycle.was if is_before else state).setpoint.override_mps
        speed_mps = to.speed_mps if override_mps is None else override_mps
        if stops:
            speed_mps = min(speed_mps, max(math.sqrt(control.speed.ramp_mps2 * far_m), CREEP_MPS))
        yield from self._steers(cycle, heading_rad, speed_mps)
        yield from _remembers(cycle, course)
        if differs(reference.distance_m, far_m) or differs(reference.cross_track_m, cross_m):
            yield f"{mode} tells {reference.distance_m} m to go, {reference.cross_track_m} m off, not {far_m}, {cross_m}"
        if (reference.north_m, reference.east_m) != end:
            yield f"{mode} goes to {reference.north_m}, {reference.east_m}, not to {end}"
        if is_there and then is None:
            if not cycle.is_order:  # the first step after an order ends nothing yet
                yield f"{mode} is not done {far_m:.1f} m from its end"
            return
        leg, begin = (then, end) if is_there and then is not None else (was.leg, begin)
        if (after.leg, after.north_m, after.east_m) != (leg, *begin):
            yield f"{mode} goes on with leg {after.leg}, not {leg}, {far_m:.1f} m from the end of leg {was.leg}"

    def _done(self, cycle: CycleSeen) -> Iterator[str]:
        """Whether the boat reports that a mode is done."""
        was, motion, setpoint, mode = cycle.was.memory, cycle.state.motion, cycle.was.setpoint, cycle.was.mode
        to = setpoint.target if mode is Mode.GOTO else None
        if mode is Mode.PLAY and setpoint.plan is not None:
            to = setpoint.plan.waypoints[-1]
        if mode is Mode.HOME and setpoint.track:
            to = Waypoint(*setpoint.track[0], 0.0, cycle.run.vehicle.helm.limits.control.path.acceptance_m)
        if mode is Mode.PATH and setpoint.plan is not None and isinstance(piece := setpoint.plan.path[-1], Line):
            left_m = onto((piece.north_m, piece.east_m), (piece.to_north_m, piece.to_east_m), motion)[2]
            if left_m > SAME or was.leg != len(setpoint.plan.path) - 1:
                yield f"path is done {left_m:.1f} m before its end, on piece {was.leg}"
        if to is None:
            return
        end, here = (to.north_m, to.east_m), (motion.north_m, motion.east_m)
        left_m = onto((was.north_m, was.east_m), end, motion)[2]
        if not reached(to, math.dist(end, here), left_m):
            yield f"{mode.name.lower()} is done {math.dist(end, here):.1f} m from its end"

    def _path(self, cycle: CycleSeen) -> Iterator[str]:
        state, was = cycle.state, cycle.was.memory
        plan, motion, control = state.setpoint.plan, state.motion, cycle.run.vehicle.helm.limits.control
        if plan is None or was.leg >= len(plan.path) or was.left_s or cycle.memory.left_s:
            return
        piece = plan.path[was.leg] if was.leg >= 0 else None
        onwards = was.leg + 1 if piece is not None else -1 - was.leg
        following = plan.path[onwards] if onwards < len(plan.path) else None
        if piece is None and isinstance(following, Line):
            a, b, speed_mps = (was.north_m, was.east_m), _beginning(following, was.line_m), following.speed_mps
        elif isinstance(piece, Line):
            a, b, speed_mps = (piece.north_m, piece.east_m), (piece.to_north_m, piece.to_east_m), piece.speed_mps
        else:
            return  # an arc
        stops = following is None or (piece is not None and piece.hold_s > 0.0)
        bearing_rad, cross_m, left_m = onto(a, b, motion)
        ahead_m, off_m = control.path.lookahead_m, cross_m
        if abs(cross_m) > ahead_m and not (stops and left_m < abs(cross_m)):
            off_m = math.copysign(ahead_m, cross_m)
        course, heading_rad = line_of_sight(was.course, motion, bearing_rad, off_m, cycle)
        speed_mps = speed_mps if state.setpoint.override_mps is None else state.setpoint.override_mps
        if stops:
            speed_mps = min(speed_mps, max(math.sqrt(control.speed.ramp_mps2 * max(left_m, 0.0)), CREEP_MPS))
        yield from self._steers(cycle, heading_rad, speed_mps)
        if following is not None and cycle.memory.leg == onwards:  # it learnt what pushes aside of this piece, not of the next
            kept = max(math.cos(_tangent_rad(following) - bearing_rad), 0.0)
            course = course._replace(shift_m=course.shift_m * kept)
        yield from _remembers(cycle, course)
        if differs(state.reference.cross_track_m, cross_m) or differs(state.reference.distance_m, max(left_m, 0.0)):
            yield f"path tells {state.reference.distance_m} m to go, {state.reference.cross_track_m} m off, not {left_m}"
        if state.reference.done is not (following is None and left_m <= 0.0):
            yield f"path is {'done' if state.reference.done else 'not done'} {left_m:.1f} m before its end"
        over_m = 0.0
        if isinstance(following, Line) and not stops:
            corner_rad = min(abs(wrap(_tangent_rad(following) - bearing_rad)), math.radians(120.0))
            over_m = min(3.0 * speed_mps * math.tan(corner_rad / 2.0), ahead_m)
            leg = was.leg if left_m > over_m else onwards
            if cycle.memory.leg != leg:
                yield f"path goes on with piece {cycle.memory.leg}, not {leg}, {left_m:.1f} m before the end"

    def _unstick(self, cycle: CycleSeen) -> Iterator[str]:
        """Whether the boat goes out no faster, no farther and for no longer than its file says."""
        state, was, limits = cycle.state, cycle.was.memory, cycle.run.vehicle.helm.limits.control.unstick
        if state.reference.done:
            return
        if abs(abs(state.reference.speed_mps or 0.0) - limits.speed_mps) > SAME:
            yield f"unstick asks for {state.reference.speed_mps} m/s, not {limits.speed_mps} astern"
        far_m = math.dist((was.north_m, was.east_m), (state.motion.north_m, state.motion.east_m))
        if far_m > limits.distance_m + SAME or cycle.now_s - state.mode_s > limits.time_s + LATE_S:
            yield f"unstick goes on after {cycle.now_s - state.mode_s:.1f} s, {far_m:.1f} m away"

    def _hold(self, cycle: CycleSeen) -> Iterator[str]:
        state, was, after = cycle.state, cycle.was.memory, cycle.memory
        hold, motion, mode = cycle.run.vehicle.helm.limits.control.hold, cycle.state.motion, cycle.state.mode.name.lower()
        if (was.north_m, was.east_m, was.room) != (after.north_m, after.east_m, after.room):
            return  # it was given a better place meanwhile
        north_m, east_m = was.north_m - motion.north_m, was.east_m - motion.east_m
        far_m, bearing_rad, radius_m = math.hypot(north_m, east_m), math.atan2(east_m, north_m), was.room * hold.radius_m
        driving = was.driving
        if driving and far_m < 0.4 * radius_m:
            driving = 0
        elif not driving and far_m > radius_m:
            is_behind = abs(wrap(bearing_rad - motion.heading_rad)) > BEHIND_RAD and far_m < 3.0 * radius_m
            driving = -1 if is_behind else 1
        if after.driving != driving:
            yield f"{mode} drives {after.driving}, not {driving}, {far_m:.1f} m from its place"
        if differs(state.reference.distance_m, far_m) or (state.reference.north_m, state.reference.east_m) != (
            was.north_m,
            was.east_m,
        ):
            yield f"{mode} tells {state.reference.distance_m} m to its place, not {far_m}"
        if driving:
            heading_rad = bearing_rad if driving > 0 else bearing_rad + math.pi
            yield from self._steers(cycle, heading_rad, driving * min(far_m / 5.0, hold.speed_mps))
        elif not cycle.run.vehicle.helm.limits.hull.aside_n:
            yield from self._steers(cycle, None, 0.0)


def _tangent_rad(piece: Line | Arc) -> float:
    """Of its beginning."""
    if isinstance(piece, Line):
        return math.atan2(piece.to_east_m - piece.east_m, piece.to_north_m - piece.north_m)
    return piece.start_rad + math.copysign(math.pi / 2.0, piece.turn_rad)


def _beginning(piece: Line, line_m: float) -> Point:
    """Where a path begins: with a survey's line that was left, so far before its end."""
    begin, end = (piece.north_m, piece.east_m), (piece.to_north_m, piece.to_east_m)
    part = line_m / math.dist(begin, end) if line_m else 1.0
    return end[0] + part * (begin[0] - end[0]), end[1] + part * (begin[1] - end[1])


def begun(mode: Mode, setpoint: Setpoint, motion: Motion) -> Memory:
    """The memory with which a mode begins: integrals at zero, the ramp at the speed of the boat, its leg or place here."""
    ahead_n, ahead_e = math.cos(motion.heading_rad), math.sin(motion.heading_rad)
    integrals = Integrals(speed_mps=motion.north_mps * ahead_n + motion.east_mps * ahead_e)
    here, leg = (motion.north_m, motion.east_m), 0
    if mode is Mode.HOLD or (mode is Mode.GOTO and setpoint.target is None):
        here = motion.north_m + STOPS_S * motion.north_mps, motion.east_m + STOPS_S * motion.east_mps
    elif mode is Mode.PLAY:
        leg = setpoint.leg
    elif mode is Mode.PATH:
        leg = -1 - setpoint.piece
    elif mode is Mode.HOME:
        leg = len(setpoint.track) - 1
    return Memory(integrals, LineOfSight(), *here, leg)


class Beginnings:
    """A mode that begins without an order has nothing left of the one before, and a hold begins where the boat can stop, or
    where the fence leaves it room."""

    def __init__(self, run: Lockstep) -> None:
        self._fence, self._hold_s = PlainFence(run), -math.inf
        self._place: Point | None = None  # where a hold would have begun without a fence

    def ordered(self, state: State, *, is_hold: bool) -> None:
        """Note that an order was obeyed."""
        place = begun(Mode.HOLD, state.setpoint, state.motion) if is_hold else None
        self._hold_s, self._place = state.mode_s, None if place is None else (place.north_m, place.east_m)

    def look(self, cycle: CycleSeen) -> Iterator[str]:
        state, has = cycle.state, cycle.memory
        begins = state.mode is not cycle.was.mode and not state.reason.startswith(("operator", "payload", "restarted"))
        if begins and state.mode in STEERED and state.navigation_s >= state.mode_s:  # without navigation it has not begun yet
            should = begun(state.mode, state.setpoint, state.motion)
            held, push, speed_mps = has.integrals.yaw_nm, has.integrals.surge_n, has.integrals.speed_mps
            if (
                held
                or push
                or differs(speed_mps, should.integrals.speed_mps if speed_mps or state.mode is not Mode.HOLD else 0.0)
            ):
                yield f"{state.mode.name.lower()} begins with {held} N m, {push} N and {speed_mps} m/s"
        if state.mode is not Mode.HOLD or any(notice.action == "back" for notice in state.notices):
            self._hold_s = -math.inf
            return
        is_same = state.reason == cycle.was.reason and state.setpoint is cycle.was.setpoint and "position" in state.motion.has
        if self._hold_s != state.mode_s or not is_same:
            self.ordered(
                state, is_hold=begins and state.mode_s == cycle.now_s and not state.twice
            )  # else it began at another fix
        if self._place is not None:
            yield from self._held(cycle, self._place, (has.north_m, has.east_m), has.room)

    def _held(self, cycle: CycleSeen, first: Point, at: Point, room: float) -> Iterator[str]:
        """The place that a hold keeps, if it would have been at `first` without a fence."""
        zones, helm = self._fence.zones(), cycle.run.vehicle.helm
        if zones is None:
            return
        radius_m, margin_m = helm.limits.control.hold.radius_m, self._fence.limits.margin_m
        needed_m = room * radius_m + margin_m - SAME
        is_free = not zones or min(zone.clear_m(first) for zone in zones) >= radius_m + margin_m + SAME
        is_first = math.dist(at, first) <= SAME
        if is_free and not (is_first and room == 1.0):
            yield f"hold keeps {at} with {room} of its radius, not {first}, where the fence leaves it room"
        elif not is_first and zones and min(zone.clear_m(at) for zone in zones) < needed_m:
            yield f"hold keeps {at} with {room} of its radius, where the fence leaves it no room"


def _remembers(cycle: CycleSeen, course: LineOfSight) -> Iterator[str]:
    has = cycle.memory.course
    if differs(has.crab_rad, course.crab_rad) or differs(has.shift_m, course.shift_m):
        yield f"line of sight: {has.crab_rad:.3f} rad, {has.shift_m:.3f} m, not {course.crab_rad:.3f}, {course.shift_m:.3f}"


def _degrees(angle_rad: float | None) -> str:
    return "nothing" if angle_rad is None else f"{math.degrees(angle_rad) % 360.0:.1f} degrees"
