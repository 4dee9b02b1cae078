"""Scenarios: what an operator does, what breaks, and what must come of it, in a text file, sailed in lock step.

Beside what a scenario expects, every run is watched for what must never happen (`Watch`). `docs/scenarios.md` has the
format by example.
"""

import json
import math
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple, Self

import msgspec

from delfim import config, tables
from delfim.clock import ManualClock
from delfim.errors import ConfigError, FormatError, in_words
from delfim.modes import Mode
from delfim.outside import parse_toml, read_text
from delfim.simulator.faults import Fault, fault
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console, fence
from delfim.vehicle.state import State, StateLog

RETRY_S: Final = 1.0  # an operator who was refused asks again so often ...
PATIENCE_S: Final = 15.0  # ... and gives up after so long
GUEST_S: Final = 0.5
HELD_S: Final = 0.5
TURNS_RPM: Final = 120.0  # a propeller that gives thrust worth the name
COAST_S: Final = 4.0  # until a stopped one does not any more
ASTRAY_S: Final = 12.0  # the same where it does not obey: seen, disconnected, coasted
BLIND_S: Final = 0.5  # beyond its limit, for the watchdog to come round
NOISE_M: Final = 1.5  # between where the boat is and where it can know itself to be
DECEIVED_M: Final = 3.0  # a boat that is told to be farther off than this cannot keep a fence

DAY_S: Final = 86_400.0
Time = Annotated[float, msgspec.Meta(ge=0.0, le=DAY_S)]


class FaultAt(tables.Table, frozen=True):
    """Something breaks."""

    at_s: Time
    kind: str
    where: str = ""
    value: float | None = None
    for_s: float | None = None  # to the end where not given


class Expect(tables.Table, frozen=True):
    """What must come of it: a mode, a notice, propellers that stand still, or waypoints reached."""

    mode: str = ""
    notice: str = ""  # a trouble's name
    propellers: Literal["", "stopped"] = ""
    waypoints: Annotated[int, msgspec.Meta(ge=0)] = 0  # of the mission, passed within their radius
    reason: str = ""  # contained in the reason of the mode or the notice
    after: float | str = 0.0  # a time in s, a kind of fault, or a word of the operator; its last occurrence
    within_s: float = math.inf  # of that
    at_end: bool = False  # and then to the end of the run
    never: bool = False  # not at all after that

    def __post_init__(self) -> None:
        if sum(map(bool, (self.mode, self.notice, self.propellers, self.waypoints))) != 1:
            raise ValueError("one of mode, notice, propellers, waypoints")


class Guest(tables.Table, frozen=True):
    """What the guest computer asks for, twice a second."""

    heading_deg: float
    speed_mps: float


class Scenario(tables.Table, frozen=True):
    """A scenario file."""

    version: Literal[1]
    name: str
    seconds: Annotated[float, msgspec.Meta(gt=0.0, le=86_400.0)]
    mission: str = ""  # a mission file, beside this one
    vehicle: dict[str, Any] = msgspec.field(default_factory=dict)  # tables laid over the vehicle's file
    guest: Guest | None = None
    command: tuple[dict[str, Any], ...] = ()  # the operator's words with `at_s`, and `held_s` or `refused` (class Order)
    fault: tuple[FaultAt, ...] = ()
    expect: tuple[Expect, ...] = ()


class Event(NamedTuple):
    """Something that happened."""

    t_s: float
    kind: Literal["command", "fault", "mode", "notice", "propellers"]
    name: str
    text: str = ""


class Result(NamedTuple):
    events: list[Event]
    failures: list[str]  # in words; empty when all is as it must be
    elapsed_s: float


def load_scenario(path: str | Path) -> Scenario:
    """A scenario, its faults and commands checked. Raises ConfigError."""
    scenario = tables.decode(tables.read_toml(path), Scenario, str(path))
    key = ""
    try:
        for number, broken in enumerate(scenario.fault):
            key = f"fault[{number}]"
            _fault(broken)
        for number, words in enumerate(scenario.command):
            key = f"command[{number}]"
            Order.of(words)
    except FormatError as error:
        raise ConfigError(str(path), key, str(error)) from None
    return scenario


