"""Vessels that react to the boat, drawn from a seed: forged ones that follow it, some that change sides, others that chase it;
and things that a program makes up around it.

A run has a boat, mostly with a fence, an operator who gives it some orders and then leaves it alone, and a fleet.
"""

from collections.abc import Callable
from functools import partial
from random import Random
from typing import Any, Final

import msgspec

from delfim import config
from delfim.simulator.scenarios.random_faults import place_of
from delfim.simulator.scenarios.scenario import Scenario, laid_over
from delfim.simulator.tables import Simulation

CHASED: Final = "chased"
FORGED: Final = "forged"
LIAR: Final = "liar"  # the program
FLEET: Final = 10


def chased(seed: int, vehicle: config.Vehicle) -> Scenario:
    """The run of a seed."""
    random, here = Random(f"chased {seed}"), vehicle.of(Simulation)
    place, seconds = partial(place_of, here), random.uniform(180.0, 480.0)
    sea = {
        "current_mps": random.uniform(0.0, 0.4),
        "current_to_deg": random.uniform(0.0, 360.0),
        "wind_mps": random.uniform(0.0, 6.0),
        "wind_from_deg": random.uniform(0.0, 360.0),
    }
    traffic = {"heard": random.choice(("perfect", "perfect", "A", "B"))}
    fence = {"keep_in": [{"centre": [place(0.0, 0.0)], "radius_m": random.uniform(80.0, 250.0)}]}
    if random.random() < 0.5:
        fence["keep_out"] = [{"centre": [place(random.uniform(-70.0, 70.0), 75.0)], "radius_m": random.uniform(5.0, 20.0)}]
    simulation = {"sea": sea, "traffic": traffic, "heading_deg": random.uniform(0.0, 360.0)}
    tree: dict[str, Any] = {"simulation": simulation, "sensors": {"names": ["sysstat", "nmea2000"]}}
    return Scenario(
        version=1,
        name=f"chased, seed {seed}",
        seconds=seconds,
        vehicle=tree | ({"fence": fence} if random.random() < 0.75 else {}),
        command=tuple(_orders(random, place)),
        vessel=tuple(_fleet(random)),
        patient=False,
    )


def forged(seed: int, vehicle: config.Vehicle) -> Scenario:
    """The run of a seed: as the chased one, and a program makes up things and swimmers around the boat; often without ships."""
    random, scenario = Random(f"forged {seed}"), chased(seed, vehicle)
    lookout = {"payload": LIAR, "kind": "lidar", "reach_m": 1000.0, "missed": 0.0, "ghosts": random.choice((0.0, 0.0, 2.0))}
    tree = {
        "payload": {LIAR: {"command": ["/usr/bin/liar"], "may": ["obstacles"]}},
        "simulation": {"things": {"lookout": [lookout], "thing": _made_up(random)}},
    }
    return msgspec.structs.replace(
        scenario,
        name=f"forged, seed {seed}",
        vehicle=laid_over(scenario.vehicle, tree),
        vessel=scenario.vessel if random.random() < 0.5 else (),
    )


def _made_up(random: Random) -> list[dict[str, Any]]:
    """Things that stay where the boat is: a wall that moves with it, a ring with a gap, a crowd at its side. What is told once
    is believed for a while, so that they leave a trail."""
    arc_deg, number = random.choice((5.0, 40.0, 90.0, 180.0, 330.0)), random.randint(1, 3 * FLEET)
    bearing_deg, away_m = random.uniform(0.0, 360.0), random.uniform(3.0, 60.0)
    kind, radii_m = random.choice((("thing", (0.5, 0.5, 5.0, 20.0)), ("thing", (0.5,)), ("person", (0.5,))))
    return [
        {
            "kind": kind,
            "radius_m": random.choice(radii_m),
            "follows_m": away_m,
            "follows_deg": (bearing_deg + arc_deg * (i / number - 0.5)) % 360.0,
        }
        for i in range(number)
    ]


def _fleet(random: Random) -> list[dict[str, Any]]:
    """Vessels, all of one kind: they stay where the boat is, in an arc; some move, or report so; some chase it in truth."""
    kind, number = random.choice(("lie", "push", "ahead", "sides", "chase")), random.randint(1, FLEET)
    bearing_deg, arc_deg = random.uniform(0.0, 360.0), random.choice((0.0, 60.0, 90.0, 180.0, 360.0))
    length_m, away_m = random.choice((12.0, 60.0, 200.0)), random.uniform(5.0, 400.0 if kind == "ahead" else 80.0)
    rows = list[dict[str, Any]]()
    for i in range(number):
        toward_deg = bearing_deg + arc_deg * (i / number - 0.5)
        row: dict[str, Any] = {"transponder": random.choice("AB"), "length_m": length_m, "beam_m": length_m / 6.0}
        if kind == "chase":
            north_m, east_m = random.uniform(-300.0, 300.0), random.uniform(-300.0, 300.0)
            row |= {"chases": True, "turn_dps": random.uniform(1.0, 10.0), "north_m": north_m, "east_m": east_m}
        else:
            row |= {"follows_m": away_m, "follows_deg": toward_deg % 360.0}
        if kind == "sides":
            row |= {"sides_s": random.uniform(20.0, 120.0)}
        if kind not in ("lie", "sides"):
            row |= {"speed_mps": random.uniform(0.5, 4.0), "course_deg": (toward_deg + 180.0) % 360.0}
        rows.append(row)
    return rows


def _orders(random: Random, place: Callable[[float, float], list[float]]) -> list[dict[str, Any]]:
    """Up to three orders, then none; refusals are allowed."""
    orders, at_s = list[dict[str, Any]](), 8.0
    for _ in range(random.randint(1, 3)):
        latitude_deg, longitude_deg = place(random.uniform(-70.0, 70.0), random.uniform(-70.0, 70.0))
        choices: list[dict[str, Any]] = [
            {"command": "mode", "mode": random.choice(("hold", "hold", "path", "home"))},
            {"command": "course", "course_deg": random.uniform(0.0, 360.0), "speed_mps": random.uniform(0.5, 2.2)},
            {"command": "goto", "latitude_deg": latitude_deg, "longitude_deg": longitude_deg},
            {"command": "play"},
        ]
        orders.append({"at_s": at_s, **random.choice(choices)})
        at_s += random.uniform(15.0, 60.0)
    return orders
