"""What a worker does: it sails the runs of a batch and says of each what came of it. It knows nothing of who asked."""

import gc
import hashlib
import os
import pkgutil
import platform
import time
from collections.abc import Callable
from importlib.util import find_spec
from tempfile import TemporaryDirectory
from typing import Any, Final

import delfim
from delfim import config, tables
from delfim.campaign.measures import MEASURES, RunTape, Sailed, Truth
from delfim.campaign.runplan import Batch, Plan, broken_of, laid, parted
from delfim.clock import ManualClock
from delfim.errors import DelfimError
from delfim.simulator.chased import DRAWN
from delfim.simulator.encounters import OWN_MPS, RANDOM, drawn, staged
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.mixed import mixed_mission
from delfim.simulator.scenario import Scenario, laid_upon
from delfim.simulator.trial import sail
from delfim.simulator.watch import TruePlace
from delfim.vehicle.logbook import Logbook
from delfim.vehicle.state import NoLog, StateLog

LOOK_CYCLES: Final = 100  # the time of the processor is looked at so often


class TooLong(DelfimError):
    """A run took more computing than `limit_s`."""


class _Watch:
    """Looks at a run after each cycle."""

    def __init__(self, limit_s: float, look: Callable[[Lockstep], object], beside: Callable[[ManualClock], StateLog]) -> None:
        self._until_s, self._limit_s = time.process_time() + limit_s, limit_s
        self._look, self._beside = look, beside
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
        if self._cycles % LOOK_CYCLES == 0 and time.process_time() > self._until_s:
            raise TooLong(f"not over after {self._limit_s:g} s of computing, {run.elapsed_s:.0f} s at sea")


def code() -> str:
    """A digest of the sources as they are imported here, folder or archive: a version number does not say what was edited."""
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
    """A dict a run, plain values only. Raises DelfimError where this worker has other code than who asks."""
    if version != VERSION:
        raise DelfimError(f"this worker has {VERSION}, the campaign {version}")
    rows = list[dict[str, Any]]()
    gc.disable()  # a run leaves little garbage: to look for it meanwhile costs a twelfth of the time
    try:
        for point, seed in batch.runs:
            rows.append(one(plan, batch.number, point, seed))
            gc.collect(1)
    finally:
        gc.enable()
    return rows


def one(plan: Plan, number: int, point: int, seed: int) -> dict[str, Any]:
    """A run. One that cannot be sailed is a row too, with its error."""
    began_s, worked_s = time.perf_counter(), time.process_time()
    values = plan.values(point, seed)
    story = plan.stories[plan.points[point][0]]
    row: dict[str, Any] = {"batch": number, "point": point, "seed": seed, "vehicle": story.boat, "story": story.name} | values
    try:
        sailed, failures = (_audited if plan.audit else sailed_run)(plan, point, seed)
        row |= {"ok": not failures, "failures": failures, "error": ""}
        row |= {measure.name: measure.value(sailed) for measure in MEASURES}
    except Exception as error:  # a defect, or a limit: a result of this run, not the end of the campaign
        row |= {"ok": False, "failures": [], "error": f"{type(error).__name__}: {error}"}
    return row | {
        "wall_s": time.perf_counter() - began_s,
        "cpu_s": time.process_time() - worked_s,
        "host": platform.node(),
        "pid": os.getpid(),
        "version": VERSION,
    }


def _audited(plan: Plan, point: int, seed: int) -> tuple[Sailed, list[str]]:
    """The same with its log, which the second auditor judges; what it finds is among the failures."""
    from delfim.audit import auditor  # it needs numpy, which a run that nobody audits does not

    with TemporaryDirectory(prefix="delfim-audit-") as folder:
        sailed, failures = sailed_run(plan, point, seed, log=folder)
        return sailed, [*failures, *(f"audit: {words}" for words in auditor.complaints(folder))]


def sailed_run(
    plan: Plan, point: int, seed: int, look: Callable[[Lockstep], object] = lambda run: None, log: str = ""
) -> tuple[Sailed, list[str]]:
    """The run of a point and a seed, and what failed in it, in words. `look` is called after each cycle; `log` is a folder for
    its state log. Raises DelfimError."""
    story, (values, faults) = plan.stories[plan.points[point][0]], parted(plan.values(point, seed))
    tree = laid(story.vehicle, values | ({"log.directory": log, "log.state_method": "write"} if log else {}))
    scenario, mission, patient = None, story.mission, True
    if story.scenario is not None:
        scenario = tables.decode(story.scenario, Scenario, story.name)
        if scenario.encounters == RANDOM:
            _, scenario, mission = staged(scenario, drawn(seed, scenario.speed_mps or OWN_MPS))
        if faults:
            scenario = broken_of(scenario, faults, plan.name)
    elif not story.mission:
        settings = tables.decode(tree, config.Vehicle, plan.name)
        scenario, mission, patient = DRAWN[story.name](seed, settings), mixed_mission(settings.simulation), False
    if scenario is not None:
        tree = laid(laid_upon(tree, scenario), values)  # the campaign's values lie uppermost
    settings = tables.decode(tree, config.Vehicle, plan.name)
    watch = _Watch(plan.limit_s, look, lambda clock: Logbook(settings, clock) if log else NoLog())
    if scenario is None:
        run = Lockstep(settings, seed, watch.tape)
        place = TruePlace(run)

        def looks(run: Lockstep) -> None:
            place.look()
            watch(run, place)

        end = run.sail(mission, plan.seconds, looks)
        run.close()
        return Sailed(run, watch.log, watch.truth, [], end), [] if end.startswith("mission done") else [end]
    result = sail(scenario, settings, seed, mission, watch.tape, patient=patient, look=watch)
    return Sailed(watch.begun, watch.log, watch.truth, result.events, watch.truth.reason), result.failures
