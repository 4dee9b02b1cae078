"""Surveys sailed in lock step: how well lines are kept, and whether time and energy are as foretold.

python -m bench.survey following [SEAS [FIRST [BOAT...]]]    makes the table of docs/survey.md, "How well lines are kept"
python -m bench.survey estimate [AREAS [FIRST [BOAT...]]]    and of "Time and energy": rectangles
python -m bench.survey holes [AREAS [FIRST [BOAT...]]]       drawn areas with holes, in other weather

True places against the lines as planned. Wind and current come from anywhere, by the seed; FIRST is the first seed. A BOAT is a
file of etc/boats.
"""

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from random import Random
from statistics import mean
from typing import NamedTuple

from shapely.geometry import MultiPolygon, box

from delfim import config
from delfim.base.errors import DelfimError
from delfim.base.geodesy import origin, to_plane
from delfim.base.modes import Mode
from delfim.simulator.lockstep import Lockstep
from delfim.survey.ground import Ground, Place, in_degrees
from delfim.survey.linefigures import LineFigures, beside, figures
from delfim.survey.planning import SurveyPlan, mission, planned, wanted_of
from delfim.survey.trialsail import foretold
from delfim.vehicle import console
from delfim.vehicle.plans.mission import canonical
from delfim.vehicle.state import NoLog
from tests.survey.drawn import drawn

BOATS = "../delfimx", "otter", "blueboat", "skiff", "heron", "wam-v"
FOLLOWED = BOATS[:4]
PLACE = 38.6907, -9.2153
LINES, LONG_M, SPACING_M = 10, 150.0, 10.0
UNTIL_S = 4 * 3600.0


class Voyage(NamedTuple):
    took_s: float
    energy_wh: float
    lines: list[LineFigures]
    p95_m: float  # 95 % of all places on lines are nearer to theirs


class Area(NamedTuple):
    seed: int
    ground: Ground
    spacing_m: float
    wind_mps: float
    current_mps: float


def sea(seed: int, wind_mps: float, current_mps: float) -> str:
    chance = Random(f"sea {seed}")
    current = f"current_mps={current_mps}, current_to_deg={chance.uniform(0.0, 360.0):.1f}"
    return f"simulation.sea={{{current}, wind_mps={wind_mps}, wind_from_deg={chance.uniform(0.0, 360.0):.1f}}}"


def load(name: str, at: Place, *overrides: str) -> config.Vehicle:
    places = [f"simulation.latitude_deg={at[0]:.9f}", f"simulation.longitude_deg={at[1]:.9f}"]
    return config.load(f"etc/boats/{name}.toml", [*places, *overrides])


def voyage(settings: config.Vehicle, plan: SurveyPlan, seed: int) -> Voyage:
    """From the beginning of the way to its end. Raises DelfimError where the boat does not come there."""
    run = Lockstep(settings, seed, lambda clock: NoLog())
    if why := run.command(console.LoadMission(canonical(mission(plan, "lines")))):
        raise DelfimError(why)
    begun_s, joules, before_s, track = 0.0, 0.0, 0.0, list[tuple[int, Place]]()
    model, state = run.nodes.model, run.state
    for _ in run.cycles(UNTIL_S):
        now_s = run.elapsed_s
        if not begun_s:
            begun_s = now_s if run.command(console.SetMode("path")) is None else 0.0
            before_s = now_s
            continue
        joules += sum(each.voltage_v * each.current_a for each in model.drives.values()) * (now_s - before_s)
        before_s = now_s
        north_m, east_m = to_plane(plan.ground.at, model.latitude_rad, model.longitude_rad)
        track.append((state.reference.line, (east_m, north_m)))
        if state.mode is Mode.HOLD:
            break
    end = state.reason
    run.close()
    if end != "path done":
        raise DelfimError(f"it ended: {end}")
    lines = dict(enumerate(plan.lines, 1))
    off = sorted(abs(beside(lines[line], place)[1]) for line, place in track if line)
    return Voyage(before_s - begun_s, joules / 3600.0, figures(lines, track), off[int(0.95 * len(off))])


def rectangle(width_m: float, long_m: float) -> Ground:
    return Ground(origin(*map(math.radians, PLACE)), MultiPolygon([box(0.0, 0.0, width_m, long_m)]), MultiPolygon())


