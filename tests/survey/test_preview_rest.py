"""What is left of a survey, for a page: by files of soundings, of lines that the console planned or that a boat has aboard."""

import math
from pathlib import Path
from random import Random
from typing import Any

import msgspec

from delfim import config
from delfim.survey.areafile import read_area
from delfim.survey.ground import Place, in_degrees, laid
from delfim.survey.planning import LinesWanted, planned
from delfim.survey.preview import answered
from tests.survey.sounded import utc_rows
from tests.survey.test_progress import soundings

ROOT = Path(__file__).parents[2]
SETTINGS = config.load(ROOT / "etc/delfimx.toml")
AREAS = read_area(ROOT / "etc/areas/basin.geojson")
HEAD = "utc,latitude [deg],longitude [deg],depth_m [m]\n"


def told(**asked: Any) -> dict[str, Any]:
    return answered(msgspec.json.encode(asked), SETTINGS)


def kept(folder: Path, name: str, places: list[Place]) -> str:
    """A file of soundings along a way."""
    at = laid(AREAS).at
    file = folder / f"{name}.csv"
    file.write_text(HEAD + "".join(utc_rows(in_degrees(at, *place) for place in places)))
    return str(file)


def test_what_two_boats_have_sounded_counts_together_and_the_rest_begins_at_the_boat(tmp_path: Path) -> None:
    whole = told(areas=AREAS, spacing_m=20.0, name="basin")
    plan, draw = planned(laid(AREAS), LinesWanted(20.0, 1.5), config.Zones()), Random("page")
    places = soundings(plan, draw)
    third = len(places) // 3
    heard = [kept(tmp_path, "1", places[:third]), kept(tmp_path, "2", places[-third:])]
    boat = in_degrees(plan.ground.at, *places[third])
    known = {"areas": AREAS, "spacing_m": 20.0, "lines": whole["lines"], "across": 0, "at": boat, "heard": heard}
    rest = told(**known)
    assert 3 <= len(rest["lines"]) < len(whole["lines"]) - 5
    assert rest["line_m"] + sum(math.dist(*map(flat, line)) for line in rest["done"]) > whole["line_m"] - 3.0, (
        "shorter gaps are none"
    )
    assert rest["covered"][0] > 0.99
    assert "in part" in rest["counts"]
    assert rest["known"] == whole["lines"]
    assert math.dist(flat(rest["way"][0]), flat(boat)) < 40.0
    other = told(**known | {"at": in_degrees(plan.ground.at, *places[-third])})
    assert other["lines"][0] != rest["lines"][0]
    known["heard"] = [*heard, kept(tmp_path, "3", places)]
    assert told(**known)["refused"].startswith("nothing is left: ")


def test_what_is_left_is_divided_among_the_boats_that_go_on(tmp_path: Path) -> None:
    whole = told(areas=AREAS, spacing_m=20.0, cross_m=40.0, name="basin")
    plan, draw = planned(laid(AREAS), LinesWanted(20.0, 1.5), config.Zones()), Random("page")
    places = soundings(plan, draw)
    heard = [kept(tmp_path, "1", places[: len(places) // 4])]
    here, there = (in_degrees(plan.ground.at, *places[at]) for at in (len(places) // 4, -1))
    known = {"areas": AREAS, "spacing_m": 20.0, "lines": whole["lines"], "across": whole["across"], "heard": heard}
    alone, both = told(**known, at=here), told(**known, at=here, others=[there])
    one, other = both["shares"]
    assert alone["shares"] == ()
    assert sorted(map(str, [*one["lines"], *other["lines"]])) == sorted(map(str, both["lines"]))
    assert both["across"] == alone["across"] > 0
    assert both["counts"] == alone["counts"]
    assert max(one["time_s"], other["time_s"]) == both["time_s"] < 0.7 * alone["time_s"]
    assert math.dist(flat(other["way"][0]), flat(there)) < math.dist(flat(other["way"][0]), flat(here))
    assert all(each["mission"]["waypoint"] for each in (one, other))


def flat(place: Any) -> Place:
    return place[0] * 111_111.0, place[1] * 111_111.0 * math.cos(math.radians(38.69))


def test_lines_without_their_area_are_a_survey_with_the_spacing_that_they_have(tmp_path: Path) -> None:
    whole = told(areas=AREAS, spacing_m=20.0, cross_m=30.0)
    known = {"areas": [], "lines": list(reversed(whole["lines"]))}
    rest = told(**known)
    assert abs(rest["spacing_m"] - 20.0) < 0.1
    assert (len(rest["lines"]), rest["across"]) == (len(whole["lines"]), whole["across"])
    assert rest["known_across"] == whole["across"] > 0
    assert sorted(rest["known"]) == sorted(whole["lines"])
    assert rest["counts"].startswith("0 of ")
    hole = AREAS[0].holes[0]
    closed = told(**known | {"closed": [hole]})
    assert closed["way_m"] > 0.0


def test_a_file_of_soundings_that_is_none_is_refused_in_words(tmp_path: Path) -> None:
    whole = told(areas=AREAS, spacing_m=20.0)
    (tmp_path / "1.csv").write_text("nothing\n")
    assert "no soundings" in told(areas=AREAS, spacing_m=20.0, lines=whole["lines"], heard=[str(tmp_path / "1.csv")])["refused"]
