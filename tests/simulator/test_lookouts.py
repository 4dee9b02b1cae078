"""Things in the simulated water and the sensors that look for them: what they see, miss and make up, and how they tell it."""

import math
import os
from pathlib import Path
from random import Random

import msgspec
import pytest

from delfim import config
from delfim.base.errors import ConfigError
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.nodes import nodes_of
from delfim.simulator.nodes.lookouts import SORTS, TOLD, Surroundings, TrueThing
from delfim.simulator.nodes.worlds import Standing, drawn
from delfim.simulator.realtime.lookout_pipes import LookoutPipes, pipe_of
from delfim.simulator.scenarios import trial
from delfim.simulator.tables import Simulation
from delfim.vehicle import console
from delfim.vehicle.state import NoLog

ROOT = Path(__file__).parents[2]
ROWS = """
[boat]
name = "test"

[payload.lidar]
command = ["/usr/bin/lidar"]
may = ["obstacles"]

[[simulation.things.lookout]]
payload = "lidar"
"""


def settings(tmp_path: Path, text: str = "") -> config.Vehicle:
    file = tmp_path / "boat.toml"
    file.write_text(ROWS + text)
    return config.load(file)


def around(tmp_path: Path, text: str) -> Surroundings:
    found = nodes_of(settings(tmp_path, text), 1).surroundings
    assert found is not None
    return found


def thing(north_m: float, east_m: float, more: str = "") -> str:
    return f"\n[[simulation.things.thing]]\nnorth_m = {north_m}\neast_m = {east_m}\n{more}\n"


def told(here: Surroundings, seconds: float) -> list[console.Sight]:
    return [sight for i in range(round(seconds / 0.25)) for _, sight in here.step(0.25 * i)]


def test_a_lidar_sees_a_buoy_within_its_reach_where_it_is(tmp_path: Path) -> None:
    here = around(tmp_path, "ghosts = 0.0\n" + thing(50.0, 30.0) + thing(79.0, 30.0))
    sights = told(here, 60.0)
    assert {each.target.id for each in sights} == {"1"}
    assert 0.8 < len(sights) / 240 < 1.0, "a tenth is missed"
    (origin,) = {here._model.origin}
    for each in sights:
        north_m = (math.radians(each.target.latitude_deg) - origin.latitude_rad) * origin.north_m_per_rad
        assert abs(north_m - 50.0) < 1.5
        assert (each.target.kind, each.target.confidence) == ("thing", SORTS["lidar"].confidence)


def test_a_camera_looks_ahead_and_knows_a_swimmer(tmp_path: Path) -> None:
    text = 'kind = "camera"\nghosts = 0.0\nmissed = 0.0\n'
    here = around(tmp_path, text + thing(40.0, 0.0, 'kind = "person"') + thing(-40.0, 0.0) + thing(0.0, 40.0))
    assert {(each.target.id, each.target.kind) for each in told(here, 10.0)} == {("1", "person")}


def test_ghosts_are_seen_once_and_not_where_something_is(tmp_path: Path) -> None:
    here = around(tmp_path, "ghosts = 2.0\n")
    sights = told(here, 100.0)
    assert 150 < len(sights) < 250
    assert len({each.target.latitude_deg for each in sights}) == len(sights)


def test_of_more_than_the_boat_takes_all_are_told_by_turns(tmp_path: Path) -> None:
    here = around(tmp_path, "ghosts = 0.0\nmissed = 0.0\n" + "".join(thing(40.0, 2.0 * i) for i in range(-10, 10)))
    for i in range(4):
        assert len(here.step(0.25 * i)) == TOLD
    assert {each.target.id for each in told(around(tmp_path, ""), 0.0)} == set()
    assert len({sight.target.id for i in range(4, 8) for _, sight in here.step(0.25 * i)}) == 4 * TOLD


def test_a_vessel_without_ais_is_told_as_one_with_its_course(tmp_path: Path) -> None:
    row = '[[simulation.traffic.vessel]]\nname = "KAYAK"\nnorth_m = 60.0\ncourse_deg = 90.0\nspeed_mps = 1.0\ntransponder = '
    (first, *_) = told(around(tmp_path, f'ghosts = 0.0\nmissed = 0.0\n{row}"none"\n'), 1.0)
    assert (first.target.id, first.target.kind, first.target.course_deg) == ("KAYAK", "vessel", 90.0)
    assert told(around(tmp_path, f'ghosts = 0.0\nmissed = 0.0\n{row}"B"\n'), 1.0) == []


