"""Checks how a run among other vessels kept rules 8 and 13 to 17 of the COLREG, by geometry: from the true motion of all, not
from what the boat knew or meant. Only encounters are checked (delfim/simulator/scenarios/encounters.py): there the boat goes
north."""

import math
from collections.abc import Iterator
from typing import Final, NamedTuple

from delfim.base.geodesy import wrap
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.nodes.other_vessels import Vessel, axes_m, nearness
from delfim.simulator.scenarios.encounters import START_S
from delfim.vehicle.helm import setpoints

LOOK_S: Final = 1.0
GIVE_WAY: Final = ("head-on", "give-way", "overtaking")  # what the boat must keep clear in
FROM_STARBOARD: Final = ("head-on", "give-way")  # where it must not turn to port
SETTLED_S: Final = 20.0  # after START_S, until the boat has its course and speed
ALTERED_RAD, SLOWED = math.radians(12.0), 0.8  # beyond these the boat has altered course, or speed as a part of its own
HELD_S: Final = 5.0  # for so long
LARGE_RAD, LARGE_SLOW, SOON_S = math.radians(28.0), 0.55, 40.0  # a manoeuvre that others see, and how soon (rule 8 b)
PORT_S: Final = 12.0  # after it began, a turn shows its side
AMPLE, HOLDS, HOLDS_S = 1.5, 2.6, 60.0  # rule 8 a and 17 a: times the time to leave the domain abeam, and seconds
BOW, BOW_WIDTH = 3.0, 0.5  # ahead of a vessel is the way up to so many half axes of its domain, so many to each side


class Instant(NamedTuple):
    """Position and motion of all vessels: metres, course over ground, m/s."""

    t_s: float
    north_m: float
    east_m: float
    course_rad: float
    speed_mps: float
    vessels: tuple[tuple[float, float, float], ...]  # north, east, course


class Check(NamedTuple):
    rule: str
    vessel: str
    is_kept: bool


class RuleTape:
    """Keeps the motion of all, once a second. Call `look` after each cycle."""

    def __init__(self, run: Lockstep) -> None:
        self._run, self._due_s = run, 0.0
        self.instants = list[Instant]()

    def look(self, now_s: float) -> None:
        nodes = self._run.nodes
        if now_s < self._due_s or not nodes.vessels:
            return
        self._due_s = now_s + LOOK_S
        model = nodes.model
        north_mps, east_mps = model.north_mps, model.east_mps
        course_rad, speed_mps = math.atan2(east_mps, north_mps), math.hypot(north_mps, east_mps)
        others = tuple((each.north_m, each.east_m, each.course_rad) for each in nodes.vessels)
        self.instants.append(Instant(now_s, model.north_m, model.east_m, course_rad, speed_mps, others))

    @property
    def off_m(self) -> float | None:
        """The greatest distance from the line to the north, m."""
        return max((abs(each.east_m) for each in self.instants), default=None)

    def checks(self) -> list[Check]:
        """The rules that demand something of the boat, for each vessel that has a `meeting`."""
        vessels, own_mps = self._run.nodes.vessels, setpoints.speed(None, self._run.settings.control.speed)
        met = [(i, each) for i, each in enumerate(vessels) if each.row.meeting]
        sailed = [each for each in self.instants if each.t_s >= START_S]
        if not met or not sailed:
            return []
        entered = {i: _entered_s(sailed, i, axes_m(each.row.length_m), own_mps) for i, each in met}
        first_s = _altered_s(sailed, own_mps)
        soonest_s = min((t_s for t_s in entered.values() if t_s is not None), default=math.inf)
        judge = Judge(sailed, own_mps, first_s)
        duty = any(each.row.meeting in GIVE_WAY for _, each in met)
        found = list[Check]()
        for i, each in met:
            name = f"{each.row.meeting} {i + 1}"
            is_next = entered[i] == soonest_s < math.inf
            found += [Check(rule, name, is_kept) for rule, is_kept in judge.asked(i, each, entered[i], is_next, duty)]
        return found