def settings_of(scenario: Scenario, vehicle: str | Path, overrides: tuple[str, ...] = ()) -> config.Vehicle:
    """The vehicle's file with the scenario's tables laid over it. Raises ConfigError."""
    return tables.decode(_laid_over(tables.read_toml(vehicle, overrides), scenario.vehicle), config.Vehicle, str(vehicle))


def _laid_over(tree: dict[str, Any], upper: dict[str, Any]) -> dict[str, Any]:
    both = {key: _laid_over(tree[key], value) for key, value in upper.items() if isinstance(tree.get(key), dict)}
    return {**tree, **upper, **both}


class Order(NamedTuple):
    """A word of the operator."""

    at_s: float
    command: console.Commands
    refused: str = ""  # it must be, in these words; empty: it must not
    held_s: float = 0.0  # once obeyed it is given again twice a second for so long, as by a stick that is pushed

    @classmethod
    def of(cls, words: dict[str, Any]) -> Self:
        """From a table of a scenario. Raises FormatError."""
        rest = {**words}
        at_s, refused, held_s = rest.pop("at_s", None), rest.pop("refused", ""), rest.pop("held_s", 0.0)
        is_timed = all(isinstance(each, float | int) and 0.0 <= each <= DAY_S for each in (at_s, held_s))
        if not is_timed or not isinstance(refused, str):
            raise FormatError("a command needs at_s, seconds up to a day; held_s, too, is seconds, and refused is text")
        command = json.dumps(rest, default=str).encode()  # no command holds a date
        return cls(float(at_s), console.parse(command), refused, float(held_s))


class Watch:
    """What must never happen, in any run, whatever breaks. `look` after each cycle."""

    def __init__(self, run: Lockstep) -> None:
        self._run, self._model, self._settings = run, run.nodes.model, run.settings
        self.failures: list[str] = []
        self._turning_since_s = math.inf
        self._was_inside, self._astray = True, False

    def look(self) -> None:
        run, state = self._run, self._run.state
        now_s, sent, limits = run.elapsed_s, state.actuation, self._settings
        idle = state.mode is Mode.IDLE
        fastest = max(abs(sent.starboard_rpm), abs(sent.port_rpm))
        if not fastest <= limits.propulsion.rpm_max or (fastest and (idle or not sent.run)):
            self._fail(f"commanded {sent}")
        if idle and not state.reason:
            self._fail("stopped without a reason")
        if not idle and now_s - state.navigation_s > limits.failsafe.navigation_silent.after_s + BLIND_S:
            self._fail(f"sailing blind in mode {state.mode.name.lower()}")
        self._adrift(idle, now_s)
        if (around := run.vehicle.helm.plans.fence) is not None:
            self._fenced(around, state, idle)

    def _adrift(self, idle: bool, now_s: float) -> None:
        """Propellers that give thrust for a boat that nobody steers. A bus that is away is not the boat's fault."""
        model, on = self._model, self._run.faults.on
        turns = max(abs(model.starboard.rpm), abs(model.port.rpm)) > TURNS_RPM
        if not (idle and turns) or "bus_off" in on or any(kind.startswith("frames_") for kind in on):
            self._turning_since_s, self._astray = math.inf, False
            return
        self._turning_since_s = min(self._turning_since_s, now_s)
        self._astray = self._astray or model.starboard.fault is not None or model.port.fault is not None
        if now_s - self._turning_since_s > (ASTRAY_S if self._astray else COAST_S):
            self._fail("adrift under power")

    def _fenced(self, around: fence.Fence, state: State, idle: bool) -> None:
        """A boat that obeys, knows where it is and drives must not leave its fence; one that was stopped drifts."""
        model, origin = self._model, state.origin
        if origin is None:
            return
        north_m = (model.latitude_rad - origin.latitude_rad) * origin.north_m_per_rad
        east_m = (model.longitude_rad - origin.longitude_rad) * origin.east_m_per_rad
        inside = all(fence.clearance_m(zone, north_m, east_m) > -NOISE_M for zone in around.zones)
        deceived = math.dist((north_m, east_m), (state.motion.north_m, state.motion.east_m)) > DECEIVED_M
        obeys = not model.starboard.fault and not model.port.fault
        if self._was_inside and not inside and not idle and obeys and not deceived:
            self._fail(f"outside the fence in mode {state.mode.name.lower()}")
        self._was_inside = inside

    def _fail(self, words: str) -> None:
        if not any(words in known for known in self.failures):
            self.failures.append(f"{words} at {self._run.elapsed_s:.1f} s ({self._run.state.reason})")


