"""Measures how well a boat was steered, mode by mode, from its true motion and position, not from what it knew of them."""

import math
from itertools import pairwise
from typing import Final

from delfim.base.geodesy import wrap
from delfim.base.modes import Mode
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle.control.modes.path import nearest
from delfim.vehicle.plans.zones import Point, from_segment
from delfim.vehicle.state import Arc, Motion, Plan

STEADY_S: Final = 60.0  # after an order, or after a hold began, what is left counts as steady
CORNER_S: Final = 20.0  # a boat that comes onto a path across it gets this long; smooth joints get nothing
SETTLED, SETTLED_RAD = 0.05, math.radians(3.0)  # a turn is over within this part of it, but not below this error ...
STAYS_S: Final = 10.0  # ... for so long; a gust may come later
DRIVEN_M, NEAR = 2.0, 10  # between the places of the track that is remembered, and how many of them are looked through
ALL: Final = frozenset({"position", "heading", "velocity"})
# Asked for in each cycle: a lookup in the enumeration takes longer than the comparison.
_HEADING, _COURSE, _HOLD, _HOME, _PATH, _PLAY = Mode.HEADING, Mode.COURSE, Mode.HOLD, Mode.HOME, Mode.PATH, Mode.PLAY


class Deviation:
    """Root of the mean square, and the greatest size, of values that nobody keeps. None: there was none."""

    def __init__(self) -> None:
        self.count, self._squares, self._most = 0, 0.0, 0.0

    def add(self, value: float) -> None:
        self.count, self._squares = self.count + 1, self._squares + value * value
        if (size := abs(value)) > self._most:
            self._most = size

    @property
    def rms(self) -> float | None:
        return math.sqrt(self._squares / self.count) if self.count else None

    @property
    def most(self) -> float | None:
        return self._most if self.count else None


