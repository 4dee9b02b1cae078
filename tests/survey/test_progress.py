"""A survey goes on wherever it was cut, and is divided among boats: nothing is left out, and little is sailed twice."""

import math
from itertools import pairwise
from pathlib import Path
from random import Random

import msgspec
import pytest
from shapely import STRtree, points
from shapely.geometry import LineString, MultiPolygon, box

from delfim.__main__ import main
from delfim.base.errors import FormatError
from delfim.config import Zones
from delfim.survey.ground import Place, Segment, in_degrees, swaths
from delfim.survey.planning import LinesWanted, SurveyPlan, plan_of, planned
from delfim.survey.progress import (
    LEAST_M,
    OVERLAP_M,
    Span,
    kept,
    least_m,
    left,
    merged,
    parts,
    read_survey,
    sailed,
    with_covered,
    write_survey,
)
from delfim.survey.progress import SurveyWishes as Wishes
from delfim.survey.sharing import BoatShare, shared
from tests.survey.drawn import drawn
from tests.survey.sounded import utc_rows

ROOT = Path(__file__).parents[2]
NOTHING = Zones()
STEP_M, OFF_M = 1.5, 0.3


def soundings(plan: SurveyPlan, draw: Random, until: float = 1.0) -> list[Place]:
    """The places along the first part of a plan's time, as a receiver has them."""
    places, far_m = list[Place](), until * plan.way_m
    ends = [plan.begin, *(each.bend.to for each in plan.way)]
    for (x, y), (to_x, to_y) in pairwise(ends):
        long_m = math.dist((x, y), (to_x, to_y))
        for step in range(max(1, int(min(long_m, far_m) / STEP_M))):
            part = step * STEP_M / long_m if long_m else 0.0
            places.append((x + part * (to_x - x) + draw.gauss(0.0, OFF_M), y + part * (to_y - y) + draw.gauss(0.0, OFF_M)))
        far_m -= long_m
        if far_m <= 0.0:
            break
    return places


def covered(plan: SurveyPlan, done: list[list[Span]]) -> float:
    its = [part for line, spans in zip(plan.lines, done, strict=True) for part in parts(line, spans)]
    return swaths(its, plan.wanted.spacing_m).intersection(plan.free).area / plan.free.area if its else 0.0


def cut(plan: SurveyPlan, draw: Random) -> float:
    """A part of the way that ends in the middle of a line."""
    far_m, places = 0.0, [plan.begin, *(each.bend.to for each in plan.way)]
    middles = list[float]()
    for piece, (a, b) in zip(plan.way, pairwise(places), strict=True):
        if piece.line is not None:
            middles.append(far_m + draw.uniform(0.2, 0.8) * math.dist(a, b))
        far_m += math.dist(a, b)
    return draw.choice(middles) / far_m


@pytest.mark.parametrize("seed", range(50))
def test_a_survey_that_is_cut_in_the_middle_of_a_line_goes_on(seed: int) -> None:
    ground, spacing_m = drawn(seed)
    spacing_m = max(spacing_m, 10.0)
    wanted, draw = LinesWanted(spacing_m, STEP_M), Random(f"cut {seed}")
    plan = planned(ground, wanted, NOTHING)
    first = soundings(plan, draw, cut(plan, draw))
    done = sailed(plan.lines, first, spacing_m)
    gaps = [left(line, spans, least_m(spacing_m), wanted.cut.joined_m) for line, spans in zip(plan.lines, done, strict=True)]
    rest = plan_of(ground, wanted, NOTHING, plan.heading_deg, [each for its in gaps for each in its], [], first[-1])
    second = sailed(plan.lines, soundings(rest, draw), spacing_m)
    both = [merged(*each) for each in zip(done, second, strict=True)]
    once = sailed(plan.lines, soundings(plan, draw), spacing_m)
    assert covered(plan, both) > covered(plan, once) - 0.015, "a line of a few metres is not gone back to"
    gone = [gap for each in zip(plan.lines, both, strict=True) for gap in left(*each)]
    assert max((math.dist(*gap) - OVERLAP_M for gap in gone), default=0.0) < spacing_m, "no gap is longer than a spacing"
    took_s = len(first) * STEP_M / wanted.speed_mps + math.dist(first[-1], rest.begin) / wanted.speed_mps + rest.time_s
    assert took_s < 1.15 * plan.time_s + 60.0, "of a survey of minutes, the way there counts"
    for line, spans, again in zip(plan.lines, done, gaps, strict=True):
        whole = sum(b - a for a, b in spans)
        twice = whole + sum(math.dist(*each) for each in again) - math.dist(*line)
        assert twice <= (len(spans) + 1) * max(2.0 * OVERLAP_M, wanted.cut.joined_m), "no line twice but for its run-in"


