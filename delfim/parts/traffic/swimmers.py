"""Swimmers near the boat: it goes slowly by, and beside one its propellers stop. A turning propeller is what kills.

They stop, and do not brake or steer: both turn them. So a boat beside a swimmer drifts, and may still touch one who swims into
it. They turn again when the swimmer is clear by more, for some seconds; one out of view is where it was, as long as it is kept.
Pure, and cheap: it is asked ten times a second.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from delfim.base.geodesy import wrap
from delfim.parts.traffic.encounter import Own
from delfim.parts.traffic.trialways import Caution, core
from delfim.vehicle.state import Motion
from delfim.vehicle.target import CourseOrder, Target

SLOW: Final = 0.5  # of the speed, near a swimmer
ALONG: Final = 0.6  # a swimmer goes along with the boat at so much of its slow speed
MORE_M, CLEAR_S = 4.0, 5.0  # the propellers turn again when the swimmer is so much farther off, for so long
NEARBY_M: Final = 60.0  # farther off none can be beside the boat before the next look
RECKONED_S: Final = 5.0  # a swimmer's way since the last look is reckoned on for so long


class Stopped(NamedTuple):
    """The propellers are stopped, for a swimmer."""

    key: str
    name: str
    course_rad: float  # the heading of the boat when they stopped: it drifts
    near_s: float  # when one was so near last
    at_s: float  # when it was looked at last

    @property
    def words(self) -> str:
        return f"propellers stopped: {self.name}, a swimmer, is beside the boat"

    @property
    def order(self) -> CourseOrder:
        return CourseOrder(self.course_rad, 0.0, 0.0, self.words, self.key, 0.0, self.at_s)


def nearby(things: Sequence[Target], north_m: float, east_m: float, stop_m: float) -> tuple[Target, ...]:
    """The swimmers who may be beside the boat before the next look."""
    within_m = NEARBY_M + stop_m
    swimmers = [each for each in things if each.kind == "person"]
    return tuple(each for each in swimmers if math.hypot(each.north_m - north_m, each.east_m - east_m) < within_m)


def stopped_for(
    was: Stopped | None, swimmers: Sequence[Target], at_s: float, motion: Motion, length_m: float, stop_m: float, now_s: float
) -> Stopped | None:
    """Whether the propellers are stopped from now on; None: they may turn. `swimmers` as they were at `at_s`; `length_m`: of
    the boat; `stop_m`: so near to its side or end."""
    passed_s = min(max(now_s - at_s, 0.0), RECKONED_S)
    nearest, least_m = None, math.inf
    for each in swimmers:
        way_m = each.speed_mps * passed_s
        north_m = each.north_m + way_m * math.cos(each.course_rad) - motion.north_m
        east_m = each.east_m + way_m * math.sin(each.course_rad) - motion.east_m
        away_m = math.hypot(north_m, east_m) - (each.length_m + length_m) / 2.0
        if away_m < least_m:
            nearest, least_m = each, away_m
    if was is None:
        if nearest is None or not least_m < stop_m:
            return None
        return Stopped(nearest.key, nearest.name, motion.heading_rad, now_s, now_s)
    if nearest is not None and least_m < stop_m + MORE_M:
        return Stopped(nearest.key, nearest.name, was.course_rad, now_s, now_s)
    return was._replace(at_s=now_s) if now_s - was.near_s < CLEAR_S else None


def swimmer_near(limits: Caution, own: Own, speed_mps: float, things: Sequence[Target]) -> Target | None:
    """A swimmer so near that the boat goes slowly; None: there is none. One that swims the same way about as fast as the slow
    boat is no reason: it would catch up with it, or go beside it for long; the boat leaves it behind, or passes it at the full
    distance."""
    for each in things:
        core_m, north_m, east_m = core(limits, each), each.north_m - own.north_m, each.east_m - own.east_m
        away_m = math.hypot(north_m, east_m)
        if each.kind != "person" or away_m >= core_m + 2.0 * limits.person_clear_m:
            continue
        along_mps = each.speed_mps * math.cos(wrap(each.course_rad - own.course_rad))
        is_abaft = math.cos(wrap(math.atan2(east_m, north_m) - own.course_rad)) < 0.0
        if along_mps < ALONG * SLOW * speed_mps or not (is_abaft or away_m > core_m + limits.person_clear_m):
            return each
    return None
