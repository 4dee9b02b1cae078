"""Sails encounters with a point that has a ramp of speed and a limited rate of turn, and checks how it kept the rules."""

import json
import math
import random
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from delfim.base.geodesy import wrap
from delfim.parts.traffic.encounter import Own
from delfim.parts.traffic.keepclear import Memory, decide
from delfim.parts.traffic.trialways import Caution, RouteAhead
from delfim.vehicle.plans.fence import Fence
from delfim.vehicle.target import Target

SETS = Path(__file__).parents[3] / "etc" / "encounters"
LIMITS = Caution(length_m=4.5, turn_radps=math.radians(15.0), ramp_mps2=0.4, stand_on="always")
GIVE_WAY = ("head-on", "give-way", "overtaking")
LARGE_RAD, ALTERED_RAD, ABOUT_RAD = math.radians(28.0), math.radians(10.0), math.radians(175.0)


class Ship(NamedTuple):
    north_m: float
    east_m: float
    course_rad: float
    speed_mps: float
    length_m: float
    kind: str
    tcpa_s: float
    turns_s: float = math.inf  # when it changes its course ...
    turn_rad: float = 0.0  # ... by this

    def at(self, t_s: float) -> "Ship":
        if t_s > self.turns_s:
            there = self._replace(turns_s=math.inf).at(self.turns_s)
            return there._replace(course_rad=self.course_rad + self.turn_rad).at(t_s - self.turns_s)
        way_m = self.speed_mps * t_s
        return self._replace(
            north_m=self.north_m + way_m * math.cos(self.course_rad), east_m=self.east_m + way_m * math.sin(self.course_rad)
        )


LATE_S = 150.0
MUST_TURN = ("stand-on", "overtaken", "head-on")  # what the boat is for a vessel that must do something, too


def late(ships: Sequence[Ship], seed: int) -> tuple[Ship, ...]:
    """Who must keep clear turns 40 degrees to starboard, LATE_S before they meet."""
    return tuple(
        each._replace(turns_s=each.tcpa_s - LATE_S, turn_rad=math.radians(40.0)) if each.kind in MUST_TURN else each
        for each in ships
    )


def turning(ships: Sequence[Ship], seed: int) -> tuple[Ship, ...]:
    """Each turns 30 degrees to some side, 60 to 400 s before they meet."""
    chance = random.Random(seed)
    return tuple(
        each._replace(turns_s=each.tcpa_s - chance.uniform(60.0, 400.0), turn_rad=math.radians(chance.choice((-30.0, 30.0))))
        for each in ships
    )


class Instant(NamedTuple):
    t_s: float
    own: Own
    ships: tuple[Ship, ...]
    course_rad: float  # ordered
    speed_mps: float


Blur = Callable[[float, Sequence[Ship]], list[Target]]


def encounters(name: str) -> list[tuple[str, tuple[Ship, ...]]]:
    """The encounters of a set, by their titles; the own boat goes 1.5 m/s."""
    rows = json.loads((SETS / f"{name}.json").read_text())["encounters"]
    return [(f"{row['id']} {row['title']}", tuple(map(_ship, row["targets"]))) for row in rows]


def _ship(row: dict[str, float | str]) -> Ship:
    numbers = {name: float(value) for name, value in row.items() if name != "kind"}
    return Ship(
        *(numbers["north_m"], numbers["east_m"], math.radians(numbers["course_deg"]), numbers["speed_mps"]),
        *(numbers["length_m"], str(row["kind"]), numbers["tcpa_s"]),
    )


def target(number: int, ship: Ship, margin_m: float = 0.0) -> Target:
    return Target(
        key=str(number),
        name=f"SHIP {number}",
        north_m=ship.north_m,
        east_m=ship.east_m,
        course_rad=ship.course_rad,
        speed_mps=ship.speed_mps,
        heading_rad=math.nan,
        length_m=ship.length_m,
        beam_m=ship.length_m / 6.0,
        is_size_known=True,
        margin_m=margin_m,
        age_s=0.0,
        is_lost=False,
        kind="A",
        status=0,
    )


def exactly(t_s: float, ships: Sequence[Ship]) -> list[Target]:
    return [target(i, ship) for i, ship in enumerate(ships)]


