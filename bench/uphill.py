"""The picture of docs/payloads.md: a payload program takes the boat up to the warmest water, in lock step.

`python -m bench.uphill docs/pictures/payload-uphill.png`
"""

import importlib.util
import math
import sys
from pathlib import Path
from typing import Any, Final

import matplotlib
import numpy as np

from delfim.simulator.invariants.onlooker import TruePlace
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.scenarios.scenario import load_scenario, settings_of
from delfim.simulator.scenarios.trial import sail

ROOT: Final = Path(__file__).parents[1]
SCENARIO, VEHICLE, PROGRAM = (ROOT / "etc" / name for name in ("scenarios/payload.toml", "delfimx.toml", "payloads/uphill.py"))
MARGIN_M: Final = 30.0
HOLDS: Final = "goto done"


def main(picture: str) -> None:
    matplotlib.use("Agg")
    from matplotlib import pyplot

    scenario = load_scenario(SCENARIO)
    way = list[tuple[float, float, bool]]()  # degrees, and whether the boat waits

    def look(run: Lockstep, place: TruePlace) -> None:
        if run.state.helmsman and (n := run.state.navigation) is not None and n.latitude_rad is not None:
            waits = run.state.reason == HOLDS
            way.append((math.degrees(n.latitude_rad), math.degrees(n.longitude_rad or 0.0), waits))

    result = sail(scenario, settings_of(scenario, VEHICLE), 1, look=look)
    if result.failures:
        raise SystemExit("\n".join(result.failures))
    latitude_deg, longitude_deg, width_m = map(float, scenario.payload["uphill"][-3:])
    program = _program()
    peak = program.Peak(latitude_deg, longitude_deg, width_m)
    places = np.array([program.metres((latitude_deg, longitude_deg), each[:2]) for each in way])
    north, east = (np.arange(places[:, i].min() - MARGIN_M, places[:, i].max() + MARGIN_M, 2.0) for i in (0, 1))
    warmth = [[peak.warmth(math.hypot(n, e)) for e in east] for n in north]
    figure, axes = pyplot.subplots(figsize=(6.4, 6.0), layout="constrained")
    filled = axes.contourf(east, north, warmth, levels=16, cmap="YlOrRd")
    figure.colorbar(filled, label="warmth of the water, °C")
    waits = np.array([each[2] for each in way])
    axes.plot(places[~waits, 1], places[~waits, 0], "k", linewidth=1.2, label="climbs")
    axes.plot(places[waits, 1], places[waits, 0], "b", linewidth=1.2, label="waits")
    axes.plot(0.0, 0.0, "w^", markeredgecolor="k", label="warmest place")
    axes.plot(places[0, 1], places[0, 0], "wo", markeredgecolor="k", label="given to the program")
    axes.set(xlabel="east of the warmest place, m", ylabel="north, m", aspect="equal")
    axes.legend(loc="lower right")
    figure.savefig(picture, dpi=100)


def _program() -> Any:
    """The example, which is no part of a package."""
    spec = importlib.util.spec_from_file_location("uphill", PROGRAM)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


if __name__ == "__main__":
    main(sys.argv[1])
