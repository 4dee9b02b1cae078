"""The contract of a laboratory's part, tried in simulation: silence, garbage, a line that takes nothing, stop, and a voyage.

    for each in tried("acme", "1.0"):
        assert not each.fault, each.what

Each is tried on a fresh boat: that of a vehicle's file which names the part, or the boat of the examples with it.
"""

import inspect
import json
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random
from typing import Any, Final, NamedTuple

from delfim import config
from delfim.base import parts
from delfim.base.clock import ManualClock
from delfim.base.errors import DelfimError, in_words
from delfim.base.frames import extended, standard
from delfim.base.parts import OrderRow, Part
from delfim.base.tables import read_toml
from delfim.canproxy.socket import ANYTHING, CanAddress, CanSocket
from delfim.lines.forms import Form
from delfim.simulator.line import LockstepLine
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.lockstepbus import LockstepBus
from delfim.simulator.nodes import nodes_of
from delfim.vehicle import console, foreign
from delfim.vehicle.failsafe.troubles import Inputs, Look
from delfim.vehicle.foreign import SLOW_S, is_sound, triggers
from delfim.vehicle.links import Links
from delfim.vehicle.navigation.fixes import open_source
from delfim.vehicle.propulsion.actuators import Actuator, open_actuator
from delfim.vehicle.sensors import module
from delfim.vehicle.state import Actuation, NoLog, State

BOAT: Final = str(Path(__file__).parents[1] / "etc/delfimx.toml")
PIECES: Final = 300  # of garbage
READS: Final = 100
TRIES: Final = 3  # of calls that are long
LONG_S: Final = 10.0 * SLOW_S  # of one call: then it is a fault
VOYAGE_S: Final = 60.0
THRUSTERS: Final = """thrusters=[{{name="starboard", driver="{0}", y_m=1.0, thrust_n=[-300.0, 500.0]}}, \
{{name="port", driver="{1}", address=1, y_m=-1.0, thrust_n=[-300.0, 500.0]}}]"""


class Tried(NamedTuple):
    what: str  # was tried
    fault: str  # in words; empty: it is as it must be
    worst_s: float = 0.0  # the longest call


class Wires:
    """All lines and buses that a part opens, with a device that sends there."""

    def __init__(self) -> None:
        self.clock = ManualClock()
        self.lines, self.buses = dict[str, DeafLine](), dict[str, LockstepBus]()
        self.links = Links(self._bus, self._line)
        self._ends = dict[str, CanSocket]()

    def _line(self, device: str, baud: int, form: Form = "8N1") -> LockstepLine:
        return self.lines.setdefault(device, DeafLine(self.clock))

    def _bus(self, interface: str, filters: tuple[CanAddress, ...]) -> CanSocket:
        if interface not in self.buses:
            self.buses[interface] = LockstepBus(self.clock, interface)
            self._ends[interface] = self.buses[interface].bound(ANYTHING, computer="devices")
        return self.buses[interface].bound(*filters)

    def say(self, data: bytes, chance: Random) -> None:
        """Send data on every line, and as frames on every bus."""
        for line in self.lines.values():
            line.put(data)
        for end in self._ends.values():
            arb = standard(chance.randrange(1 << 11)) if chance.random() < 0.5 else extended(chance.randrange(1 << 29))
            end.sendto(data[:8], CanAddress(arb))

    def sent(self) -> int:
        """The number of bytes and frames that the part has sent since."""
        count = sum(len(line.written) for line in self.lines.values())
        for line in self.lines.values():
            line.written.clear()
        return count + sum(len(list(_received(end))) for end in self._ends.values())

    def deaf(self) -> None:
        """Take nothing more from the part."""
        for line in self.lines.values():
            line.refuses = True
        for bus in self.buses.values():
            bus.off = True


class DeafLine(LockstepLine):
    refuses = False

    def write(self, data: bytes) -> bool:
        return False if self.refuses else super().write(data)


def _received(end: CanSocket) -> Iterator[object]:
    while (frame := end.receive()) is not None:
        yield frame


