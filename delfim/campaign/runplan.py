"""A campaign's file: what is sailed, what varies, and what must hold.

A run is a point and a seed. A point is a combination of the varied values; what is drawn depends on the seed alone, so that all
points meet the same sea. Batches are cut from the file alone: whoever goes on with a campaign cuts the same ones.
"""

import hashlib
import math
from collections.abc import Iterator
from itertools import islice, product
from pathlib import Path
from random import Random
from statistics import NormalDist
from typing import Annotated, Any, Final, Literal, NamedTuple

import msgspec

from delfim import config
from delfim.base import tables
from delfim.base.errors import ConfigError, FormatError
from delfim.base.input.untrusted import read_text
from delfim.campaign.adopted.columns import ADOPTION
from delfim.simulator.scenarios.encounters import staged_of
from delfim.simulator.scenarios.scenario import FaultAt, Scenario, fault_of, load_scenario
from delfim.simulator.scenarios.searching import DRAWN
from delfim.vehicle.plans.mission import load_mission

POINTS_MAX: Final = 100_000
RUNS_MAX: Final = 100_000_000
ENDING: Final = 256  # a batch has at most one in so many of the runs that are left
FAULT: Final = "fault."  # keys that begin with it lie over each fault of a scenario
Key = Annotated[str, tables.text(r"[a-z][a-z0-9_]*(\.([a-z][a-z0-9_]*|[0-9]{1,4}))*", "a key of the vehicle's file, with dots")]
Number = float | int
Scalar = float | int | str | bool
Name = Annotated[str, tables.text("[^\n]{1,80}", "a line of up to 80 characters")]


class Steps(tables.Table, frozen=True):
    """Evenly spaced values, both ends among them."""

    start: Number = msgspec.field(name="from")
    to: Number
    steps: Annotated[int, msgspec.Meta(ge=2, le=1000)]


class Draw(tables.Table, frozen=True):
    """A drawn value, by one of these: a uniform range, a normal distribution (mean, standard deviation), or a choice."""

    uniform: tuple[float, float] | None = None
    normal: tuple[float, float] | None = None
    choice: Annotated[tuple[Scalar, ...], msgspec.Meta(max_length=1000)] = ()

    def __post_init__(self) -> None:
        if sum((self.uniform is not None, self.normal is not None, bool(self.choice))) != 1:
            raise ValueError("name one of uniform, normal, choice")


class Pass(tables.Table, frozen=True):
    """A condition that must hold. `sql`: an expression over all runs that gives true or false; each = "point": at every
    point."""

    name: Name
    sql: Annotated[str, msgspec.Meta(min_length=1, max_length=1000)]
    each: Literal["", "point"] = ""


class Answer(tables.Table, frozen=True):
    """A table that is printed at the end, and stands in the report. `sql`: a query of DuckDB over the table `runs`."""

    name: Name
    sql: Annotated[str, msgspec.Meta(min_length=1, max_length=4000)]


class Seeds(tables.Table, frozen=True):
    """The seeds at each point."""

    first: Annotated[int, msgspec.Meta(ge=0, le=2**53)] = 1
    count: Annotated[int, msgspec.Meta(ge=1, le=RUNS_MAX)] = 100


class CampaignFile(tables.Table, frozen=True):
    """The file of a campaign. `vehicle`, `scenario` and `mission` are files beside it, one or several: each boat sails each of
    the others. The scenarios "mixed", "chased", "forged" and "searching" are drawn from the seed; so is "adoption", whose runs
    are trials of boats that are not as their files say, and have columns of their own."""

    version: Literal[1]
    name: Name
    vehicle: str | tuple[str, ...]
    scenario: str | tuple[str, ...] = ()
    mission: str | tuple[str, ...] = ()
    seconds: Annotated[float, msgspec.Meta(gt=0.0, le=86_400.0)] = 3600.0  # of a mission, at most
    limit_s: Annotated[float, msgspec.Meta(gt=0.0, le=86_400.0)] = 300.0  # of computing for a run
    seeds: Seeds = Seeds()
    audit: bool = False  # each run's log is judged by the second auditor: what it finds is a failure
    pairs: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 0.0  # part of the possible pairs that must be met; 0: not counted
    page: bool = True  # write the page with its pictures at the end
    latin: bool = False  # draw evenly: each of as many slices of a range as there are seeds is met once
    vary: dict[Key, Annotated[tuple[Scalar, ...], msgspec.Meta(min_length=1)] | Steps] = msgspec.field(default_factory=dict)
    draw: dict[Key, Draw] = msgspec.field(default_factory=dict)
    must: tuple[Pass, ...] = msgspec.field(name="pass", default=())
    answers: tuple[Answer, ...] = msgspec.field(name="table", default=())

    def __post_init__(self) -> None:
        if not (self.scenario or self.mission):
            raise ValueError("name a scenario, a mission, or both")
        if twice := self.vary.keys() & self.draw.keys():
            raise ValueError(f"{min(twice)} is varied and drawn")
        if ADOPTION in _names(self.scenario):
            if self.mission or self.scenario not in (ADOPTION, (ADOPTION,)):
                raise ValueError(f"a campaign of {ADOPTION} has no other scenario, and no mission")
            if self.page or self.audit or self.pairs:
                raise ValueError(f"a campaign of {ADOPTION} has no tracks, audit and pairs: page = false")


