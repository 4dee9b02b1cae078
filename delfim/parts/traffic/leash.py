"""Bounds how far, and for how long, others may move the boat: the guard believes whatever AIS reports.

Anybody with a transmitter can pretend to be a ship, or a fleet of them that follows the boat. From the leg or the place that
the boat was told to keep the guard leads it no farther than `away_m`, and under way for no longer than `away_s`; then it rests
for as long as it led. A stop does not count: an anchorage may keep a boat waiting.
"""

import math
from itertools import pairwise
from typing import Final, NamedTuple

from delfim.config import TrafficGuard
from delfim.parts.traffic.encounter import Own
from delfim.parts.traffic.trialways import RouteAhead
from delfim.vehicle.plans.zones import Point, from_segment
from delfim.vehicle.target import NEVER_S, CourseOrder

REST_S: Final = 60.0  # at least
LOOK_S: Final = 10.0  # between two looks, at most


class Leash(NamedTuple):
    """The displacement of the boat by the guard so far."""

    task: object = None  # of the boat; another one has another way
    way: tuple[Point, ...] = ()  # that the boat was led from; empty: it was not
    led_s: float = 0.0  # under way by orders; it runs back while there are none
    spent: str = ""  # why the guard leads the boat no farther, in words, until `led_s` has run back
    at_s: float = NEVER_S


def paid_out(
    was: Leash,
    limits: TrafficGuard,
    task: object,
    route: RouteAhead,
    own: Own,
    order: CourseOrder | None,
    now_s: float,
) -> Leash:
    """After each decision. `order`: what came of it."""
    passed_s, here = min(max(now_s - was.at_s, 0.0), LOOK_S), (own.north_m, own.east_m)
    is_led = order is not None and order.speed_mps > 0.0
    led_s = was.led_s + passed_s if is_led else max(was.led_s - passed_s, 0.0)
    way, spent = was.way if task == was.task else (), was.spent if led_s > 0.0 else ""
    if order is None:  # a leg begins anew; a course has none, and whoever leads the boat again soon leads it from the same line
        is_same = not route.has_end and (led_s > 0.0 or was.spent)
        return Leash(task, way if is_same else (), led_s, spent, now_s)
    way = (route.place,) if route.place is not None else way or (here, *route.points)
    away_m = _away_m(way, here)
    if away_m >= limits.away_m:
        spent = f"it led the boat {away_m:.0f} m away (traffic.guard.away_m)"
    elif led_s >= limits.away_s:
        spent = f"it led the boat for {led_s:.0f} s (traffic.guard.away_s)"
    return Leash(task, way, max(led_s, REST_S) if spent else led_s, spent, now_s)


def _away_m(way: tuple[Point, ...], here: Point) -> float:
    """The distance from a way in straight pieces, m."""
    if len(way) == 1:
        return math.dist(way[0], here)
    return min(from_segment(a, (b[0] - a[0], b[1] - a[1]), here) for a, b in pairwise(way))
