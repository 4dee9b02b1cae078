"""A few lines sailed by the simulated boat, in lock step and a calm: what turns take beyond their length, and what she draws.

Turns from line to line are right angles or arcs. Where a plan has sharper corners or slow ways, as beside holes, she sails
these, too, after the lines.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, zip_longest
from typing import Final, NamedTuple

import msgspec
from shapely.geometry import MultiPolygon, box

from delfim import config
from delfim.base.errors import DelfimError
from delfim.base.geodesy import origin, wrap
from delfim.base.modes import Mode
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.tables import Sea, SimulatedBed, Simulation
from delfim.survey.ground import Ground, Place, in_degrees
from delfim.survey.planning import SLOWLY, LinesWanted, SurveyPlan, mission, planned, slow_ways, stops
from delfim.survey.turns import towards
from delfim.vehicle import console
from delfim.vehicle.control.modes.path import wheel_over_m
from delfim.vehicle.plans.mission import Mission, PathPoint, Waypoint, canonical
from delfim.vehicle.state import NoLog

WEATHER: Final = 1.04  # what boats drew in 4 m/s of wind and 0.2 m/s of current, by a calm (`bench/survey.py`)
LINES: Final = 4
STEERED_LINES: Final = 9  # of a boat that steers: with four, close together, half of the arcs are loops, as in no whole area
LONG_M: Final = 40.0  # of each
LEAST_M, MOST_M = 2.0, 60.0  # of their spacing: beyond, a turn takes what it takes with that
UNTIL_S: Final = 2700.0
PLACE: Final = 38.6907, -9.2153  # anywhere; degrees
CORNER_RAD: Final = 0.1  # a corner that is less is none
SHARP_RAD: Final = math.radians(110.0)  # and one that is more has to be sailed to be known
BACK_M: Final = -30.0, -38.5, -18.5, -48.5  # along the last line, from its run-out: back, slower, slowly back, and back
SLOW: Final = 1, 2  # of these
BACK_STEERED_M: Final = (-60.0,)  # of a boat that steers


@dataclass(frozen=True, slots=True)
class Taken:
    """What something takes of time and of the batteries; of a turn, beyond its length at the speed and the power there."""

    s: float = 0.0
    j: float = 0.0

    def __add__(self, other: "Taken") -> "Taken":
        return Taken(self.s + other.s, self.j + other.j)

    def __sub__(self, other: "Taken") -> "Taken":
        return Taken(self.s - other.s, self.j - other.j)

    def __mul__(self, times: float) -> "Taken":
        return Taken(self.s * times, self.j * times)


NOTHING: Final = Taken()


class SharpTurns(NamedTuple):
    """What is sailed beside holes: corners of 180 degrees."""

    back: Taken
    slow_w: float = 0.0  # power, on slow ways
    slow_back: Taken = NOTHING  # on a slow way, shortly behind its beginning
    faster: Taken = NOTHING  # at its end


class SurveyLeg(NamedTuple):
    """A piece of the way as it is sailed. Headings from north, clockwise."""

    begin: Place
    to: Place
    begin_rad: float  # its heading there ...
    to_rad: float  # ... and at its end
    long_m: float
    line: int = 0  # 0: none
    is_slow: bool = False
    is_arc: bool = False

    def left_m(self, here: Place) -> float:
        """To its end: of an arc all of it."""
        if self.is_arc:
            return self.long_m
        return (self.to[0] - here[0]) * math.sin(self.to_rad) + (self.to[1] - here[1]) * math.cos(self.to_rad)

    def corner_rad(self, after: "SurveyLeg") -> float:
        return abs(wrap(after.begin_rad - self.to_rad))


class SailedLines(NamedTuple):
    """What the boat takes for lines and turns, in a calm."""

    wanted: LinesWanted
    ahead_m: float  # no piece is left earlier, at a corner
    power_w: float  # on lines, from the batteries
    ends: Taken = NOTHING  # beginning from rest, and stopping at the end
    turn: Taken = NOTHING  # from line to line; of a boat that steers, an arc
    sharp: SharpTurns | None = None  # None: not asked for

    def summed(self, pieces: Sequence[SurveyLeg]) -> Taken:
        """Of a whole way. The boat leaves a piece early for the next one (`wheel_over_m`), a short one before she has come to
        it."""
        total, here, before = self.ends, pieces[0].begin, pieces[0]
        for leg, after in zip_longest(pieces, pieces[1:]):
            left_m, early_m = leg.left_m(here), self._early_m(leg, after) if after is not None else 0.0
            if after is not None and left_m <= early_m:
                continue
            total += self.along(left_m - early_m, leg.is_slow) + (self._corner(before, leg) if before is not leg else NOTHING)
            if leg.is_arc:
                total += self.turn
            before, here = leg, towards(leg.to, leg.begin, early_m) if early_m else leg.to
        return total

    def along(self, long_m: float, is_slow: bool = False) -> Taken:
        """Of a way straight ahead."""
        slow_w = self.sharp.slow_w if self.sharp is not None else 0.0
        takes_s = long_m / self._speed_mps(is_slow)
        return Taken(takes_s, takes_s * (slow_w if is_slow else self.power_w))

    def _speed_mps(self, is_slow: bool) -> float:
        return SLOWLY * self.wanted.speed_mps if is_slow else self.wanted.speed_mps

    def _early_m(self, leg: SurveyLeg, after: SurveyLeg) -> float:
        return self._leaves_m(leg.corner_rad(after), leg.is_slow)

    def _leaves_m(self, corner_rad: float, is_slow: bool) -> float:
        return wheel_over_m(corner_rad, self._speed_mps(is_slow), self.ahead_m)

    def _cut(self, corner_rad: float, is_slow: bool, is_slow_behind: bool) -> Taken:
        """The way along both pieces that a corner leaves out."""
        early_m = self._leaves_m(corner_rad, is_slow)
        return self.along(early_m, is_slow) - self.along(early_m * math.cos(corner_rad), is_slow_behind)

    def _corner(self, before: SurveyLeg, leg: SurveyLeg) -> Taken:
        """What a corner takes in place of the way that it leaves out. Two are known: one of 90 degrees, half of a turn, and one
        of 180. None takes nothing, and the others lie on the parabola of these. Of a boat that steers the one of 180 degrees is
        known, and the parabola is flat at its beginning."""
        corner_rad = before.corner_rad(leg)
        if corner_rad <= CORNER_RAD:
            return NOTHING
        sharp, part = self.sharp or SharpTurns(self.turn), corner_rad / (0.5 * math.pi)
        back = fast_back = sharp.back + self._cut(math.pi, False, False)
        if leg.is_slow:
            back = sharp.slow_back + self._cut(math.pi, True, True)
        elif before.is_slow:
            back = sharp.faster + self._cut(math.pi, True, False)
        right = self.turn * 0.5 + self._cut(0.5 * math.pi, False, False)
        straight = NOTHING if self.wanted.radius_m else right * 2.0 - fast_back * 0.5
        return straight * part + (back - straight * 2.0) * (0.25 * part * part)


def legs(plan: SurveyPlan) -> list[SurveyLeg]:
    """The way of a plan as it is sailed: where the boat turns on the spot from stop to stop."""
    if plan.wanted.radius_m:
        return _steered(plan)
    places, found = stops(plan), list[SurveyLeg]()
    slow = slow_ways(plan, places)
    for number, ((a, _), (b, line)) in enumerate(pairwise(places), 1):
        heading_rad = math.atan2(b[0] - a[0], b[1] - a[1])
        found.append(SurveyLeg(a, b, heading_rad, heading_rad, math.dist(a, b), line, number in slow))
    return found


def _steered(plan: SurveyPlan) -> list[SurveyLeg]:
    found, here = list[SurveyLeg](), plan.begin
    for bend, line in plan.way:
        begin_rad = math.atan2(bend.to[0] - here[0], bend.to[1] - here[1])
        if bend.centre is not None:
            side_rad = math.copysign(0.5 * math.pi, bend.turn_rad)
            begin_rad = math.atan2(here[0] - bend.centre[0], here[1] - bend.centre[1]) + side_rad
        long_m, number = bend.long_m or math.dist(here, bend.to), 0 if line is None else line + 1
        found.append(
            SurveyLeg(here, bend.to, begin_rad, begin_rad + bend.turn_rad, long_m, number, is_arc=bend.centre is not None)
        )
        here = bend.to
    return found


def foretold(settings: config.Vehicle, plan: SurveyPlan) -> tuple[float, float | None]:
    """The time of a survey, s, and its energy in usual weather, Wh, by lines that the simulated boat sails. Where she does
    not: by speed and turns, and None."""
    pieces, least_rad = legs(plan), CORNER_RAD if plan.wanted.radius_m else SHARP_RAD
    is_sharp = any(a.is_slow or a.corner_rad(b) > least_rad for a, b in pairwise(pieces))
    try:
        its = sailed(settings, plan.wanted, is_sharp).summed(pieces)
    except DelfimError:  # this boat's devices are not simulated, or it is no boat for lines
        return plan.time_s, None
    return its.s, WEATHER * its.j / 3600.0


def sailed(settings: config.Vehicle, wanted: LinesWanted, is_sharp: bool) -> SailedLines:
    """The boat on lines of its own, without fence, wind and current; `is_sharp`: and on sharp corners, too. It takes half a
    second of a processor, of a boat that steers two. Raises DelfimError where it does not come to their end."""
    plan = _plan(wanted)
    calm = {"sea": Sea(), "sea_bed": SimulatedBed(), "position_noise_m": 0.02, "heading_noise_deg": 0.1}
    latitude_deg, longitude_deg = in_degrees(plan.ground.at, *plan.begin)
    here = msgspec.structs.replace(settings.of(Simulation), latitude_deg=latitude_deg, longitude_deg=longitude_deg, **calm)
    boat = msgspec.structs.replace(settings, simulation=here, fence=config.FenceTable())
    run = Lockstep(boat, 1, lambda clock: NoLog())
    try:
        return _measured(run, plan, settings.control.path.lookahead_m, is_sharp)
    finally:
        run.close()


def _plan(wanted: LinesWanted) -> SurveyPlan:
    spacing_m, lines = min(max(wanted.spacing_m, LEAST_M), MOST_M), STEERED_LINES if wanted.radius_m else LINES
    area = MultiPolygon([box(0.0, 0.0, lines * spacing_m, LONG_M)])
    ground = Ground(origin(*map(math.radians, PLACE)), area, MultiPolygon())
    alike = LinesWanted(spacing_m, wanted.speed_mps, heading_deg=0.0, run_in_m=wanted.run_in_m, radius_m=wanted.radius_m)
    return planned(ground, alike, config.Zones())


def _with_back(plan: SurveyPlan, back_m: Sequence[float]) -> Mission:
    """The lines, and then to and fro on the last one."""
    its, (begin, _), end = mission(plan, "lines"), plan.lines[-1], plan.way[-1].bend.to
    long_m, speed_mps = math.dist(begin, end), plan.wanted.speed_mps
    places = [in_degrees(plan.ground.at, *towards(begin, end, long_m + far_m)) for far_m in back_m]
    if plan.wanted.radius_m:
        pieces = [PathPoint(latitude_deg=n, longitude_deg=e, speed_mps=speed_mps) for n, e in places]
        return msgspec.structs.replace(its, path=(*its.path, *pieces))
    speeds = [SLOWLY * speed_mps if number in SLOW else speed_mps for number in range(len(places))]
    ways = [Waypoint(latitude_deg=n, longitude_deg=e, speed_mps=v) for (n, e), v in zip(places, speeds, strict=True)]
    return msgspec.structs.replace(its, waypoint=(*its.waypoint, *ways))


def _measured(run: Lockstep, plan: SurveyPlan, ahead_m: float, is_sharp: bool) -> SailedLines:
    """Each turn is measured from the middle of the piece before it to the middle of the one behind."""
    back_m = () if not is_sharp else BACK_STEERED_M if plan.wanted.radius_m else BACK_M
    lengths_m = [leg.long_m for leg in legs(plan)] + [abs(b - a) for a, b in pairwise((0.0, *back_m))]
    middles, ends = _passed(run, canonical(_with_back(plan, back_m)), lengths_m)
    lines = [number for number, leg in enumerate(legs(plan)) if leg.line]
    steady = [ends[number] - middles[number] for number in lines]
    told = SailedLines(plan.wanted, ahead_m, sum(each.j for each in steady) / sum(each.s for each in steady))
    first, last, behind = lines[0], lines[-1], len(lengths_m) - len(back_m)

    def beyond(a: int, b: int) -> Taken:
        """From the middle of a piece to the middle of another one, beyond their length."""
        return middles[b] - middles[a] - told.along(sum(lengths_m[a + 1 : b]) + 0.5 * (lengths_m[a] + lengths_m[b]))

    begin = middles[first] - told.along(sum(lengths_m[:first]) + 0.5 * lengths_m[first])
    rest = len(lengths_m) - 1 if back_m else last
    stop = ends[-1] - middles[rest] - told.along(0.5 * lengths_m[rest] + sum(lengths_m[rest + 1 :]))
    turns = sum(leg.is_arc for leg in legs(plan)[first:last]) or len(lines) - 1
    told = told._replace(ends=begin + stop, turn=beyond(first, last) * (1.0 / turns))
    if not back_m:
        return told
    back = beyond(last, behind)
    if plan.wanted.radius_m:
        return told._replace(sharp=SharpTurns(back))
    slow_w = (its := ends[behind + SLOW[1]] - middles[behind + SLOW[1]]).j / its.s
    told = told._replace(sharp=SharpTurns(back, slow_w))

    def slowly(long_m: float) -> Taken:
        return told.along(long_m, is_slow=True) - told.along(long_m)

    there_m, back_again_m = lengths_m[behind + SLOW[0]], 0.5 * lengths_m[behind + SLOW[1]]
    slow_back = beyond(behind, behind + SLOW[1]) - slowly(there_m + back_again_m)
    return told._replace(sharp=SharpTurns(back, slow_w, slow_back, beyond(behind + SLOW[1], rest) - slowly(back_again_m)))


def _passed(run: Lockstep, its: str, lengths_m: Sequence[float]) -> tuple[list[Taken], list[Taken]]:
    """Sail a mission, of pieces so long: what it took to the middle of each piece, and to its end."""
    if why := run.command(console.LoadMission(its)):
        raise DelfimError(why)
    never, begun_s, before_s, joules, state = Taken(math.nan, math.nan), math.nan, 0.0, 0.0, run.state
    middles, ends = [never] * len(lengths_m), [never] * len(lengths_m)
    for _ in run.cycles(UNTIL_S):
        now_s = run.elapsed_s
        if math.isnan(begun_s):
            begun_s, before_s = now_s if run.command(console.SetMode("path")) is None else math.nan, now_s
            continue
        joules += sum(each.voltage_v * each.current_a for each in run.nodes.model.drives.values()) * (now_s - before_s)
        before_s, here, piece, left_m = now_s, Taken(now_s - begun_s, joules), state.reference.leg, state.reference.distance_m
        if state.mode is not Mode.PATH:
            break
        ends[piece] = here
        if middles[piece] is never and left_m is not None and left_m <= 0.5 * lengths_m[piece]:
            middles[piece] = here
    if not state.reason.startswith("path done"):
        raise DelfimError(f"the simulated boat did not sail a few lines to their end: {state.reason}")
    return middles, [*ends[:-1], here]
