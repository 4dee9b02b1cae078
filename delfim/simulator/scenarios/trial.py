"""A scenario sailed in lock step, and its results compared with the expected ones.

Every run is also checked against the invariants of `delfim.simulator.invariants.onlooker`.
"""

import contextlib
import math
import sys
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Final, Literal, NamedTuple

import msgspec

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.errors import ConfigError
from delfim.base.modes import Mode
from delfim.simulator.invariants.onlooker import TURNS, Onlooker, TruePlace
from delfim.simulator.lockstep import Lockstep, uncollected
from delfim.simulator.nodes import Nodes
from delfim.simulator.nodes.other_vessels import Vessel
from delfim.simulator.payloadprogram import PayloadProgram
from delfim.simulator.scenarios.encounters import OWN_MPS, RANDOM, drawn, staged, staged_of
from delfim.simulator.scenarios.scenario import Expect, OperatorWord, Scenario, fault_of, load_scenario, settings_of
from delfim.vehicle import console
from delfim.vehicle.log.logbook import Logbook
from delfim.vehicle.state import NoLog, StateLog

RETRY_S: Final = 1.0  # a refused operator repeats the order at this interval ...
PATIENCE_S: Final = 15.0  # ... and gives up after this time
GUEST_S: Final = 0.5
HELD_S: Final = 0.5


class Event(NamedTuple):
    """One event of a run."""

    t_s: float
    kind: Literal["command", "fault", "mode", "notice", "propellers"]
    name: str
    text: str = ""


class Result(NamedTuple):
    events: list[Event]
    failures: list[str]  # in words; empty: the run passed
    elapsed_s: float


class Recorder:
    """The run's history, as events."""

    def __init__(self, run: Lockstep) -> None:
        self._run, self.events, self._drives = run, list[Event](), run.nodes.model.drives
        self._mode: Mode | None = None
        self._reason = ""
        self._notices: set[tuple[str, str]] = set()
        self._stopped = False
        self.nearest_m: list[float] = []

    def add(self, kind: Literal["command", "fault"], name: str, text: str = "") -> None:
        self.events.append(Event(self._run.elapsed_s, kind, name, text))

    def look(self) -> None:
        state, now_s = self._run.state, self._run.elapsed_s
        if state.mode is not self._mode or state.reason != self._reason:
            self._mode, self._reason = state.mode, state.reason
            self.events.append(Event(now_s, "mode", state.mode.name.lower(), state.reason))
        if state.notices or self._notices:
            present = {(notice.name, notice.action) for notice in state.notices}
            news = [notice for notice in state.notices if (notice.name, notice.action) not in self._notices]
            self.events += [Event(now_s, "notice", notice.name, f"{notice.reason}: {notice.action}") for notice in news]
            self._notices = present
        stopped = max([abs(drive.part) for drive in self._drives.values()]) <= TURNS
        if stopped is not self._stopped:
            self._stopped = stopped
            self.events.append(Event(now_s, "propellers", "stopped" if stopped else "turning"))

    def passes(self, place: TruePlace) -> None:
        """Note how near the boat's true position came to each waypoint."""
        plan, at = self._run.state.setpoint.plan, place.at
        if plan is None or at is None:
            return
        if len(self.nearest_m) != len(plan.waypoints):
            self.nearest_m = [math.inf] * len(plan.waypoints)
        for number, to in enumerate(plan.waypoints):
            away_m = math.hypot(at[0] - to.north_m, at[1] - to.east_m) - to.acceptance_m
            self.nearest_m[number] = min(self.nearest_m[number], away_m)


@uncollected()
def sail(
    scenario: Scenario,
    settings: config.Vehicle,
    seed: int,
    mission: str = "",
    make_log: Callable[[ManualClock], StateLog] | None = None,
    *,
    look: Callable[[Lockstep, TruePlace], object] | None = None,
) -> Result:
    """Sail one run. `mission` is the text of the scenario's mission file. The same seed gives the same bytes. `look` is called
    after each cycle."""
    run = Lockstep(settings, seed, make_log or (lambda clock: NoLog()), handset=scenario.handset)
    watch = Onlooker(run, facts=True)
    recorder, operator = Recorder(run), Operator(run, watch, scenario, mission)
    faults = [(each.at_s, fault_of(each, run.faults.thrusters)) for each in scenario.fault]
    broken = deque(sorted(faults, key=lambda pair: pair[0]))
    guest_s, counts_waypoints = 0.0, any(expected.waypoints for expected in scenario.expect)
    with contextlib.ExitStack() as last:
        programs = [
            last.enter_context(PayloadProgram(name, (sys.executable, *words), watch.order))
            for name, words in scenario.payload.items()
        ]
        for _ in run.cycles(scenario.seconds):
            watch.look()
            while broken and broken[0][0] <= run.elapsed_s:
                each = broken.popleft()[1]
                recorder.add("fault", each.kind, each.where)
                run.breaks(each)
            if scenario.guest is not None and run.elapsed_s >= guest_s:
                guest_s = run.elapsed_s + GUEST_S
                run.guest_says(msgspec.json.encode(scenario.guest))
                watch.ready()
            for program in programs:
                program.turn(run)
            operator.speak(recorder)
            recorder.look()
            if look is not None:
                look(run, watch.place)
            if counts_waypoints:
                recorder.passes(watch.place)
    missed = [words for expected in scenario.expect if (words := _missed(expected, recorder, run.elapsed_s, run.nodes))]
    run.close()
    return Result(recorder.events, [*watch.failures, *operator.failures, *missed], run.elapsed_s)


