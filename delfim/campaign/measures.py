"""The measures of a run: each is a row in `MEASURES`, and so a column of the results."""

import hashlib
import math
import struct
from collections.abc import Callable, Iterable
from typing import Final, NamedTuple

from delfim.base.clock import ManualClock
from delfim.base.modes import Mode
from delfim.campaign.colreg import Check, RuleTape, alterations
from delfim.campaign.steering import Deviation, SteerTape
from delfim.simulator.invariants.onlooker import TruePlace
from delfim.simulator.lockstep import Lockstep, OrderLog
from delfim.simulator.scenarios.trial import Event
from delfim.vehicle.console import Commands
from delfim.vehicle.log.logbook import ORDERLY
from delfim.vehicle.plans.zones import Point
from delfim.vehicle.state import State, StateLog

STOPS: Final = (Mode.IDLE, Mode.HOLD)


class RunTape:
    """The state log of a run: it keeps sums and a digest of what the boat knew and commanded in each cycle. `beside` gets
    everything, too."""

    def __init__(self, clock: ManualClock, beside: StateLog) -> None:
        self.clock, self.hash, self.beside = clock, hashlib.blake2b(digest_size=8), beside
        self.fastest_mps, self.cross_m = 0.0, Deviation()
        self._form = struct.Struct("")

    def write(self, state: State, now_s: float) -> None:
        m, sent, cross_m = state.motion, state.actuation, state.reference.cross_track_m
        numbers = (now_s, *m[1:], *sent.thrust, *sent.angle_rad)
        if self._form.size != 8 * len(numbers) + 1:
            self._form = struct.Struct(f"<{len(numbers)}dB")
        self.hash.update(self._form.pack(*numbers, state.mode))
        if (speed_mps := math.hypot(m.north_mps, m.east_mps)) > self.fastest_mps:
            self.fastest_mps = speed_mps
        if cross_m is not None:
            self.cross_m.add(cross_m)
        self.beside.write(state, now_s)

    def note(self, text: str) -> None:
        self.hash.update(text.encode())
        self.beside.note(text)

    def command(self, command: Commands, refused: str | None, state: State, operator: str) -> None:
        if isinstance(self.beside, OrderLog):
            self.beside.command(command, refused, state, operator)

    def watch(self, state: State) -> None:
        if isinstance(self.beside, OrderLog):
            self.beside.watch(state)

    def reason(self) -> str:
        return ""

    def close(self) -> None:
        self.beside.close()


class Truth:
    """The true motion of the hull, whatever the boat knew: called after each cycle."""

    def __init__(self, run: Lockstep) -> None:
        self._run, self._drives, self._at_s = run, run.nodes.model.drives, 0.0
        self.way_m, self.energy_j, self.fence_m = 0.0, 0.0, math.inf
        self.at: Point | None = None  # from where the boat knew first that it was
        self.rules, self.steered = RuleTape(run), SteerTape(run)
        self.mode: Mode | None = None  # before the run was ended
        self.reason = ""
        self._stop: Point | None = None  # where it was last told to stop, while it moved
        self.stop_m: float | None = None

    def look(self, place: TruePlace) -> None:
        """Take the true position of this cycle, `place`."""
        state, now_s, at = self._run.state, self._run.elapsed_s, place.at
        self.rules.look(now_s)
        was, self.mode, self.reason = self.mode, state.mode, state.reason
        power_w = sum([drive.voltage_v * drive.current_a for drive in self._drives.values()])
        self.energy_j, self._at_s = self.energy_j + power_w * (now_s - self._at_s), now_s
        if at is None:
            return
        if self.at is not None:
            self.way_m += math.hypot(at[0] - self.at[0], at[1] - self.at[1])
        if was is not self.mode and was is not None and self.mode in STOPS:
            self._stop, self.stop_m = at, 0.0
        if self._stop is not None:
            self.stop_m = max(self.stop_m or 0.0, math.dist(self._stop, at))
        self.at = at
        self.steered.look(now_s, at)
        if (clear_m := place.clear_m(self.fence_m)) < self.fence_m:
            self.fence_m = clear_m


