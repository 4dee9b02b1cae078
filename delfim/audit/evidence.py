"""The evidence of a run, as the rules read it: records as columns, notices, modes, orders, frames, and its settings.

Times are seconds since the computer's boot, as in the records. Nothing here judges.
"""

import bisect
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from delfim.base.errors import DelfimError
from delfim.base.modes import Mode

TROUBLES: Final = (  # bit n of the field `troubles` is the n-th: docs/failsafe.md
    *("control", "navigation_jumping", "navigation_silent", "navigation_frozen", "sensor_bad", "battery_critical", "thruster"),
    *("manual_silent", "console_silent", "guest_silent", "fence", "battery_low", "log", "gnss_poor", "kill", "handset_silent"),
    *("shallow", "traffic", "traffic_close", "ais_silent", "fence_left", "traffic_unclear", "restarted", "outlet"),
    *("navigation_twice", "energy", "stuck", "capsized", "beyond"),
)
ACTIONS: Final = (  # from harmless to severe; disconnect is for idle alone
    *("warn", "disconnect", "hold", "back", "unstick", "home", "stop"),
)
IDLE: Final = "idle"
LEADS: Final = {  # the modes that an action leads to
    "stop": (IDLE,),
    **dict.fromkeys(("hold", "back"), ("hold",)),
    **{name: (name, "hold") for name in ("unstick", "home")},
}
PAUSE_S: Final = 1.0  # between records, after which what they said is old
SAME_S: Final = 0.05  # events of one look of the boat are so close together
LOOK_S: Final = 0.45  # the boat looks ten times a second, in lock step five; so much later it has noticed and acted


class Unjudged(DelfimError):
    """The log does not have what a rule needs; the reason in words."""


class Noted(NamedTuple):
    """The content of a notice, from this time on."""

    t_s: float
    words: str
    action: str


class LoggedTrouble(NamedTuple):
    """A trouble from its first note to the one that ends it; infinite where none does."""

    name: str
    told: tuple[Noted, ...]
    end_s: float

    @property
    def begin_s(self) -> float:
        return self.told[0].t_s


class ModeChange(NamedTuple):
    t_s: float
    before: str
    mode: str
    reason: str


class LoggedOrder(NamedTuple):
    t_s: float
    name: str
    value: Mapping[str, Any]
    refused: str
    operator: str


class Sent(NamedTuple):
    """A frame of the black box, by the wall clock."""

    t_ns: int
    identifier: int
    data: bytes


