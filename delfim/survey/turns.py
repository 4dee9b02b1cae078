"""The shortest way of a boat that cannot turn on the spot, from one heading to another: three pieces, each an arc of its
smallest radius or straight (Dubins 1957). Angles as the compass has them: from north, clockwise, rad."""

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import Final, NamedTuple

from delfim.survey.ground import Place, Segment
from delfim.survey.ways import OpenWater
from delfim.vehicle.plans.mission import LEG_MIN_M

SHORT_M: Final = 0.6  # a piece that is no longer is left out: its neighbours bend by as little
FARTHER: Final = 2.0  # than a boat stops there is water ahead of a turn, where one has so much: it turns late, and faster
LATE_RAD: Final = 0.6  # of an arc that a boat leaves out before it turns to the other side
DRAWN_RAD: Final = 0.2  # of an arc, from place to place


class Bend(NamedTuple):
    """A piece of a turn: straight, or an arc about its centre."""

    to: Place
    centre: Place | None = None
    turn_rad: float = 0.0  # of the arc, positive to starboard
    radius_m: float = 0.0

    @property
    def long_m(self) -> float:
        """Of an arc; what a straight piece is long depends on what is before it."""
        return abs(self.turn_rad) * self.radius_m


def turn(begin: Place, heading_rad: float, end: Place, end_rad: float, radius_m: float) -> list[Bend]:
    """The pieces from one place and heading to another."""
    return next(turns(begin, heading_rad, end, end_rad, radius_m))


def turns(begin: Place, heading_rad: float, end: Place, end_rad: float, radius_m: float) -> Iterator[list[Bend]]:
    """The same by each kind of path, the shortest first."""
    east, north = end[0] - begin[0], end[1] - begin[1]
    line_rad = math.atan2(north, east)
    a, b = (_mod(math.pi / 2.0 - each - line_rad) for each in (heading_rad, end_rad))  # counter-clockwise, from the line
    for word, parts in sorted(_words(math.hypot(east, north) / radius_m, a, b), key=lambda found: sum(found[1])):
        here, now_rad, pieces = begin, heading_rad, list[Bend]()
        for letter, part in zip(word, parts, strict=True):
            if part * radius_m < SHORT_M:
                here, now_rad = _ahead(here, now_rad, letter, part, radius_m)[:2]
                continue
            there, after_rad, centre = _ahead(here, now_rad, letter, part, radius_m)
            pieces.append(Bend(there) if centre is None else Bend(there, centre, after_rad - now_rad, radius_m))
            here, now_rad = there, after_rad
        yield pieces


def turned(
    ways: OpenWater, here: Place, heading_rad: float, ahead: Place, ahead_rad: float, radius_m: float, brake_m: float
) -> list[Bend]:
    """From the run-out of a line to the run-in of the next one: by arcs, where the boat may turn so, if need be not by the
    shortest."""
    for ahead_m in (FARTHER * brake_m, brake_m) if radius_m else ():
        for bends in turns(here, heading_rad, ahead, ahead_rad, radius_m):
            if _can_turn(ways.turning, here, bends, ahead_m):
                return bends
    places = [*ways.between(here, ahead), ahead]
    kept = [there for before_it, there in pairwise([here, *places]) if math.dist(before_it, there) >= LEG_MIN_M]
    return [Bend(place) for place in kept]


def long_m(begin: Place, bends: Iterable[Bend]) -> float:
    bends = tuple(bends)
    places = [begin, *(bend.to for bend in bends)]
    return sum(bend.long_m or math.dist(a, b) for (a, b), bend in zip(pairwise(places), bends, strict=True))


def _can_turn(water: OpenWater, here: Place, bends: Sequence[Bend], ahead_m: float) -> bool:
    """Whether there is water on a turn, and everywhere so far straight ahead of it; and no arc that the boat, which is late,
    would leave out before it turns to the other side."""
    if not bends or any(a.centre and b.centre and abs(a.turn_rad) < LATE_RAD for a, b in pairwise(bends)):
        return False
    places = places_of(here, bends)
    ahead = [(b, towards(b, a, -ahead_m)) for a, b in pairwise(places)] if ahead_m else []
    return water.covers([places, *ahead])


def heading(line: Segment) -> float:
    (x, y), (to_x, to_y) = line
    return math.atan2(to_x - x, to_y - y)


