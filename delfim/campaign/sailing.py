"""The work of a worker: it sails the runs of a batch and returns their results. It knows nothing of who ordered them."""

import gc
import hashlib
import os
import pkgutil
import platform
import time
from collections.abc import Callable
from importlib.util import find_spec
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple

import delfim
from delfim import config
from delfim.base import tables
from delfim.base.clock import ManualClock
from delfim.base.errors import DelfimError
from delfim.campaign.measures import MEASURES, RunTape, Sailed, Truth
from delfim.campaign.runplan import Batch, Plan, broken_of, laid, parted
from delfim.simulator.invariants.onlooker import TruePlace
from delfim.simulator.lockstep import Lockstep, uncollected
from delfim.simulator.scenarios.encounters import OWN_MPS, RANDOM, drawn, staged
from delfim.simulator.scenarios.pairs import PairTape
from delfim.simulator.scenarios.random_faults import mixed_mission
from delfim.simulator.scenarios.scenario import Scenario, laid_upon
from delfim.simulator.scenarios.searching import DRAWN
from delfim.simulator.scenarios.trial import Event, sail
from delfim.simulator.tables import Simulation
from delfim.vehicle.log.logbook import Logbook
from delfim.vehicle.state import NoLog, StateLog

LOOK_CYCLES: Final = 100  # the time of the processor is looked at so often


class TooLong(DelfimError):
    """A run that took more computing than `limit_s`."""


class _Watch:
    """Looks at a run after each cycle."""

    def __init__(self, plan: Plan, look: Callable[[Lockstep], object], beside: Callable[[ManualClock], StateLog]) -> None:
        self._until_s, self._limit_s = time.process_time() + plan.limit_s, plan.limit_s
        self._look, self._beside = look, beside
        self._pairs = PairTape() if plan.pairs else None
        self.begun: Lockstep
        self.log: RunTape
        self.truth: Truth
        self._cycles = 0

    def tape(self, clock: ManualClock) -> RunTape:
        self.log = RunTape(clock, self._beside(clock))
        return self.log

    def __call__(self, run: Lockstep, place: TruePlace) -> None:
        if not self._cycles:
            self.begun, self.truth = run, Truth(run)
        self._cycles += 1
        self.truth.look(place)
        self._look(run)
        if self._pairs is not None:
            self._pairs.look(run)
        if self._cycles % LOOK_CYCLES == 0 and time.process_time() > self._until_s:
            raise TooLong(f"not over after {self._limit_s:g} s of computing, {run.elapsed_s:.0f} s at sea")

    def sailed(self, events: list[Event], end: str) -> Sailed:
        """The run when it has ended, with its end in words."""
        pairs = None if self._pairs is None else " ".join(map(str, sorted(self._pairs.met)))
        return Sailed(self.begun, self.log, self.truth, events, end, pairs)


def code() -> str:
    """A digest of the sources as they are imported here, folder or archive: a version number does not show what was edited."""
    digest = hashlib.sha256()
    for found in sorted(pkgutil.walk_packages(delfim.__path__, "delfim."), key=lambda module: module.name):
        spec = find_spec(found.name)
        if spec is not None and spec.origin is not None and spec.loader is not None:
            digest.update(spec.loader.get_data(spec.origin))  # type: ignore[attr-defined]
    return digest.hexdigest()[:8]


# Of all that may change a run's last byte: where sin and atan2 come from, too.
MACHINE: Final = " ".join(filter(None, (platform.machine(), *platform.libc_ver())))
VERSION: Final = f"delfim {delfim.__version__} code {code()} python {platform.python_version()} on {MACHINE}"


def sail_batch(plan: Plan, batch: Batch, version: str) -> list[dict[str, Any]]:
    """Sail a batch; returns a dict for each run, plain values only. Raises DelfimError where this worker has other code than
    the one that ordered it."""
    if version != VERSION:
        raise DelfimError(f"this worker has {VERSION}, the campaign {version}")
    rows = list[dict[str, Any]]()
    with uncollected():
        for point, seed in batch.runs:
            rows.append(one(plan, batch.number, point, seed))
            gc.collect(1)
    return rows


def one(plan: Plan, number: int, point: int, seed: int) -> dict[str, Any]:
    """Sail a run. One that cannot be sailed is a row too, with its error."""
    began_s, worked_s = time.perf_counter(), time.process_time()
    values = plan.values(point, seed)
    story = plan.stories[plan.points[point][0]]
    row: dict[str, Any] = {"batch": number, "point": point, "seed": seed, "vehicle": story.boat, "story": story.name} | values
    try:
        if plan.is_adoption:
            its, failures = _adopted(plan, laid(story.vehicle, values), story.boat, seed)
        else:
            sailed, failures = judged(plan, drawn_run(plan, point, seed), seed)
            its = {measure.name: measure.value(sailed) for measure in MEASURES}
        row |= {"ok": not failures, "failures": failures, "error": ""} | its
    except Exception as error:  # a defect, or a limit: a result of this run, not the end of the campaign
        row |= {"ok": False, "failures": [], "error": f"{type(error).__name__}: {error}"}
    return row | {
        "wall_s": time.perf_counter() - began_s,
        "cpu_s": time.process_time() - worked_s,
        "host": platform.node(),
        "pid": os.getpid(),
        "version": VERSION,
    }