def settings_of(name: str, version: str, file: str = BOAT) -> config.Vehicle:
    """The settings of a vehicle's file that names the part, or of one with the part added. Raises ConfigError."""
    tree = read_toml(file)
    if name in tree.get("parts", {}):
        return config.load(file)
    named = f'parts.{name}="{version}"'
    part = parts.find(config.load(file, [named]).aboard, name)
    assert part is not None
    values = [THRUSTERS.format(name if part.drives.sides == "mixed" else "dsor", name)] if part.driver else []
    values += [f'navigation.sources=["{name}"]'] if part.source else []
    values += [f'sensors.names=["sysstat", "{name}"]'] if part.sensor else []
    return config.load(file, [named, *values])


def tried(name: str, version: str, file: str = BOAT) -> Iterator[Tried]:
    """Try all that the contract asks of the part of this name. Raises ConfigError where the vehicle's file or its row is
    refused."""
    settings = settings_of(name, version, file)
    part = parts.find(settings.aboard, name)
    assert part is not None
    yield from devices(part, settings)
    for trigger in triggers(settings) if part.troubles else ():
        reason = trigger.sees(Look(settings, State(), Inputs("", None), (), 0.0)) or ""
        what = f"trouble {trigger.name.lower()}: a boat that knows nothing yet"
        yield Tried(what, reason if "cannot tell" in reason else "")
    if part.service:
        faults = list[str]()
        with _trying(faults):
            if not inspect.iscoroutinefunction(parts.load(part, part.service)):
                faults.append(f"{part.service} is no coroutine function")
        yield Tried("service", "".join(faults))
    for mode in part.modes:
        yield from _mode(mode.name, settings)
    for order in part.orders:
        yield _order(part, order, settings)
    if part.driver or part.source or part.sensor or part.played:
        yield from _voyage(part, settings)


def devices(part: Part, settings: config.Vehicle) -> Iterator[Tried]:
    """Its driver, source and sensor, on lines and buses where nobody makes sense."""
    if part.driver:
        yield from _driver(part.name, settings)
    for kind in ("source", "sensor"):
        if getattr(part, kind):
            yield from _input(kind, part.name, settings)


@contextmanager
def _trying(found: list[str]) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # foreign code, of which anything may come
        found.append(f"it raised {type(error).__name__}: {in_words(error)}")


def judged(calls: Callable[[], tuple[list[float], str]]) -> tuple[str, float]:
    """What is wrong with these calls, and how long the longest takes, s. `calls` makes all of them, and answers with what each
    took and what was wrong. A busy machine holds up any call, but not the same one in each try: the shortest time counts."""
    least_s = list[float]()
    for _ in range(TRIES):
        took_s, fault = calls()
        least_s = list(map(min, least_s or took_s, took_s))
        if fault or max(least_s) <= LONG_S:
            break
    worst_s = max(least_s)
    return fault or (f"a call took {1e3 * worst_s:.1f} ms" if worst_s > LONG_S else ""), worst_s


class Stopwatch:
    """Counts calls, how long each took, and what they raised."""

    def __init__(self) -> None:
        self.took_s, self.faults = list[float](), list[str]()

    def __call__(self, call: Callable[..., Any], *arguments: Any) -> Any:
        began_s, result = time.perf_counter(), None
        with _trying(self.faults):
            result = call(*arguments)
        self.took_s.append(time.perf_counter() - began_s)
        return result

    def tried(self, what: str, fault: str = "") -> Tried:
        return Tried(what, next(iter(self.faults), fault), max(self.took_s))


