"""Whether boats that go home for their energy come home, and with how much.

    python -m bench.energy [SEEDS [BOAT [CAPACITY_WH]]]

A boat sails drawn places, out and about, in a drawn sea: wind to 8 m/s, waves, a current to 0.4 m/s that turns by up to 120
degrees an hour. Its batteries last for some 40 to 60 minutes. Prints how many came home with a tenth of the capacity at least,
how many had gone home with more than a tenth left beside the reserve, and by how much the prediction of the way was off.
"""

import math
import random
import sys
from statistics import quantiles

from delfim import config
from delfim.base.geodesy import from_plane
from delfim.base.modes import Mode
from delfim.parts.energy.table import EnergyTable
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.state import NoLog, State

LOOK_S = 60.0
LIMIT_S = 4.0 * 3600.0


def _settings(boat: str, draw: random.Random, capacity_wh: float) -> config.Vehicle:
    sea = {
        "current_mps": draw.uniform(0.0, 0.4),
        "current_to_deg": draw.uniform(0.0, 360.0),
        "wind_mps": draw.uniform(0.0, 8.0),
        "wind_from_deg": draw.uniform(0.0, 360.0),
    }
    told = ['sensors.names=["sysstat"]'] if boat.endswith("delfimx.toml") else []
    quiet = [f'failsafe.{name}.action="warn"' for name in ("battery_low", "battery_critical", "console_silent")]
    sails = [f"simulation.sea.{key}={value:.3f}" for key, value in sea.items()]
    return config.load(boat, [*told, *quiet, *sails, f"energy.capacity_wh={capacity_wh:.1f}"])


def sailed(boat: str, seed: int, capacity_wh: float) -> tuple[float, float, float, list[float]]:
    """The charge at home, what the boat thought it would be, the reserve, 0..1, and the errors of the prediction."""
    draw = random.Random(seed)
    settings = _settings(boat, draw, capacity_wh)
    run = Lockstep(settings, seed, lambda clock: NoLog())
    turn_radps = math.radians(draw.uniform(-120.0, 120.0)) / 3600.0
    state, model = run.state, run.nodes.model
    next_s, going_home_s, spent = 0.0, math.inf, list[tuple[float, float]]()
    foreseen = 0.0
    for _ in run.cycles(LIMIT_S):
        c, s = math.cos(turn_radps * 0.2), math.sin(turn_radps * 0.2)
        n, e = model.current_north_mps, model.current_east_mps
        model.current_north_mps, model.current_east_mps = n * c - e * s, n * s + e * c
        charge = min(drive.charge for drive in model.drives.values())
        if state.origin is None or run.elapsed_s < 5.0:
            continue
        is_going_home = state.mode is Mode.HOME
        if is_going_home and going_home_s == math.inf:
            going_home_s = run.elapsed_s
            foreseen = charge - _home(state) / capacity_wh
        if going_home_s < math.inf and not is_going_home:
            break
        if going_home_s < math.inf and run.elapsed_s >= next_s:
            next_s = run.elapsed_s + LOOK_S
            spent.append((charge, _home(state) / capacity_wh))
        if not is_going_home and state.mode is not Mode.GOTO and not (state.mode is Mode.HOLD and "home in" in state.reason):
            far_m, bearing = draw.uniform(150.0, 500.0), draw.uniform(0.0, 2.0 * math.pi)
            latitude, longitude = from_plane(
                state.origin, model.north_m + far_m * math.cos(bearing), model.east_m + far_m * math.sin(bearing)
            )
            speed = draw.choice([1.0, 1.2, 1.5]) * settings.control.speed.cruise_mps / 1.5
            run.order(console.Goto(math.degrees(latitude), math.degrees(longitude), speed_mps=speed), "bench")
        elif run.elapsed_s % 5.0 < 0.2:
            run.order(console.Alive(), "bench")
    end = min(drive.charge for drive in model.drives.values())
    errors = [(home - (charge - end)) / (charge - end) for charge, home in spent if charge - end > 0.02]
    run.close()
    return end, foreseen, settings.of(EnergyTable).reserve, errors


def _home(state: State) -> float:
    """The way home, Wh."""
    return (state.energy and state.energy.home_wh) or 0.0


def main(seeds: int, boat: str, capacity_wh: float) -> None:
    rows = []
    for seed in range(1, seeds + 1):
        rows.append(sailed(boat, seed, capacity_wh))
        end, foreseen, reserve, errors = rows[-1]
        first = f"{errors[0]:+.0%}" if errors else "-"
        print(f"{seed}: home with {end:.1%}, foreseen {foreseen:.1%}; at the turn {first}", file=sys.stderr, flush=True)
    ends, reserve = [row[0] for row in rows], rows[0][2]
    errors = sorted(row[3][0] for row in rows if row[3])
    print(f"{seeds} seas: {sum(end >= 0.10 for end in ends)} home with a tenth or more, least {min(ends):.1%}")
    print(f"cut short needlessly (more than {reserve + 0.1:.0%} left): {sum(end > reserve + 0.1 for end in ends)}")
    if len(errors) > 1:
        cut = quantiles(errors, n=20)
        print(f"prediction at the turn: median {errors[len(errors) // 2]:+.1%}, 90 % within {cut[0]:+.1%} to {cut[-1]:+.1%}")


if __name__ == "__main__":
    seeds, boat, capacity = [*sys.argv[1:], *("100", "etc/delfimx.toml", "800")[len(sys.argv) - 1 :]]
    main(int(seeds), boat, float(capacity))