class Recorder:
    """What happened, as events."""

    def __init__(self, run: Lockstep) -> None:
        self._run, self.events = run, list[Event]()
        self._mode: tuple[Mode, str] | None = None
        self._notices: set[tuple[str, str]] = set()
        self._stopped = False
        self.nearest_m: list[float] = []

    def add(self, kind: Literal["command", "fault"], name: str, text: str = "") -> None:
        self.events.append(Event(self._run.elapsed_s, kind, name, text))

    def look(self) -> None:
        state, model, now_s = self._run.state, self._run.nodes.model, self._run.elapsed_s
        if (state.mode, state.reason) != self._mode:
            self._mode = state.mode, state.reason
            self.events.append(Event(now_s, "mode", state.mode.name.lower(), state.reason))
        if state.notices or self._notices:
            present = {(notice.name, notice.action) for notice in state.notices}
            news = [notice for notice in state.notices if (notice.name, notice.action) not in self._notices]
            self.events += [Event(now_s, "notice", notice.name, f"{notice.reason}: {notice.action}") for notice in news]
            self._notices = present
        stopped = max(abs(model.starboard.rpm), abs(model.port.rpm)) <= TURNS_RPM
        if stopped is not self._stopped:
            self._stopped = stopped
            self.events.append(Event(now_s, "propellers", "stopped" if stopped else "turning"))

    def passes(self) -> None:
        """How near the boat, in truth, came to each waypoint."""
        state, model = self._run.state, self._run.nodes.model
        plan, origin = state.setpoint.plan, state.origin
        if plan is None or origin is None:
            return
        if len(self.nearest_m) != len(plan.waypoints):
            self.nearest_m = [math.inf] * len(plan.waypoints)
        north_m = (model.latitude_rad - origin.latitude_rad) * origin.north_m_per_rad
        east_m = (model.longitude_rad - origin.longitude_rad) * origin.east_m_per_rad
        for number, to in enumerate(plan.waypoints):
            away_m = math.hypot(north_m - to.north_m, east_m - to.east_m) - to.acceptance_m
            self.nearest_m[number] = min(self.nearest_m[number], away_m)


def sail(
    scenario: Scenario,
    settings: config.Vehicle,
    seed: int,
    mission: str = "",
    make_log: Callable[[ManualClock], StateLog] | None = None,
    *,
    patient: bool = True,
) -> Result:
    """One run. `mission` is the text of the scenario's mission file. The same seed gives the same bytes. An operator who is not
    patient gives an order once and takes a refusal for an answer.
    """
    run = Lockstep(settings, seed, make_log or Silence)
    watch, recorder, operator = Watch(run), Recorder(run), Operator(run, scenario, mission, patient)
    broken = deque(sorted(((each.at_s, _fault(each)) for each in scenario.fault), key=lambda pair: pair[0]))
    guest_s = 0.0
    for _ in run.cycles(scenario.seconds):
        while broken and broken[0][0] <= run.elapsed_s:
            each = broken.popleft()[1]
            recorder.add("fault", each.kind, each.where)
            run.breaks(each)
        if scenario.guest is not None and run.elapsed_s >= guest_s:
            guest_s = run.elapsed_s + GUEST_S
            run.guest_says(msgspec.json.encode(scenario.guest))
        operator.speak(recorder)
        watch.look()
        recorder.look()
        if any(expected.waypoints for expected in scenario.expect):
            recorder.passes()
    missed = [words for expected in scenario.expect if (words := _missed(expected, recorder, run.elapsed_s))]
    run.close()
    return Result(recorder.events, [*watch.failures, *operator.failures, *missed], run.elapsed_s)