def _ahead(here: Place, heading_rad: float, letter: str, part: float, radius_m: float) -> tuple[Place, float, Place | None]:
    """Where a piece ends, with which heading, and its centre."""
    x, y = here
    if letter == "S":
        far_m = part * radius_m
        return (x + far_m * math.sin(heading_rad), y + far_m * math.cos(heading_rad)), heading_rad, None
    side = 1.0 if letter == "R" else -1.0
    centre = x + side * radius_m * math.cos(heading_rad), y - side * radius_m * math.sin(heading_rad)
    end_rad = heading_rad + side * part
    there = centre[0] - side * radius_m * math.cos(end_rad), centre[1] + side * radius_m * math.sin(end_rad)
    return there, end_rad, centre


def _mod(angle_rad: float) -> float:
    """0..2 pi; what is a hair below it is 0."""
    found = angle_rad % math.tau
    return 0.0 if found > math.tau - 1e-9 else found


def _words(d: float, a: float, b: float) -> Iterator[tuple[str, tuple[float, float, float]]]:
    """The six kinds of path for ends `d` radii apart, with headings from the line between them, and how far each piece goes."""
    sa, sb, ca, cb, cab = math.sin(a), math.sin(b), math.cos(a), math.cos(b), math.cos(a - b)
    if (p2 := 2.0 + d * d - 2.0 * cab + 2.0 * d * (sa - sb)) >= 0.0:
        to = math.atan2(cb - ca, d + sa - sb)
        yield "LSL", (_mod(to - a), math.sqrt(p2), _mod(b - to))
    if (p2 := 2.0 + d * d - 2.0 * cab + 2.0 * d * (sb - sa)) >= 0.0:
        to = math.atan2(ca - cb, d - sa + sb)
        yield "RSR", (_mod(a - to), math.sqrt(p2), _mod(to - b))
    if (p2 := -2.0 + d * d + 2.0 * cab + 2.0 * d * (sa + sb)) >= 0.0:
        to = math.atan2(-ca - cb, d + sa + sb) - math.atan2(-2.0, math.sqrt(p2))
        yield "LSR", (_mod(to - a), math.sqrt(p2), _mod(to - b))
    if (p2 := -2.0 + d * d + 2.0 * cab - 2.0 * d * (sa + sb)) >= 0.0:
        to = math.atan2(ca + cb, d - sa - sb) - math.atan2(2.0, math.sqrt(p2))
        yield "RSL", (_mod(a - to), math.sqrt(p2), _mod(b - to))
    if abs(c := (6.0 - d * d + 2.0 * cab + 2.0 * d * (sa - sb)) / 8.0) <= 1.0:
        p = math.tau - math.acos(c)
        t = _mod(a - math.atan2(ca - cb, d - sa + sb) + p / 2.0)
        yield "RLR", (t, p, _mod(a - b - t + p))
    if abs(c := (6.0 - d * d + 2.0 * cab + 2.0 * d * (sb - sa)) / 8.0) <= 1.0:
        p = math.tau - math.acos(c)
        t = _mod(-a + math.atan2(cb - ca, d + sa - sb) + p / 2.0)
        yield "LRL", (t, p, _mod(b - a - t + p))


def along(begin: Place, bend: Bend, steps: int) -> list[Place]:
    """So many places along a bend, its end the last one."""
    if bend.centre is None:
        return [bend.to]
    from_rad = math.atan2(begin[0] - bend.centre[0], begin[1] - bend.centre[1])
    turns = (from_rad + bend.turn_rad * step / steps for step in range(1, steps))
    (x, y), radius_m = bend.centre, bend.radius_m
    return [*((x + radius_m * math.sin(at_rad), y + radius_m * math.cos(at_rad)) for at_rad in turns), bend.to]


def places_of(begin: Place, bends: Iterable[Bend]) -> list[Place]:
    """Places along bends, close enough to draw and to look at."""
    places = [begin]
    for bend in bends:
        places += along(places[-1], bend, max(2, math.ceil(abs(bend.turn_rad) / DRAWN_RAD)))
    return places


def towards(here: Place, there: Place, far_m: float) -> Place:
    """The place so far on the straight way from here to there."""
    part = far_m / math.dist(here, there)
    return here[0] + part * (there[0] - here[0]), here[1] + part * (there[1] - here[1])
