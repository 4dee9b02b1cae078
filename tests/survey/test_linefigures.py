"""The figures of lines, and the report of them."""

import math
from itertools import groupby
from pathlib import Path

import pytest

from delfim.__main__ import main
from delfim.base.errors import DelfimError
from delfim.survey import linefigures
from delfim.survey.linefigures import figures
from delfim.vehicle.plans.mission import load_mission

ROOT = Path(__file__).parents[2]
LINE = {7: ((0.0, 0.0), (100.0, 0.0))}


def test_a_line_is_sailed_where_the_boat_was_near_it() -> None:
    track = [(7, (float(x), 0.5 if x < 50 else -1.0)) for x in range(101) if not 20 < x < 40]
    (all_of_it,) = figures(LINE, track)
    assert all_of_it.sailed == pytest.approx(0.8)
    assert (all_of_it.p95_m, all_of_it.most_m) == (1.0, 1.0)
    (near,) = figures(LINE, track, within_m=0.6)
    assert near.sailed == pytest.approx(0.29)
    assert all_of_it.rms_m == pytest.approx(math.sqrt((31 * 0.25 + 51) / 82), abs=0.01)


def test_play_leaves_a_line_before_its_end_and_the_boat_does_not() -> None:
    track = [(7, (float(x), 0.2)) for x in range(96)] + [(0, (float(x), 0.2)) for x in range(96, 140)]
    assert figures(LINE, track)[0].sailed == pytest.approx(1.0)
    turned = [*track[:96], (0, (95.0, 20.0)), (0, (99.0, 0.0))]
    assert figures(LINE, turned)[0].sailed == pytest.approx(0.95)
    assert math.isnan(figures(LINE, [])[0].rms_m)


def test_a_line_that_the_boat_believes_to_begin_later_than_it_does_is_sailed_from_its_beginning() -> None:
    along = [(0 if x < 3 else 7, (float(x), 0.2)) for x in range(-12, 101)]
    assert figures(LINE, along)[0].sailed == pytest.approx(1.0)
    aside = [(0, (2.0, float(y))) for y in range(30, 5, -1)]
    assert figures(LINE, [*aside, *along[14:]])[0].sailed == pytest.approx(0.98)
    other = [(6, (float(x), 0.2)) for x in range(3)]
    assert figures(LINE, [*other, *along[15:]])[0].sailed == pytest.approx(0.97)


@pytest.mark.long
def test_the_report_of_a_survey(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    area, boat = str(ROOT / "etc/areas/basin.geojson"), str(ROOT / "etc/boats/otter.toml")
    words = ["--vehicle", boat, "--spacing", "40", "--at-begin", "206,10", "--at-end", "206"]
    assert main(["survey", "lines", area, *words]) == 0
    told = capsys.readouterr().out
    assert " Wh at 1.5 m/s" in told
    mission = load_mission("basin.toml")
    lines = [line for line, _ in groupby(row.line for row in mission.waypoint) if line]  # one that ends at a hole has two legs
    assert lines == list(range(1, len(lines) + 1))
    legs = [number for number, row in enumerate(mission.waypoint) if row.line]
    firsts = [number for number in legs if mission.waypoint[number - 1].line != mission.waypoint[number].line]
    lasts = [number for number in legs if mission.waypoint[number + 1].line != mission.waypoint[number].line]
    assert [each.after for each in mission.action] == [
        at for first, last in zip(firsts, lasts, strict=True) for at in (first, last + 1)
    ]
    assert [each.params[0] for each in mission.action[:2]] == [10.0, 0.0]
    assert main(["sim", boat, "--mission", "basin.toml", "--lockstep", "--output", "run"]) == 0
    capsys.readouterr()
    assert main(["survey", "report", "basin.toml", "run"]) == 0
    rows = capsys.readouterr().out.splitlines()
    assert len(rows) == len(lines) + 2
    assert all(float(row.split()[3]) > 96.0 for row in rows[1:-1]), rows
    with pytest.raises(DelfimError, match="no numbers of lines"):
        linefigures.lines_of(load_mission(ROOT / "etc/missions/doca.toml"))


@pytest.mark.parametrize("text", ["206,1,2,3,4,5", "x", "206.5", ""])
def test_an_action_is_a_number_and_up_to_four_more(text, capsys) -> None:
    with pytest.raises(SystemExit):
        main(["survey", "lines", str(ROOT / "etc/areas/basin.geojson"), "--spacing", "40", "--at-begin", text])
    assert "not a number of MAVLink" in capsys.readouterr().err
