"""The loop's calls to a laboratory's part. What the part raises, and the time that it takes, costs the part: after three calls
that failed it is switched off until the program starts again, and the boat goes on as if its device were silent.

A call that takes longer than BROKEN_S is broken off, in real time alone: a clock of the computer would make lock step and
replay differ from run to run.
"""

import math
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from types import FrameType
from typing import Any, Final, NamedTuple, TypeVar, get_args

import msgspec

from delfim import config
from delfim.base.errors import ConfigError, FormatError, Refused, in_words, one_line
from delfim.base.modes import Mode
from delfim.base.parts import ModeRow, OrderRow, Part, find, load
from delfim.base.tables import Table, decode
from delfim.canproxy.dsor.messages import Navigation
from delfim.vehicle import console
from delfim.vehicle.control.control import PartError
from delfim.vehicle.control.memory import Memory, Settings
from delfim.vehicle.failsafe.troubles import NUMBERS, PartTrigger
from delfim.vehicle.links import LoopInput
from delfim.vehicle.navigation.fixes import Fix, Source
from delfim.vehicle.propulsion.actuators import Actuator
from delfim.vehicle.report import PartHealth
from delfim.vehicle.state import Actuation, Motion, Reference, Setpoint, State, Wanted

SLOW_S: Final = 0.002  # of one call: longer ones are counted
BROKEN_S: Final = 0.1  # of one call: then it is broken off
STRIKES: Final = 3  # calls that fail one after the other: then the part is switched off
HEALS: Final = 0.02  # of a call that failed, for each that did not
T = TypeVar("T")
_running = [False]  # whether a part's call is
_limit: list[Callable[[], AbstractContextManager[object]]] = [nullcontext]  # of each call in this process


def in_real_time() -> None:
    """From now on each call of this process is broken off after BROKEN_S. For the main thread of a program in real time."""
    _limit[0] = breaking_off


def within() -> AbstractContextManager[object]:
    """The limit of one call."""
    return _limit[0]()


@contextmanager
def breaking_off() -> Iterator[None]:
    """Raise TimeoutError in what runs within for longer than BROKEN_S. For the main thread of a program in real time."""
    signal.signal(signal.SIGALRM, _break_off)
    _running[0] = True
    signal.setitimer(signal.ITIMER_REAL, BROKEN_S, BROKEN_S)  # again: code that catches everything must not go on
    try:
        try:
            yield
        finally:
            _running[0] = False
    finally:  # even if the clock struck in the line before: it does so once in BROKEN_S
        _running[0] = False
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def _break_off(number: int, frame: FrameType | None) -> None:
    """Never in the boat's own code."""
    if _running[0]:
        raise TimeoutError(f"it took more than {BROKEN_S:g} s")


class _Guarded:
    """What a part's driver, source, sensor and orders have in common. Each is switched off alone; the health is the part's."""

    KIND = ""  # as in `OrderAsked`

    def __init__(self, name: str, state: State, opened: object = None) -> None:
        self.name, self.opened = name, opened
        self.health = state.parts.setdefault(name, PartHealth())
        self._state, self._strikes, self._is_off = state, 0.0, False

    def _call(self, otherwise: T, what: str, call: Callable[..., T], *arguments: Any) -> T:
        """The call's result, or `otherwise` where it fails or the part is switched off."""
        if self._is_off:
            return otherwise
        began_s = time.perf_counter()
        try:
            with within():
                result = call(*arguments)
            self._strikes = max(self._strikes - HEALS, 0.0)
        except Exception as error:  # foreign code, of which anything may come
            result = otherwise
            self._strike(f"{what}: {in_words(error)}")
        took_s = time.perf_counter() - began_s
        self.health.slow += took_s > SLOW_S
        self.health.worst_s = max(self.health.worst_s, took_s)
        return result

    def _strike(self, words: str) -> None:
        self._state.count(f"{self.name}_failed")
        self.health.failed += 1
        self.health.reason = words
        self._strikes += 1.0
        if self._strikes > STRIKES - 1:
            self._is_off = True
            self.health.off = f"part {self.name} is switched off: {words}"


def is_sound(fix: object) -> bool:
    """Whether this is a message of navigation, each of its numbers finite."""
    if not isinstance(fix, Fix) or not isinstance(fix.navigation, Navigation):
        return False
    return all(each is None or _are_numbers((each,)) for each in (*fix.navigation, fix.t0_ns, fix.received_s))


def _are_numbers(values: object) -> bool:
    return isinstance(values, tuple) and all(isinstance(each, float | int) and math.isfinite(each) for each in values)