def _driver(name: str, settings: config.Vehicle) -> Iterator[Tried]:
    wires, timed = Wires(), Stopwatch()
    driver: Actuator | None = timed(open_actuator, name, settings, wires.links)
    yield timed.tried(
        "opened, it commands nothing: a second one is opened before the start", "it spoke" if wires.sent() else ""
    )
    if driver is None:
        return
    count = len(settings.thrusters)
    full, still = Actuation((1.0,) * count, (0.0,) * count, True), Actuation((0.0,) * count, (0.0,) * count, False)
    timed, took = Stopwatch(), list[object]()
    for k in range(READS):
        took.append(timed(driver.send, full if k % 2 else still, 0.2 * k))
        if driver.period_s is not None:
            took.append(timed(driver.repeat, 0.2 * k + 0.1))
    wrong = next((f"send or repeat returned {each!r}, not 0" for each in took if each != 0), "")
    yield timed.tried("commands are sent", wrong or ("" if wires.sent() else "nothing came on its line or bus"))
    for sensor in driver.inputs:
        yield _garbage("garbage where its reports come", sensor.read, wires)
    timed = Stopwatch()
    timed(driver.stop)
    yield timed.tried("stop is sent", "" if wires.sent() else "nothing came on its line or bus")
    yield _jsonable("report", driver.report)
    wires.deaf()
    timed = Stopwatch()
    refused = timed(driver.send, full, 0.0)
    yield timed.tried(
        "a line that takes nothing is told", "" if refused else f"send returned {refused!r}, not how many were lost"
    )
    faults = list[str]()
    try:
        driver.stop()
    except OSError:
        pass
    except Exception as error:
        faults.append(f"stop raised {type(error).__name__}, not OSError")
    else:
        faults.append("stop did not raise OSError")
    yield Tried("a stop that is not taken raises OSError", "".join(faults))


def _input(kind: str, name: str, settings: config.Vehicle) -> Iterator[Tried]:
    wires, timed, state = Wires(), Stopwatch(), State()
    if kind == "source":
        opened = timed(open_source, name, settings, wires.links, state)
    else:
        opened = timed(module(name, settings).open_sensor, settings, wires.links)
    yield timed.tried(f"{kind} opened")
    if opened is None:
        return
    read = opened.read if kind == "sensor" else lambda _, now_s: opened.read(now_s)
    timed = Stopwatch()
    values = [timed(read, state, 0.2 * k) for k in range(READS)]
    yield timed.tried(f"{kind}: silence", "it returned something" if any(values) else "")
    yield _garbage(f"{kind}: garbage", read, wires, state)
    if (said := _played(name, settings)) and wires.lines:
        yield from _timings(kind, read, said, wires, state)
    if kind == "source":
        yield _jsonable("report", lambda: opened.report(0.0))


def _garbage(what: str, read: Callable[[State, float], object], wires: Wires, state: State | None = None) -> Tried:
    """Feed pieces of all lengths, an endless line among them. What comes of it must make sense."""
    state = state or State()

    def fed() -> tuple[list[float], str]:
        timed, chance, faults = Stopwatch(), Random(what), list[str]()
        for k in range(PIECES):
            length = 65_536 if k == PIECES // 2 else chance.randrange(0, 200)
            wires.say(chance.randbytes(length).replace(b"\n", b"" if length > 200 else b"\n"), chance)
            fix = timed(read, state, 0.2 * k)
            if fix is not None and not is_sound(fix):
                faults.append("its message has numbers that are not finite")
            faults += [f"{name} is {value!r}" for name, (value, _) in state.measured.items() if not math.isfinite(value)]
        return timed.took_s, "".join([*timed.faults, *faults][:1])

    return Tried(what, *judged(fed))


def _played(name: str, settings: config.Vehicle) -> bytes:
    """The first output of the part's device in simulation; empty: it has none on a line."""
    nodes, clock = nodes_of(settings, 1), ManualClock()
    for _ in range(READS):
        nodes.step(clock.monotonic_s(), clock.time_ns())
        for port, data in nodes.instruments.step(clock.monotonic_s(), clock.time_ns()) if nodes.instruments else ():
            if port == name:
                return data
        clock.advance(0.1)
    return b""


def _timings(kind: str, read: Callable[[State, float], object], said: bytes, wires: Wires, state: State) -> Iterator[Tried]:
    """Feed the output of its device: as it comes, byte by byte, all at once, and the same again and again."""
    (line,) = list(wires.lines.values())[:1]
    bytewise = [said[k : k + 1] for k in range(len(said))]
    for what, pieces in (
        (", after garbage", [said] * 3),
        (" byte by byte", bytewise),
        (" many times at once", [said * 50]),
        (" frozen", [said] * 50),
    ):
        timed = Stopwatch()
        state.measured.clear()
        wires.clock.advance(1.0)
        found = list[object]()
        for piece in pieces:
            line.put(piece)
            found.append(timed(read, state, wires.clock.monotonic_s()))
        is_heard = any(is_sound(each) for each in found) if kind == "source" else bool(state.measured)
        yield timed.tried(f"{kind}: what its device says{what}", "" if is_heard else "it was not understood")