def test_what_is_done_is_kept_by_line_and_only_along_it() -> None:
    line: Segment = ((0.0, 0.0), (0.0, 100.0))
    along = [(0.5, float(y)) for y in (*range(-10, 41, 2), *range(60, 121, 2))]
    assert sailed([line], along, 10.0) == [[(0.0, 40.0), (60.0, 100.0)]]
    assert sailed([line], [(x + 3.0, y) for x, y in along], 10.0) == [[]], "a quarter of the spacing, no more"
    assert sailed([line], [(float(x), 50.0) for x in range(-20, 20)], 10.0) == [[]], "who crosses has not sailed it"
    assert left(line, [(0.0, 40.0), (60.0, 100.0)]) == [((0.0, 40.0 - OVERLAP_M), (0.0, 60.0 + OVERLAP_M))]
    assert left(line, [(LEAST_M, 100.0)]) == []
    assert left(line, [(20.0, 30.0)], joined_m=20.0) == [line]
    assert merged([(5.0, 9.0), (0.0, 2.0)], [(1.0, 5.0)]) == [(0.0, 9.0)]


def test_what_is_covered_from_beside_a_line_is_no_gap() -> None:
    lines = [((0.0, y), (100.0, y)) for y in (0.0, 10.0, 20.0)]
    area = MultiPolygon([box(0.0, -5.0, 100.0, 25.0)])
    whole = [(float(x), y) for y in (0.0, 20.0) for x in range(101)]
    aside = [(float(x), 10.0 + max(0.0, 4.0 - x / 4.0)) for x in range(101)]  # it comes to its line in 16 m
    done = sailed([lines[1]], [*whole, *aside], 10.0)[0]
    assert left(lines[1], done)
    assert with_covered(lines[1], done, STRtree(points([*whole, *aside])), area, 10.0) == [(0.0, 100.0)]
    alone = STRtree(points(aside))
    assert with_covered(lines[1], done, alone, area, 10.0) == done, "nobody sounded the other side"
    assert with_covered(lines[1], [], STRtree(points(whole)), area, 10.0) == [], "neighbours alone do not cover a line"


def test_a_line_of_a_sensor_that_looks_to_one_side_is_done_only_where_it_was_sailed_that_way() -> None:
    there: Segment = ((0.0, 0.0), (0.0, 100.0))
    along = [(0.1, float(y)) for y in range(-5, 106, 2)]
    assert sailed([there, there[::-1]], along, 10.0, one_way=True) == [[(0.0, 100.0)], []]
    assert sailed([there, there[::-1]], along, 10.0) == [[(0.0, 100.0)], [(0.0, 100.0)]]


def test_boats_are_done_at_the_same_time_and_share_anew_when_one_goes_home() -> None:
    ground, _ = drawn(6)
    slow, fast = LinesWanted(10.0, 1.0), LinesWanted(10.0, 2.0, cross_m=60.0)
    plan = planned(ground, fast, NOTHING)
    main_lines, across = plan.lines[: len(plan.lines) - plan.across], plan.lines[len(plan.lines) - plan.across :]
    boats = [BoatShare(slow, NOTHING), BoatShare(fast, NOTHING), BoatShare(fast, NOTHING)]
    plans = [each for each in shared(ground, plan.heading_deg, main_lines, across, boats) if each is not None]
    assert len(plans) == 3
    assert sorted(ends for each in plans for ends in map(sorted, each.lines)) == sorted(map(sorted, plan.lines)), (
        "each line once"
    )
    times = [each.time_s for each in plans]
    assert max(times) < 1.15 * min(times)
    assert max(times) < 0.5 * plan.time_s
    draw, done = Random("home"), [list[Span]() for _ in plan.lines]
    for each in plans:  # half of the time, then the first one goes home
        half = sailed(plan.lines, soundings(each, draw, 0.5), 10.0)
        done = [merged(*spans) for spans in zip(done, half, strict=True)]
    rest = [left(line, spans, joined_m=29.0) for line, spans in zip(plan.lines, done, strict=True)]
    again = shared(ground, plan.heading_deg, [each for its in rest for each in its], [], boats[1:])
    assert all(each is not None for each in again)
    for each in again:
        assert each is not None
        half = sailed(plan.lines, soundings(each, draw), 10.0)
        done = [merged(*spans) for spans in zip(done, half, strict=True)]
    assert covered(plan, done) > 0.985 * plan.covered()[0]