class Sailed(NamedTuple):
    """A run that has ended."""

    run: Lockstep
    tape: RunTape
    truth: Truth
    events: list[Event]
    end: str  # in words
    pairs: str | None = None  # where the campaign counts them


class Measure(NamedTuple):
    name: str  # with its unit
    kind: str  # of DuckDB
    words: str
    value: Callable[[Sailed], object]  # None: there is none


def _noticed(sailed: Sailed) -> list[float | None]:
    """The time from each fault to a notice, or to a mode that was not ordered; None: nobody noticed it."""
    found = list[float | None]()
    for at, fault in enumerate(sailed.events):
        if fault.kind == "fault":
            found.append(next((each.t_s - fault.t_s for each in sailed.events[at + 1 :] if _notices(each)), None))
    return found


def _notices(event: Event) -> bool:
    """Whether an event shows the operator a trouble. A mode that he ordered, or that follows at the end of one, does not."""
    return event.kind == "notice" or (
        event.kind == "mode" and not event.text.startswith(ORDERLY) and not event.text.endswith(" done")
    )


def _slowest(sailed: Sailed) -> float | None:
    return max((each for each in _noticed(sailed) if each is not None), default=None)


def _broken(sailed: Sailed) -> str | None:
    found = _checks(sailed)
    return "; ".join(f"{each.rule}: {each.vessel}" for each in found if not each.is_kept) if found else None


def _checks(sailed: Sailed) -> list[Check]:
    return sailed.truth.rules.checks()


def _least(distances_m: Iterable[float]) -> float | None:
    """The smallest distance; None of those that were never measured, which are infinite."""
    return min(filter(math.isfinite, distances_m), default=None)


def _entered(sailed: Sailed) -> int:
    return sum(each.nearest < 1.0 for each in sailed.run.nodes.vessels)


def _collisions(sailed: Sailed) -> int:
    own_m = sailed.run.settings.boat.length_m
    return sum(each.nearest_m < 0.5 * (each.row.length_m + own_m) for each in sailed.run.nodes.vessels)


