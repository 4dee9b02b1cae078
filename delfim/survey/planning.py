"""A survey planned: the lines of an area in order, with run-ins and turns that the boat can make, and the mission of it."""

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Any, Final, NamedTuple

import msgspec
from shapely.geometry.base import BaseGeometry

from delfim import config
from delfim.base.cooperative import Sliced
from delfim.base.errors import DelfimError
from delfim.base.geodesy import wrap
from delfim.survey.ground import Ground, Place, Segment, in_degrees, polygons, simplified, swaths, water
from delfim.survey.lines import Cut, Strip, headings, rings, rough_s, strips
from delfim.survey.order import ordered
from delfim.survey.turns import Bend, along, heading, long_m, places_of, towards, turned
from delfim.survey.ways import OpenWater
from delfim.vehicle.control.hull import craft
from delfim.vehicle.helm.planning import laid
from delfim.vehicle.plans.fence import stopping_m
from delfim.vehicle.plans.mission import LEG_MIN_M, RADIUS_MIN_M, ROWS, Mission, PathPoint, PayloadItem, Waypoint

ARC_S: Final = 7.0  # of a turn of a boat that steers, beyond its length, as the skiff sailed it
CORNER_S: Final = -4.0  # of a turn on the spot, beyond its length: corners are cut ...
CORNER_S_PER_M: Final = 1.35  # ... and a long boat turns slowly; as boats sailed it
SLOW_S: Final = 4.0  # the same of a whole turn, where headings are compared
AROUND_M: Final = 100.0  # water about an area, for turns
RUN_IN_M: Final = 12.0
ACCEPTED_M: Final = 5.0  # a run-in is longer than the radius within which a waypoint is reached by so much
TURN_M: Final = 6.0  # lines keep so far from what missions keep off, for the turn at their ends
TRIED: Final = 3  # headings, whose lines are laid and put in order ...
LOOKED_AT: Final = 120  # ... until there were so many lines
LENGTHS: Final = 1.875  # of a boat that steers by a rudder or an outboard: its smallest turn
CROSS: Final = 3.0  # spacings: a cross line is no shorter
STEPS: Final = 16  # places of an arc, where its chords are no water
LONGER: Final = 2.0  # times a run-in, before a line that is shorter than one
SETTLED_M: Final = 10.0  # after a turn: then a boat is on its line, as boats sailed
SLOWLY: Final = 0.5  # of the speed, on the way to a line that begins at a hole ...
SLOW_MOST_M: Final = 30.0  # ... where this way is no longer
TURNED_M: Final = 8.0  # ... and so far on a longer way from it
STUB_M: Final = 4.0  # of the room for turns, that run-ins and ways may take
PASSED_M: Final = 3.0  # so far a boat passes the end of a line before it turns ...
STEERED_PASSED_M: Final = 5.0  # ... and one that steers ...
STEERED_FASTER: Final = 1.5  # ... with so much of its speed: the skiff's 1.5 m/s became 2.3
FASTER: Final = 1.15  # of its speed, a boat that turns on the spot makes with wind and current behind
CARRIED_MPS: Final = 0.55  # so fast 6 m/s of wind and 0.3 m/s of current carry a boat that turns on the spot, ...
CARRIED: Final = 1.5  # ... so many times as long as half a turn takes at her fastest: she begins from rest, and turns too far
STRAIGHT_RAD: Final = 0.01  # a corner that is less is none
LATE_M: Final = 2.0  # so much later than it should a boat is slow
BESIDE_M: Final = 2.0  # beyond what missions keep off, they keep off by so much
SIDES: Final = {"": 0, "port": -1, "starboard": 1}
CORNERS: Final = {"sw": (0, 1), "se": (2, 1), "nw": (0, 3), "ne": (2, 3)}  # of the area's box: where in its bounds they stand