class Evidence:
    """The evidence of a run. `events` are those of the state log's sidecar, in order; `boxes` the frames of black boxes by the
    bus' name."""

    def __init__(
        self,
        name: str,
        columns: Mapping[str, NDArray[Any]],
        events: Sequence[Mapping[str, Any]],
        boxes: Mapping[str, Sequence[Sent]] | None = None,
        box_events: Sequence[Mapping[str, Any]] = (),
    ) -> None:
        self.name, self.columns, self.events, self.boxes, self.box_events = name, columns, events, boxes or {}, box_events
        self.t_s: NDArray[np.float64] = self.column("monotonic_s").astype(float)
        if not len(self.t_s):
            raise Unjudged("no record")
        self.cycle = self.column("cycle").astype(np.int64)
        start = next((each for each in events if each["event"] == "start"), {})
        self._settings: Mapping[str, Any] = start.get("settings") or {}

    def column(self, name: str) -> NDArray[Any]:
        """A column of the records. Raises Unjudged where the log has no such field."""
        if name not in self.columns:
            raise Unjudged(f"the log has no field {name}")
        return self.columns[name]

    def setting(self, key: str) -> Any:
        """A value of the vehicle's file, such as failsafe.pause_s. Raises Unjudged where the log lacks it, or an order changed
        it."""
        if any(key.startswith(each) for each in self._changed):
            raise Unjudged(f"{key} was changed at sea")
        found: Any = self._settings
        for word in key.split("."):
            if not isinstance(found, Mapping) or word not in found:
                raise Unjudged(f"the log does not say {key}: it has no start with settings")
            found = found[word]
        return found

    @cached_property
    def _changed(self) -> set[str]:
        return {str(each.value.get("key")) for each in self.orders if each.name == "set" and not each.refused}

    def action(self, trouble: str, mode: str) -> str:
        """The action of the vehicle's file for this trouble in this mode."""
        if mode == IDLE:
            return "warn"
        if trouble in ("control", "kill"):
            return "stop"
        if trouble == "restarted":
            return "warn"
        table = self.setting(f"failsafe.{trouble}")
        own = table.get(mode, "same")
        return str(table["action"] if own == "same" else own)

    @cached_property
    def thrusters(self) -> list[Mapping[str, Any]]:
        """The rows of the vehicle's file."""
        return [each for each in self.setting("thrusters") if f"{each['name']}_command" in self.columns]

    @cached_property
    def commands(self) -> NDArray[np.float64]:
        """The commands of all thrusters, a column each."""
        return np.column_stack([self.column(f"{each['name']}_command") for each in self.thrusters]).astype(float)

    @cached_property
    def is_driven(self) -> NDArray[np.bool_]:
        """Whether any thruster is commanded to turn, in each record."""
        driven: NDArray[np.bool_] = (self.commands != 0.0).any(axis=1)
        return driven

    @cached_property
    def modes(self) -> list[ModeChange]:
        found, before = list[ModeChange](), IDLE
        for each in self.events:
            if each["event"] == "mode":
                found.append(ModeChange(float(each["monotonic_s"]), before, str(each["value"]), str(each.get("reason", ""))))
                before = found[-1].mode
        return found

    @cached_property
    def _mode_times(self) -> list[float]:
        return [each.t_s for each in self.modes]

    def mode_at(self, t_s: float) -> str:
        """The mode of the boat at this time, a change at this very time included."""
        at = bisect.bisect_right(self._mode_times, t_s + 1e-6)
        return self.modes[at - 1].mode if at else IDLE

    def modes_about(self, t_s: float, within_s: float = LOOK_S) -> set[str]:
        """All modes of the boat within this time."""
        return {self.mode_at(t_s - within_s)} | {each.mode for each in self.changes(t_s, within_s)}

    def entered_s(self, t_s: float) -> float:
        """The time, s, since when the boat is in the mode that it has at this time."""
        since_s, mode = -math.inf, IDLE
        for each in self.modes[: bisect.bisect_right(self._mode_times, t_s + 1e-6)]:
            if each.mode != mode:
                since_s, mode = each.t_s, each.mode
        return since_s

    @cached_property
    def record_modes(self) -> NDArray[Any]:
        """The name of the mode of each record."""
        names = {int(mode): mode.name.lower() for mode in Mode}
        numbers, places = np.unique(self.column("mode"), return_inverse=True)
        return np.array([names.get(int(number), f"number {number}") for number in numbers])[places]

    @cached_property
    def orders(self) -> list[LoggedOrder]:
        its = (each for each in self.events if each["event"] == "command")
        return [
            LoggedOrder(
                float(each.get("at_s", each["monotonic_s"])),
                str(each["value"]["command"]),
                each["value"],
                str(each["refused"]),
                str(each.get("operator", "")),
            )
            for each in its
        ]

    @cached_property
    def _obeyed(self) -> tuple[list[float], list[LoggedOrder]]:
        its = sorted((each for each in self.orders if not each.refused), key=lambda each: each.t_s)
        return [each.t_s for each in its], its

    def obeyed(self, t_s: float, within_s: float) -> list[LoggedOrder]:
        """The orders within this time that were not refused."""
        times, its = self._obeyed
        return its[bisect.bisect_left(times, t_s - within_s) : bisect.bisect_right(times, t_s + within_s)]

    def changes(self, t_s: float, within_s: float) -> list[ModeChange]:
        """The changes of mode within this time."""
        times = self._mode_times
        return self.modes[bisect.bisect_left(times, t_s - within_s) : bisect.bisect_right(times, t_s + within_s)]

    @cached_property
    def alarms(self) -> list[LoggedTrouble]:
        """The troubles, by when they began. What else a note has is in `words`."""
        running, found = dict[str, list[Noted]](), list[LoggedTrouble]()
        for t_s, name, words, action in self._notes():
            if action:
                running.setdefault(name, []).append(Noted(t_s, words, action))
            elif name in running:
                found.append(LoggedTrouble(name, tuple(running.pop(name)), t_s))
        found += [LoggedTrouble(name, tuple(told), math.inf) for name, told in running.items()]
        return sorted(found, key=lambda each: each.begin_s)

    @cached_property
    def words(self) -> list[Noted]:
        """The notes of no trouble: a thrust that ended, a thruster that dropped out."""
        return [Noted(t_s, words, "") for t_s, name, words, action in self._notes() if not name and not action]

    def _notes(self) -> Iterator[tuple[float, str, str, str]]:
        """The notes: time, trouble, words, action; without an action the trouble is over, without a name it is a note of
        another kind."""
        known = self._settings.get("failsafe", {})
        for each in self.events:
            if each["event"] != "note":
                continue
            t_s, value = float(each["monotonic_s"]), str(each["value"])
            name, _, rest = value.partition(": ")
            words, _, action = rest.rpartition(": ")
            if (name in TROUBLES or name in known) and (rest == "over" or action in ACTIONS):
                yield (t_s, name, "", "") if rest == "over" else (t_s, name, words, action)
            else:
                yield t_s, "", value, ""

    def named(self, *names: str) -> list[LoggedTrouble]:
        return [each for each in self.alarms if each.name in names]

    def is_told(self, names: Iterable[str], t_s: float, late_s: float = LOOK_S) -> bool:
        """Whether one of these troubles is reported at this time or so much later."""
        return any(each.begin_s <= t_s + late_s and t_s <= each.end_s for each in self.named(*names))

    @cached_property
    def end_s(self) -> float:
        """The time of the last entry of the log, s."""
        return max(float(self.t_s[-1]), *(float(each["monotonic_s"]) for each in self.events if "monotonic_s" in each), 0.0)

    def last(self, t_s: float) -> int | None:
        """The newest record of this time; None where it is old."""
        at = int(np.searchsorted(self.t_s, t_s + 1e-6)) - 1
        return at if at >= 0 and t_s - self.t_s[at] < PAUSE_S else None

    def unbroken(self, holds: NDArray[np.bool_]) -> list[tuple[int, int]]:
        """The first and last record of each stretch in which it holds and records follow one another: a pause is unknown."""
        ends = np.flatnonzero(np.diff(self.t_s) > PAUSE_S) + 1
        return [
            (begin, end)
            for first, last in spells(holds)
            for cut in [[first, *ends[(ends > first) & (ends <= last)], last + 1]]
            for begin, end in zip(map(int, cut[:-1]), (int(each) - 1 for each in cut[1:]), strict=True)
        ]

    @cached_property
    def lost(self) -> NDArray[np.bool_]:
        """Whether cycles are missing between a record and the next: the log was not written then."""
        missing: NDArray[np.bool_] = np.diff(self.cycle) > 1
        return missing


