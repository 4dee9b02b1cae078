"""Lines cover drawn areas, none of them in a hole; the figures of many areas are printed by the long test."""

import json
import math
import statistics
import time
from itertools import pairwise
from pathlib import Path

import pytest
import shapely
from shapely import affinity
from shapely.geometry import LineString, MultiPolygon, Point, Polygon, box

from delfim import config
from delfim.base.errors import DelfimError
from delfim.survey.areafile import read_area
from delfim.survey.ground import Ground, laid, simplified, swaths, union, water
from delfim.survey.lines import Cut, strips
from delfim.survey.order import alternating, ordered
from delfim.survey.planning import LinesWanted, SurveyPlan, check, mission, plan_of, planned, slow_ways, stops, wanted_of
from delfim.survey.trialsail import legs
from delfim.survey.turns import places_of, turn
from delfim.survey.ways import OpenWater
from delfim.vehicle.plans.fence import stopping_m
from tests.survey.drawn import AT, drawn

NEARLY_TOUCHING = Path(__file__).parents[1] / "data/nearly-touching.json"
SQUARE = Ground(AT, MultiPolygon([box(0, 0, 100, 100)]), MultiPolygon())
ISLAND = box(40, 40, 60, 60)
ROUND_AN_ISLAND = Ground(AT, MultiPolygon([box(0, 0, 100, 100).difference(ISLAND)]), MultiPolygon([ISLAND]))
BOAT = LinesWanted(10.0, 1.5)


def survey(ground: Ground, **asked: object) -> SurveyPlan:
    return planned(ground, BOAT._replace(**asked), config.Zones())  # type: ignore[arg-type]


def in_holes(plan: SurveyPlan) -> int:
    """Lines and ways that touch a hole."""
    holes = plan.ground.holes.buffer(-0.02)
    places = [plan.begin, *(each.bend.to for each in plan.way)]
    return sum(LineString(pair).intersects(holes) for pair in pairwise(places)) if not holes.is_empty else 0


@pytest.mark.parametrize("seed", range(24))
def test_a_drawn_area_is_covered_and_nothing_crosses_a_hole(seed: int) -> None:
    ground, spacing_m = drawn(seed)
    plan = survey(ground, spacing_m=spacing_m, room_m=0.0, run_in_m=10.0)
    assert plan.covered()[0] > 0.995
    assert in_holes(plan) == 0
    done = sorted(each.line for each in plan.way if each.line is not None)
    assert done == list(range(len(plan.lines))), "each line once"


@pytest.mark.parametrize("side", ["port", "starboard"])
@pytest.mark.parametrize("seed", range(12))
def test_a_sensor_that_looks_to_one_side_covers_an_area_from_lines_that_are_sailed_the_right_way(seed: int, side: str) -> None:
    ground, spacing_m = drawn(seed)
    asked = {"spacing_m": spacing_m, "swath_m": 1.25 * spacing_m, "side": side, "radius_m": 6.0 * (seed % 2)}
    plan = survey(ground, **asked)
    assert plan.covered()[0] > 0.995
    assert in_holes(plan) == 0
    ends = [(each.bend.to, plan.lines[each.line][1]) for each in plan.way if each.line is not None]
    assert all(math.dist(*both) < 0.01 for both in ends), "each is sailed as it is written"
    assert plan.way_m < 1.5 * survey(ground, **asked | {"side": "", "swath_m": 0.0}).way_m
    again = plan_of(ground, plan.wanted, config.Zones(), plan.heading_deg, plan.lines, [], None)
    assert sorted(again.lines) == sorted(plan.lines)
    assert again.way_m < 1.3 * plan.way_m


def test_a_square_of_one_sided_lines_is_covered_from_its_edges_inwards() -> None:
    plan = survey(SQUARE, spacing_m=25.0, heading_deg=0.0, side="starboard")
    lines = sorted((round(line[0][0], 6), line[1][1] > line[0][1]) for line in plan.lines)
    assert lines == [(0.0, True), (50.0, False), (50.0, True), (100.0, False)], "east, and whether it is sailed to the north"
    assert plan.covered()[0] > 0.9999
    port = survey(SQUARE, spacing_m=25.0, heading_deg=0.0, side="port")
    assert sorted(line[::-1] for line in port.lines) == sorted(plan.lines)