class Judge:
    """Judges one run. It knows when the boat first altered course or speed; None: never."""

    def __init__(self, sailed: list[Instant], own_mps: float, first_s: float | None) -> None:
        self._sailed, self._own_mps, self._first_s = sailed, own_mps, first_s

    def asked(self, i: int, vessel: Vessel, entered_s: float | None, is_next: bool, duty: bool) -> Iterator[tuple[str, bool]]:
        """List each rule, and whether it was kept. `entered_s`: when the domain would have been entered; `is_next`: before any
        other; `duty`: the boat must give way to somebody."""
        meeting, first_s = vessel.row.meeting, self._first_s
        leaving_s = axes_m(vessel.row.length_m)[1] / self._own_mps
        turn_rad = self._turn_rad()
        if entered_s is not None and meeting in GIVE_WAY:
            yield "8a in ample time", first_s is not None and entered_s - first_s >= AMPLE * leaving_s
            yield "8b readily apparent", first_s is not None and self._is_large()
        if is_next and meeting in FROM_STARBOARD and first_s is not None:
            yield "14, 15 not to port", turn_rad > -ALTERED_RAD
        if meeting == "head-on" and vessel.nearest < BOW:
            at = min(self._sailed, key=lambda each: math.dist(each[1:3], each.vessels[i][:2]))
            north_m, east_m, _ = at.vessels[i]
            yield "14 port to port", wrap(math.atan2(east_m - at.east_m, north_m - at.north_m)) < 0.0
        if meeting == "give-way":
            yield "15 not ahead of it", not self._is_ahead(i, vessel)
        if is_next and entered_s is not None and not duty and meeting in ("stand-on", "overtaken"):
            yield "17a holds on", first_s is None or entered_s - first_s <= HOLDS * leaving_s + HOLDS_S
        if meeting == "stand-on" and not duty and first_s is not None:
            yield "17c not to port", turn_rad > -ALTERED_RAD

    def _soon(self) -> list[Instant]:
        first_s = math.inf if self._first_s is None else self._first_s
        return [each for each in self._sailed if first_s <= each.t_s <= first_s + SOON_S]

    def _turn_rad(self) -> float:
        """The first turn, rad, positive to starboard."""
        return next((wrap(each.course_rad) for each in self._soon() if each.t_s >= (self._first_s or 0.0) + PORT_S), 0.0)

    def _is_large(self) -> bool:
        soon = self._soon()
        turned_rad = max(abs(wrap(each.course_rad)) for each in soon)
        return turned_rad >= LARGE_RAD or min(each.speed_mps for each in soon) <= LARGE_SLOW * self._own_mps

    def _is_ahead(self, i: int, vessel: Vessel) -> bool:
        """Whether the boat crossed the vessel's bow, near it."""
        ahead_m, abeam_m = axes_m(vessel.row.length_m)
        before = 0.0
        for at in self._sailed:
            north_m, east_m, course_rad = at.vessels[i]
            c, s = math.cos(course_rad), math.sin(course_rad)
            x = ((at.north_m - north_m) * c + (at.east_m - east_m) * s) / ahead_m
            y = ((at.east_m - east_m) * c - (at.north_m - north_m) * s) / abeam_m
            if before * y < 0.0 and 0.0 < x < BOW and abs(y) < BOW_WIDTH:
                return True
            before = y
        return False


def _altered_s(sailed: list[Instant], own_mps: float) -> float | None:
    """The time, s, when the boat first altered course or speed, and kept to it."""
    since_s: float | None = None
    for each in sailed:
        is_off = abs(wrap(each.course_rad)) > ALTERED_RAD or each.speed_mps < SLOWED * own_mps
        if not is_off or each.t_s < START_S + SETTLED_S:
            since_s = None
        elif since_s is None:
            since_s = each.t_s
        elif each.t_s - since_s >= HELD_S:
            return since_s
    return None


def _entered_s(sailed: list[Instant], i: int, axes: tuple[float, float], own_mps: float) -> float | None:
    """The time, s, when the domain would have been entered, had the boat kept its course and speed to the north; None:
    never."""
    begin = sailed[0]
    for each in sailed:
        north_m, east_m, course_rad = each.vessels[i]
        own_m = begin.north_m + own_mps * (each.t_s - begin.t_s)
        if nearness(own_m - north_m, begin.east_m - east_m, course_rad, axes) < 1.0:
            return each.t_s
    return None


def alterations(sailed: list[Instant]) -> int:
    """How often the boat took another course and kept it for 10 s."""
    count, course_rad = 0, 0.0
    for before, each in zip(sailed, sailed[10:], strict=False):
        is_steady = abs(wrap(each.course_rad - before.course_rad)) < ALTERED_RAD / 3.0
        if each.t_s > START_S + SETTLED_S and is_steady and abs(wrap(each.course_rad - course_rad)) > ALTERED_RAD:
            count, course_rad = count + 1, each.course_rad
    return count