def test_the_same_seed_sees_the_same(tmp_path: Path) -> None:
    text = "ghosts = 3.0\n" + thing(50.0, 30.0)
    assert told(around(tmp_path, text), 20.0) == told(around(tmp_path, text), 20.0)


@pytest.mark.parametrize("world", ["field", "moorings", "bathers", "entrance", "pocket", "harbour"])
def test_a_world_lies_to_the_north_and_is_of_its_seed(world: str) -> None:
    for seed in range(20):
        things = drawn(world, Random(seed))
        assert things == drawn(world, Random(seed))
        assert 5 <= len(things) <= 80
        assert all(20.0 < each.north_m < 400.0 and each.radius_m > 0.0 for each in things)


def test_how_near_the_hull_came_is_measured_from_its_edge(tmp_path: Path) -> None:
    model = nodes_of(settings(tmp_path), 1).model
    for north_m, east_m, clear_m in ((10.0, 0.0, 7.0), (0.0, 10.0, 8.0), (5.0, 5.0, 4.0), (2.5, 0.5, -0.5)):
        each = TrueThing(1, Standing(north_m, east_m, 1.0))
        each.measure(model, 2.0, 1.0)
        assert each.nearest_m == pytest.approx(clear_m)


@pytest.mark.parametrize("right", ["[]", '["goto"]'])
def test_a_look_out_without_a_program_that_may_tell_is_refused(tmp_path: Path, right: str) -> None:
    file = tmp_path / "boat.toml"
    file.write_text(ROWS.replace('["obstacles"]', right))
    with pytest.raises(ConfigError, match="obstacles"):
        nodes_of(config.load(file), 1)


def test_the_boat_knows_what_the_lidar_sees(tmp_path: Path) -> None:
    run = Lockstep(settings(tmp_path, thing(40.0, 10.0)), 1, lambda clock: NoLog())
    for _ in run.cycles(20.0):
        pass
    (seen,) = [each for each in run.state.traffic.targets if each.name == "lidar 1"]
    assert math.hypot(seen.north_m - 40.0, seen.east_m - 10.0) < 1.0


def test_a_boat_that_strikes_something_fails_its_run(tmp_path: Path) -> None:
    file = tmp_path / "blind.toml"
    file.write_text(
        'version = 1\nname = "blind"\nseconds = 60\n[[vehicle.simulation.things.thing]]\nnorth_m = 20.0\n'
        '[[command]]\nat_s = 5\ncommand = "heading"\nheading_deg = 0\nspeed_mps = 1.5\n'
        "[[expect]]\nclear_m = 1.0\n"
    )
    result = trial.run_file(file, ROOT / "etc/delfimx.toml", 1)
    assert any(words.startswith("struck thing 1 at ") for words in result.failures)
    assert any(words.endswith("m from thing 1") for words in result.failures)


def test_in_real_time_the_program_reads_what_its_look_out_sees(tmp_path: Path) -> None:
    boat = settings(tmp_path, "ghosts = 0.0\nmissed = 0.0\n" + thing(40.0, 0.0))
    boat = msgspec.structs.replace(boat, runtime=msgspec.structs.replace(boat.runtime, run_directory=str(tmp_path)))
    assert len(boat.of(Simulation).things.lookout) == 1
    here = nodes_of(boat, 1).surroundings
    assert here is not None
    with LookoutPipes(boat, here) as pipes:
        pipes.say(here.step(0.0))  # nobody listens
        end = os.open(pipe_of(boat, "lidar"), os.O_RDONLY | os.O_NONBLOCK)
        pipes.say(here.step(1.0))
        (line,) = os.read(end, 4096).splitlines()
        told = console.parse(line)
        assert isinstance(told, console.Sight)
        assert told.target.id == "1"
        for i in range(2, 1000):  # who does not read loses lines, and holds up nobody
            pipes.say(here.step(float(i)))
        os.close(end)
        pipes.say(here.step(1000.0))
        pipes.say(here.step(1001.0))
    assert not pipe_of(boat, "lidar").exists()