class LinesWanted(NamedTuple):
    """What is asked of the lines."""

    spacing_m: float
    speed_mps: float
    swath_m: float = 0.0  # what a line covers; 0: the spacing
    heading_deg: float | None = None  # None: the quickest
    edges: bool = True  # the area is covered up to its edges; False: lines end where they leave it
    run_in_m: float = RUN_IN_M  # straight, before and behind each line
    room_m: float = config.FenceTable().mission_margin_m + TURN_M  # from holes and the fence
    brake_m: float = 0.0  # where a line ends at a hole, so much of it is sailed slowly; ahead of an arc so much water is free
    stub_m: float = 0.0  # of the room, that run-ins and ways may take, or arcs: where a line ends at a hole, it turns beyond
    radius_m: float = 0.0  # of the boat's smallest turn; 0: it turns on the spot
    turn_s: float = 0.0  # what a turn takes beyond its length
    cross_m: float = 0.0  # spacing of the cross lines; 0: none
    start: str = ""  # corner of the area to begin near
    side: str = ""  # that the sensor looks to, port or starboard; empty: both

    @property
    def cut(self) -> Cut:
        return Cut(
            self.spacing_m, self.swath_m or self.spacing_m, self.edges, 2.0 * self.run_in_m + ACCEPTED_M, SIDES[self.side]
        )


def wanted_of(settings: config.Vehicle, **asked: Any) -> LinesWanted:
    """What is asked for, and where it is None, what suits the boat. Raises DelfimError."""
    rows, control, its = settings.thrusters, settings.control, settings.adopted
    is_steered = all(row.steer is not None for row in rows) and len({row.y_m for row in rows}) == 1
    carried_m = 0 if is_steered else _carried_m(settings)
    guess_s = ARC_S if is_steered else CORNER_S + CORNER_S_PER_M * settings.boat.length_m
    suits = {
        "speed_mps": control.speed.cruise_mps,
        "run_in_m": max(its.run_in_m or RUN_IN_M, control.path.acceptance_m + ACCEPTED_M),
        "room_m": _room_m(settings.fence, asked.get("speed_mps") or control.speed.cruise_mps, is_steered) + carried_m,
        "turn_s": guess_s if its.turn_s is None else its.turn_s,
        "radius_m": max(LENGTHS * settings.boat.length_m, RADIUS_MIN_M) if is_steered else 0.0,
    }
    wanted = LinesWanted(**suits | {key: value for key, value in asked.items() if value is not None})
    least_m = control.path.acceptance_m + ACCEPTED_M
    if wanted.run_in_m < least_m:
        raise DelfimError(
            f"a run-in is {least_m:g} m or more: a waypoint counts as reached within {control.path.acceptance_m:g} m"
        )
    if 0.0 < wanted.radius_m < RADIUS_MIN_M:
        raise DelfimError(f"a radius of a turn is {RADIUS_MIN_M:g} m or more")
    if wanted.swath_m and wanted.swath_m < wanted.spacing_m:
        raise DelfimError("the swath is narrower than the spacing: water between lines stays uncovered")
    if wanted.speed_mps > control.speed.max_mps:
        raise DelfimError(f"faster than this boat goes: up to {control.speed.max_mps} m/s")
    fastest_mps = FASTER * wanted.speed_mps
    beside_m = settings.fence.mission_margin_m + BESIDE_M
    if wanted.radius_m:
        brake_m = stopping_m(settings.fence, fastest_mps) + settings.fence.margin_m - settings.fence.mission_margin_m
        return wanted._replace(stub_m=max(wanted.room_m - beside_m, 0.0), brake_m=max(brake_m, 0.0))
    nearest_m = max(beside_m, _stopped_m(settings.fence, wanted.speed_mps)) + carried_m
    stub_m = min(max(wanted.room_m - nearest_m, 0.0), STUB_M)
    brake_m = stopping_m(settings.fence, fastest_mps) - stopping_m(settings.fence, SLOWLY * fastest_mps) + LATE_M
    return wanted._replace(stub_m=stub_m, brake_m=brake_m)