@pytest.mark.long
def test_two_hundred_drawn_areas(capsys) -> None:
    covered, ratios, took_ms, lines = list[float](), list[float](), list[float](), 0
    for seed in range(5000, 5200):
        ground, spacing_m = drawn(seed)
        begun_s = time.thread_time()
        plan = survey(ground, spacing_m=spacing_m, room_m=0.0, run_in_m=0.01)
        took_ms.append(1000.0 * (time.thread_time() - begun_s))
        assert not any(LineString(line).intersects(ground.holes.buffer(-0.02)) for line in plan.lines)
        covered.append(plan.covered()[0])
        ratios.append(plan.way_m * spacing_m / plan.free.area)
        lines += len(plan.lines)
    whole = sum(part >= 0.995 for part in covered)
    with capsys.disabled():
        print(f"\n{len(covered)} areas, {lines} lines: {whole} covered, least {100.0 * min(covered):.2f} %;")
        print(f"way / bound {statistics.median(ratios):.2f}; {statistics.median(took_ms):.0f} ms, {max(took_ms):.0f} at most")
    assert whole >= 195
    assert statistics.median(ratios) <= 1.30


@pytest.mark.parametrize("start", ["", "nw", "ne", "se", "sw"])
@pytest.mark.parametrize("come", [(50.0, -8.0), (-10.0, 50.0), (50.0, 75.0), (110.0, 110.0)])
def test_a_boat_comes_to_its_first_line_round_holes(come: tuple[float, float], start: str) -> None:
    plan = planned(ROUND_AN_ISLAND, BOAT._replace(start=start), config.Zones(), come)
    assert plan.ways.free(come, plan.begin)
    assert in_holes(plan) == 0
    assert start or math.dist(come, plan.begin) < 80.0, "the survey begins near the boat"
    elsewhere = planned(ROUND_AN_ISLAND, BOAT._replace(start=start), config.Zones(), (5000.0, 50.0))
    assert plan.lines == elsewhere.lines or not start, "a boat that is far away has no way to be planned"


def test_a_boat_that_lies_near_a_hole_goes_away_from_it_and_then_round() -> None:
    come = 38.0, 50.0
    plan = planned(ROUND_AN_ISLAND, BOAT._replace(start="ne", room_m=8.0), config.Zones(), come)
    assert not LineString([come, plan.begin]).intersects(ROUND_AN_ISLAND.holes)
    assert plan.begin == pytest.approx((32.0, 50.0), abs=0.1)
    assert in_holes(plan) == 0


def test_lines_are_apart_as_asked_and_as_long_as_their_strips() -> None:
    plan = survey(SQUARE, heading_deg=0.0)
    assert sorted(round(line[0][0], 6) for line in plan.lines) == [5.0 + 10.0 * number for number in range(10)]
    assert {round(math.dist(*line), 6) for line in plan.lines} == {100.0}
    assert plan.way_m == pytest.approx(10 * 124.0 + 9 * 10.0)
    assert plan.covered() == (pytest.approx(1.0), pytest.approx(1.0))
    wide = survey(SQUARE, heading_deg=0.0, swath_m=14.0)
    assert len(wide.lines) == 10, "the outer lines need not reach the edge"
    assert wide.covered()[0] == pytest.approx(1.0)
    assert len(survey(SQUARE, heading_deg=30.0).lines) > 12
    assert survey(SQUARE).heading_deg % 90.0 == 0.0, "along a side is quickest"


