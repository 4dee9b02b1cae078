"""Whether boats that go home for their energy come home, and with how much.

    python -m bench.energy [SEEDS [BOAT [CAPACITY_WH]]] [--first SEED] [--rows FILE] [--steady | --ordered]

A boat sails drawn places, out and about, in a drawn sea: wind to 8 m/s, waves, a current to 0.4 m/s that turns by up to 120
degrees an hour. Its batteries last for some 40 to 60 minutes. Prints how many came home with a tenth of the capacity at least,
how many had gone home with more than a tenth left beside the reserve, and by how much the prediction of the way was off.

--first: the seeds from this one on, up to SEEDS. --rows: a line for each sea; those that are in the file already are not sailed
again. --steady: on the way home an operator holds the speed, so that the boat does not slow down to save energy: the prediction
is judged by that. --ordered: likewise, and home is ordered at a drawn time between 10 and 25 minutes, mostly before the boat
would turn by itself: a boat turns when it believes the way dear, so what it believes at the turn is not what it believes.
"""

import argparse
import json
import math
import random
import sys
from pathlib import Path
from statistics import median, quantiles

from delfim import config
from delfim.base.geodesy import from_plane
from delfim.base.modes import Mode
from delfim.canproxy.dsor.messages import BatteriesStatus, Fault, Status
from delfim.parts.energy.table import EnergyTable
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.state import NoLog, State

LIMIT_S = 4.0 * 3600.0
HOME_S = 600.0, 1500.0  # of --ordered
TOLD = 200.0  # steps of the charge that batteries tell


def _settings(boat: str, draw: random.Random, capacity_wh: float) -> config.Vehicle:
    sea = {
        "current_mps": draw.uniform(0.0, 0.4),
        "current_to_deg": draw.uniform(0.0, 360.0),
        "wind_mps": draw.uniform(0.0, 8.0),
        "wind_from_deg": draw.uniform(0.0, 360.0),
    }
    quiet = [f'failsafe.{name}.action="warn"' for name in ("battery_low", "battery_critical", "console_silent")]
    sails = [f"simulation.sea.{key}={value:.3f}" for key, value in sea.items()]
    return config.load(boat, [*quiet, *sails, f"energy.capacity_wh={capacity_wh:.1f}"])


class Sailed:
    """A boat on one sea."""

    def __init__(self, boat: str, seed: int, capacity_wh: float, is_steady: bool, is_ordered: bool) -> None:
        self._draw = random.Random(seed)
        self._settings, self._capacity_wh = _settings(boat, self._draw, capacity_wh), capacity_wh
        self._is_steady, self._ordered_s = is_steady, random.Random(f"home {seed}").uniform(*HOME_S) if is_ordered else math.inf
        self._turn_radps = math.radians(self._draw.uniform(-120.0, 120.0)) / 3600.0
        self._run = Lockstep(self._settings, seed, lambda clock: NoLog())
        self._turned: tuple[float, float] | None = None  # the charge where it turned, and of the way home
        self._has_slowed = False

    def row(self) -> dict[str, float]:
        """The charge at home; and at the turn the charge, that of the way home as the boat reckoned it, and when it was, s; 1
        where it slowed down."""
        run, state, at_s = self._run, self._run.state, math.nan
        for _ in run.cycles(LIMIT_S):
            self._tell()
            if state.origin is None or run.elapsed_s < 5.0:
                continue
            is_home = state.mode is Mode.HOME
            if is_home and self._turned is None:
                self._turned, at_s = (self._charge(), _home_wh(state) / self._capacity_wh), run.elapsed_s
                if self._is_steady:
                    run.order(console.SetSpeed(speed_mps=self._settings.control.home.speed_mps), "bench")
            if self._turned is not None and not is_home:
                break
            self._has_slowed |= is_home and not self._is_steady and state.setpoint.override_mps is not None
            if not is_home and run.elapsed_s >= self._ordered_s:
                run.order(console.SetMode("home"), "bench")
            elif not is_home and state.mode is not Mode.GOTO and not (state.mode is Mode.HOLD and "home in" in state.reason):
                self._go_on()
            elif run.elapsed_s % 5.0 < 0.2:
                run.order(console.Alive(), "bench")
        run.close()
        charge, home = self._turned or (math.nan, math.nan)
        return {"end": self._charge(), "charge": charge, "home": home, "at_s": at_s, "slowed": float(self._has_slowed)}

    def _charge(self) -> float:
        return min(drive.charge for drive in self._run.nodes.model.drives.values())

    def _tell(self) -> None:
        """The batteries tell, whatever boat it is; and the current turns."""
        model, state, now_s = self._run.nodes.model, self._run.state, self._run.state.watchdog_s
        for name, drive in zip(("batteries_starboard", "batteries_port"), model.drives.values(), strict=False):
            charge = round(drive.charge * TOLD) / TOLD
            report = BatteriesStatus(Status.GOOD, Fault(0), drive.voltage_v, drive.current_a, charge, 20)
            state.sysstat[name] = report, now_s
        c, s = math.cos(self._turn_radps * 0.2), math.sin(self._turn_radps * 0.2)
        n, e = model.current_north_mps, model.current_east_mps
        model.current_north_mps, model.current_east_mps = n * c - e * s, n * s + e * c

    def _go_on(self) -> None:
        run, draw, model = self._run, self._draw, self._run.nodes.model
        far_m, bearing = draw.uniform(150.0, 500.0), draw.uniform(0.0, 2.0 * math.pi)
        assert run.state.origin is not None
        place = from_plane(
            run.state.origin, model.north_m + far_m * math.cos(bearing), model.east_m + far_m * math.sin(bearing)
        )
        speed_mps = draw.choice([1.0, 1.2, 1.5]) * self._settings.control.speed.cruise_mps / 1.5
        run.order(console.Goto(math.degrees(place[0]), math.degrees(place[1]), speed_mps=speed_mps), "bench")