def _room_m(limits: config.FenceTable, speed_mps: float, is_steered: bool) -> float:
    """From holes and the fence: what missions keep and the room for a turn, and what the boat needs to stop before them. One
    that steers passes the end of a line before it has turned, and the thrust that turns it makes it faster; another one comes
    slowly (`slow_ways`)."""
    stopped_m = _stopped_m(limits, STEERED_FASTER * speed_mps) + STEERED_PASSED_M
    slowly_m = _stopped_m(limits, FASTER * SLOWLY * speed_mps) + PASSED_M
    return max(limits.mission_margin_m + TURN_M, stopped_m if is_steered else slowly_m)


def _carried_m(settings: config.Vehicle) -> int:
    """How much more room a boat that turns on the spot needs than others, because wind and current carry it at a hole while it
    turns: a WAM-V, with 15 degrees a second, by 7 m."""
    limits, hull = settings.fence, craft(settings)
    turn_s = math.pi * hull.damping_nm_per_radps / hull.turn_nm if hull.turn_nm else 0.0
    least_m = limits.margin_m + stopping_m(limits, CARRIED_MPS) + CARRIED_MPS * CARRIED * turn_s + PASSED_M
    return max(0, math.ceil(least_m - limits.mission_margin_m - TURN_M))


def _stopped_m(limits: config.FenceTable, speed_mps: float) -> int:
    return math.ceil(limits.margin_m + stopping_m(limits, speed_mps))


class PlannedPiece(NamedTuple):
    """A piece of the way: of a line, whose number counts from 0, or between lines."""

    bend: Bend
    line: int | None


class SurveyPlan(NamedTuple):
    """Lines in the order and direction in which they are sailed, the last ones across, and the whole way from `begin`."""

    ground: Ground
    wanted: LinesWanted
    free: BaseGeometry  # of the area, what may be sailed
    ways: OpenWater  # there
    heading_deg: float
    lines: list[Segment]
    across: int
    begin: Place
    way: list[PlannedPiece]

    @property
    def line_m(self) -> float:
        return sum(math.dist(*line) for line in self.lines)

    @property
    def way_m(self) -> float:
        """Of everything."""
        return long_m(self.begin, [each.bend for each in self.way])

    @property
    def time_s(self) -> float:
        """By speed and turns, as the boat takes it within some per cent."""
        places = stops(self)
        slow_m = sum(math.dist(places[number - 1][0], places[number][0]) for number in slow_ways(self, places))
        way_m = self.way_m + slow_m * (1.0 / SLOWLY - 1.0)
        return way_m / self.wanted.speed_mps + (len(self.lines) - 1) * self.wanted.turn_s

    @property
    def rough(self) -> list[int]:
        """The lines, from 1, with less of a run-in than a boat needs to settle, for want of water: they begin at a hole."""
        least_m = min(SETTLED_M, self.wanted.run_in_m) - LEG_MIN_M
        lines = enumerate(self.lines, 1)
        return [line for line, its in lines if math.dist(_before(self.ways, its, self.wanted), its[0]) < least_m]

    def covered(self) -> tuple[float, float]:
        """The parts that the lines along cover: of what may be sailed, and of the whole area."""
        cut = self.wanted.cut
        done = swaths(self.lines[: len(self.lines) - self.across], cut.wide_m, cut.side)
        area = self.ground.area
        return done.intersection(self.free).area / self.free.area, done.intersection(area).area / area.area