def test_lines_that_begin_or_end_at_a_hole_have_a_piece_of_run_in_and_short_ones_begin_where_there_is_room_for_all_of_it() -> (
    None
):
    ground = laid(read_area(Path(__file__).parents[2] / "etc/areas/basin.geojson"))
    wanted = wanted_of(config.load("etc/delfimx.toml"), spacing_m=10.0)
    plan = planned(ground, wanted, config.Zones())
    places, short = [plan.begin, *(each.bend.to for each in plan.way)], 0
    for number, each in enumerate(plan.way):
        if each.line is None:
            continue
        begin, end = plan.lines[each.line]
        assert math.dist(begin, places[number]) < 0.01
        run_in_m, run_out_m = math.dist(places[number - 1], begin), math.dist(end, places[number + 2])
        assert min(run_in_m, run_out_m) >= 3.0 - 0.01
        if math.dist(begin, end) < wanted.run_in_m:
            short += 1
            assert run_in_m >= wanted.run_in_m - 0.01
    assert short >= 4
    rocks = shapely.unary_union([Polygon(each.exterior) for each in ground.holes.geoms])
    assert rocks.distance(LineString(places)) >= 8.0 - 0.05  # missions keep off 6 m


@pytest.mark.parametrize("turned_deg", [33.333, 12.345, 77.77])
def test_a_long_thin_area_gets_no_line_for_a_rounded_heading(turned_deg: float) -> None:
    """A twentieth of a degree is a third of a metre at its end: it had a fourth line."""
    thin = affinity.rotate(box(0, 0, 400, 15.01), turned_deg, origin=(0, 0))
    plan = survey(Ground(AT, MultiPolygon([thin]), MultiPolygon()), spacing_m=5.0)
    assert len(plan.lines) == 3
    assert plan.covered()[0] > 0.995


def test_inside_lines_end_where_they_leave_the_area() -> None:
    ground = Ground(AT, MultiPolygon([Polygon([(0, 0), (100, 0), (0, 100)])]), MultiPolygon())
    whole, inside = survey(ground, heading_deg=0.0), survey(ground, heading_deg=0.0, edges=False)
    assert whole.covered()[0] > 0.9999
    assert 0.9 < inside.covered()[0] < 0.99
    assert all(ground.area.buffer(0.01).covers(LineString(line)) for line in inside.lines)


def test_a_start_corner_and_cross_lines() -> None:
    for corner, place in (("sw", (0, 0)), ("se", (100, 0)), ("nw", (0, 100)), ("ne", (100, 100))):
        plan = survey(SQUARE, heading_deg=0.0, start=corner, cross_m=40.0)
        assert math.dist(plan.lines[0][0], place) < 6.0
        assert (len(plan.lines), plan.across) == (13, 3)
        assert all(abs(line[0][1] - line[1][1]) < 1e-6 for line in plan.lines[-3:])
        assert plan.covered()[0] == pytest.approx(1.0), "cross lines count for nothing"


def test_a_short_line_has_a_longer_run_in_and_lines_that_begin_at_a_hole_are_counted() -> None:
    for long_m, run_in_m in ((11.0, 24.0), (13.0, 12.0)):
        plan = survey(Ground(AT, MultiPolygon([box(0, 0, 8, long_m)]), MultiPolygon()), heading_deg=0.0)
        assert math.dist(plan.begin, plan.lines[0][0]) == pytest.approx(run_in_m)
        assert plan.rough == []
    around = survey(ROUND_AN_ISLAND, heading_deg=0.0)
    at_hole = [line for line in around.lines if Point(line[0]).distance(ISLAND) < around.wanted.room_m + 0.1]
    assert len(around.rough) == len(at_hole) > 0
    ways = mission(around, "around").waypoint
    slow = {number for number, row in enumerate(ways) if row.speed_mps == 0.75}
    assert slow
    assert all({row.line for row in ways[number + 1 : number + 3]} & {*around.rough} for number in slow)
    assert not any(ways[number].line for number in slow)
    arcs = survey(ROUND_AN_ISLAND, heading_deg=0.0, radius_m=6.0)
    assert all(row.speed_mps == 1.5 for row in mission(arcs, "arcs").path[1:])