class Operator:
    """Gives a scenario's orders: each until it is obeyed, refused as expected, or given up."""

    def __init__(self, run: Lockstep, watch: Onlooker, scenario: Scenario, mission: str) -> None:
        self._run, self._watch, self._patience_s = run, watch, PATIENCE_S if scenario.patient else 0.0
        orders = [OperatorWord.of(words) for words in scenario.command]
        if mission:
            orders.append(OperatorWord(-1.0, console.LoadMission(mission)))
        self._orders = deque(sorted(orders, key=lambda order: order.at_s))
        self._again_s = self._held_s = 0.0
        self._held: console.Commands | None = None
        self.failures: list[str] = []

    def speak(self, recorder: Recorder) -> None:
        """Give the orders that are due now."""
        now_s = self._run.elapsed_s
        if self._held is not None and now_s >= self._again_s:
            self._again_s = now_s + HELD_S
            self._watch.order(self._held, "scenario")
            self._held = self._held if now_s < self._held_s else None
        elif self._orders and self._orders[0].at_s <= now_s and now_s >= self._again_s:
            order = self._orders[0]
            if self._give(order, recorder):
                self._orders.popleft()
            else:
                self._again_s = now_s + RETRY_S

    def _give(self, order: OperatorWord, recorder: Recorder) -> bool:
        """Give an order; returns whether the operator is done with it."""
        name, now_s = str(order.command.__struct_config__.tag), self._run.elapsed_s
        why = self._watch.order(order.command, "scenario")
        if order.refused:
            recorder.add("command", name, f"refused: {why}" if why else "")
            if order.refused not in (why or ""):
                self.failures.append(f"{name} at {order.at_s:g} s: {why or 'obeyed'}, not refused with {order.refused!r}")
            return True
        if why is None:
            recorder.add("command", name)
            if order.held_s:
                self._held, self._held_s, self._again_s = order.command, now_s + order.held_s, now_s + HELD_S
            return True
        if now_s - order.at_s < self._patience_s:
            return False
        if self._patience_s:
            self.failures.append(f"{name} at {order.at_s:g} s: {why}")
        return True


def _missed(expected: Expect, recorder: Recorder, end_s: float, nodes: Nodes) -> str | None:
    """The reason, in words, why a run misses an expected result; None: it does not."""
    if expected.waypoints:
        reached = sum(away_m <= 1.0 for away_m in recorder.nearest_m)
        return None if reached >= expected.waypoints else f"{reached} of {expected.waypoints} waypoints reached"
    if expected.nearest or expected.nearest_m:
        return _too_near(expected, nodes.vessels)
    if expected.clear_m:
        near = [f"{each.nearest_m:.1f} m from {each.name}" for each in nodes.things if each.nearest_m < expected.clear_m]
        return ", ".join(near) or None
    kind, name = next((k, n) for k in ("mode", "notice", "propellers") if (n := getattr(expected, k)))
    since_s = _since(expected.after, recorder.events)
    what = f"{kind} {name}" + (f" ({expected.reason})" if expected.reason else "")
    if since_s is None:
        return f"{what}: {expected.after} never happened"
    fits = [event for event in recorder.events if event.kind == kind]
    there = [e for e in fits if e.t_s >= since_s and e.name == name and expected.reason in e.text]
    before = [e for e in fits if e.t_s < since_s][-1:]
    if kind != "notice" and before and before[0].name == name and expected.reason in before[0].text:
        there = [before[0]._replace(t_s=since_s), *there]
    if expected.never:
        return f"{what} at {there[0].t_s:.1f} s, never expected after {expected.after}" if there else None
    if not there:
        return f"{what}: not after {expected.after}"
    if there[0].t_s - since_s > expected.within_s + 1e-6:
        return f"{what}: {there[0].t_s - since_s:.1f} s after {expected.after}, not {expected.within_s:g} s"
    if expected.at_end and (fits[-1].name != name or expected.reason not in fits[-1].text):
        return f"{what}: at {end_s:.0f} s it is {fits[-1].name} ({fits[-1].text})"
    return None


def _too_near(expected: Expect, vessels: Sequence[Vessel]) -> str | None:
    """Whether a vessel came too near in truth, whatever the boat received."""
    for vessel in vessels:
        if vessel.nearest < expected.nearest or vessel.nearest_m < expected.nearest_m:
            near = f"{vessel.nearest_m:.0f} m and {vessel.nearest:.2f} domains"
            return f"{vessel.row.name or vessel.mmsi} was as near as {near} at {vessel.nearest_s:.0f} s"
    return None


def _since(after: float | str, events: list[Event]) -> float | None:
    if not isinstance(after, str):
        return after
    return next((e.t_s for e in reversed(events) if e.kind in ("fault", "command") and e.name == after), None)


def run_file(
    path: str | Path, vehicle: str | Path, seed: int, overrides: tuple[str, ...] = (), *, logged: bool = False
) -> Result:
    """Sail a scenario file; FILE:NAME is one of its encounters. `logged`: its log is written, too. Raises ConfigError."""
    file, _, name = str(path).partition(".toml:")
    file = f"{file}.toml" if name else file
    here = load_scenario(file)
    if here.encounters == RANDOM:
        _, scenario, mission = staged(here, drawn(seed, here.speed_mps or OWN_MPS))
    else:
        found = {each.name: each for each in staged_of(here, file)}
        if name not in found:
            raise ConfigError(file, "encounters", f"{name or 'no name'}: name one, as {file}:{next(iter(found))}")
        _, scenario, mission = found[name]
    settings = settings_of(scenario, vehicle, overrides)
    return sail(scenario, settings, seed, mission, partial(Logbook, settings) if logged else None)


def report(result: Result) -> list[str]:
    """Format the events and the verdict, a line each."""
    lines = [f"{e.t_s:7.1f} s  {e.kind:10} {e.name}{f'  {e.text}' if e.text else ''}" for e in result.events]
    return lines + [f"FAILED: {words}" for words in result.failures]