MEASURES: Final = (
    Measure("sailed_s", "DOUBLE", "time at sea", lambda s: s.run.elapsed_s),
    Measure("way_m", "DOUBLE", "way over ground", lambda s: s.truth.way_m),
    Measure("energy_j", "DOUBLE", "electric energy of the thrusters", lambda s: s.truth.energy_j),
    Measure("fastest_mps", "DOUBLE", "greatest speed over ground", lambda s: s.tape.fastest_mps),
    Measure(
        "cross_rms_m", "DOUBLE", "cross-track error, root of the mean square, as the boat knew it", lambda s: s.tape.cross_m.rms
    ),
    Measure("cross_max_m", "DOUBLE", "greatest cross-track error, as the boat knew it", lambda s: s.tape.cross_m.most),
    Measure(
        "fence_m",
        "DOUBLE",
        "smallest distance to the fence; negative: outside",
        lambda s: s.truth.fence_m if math.isfinite(s.truth.fence_m) else None,
    ),
    Measure("vessels", "INTEGER", "other vessels", lambda s: len(s.run.nodes.vessels)),
    Measure(
        "nearest_m",
        "DOUBLE",
        "smallest distance to another vessel, from middle to middle",
        lambda s: min((each.nearest_m for each in s.run.nodes.vessels), default=None),
    ),
    Measure(
        "nearest",
        "DOUBLE",
        "the same in domains; below 1 the boat was inside",
        lambda s: min((each.nearest for each in s.run.nodes.vessels), default=None),
    ),
    Measure("entered", "INTEGER", "vessels whose domain the boat entered", _entered),
    Measure("collisions", "INTEGER", "vessels nearer than half the lengths of both", _collisions),
    Measure("things", "INTEGER", "things that stand, and swimmers", lambda s: len(s.run.nodes.things)),
    Measure(
        "clear_m",
        "DOUBLE",
        "smallest distance from the hull to one of them, of swimmers while a propeller turned; negative: it struck it",
        lambda s: _least(each.nearest_m for each in s.run.nodes.things),
    ),
    Measure(
        "still_m",
        "DOUBLE",
        "the same to a swimmer while the propellers stood still; negative: it touched",
        lambda s: _least(each.still_m for each in s.run.nodes.things),
    ),
    Measure("alterations", "INTEGER", "courses that were taken and kept", lambda s: alterations(s.truth.rules.instants)),
    Measure("off_m", "DOUBLE", "farthest from the line of an encounter", lambda s: s.truth.rules.off_m),
    Measure("rules_asked", "INTEGER", "checks of rules 8 and 13 to 17 in an encounter", lambda s: len(_checks(s))),
    Measure("rules_broken", "VARCHAR", "those that were not kept", _broken),
    Measure(
        "stop_m", "DOUBLE", "how far it went from where it entered idle or hold last, drift included", lambda s: s.truth.stop_m
    ),
    Measure(
        "over_deg", "DOUBLE", "overshoot of the last turn ordered in heading or course mode", lambda s: s.truth.steered.over_deg
    ),
    Measure("settled_s", "DOUBLE", "time until that turn was over", lambda s: s.truth.steered.settled_s),
    Measure(
        "steady_rms_deg", "DOUBLE", "error of heading or course from a minute after", lambda s: s.truth.steered.steady_deg.rms
    ),
    Measure("steady_max_deg", "DOUBLE", "the greatest", lambda s: s.truth.steered.steady_deg.most),
    Measure(
        "held_rms_m",
        "DOUBLE",
        "distance to the point of the last hold, from a minute after",
        lambda s: s.truth.steered.held_m.rms,
    ),
    Measure("held_max_m", "DOUBLE", "the greatest", lambda s: s.truth.steered.held_m.most),
    Measure(
        "turned_deg", "DOUBLE", "greatest error of the heading that was held there", lambda s: s.truth.steered.turned_deg.most
    ),
    Measure("resting", "DOUBLE", "part of that time with all thrusters at rest", lambda s: s.truth.steered.resting),
    Measure("line_rms_m", "DOUBLE", "distance to the lines of a path", lambda s: s.truth.steered.lines_m.rms),
    Measure("line_max_m", "DOUBLE", "the greatest", lambda s: s.truth.steered.lines_m.most),
    Measure("arc_rms_m", "DOUBLE", "distance to the arcs of a path", lambda s: s.truth.steered.arcs_m.rms),
    Measure("arc_max_m", "DOUBLE", "the greatest", lambda s: s.truth.steered.arcs_m.most),
    Measure("missed_m", "DOUBLE", "beyond the radius of the waypoint that was missed most", lambda s: s.truth.steered.missed_m),
    Measure("home_rms_m", "DOUBLE", "distance to the driven track on the way home", lambda s: s.truth.steered.home_m.rms),
    Measure("home_max_m", "DOUBLE", "the greatest", lambda s: s.truth.steered.home_m.most),
    Measure("faults", "INTEGER", "faults that began", lambda s: len(_noticed(s))),
    Measure("unnoticed", "INTEGER", "of these, without any notice or mode after them", lambda s: _noticed(s).count(None)),
    Measure("noticed_s", "DOUBLE", "longest time until a fault was noticed", _slowest),
    Measure("end_north_m", "DOUBLE", "true place of the end", lambda s: s.truth.at and s.truth.at[0]),
    Measure("end_east_m", "DOUBLE", "true place of the end", lambda s: s.truth.at and s.truth.at[1]),
    Measure("mode", "VARCHAR", "mode at the end", lambda s: s.truth.mode.name.lower() if s.truth.mode is not None else ""),
    Measure("end", "VARCHAR", "how it ended, in words", lambda s: s.end),
    Measure("pairs", "VARCHAR", "pairs that it met, where they are counted", lambda s: s.pairs),
    Measure("digest", "VARCHAR", "of each cycle, and of the notes of the log", lambda s: s.tape.hash.hexdigest()),
)