def planned(ground: Ground, wanted: LinesWanted, fence: config.Zones, come: Place | None = None) -> SurveyPlan:
    """The survey of an area, from where the boat is, if that is known. Raises DelfimError in words where there is none."""
    around_m = AROUND_M + 2.0 * (wanted.run_in_m + wanted.radius_m) + wanted.spacing_m
    open_water = water(ground, fence, wanted.room_m, around_m)
    free = ground.area.intersection(open_water)
    if free.area < 1.0:
        raise DelfimError(f"nothing of the area is {wanted.room_m:g} m away from holes and the fence")
    start, turn_s = (
        _corner(free, wanted.start) or come,
        wanted.turn_s + (wanted.spacing_m + 2.0 * wanted.run_in_m) / wanted.speed_mps,
    )
    tried = list[tuple[float, list[Segment]]]()
    for each in _headings(free, wanted):
        if sum(len(known) for _, known in tried) < LOOKED_AT:
            tried.append((each, _lines(free, open_water, each, wanted, start)))
    heading_deg, lines = min(tried, key=lambda each: _straight_s(each[1], wanted.speed_mps, turn_s))
    across = list[Segment]()
    if wanted.cross_m:
        cut = wanted.cut._replace(spacing_m=wanted.cross_m, wide_m=wanted.cross_m, edges=False, side=0)
        found = [each for each in strips(free, open_water, heading_deg + 90.0, cut) if _is_long(each.line, wanted)]
        across = ordered(found, max(1, math.ceil(2.0 * wanted.radius_m / wanted.cross_m)), lines[-1][1] if lines else None)
    if not lines:
        raise DelfimError("the area is smaller than a line")
    ways = _ways(open_water, water(ground, fence, wanted.room_m - wanted.stub_m, around_m), wanted)
    lines, across = _settled(lines, ways, wanted), _settled(across, ways, wanted)
    begin, way = _sailed([*lines, *across], ways, wanted, come)
    if len(way) + 1 > ROWS:
        raise DelfimError(f"{len(lines)} lines make {len(way) + 1} places, and a mission has {ROWS}: take the area in parts")
    return SurveyPlan(ground, wanted, free, ways, heading_deg, [*lines, *across], len(across), begin, way)


def _ways(open_water: BaseGeometry, nearer: BaseGeometry, wanted: LinesWanted) -> OpenWater:
    return OpenWater(open_water, nearer) if wanted.radius_m else OpenWater(nearer)


def plan_of(
    ground: Ground,
    wanted: LinesWanted,
    fence: config.Zones,
    heading_deg: float,
    main: Sequence[Segment],
    across: Sequence[Segment],
    start: Place | None,
) -> SurveyPlan:
    """The survey of lines that are known, in a new order, from where the boat is. Raises DelfimError in words where there is
    none."""
    around_m = AROUND_M + 2.0 * (wanted.run_in_m + wanted.radius_m) + wanted.spacing_m
    open_water = water(ground, fence, wanted.room_m, around_m)
    near = start or _corner(ground.area, wanted.start)
    lines = _again(main, heading_deg, wanted.spacing_m, wanted.radius_m, near, wanted.cut)
    there, cross_m = lines[-1][1] if lines else near, wanted.cross_m or wanted.spacing_m
    crossed = _again(across, heading_deg + 90.0, cross_m, wanted.radius_m, there)
    if not lines and not crossed:
        raise DelfimError("no line is left")
    ways = _ways(open_water, water(ground, fence, wanted.room_m - wanted.stub_m, around_m), wanted)
    lines, crossed = _settled(lines, ways, wanted), _settled(crossed, ways, wanted)
    begin, way = _sailed([*lines, *crossed], ways, wanted, start)
    free = ground.area.intersection(open_water)
    return SurveyPlan(ground, wanted, free, ways, heading_deg, [*lines, *crossed], len(crossed), begin, way)


def _again(
    lines: Sequence[Segment],
    heading_deg: float,
    spacing_m: float,
    radius_m: float,
    start: Place | None,
    cut: Cut | None = None,
) -> list[Segment]:
    """Lines in an order: all are turned one way first, as strips are. Those of a sensor that looks to one side, as `cut` has
    it, keep their way."""
    s, c = math.sin(math.radians(heading_deg)), math.cos(math.radians(heading_deg))
    senses = [1 if (b[0] - a[0]) * s + (b[1] - a[1]) * c > 0.0 else -1 for a, b in lines]
    half_m = cut.side * cut.wide_m / 2.0 if cut is not None else 0.0
    middles = ((a[0] + b[0]) / 2.0 * c - (a[1] + b[1]) / 2.0 * s for a, b in lines)
    across = [middle + sense * half_m for middle, sense in zip(middles, senses, strict=True)]
    found = list[Strip]()
    for line, sense, middle in zip(lines, senses, across, strict=True):
        number = round((middle - min(across)) / spacing_m)
        found.append(Strip(number, True, line, sense) if half_m else Strip(number, True, line if sense > 0 else line[::-1]))
    found.sort(key=lambda strip: strip[::2])
    return ordered(found, max(1, math.ceil(2.0 * radius_m / spacing_m - 1e-9)), start)