class Operator:
    """Who gives a scenario's orders: each until it is obeyed, or refused as it should be, or given up."""

    def __init__(self, run: Lockstep, scenario: Scenario, mission: str, patient: bool) -> None:
        self._run, self._patience_s = run, PATIENCE_S if patient else 0.0
        orders = [Order.of(words) for words in scenario.command]
        if mission:
            orders.append(Order(-1.0, console.Mission(mission)))
        self._orders = deque(sorted(orders, key=lambda order: order.at_s))
        self._again_s = self._held_s = 0.0
        self._held: console.Commands | None = None
        self.failures: list[str] = []

    def speak(self, recorder: Recorder) -> None:
        """What is due now."""
        now_s = self._run.elapsed_s
        if self._held is not None and now_s >= self._again_s:
            self._again_s = now_s + HELD_S
            self._run.command(self._held)
            self._held = self._held if now_s < self._held_s else None
        elif self._orders and self._orders[0].at_s <= now_s and now_s >= self._again_s:
            order = self._orders[0]
            if self._give(order, recorder):
                self._orders.popleft()
            else:
                self._again_s = now_s + RETRY_S

    def _give(self, order: Order, recorder: Recorder) -> bool:
        """Whether the operator is done with the order."""
        name, now_s = type(order.command).__name__.lower(), self._run.elapsed_s
        why = self._run.command(order.command)
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


def _missed(expected: Expect, recorder: Recorder, end_s: float) -> str | None:
    """What a run lacks of what was expected, in words."""
    if expected.waypoints:
        reached = sum(away_m <= 1.0 for away_m in recorder.nearest_m)
        return None if reached >= expected.waypoints else f"{reached} of {expected.waypoints} waypoints reached"
    kind, name = next((k, n) for k in ("mode", "notice", "propellers") if (n := getattr(expected, k)))
    since_s = _since(expected.after, recorder.events)
    what = f"{kind} {name}" + (f" ({expected.reason})" if expected.reason else "")
    if since_s is None:
        return f"{what}: there was no {expected.after}"
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


def _since(after: float | str, events: list[Event]) -> float | None:
    if not isinstance(after, str):
        return after
    return next((e.t_s for e in reversed(events) if e.kind in ("fault", "command") and e.name == after), None)


def _fault(asked: FaultAt) -> Fault:
    return fault(asked.kind, asked.where, asked.value, asked.for_s)


class Silence:
    """A state log that keeps nothing."""

    def __init__(self, clock: ManualClock) -> None:
        pass

    def write(self, state: State, now_s: float) -> None:
        pass

    def note(self, text: str) -> None:
        pass

    def reason(self) -> str:
        return ""

    def close(self) -> None:
        pass


def run_file(path: str | Path, vehicle: str | Path, seed: int, overrides: tuple[str, ...] = ()) -> Result:
    """A scenario file, sailed. Raises ConfigError."""
    scenario = load_scenario(path)
    return sail(scenario, settings_of(scenario, vehicle, overrides), seed, mission_of(scenario, path))


def mission_of(scenario: Scenario, path: str | Path) -> str:
    """The text of the mission beside a scenario file, empty where it names none. Raises ConfigError."""
    if not scenario.mission:
        return ""
    place = Path(path).parent / scenario.mission
    try:
        mission = read_text(place)
        parse_toml(mission)
    except (OSError, FormatError) as error:
        raise ConfigError(str(place), "file", in_words(error)) from None
    return mission


def report(result: Result) -> list[str]:
    """What happened and what it is worth, a line each."""
    lines = [f"{e.t_s:7.1f} s  {e.kind:10} {e.name}{f'  {e.text}' if e.text else ''}" for e in result.events]
    return lines + [f"FAILED: {words}" for words in result.failures]