class SteerTape:
    """Measures one run. Call `look` after each cycle. Of several orders, or several holds, the last one counts."""

    def __init__(self, run: Lockstep) -> None:
        self._run, self._mode_s = run, -math.inf
        self._asked: tuple[float, float] | None = None  # mode_s and direction of the last order
        self._began_s = self._limit_rad = self._side = self._inside_s = 0.0
        self.over_deg: float | None = None
        self.settled_s: float | None = None
        self.steady_deg, self.held_m, self.turned_deg = Deviation(), Deviation(), Deviation()
        self.rests = 0  # cycles of the steady hold with all thrusters at rest
        self.lines_m, self.arcs_m, self.home_m = Deviation(), Deviation(), Deviation()
        self._joined_s = 0.0
        self._driven, self._back = list[Point](), 0  # its true track, and the place there that it is near on the way home
        self._plan: Plan | None = None
        self._closest_m, self._left = list[float](), 0  # to each waypoint, less its radius; and how many of them are behind it

    @property
    def missed_m(self) -> float | None:
        """The greatest distance, m, by which the boat missed the radius of a waypoint that is behind it. Negative: it was
        within all of them."""
        return max((each for each in self._closest_m[: self._left] if each < math.inf), default=None)

    @property
    def resting(self) -> float | None:
        return self.rests / self.held_m.count if self.held_m.count else None

    def look(self, now_s: float, here: Point) -> None:
        """Measure a cycle; `here` is the true position in the local plane."""
        state, model = self._run.state, self._run.nodes.model
        mode, since_s = state.mode, state.mode_s
        entered, self._mode_s = since_s != self._mode_s, since_s
        if mode is _HEADING:
            self._turning(now_s, model.heading_rad)
        elif mode is _COURSE:
            self._turning(now_s, math.atan2(model.east_mps, model.north_mps))
        elif mode is _HOLD:
            if entered:
                self._left = len(self._closest_m) if state.reason == "play done" else self._left
                self.held_m, self.turned_deg, self.rests = Deviation(), Deviation(), 0
            if now_s - since_s >= STEADY_S:
                self._holding(*here)
        elif mode is _PATH:
            self._following(now_s, entered, *here)
        elif mode is _PLAY:
            self._playing(*here)
        if mode is _HOME:
            self._returning(entered, here)
        elif not self._driven or math.dist(self._driven[-1], here) > DRIVEN_M:
            self._driven.append(here)

    def _turning(self, now_s: float, direction_rad: float) -> None:
        asked_rad = self._run.state.setpoint.heading_rad
        error_rad = wrap(asked_rad - direction_rad)
        if self._asked != (self._mode_s, asked_rad):
            self._asked, self._began_s, self._side = (self._mode_s, asked_rad), now_s, 0.0
            self._limit_rad = max(SETTLED * abs(error_rad), SETTLED_RAD)
            self.over_deg, self.settled_s, self.steady_deg, self._inside_s = 0.0, None, Deviation(), now_s
        is_steady = now_s - self._began_s >= STEADY_S
        if abs(error_rad) < math.pi / 2.0 and not is_steady:  # further round, the side is none: half a turn goes either way
            self._side = self._side or math.copysign(1.0, error_rad)
            self.over_deg = max(self.over_deg or 0.0, -math.degrees(error_rad * self._side))
        if self.settled_s is None:
            if abs(error_rad) > self._limit_rad:
                self._inside_s = now_s
            elif now_s - self._inside_s >= STAYS_S:
                self.settled_s = self._inside_s - self._began_s
        if is_steady:
            self.steady_deg.add(math.degrees(error_rad))

    def _holding(self, north_m: float, east_m: float) -> None:
        state = self._run.state
        to = state.reference
        if to.north_m is None or to.east_m is None:
            return
        self.held_m.add(math.hypot(to.north_m - north_m, to.east_m - east_m))
        self.rests += not any(state.actuation.thrust)
        if to.heading_rad is not None and to.speed_mps == 0.0:  # a boat with sway keeps a heading, too
            self.turned_deg.add(math.degrees(wrap(to.heading_rad - self._run.nodes.model.heading_rad)))

    def _following(self, now_s: float, entered: bool, north_m: float, east_m: float) -> None:
        leg, plan = self._run.vehicle.helm.memory.leg, self._run.state.setpoint.plan
        if entered or leg < 0:
            self._joined_s = now_s
        if plan is not None and now_s - self._joined_s > CORNER_S and leg < len(plan.path):
            piece = plan.path[leg]
            off_m = nearest(piece, _at(north_m, east_m), 0.0)[1]
            (self.arcs_m if isinstance(piece, Arc) else self.lines_m).add(off_m)

    def _playing(self, north_m: float, east_m: float) -> None:
        plan, leg = self._run.state.setpoint.plan, self._run.state.reference.leg
        if plan is None:
            return
        if plan is not self._plan:
            self._plan, self._closest_m = plan, [math.inf] * len(plan.waypoints)
        self._left = leg
        for number in range(max(leg - 1, 0), min(leg + 1, len(plan.waypoints))):
            to = plan.waypoints[number]
            far_m = math.hypot(to.north_m - north_m, to.east_m - east_m) - to.acceptance_m
            if far_m < self._closest_m[number]:
                self._closest_m[number] = far_m

    def _returning(self, entered: bool, here: Point) -> None:
        """Follow the track back: the place on it moves with the boat, so that a long track costs no more than a short one."""
        if entered:
            self._back = len(self._driven) - 1
        first = max(self._back - NEAR, 0)
        near = self._driven[first : self._back + 2]
        if len(near) > 1:
            self._back = first + min(range(len(near)), key=lambda i: math.dist(near[i], here))
            ways = pairwise(self._driven[max(self._back - 1, 0) : self._back + 2])
            self.home_m.add(min(from_segment(a, (b[0] - a[0], b[1] - a[1]), here) for a, b in ways))


def _at(north_m: float, east_m: float) -> Motion:
    return Motion(ALL, north_m, east_m, 0.0, 0.0, 0.0, 0.0)
