"""Surveys sailed in lock step: how well lines are kept, and whether time and energy are as foretold.

python -m bench.survey following [SEEDS]    makes the table of docs/survey.md, "How well lines are kept"
python -m bench.survey estimate [AREAS]     and of "Time and energy"

True places against the lines as planned. Wind of 6 m/s and a current of 0.3 m/s come from anywhere, by the seed.
"""

import math
import sys
from collections.abc import Iterator
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
from delfim.survey.linefigures import LineFigures, figures
from delfim.survey.planning import SurveyPlan, mission, planned, wanted_of
from delfim.survey.trialsail import sailed
from delfim.vehicle import console
from delfim.vehicle.plans.mission import canonical
from delfim.vehicle.state import NoLog

BOATS = "../delfimx", "otter", "blueboat", "skiff", "heron", "wam-v"
FOLLOWED = BOATS[:4]
PLACE = 38.6907, -9.2153
LINES, LONG_M, SPACING_M = 10, 150.0, 10.0
UNTIL_S = 4 * 3600.0


class Voyage(NamedTuple):
    took_s: float
    energy_wh: float
    lines: list[LineFigures]


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
    return Voyage(before_s - begun_s, joules / 3600.0, figures(lines, track))


def rectangle(width_m: float, long_m: float) -> Ground:
    return Ground(origin(*map(math.radians, PLACE)), MultiPolygon([box(0.0, 0.0, width_m, long_m)]), MultiPolygon())


def began(settings: config.Vehicle, ground: Ground, **asked: object) -> tuple[SurveyPlan, Place]:
    plan = planned(ground, wanted_of(settings, **asked), config.Zones())
    return plan, in_degrees(ground.at, *plan.begin)


def following(seeds: int) -> None:
    print("| boat | receiver | wind, m/s | RMS, m | 95 %, m: all, worst line | least of a line sailed |")
    print("|---|---|---|---|---|---|")
    for name in FOLLOWED:
        for noise_m, receiver in ((0.3, "0.3 m"), (0.02, "RTK")):
            for wind_mps, current_mps in ((0.0, 0.3), (6.0, 0.3)):
                rows = list(followed(name, noise_m, wind_mps, current_mps, seeds))
                square = math.sqrt(mean(each.rms_m**2 for each in rows))
                nearest = sorted(each.p95_m for each in rows)
                least = 100.0 * min(each.sailed for each in rows)
                told = f"{mean(nearest):.2f}, {nearest[-1]:.2f} | {least:.1f} %"
                print(f"| {name.removeprefix('../')} | {receiver} | {wind_mps:g} | {square:.2f} | {told} |", flush=True)


def followed(name: str, noise_m: float, wind_mps: float, current_mps: float, seeds: int) -> Iterator[LineFigures]:
    for seed in range(1, seeds + 1):
        settings = load(name, PLACE)
        plan, at = began(settings, rectangle(LINES * SPACING_M, LONG_M), spacing_m=SPACING_M, heading_deg=0.0)
        noise = f"simulation.position_noise_m={noise_m}"
        yield from voyage(load(name, at, sea(seed, wind_mps, current_mps), noise), plan, seed).lines


def estimate(areas: int) -> None:
    print("| boat | time, sailed by foretold: least, mean, most | energy, likewise |")
    print("|---|---|---|")
    for name in BOATS:
        times, energies = list[float](), list[float]()
        for seed in range(1, areas + 1):
            chance = Random(f"area {seed}")
            ground = rectangle(chance.uniform(60.0, 200.0), chance.uniform(60.0, 200.0))
            settings = load(name, PLACE)
            plan, at = began(settings, ground, spacing_m=chance.choice((8.0, 12.0, 20.0)))
            told = sailed(settings, plan.wanted)
            plan = plan._replace(wanted=plan.wanted._replace(turn_s=told.turn_s))
            seen = voyage(load(name, at, sea(seed, 4.0, 0.2)), plan, seed)
            times.append(seen.took_s / plan.time_s)
            energies.append(seen.energy_wh / told.energy_wh(plan.time_s))
        told_of = [f"{min(each):.3f}, {mean(each):.3f}, {max(each):.3f}" for each in (times, energies)]
        print(f"| {name.removeprefix('../')} | {' | '.join(told_of)} |", flush=True)


if __name__ == "__main__":
    what, *count = sys.argv[1:]
    {"following": following, "estimate": estimate}[what](int(count[0]) if count else 4)
