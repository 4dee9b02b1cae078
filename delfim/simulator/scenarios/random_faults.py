"""Short runs of mixed faults, drawn from a seed, checked against the invariants.

A run has a boat with a fence and a mission, an operator who changes his mind, and up to five faults that begin, overlap and
mostly end.
"""

import math
import shlex
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from random import Random
from typing import Any, Final

from delfim import config
from delfim.base import geodesy
from delfim.simulator.faults import KINDS, OF_AIS, OF_COMPASS, OF_PULSES, OF_THRUSTERS, VALUES, WHERE
from delfim.simulator.nodes import nodes_of
from delfim.simulator.scenarios.scenario import FaultAt, Scenario, ScenarioGuest, settings_of
from delfim.simulator.scenarios.trial import Result, sail
from delfim.simulator.tables import Simulation
from delfim.vehicle.log.logbook import Logbook

MIXED: Final = "mixed"
START_S, QUIET_S = 8.0, 15.0  # no fault before the boat is ready, nor at the end
OTHERS: Final = "corrections_lost", "restarted", "navigation_forged", "weeds", "capsized", "thruster_fouled"
MIXABLE: Final = tuple(
    kind for kind in KINDS if kind not in (*OF_COMPASS, *OF_AIS, *OF_PULSES, *OTHERS)
)  # others need more parts
HALF_M: Final = 65.0  # distance of the fence's sides from the start


def mixed(seed: int, vehicle: config.Vehicle) -> Scenario:
    """Draw the run of a seed. What this boat does not have does not break."""
    random, here, nodes = Random(f"mixed {seed}"), vehicle.of(Simulation), nodes_of(vehicle, seed).sensors
    places = {kind: tuple(name for name in names if name in nodes) for kind, names in WHERE.items()}
    places |= dict.fromkeys(OF_THRUSTERS, tuple(row.name for row in vehicle.thrusters))
    seconds = random.uniform(60.0, 120.0)
    place = partial(place_of, here)
    corners = [place(n * HALF_M, e * HALF_M) for n, e in ((1, -1), (1, 1), (-1, 1), (-1, -1))]
    sea = {
        "current_mps": random.uniform(0.0, 0.4),
        "current_to_deg": random.uniform(0.0, 360.0),
        "wind_mps": random.uniform(0.0, 6.0),
        "wind_from_deg": random.uniform(0.0, 360.0),
    }
    return Scenario(
        version=1,
        name=f"mixed faults, seed {seed}",
        seconds=seconds,
        vehicle={
            "fence": {"keep_in": [{"polygon": corners}], "keep_out": [{"centre": [place(45.0, 0.0)], "radius_m": 10.0}]},
            "failsafe": {"pause_s": random.choice([0.0, 5.0, 15.0])},
            "simulation": {"sea": sea, "heading_deg": random.uniform(0.0, 360.0)},
            "log": {"required": random.random() < 0.5},
        },
        guest=ScenarioGuest(heading_deg=random.uniform(0.0, 360.0), speed_mps=1.5) if random.random() < 0.3 else None,
        command=tuple(_orders(random, seconds, place)),
        fault=tuple(_fault(random, seconds, places) for _ in range(random.randint(1, 5))),
        patient=False,
    )


def place_of(here: Simulation, north_m: float, east_m: float) -> list[float]:
    """The point [latitude_deg, longitude_deg] at this distance from the start."""
    at = geodesy.origin(math.radians(here.latitude_deg), math.radians(here.longitude_deg))
    return [round(math.degrees(angle), 7) for angle in geodesy.from_plane(at, north_m, east_m)]


def mixed_mission(here: Simulation) -> str:
    """The text of its mission: once around, clear of the fence."""
    corners = [place_of(here, *corner) for corner in ((-40.0, -40.0), (-40.0, 40.0), (15.0, 40.0), (15.0, -40.0))]
    rows = [f"[[waypoint]]\nlatitude_deg = {latitude}\nlongitude_deg = {longitude}\n" for latitude, longitude in corners]
    return "\n".join(['version = 1\nname = "Once around"\n', *rows])


def _orders(random: Random, seconds: float, place: Callable[[float, float], list[float]]) -> list[dict[str, Any]]:
    """An operator who gives another command each half minute; refusals are allowed."""
    orders: list[dict[str, Any]] = []
    at_s = START_S / 2
    while at_s < seconds - 5.0:
        latitude_deg, longitude_deg = place(random.uniform(-55.0, 55.0), random.uniform(-55.0, 55.0))
        choices: list[dict[str, Any]] = [
            {"command": "heading", "heading_deg": random.uniform(0.0, 360.0), "speed_mps": random.uniform(0.5, 2.2)},
            {"command": "heading", "heading_deg": random.uniform(0.0, 360.0), "speed_mps": 2.2},
            {"command": "goto", "latitude_deg": latitude_deg, "longitude_deg": longitude_deg},
            {"command": "play"},
            {"command": "mode", "mode": random.choice(["hold", "home", "path", "grex", "manual"])},
            {"command": "manual", "starboard": random.uniform(-1.0, 1.0), "port": random.uniform(-1.0, 1.0)},
            {"command": "stop"},
        ]
        orders.append({"at_s": at_s, **random.choice(choices)})
        at_s += random.uniform(8.0, 40.0)
    return orders


def _fault(random: Random, seconds: float, places: dict[str, tuple[str, ...]]) -> FaultAt:
    kind = random.choice([kind for kind in MIXABLE if places.get(kind, True)])
    at_s = random.uniform(START_S, seconds - QUIET_S - 5.0)
    for_s = random.choice([random.uniform(0.5, 3.0), random.uniform(3.0, 15.0), seconds])
    if not kind.startswith("thruster_"):
        for_s = min(for_s, seconds - QUIET_S - at_s)
    value = VALUES[kind][0] * random.uniform(0.5, 1.5) if kind in VALUES else None
    return FaultAt(at_s=at_s, kind=kind, where=random.choice(places[kind]) if kind in places else "", value=value, for_s=for_s)


def sail_mixed(
    vehicle: str | Path,
    seed: int,
    overrides: tuple[str, ...] = (),
    draw: Callable[[int, config.Vehicle], Scenario] = mixed,
    *,
    logged: bool = False,
) -> Result:
    """Sail the run of a seed with a vehicle's file. Raises ConfigError. A refused order is not a failure here."""
    here = config.load(vehicle, overrides)
    scenario = draw(seed, here)
    settings = settings_of(scenario, vehicle, overrides)
    log = partial(Logbook, settings) if logged else None
    return sail(scenario, settings, seed, mixed_mission(here.of(Simulation)), log)


def again(vehicle: str, scenario: str, seed: int, overrides: Sequence[str]) -> str:
    """The command line that repeats a run."""
    words = ["delfim", "sim", vehicle, "--scenario", scenario, "--seed", str(seed)]
    return shlex.join([*words, *(word for override in overrides for word in ("--set", override))])
