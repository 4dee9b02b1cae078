"""Scenarios: an operator's commands, the faults and the expected results, in a text file. `docs/scenarios.md` has the format
by example; `delfim.simulator.scenarios.trial` sails it.
"""

import json
import math
from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple, Self

import msgspec

from delfim import config
from delfim.base import tables
from delfim.base.errors import ConfigError, FormatError, in_words
from delfim.base.input.untrusted import parse_toml, read_text
from delfim.simulator.faults import Breakage, fault
from delfim.simulator.handset import HandsetAt
from delfim.vehicle import console

DAY_S: Final = 86_400.0
EXPECTED: Final = ("mode", "notice", "propellers", "waypoints", "nearest", "nearest_m", "clear_m")
Words = Annotated[tuple[str, ...], msgspec.Meta(min_length=1)]
Time = Annotated[float, msgspec.Meta(ge=0.0, le=DAY_S)]


class FaultAt(tables.Table, frozen=True):
    """A fault and its time."""

    at_s: Time
    kind: str
    where: str = ""
    value: float | None = None
    for_s: float | None = None  # to the end if not given


class Expect(tables.Table, frozen=True):
    """An expected result: a mode, a notice, stopped propellers, or waypoints reached."""

    mode: str = ""
    notice: str = ""  # a trouble's name
    propellers: Literal["", "stopped"] = ""
    waypoints: Annotated[int, msgspec.Meta(ge=0)] = 0  # number of the mission's waypoints passed within their radius
    nearest: Annotated[float, msgspec.Meta(ge=0.0)] = 0.0  # domains of other vessels, at least; 1 is the edge
    nearest_m: Annotated[float, msgspec.Meta(ge=0.0)] = 0.0  # to the middle of other vessels, at least
    clear_m: Annotated[float, msgspec.Meta(ge=0.0)] = 0.0  # from the hull to what stands in the water, and swimmers, at least
    reason: str = ""  # contained in the reason of the mode or the notice
    after: float | str = 0.0  # a time in s, a kind of fault, or a command of the operator; its last occurrence
    within_s: float = math.inf  # after that
    at_end: bool = False  # and until the end of the run
    never: bool = False  # not at all after that

    def __post_init__(self) -> None:
        if sum(map(bool, (getattr(self, name) for name in EXPECTED))) != 1:
            raise ValueError(f"name one of {', '.join(EXPECTED)}")


class ScenarioGuest(tables.Table, frozen=True):
    """The guest computer's set point, sent twice a second."""

    heading_deg: float
    speed_mps: float


class Scenario(tables.Table, frozen=True):
    """A scenario file."""

    version: Literal[1]
    name: str
    seconds: Annotated[float, msgspec.Meta(gt=0.0, le=86_400.0)]
    mission: str = ""  # a mission file, beside this one
    vehicle: dict[str, Any] = msgspec.field(
        default_factory=dict
    )  # tables laid over the vehicle's file, a chart beside this one
    guest: ScenarioGuest | None = None
    # payload programs in Python that run, by their names: a file, beside this one, and its words
    payload: dict[str, Words] = msgspec.field(default_factory=dict)
    command: tuple[dict[str, Any], ...] = ()  # the operator's commands with `at_s`, and `held_s` or `refused` (class Order)
    fault: tuple[FaultAt, ...] = ()
    vessel: tuple[dict[str, Any], ...] = ()  # other vessels, rows of `simulation.traffic.vessel` in the vehicle's file
    encounters: str = ""  # a file of them, beside this one, each a scenario of its own; or "random": one by the seed
    speed_mps: Annotated[float, msgspec.Meta(ge=0.0, le=30.0)] = 0.0  # of the boat; encounters are scaled to it; 0: their own
    handset: tuple[HandsetAt, ...] = ()  # of the boat's hand-set, which `vehicle.handset` then describes
    patient: bool = True  # the operator gives a refused order again; false: he gives each once, and it may be refused
    expect: tuple[Expect, ...] = ()