def _jsonable(what: str, report: Callable[[], object]) -> Tried:
    faults = list[str]()
    with _trying(faults):
        json.dumps(report(), allow_nan=False)
    return Tried(f"{what} can be JSON", "".join(faults))


def _mode(name: str, settings: config.Vehicle) -> Iterator[Tried]:
    """Let a mode steer for a while, with numbers that make no sense in between; it must stop then. Then leave it."""
    faults = list[str]()
    with _trying(faults):
        run = Lockstep(settings, 1, lambda clock: NoLog())
        refused: str | None = "not yet"
        for state in run.cycles(VOYAGE_S):
            if refused is not None:
                refused = run.command(console.SetMode(name))
            elif state.mode.name.lower() != name:
                faults.append(state.reason)
                break
        faults += [refused] if refused is not None else []
    yield Tried(f"mode {name}: {VOYAGE_S:.0f} s in simulation", "".join(faults[:1]))


def _order(part: Part, row: OrderRow, settings: config.Vehicle) -> Tried:
    """Give an order without values, and with some that make no sense: it is carried out, or refused for a reason, and in
    time."""
    garbage, tries = (-1e300, 1e300, "\0"), list[console.Values]([{}, {"no_such_key": 1.0}])
    tries += [{key: value} for key in row.table.__struct_fields__ for value in garbage]

    def given() -> tuple[list[float], str]:
        run, took_s, faults = Lockstep(settings, 1, lambda clock: NoLog()), list[float](), list[str]()
        health = run.state.parts[part.name]
        for values in tries:
            for _ in run.cycles(1.0):
                pass
            health.worst_s = 0.0
            with _in_real_time():
                refused = run.command(console.PartOrder(row.name, values))
            took_s.append(health.worst_s)
            faults += [health.reason] if health.failed else []
            faults += [f"{key} has no limits" for key, value in values.items() if refused is None and isinstance(value, float)]
        return took_s, "".join(faults[:1])

    return Tried(f"order {row.name}", *judged(given))


@contextmanager
def _in_real_time() -> Iterator[None]:
    """Break off the calls of parts within."""
    before = foreign._limit[0]
    foreign.in_real_time()
    try:
        yield
    finally:
        foreign._limit[0] = before


def _voyage(part: Part, settings: config.Vehicle) -> Iterator[Tried]:
    """Sail a voyage in lock step twice: it must be the same, and the part must not fail."""
    ends = list[tuple[float, float, tuple[float, ...]]]()
    faults = list[str]()
    for _attempt in range(2):
        with _trying(faults):
            run = Lockstep(settings, 1, lambda clock: NoLog())
            refused: str | None = "not yet"
            for _ in run.cycles(VOYAGE_S):
                if refused is not None:
                    refused = run.command(console.Heading(90.0, 1.0))
            if refused is not None and (part.played or not part.source):
                faults.append(refused)
            faults += [each.reason for each in run.state.parts.values() if each.reason]
            if part.sensor and part.played:
                missing = [each.name for each in module(part.name, settings).VALUES if each.name not in run.state.measured]
                faults += [f"{missing[0]} was not measured"] if missing else []
            model = run.nodes.model
            ends.append((model.north_m, model.east_m, run.state.actuation.thrust))
    if len(set(ends)) > 1:
        faults.append("two voyages with the same seed differ")
    yield Tried(f"a voyage of {VOYAGE_S:.0f} s in simulation, twice", "".join(faults[:1]))


def version_of(name: str) -> str:
    """The version of the package with this part. Raises DelfimError."""
    entries = parts.installed().get(name, [])
    if not entries:
        raise DelfimError(f"no installed package has a part of the name {name}; delfim parts list shows them")
    return parts.version_of(entries[0])