class GuardedSource(_Guarded):
    """A source of navigation of a part."""

    KIND = "source"

    def __init__(self, source: Source, name: str, state: State) -> None:
        super().__init__(name, state, source)
        self._source, self.input = source, source.input

    @property
    def heard_s(self) -> float:
        return self._source.heard_s

    @heard_s.setter
    def heard_s(self, value: float) -> None:
        self._source.heard_s = value

    def read(self, now_s: float) -> Fix | None:
        return self._call(None, "read", self._read, now_s)

    def _read(self, now_s: float) -> Fix | None:
        fix = self._source.read(now_s)
        if fix is None or is_sound(fix):
            return fix
        raise FormatError("its message is no Fix, or has numbers that are not finite")

    def report(self, now_s: float) -> dict[str, object]:
        return self._call({}, "report", self._source.report, now_s)


class GuardedSensor(_Guarded):
    """A sensor of a part, or the reports of its motors. Values that are no finite numbers are not taken."""

    KIND = "sensor"

    def __init__(self, sensor: LoopInput, name: str, state: State, values: tuple[str, ...] = ()) -> None:
        super().__init__(name, state, sensor)
        self._sensor, self.input, self._values = sensor, sensor.input, values

    def read(self, state: State, now_s: float) -> None:
        self._call(None, "read", self._read, state, now_s)

    def _read(self, state: State, now_s: float) -> None:
        self._sensor.read(state, now_s)
        for value in self._values:
            if not _are_numbers(state.measured.get(value, (0.0, 0.0))):
                del state.measured[value]
                raise FormatError(f"{value} is no finite number")


def _count(call: Callable[..., int], *arguments: Any) -> int:
    """What a part returns as a number, and may forget to."""
    return int(call(*arguments))


class GuardedActuator(_Guarded):
    """A driver of a part. Switched off, it is still told to stop."""

    KIND = "driver"

    def __init__(self, actuator: Actuator, rows: int, state: State) -> None:
        super().__init__(actuator.name, state, actuator)
        self._actuator, self._rows, self.period_s = actuator, rows, actuator.period_s
        self.inputs: tuple[LoopInput, ...] = tuple(GuardedSensor(each, self.name, state) for each in actuator.inputs)

    def send(self, sent: Actuation, now_s: float) -> int:
        return self._call(self._rows, "send", _count, self._actuator.send, sent, now_s)

    def repeat(self, now_s: float) -> int:
        return self._call(self._rows, "repeat", _count, self._actuator.repeat, now_s)

    def stop(self) -> None:
        """Raises OSError."""
        try:
            with within():
                self._actuator.stop()
        except Exception as error:
            raise OSError(f"part {self.name}: stop: {in_words(error)}") from error

    def disconnect(self, names: tuple[str, ...]) -> None:
        self._call(None, "disconnect", self._actuator.disconnect, names)

    def report(self) -> dict[str, object]:
        return self._call({}, "report", self._actuator.report)


def sources(settings: config.Vehicle, opened: tuple[Source, ...], state: State) -> tuple[Source, ...]:
    """The sources of navigation, those of parts guarded."""
    return tuple(GuardedSource(each, each.name, state) if find(settings.aboard, each.name) else each for each in opened)


def sensors(settings: config.Vehicle, opened: tuple[LoopInput, ...], state: State) -> tuple[LoopInput, ...]:
    """The sensors in the order of their names, those of parts guarded."""
    found = list[LoopInput]()
    for name, each in zip(settings.sensors.names, opened, strict=True):
        part = find(settings.aboard, name)
        values = () if part is None else tuple(value.name for value in load(part, part.sensor).VALUES)
        found.append(each if part is None else GuardedSensor(each, name, state, values))
    return tuple(found)


def actuators(settings: config.Vehicle, opened: tuple[Actuator, ...], state: State) -> tuple[Actuator, ...]:
    """The drivers in the order of their names, those of parts guarded."""
    rows = [row.driver for row in settings.thrusters]
    return tuple(
        GuardedActuator(each, rows.count(name), state) if find(settings.aboard, name) else each
        for name, each in zip(settings.drivers, opened, strict=True)
    )


class OrderAsked(NamedTuple):
    """What the function of a part's order is told, and what its part has opened (None: the vehicle's file does not use it)."""

    values: Any  # of the row's table
    settings: config.Vehicle
    state: State  # to look at
    now_s: float
    driver: Any = None
    source: Any = None
    sensor: Any = None