def began(settings: config.Vehicle, ground: Ground, **asked: object) -> tuple[SurveyPlan, Place]:
    plan = planned(ground, wanted_of(settings, **asked), config.Zones())
    return plan, in_degrees(ground.at, *plan.begin)


def following(seeds: range, boats: Sequence[str]) -> None:
    print("| boat | receiver | wind, m/s | RMS, m | 95 %, m: worst sea, worst line | least of a line sailed |")
    print("|---|---|---|---|---|---|")
    for name in boats or FOLLOWED:
        for noise_m, receiver in ((0.3, "0.3 m"), (0.02, "RTK")):
            for wind_mps, current_mps in ((0.0, 0.3), (6.0, 0.3)):
                seas = [followed(name, noise_m, wind_mps, current_mps, seed) for seed in seeds]
                lines = [each for sea in seas for each in sea.lines]
                square = math.sqrt(mean(each.rms_m**2 for each in lines))
                told = f"{max(sea.p95_m for sea in seas):.2f}, {max(each.p95_m for each in lines):.2f}"
                least = 100.0 * min(each.sailed for each in lines)
                print(f"| {Path(name).name} | {receiver} | {wind_mps:g} | {square:.2f} | {told} | {least:.1f} % |", flush=True)


def followed(name: str, noise_m: float, wind_mps: float, current_mps: float, seed: int) -> Voyage:
    plan, at = began(load(name, PLACE), rectangle(LINES * SPACING_M, LONG_M), spacing_m=SPACING_M, heading_deg=0.0)
    noise = f"simulation.position_noise_m={noise_m}"
    return voyage(load(name, at, sea(seed, wind_mps, current_mps), noise), plan, seed)


def rectangle_of(seed: int) -> Area:
    """In 4 m/s of wind and 0.2 m/s of current."""
    chance = Random(f"area {seed}")
    ground = rectangle(chance.uniform(60.0, 200.0), chance.uniform(60.0, 200.0))
    return Area(seed, ground, chance.choice((8.0, 12.0, 20.0)), 4.0, 0.2)


def drawn_of(seed: int) -> Area:
    """In wind to 6 m/s and current to 0.3 m/s."""
    chance, (ground, spacing_m) = Random(f"weather {seed}"), drawn(seed, (90.0, 150.0), 1.0)
    return Area(seed, ground, spacing_m, chance.uniform(0.0, 6.0), chance.uniform(0.0, 0.3))


def compared(name: str, area: Area) -> tuple[float, float]:
    """Time and energy of a voyage by those that the command foretells. Raises DelfimError where the boat does not come to its
    end."""
    settings = load(name, PLACE)
    plan, at = began(settings, area.ground, spacing_m=area.spacing_m)
    time_s, energy_wh = foretold(settings, plan)
    seen = voyage(load(name, at, sea(area.seed, area.wind_mps, area.current_mps)), plan, area.seed)
    return seen.took_s / time_s, seen.energy_wh / (energy_wh or math.nan)


def estimate(seeds: range, boats: Sequence[str]) -> None:
    _table([rectangle_of(seed) for seed in seeds], boats)


def holes(seeds: range, boats: Sequence[str]) -> None:
    _table([drawn_of(seed) for seed in seeds], boats)


def _table(areas: Sequence[Area], boats: Sequence[str]) -> None:
    print("| boat | time, sailed by foretold: least, mean, most | energy, likewise |")
    print("|---|---|---|")
    for name in boats or BOATS:
        found = list[tuple[float, float]]()
        for area in areas:
            try:
                found.append(compared(name, area))
            except DelfimError as error:
                print(f"{Path(name).name}, area {area.seed}: {error}", file=sys.stderr, flush=True)
        told_of = [f"{min(each):.3f}, {mean(each):.3f}, {max(each):.3f}" for each in zip(*found, strict=True)]
        print(f"| {Path(name).name} | {' | '.join(told_of)} |", flush=True)


if __name__ == "__main__":
    what, count, first, *names = (*sys.argv[1:], *("4", "1")[len(sys.argv) - 2 :])
    {"following": following, "estimate": estimate, "holes": holes}[what](range(int(first), int(first) + int(count)), names)
