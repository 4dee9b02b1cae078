"""What is sailed in lock step: every boat through its modes, every scenario, seeds of mixed faults, encounters."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec

from delfim import config
from delfim.base.clock import ManualClock
from delfim.simulator.invariants.onlooker import TruePlace
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.scenarios.encounters import staged_of
from delfim.simulator.scenarios.random_faults import mixed, mixed_mission, place_of
from delfim.simulator.scenarios.scenario import Scenario, load_scenario, mission_of, settings_of
from delfim.simulator.scenarios.trial import sail
from delfim.simulator.tables import Simulation
from tests.oracles.traces import Layout, Tape, Trace

ROOT: Final = Path(__file__).parents[2]
DELFIMX: Final = ROOT / "etc/delfimx.toml"
MIXED: Final = range(1, 21)
ENCOUNTERS: Final = {"imazu22": (1, 6, 11, 16, 22), "dnv55": (2, 18, 40), "morise55": (9, 50)}  # of each scale
# Of a voyage in the tests that run each time. Within two minutes a boat is told all modes.
QUICK_S: Final = {"boats": 120.0, "scenarios": 60.0, "mixed": 60.0, "encounters": 60.0}
MODES_S: Final = 7.0  # a boat is told another mode so often


class Voyage(NamedTuple):
    """A run."""

    name: str
    settings: config.Vehicle
    seed: int
    scenario: Scenario
    mission: str
    layout: Layout

    def sail(self, groups: dict[str, tuple[str, ...]], seconds: float = math.inf) -> Trace:
        """Its trace in these fields, or in all; whole, or for a time."""
        tapes = list[Tape]()

        def tape(clock: ManualClock) -> Tape:
            tapes.append(Tape(self.settings, clock, groups))
            return tapes[0]

        def look(run: Lockstep, place: TruePlace) -> None:
            tapes[0].look(run)

        scenario = msgspec.structs.replace(self.scenario, seconds=min(seconds, self.scenario.seconds))
        result = sail(scenario, self.settings, self.seed, self.mission, tape, look=look)
        for event in result.events:
            if event.kind == "command":
                tapes[0].told.append((event.t_s, f"operator: {event.name} {event.text}".rstrip()))
        tapes[0].failures = result.failures
        return tapes[0].trace(self.layout)


def boats() -> Iterator[Voyage]:
    """Each mode for some seconds, then its mission."""
    for file in (*sorted((ROOT / "etc/boats").glob("*.toml")), DELFIMX):
        settings = config.load(file)
        mission = config.mission_place(str(file), settings).read_text()
        orders = tuple({"at_s": 4.0 + MODES_S * i, **order} for i, order in enumerate(_orders(settings.simulation)))
        scenario = Scenario(version=1, name="all modes", seconds=300.0, command=orders)
        yield Voyage(_name(file), settings, 1, scenario, mission, Layout(settings.navigation.rate_hz, 60.0, 5.0, each=True))


def _orders(here: Simulation) -> Iterator[dict[str, Any]]:
    latitude_deg, longitude_deg = place_of(here, 20.0, -15.0)
    yield {"command": "play"}
    yield {"command": "mode", "mode": "hold"}
    yield {"command": "heading", "heading_deg": 200.0, "speed_mps": 0.8}
    yield {"command": "manual", "starboard": 0.5, "port": 0.25, "held_s": MODES_S - 1.0}
    yield {"command": "goto", "latitude_deg": latitude_deg, "longitude_deg": longitude_deg}
    yield {"command": "course", "course_deg": 75.0, "speed_mps": 1.1}
    yield {"command": "mode", "mode": "home"}
    yield {"command": "mode", "mode": "path"}
    yield {"command": "stop"}
    yield {"command": "play"}


def scenarios() -> Iterator[Voyage]:
    for file in sorted((ROOT / "etc/scenarios").glob("*.toml")):
        scenario = load_scenario(file)
        settings = settings_of(scenario, DELFIMX)
        layout = Layout(settings.navigation.rate_hz, 30.0, 10.0)
        yield Voyage(_name(file), settings, 1, scenario, mission_of(scenario, file), layout)


def mixed_seeds() -> Iterator[Voyage]:
    here = config.load(DELFIMX)
    for seed in MIXED:
        scenario, mission = mixed(seed, here), mixed_mission(here.simulation)
        settings = settings_of(scenario, DELFIMX)
        layout = Layout(settings.navigation.rate_hz, 25.0, 10.0)
        yield Voyage(f"mixed, seed {seed}", settings, seed, scenario, mission, layout)


def encounters() -> Iterator[Voyage]:
    for stem, numbers in ENCOUNTERS.items():
        for scale, heard in (("real", "A"), ("similar", "perfect")):
            file = ROOT / f"etc/encounters/{stem}-{scale}.toml"
            staged = staged_of(load_scenario(file), file)
            for number in numbers:
                name, scenario, mission = staged[number - 1]
                settings = settings_of(scenario, DELFIMX, (f'simulation.traffic.heard="{heard}"',))
                layout = Layout(settings.navigation.rate_hz, 10.0, 60.0)
                yield Voyage(f"{_name(file)}:{name}", settings, number, scenario, mission, layout)


def _name(file: Path) -> str:
    return str(file.relative_to(ROOT))


VOYAGES: Final[dict[str, Callable[[], Iterator[Voyage]]]] = {
    "boats": boats,
    "scenarios": scenarios,
    "mixed": mixed_seeds,
    "encounters": encounters,
}