def load_scenario(path: str | Path) -> Scenario:
    """Load a scenario, and check its faults and commands. Raises ConfigError."""
    scenario = tables.decode(tables.read_toml(path), Scenario, str(path))
    key = ""
    try:
        for number, broken in enumerate(scenario.fault):
            key = f"fault[{number}]"
            fault_of(broken)
        for number, words in enumerate(scenario.command):
            key = f"command[{number}]"
            OperatorWord.of(words)
    except FormatError as error:
        raise ConfigError(str(path), key, str(error)) from None
    programs = {name: (str((Path(path).parent / file).resolve()), *words) for name, (file, *words) in scenario.payload.items()}
    vehicle, fence = scenario.vehicle, scenario.vehicle.get("fence")
    if isinstance(fence, dict) and isinstance(chart := fence.get("chart"), str) and chart:
        vehicle = vehicle | {"fence": fence | {"chart": str((Path(path).parent / chart).resolve())}}
    return msgspec.structs.replace(scenario, payload=programs, vehicle=vehicle)


def settings_of(scenario: Scenario, vehicle: str | Path, overrides: tuple[str, ...] = ()) -> config.Vehicle:
    """The vehicle's file with the scenario's tables laid over it. Raises ConfigError."""
    settings = config.read(laid_upon(tables.read_toml(vehicle, overrides), scenario), str(vehicle))
    if scenario.handset and not settings.handset.device:
        raise ConfigError(str(vehicle), "handset.device", "the scenario has a hand-set: name its device")
    return settings


def laid_upon(tree: dict[str, Any], scenario: Scenario) -> dict[str, Any]:
    """A vehicle's file with the scenario's tables and vessels laid over it."""
    both = laid_over(tree, scenario.vehicle)
    return laid_over(both, {"simulation": {"traffic": {"vessel": list(scenario.vessel)}}}) if scenario.vessel else both


def laid_over(tree: dict[str, Any], upper: dict[str, Any]) -> dict[str, Any]:
    """The tree with the upper one laid over it, table by table."""
    both = {key: laid_over(tree[key], value) for key, value in upper.items() if isinstance(tree.get(key), dict)}
    return {**tree, **upper, **both}


class OperatorWord(NamedTuple):
    """A command of the operator."""

    at_s: float
    command: console.Commands
    refused: str = ""  # it must be refused, in these words; empty: it must be obeyed
    held_s: float = 0.0  # once obeyed, it is repeated twice a second for this time, like a pushed joystick

    @classmethod
    def of(cls, words: dict[str, Any]) -> Self:
        """Parse a table of a scenario. Raises FormatError."""
        rest = {**words}
        at_s, refused, held_s = rest.pop("at_s", None), rest.pop("refused", ""), rest.pop("held_s", 0.0)
        is_timed = all(isinstance(each, float | int) and 0.0 <= each <= DAY_S for each in (at_s, held_s))
        if not is_timed or not isinstance(refused, str):
            raise FormatError("a command needs at_s in seconds, up to a day; held_s is in seconds too, and refused is text")
        command = json.dumps(rest, default=str).encode()  # a command has no dates
        return cls(float(at_s), console.parse(command), refused, float(held_s))


def fault_of(asked: FaultAt, thrusters: Collection[str] = ()) -> Breakage:
    """The fault of a row; `thrusters` are the names of the boat's. Raises FormatError."""
    return fault(asked.kind, asked.where, asked.value, asked.for_s, thrusters)


def mission_of(scenario: Scenario, path: str | Path) -> str:
    """The text of the mission beside a scenario file, empty if it names none. Raises ConfigError."""
    if not scenario.mission:
        return ""
    place = Path(path).parent / scenario.mission
    try:
        mission = read_text(place)
        parse_toml(mission)
    except (OSError, FormatError) as error:
        raise ConfigError(str(place), "file", in_words(error)) from None
    return mission