def _headings(free: BaseGeometry, wanted: LinesWanted) -> list[float]:
    """The heading that is asked for, or the few that are the quickest by a rough look."""
    if wanted.heading_deg is not None:
        return [wanted.heading_deg]
    turn_s = (2.0 * wanted.run_in_m + wanted.spacing_m + math.pi * wanted.radius_m) / wanted.speed_mps + SLOW_S
    sides, tried = rings(free), headings(free, wanted.spacing_m)
    rough = {heading_deg: rough_s(sides, heading_deg, wanted.cut, wanted.speed_mps, turn_s) for heading_deg in tried}
    return sorted(tried, key=lambda heading_deg: rough[heading_deg])[:TRIED]


def _lines(
    free: BaseGeometry, open_water: BaseGeometry, heading_deg: float, wanted: LinesWanted, start: Place | None
) -> list[Segment]:
    apart = max(1, math.ceil(2.0 * wanted.radius_m / wanted.spacing_m - 1e-9))
    return ordered(strips(free, open_water, heading_deg, wanted.cut), apart, start)


def _straight_s(lines: list[Segment], speed_mps: float, turn_s: float) -> float:
    """The time of lines with straight ways between."""
    way_m = sum(math.dist(*line) for line in lines) + sum(math.dist(a[1], b[0]) for a, b in pairwise(lines))
    return way_m / speed_mps + len(lines) * turn_s if lines else math.inf


def _corner(free: BaseGeometry, name: str) -> Place | None:
    if not name:
        return None
    x, y = CORNERS[name]
    return free.bounds[x], free.bounds[y]


def _is_long(line: Segment, wanted: LinesWanted) -> bool:
    return math.dist(*line) >= CROSS * wanted.spacing_m


def _settled(lines: list[Segment], ways: OpenWater, wanted: LinesWanted) -> list[Segment]:
    """Lines that are shorter than a run-in begin where there is room for one: turned back they cost less than their length
    twice. Those of a sensor that looks to one side keep their way."""
    if wanted.side:
        return lines
    found = list[Segment]()
    for begin, end in lines:
        before, behind = (ways.beyond(a, b, wanted.run_in_m) for a, b in ((end, begin), (begin, end)))
        is_turned = math.dist(begin, end) < wanted.run_in_m and math.dist(before, begin) < math.dist(behind, end)
        found.append((end, begin) if is_turned else (begin, end))
    return found


def _sailed(lines: list[Segment], ways: OpenWater, wanted: LinesWanted, come: Place | None) -> tuple[Place, list[PlannedPiece]]:
    """Where the boat begins, and its way: run-in, line, run-out, turn. Where holes lie between the boat and the first line, it
    begins with the way round them."""
    here = _before(ways, lines[0], wanted)
    begin, *places = [*ways.out_to(come, here, wanted.room_m), here]
    way = [PlannedPiece(Bend(place), None) for place in places]
    for number, line in enumerate(lines):
        ahead = _before(ways, line, wanted)
        if number:
            bends = turned(ways, here, heading(lines[number - 1]), ahead, heading(line), wanted.radius_m, wanted.brake_m)
            way += [PlannedPiece(each, None) for each in bends]
        if math.dist(way[-1].bend.to if way else begin, line[0]) >= LEG_MIN_M:
            way.append(PlannedPiece(Bend(line[0]), None))
        way.append(PlannedPiece(Bend(line[1]), number))
        here = ways.beyond(line[0], line[1], wanted.run_in_m)
        if math.dist(line[1], here) >= LEG_MIN_M:
            way.append(PlannedPiece(Bend(here), None))
    return begin, way


def _before(ways: OpenWater, line: Segment, wanted: LinesWanted) -> Place:
    """Where the run-in of a line begins. On a short line the boat has no time to come nearer: it gets a longer one."""
    longer = LONGER if math.dist(*line) < wanted.run_in_m else 1.0
    return ways.beyond(line[1], line[0], longer * wanted.run_in_m)