def test_room_is_kept_from_holes_and_fences_and_the_mission_has_the_holes_as_zones() -> None:
    plan = survey(ROUND_AN_ISLAND, room_m=8.0)
    near = ISLAND.buffer(7.9)
    places = [plan.begin, *(each.bend.to for each in plan.way)]
    assert not any(near.intersects(LineString(pair)) for pair in pairwise(places))
    free, area = plan.covered()
    assert free > 0.999
    assert area < free
    (zone,) = mission(plan, "island").fence.keep_out
    assert len(zone.polygon) == 4
    fenced = planned(SQUARE, BOAT, config.Zones(keep_out=(zone,)))
    assert not any(near.intersects(LineString(line)) for line in fenced.lines)
    basin = config.Area(centre=((math.degrees(AT.latitude_rad), math.degrees(AT.longitude_rad)),), radius_m=120.0)
    within = planned(SQUARE, BOAT, config.Zones(keep_in=(basin,)))
    assert max(math.hypot(*place) for line in within.lines for place in line) <= 120.0 - BOAT.room_m + 0.1


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"spacing_m": 0.1}, "more than 500 are no survey"),
        ({"room_m": 60.0}, "nothing of the area is 60 m away"),
        ({"spacing_m": 0.3, "heading_deg": 45.0}, "take the area in parts"),
    ],
)
def test_what_is_no_survey_is_refused_in_words(asked, words) -> None:
    ground = ROUND_AN_ISLAND
    with pytest.raises(DelfimError, match=words):
        survey(ground, **asked)


def test_waters_that_do_not_meet_are_not_sailed_as_one() -> None:
    bar = box(-500, 45, 500, 55)
    ground = Ground(AT, MultiPolygon([box(0, 0, 100, 40), box(0, 60, 100, 100)]), MultiPolygon([bar]))
    with pytest.raises(DelfimError, match="there is no way from one line to the next"):
        survey(ground, room_m=2.0)


def test_a_way_leads_round_what_is_between() -> None:
    open_water = water(ROUND_AN_ISLAND, config.Zones(), 5.0, 50.0)
    ways = OpenWater(open_water)
    assert ways.between((0.0, 0.0), (100.0, 0.0)) == []
    places = [(0.0, 50.0), *ways.between((0.0, 50.0), (100.0, 50.0)), (100.0, 50.0)]
    assert len(places) == 4
    assert all(open_water.buffer(0.1).covers(LineString(pair)) for pair in pairwise(places))
    assert 104.0 < sum(math.dist(a, b) for a, b in pairwise(places)) < 108.0


def test_a_union_loses_nothing_which_a_plain_one_does() -> None:
    parts = [Polygon(corners) for corners in json.loads(NEARLY_TOUCHING.read_text())]
    plain, ours = shapely.union_all(parts).buffer(0.01), union(parts)
    assert [n for n, part in enumerate(parts) if part.difference(plain).area > 1.0], "what the grid is for"
    assert not [n for n, part in enumerate(parts) if part.difference(ours.buffer(0.01)).area > 0.1]
    assert union([]).is_empty


def test_a_hole_of_many_corners_is_a_zone_of_a_hundred_that_holds_it() -> None:
    hole = Polygon(
        [((30 + n % 3) * math.cos(math.tau * n / 400), (30 + n % 3) * math.sin(math.tau * n / 400)) for n in range(400)]
    )
    zone = simplified(hole, 100)
    assert len(zone.exterior.coords) <= 101
    assert zone.covers(hole)
    assert zone.area < 1.3 * hole.area


@pytest.mark.parametrize(("count", "apart"), [(1, 2), (6, 1), (11, 2), (20, 3), (2, 5)])
def test_lines_are_taken_so_many_away_where_there_are_such(count: int, apart: int) -> None:
    order = alternating(count, apart)
    assert sorted(order) == list(range(count))
    near = sum(abs(b - a) < apart for a, b in pairwise(order))
    assert near <= 3 if count > 2 * apart else True
    if apart == 1:
        assert order == list(range(count))