def test_more_boats_than_lines_leave_some_without() -> None:
    ground, _ = drawn(0)
    plan = planned(ground, LinesWanted(10.0, 1.5), NOTHING)
    plans = shared(ground, plan.heading_deg, plan.lines[:2], [], [BoatShare(plan.wanted, NOTHING)] * 3)
    assert sum(each is None for each in plans) == 1


def test_the_file_of_a_survey_is_read_as_it_was_written_or_refused(tmp_path: Path) -> None:
    from delfim.survey.areafile import read_area
    from delfim.survey.ground import laid

    areas = read_area(ROOT / "etc/areas/basin.geojson")
    plan = planned(laid(areas), LinesWanted(20.0, 1.5, cross_m=40.0), NOTHING)
    survey = kept([plan], "basin", areas, Wishes(spacing_m=20.0, cross_m=40.0))
    survey.done[2] = [(1.0, 20.0)]
    write_survey(survey, tmp_path / "basin.survey.json")
    assert read_survey(tmp_path / "basin.survey.json") == survey
    assert survey.across == plan.across > 0
    for line, again in zip(plan.lines, survey.segments(plan.ground), strict=True):
        assert math.dist(line[0], again[0]) < 1e-3 > math.dist(line[1], again[1])
    for wrong in (b"", b"{}", b"\xff", msgspec.json.encode(survey).replace(b'"done":[[],', b'"done":[')):
        (tmp_path / "wrong.survey.json").write_bytes(wrong)
        with pytest.raises(FormatError, match="not the file of a survey"):
            read_survey(tmp_path / "wrong.survey.json")


def test_the_command_makes_the_rest_by_logs_and_says_when_all_is_done(tmp_path: Path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["survey", "lines", str(ROOT / "etc/areas/basin.geojson"), "--spacing", "20", "--output", "basin.toml"]) == 0
    assert main(["survey", "rest", "basin.survey.json"]) == 0
    assert "0 of 12 lines done, 0 in part, 12 not begun" in capsys.readouterr().out
    survey = read_survey("basin.survey.json")
    from delfim.survey.ground import laid

    ground, draw = laid(survey.areas), Random("rest")
    plan = planned(ground, LinesWanted(20.0, 1.5), NOTHING)
    places = soundings(plan, draw)
    half = len(soundings(plan, draw, cut(plan, draw)))
    for number, its in enumerate((places[:half], places[half - 10 :])):
        rows = utc_rows(in_degrees(ground.at, *place) for place in its)
        (tmp_path / f"{number}.csv").write_text("utc,latitude [deg],longitude [deg],depth_m [m]\n" + "".join(rows))
    words = ["survey", "rest", "basin.survey.json", "--boats", "etc/delfimx.toml,etc/boats/otter.toml"]
    assert main([*words, "0.csv"]) == 0
    said = capsys.readouterr().out
    assert "1 in part" in said
    assert {each.name for each in tmp_path.glob("*.toml")} == {
        "basin.toml",
        "basin-rest.toml",
        "basin-rest-delfimx.toml",
        "basin-rest-otter.toml",
    }
    assert main([*words, "1.csv"]) == 0
    assert capsys.readouterr().out.endswith("the survey is done\n")


def test_the_rest_begins_where_the_boat_is() -> None:
    ground, _ = drawn(0)
    plan = planned(ground, LinesWanted(10.0, 1.5), NOTHING)
    box = LineString([place for line in plan.lines for place in line]).bounds
    for corner in ((box[0], box[1]), (box[2], box[3])):
        rest = plan_of(ground, plan.wanted, NOTHING, plan.heading_deg, plan.lines, [], corner)
        ends = [math.dist(corner, place) for line in plan.lines for place in line]
        assert math.dist(corner, rest.lines[0][0]) < min(ends) + 40.0
