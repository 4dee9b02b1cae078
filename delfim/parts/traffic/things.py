"""Things that stand in the water, and swimmers, as programs aboard see them: a buoy, a pile, a boat at its mooring
(docs/traffic.md).

A thing is known by its place, whichever program tells of it and under whichever name, so that two programs that see one buoy
make one thing of it. The confidences of its sightings, one a second, add up: from BELIEVED on it is there, and out of view it
is kept for KEPT times as many seconds. What is small and moves by itself is taken for a swimmer. Bounded; no clock, no
exception for any report.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from delfim.base.cooperative import Work
from delfim.base.geodesy import Origin, to_plane, wrap
from delfim.base.vessels import ThingSeen
from delfim.config import TrafficTable
from delfim.parts.traffic.thingmotion import RADIUS_M, ThingMotion, seen_again, seen_at, told_to_move
from delfim.vehicle.target import STATUS_UNKNOWN, Target

MOST: Final = 100
BELIEVED: Final = 1.0 - 1e-9  # sum of confidences from which on a thing is there
COUNTED_S: Final = 1.0  # one sighting in this time counts
KEPT: Final = 10.0  # seconds out of view for each such sighting of full confidence
PERSON_S: Final = 120.0  # a swimmer is kept no longer, since it swims ...
PERSON_MPS: Final = 1.0  # ... as fast as that
PERSON_MAX_M: Final = 60.0
MARGIN_M: Final = 2.0  # of the place of a thing, with that of the boat itself
HEAD_REACH_M: Final = 6.1  # farther from the edge of a thing, or from where a swimmer may be, no sighting is of it
REACH_MAX_M: Final = 6.1 + PERSON_MPS * PERSON_S  # no sighting so far off is of any thing: most things are no nearer
SAME_M: Final = 3.0  # a sighting so near to a thing is of that one, ...
SAME_PERSON_M: Final = 6.0  # ... or to a swimmer: a camera tells poorly how far away a head is
HEAD_M: Final = 1.0  # radius of what may be a head above the water, seen by who cannot tell it from a buoy, ...
SWIMS_S: Final = 5.0  # what may be a head and moves for so long is one
CARRIED_S: Final = 10.0  # out of view it is reckoned on for so long
HEAD_S: Final = 3.0  # ... and for how long after a sighting what is seen where it may be is it
SMOOTH, SMOOTH_PERSON = 4, 2  # sightings that make the place of a thing, and of a swimmer
NUMBERS: Final = 999
LOOKED: Final = 3  # comparisons that where one thing is now costs
LATITUDE_MAX_RAD: Final = math.radians(89.0)


@dataclass(slots=True)
class Thing:
    """A thing that was seen, or may have been. Angles in rad, times monotonic."""

    kind: str
    name: str
    number: int
    latitude_rad: float
    longitude_rad: float
    radius_m: float
    at_s: float  # of the last sighting
    belief: float  # sum of confidences
    counted_s: float  # when a sighting was added last
    motion: ThingMotion
    seen: int = 1

    def kept_s(self, limits: TrafficTable) -> float:
        """How long it is kept out of view, s."""
        most_s = limits.kept_thing_s if self.kind == "thing" else min(PERSON_S, limits.kept_thing_s)
        return max(min(KEPT * self.belief, most_s), limits.lost_near_s)

    def take(self, told: ThingSeen, now_s: float) -> None:
        """Take the next sighting."""
        self.seen, self.kind = self.seen + 1, told.kind if told.kind == "person" else self.kind
        part = 1.0 / min(self.seen, SMOOTH_PERSON if self.kind == "person" else SMOOTH)
        self.latitude_rad += part * (told.latitude_rad - self.latitude_rad)
        self.longitude_rad = wrap(self.longitude_rad + part * wrap(told.longitude_rad - self.longitude_rad))
        self.radius_m += part * (told.radius_m - self.radius_m)
        self.at_s = max(now_s, self.at_s)
        self.move(told, seen_again(self.motion, told.latitude_rad, told.longitude_rad, now_s))
        if now_s - self.counted_s >= COUNTED_S:
            self.belief, self.counted_s = self.belief + told.confidence, now_s

    def move(self, told: ThingSeen, motion: ThingMotion) -> None:
        """Know of its motion what came of this sighting."""
        if told.course_rad is not None and told.speed_mps is not None:
            motion = told_to_move(motion, told.course_rad, told.speed_mps)
        self.motion = motion
        if self.radius_m <= HEAD_M and motion.at_s - motion.moves_s >= SWIMS_S:
            self.kind = "person"

    def target(self, origin: Origin, age_s: float) -> Target:
        """It as others are told of it: a circle that lies still, or that moves. After CARRIED_S without a sighting nobody knows
        how."""
        north_m, east_m = to_plane(origin, self.latitude_rad, self.longitude_rad)
        north_mps, east_mps = self.motion.mps
        speed_mps, carried_s = math.hypot(north_mps, east_mps), min(age_s, CARRIED_S)
        may_move = self.kind == "person" or speed_mps > 0.0
        margin_m = MARGIN_M + (min(PERSON_MPS * age_s, PERSON_MAX_M) if may_move else 0.0)
        course_rad = math.atan2(east_mps, north_mps) % math.tau if speed_mps else 0.0
        size_m = 2.0 * self.radius_m
        told_mps = speed_mps if age_s < CARRIED_S else 0.0
        at = north_m + north_mps * carried_s, east_m + east_mps * carried_s
        place = (*at, course_rad, told_mps, math.nan, size_m, size_m)
        return Target(f"{self.kind} {self.number}", self.name, *place, True, margin_m, age_s, False, self.kind, STATUS_UNKNOWN)


class Things:
    """All things that are known, MOST at most. `refused` counts sightings that found no room."""

    def __init__(self, limits: TrafficTable) -> None:
        self._limits = limits
        self._things = dict[int, Thing]()  # by number
        self._last = 0  # number
        self._here = 0.0, 0.0  # latitude and longitude of the boat at the last look
        self.refused = 0

    def __len__(self) -> int:
        return len(self._things)

    def hear(self, told: ThingSeen, name: str, now_s: float) -> int:
        """Take a sighting. `name`: who saw it, and as what. Returns how many things it had to be measured against."""
        if not abs(told.latitude_rad) <= LATITUDE_MAX_RAD or told.latitude_rad == told.longitude_rad == 0.0:
            self.refused += 1
            return 0
        near = self._near(told, now_s)
        known = _nearest(near, told, now_s)
        if known is not None and told.confidence == 0.0:
            del self._things[known.number]
        elif known is not None:
            known.take(told, now_s)
            if known.kind == "person":
                self._gather(known, now_s)
        elif told.confidence > 0.0:
            is_full = len(self._things) >= MOST
            if not is_full or self._makes_room(told):
                number = next(each for i in range(NUMBERS) if (each := (self._last + i) % NUMBERS + 1) not in self._things)
                self._last = number
                place = told.latitude_rad, told.longitude_rad
                new = (told.kind, name, number, *place, told.radius_m, now_s, told.confidence, now_s, seen_at(*place, now_s))
                self._things[number] = fresh = Thing(*new)
                fresh.move(told, fresh.motion)
            return len(near) + (MOST if is_full else 0)
        return len(near)

    def _near(self, told: ThingSeen | Thing, now_s: float) -> list[Thing]:
        """The things of which something there may be one. Most are not, and the loop waits for this: no function for those."""
        latitude_rad, longitude_rad = told.latitude_rad, told.longitude_rad
        parallel_m, found = RADIUS_M * math.cos(latitude_rad), list[Thing]()
        for each in self._things.values():
            north_m = RADIUS_M * (latitude_rad - each.latitude_rad)
            if not -REACH_MAX_M <= north_m <= REACH_MAX_M:
                continue
            reach_m = HEAD_REACH_M + (each.radius_m if each.kind == "thing" else PERSON_MPS * abs(now_s - each.at_s))
            if not -reach_m <= north_m <= reach_m:
                continue
            if not reach_m < abs(parallel_m * (longitude_rad - each.longitude_rad)) < math.tau * parallel_m - reach_m:
                found.append(each)
        return found

    def _gather(self, swimmer: Thing, now_s: float) -> None:
        """What is so near to a swimmer and as small is that one, which a camera took for another, farther or nearer."""
        for each in self._near(swimmer, now_s):
            is_small = each.kind == "person" or each.radius_m <= HEAD_M
            if each is not swimmer and is_small and _far_m(each, swimmer) <= SAME_PERSON_M:
                swimmer.belief = max(swimmer.belief, each.belief)
                del self._things[each.number]

    def _makes_room(self, told: ThingSeen) -> bool:
        """Whether it is one of the MOST that are nearest to the boat: then the farthest one goes."""
        last = max(self._things.values(), key=lambda each: self._away(each.latitude_rad, each.longitude_rad))
        self.refused += 1
        if self._away(told.latitude_rad, told.longitude_rad) >= self._away(last.latitude_rad, last.longitude_rad):
            return False
        del self._things[last.number]
        return True

    def _away(self, latitude_rad: float, longitude_rad: float) -> float:
        east_rad = wrap(longitude_rad - self._here[1]) * math.cos(latitude_rad)
        return math.hypot(latitude_rad - self._here[0], east_rad)

    def looked(self, now_s: float, origin: Origin, latitude_rad: float, longitude_rad: float) -> Work[list[Target]]:
        """The things that are believed in now. Forgets those that were not seen for long. `latitude_rad`, `longitude_rad`: of
        the boat."""
        self._here = latitude_rad, longitude_rad
        found = list[Target]()
        for number, each in tuple(self._things.items()):
            yield LOOKED
            age_s = max(now_s - each.at_s, 0.0)
            if age_s <= each.kept_s(self._limits):
                if each.belief >= BELIEVED:
                    found.append(each.target(origin, age_s))
            elif self._things.get(number) is each:
                del self._things[number]
        return found


def _nearest(near: Iterable[Thing], told: ThingSeen, now_s: float) -> Thing | None:
    """The thing of which this is a sighting, a swimmer first, the nearest one; None: it is a new one."""
    found, least = None, (True, math.inf)
    for each in near:
        far_m = _far_m(each, told)
        if far_m <= _reach_m(each, told, now_s) and (this := (each.kind != "person", far_m)) < least:
            found, least = each, this
    return found


def _far_m(each: Thing, told: ThingSeen | Thing) -> float:
    """From a thing to a sighting, m."""
    north_m = RADIUS_M * (told.latitude_rad - each.latitude_rad)
    return math.hypot(north_m, RADIUS_M * math.cos(told.latitude_rad) * wrap(told.longitude_rad - each.longitude_rad))


def _reach_m(each: Thing, told: ThingSeen, now_s: float) -> float:
    """How near to a thing a sighting is of that one, m; negative: of another kind. Who is called a swimmer by one program is
    one, though another sees something small there."""
    if each.kind == told.kind == "thing":
        return each.radius_m if each.radius_m > SAME_M else SAME_M
    swum_m = PERSON_MPS * max(now_s - each.at_s, 0.0)
    if each.kind == told.kind:
        return SAME_PERSON_M + swum_m
    if (each.radius_m if each.kind == "thing" else told.radius_m) > HEAD_M:
        return -1.0
    return SAME_PERSON_M if each.kind == "thing" or swum_m <= HEAD_S * PERSON_MPS else -1.0
