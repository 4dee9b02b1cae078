"""The trace of a voyage: small, and enough to say in which cycle which field of it changed first.

A cycle has four groups of numbers, in the order in which they come about: where the boat truly is, what it sensed, what it
decided, what it commanded. The trace has

    marks    a digest of everything so far, and a letter for each field
    rows     a second of cycles, each with a letter for each group; later a letter for each group of some seconds; then the
             commands at its end, or of each cycle, as whole numbers
    ends     some values now and then, in digits
    told     what the boat and its operator said

A letter is six bits: of 64 changes it shows 63. The digest shows all.
"""

import hashlib
import math
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from operator import itemgetter
from typing import Any, Final, NamedTuple

from delfim import config
from delfim.base.clock import ManualClock
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle.log import record
from delfim.vehicle.state import State

GROUPS: Final = ("true", "sensed", "decided", "commanded")
LETTERS: Final = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+-"
MARKS_S: Final = (60.0, 120.0)  # and at the end
ENDS_S: Final = (20.0, 40.0, 80.0, 160.0, 320.0, 640.0, 1280.0)
FULL: Final = 2047  # of a command, in two letters
UNKNOWN: Final = 4095
TRUE: Final = ("north", "east", "heading", "surge", "sway", "yaw_rate")
DECIDED: Final = {
    *("cycle", "mode", "troubles", "reference_heading", "reference_speed", "cross_track", "distance", "leg", "vessels"),
    *("order_course", "order_speed", "nearness", "console_s", "guest_s", "guest_heading", "guest_speed", "watchdog_s"),
}
DIGITS: Final = {"true_north", "true_east", "north", "east", "heading", "reference_heading", "reference_speed"}


class Layout(NamedTuple):
    """How finely a trace is written: cycle by cycle for `fine_s`, then `coarse_s` together. `each`: the commands of each cycle,
    not of each second."""

    rate_hz: float
    fine_s: float
    coarse_s: float
    each: bool = False


class Row(NamedTuple):
    end: int  # its last cycle, counted from 1
    letters: str  # of each group, of each cycle in it or of all together
    commands: str  # two letters each


class Trace(NamedTuple):
    """What is kept of a voyage; the values of all cycles, too, while they are at hand."""

    groups: dict[str, tuple[str, ...]]  # names of fields
    seconds: float
    rate_hz: float
    marks: dict[int, tuple[str, str]]  # by cycle: digest, a letter for each field
    rows: list[Row]
    ends: dict[int, dict[str, float]]
    told: list[tuple[float, str]]
    failures: list[str]
    columns: dict[str, Sequence[Any]]  # values by field, of each cycle; not kept
    at_s: Sequence[float]  # of each cycle; not kept

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(name for names in self.groups.values() for name in names)

    @property
    def told_by(self) -> tuple[str, ...]:
        return tuple(name for name in self.groups["commanded"] if name.endswith(("_command", "_angle")))


class Tape:
    """The state log of a voyage, which keeps the values of each cycle. `groups`: of its fields; empty: all there are."""

    def __init__(self, settings: config.Vehicle, clock: ManualClock, groups: dict[str, tuple[str, ...]]) -> None:
        self._clock, self._groups, self._record = clock, groups, record.of(settings)
        rows = [row.name for row in settings.thrusters]
        self._commanded = {"run", *(f"{name}_{what}" for name in rows for what in ("command", "rpm", "angle"))}
        self._drives = rows
        self._values, self._at_s = list[tuple[Any, ...]](), list[float]()
        self._notes = list[tuple[int, float, str]]()
        self.told, self.failures = list[tuple[float, str]](), list[str]()

    def write(self, state: State, now_s: float) -> None:
        pass

    def note(self, text: str) -> None:
        self._notes.append((len(self._values), self._clock.monotonic_s(), text))

    def reason(self) -> str:
        return ""

    def close(self) -> None:
        pass

    def look(self, run: Lockstep) -> None:
        """After each cycle, whether it had navigation or not."""
        model, state, now_s = run.nodes.model, run.state, run.elapsed_s
        true = model.north_m, model.east_m, model.heading_rad, model.surge_mps, model.sway_mps, model.yaw_rate_radps
        drives = [each for name in self._drives for each in (model.drives[name].rpm, model.drives[name].charge)]
        self._at_s.append(now_s)
        self._values.append((*true, *drives, *record.values(self._record, state, now_s)))

    def trace(self, layout: Layout) -> Trace:
        names = [f"true_{name}" for name in TRUE]
        names += [f"true_{name}_{what}" for name in self._drives for what in ("rpm", "charge")]
        codes = ["d"] * len(names) + ["d" if field.code == "f" else field.code for field in self._record.fields]
        names += [field.name for field in self._record.fields]
        groups = {each: tuple(n for n in names if self._group(n) == each) for each in GROUPS}
        if self._groups:
            groups = {each: tuple(name for name in kept if name in names) for each, kept in self._groups.items()}
        packers = list[Packer]()
        for each in groups.values():
            places = [names.index(name) for name in each]
            packers.append(Packer(itemgetter(*places), struct.Struct("<" + "".join(codes[place] for place in places))))
        notes = [(t_s, text) for cycle, t_s, text in self._notes if cycle < len(self._values)]  # none of the end of the run
        trace = Trace(
            groups,
            self._at_s[-1],
            layout.rate_hz,
            {},
            [],
            {},
            sorted([*notes, *self.told], key=itemgetter(0)),
            self.failures,
            dict(zip(names, zip(*self._values, strict=True), strict=True)),
            self._at_s,
        )
        _write(trace, [[packer.pack(values) for packer in packers] for values in self._values], layout)
        return trace

    def _group(self, name: str) -> str:
        if name.startswith("true_"):
            return "true"
        return "commanded" if name in self._commanded else "decided" if name in DECIDED else "sensed"