def drawn(plan: SurveyPlan) -> list[Place]:
    """The whole way as places, arcs as corners."""
    return places_of(plan.begin, (each.bend for each in plan.way))


def stops(plan: SurveyPlan) -> list[tuple[Place, int]]:
    """The whole way as few places: the straight ways between them are water, too. Beside each is the line, from 1, that the
    way to it sails; 0: none."""
    kept = [(plan.begin, 0)]
    for bend, line in plan.way:
        begin, found, steps = kept[-1][0], [bend.to], 1
        while steps < STEPS and not all(plan.ways.turning.free(a, b) for a, b in pairwise([begin, *found])):
            steps *= 2
            found = along(begin, bend, steps)
        for place in found:
            if math.dist(kept[-1][0], place) >= LEG_MIN_M:
                kept.append((place, _number(line)))
    inwards, brakes_m = _inwards(plan, kept), dict[int, float]()
    for number in inwards:
        last, brake_m = _braking(plan, kept, number)
        brakes_m[last] = max(brake_m, brakes_m.get(last, 0.0))
    for number in sorted(inwards | brakes_m.keys(), reverse=True):  # from behind: places are put in
        is_way = number in inwards and number + 1 < len(kept) and not kept[number + 1][1]
        if is_way and math.dist(kept[number][0], kept[number + 1][0]) > SLOW_MOST_M:
            kept.insert(number + 1, (towards(kept[number][0], kept[number + 1][0], TURNED_M), 0))
        line, brake_m = kept[number][1], brakes_m.get(number, math.inf)
        if line and math.dist(kept[number - 1][0], kept[number][0]) > brake_m + LEG_MIN_M:
            kept.insert(number, (towards(kept[number][0], kept[number - 1][0], brake_m), line))
    return kept


def _inwards(plan: SurveyPlan, places: Sequence[tuple[Place, int]]) -> set[int]:
    """The stops where a boat that turns on the spot comes as near to a hole or the fence as lines do, or nearer."""
    if plan.wanted.radius_m:
        return set()
    near_m = plan.wanted.stub_m + LEG_MIN_M
    shores_m = [min(shore_m, near_m) for shore_m in plan.ways.shores_m([place for place, _ in places])]
    return {number for number, (before, here) in enumerate(pairwise(shores_m), 1) if here < before}


def _braking(plan: SurveyPlan, places: Sequence[tuple[Place, int]], number: int) -> tuple[int, float]:
    """At the end of which piece a boat has to be slow that comes to a stop near a hole, and how far before: where the run-out
    is too short for it, at the end of the line."""
    (before, line), (here, its) = places[number - 1], places[number]
    left_m = plan.wanted.brake_m - math.dist(before, here)
    if its or not line or left_m <= 0.0 or _corner_rad(places[number - 2][0], before, here) > STRAIGHT_RAD:
        return number, plan.wanted.brake_m
    return number - 1, left_m


def slow_ways(plan: SurveyPlan, places: Sequence[tuple[Place, int]]) -> set[int]:
    """To which of the stops a boat goes slowly: that which turns on the spot turns closer so, and where a line begins at a hole
    it has little room to come nearer. So it has where one ends there: wind and current behind make the boat faster than asked,
    it goes straight on while it turns, and its fence would stop it."""
    if plan.wanted.radius_m:
        return set()
    rough = set(plan.rough)
    begins = [number for number, (_, line) in enumerate(places) if line in rough and places[number - 1][1] != line]
    before = {each for begin in begins for each in range(max(begin - 2, 1), begin)}
    inwards = _inwards(plan, places)
    lengths_m = [0.0, *(math.dist(a, b) for (a, _), (b, _) in pairwise(places))]
    beside = before | inwards | {each + 1 for each in inwards if each + 1 < len(places)}
    between = {each for each in beside if not places[each][1] and lengths_m[each] <= SLOW_MOST_M}
    brakes = (_braking(plan, places, each) for each in inwards)
    ends = {last for last, brake_m in brakes if places[last][1] and lengths_m[last] <= brake_m + LEG_MIN_M}
    return between | ends


