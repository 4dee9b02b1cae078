"""The record of encounters: what is sailed, what the tables say, the page of tracks; and the fast check of decisions alone."""

import json
import math
import os
import subprocess
import sys
from multiprocessing.pool import ThreadPool
from pathlib import Path
from typing import Any

import pytest

from bench import encounters, record
from delfim.campaign.colreg import Instant
from delfim.simulator.scenarios.encounters import Encounter, Ship, drawn

ROOT = Path(__file__).parents[2]
HEAD_ON = Ship(north_m=1500.0, east_m=0.0, course_deg=180.0, speed_mps=1.5, length_m=20.0, kind="head-on", tcpa_s=500.0)


def met(*targets: Ship) -> Encounter:
    own = Ship(north_m=0.0, east_m=0.0, course_deg=0.0, speed_mps=1.5, length_m=4.5)
    return Encounter(id="test", title="test", own=own, targets=targets)


def test_the_guard_alone_keeps_clear_and_without_it_the_domain_is_entered():
    row = encounters.one(met(HEAD_ON))
    assert row["nearest"] >= 1.0 > 0.1 > row["without"]
    assert row["entered"] == [0, 1]


def test_a_random_encounter_of_a_seed_is_sailed():
    assert encounters.one(4)["name"] == drawn(4, 1.5).id


def test_a_solution_is_a_course_that_stays_clear_of_all():
    found = encounters.solution((HEAD_ON,))
    assert found is not None
    assert found != (0.0, 1.0)
    around = [
        Ship(
            north_m=200.0 * math.cos(math.radians(each)),
            east_m=200.0 * math.sin(math.radians(each)),
            course_deg=each + 180.0,
            speed_mps=1.0,
            length_m=100.0,
            tcpa_s=200.0,
        )
        for each in range(0, 360, 30)
    ]
    assert encounters.solution(around) is None


def test_the_record_sails_four_sets_with_and_without_the_guard_by_two_kinds_of_ais():
    plan, bare = (record.plan_of(2, guarded=guarded) for guarded in (True, False))
    assert (plan.runs, bare.runs) == ((22 + 22 + 55 + 55) * 2, 22 + 22 + 55 + 55)
    assert {values[record.HEARD] for _, values in plan.points} == {"perfect", "B"}
    assert {values[record.GUARD] for _, values in plan.points} == {True}
    assert {values[record.GUARD] for _, values in bare.points} == {False}
    scales = [record.plan_of(2, guarded=True, scale=each) for each in (record.SIMILAR, record.REAL)]
    assert [each.runs for each in scales] == [(22 + 55) * 2] * 2
    assert len({plan.digest, bare.digest, *(each.digest for each in scales)}) == 4
    assert plan.values(0, 2)["simulation.sea.wind_mps"] == bare.values(0, 2)["simulation.sea.wind_mps"], "side by side"


def test_random_encounters_are_kept_in_blocks_and_gone_on_with(tmp_path, monkeypatch):
    monkeypatch.setattr(encounters, "BLOCK", 2)
    monkeypatch.setattr(encounters, "Pool", ThreadPool)
    assert len(list(encounters.blocks(0, 2, 1, tmp_path))) == 2
    (kept,) = tmp_path.iterdir()
    rows = json.loads(kept.read_text())
    rows[0]["name"] = "kept"
    kept.write_text(json.dumps(rows))
    assert [row["name"] for row in encounters.blocks(0, 3, 1, tmp_path)] == ["kept", "random-1", "random-2"]
    assert len(list(tmp_path.iterdir())) == 1, "a block that is not complete is sailed again"


def sailed(seed: int = 1) -> Any:
    duckdb: Any = pytest.importorskip("duckdb")
    database = duckdb.connect()
    database.execute(
        f"""create table runs as select 'imazu22-real:imazu-0' || i as story, 'B' as "{record.HEARD}",
        i < 3 as "{record.GUARD}", {seed} as seed, 'd' as digest, 'v' as version, i as point, 1 as vessels, 0 as collisions,
        case when i = 2 then 1 else 0 end as entered, 0.5::double * i as nearest, 100.0::double as nearest_m, 2 as alterations,
        90.0::double as off_m, 3 as rules_asked,
        case when i = 1 then '8a in ample time: give-way 1' else '' end as rules_broken,
        'time' as "end", '' as error from range(1, 5) r(i)"""
    )
    return database


def test_who_reads_only_the_first_lines_sees_no_traceback():
    read, write = os.pipe()
    os.close(read)
    words = [sys.executable, "-m", "bench.record", "--tell", "--output", "docs/record.parquet"]
    here = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(words, cwd=ROOT, env=here, stdout=write, stderr=subprocess.PIPE, check=False)
    os.close(write)
    assert done.stderr == b""


def test_the_tables_name_what_failed(capsys):
    record.tell(sailed())
    told = capsys.readouterr().out
    assert "| imazu22-real | B | on | 2 | 2 | 0 | 1 | 0.5 | 0.75 | 100 | 2 | 90 | 6 | 5 |" in told
    assert "| 8a in ample time | 1 | 1 |" in told
    assert "| imazu22-real:imazu-02 | B | 1 | 1 | 100 | 1 |" in told


def test_runs_are_kept_in_a_file_each_once_and_tell_the_same_tables(tmp_path, capsys):
    place = tmp_path / "record.parquet"
    for seed in (1, 2, 1):
        record.keep(sailed(seed), place)
    kept = record.connect(place)
    assert kept.execute("select count(*), count(distinct seed) from runs").fetchall() == [(8, 2)]
    record.tell(kept)
    assert "| imazu22-real | B | on | 4 | 4 | 0 | 2 |" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == [place]


def test_the_pages_have_the_figures_of_the_kept_record():
    kept = record.connect(ROOT / "docs/record.parquet")
    guarded = f'where "{record.GUARD}"'
    runs, ships, seeds = kept.execute(f"select count(*), sum(vessels), max(seed) from runs {guarded}").fetchone()
    bad = kept.execute(f"select sum(entered), sum(collisions), count(*) filter (error != '') from runs {guarded}").fetchone()
    page = (ROOT / "docs/encounters.md").read_text()
    assert f"**{runs:,} runs with the guard, in which the boat meets {ships:,} ships: no collision, no domain entered**" in page
    assert f"Seeds 1 to {seeds} of" in page
    first = (ROOT / "README.md").read_text()
    assert all(words in first for words in (f"[{runs:,} simulated encounters]", f"{runs:,} [encounters]", f"{ships:,} ships"))
    assert bad == (0, 0, 0)


def test_the_page_of_tracks_is_drawn(tmp_path):
    instants = [Instant(float(t), 1.5 * t, 0.0, 0.0, 1.5, ((1500.0 - 1.5 * t, 30.0, math.pi),)) for t in range(900)]
    case = {"name": "test", "vessels": [(20.0, 4.0, "head-on", 1.0)], "instants": instants}
    record.draw([case] * 7, tmp_path / "page.png", "test")
    assert (tmp_path / "page.png").stat().st_size > 10_000


def test_what_a_random_encounter_came_to_can_be_drawn(tmp_path):
    row = encounters.one(2) | {"track": [(15.0 * i, 0.0) for i in range(100)]}
    case = encounters.shown(row)
    assert len(case["instants"]) == 100
    record.draw([case], tmp_path / "random.png", "random")
    assert (tmp_path / "random.png").exists()


def test_where_nothing_was_sailed_it_says_so(tmp_path):
    with pytest.raises(SystemExit, match=r"nothing was sailed into .*; what is kept: --tell --output"):
        record.connect(tmp_path)
