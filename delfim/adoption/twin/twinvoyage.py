"""A voyage by which gains are judged: two turns, two lines with the way between them, a while of holding. The whole program of
the boat sails it, in lock step; what counts is where she truly was.
"""

import math
from collections import deque
from collections.abc import Callable, Sequence
from statistics import fmean
from typing import Final, NamedTuple

import msgspec

from delfim import config
from delfim.base.geodesy import Origin, from_plane, to_plane, wrap
from delfim.base.modes import Mode
from delfim.simulator.lockstep import Lockstep, uncollected
from delfim.simulator.tables import Sea, SimulatedTraffic, Simulation
from delfim.vehicle import console

WAY_S: Final = 25.0  # until she sails steadily, after SETTLE_S for her receivers
SETTLE_S: Final = 4.0
TURNS: Final = ((90.0, 30.0), (-20.0, 20.0))  # deg, and seconds for it
HOLD_S: Final = 60.0
LINE_M, LINE_LENGTHS = 30.0, 12.0  # of a line, at least
APART_M, APART_LENGTHS = 10.0, 5.0
AHEAD_M: Final = 8.0  # where the first line begins
NEAR_DEG: Final = 5.0  # of a heading that she has settled on
OVER_DEG, SETTLED_S = 3.0, 9.0  # of a turn of 90 degrees: what is beyond costs more, for the true boat is not quite her twin
MEAN_S: Final = 1.0  # of the headings that a boat tells: a compass is not quiet
STEADY: Final = 0.25  # of a line, after which she is to be on it
ON_LINE_M, ALONG_DEG = 1.0, 15.0  # from a line, and across it, within which she is on it
OFF_M: Final = 20.0  # of a path that was never sailed
UNFINISHED: Final = 20.0  # the cost of lines that are not sailed to their end
FACTOR: Final = 4.0  # times their length at cruising speed is what the lines may take


class VoyageTurn(NamedTuple):
    """A turn, in truth and as the boat is told."""

    over_deg: float  # beyond the new heading
    settled_s: float  # from the order until she stays within NEAR_DEG of it
    told_over_deg: float
    told_s: float


class TwinVoyage(NamedTuple):
    """How she sailed."""

    over_deg: float  # beyond a new heading, the worst of the turns
    settled_s: float  # from an order until she stays within NEAR_DEG of the heading, both turns together
    quarter: VoyageTurn  # that of 90 degrees alone
    path_m: float  # rms off the lines
    hold_m: float  # rms from the point
    speed_off: float  # rms of the speed asked for on the lines, as a part of it
    travel_per_s: float  # of the motors' commands, full ones a second
    is_done: bool  # the lines were sailed to their end
    turn_s: float  # what the way from line to line took beyond its length at cruising speed
    run_in_m: float  # of a line, until she was on it

    @property
    def cost(self) -> float:
        """What counts, in one number: half a metre, a tenth of the speed, some degrees and seconds, and tired motors weigh
        about the same."""
        weighed = self.path_m / 0.4 + self.speed_off / 0.1 + self.over_deg / 8.0 + self.settled_s / 15.0
        weighed += self.travel_per_s / 0.5
        beyond = max(self.quarter.over_deg - OVER_DEG, 0.0) + max(self.quarter.settled_s - SETTLED_S, 0.0)
        return weighed + 0.5 * beyond + (0.0 if self.is_done else UNFINISHED)


def twin_of(vehicle: config.Vehicle, sea: Sea, later: float = 1.0) -> config.Vehicle:
    """The vehicle's file for a voyage in simulation, in open water without others, with its motors so many times as late."""
    replace, there = msgspec.structs.replace, vehicle.of(Simulation)
    alone = replace(there, sea=sea, traffic=SimulatedTraffic(), external="")
    fence = config.FenceTable(reaction_s=vehicle.fence.reaction_s, deceleration_mps2=vehicle.fence.deceleration_mps2)
    rows = tuple(replace(row, delay_s=min(later * row.delay_s, 2.0)) for row in vehicle.thrusters)
    return replace(vehicle, simulation=alone, fence=fence, thrusters=rows)


@uncollected()
def sailed(run: Lockstep, cruise_mps: float) -> TwinVoyage:
    """Sail it with the boat of a run that has just begun, at this speed."""
    return _Sailing(run, cruise_mps).whole()


def mission_text(plane: Origin, places: Sequence[tuple[float, float]], speed_mps: float) -> str:
    """A mission of waypoints, m north and east on a plane, as a file has it."""
    rows = ['version = 1\nname = "Lines"\n']
    for north_m, east_m in places:
        latitude, longitude = (math.degrees(each) for each in from_plane(plane, north_m, east_m))
        place = f"latitude_deg = {latitude:.9f}\nlongitude_deg = {longitude:.9f}"
        rows.append(f"[[waypoint]]\n{place}\nspeed_mps = {speed_mps:.3f}\n")
    return "\n".join(rows)