def _corner_rad(before: Place, here: Place, after: Place) -> float:
    return abs(wrap(heading((here, after)) - heading((before, here))))


def _number(line: int | None) -> int:
    return 0 if line is None else line + 1


class LineActions(NamedTuple):
    """What is announced to payloads at the beginning and at the end of each line: commands of MAVLink with their numbers."""

    begin: tuple[PayloadItem, ...] = ()
    end: tuple[PayloadItem, ...] = ()

    def at(self, lines: list[int], key: str) -> Iterator[PayloadItem]:
        """The actions of legs or pieces with these lines; `key` is that of their places."""
        for number, (before, line, after) in enumerate(zip((0, *lines), lines, (*lines[1:], 0), strict=False)):
            begins, ends = self.begin if line != before else (), self.end if line != after else ()
            for place, actions in ((number, begins), (number + 1, ends)):
                yield from (msgspec.structs.replace(each, **{key: place}) for each in actions if line)


SILENT: Final = LineActions()


def mission(plan: SurveyPlan, name: str, actions: LineActions = SILENT) -> Mission:
    """The mission of a plan: its holes are zones of its fence. Where the boat turns on the spot the waypoints are the path.
    Each leg or piece has the number of its line."""
    at, speed_mps = plan.ground.at, plan.wanted.speed_mps

    def place(point: Place) -> tuple[float, float]:
        latitude_deg, longitude_deg = in_degrees(at, *point)
        return round(latitude_deg, 8), round(longitude_deg, 8)

    places = stops(plan)
    if len(places) > ROWS:
        raise DelfimError(f"{len(places)} places, and a mission has {ROWS}: take the area in parts")
    slow = slow_ways(plan, places)
    waypoints = [
        Waypoint(latitude_deg=n, longitude_deg=e, speed_mps=SLOWLY * speed_mps if number in slow else speed_mps, line=line)
        for number, ((n, e), line) in enumerate((place(point), line) for point, line in places)
    ]
    items, path = list(actions.at([line for _, line in places], "after")), list[PathPoint]()
    if plan.wanted.radius_m:
        n, e = place(plan.begin)
        path.append(PathPoint(latitude_deg=n, longitude_deg=e))
        for bend, line in plan.way:
            n, e = place(bend.centre or bend.to)
            more = {"turn_deg": round(math.degrees(bend.turn_rad), 4), "radius_m": bend.radius_m, "line": _number(line)}
            path.append(msgspec.convert({"latitude_deg": n, "longitude_deg": e, "speed_mps": speed_mps} | more, PathPoint))
        items += actions.at([row.line for row in path[1:]], "after_piece")
    fence, stations, pieces = config.Zones(keep_out=_zones(plan, place)), tuple(waypoints), tuple(path)
    return Mission(version=1, name=name, waypoint=stations, path=pieces, action=tuple(items), fence=fence)


def check(its: Mission, plan: SurveyPlan, settings: config.Vehicle) -> None:
    """Look at the mission as the boat will. Raises ConfigError, Refused where the boat would not take it."""
    Sliced(laid(its, plan.ground.at, settings.control, settings.fence)).finish()


def _zones(plan: SurveyPlan, place: Callable[[Place], tuple[float, float]]) -> tuple[config.Area, ...]:
    near = plan.ground.area.envelope.buffer(AROUND_M + plan.wanted.room_m)
    holes = [hole for hole in polygons(plan.ground.holes) if hole.intersects(near)]
    if len(holes) > config.ZONES:
        raise DelfimError(f"{len(holes)} holes, and a fence has {config.ZONES} zones: join holes that lie close together")
    outlines = (list(simplified(hole, config.CORNERS).exterior.coords)[:-1] for hole in holes)
    return tuple(
        config.Area(name=f"hole {number}", polygon=tuple(map(place, outline))) for number, outline in enumerate(outlines, 1)
    )