def test_a_boat_that_does_not_turn_on_the_spot_gets_arcs_of_its_radius() -> None:
    skiff = config.load("etc/boats/skiff.toml")
    wanted = wanted_of(skiff, spacing_m=10.0)
    assert (wanted.radius_m, wanted_of(config.load("etc/boats/otter.toml"), spacing_m=10.0).radius_m) == (7.5, 0.0)
    assert wanted_of(config.load("etc/boats/bait-boat.toml"), spacing_m=10.0).radius_m == 2.0, "no mission has less"
    plan = planned(SQUARE, wanted, skiff.fence)
    its = mission(plan, "arcs")
    assert {row.radius_m for row in its.path if row.turn_deg} == {7.5}
    assert plan.way_m < planned(SQUARE, wanted._replace(spacing_m=10.0, radius_m=10.0), skiff.fence).way_m + 1e-6
    by_neighbours = sum(turned_m(10.0 * number) for number in (1, 1, 1, 1, 1, 1, 1, 1, 1))
    assert plan.way_m - plan.line_m - 20 * wanted.run_in_m < 0.75 * by_neighbours


def test_the_waypoints_of_arcs_lead_round_holes_as_the_arcs_do() -> None:
    skiff = config.load("etc/boats/skiff.toml")
    plan = planned(ROUND_AN_ISLAND, wanted_of(skiff, spacing_m=10.0), skiff.fence)
    its = mission(plan, "arcs")
    assert len(its.waypoint) > len({place.to for place, _ in plan.way}) / 2
    ways = [LineString(pair) for pair in pairwise(place for place, _ in stops(plan))]
    nearest_m = plan.wanted.room_m - plan.wanted.stub_m
    assert nearest_m == skiff.fence.mission_margin_m + 2.0
    assert not any(ISLAND.buffer(nearest_m - 0.1).intersects(way) for way in ways)
    check(its, plan, skiff)


def test_a_boat_that_steers_turns_by_arcs_where_lines_end_at_a_hole_and_could_stop_anywhere_on_them() -> None:
    skiff = config.load("etc/boats/skiff.toml")
    plan = planned(ROUND_AN_ISLAND, wanted_of(skiff, spacing_m=20.0, heading_deg=0.0), skiff.fence)
    here, arcs = plan.begin, 0
    stopped_m = stopping_m(skiff.fence, 1.15 * plan.wanted.speed_mps)
    for bend, _ in plan.way:
        places = places_of(here, [bend])
        here = bend.to
        if bend.centre is None:
            continue
        arcs += LineString(places).distance(ISLAND) < plan.wanted.room_m - 1.0
        for a, b in pairwise(places):
            there = b[0] + stopped_m * (b[0] - a[0]) / math.dist(a, b), b[1] + stopped_m * (b[1] - a[1]) / math.dist(a, b)
            assert LineString([b, there]).distance(ISLAND) > skiff.fence.margin_m + 1.0
    assert arcs >= 4, "at the island"
    pieces = legs(plan)
    sharp = [a for a, b in pairwise(pieces) if a.corner_rad(b) > 1.0]
    assert len(sharp) <= 1, "corners of a boat that needs arcs"


@pytest.mark.parametrize(("boat", "room_m", "stub_m"), [("wam-v", 16.0, 3.0), ("../delfimx", 12.0, 3.0), ("otter", 12.0, 3.0)])
def test_a_boat_that_turns_slowly_keeps_more_room_from_holes(boat: str, room_m: float, stub_m: float) -> None:
    """Wind and current carry her while she turns, for 14 s half round."""
    wanted = wanted_of(config.load(f"etc/boats/{boat}.toml"), spacing_m=10.0)
    assert (wanted.room_m, wanted.stub_m) == (room_m, stub_m)


def test_a_boat_that_turns_on_the_spot_is_slow_before_it_turns_at_a_hole_however_short_the_run_out_is() -> None:
    """A run-out of three metres was sailed slowly, and the line before it at full speed: the boat was stopped by its fence."""
    wam_v = config.load("etc/boats/wam-v.toml")
    hole = box(-40.0, 85.0, 60.0, 94.0)  # 16.5 m behind the lines: they end there, not at the hole
    ground = Ground(AT, MultiPolygon([box(0.0, 0.0, 20.0, 68.5)]), MultiPolygon([hole]))
    plan = planned(ground, wanted_of(wam_v, spacing_m=5.0, heading_deg=0.0), wam_v.fence)
    places = stops(plan)
    slow, ends = slow_ways(plan, places), [number for number, (place, _) in enumerate(places) if place[1] > 70.0]
    run_outs = [number for number in ends if places[number - 1][1]]
    assert run_outs
    for number in run_outs:
        assert math.dist(places[number][0], places[number - 1][0]) < plan.wanted.brake_m, "short"
        assert {number - 1, number} <= slow
        assert math.dist(places[number][0], places[number - 2][0]) == pytest.approx(plan.wanted.brake_m)


