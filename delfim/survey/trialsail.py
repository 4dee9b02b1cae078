"""A few lines sailed by the simulated boat, in lock step and a calm: what a turn takes of its time, and what it draws."""

import math
from itertools import pairwise
from typing import Final, NamedTuple

import msgspec
from shapely.geometry import MultiPolygon, box

from delfim import config
from delfim.base.errors import DelfimError
from delfim.base.geodesy import origin
from delfim.base.modes import Mode
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.tables import Sea, SimulatedBed, Simulation
from delfim.survey.ground import Ground
from delfim.survey.planning import LinesWanted, SurveyPlan, mission, planned
from delfim.vehicle import console
from delfim.vehicle.plans.mission import canonical
from delfim.vehicle.state import NoLog

WEATHER: Final = 1.04  # what boats drew in 4 m/s of wind and 0.2 m/s of current, by a calm (`bench/survey.py`)
LINES: Final = 4
LONG_M: Final = 40.0  # of each
LEAST_M, MOST_M = 2.0, 60.0  # of their spacing: beyond, a turn takes what it takes with that
UNTIL_S: Final = 1200.0
PLACE: Final = 38.6907, -9.2153  # anywhere; degrees


class SailedLines(NamedTuple):
    turn_s: float  # what a turn takes beyond its length at the speed of the lines
    power_w: float  # mean of lines and turns, from the batteries

    def energy_wh(self, time_s: float) -> float:
        """Of a survey of this time, in usual weather."""
        return WEATHER * self.power_w * time_s / 3600.0


def sailed(settings: config.Vehicle, wanted: LinesWanted) -> SailedLines:
    """The boat on lines of its own, without fence, wind and current. It takes half a second of a processor. Raises DelfimError
    where it does not come to their end."""
    plan = _plan(wanted)
    calm = {"sea": Sea(), "sea_bed": SimulatedBed(), "position_noise_m": 0.02, "heading_noise_deg": 0.1}
    here = msgspec.structs.replace(settings.of(Simulation), latitude_deg=PLACE[0], longitude_deg=PLACE[1], **calm)
    boat = msgspec.structs.replace(settings, simulation=here, fence=config.FenceTable())
    run = Lockstep(boat, 1, lambda clock: NoLog())
    try:
        return _measured(run, plan)
    finally:
        run.close()


def foretold(settings: config.Vehicle, plan: SurveyPlan) -> tuple[float, float | None]:
    """The time of a survey, s, and its energy, Wh, by lines that the simulated boat sails; by speed and turns, and None, where
    it does not."""
    try:
        told = sailed(settings, plan.wanted)
    except DelfimError:  # this boat's devices are not simulated, or it is no boat for lines
        return plan.time_s, None
    time_s = plan._replace(wanted=plan.wanted._replace(turn_s=told.turn_s)).time_s
    return time_s, told.energy_wh(time_s)


def _plan(wanted: LinesWanted) -> SurveyPlan:
    spacing_m = min(max(wanted.spacing_m, LEAST_M), MOST_M)
    area = MultiPolygon([box(0.0, 0.0, LINES * spacing_m, LONG_M)])
    ground = Ground(origin(*map(math.radians, PLACE)), area, MultiPolygon())
    alike = LinesWanted(spacing_m, wanted.speed_mps, heading_deg=0.0, run_in_m=wanted.run_in_m, radius_m=wanted.radius_m)
    return planned(ground, alike, config.Zones())


def _measured(run: Lockstep, plan: SurveyPlan) -> SailedLines:
    """From the beginning of the first line to the end of the last one."""
    if why := run.command(console.LoadMission(canonical(mission(plan, "lines")))):
        raise DelfimError(why)
    begun, from_s, to_s, joules, since_j, before_s = False, 0.0, 0.0, 0.0, 0.0, 0.0
    for _ in run.cycles(UNTIL_S):
        if not begun:
            begun = run.command(console.SetMode("path")) is None
            continue
        now_s, line = run.elapsed_s, run.state.reference.line
        joules += sum(each.voltage_v * each.current_a for each in run.nodes.model.drives.values()) * (now_s - before_s)
        before_s = now_s
        if line and not from_s:
            from_s, joules = now_s, 0.0
        if line == LINES:
            to_s, since_j = now_s, joules
        if run.state.mode is Mode.HOLD or (run.state.mode is Mode.IDLE and from_s):
            break
    if not to_s or not run.state.reason.startswith("path done"):
        raise DelfimError(f"the simulated boat did not sail {LINES} lines to their end: {run.state.reason}")
    places = [plan.begin, *(each.bend.to for each in plan.way)]
    lengths = [each.bend.long_m or math.dist(a, b) for (a, b), each in zip(pairwise(places), plan.way, strict=True)]
    numbers = [each.line for each in plan.way]
    way_m = sum(lengths[numbers.index(0) : numbers.index(LINES - 1) + 1])
    return SailedLines((to_s - from_s - way_m / plan.wanted.speed_mps) / (LINES - 1), since_j / (to_s - from_s))