class _Sailing:
    """A voyage under way: a run, and what was seen of it."""

    def __init__(self, run: Lockstep, cruise_mps: float) -> None:
        self._run, self._model, self._cruise_mps = run, run.nodes.model, cruise_mps
        self._travel, self._was = 0.0, run.state.actuation.thrust
        self._cycles(SETTLE_S)

    def whole(self) -> TwinVoyage:
        began_s, goal_rad = self._run.elapsed_s, self._model.heading_rad
        self._turned(goal_rad, WAY_S)
        turns = list[VoyageTurn]()
        for turn_deg, seconds in TURNS:
            goal_rad += math.radians(turn_deg)
            turns.append(self._turned(goal_rad, seconds, math.copysign(1.0, turn_deg)))
        path_m, speed_off, is_done, turn_s, run_in_m = self._lines()
        hold_m = self._held()
        travel_per_s = self._travel / (self._run.elapsed_s - began_s)
        both = max(each.over_deg for each in turns), sum(each.settled_s for each in turns)
        return TwinVoyage(*both, turns[0], path_m, hold_m, speed_off, travel_per_s, is_done, turn_s, run_in_m)

    def _cycles(self, seconds: float, look: Callable[[], object] = lambda: None, until: Mode | None = None) -> None:
        """Let this time pass, or what is left until the boat is no longer in a mode."""
        for state in self._run.cycles(seconds):
            sent = state.actuation.thrust
            self._travel += sum(abs(now - was) for now, was in zip(sent, self._was, strict=True))
            self._was = sent
            look()
            if until is not None and state.mode is not until:
                return

    def _turned(self, goal_rad: float, seconds: float, way: float = 1.0) -> VoyageTurn:
        """Order a heading, and see how she turns to it."""
        self._run.command(console.Heading(math.degrees(wrap(goal_rad)), self._cruise_mps))
        began_s, over_deg, settled_s = self._run.elapsed_s, [0.0, 0.0], [0.0, 0.0]
        last = deque[float](maxlen=round(MEAN_S * self._run.settings.navigation.rate_hz))

        def look() -> None:
            last.append(way * math.degrees(wrap(self._run.state.motion.heading_rad - goal_rad)))
            true_deg = way * math.degrees(wrap(self._model.heading_rad - goal_rad))
            for which, off_deg in enumerate((true_deg, fmean(last))):
                over_deg[which] = max(over_deg[which], off_deg if off_deg < 90.0 else 0.0)
                if abs(off_deg) > NEAR_DEG:
                    settled_s[which] = self._run.elapsed_s - began_s

        self._cycles(seconds, look)
        return VoyageTurn(over_deg[0], settled_s[0], over_deg[1], settled_s[1])

    def _lines(self) -> tuple[float, float, bool, float, float]:
        """Sail two lines side by side. Returns the rms off them, m, and of the speed, as a part of it, whether they were sailed
        to their end, the time that the way between them took beyond its length, s, and the run-in of the second, m."""
        model, length_m = self._model, self._run.settings.boat.length_m
        long_m, apart_m = max(LINE_M, LINE_LENGTHS * length_m), max(APART_M, APART_LENGTHS * length_m)
        ahead = math.cos(model.heading_rad), math.sin(model.heading_rad)
        zero = model.north_m + AHEAD_M * ahead[0], model.east_m + AHEAD_M * ahead[1]
        corners = (0.0, 0.0), (long_m, 0.0), (long_m, apart_m), (0.0, apart_m)
        places = [(zero[0] + x * ahead[0] - y * ahead[1], zero[1] + x * ahead[1] + y * ahead[0]) for x, y in corners]
        began_s, off_m, off_mps = self._run.elapsed_s, list[float](), list[float]()
        left_s = back_s = run_in_m = 0.0

        def look() -> None:
            nonlocal left_s, back_s, run_in_m
            leg, now_s = self._run.state.reference.leg, self._run.elapsed_s
            if leg not in (1, 3):
                return
            north, east = model.north_m - zero[0], model.east_m - zero[1]
            x, y = north * ahead[0] + east * ahead[1], east * ahead[0] - north * ahead[1]
            gone_m, side_m = (x, y) if leg == 1 else (long_m - x, y - apart_m)
            if leg == 1 and gone_m <= (1.0 - STEADY) * long_m:
                left_s = now_s
            if leg == 3 and gone_m <= STEADY * long_m:
                back_s = now_s
            if leg == 3 and not run_in_m and abs(side_m) < ON_LINE_M:
                back_rad = wrap(model.heading_rad - math.atan2(-ahead[1], -ahead[0]))
                run_in_m = max(gone_m, 0.1) if abs(back_rad) < math.radians(ALONG_DEG) else 0.0
            if STEADY * long_m < gone_m < (1.0 - STEADY) * long_m:
                off_m.append(side_m)
                made_mps = model.north_mps * ahead[0] + model.east_mps * ahead[1]
                off_mps.append(abs(made_mps) / self._cruise_mps - 1.0)

        limit_s = FACTOR * (2.0 * long_m + apart_m + AHEAD_M) / self._cruise_mps
        lines = console.LoadMission(mission_text(model.origin, places, self._cruise_mps))
        if self._run.command(lines) is None and self._run.command(console.Play()) is None:
            self._cycles(limit_s, look, Mode.PLAY)
        is_done = self._run.state.mode is not Mode.PLAY and self._run.elapsed_s - began_s < limit_s and back_s > 0.0
        turn_s = back_s - left_s - (2.0 * STEADY * long_m + apart_m) / self._cruise_mps if is_done else 0.0
        return _rms(off_m), _rms(off_mps), is_done, turn_s, run_in_m

    def _held(self) -> float:
        """Hold. Returns the rms distance from the point, m."""
        if self._run.command(console.SetMode("hold")) is not None or self._run.state.origin is None:
            return OFF_M
        far_m = list[float]()

        def look() -> None:
            there, plane = self._run.state.reference, self._run.state.origin
            if there.north_m is not None and there.east_m is not None and plane is not None:
                point = to_plane(self._model.origin, *from_plane(plane, there.north_m, there.east_m))
                far_m.append(math.dist(point, (self._model.north_m, self._model.east_m)))

        self._cycles(HOLD_S, look)
        return _rms(far_m)


def _rms(values: list[float]) -> float:
    """The root of the mean of squares; of nothing, OFF_M."""
    return math.sqrt(sum(each * each for each in values) / len(values)) if values else OFF_M