class ClassB:
    """Reports each 30 s of which a fifth is lost, with a position 5 m off that wanders, and errors of speed and course."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)
        self._last: dict[int, tuple[float, Ship]] = {}
        self._off: dict[int, list[float]] = {}
        self._phase: dict[int, float] = {}

    def __call__(self, t_s: float, ships: Sequence[Ship]) -> list[Target]:
        gauss, keep, seen = self._random.gauss, math.exp(-2.0 / 60.0), []
        for i, ship in enumerate(ships):
            off = self._off.setdefault(i, [gauss(0.0, 5.0), gauss(0.0, 5.0)])
            off[:] = [keep * each + gauss(0.0, 5.0 * math.sqrt(1.0 - keep * keep)) for each in off]
            if (t_s + self._phase.setdefault(i, self._random.uniform(0.0, 30.0))) % 30.0 < 2.0 and self._random.random() >= 0.2:
                speed_kn = max(round(ship.speed_mps / 0.514444 + gauss(0.0, 0.1), 1), 0.0)
                off_rad = math.radians(gauss(0.0, 2.0 if speed_kn < 3.0 else 0.7))
                heard = ship._replace(
                    north_m=ship.north_m + off[0],
                    east_m=ship.east_m + off[1],
                    course_rad=ship.course_rad + off_rad,
                    speed_mps=speed_kn * 0.514444,
                )
                self._last[i] = t_s, heard
            if i in self._last:
                at_s, heard = self._last[i]
                seen.append(target(i, heard.at(t_s - at_s), 10.0 + 0.15 * (t_s - at_s)))
        return seen


def sail(
    ships: Sequence[Ship], limits: Caution = LIMITS, speed_mps: float = 1.5, see: Blur = exactly, around: Fence | None = None
) -> list[Instant]:
    """Second by second, a decision every other one, to 600 s after the last meeting. The boat is on its way north."""
    end_s = int(max(ship.tcpa_s for ship in ships) + 600.0)
    goal = (speed_mps * (end_s + 600.0), 0.0)
    own, memory, order, log = Own(0.0, 0.0, 0.0, speed_mps), Memory(), None, list[Instant]()
    for t in range(end_s):
        now = tuple(ship.at(float(t)) for ship in ships)
        if t % 2 == 0:
            memory, order, _ = decide(limits, memory, own, RouteAhead((goal,), speed_mps), see(float(t), now), around, float(t))
        course_rad = math.atan2(goal[1] - own.east_m, goal[0] - own.north_m) if order is None else order.course_rad
        asked_mps = speed_mps if order is None else order.speed_mps
        log.append(Instant(float(t), own, now, course_rad, asked_mps))
        own = moved(own, course_rad, asked_mps, limits)
    return log


def moved(own: Own, course_rad: float, speed_mps: float, limits: Caution) -> Own:
    """The point a second later."""
    turn_rad = min(max(wrap(course_rad - own.course_rad), -limits.turn_radps), limits.turn_radps)
    now_mps = own.speed_mps + min(max(speed_mps - own.speed_mps, -limits.ramp_mps2), limits.ramp_mps2)
    now_rad = wrap(own.course_rad + turn_rad)
    return Own(own.north_m + now_mps * math.cos(now_rad), own.east_m + now_mps * math.sin(now_rad), now_rad, now_mps)


def half_axes_m(ship: Ship) -> tuple[float, float]:
    return max(4.0 * ship.length_m, 50.0), max(1.6 * ship.length_m, 30.0)


def place(own: Own, ship: Ship) -> tuple[float, float, float]:
    """(nearness, ahead, to starboard) of the boat in a ship's domain."""
    ahead_m, abeam_m = half_axes_m(ship)
    north_m, east_m = own.north_m - ship.north_m, own.east_m - ship.east_m
    cos, sin = math.cos(ship.course_rad), math.sin(ship.course_rad)
    x, y = (north_m * cos + east_m * sin) / ahead_m, (east_m * cos - north_m * sin) / abeam_m
    return math.hypot(x, y), x, y


