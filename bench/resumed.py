"""Surveys cut on their way, and gone on with, in lock step: how much is covered by true places, and how long it takes.

`python -m bench.resumed CUTS`: the basin of `etc/areas`, lines 10 m apart, with wind and current; cut at so many places.
"""

import math
import sys
from pathlib import Path
from random import Random
from typing import Final

from shapely.geometry import LineString

from delfim import config
from delfim.base.geodesy import to_plane
from delfim.simulator.lockstep import Lockstep
from delfim.survey.areafile import read_area
from delfim.survey.ground import Place, laid
from delfim.survey.planning import SurveyPlan, mission, plan_of, planned, wanted_of
from delfim.survey.progress import least_m, left, sailed
from delfim.vehicle import console
from delfim.vehicle.plans.mission import canonical
from delfim.vehicle.state import NoLog

ROOT: Final = Path(__file__).parents[1]
SEA: Final = "simulation.sea={current_mps=0.2, current_to_deg=70.0, wind_mps=4.0, wind_from_deg=300.0}"
SPACING_M: Final = 10.0
UNTIL_S: Final = 7200.0


def sail(plan: SurveyPlan, here: list[str], until_s: float) -> tuple[list[Place], float, list[str]]:
    """True places, one a second, the time, and where the boat is then, as overrides."""
    run, places, was_s = (
        Lockstep(config.load(ROOT / "etc/delfimx.toml", [SEA, *here]), 1, lambda clock: NoLog()),
        list[Place](),
        0.0,
    )
    why = run.command(console.LoadMission(canonical(mission(plan, "basin"))))
    assert why is None, why
    begun_s, model = math.inf, run.nodes.model
    for state in run.cycles(UNTIL_S):
        if math.isinf(begun_s):
            begun_s = run.elapsed_s if run.command(console.SetMode("path")) is None else math.inf
            continue
        if run.elapsed_s - was_s >= 1.0:
            was_s = run.elapsed_s
            places.append(to_plane(plan.ground.at, model.latitude_rad, model.longitude_rad)[::-1])
        if state.mode.name != "PATH" or run.elapsed_s - begun_s > until_s:
            break
    at = (("latitude", model.latitude_rad), ("longitude", model.longitude_rad))
    took_s = run.elapsed_s - begun_s
    run.close()
    return places, took_s, [f"simulation.{name}_deg={math.degrees(value):.8f}" for name, value in at]


def covered(plan: SurveyPlan, places: list[list[Place]]) -> float:
    """The part of what may be sailed that lies within half of the spacing of the way."""
    near = LineString(places[0]).buffer(SPACING_M / 2.0)
    for more in places[1:]:
        near = near.union(LineString(more).buffer(SPACING_M / 2.0))
    return float(near.intersection(plan.free).area / plan.free.area)


def main(cuts: int) -> None:
    settings = config.load(ROOT / "etc/delfimx.toml")
    wanted = wanted_of(settings, spacing_m=SPACING_M)
    plan = planned(laid(read_area(ROOT / "etc/areas/basin.geojson")), wanted, settings.fence)
    places, whole_s, _ = sail(plan, [], math.inf)
    whole = covered(plan, [places])
    print(f"at once: {whole_s:.0f} s, {100.0 * whole:.2f} % covered")
    for number in range(cuts):
        part = Random(f"cut {number}").uniform(0.1, 0.9)
        first, first_s, here = sail(plan, [], part * whole_s)
        done = sailed(plan.lines, first, SPACING_M)
        gaps = [
            gap
            for line, its in zip(plan.lines, done, strict=True)
            for gap in left(line, its, least_m(SPACING_M), wanted.cut.joined_m)
        ]
        rest = plan_of(plan.ground, wanted, settings.fence, plan.heading_deg, gaps, [], first[-1])
        second, second_s, _ = sail(rest, here, math.inf)
        all_s, both = first_s + second_s, covered(plan, [first, second])
        print(f"cut at {part:.2f}: {all_s / whole_s:.3f} of the time, {100.0 * (both - whole):+.2f} % covered", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]))