def spells(holds: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """The first and last place of each stretch in which it holds."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], holds, [False])).astype(np.int8)))
    return [(int(begin), int(end) - 1) for begin, end in zip(edges[::2], edges[1::2], strict=True)]


def parts(
    name: str,
    columns: Mapping[str, NDArray[Any]],
    events: Sequence[Mapping[str, Any]],
    boxes: Mapping[str, Sequence[Sent]],
    box_events: Sequence[Mapping[str, Any]],
) -> list[Evidence]:
    """Split a log into one run, or into the lives of its program where it began again within the log, as in lock step: cycles
    count from 1 again."""
    whole = Evidence(name, columns, events, boxes, box_events)
    begins = [int(at) + 1 for at in np.flatnonzero(np.diff(whole.cycle) < 0) if whole.cycle[at + 1] == 1]
    if not begins or not whole.named("restarted"):
        return [whole]
    found, heads = list[Evidence](), [each for each in events if each["event"] == "start"]
    for first, last in zip([0, *begins], [*begins, len(whole.t_s)], strict=True):
        from_s = float(whole.t_s[first]) if first else -math.inf
        to_s = float(whole.t_s[last]) if last < len(whole.t_s) else math.inf
        its = [each for each in events if from_s <= float(each.get("monotonic_s", 0.0)) < to_s and each not in heads]
        cut = {key: column[first:last] for key, column in columns.items()}
        found.append(Evidence(name, cut, [*heads, *its], boxes, box_events))
    return found


def repeats(e: Evidence) -> NDArray[np.bool_]:
    """Whether a record has the same navigation as the one before, to the last bit."""
    names = ("latitude", "longitude", "north_speed", "east_speed", "heading", "yaw_rate")
    values = np.column_stack([e.column(name) for name in names])
    same: NDArray[np.bool_] = np.concatenate(([False], (values[1:] == values[:-1]).all(axis=1) & ~np.isnan(values[1:, 0])))
    return same