class Score(NamedTuple):
    nearness: tuple[float, ...]  # least, of each ship
    distance_m: float  # least
    orders: int
    checks: dict[str, list[bool]]  # by rule


def score(log: Sequence[Instant], speed_mps: float = 1.5) -> Score:
    """Every ship is judged by what it was at the beginning."""
    ships, checks = log[0].ships, dict[str, list[bool]]()
    first = next((now for now in log if abs(wrap(now.course_rad)) > ALTERED_RAD or now.speed_mps < 0.85 * speed_mps), None)
    breaches = [_breach_s(ship, speed_mps, len(log)) for ship in ships]
    bound = any(ship.kind in GIVE_WAY for ship in ships)
    ways = [[place(now.own, now.ships[i]) for now in log] for i in range(len(ships))]
    for i, ship in enumerate(ships):
        for rule, kept in _judged(log, ship, i, ways[i], breaches, first, bound, speed_mps):
            checks.setdefault(rule, []).append(kept)
    orders, was = 0, log[0]
    for now in log:
        if abs(wrap(now.course_rad - was.course_rad)) > math.radians(5.0) or abs(now.speed_mps - was.speed_mps) > 0.1:
            orders, was = orders + 1, now
    checks["8b few orders"] = [orders <= 2 + 2 * len(ships)]
    least_m = min(math.hypot(now.own.north_m - s.north_m, now.own.east_m - s.east_m) for now in log for s in now.ships)
    return Score(tuple(min(way)[0] for way in ways), least_m, orders, checks)


def _judged(
    log: Sequence[Instant],
    ship: Ship,
    number: int,
    way: Sequence[tuple[float, float, float]],
    breaches: Sequence[float | None],
    first: Instant | None,
    bound: bool,
    speed_mps: float,
) -> list[tuple[str, bool]]:
    at, breach_s, out_s = way.index(min(way)), breaches[number], half_axes_m(ship)[1] / speed_mps
    found, kind = [("8d clear", min(way)[0] >= 0.999)], ship.kind
    if breach_s is not None and kind in GIVE_WAY:
        found.append(("8a ample time", first is not None and breach_s - first.t_s >= 1.5 * out_s))
        found.append(("8b large", first is not None and _is_large(log, first, speed_mps)))
    if kind == "head-on" and min(way)[0] < 3.0:
        own, there = log[at].own, log[at].ships[number]
        found.append(("14 port to port", math.atan2(there.east_m - own.east_m, there.north_m - own.north_m) < 0.0))
    if kind == "give-way":
        crosses = any(p[2] * q[2] < 0.0 < q[1] < 3.0 and abs(q[2]) < 0.5 for p, q in pairwise(way))
        found.append(("15 not ahead", not crosses))
    soonest_s = min((each for each in breaches if each is not None), default=None)
    if kind in ("head-on", "give-way") and breach_s is not None and breach_s == soonest_s and first is not None:
        found.append(("14, 15 not to port", not -ABOUT_RAD < wrap(first.course_rad) < -ALTERED_RAD))
    if kind in ("stand-on", "overtaken") and not bound and breach_s is not None and breach_s == soonest_s:
        found.append(("17a stands on", first is None or breach_s - first.t_s <= 2.6 * out_s + 60.0))
    if kind == "stand-on" and not bound and first is not None:
        turned = next((wrap(now.own.course_rad) for now in log if now.t_s >= first.t_s + 8.0), 0.0)
        found.append(("17c not to port", turned > -ALTERED_RAD or abs(turned) > 2.0))
    return found


def _is_large(log: Sequence[Instant], first: Instant, speed_mps: float) -> bool:
    soon = [now.own for now in log if first.t_s <= now.t_s <= first.t_s + 30.0]
    return max(abs(wrap(own.course_rad)) for own in soon) >= LARGE_RAD or min(own.speed_mps for own in soon) <= 0.55 * speed_mps


def _breach_s(ship: Ship, speed_mps: float, end_s: int) -> float | None:
    """When the boat would have been in the domain if it had gone on; None: never."""
    return next((float(t) for t in range(end_s) if place(Own(speed_mps * t, 0.0, 0.0, speed_mps), ship.at(t))[0] < 1.0), None)
