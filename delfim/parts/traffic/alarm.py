"""Decides which vessels are a danger: two levels with hysteresis, by a pure function, for all vessels that are known."""

import math
from collections.abc import Mapping, Sequence
from typing import Final, Literal, NamedTuple

from delfim.base.cooperative import Work
from delfim.base.vessels import THINGS
from delfim.config import TrafficNear
from delfim.parts.traffic.cpa import Approach, approach, closest, passing_by
from delfim.parts.traffic.encounter import AT_REST_MPS, Own
from delfim.parts.traffic.keepclear import PassedBy, measured, plausible
from delfim.parts.traffic.trialways import Caution, RouteAhead, clear_m, core, route_legs
from delfim.vehicle.target import Danger, Target

OVER: Final = 1.5  # a danger is over when every measure was beyond so many times its limit ...
OVER_S: Final = 10.0  # ... for so long
NEAR: Final = 2.0  # domains, of a vessel that closes
ENTERS_S: Final = 30.0  # so soon, a thing in the way is a danger
JUDGED: Final = 6  # comparisons that the danger of one vessel costs

_new = tuple.__new__  # a third of the time of Danger(...)


class Alarm(NamedTuple):
    level: str  # "near" or "danger"
    seen_s: float  # when it was last within OVER times the limit


Guarded = Literal["no", "on its way", "away"]  # by an order
Alarms = Mapping[str, Alarm]  # by vessel


def dangers(
    limits: TrafficNear,
    caution: Caution,
    own: Own,
    route: RouteAhead,
    targets: Sequence[Target],
    passes: Sequence[PassedBy],
    guarded: Guarded,
    before: Alarms,
    now_s: float,
) -> Work[tuple[tuple[Danger, ...], Alarms]]:
    """Judge all vessels, in slices: each gets its danger. `passes`: what the guard found. Where it is on guard a danger is only
    what it finds no way out of."""
    found, after = list[Danger](), dict[str, Alarm]()
    if not plausible(*own):
        return (), {}
    on, known = route_legs(own, route), {each.key: each for each in passes}
    north_mps, east_mps = own.speed_mps * math.cos(own.course_rad), own.speed_mps * math.sin(own.course_rad)
    now = ((0.0, 1.0, own.north_m, own.east_m, 0.0, 0.0),)
    for target in targets:
        yield JUDGED
        if not plausible(*target[2:6], target.length_m):
            continue
        cpa_m, tcpa_s = closest(own.north_m, own.east_m, north_mps, east_mps, target)
        around, look_s, _, _ = measured(caution, own, route.speed_mps, target)
        here, _, _, _ = passing_by(around, now, 1e-6)
        passed = known.get(target.key)
        to_come = passed.without if passed is not None else approach(around, on, 2.0 * look_s)
        nearness = passed.nearness if passed is not None else to_come.nearness
        far_m = math.hypot(target.north_m - own.north_m, target.east_m - own.east_m)
        may_enter = guarded == "away" or (guarded == "no" and to_come.at_s < look_s)
        close = min(here, nearness) if may_enter else here
        if own.speed_mps < AT_REST_MPS and target.speed_mps < AT_REST_MPS:
            close = nearness = math.inf  # both lie in a harbour
        near = min(
            min(nearness, to_come.nearness) if nearness < math.inf else math.inf,
            here / NEAR if tcpa_s > 0.0 else math.inf,
            cpa_m / limits.cpa_m if limits.cpa_m and 0.0 <= tcpa_s < limits.tcpa_s else math.inf,
            far_m / limits.zone_m if limits.zone_m else math.inf,
            0.0 if target.kind == "distress" else math.inf,
        )
        if target.kind in THINGS:
            close, near = _of_thing(caution, own, route.speed_mps, target, guarded, to_come)
        alarm = _alarm(before.get(target.key), close, near, now_s)
        words = ""
        if alarm is not None:
            after[target.key] = alarm
            words = _words(target, alarm.level, far_m, cpa_m, tcpa_s)
        found.append(_new(Danger, (target.key, cpa_m, tcpa_s, nearness, _level(alarm), words)))
    return tuple(found), after


def _of_thing(
    caution: Caution, own: Own, speed_mps: float, thing: Target, guarded: Guarded, to_come: Approach
) -> tuple[float, float]:
    """Its `close` and `near`, for `_alarm`: half as far off as the boat keeps is a danger, and so is a thing in the way that
    nobody keeps clear of. A boat that lies has none."""
    if own.speed_mps < AT_REST_MPS:
        return math.inf, math.inf
    away_m = math.hypot(thing.north_m - own.north_m, thing.east_m - own.east_m)
    core_m, keeps_m = core(caution, thing), clear_m(caution, thing.kind)
    close, near = away_m / (core_m + keeps_m / NEAR), math.inf
    if guarded == "no":
        close, near = min(close, to_come.nearness if to_come.at_s < ENTERS_S else math.inf), to_come.nearness
    return close, away_m / (core_m + NEAR * keeps_m) if thing.kind == "person" else near


def _alarm(was: Alarm | None, close: float, near: float, now_s: float) -> Alarm | None:
    """The level of danger; `close` and `near` are 1 at the limit of either."""
    level = "danger" if close < 1.0 else "near" if near < 1.0 else ""
    if was is None:
        return Alarm(level, now_s) if level else None
    if level == "danger" or (was.level == "danger" and close < OVER):
        return Alarm("danger", now_s)
    if was.level == "danger" and now_s - was.seen_s < OVER_S:
        return was
    if near < OVER:
        return Alarm("near", now_s)
    return was._replace(level="near") if now_s - was.seen_s < OVER_S else None


def _level(alarm: Alarm | None) -> Literal["none", "near", "danger"]:
    return "none" if alarm is None else "danger" if alarm.level == "danger" else "near"


def _words(target: Target, level: str, far_m: float, cpa_m: float, tcpa_s: float) -> str:
    if target.kind == "distress":
        return f"distress signal of {target.name}, {far_m:.0f} m away"
    how = "close" if level == "danger" else "near"
    if tcpa_s > 0.0:
        return f"{target.name} is {how}: {far_m:.0f} m away, CPA {cpa_m:.0f} m in {tcpa_s:.0f} s"
    return f"{target.name} is {how}: {far_m:.0f} m away, drawing apart"