class GuardedOrder(_Guarded):
    """An order of a part. One that fails is refused with the reason."""

    def __init__(self, part: Part, row: OrderRow, state: State, has: dict[str, object]) -> None:
        super().__init__(part.name, state)
        self.row, self._has, self._does = row, has, load(part, row.does)
        is_table: Any = {"bases": (Table,), "frozen": True, "forbid_unknown_fields": True, "kw_only": True}
        self._kind: Any = msgspec.defstruct("Order", [(row.name, row.table)], **is_table)  # so a key is told with its order

    def carry_out(self, values: console.Values, settings: config.Vehicle, now_s: float) -> console.Meant | None:
        """The order of the console that it stands for, if it is one. Raises Refused."""
        failed = self.health.failed
        answer = self._call(None, f"order {self.row.name}", self._answer, values, settings, now_s)
        if self._is_off or self.health.failed != failed:
            raise Refused(f"order refused: {self.health.off if self._is_off else f'part {self.name}: {self.health.reason}'}")
        if isinstance(answer, str):
            raise Refused(f"order refused: {answer}")
        return answer

    def _answer(self, values: console.Values, settings: config.Vehicle, now_s: float) -> console.Meant | str | None:
        try:
            table = decode({self.row.name: values}, self._kind, "")
        except ConfigError as error:
            return f"{error.key}: {error.reason}" + (f" (allowed: {error.allowed})" if error.allowed else "")
        answer = self._does(OrderAsked(getattr(table, self.row.name), settings, self._state, now_s, **self._has))
        if isinstance(answer, str) and answer.strip():
            return f"{self.row.name}: {one_line(answer)}"
        if type(answer) in get_args(console.Meant):  # made without a look at its numbers
            meant: console.Meant = console.asked(type(answer), **msgspec.structs.asdict(answer))
            return meant
        if answer is None:
            return None
        raise FormatError(f"it answered {answer!r:.60}, which is no reason and no order that a part may give")


def orders(settings: config.Vehicle, state: State, aboard: Iterable[object]) -> dict[str, GuardedOrder]:
    """Those of the parts aboard, by name. `aboard`: what has been opened. Raises PermanentFailure."""
    found = dict[str, GuardedOrder]()
    for part in settings.aboard:
        own = {each.KIND: each.opened for each in aboard if isinstance(each, _Guarded) and each.name == part.name}
        found |= {row.name: GuardedOrder(part, row, state, own) for row in part.orders}
    return found


def _reason(part: str, ask: Callable[..., object], about: object) -> str | None:
    """The reason that a part gives, in words, or why it cannot."""
    try:
        with within():
            reason = ask(about)
        return None if reason is None else one_line(str(reason))
    except Exception as error:  # foreign code, of which anything may come
        return f"part {part} cannot tell: {in_words(error)}"


class PartProgram:
    """The program of a part's mode. What it raises stops the boat, as an input that a mode lacks does, and is the reason."""

    def __init__(self, part: Part, row: ModeRow, settings: config.Vehicle) -> None:
        self._part, self._program = part.name, load(part, row.program).open_mode(settings)
        self.NEEDS, self.SENTENCE = frozenset(self._program.NEEDS), str(self._program.SENTENCE)

    def lacks(self, setpoint: Setpoint) -> str | None:
        return _reason(self._part, self._program.lacks, setpoint)

    def enter(self, motion: Motion, setpoint: Setpoint, settings: Settings) -> Memory:
        return self._checked(Memory, "enter", motion, setpoint, settings)

    def step(
        self, memory: Memory, motion: Motion, setpoint: Setpoint, settings: Settings, dt_s: float
    ) -> tuple[Memory, Reference, Wanted]:
        result = self._checked(tuple, "step", memory, motion, setpoint, settings, dt_s)
        if tuple(map(type, result)) != (Memory, Reference, Wanted):
            raise PartError(f"part {self._part}: step returned no Memory, Reference and Wanted")
        return result

    def _checked(self, kind: type[T], what: str, *arguments: object) -> T:
        """Raises PartError."""
        try:
            with within():
                result = getattr(self._program, what)(*arguments)
        except Exception as error:  # foreign code, of which anything may come
            raise PartError(f"part {self._part}: {what}: {in_words(error)}") from error
        if not isinstance(result, kind):
            raise PartError(f"part {self._part}: {what} returned {type(result).__name__}, not {kind.__name__}")
        return result


def programs(settings: config.Vehicle) -> dict[Mode, PartProgram]:
    """Those of the modes of the parts aboard. Raises PermanentFailure where one cannot be imported."""
    return {Mode[row.name.upper()]: PartProgram(part, row, settings) for part in settings.aboard for row in part.modes}


def triggers(settings: config.Vehicle) -> tuple[PartTrigger, ...]:
    """The troubles of the parts aboard; one that cannot be judged is there, and says so. Raises PermanentFailure where
    one cannot be imported."""
    found = tuple(
        PartTrigger(row, partial(_reason, part.name, load(part, row.sees))) for part in settings.aboard for row in part.troubles
    )
    NUMBERS.update((each.name.lower(), int(each)) for each in found)
    return found