class Packer(NamedTuple):
    pick: Callable[[tuple[Any, ...]], tuple[Any, ...]]
    form: struct.Struct

    def pack(self, values: tuple[Any, ...]) -> bytes:
        return self.form.pack(*self.pick(values))


def _write(trace: Trace, packed: list[list[bytes]], layout: Layout) -> None:
    """Marks, rows and ends of the cycles."""
    digest, fields, told_by, done, marked = hashlib.blake2b(digest_size=8), dict.fromkeys(trace.names, 0), trace.told_by, 0, 0
    digits = [name for name in trace.columns if name in DIGITS or name in told_by]
    marks = {*(round(each_s * layout.rate_hz) for each_s in MARKS_S), len(packed)}
    ends = {round(each_s * layout.rate_hz) for each_s in ENDS_S}
    for cycle, groups in enumerate(packed, 1):
        digest.update(b"".join(groups))
        if cycle in marks:
            for name, before in fields.items():
                text = "".join(map(repr, trace.columns[name][marked:cycle]))
                fields[name] = zlib.crc32(text.encode(), before)
            trace.marks[cycle], marked = (digest.hexdigest(), _letters(fields.values())), cycle
        if cycle in ends:
            trace.ends[cycle] = {name: float(trace.columns[name][cycle - 1]) for name in digits}
        is_fine = cycle <= layout.fine_s * layout.rate_hz
        if cycle - done < round((1.0 if is_fine else layout.coarse_s) * layout.rate_hz) and cycle not in marks:
            continue
        rows = packed[done:cycle] if is_fine else [[b"".join(each) for each in zip(*packed[done:cycle], strict=True)]]
        letters = "".join(_letters(map(zlib.crc32, each)) for each in rows)
        told = range(done if layout.each and is_fine else cycle - 1, cycle)
        commands = "".join(_command(trace.columns[name][place], name) for place in told for name in told_by)
        trace.rows.append(Row(cycle, letters, commands))
        done = cycle


def _letters(numbers: Iterable[int]) -> str:
    return "".join([LETTERS[number % 64] for number in numbers])


def _command(value: float, name: str) -> str:
    part = value / math.pi if name.endswith("_angle") else value
    number = UNKNOWN if math.isnan(part) else min(max(round((part + 1.0) * FULL), 0), 2 * FULL)
    return LETTERS[number // 64] + LETTERS[number % 64]


def commands(row: Row, told_by: tuple[str, ...]) -> Iterator[dict[str, float]]:
    """The commands in a row, in its last cycles: to half a thousandth of full."""
    numbers = [LETTERS.index(a) * 64 + LETTERS.index(b) for a, b in zip(row.commands[::2], row.commands[1::2], strict=True)]
    for first in range(0, len(numbers), len(told_by) or 1):
        yield {
            name: math.nan if number == UNKNOWN else (number / FULL - 1.0) * (math.pi if name.endswith("_angle") else 1.0)
            for name, number in zip(told_by, numbers[first:], strict=False)
        }