class Story(NamedTuple):
    """A voyage to sail: a boat, and a scenario's file, one that a seed draws, or a mission, with the texts that belong to
    it."""

    name: str
    boat: str  # name of the vehicle's file
    vehicle: dict[str, Any]  # the vehicle's file as a tree
    scenario: dict[str, Any] | None  # the scenario's file as a tree
    mission: str


class Batch(NamedTuple):
    """Runs that are handed out together."""

    number: int
    runs: tuple[tuple[int, int], ...]  # (point, seed)


class Plan(NamedTuple):
    """A campaign as its workers need it, without any file. It is small and travels with each batch."""

    name: str
    digest: str  # of what is sailed
    stories: tuple[Story, ...]
    points: tuple[tuple[int, dict[str, Any]], ...]  # (number of the story, values)
    draw: dict[str, Draw]
    latin: bool
    seeds: Seeds
    seconds: float
    limit_s: float
    audit: bool = False
    pairs: bool = False

    @property
    def is_adoption(self) -> bool:
        return any(story.name == ADOPTION for story in self.stories)

    @property
    def runs(self) -> int:
        return len(self.points) * self.seeds.count

    def batches(self, size: int) -> Iterator[Batch]:
        """All runs in order, at most `size` of them together, and fewer towards the end: no worker rests while another one
        sails a long last batch."""
        first, left, number = self.seeds.first, self.runs, 0
        runs = product(range(len(self.points)), range(first, first + self.seeds.count))
        while left:
            some = tuple(islice(runs, min(size, max(left // ENDING, 1))))
            yield Batch(number, some)
            left, number = left - len(some), number + 1

    def values(self, point: int, seed: int) -> dict[str, Any]:
        """The values that are varied and drawn in this run, by key."""
        return self.points[point][1] | {key: self._drawn(key, how, seed) for key, how in self.draw.items()}

    def _drawn(self, key: str, how: Draw, seed: int) -> Scalar:
        part = Random(f"{key} {seed}").random()
        if self.latin:
            part = (_place(key, self.seeds, seed) + part) / self.seeds.count
        if how.uniform is not None:
            low, high = how.uniform
            return low + (high - low) * part
        if how.normal is not None:
            mean, deviation = how.normal
            return NormalDist(mean, deviation).inv_cdf(min(max(part, 1e-12), 1.0 - 1e-12)) if deviation else mean
        return how.choice[min(int(part * len(how.choice)), len(how.choice) - 1)]


def _place(key: str, seeds: Seeds, seed: int) -> int:
    """The slice of a seed: a permutation of all slices without a table of them, a Feistel network, walked until in range."""
    bits = max(2, (seeds.count - 1).bit_length())
    half = (bits + 1) // 2
    mask, at = (1 << half) - 1, seed - seeds.first
    while True:
        left, right = at >> half, at & mask
        for turn in range(4):
            word = hashlib.blake2b(f"{key} {turn} {right}".encode(), digest_size=4).digest()
            left, right = right, left ^ int.from_bytes(word, "little") & mask
        at = left << half | right
        if at < seeds.count:
            return at


def read(path: str | Path) -> tuple[CampaignFile, Plan]:
    """Read a campaign's file and its plan; every point's values are tried on the vehicle's file. Raises ConfigError."""
    place = Path(path)
    file = tables.decode(tables.read_toml(place), CampaignFile, str(place))
    trials = [trial for name in _names(file.scenario) for trial in _trials(place.parent, name)]
    trials += [_mission(place.parent, name) for name in _names(file.mission)]
    boats = [(Path(name).stem, tables.read_toml(place.parent / name)) for name in _names(file.vehicle)]
    stories = tuple(
        Story(name, boat, tree, scenario, mission) for (boat, tree), (name, scenario, mission) in product(boats, trials)
    )
    ways = {key: _values(way) for key, way in file.vary.items()}
    many = len(stories) * math.prod(map(len, ways.values()))
    if many > POINTS_MAX or many * file.seeds.count > RUNS_MAX:
        limit = f"at most {POINTS_MAX} points and {RUNS_MAX} runs"
        raise ConfigError(str(place), "vary", f"{many} points of {file.seeds.count} seeds each", limit)
    rows = [dict(zip(ways, row, strict=True)) for row in product(*ways.values())]
    points = tuple((story, row) for story in range(len(stories)) for row in rows)
    kept = {"stories": stories, "points": points, "draw": file.draw, "latin": file.latin}
    kept |= {"audit": True} if file.audit else {}
    kept |= {"pairs": True} if file.pairs else {}
    sailed = msgspec.json.encode(kept | {"seeds": file.seeds, "seconds": file.seconds}, order="sorted")
    digest = hashlib.sha256(sailed).hexdigest()[:16]
    how = file.draw, file.latin, file.seeds, file.seconds, file.limit_s, file.audit, file.pairs > 0.0
    plan = Plan(file.name, digest, stories, points, *how)
    for number in range(len(points)):
        try:
            _try(plan, number, str(place))
        except ConfigError as error:
            raise ConfigError(str(place), f"point {number}, {error.key}", error.reason, error.allowed) from None
    return file, plan


def _try(plan: Plan, number: int, where: str) -> None:
    """Try the first run of a point without sailing it. Raises ConfigError."""
    story, (over, faults) = plan.stories[plan.points[number][0]], parted(plan.values(number, plan.seeds.first))
    config.read(laid(story.vehicle, over), where)
    if faults and story.scenario is not None:
        broken_of(tables.decode(story.scenario, Scenario, story.name), faults, where)
    elif faults:
        raise ConfigError(where, min(faults), f"{story.name} has no [[fault]]")


def parted(values: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Split the values into those that lie over the vehicle's file, by key, and those over each fault of the scenario, by the
    names there."""
    faults = {key.removeprefix(FAULT): value for key, value in values.items() if key.startswith(FAULT)}
    return {key: value for key, value in values.items() if not key.startswith(FAULT)}, faults


def broken_of(scenario: Scenario, over: dict[str, Any], where: str) -> Scenario:
    """The scenario with these values over each of its faults. Raises ConfigError."""
    rows = [tables.decode(msgspec.to_builtins(each) | over, FaultAt, where) for each in scenario.fault]
    try:
        for each in rows:
            fault_of(each)
    except FormatError as error:
        raise ConfigError(where, "fault", str(error)) from None
    if not rows:
        raise ConfigError(where, "fault", f"{scenario.name} has no [[fault]]")
    return msgspec.structs.replace(scenario, fault=tuple(rows))


def _names(asked: str | tuple[str, ...]) -> tuple[str, ...]:
    return (asked,) if isinstance(asked, str) and asked else tuple(asked)


def _trials(folder: Path, name: str) -> Iterator[tuple[str, dict[str, Any] | None, str]]:
    """(name, scenario's file, mission's text) of a scenario's file, or of each of its encounters."""
    if name in DRAWN or name == ADOPTION:
        yield name, None, ""
        return
    path = folder / name
    scenario = load_scenario(path)
    programs = {"payload": msgspec.to_builtins(scenario.payload)} if scenario.payload else {}  # whose files are beside it
    for each in staged_of(scenario, path):
        tree = msgspec.to_builtins(each.scenario) if each.name else tables.read_toml(path) | programs
        yield f"{path.stem}:{each.name}" if each.name else path.stem, tree, each.mission


def _mission(folder: Path, name: str) -> tuple[str, None, str]:
    load_mission(folder / name)
    return Path(name).stem, None, read_text(folder / name)


def _values(way: tuple[Scalar, ...] | Steps) -> tuple[Scalar, ...]:
    if isinstance(way, Steps):
        return tuple(way.start + (way.to - way.start) * i / (way.steps - 1) for i in range(way.steps))
    return way


def laid(tree: dict[str, Any], values: dict[str, Any]) -> dict[str, Any]:
    """The tree with these values over it. Keys have dots; a number is a place in a list, from 0. Raises ConfigError."""
    for key, value in values.items():
        tree = _placed(tree, key, key.split("."), value)
    return tree


def _placed(tree: Any, key: str, names: list[str], value: object) -> Any:
    if not names:
        return value
    first, *rest = names
    if isinstance(tree, list) and first.isdecimal():
        if int(first) >= len(tree):
            raise ConfigError("", key, f"there are {len(tree)} of these, counted from 0")
        return [_placed(each, key, rest, value) if i == int(first) else each for i, each in enumerate(tree)]
    known = tree if isinstance(tree, dict) else {}
    return {**known, first: _placed(known.get(first), key, rest, value)}