def _adopted(plan: Plan, boat: dict[str, Any], name: str, seed: int) -> tuple[dict[str, Any], list[str]]:
    """Adopt a drawn boat; returns the columns, and what failed."""
    from delfim.campaign.adopted import whole  # it needs numpy

    until_s = time.process_time() + plan.limit_s

    def look() -> None:
        if time.process_time() > until_s:
            raise TooLong(f"not over after {plan.limit_s:g} s of computing")

    return whole.figures(boat, name, seed, look)


def judged(plan: Plan, drawn: "Drawn", seed: int) -> tuple[Sailed, list[str]]:
    """Sail a run; returns what failed in it, and where the campaign wants the second auditor, what he finds in its log, too."""
    if not plan.audit:
        return sailed_drawn(plan, drawn, seed)
    from delfim.audit import auditor  # it needs numpy, which a run that nobody audits does not

    with TemporaryDirectory(prefix="delfim-audit-") as folder:
        sailed, failures = sailed_drawn(plan, drawn, seed, log=folder)
        return sailed, [*failures, *(f"audit: {words}" for words in auditor.complaints(folder))]


class Drawn(NamedTuple):
    """The settings and scenario that a run sails."""

    boat: dict[str, Any]  # the vehicle's file as a tree, with the campaign's values over it
    values: dict[str, Any]  # they lie over what the scenario lays upon it, too
    scenario: Scenario | None
    mission: str  # its text

    def settings(self, name: str, log: str = "") -> config.Vehicle:
        """The settings of the run. `log`: a folder for the state log. Raises ConfigError in the name of what is wrong."""
        tree = self.boat if self.scenario is None else laid(laid_upon(self.boat, self.scenario), self.values)
        kept = {"log.directory": log, "log.state_method": "write"} if log else {}
        return config.read(laid(tree, kept), name)


def drawn_run(plan: Plan, point: int, seed: int) -> Drawn:
    """Draw the run of a point and a seed. Raises DelfimError."""
    story, (values, faults) = plan.stories[plan.points[point][0]], parted(plan.values(point, seed))
    if plan.is_adoption:
        raise DelfimError(f"a trial is a dialogue: delfim adopt etc/boats/{story.boat}.toml --sim {seed} --yes has it again")
    boat, scenario, mission = laid(story.vehicle, values), None, story.mission
    if story.scenario is not None:
        scenario = tables.decode(story.scenario, Scenario, story.name)
        if scenario.encounters == RANDOM:
            _, scenario, mission = staged(scenario, drawn(seed, scenario.speed_mps or OWN_MPS))
        if faults:
            scenario = broken_of(scenario, faults, plan.name)
    elif not story.mission:
        settings = config.read(boat, plan.name)
        scenario, mission = DRAWN[story.name](seed, settings), mixed_mission(settings.of(Simulation))
    return Drawn(boat, values, scenario, mission)


def sailed_run(
    plan: Plan, point: int, seed: int, look: Callable[[Lockstep], object] = lambda run: None, log: str = ""
) -> tuple[Sailed, list[str]]:
    """Sail the run of a point and a seed; returns it and what failed in it, in words. `look` is called after each cycle; `log`
    is a folder for its state log. Raises DelfimError."""
    return sailed_drawn(plan, drawn_run(plan, point, seed), seed, look, log)


def sailed_drawn(
    plan: Plan, drawn: Drawn, seed: int, look: Callable[[Lockstep], object] = lambda run: None, log: str = ""
) -> tuple[Sailed, list[str]]:
    """Sail a drawn run, as `sailed_run`."""
    settings, scenario = drawn.settings(plan.name, log), drawn.scenario
    watch = _Watch(plan, look, lambda clock: Logbook(settings, clock) if log else NoLog())
    if scenario is None:
        run = Lockstep(settings, seed, watch.tape)
        place = TruePlace(run)

        def looks(run: Lockstep) -> None:
            place.look()
            watch(run, place)

        end = run.sail(drawn.mission, plan.seconds, looks)
        run.close()
        return watch.sailed([], end), [] if end.startswith("mission done") else [end]
    result = sail(scenario, settings, seed, drawn.mission, watch.tape, look=watch)
    return watch.sailed(result.events, watch.truth.reason), result.failures
