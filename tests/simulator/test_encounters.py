"""Encounters of etc/encounters and random ones: staged so that nobody's doing nothing brings them together."""

import json
import math
from pathlib import Path

import pytest

from delfim.base.errors import ConfigError
from delfim.simulator.nodes.other_vessels import axes_m, nearness
from delfim.simulator.scenarios import trial
from delfim.simulator.scenarios.encounters import Encounter, drawn, kind_of, staged_of
from delfim.simulator.scenarios.scenario import Scenario, load_scenario

ROOT = Path(__file__).parents[2]
VEHICLE = ROOT / "etc/delfimx.toml"
FILES = sorted((ROOT / "etc/encounters").glob("*.json"))
TEXT = 'version = 1\nname = "test"\nseconds = 1\nencounters = "{file}"\n'


def written(folder: Path, file: str, *lines: str) -> Path:
    place = folder / "test.toml"
    place.write_text("\n".join([TEXT.format(file=file), *lines]))
    return place


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_each_file_is_staged_and_where_nobody_does_anything_every_domain_is_entered(tmp_path, file):
    """By straight lines: the boat at its speed to the north from 10 s on."""
    path = written(tmp_path, str(file))
    for name, scenario, mission in staged_of(load_scenario(path), path):
        assert scenario.encounters == ""
        assert mission.count("[[waypoint]]") == 2
        own_mps = scenario.vehicle["control"]["speed"]["cruise_mps"]
        for row in scenario.vessel:
            course_rad, axes = math.radians(row["course_deg"]), axes_m(row["length_m"])
            near = [
                nearness(
                    own_mps * (t_s - 10.0) - row["north_m"] - row["speed_mps"] * t_s * math.cos(course_rad),
                    -row["east_m"] - row["speed_mps"] * t_s * math.sin(course_rad),
                    course_rad,
                    axes,
                )
                for t_s in range(10, round(scenario.seconds), 10)
            ]
            assert near[0] > 1.0, name
            assert min(near) < 0.5, name
            assert near.index(min(near)) * 10.0 + 10.0 == pytest.approx(row["meets_s"], abs=60.0), name


def test_the_kinds_of_the_files_are_told_from_bearings_and_speeds():
    for file in FILES:
        for encounter in json.loads(file.read_text())["encounters"]:
            for ship in encounter["targets"]:
                given = (ship[key] for key in ("north_m", "east_m", "course_deg", "speed_mps"))
                assert kind_of(encounter["own"]["speed_mps"], *given) == ship["kind"], encounter["id"]


def test_a_faster_boat_meets_the_same_in_the_same_time_farther_away(tmp_path):
    rows = []
    for more in ("", "speed_mps = 3.0"):
        path = written(tmp_path, str(ROOT / "etc/encounters/imazu22-similar.json"), more)
        rows.append(staged_of(load_scenario(path), path)[1].scenario.vessel[0])
    slow, fast = rows
    assert [fast[key] for key in ("north_m", "east_m", "speed_mps", "length_m")] == pytest.approx(
        [2.0 * slow[key] for key in ("north_m", "east_m", "speed_mps", "length_m")]
    )
    assert fast["meets_s"] == slow["meets_s"]


def test_random_encounters_have_1_to_5_vessels_none_near_at_the_start_and_the_same_by_their_seed():
    found = [drawn(seed, 1.5) for seed in range(200)]
    assert {len(each.targets) for each in found} == {1, 2, 3, 4, 5}
    assert found[7] == drawn(7, 1.5) != drawn(8, 1.5)
    assert {ship.kind for each in found for ship in each.targets} >= {"head-on", "give-way", "stand-on", "overtaken"}
    for ship in (ship for each in found for ship in each.targets):
        assert nearness(-ship.north_m, -ship.east_m, math.radians(ship.course_deg), axes_m(ship.length_m)) > 1.0


def test_an_encounter_is_sailed_by_its_name_and_the_boat_plays_its_mission(tmp_path):
    path = written(tmp_path, str(ROOT / "etc/encounters/imazu22-similar.json"), "[[expect]]", "nearest = 1.0")
    result = trial.run_file(f"{path}:imazu-03", VEHICLE, 1)
    assert [event.name for event in result.events if event.kind == "mode"][-1] == "play"
    assert len(result.failures) == 1
    assert result.failures[0].startswith("OVERTAKING was as near as")


@pytest.mark.parametrize(
    ("file", "name", "words"),
    [
        ("none.json", "imazu-01", "none.json"),
        (str(ROOT / "etc/encounters/imazu22-real.json"), "imazu-99", "imazu-99: name one, as"),
        (str(VEHICLE), "imazu-01", "delfimx.toml"),
    ],
)
def test_a_file_or_a_name_that_is_not_there_is_refused_in_words(tmp_path, file, name, words):
    with pytest.raises(ConfigError) as refused:
        trial.run_file(f"{written(tmp_path, file)}:{name}", VEHICLE, 1)
    assert words in str(refused.value)


@pytest.mark.long
def test_a_random_encounter_is_sailed_by_its_seed(tmp_path):
    path = written(tmp_path, "random")
    assert isinstance(load_scenario(path), Scenario)
    assert isinstance(drawn(3, 1.5), Encounter)
    result = trial.run_file(path, VEHICLE, 3)
    assert result.elapsed_s > 500.0


def test_two_hundred_vessels_and_one_at_the_boats_own_place_stop_nothing(tmp_path):
    """The boat goes on, or does what the guard says; nothing raises, and nothing is stopped."""
    rows = [
        f"[[vessel]]\nnorth_m = {150.0 * (i % 20) - 1400.0}\neast_m = {150.0 * (i // 20) - 700.0}\n"
        f'course_deg = {37 * i % 360}\nspeed_mps = {i % 7}\ntransponder = "{"AB"[i % 2]}"'
        for i in range(200)
    ]
    place = "latitude_deg = 38.604\nlongitude_deg = -9.6"
    here = "[vehicle.simulation]\nlatitude_deg = 38.6\nlongitude_deg = -9.6\n[vehicle.simulation.traffic]\nheard = 'perfect'"
    lines = [
        'version = 1\nname = "crowd"\nseconds = 60\n[vehicle.sensors]\nnames = ["sysstat", "nmea2000"]',
        here,
        *rows,
        "[[vessel]]\ntransponder = 'A'",
        f'[[command]]\nat_s = 5\ncommand = "goto"\n{place}',
        '[[expect]]\nmode = "goto"\nafter = "goto"\nat_end = true',
    ]
    path = tmp_path / "crowd.toml"
    path.write_text("\n".join(lines))
    assert trial.run_file(path, VEHICLE, 1).failures == []