def _home_wh(state: State) -> float:
    """The way home, Wh."""
    return (state.energy and state.energy.home_wh) or 0.0


def _told(rows: list[dict[str, float]], reserve: float) -> None:
    ends, turned = [row["end"] for row in rows], [row for row in rows if row["charge"] - row["end"] > 0.02]
    errors = sorted(row["home"] / (row["charge"] - row["end"]) - 1.0 for row in turned)
    print(f"{len(rows)} seas: {sum(end >= 0.10 for end in ends)} home with a tenth or more, least {min(ends):.1%}")
    print(f"cut short needlessly (more than {reserve + 0.1:.0%} left): {sum(end > reserve + 0.1 for end in ends)}")
    print(f"slowed down on the way home: {sum(row['slowed'] for row in rows):.0f}")
    if len(errors) > 1:
        cut, near = quantiles(errors, n=20), sum(abs(each) <= 0.1 for each in errors) / len(errors)
        print(f"prediction at the turn: median {median(errors):+.1%}, 90 % within {cut[0]:+.1%} to {cut[-1]:+.1%}", end="")
        print(f"; within 10 %: {near:.0%}")


def main() -> None:
    asked = argparse.ArgumentParser()
    asked.add_argument("seeds", nargs="?", type=int, default=100)
    asked.add_argument("boat", nargs="?", default="etc/delfimx.toml")
    asked.add_argument("capacity_wh", nargs="?", type=float, default=800.0)
    asked.add_argument("--first", type=int, default=1)
    asked.add_argument("--rows", type=Path)
    asked.add_argument("--steady", action="store_true")
    asked.add_argument("--ordered", action="store_true")
    told = asked.parse_args()
    lines = told.rows.read_text().splitlines() if told.rows is not None and told.rows.exists() else []
    rows: dict[int, dict[str, float]] = {int(line["seed"]): line for line in map(json.loads, lines)}
    seeds = range(told.first, told.seeds + 1)
    for seed in seeds:
        if seed in rows:
            continue
        sailed = Sailed(told.boat, seed, told.capacity_wh, told.steady or told.ordered, told.ordered)
        rows[seed] = {"seed": seed, **sailed.row()}
        print(seed, f"home with {rows[seed]['end']:.1%}", file=sys.stderr, flush=True)
        if told.rows is not None:
            with told.rows.open("a") as file:
                file.write(json.dumps(rows[seed]) + "\n")
    _told([rows[seed] for seed in seeds], config.load(told.boat, []).of(EnergyTable).reserve)


if __name__ == "__main__":
    main()