def turned_m(far_m: float) -> float:
    """The way of a turn to a line so far away."""
    here, long_m = (0.0, 0.0), 0.0
    for bend in turn(here, 0.0, (far_m, 0.0), math.pi, 10.0):
        long_m += bend.long_m or math.dist(here, bend.to)
        here = bend.to
    return long_m


def test_turns_end_where_they_shall() -> None:
    for number in range(200):
        end, end_rad = (7.0 * math.sin(number) * 5.0, 30.0 * math.cos(2.0 * number)), 0.7 * number
        bends = turn((1.0, 2.0), 0.1 * number, end, end_rad, 6.0)
        assert math.dist(bends[-1].to, end) < 1.3, "but for a piece that is left out"
        assert all(bend.centre is None or math.dist(bend.centre, bend.to) == pytest.approx(6.0) for bend in bends)
    assert turned_m(20.0) == pytest.approx(10.0 * math.pi)
    assert turned_m(10.0) > 1.7 * turned_m(20.0)


def test_the_same_lines_come_in_the_same_order_and_near_ones_one_after_the_other() -> None:
    ground, spacing_m = drawn(5)
    cut = Cut(spacing_m, spacing_m, True, 0.0)
    found = strips(ground.area, ground.area.buffer(100.0), 30.0, cut)
    order = ordered(found, 1, None)
    assert order == ordered(found, 1, None)
    given = [strip.line for strip in found]
    way_m, as_given_m = (sum(math.dist(a[1], b[0]) for a, b in pairwise(each)) for each in (order, given))
    assert way_m < 0.5 * as_given_m
    assert len(order) == len(given)
    assert swaths(order, spacing_m).area == pytest.approx(swaths(given, spacing_m).area)


def test_an_area_of_a_file_is_laid_into_the_plane_about_its_first_corner() -> None:
    from delfim.survey.areafile import Shape

    ring = [(38.69, -9.21), (38.69, -9.209), (38.691, -9.209)]
    ground = laid([Shape(ring, [])])
    assert math.degrees(ground.at.latitude_rad) == pytest.approx(38.69)
    assert ground.area.area == pytest.approx(0.5 * 87.0 * 111.0, rel=0.01)


def test_a_boat_that_steers_keeps_more_room_from_a_hole_for_it_is_faster_in_a_turn_and_passes_the_end_of_a_line() -> None:
    skiff = config.load(Path(__file__).parents[2] / "etc/boats/skiff.toml")
    assert wanted_of(skiff, spacing_m=10.0).room_m == 19.0
    assert wanted_of(skiff, spacing_m=10.0, room_m=20.0).room_m == 20.0


def test_a_fast_boat_keeps_room_to_stop_before_a_hole() -> None:
    settings = config.load(Path(__file__).parents[2] / "etc/delfimx.toml", ("control.speed.max_mps=4.0",))
    for speed_mps in (1.5, 2.0, 2.5, 3.0, 4.0):
        wanted = wanted_of(settings, spacing_m=15.0, speed_mps=speed_mps, heading_deg=90.0)
        island = Polygon([(148.0, 98.0), (152.0, 98.0), (150.0, 104.0)])
        ground = Ground(AT, MultiPolygon([box(0, 0, 300, 200).difference(island)]), MultiPolygon([island]))
        plan = planned(ground, wanted, settings.fence)
        check(mission(plan, "fast"), plan, settings)
    assert wanted_of(settings, spacing_m=15.0).room_m == 12.0
