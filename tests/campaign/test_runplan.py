"""A campaign's file: what it says, and what is refused in words."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base import tables
from delfim.base.errors import ConfigError
from delfim.campaign import queries
from delfim.campaign.runplan import Draw, Plan, Seeds, laid, read

ETC = Path(__file__).parents[2] / "etc"
HEAD = f'version = 1\nname = "test"\nvehicle = "{ETC}/delfimx.toml"\n'
BUS_OFF = f'scenario = "{ETC}/scenarios/bus-off.toml"'


def written(folder: Path, *lines: str) -> Path:
    place = folder / "campaign.toml"
    place.write_text(HEAD + "\n".join(lines) + "\n")
    return place


def plan_of(draw: dict[str, Draw], seeds: Seeds, latin: bool) -> Plan:
    return Plan("test", "", (), ((0, {"x.y": 3}),), draw, latin, seeds, 10.0, 10.0)


@pytest.mark.parametrize("path", sorted((ETC / "campaigns").glob("*.toml")), ids=lambda path: path.stem)
def test_each_campaign_that_is_shipped_can_be_read(path):
    _, plan = read(path)
    assert plan.runs == len(plan.points) * plan.seeds.count > 0


def test_the_documents_example_can_be_read(tmp_path):
    text = (ETC.parent / "docs/campaigns.md").read_text().partition("```toml\n")[2].partition("```")[0]
    (tmp_path / "campaign.toml").write_text(text.replace('"../', f'"{ETC}/'))
    file, plan = read(tmp_path / "campaign.toml")
    assert len(plan.points) == 9
    assert [each.name for each in queries.rehearse(file, plan)] == ["By gain"]


def test_every_run_is_in_one_batch_and_the_file_alone_cuts_them(tmp_path):
    path = written(tmp_path, 'scenario = "mixed"', "seeds = {first = 5, count = 7}", "[vary]", '"boat.id" = [1, 2, 3]')
    batches = [list(read(path)[1].batches(4)) for _ in range(2)]
    assert batches[0] == batches[1]
    runs = [run for batch in batches[0] for run in batch.runs]
    assert runs == [(point, seed) for point in range(3) for seed in range(5, 12)]
    assert [batch.number for batch in batches[0]] == list(range(21)), "the end is cut finely, so that no worker rests"
    _, long = read(written(tmp_path, 'scenario = "mixed"', "seeds = {count = 2000}"))
    sizes = [len(batch.runs) for batch in long.batches(4)]
    assert (sizes[0], sizes[-256:], sum(sizes)) == (4, [1] * 256, 2000)
    assert sizes == sorted(sizes, reverse=True)


def test_points_are_every_combination_of_stories_and_values(tmp_path):
    names = [str(ETC / "scenarios" / name) for name in ("navigation-silent.toml", "bus-off.toml")]
    steps = '"simulation.sea.wind_mps" = {from = 0.0, to = 8.0, steps = 3}'
    path = written(tmp_path, f"scenario = {names}", "[vary]", steps, '"log.required" = [true, false]')
    _, plan = read(path)
    assert [story.name for story in plan.stories] == ["navigation-silent", "bus-off"]
    assert len(plan.points) == 2 * 3 * 2
    assert plan.points[3] == (0, {"simulation.sea.wind_mps": 4.0, "log.required": False})


def test_the_payload_program_of_a_scenario_is_beside_that_wherever_the_campaign_runs(tmp_path):
    _, plan = read(written(tmp_path, f'scenario = "{ETC}/scenarios/payload.toml"'))
    assert list(plan.stories[0].scenario["payload"]["uphill"][:2]) == [str(ETC / "payloads/uphill.py"), "--peak"]


def test_each_boat_sails_each_scenario_and_each_mission(tmp_path):
    boats = [str(ETC / name) for name in ("delfimx.toml", "boats/otter.toml")]
    missions = [str(ETC / "missions" / name) for name in ("doca.toml", "lawnmower.toml")]
    path = written(tmp_path, BUS_OFF, f"mission = {missions}", "seeds = {count = 3}")
    path.write_text(path.read_text().replace(f'"{ETC}/delfimx.toml"', str(boats)))
    _, plan = read(path)
    names = ["bus-off", "doca", "lawnmower"]
    assert [(story.boat, story.name) for story in plan.stories] == [(b, n) for b in ("delfimx", "otter") for n in names]
    assert (len(plan.points), plan.runs) == (6, 18)
    assert plan.stories[3].vehicle["boat"]["name"] == "Otter"


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ([], "a scenario, a mission, or both"),
        (['scenario = "mixed"', "[vary]", '"fault.value" = [1.0]'], "mixed has no [[fault]]"),
        ([BUS_OFF, "[vary]", '"fault.kind" = ["bus_off", "leak"]'], "leak"),
        ([BUS_OFF, "[vary]", '"fault.at_s" = [-1.0]'], "at_s"),
        ([BUS_OFF, "[vary]", '"fault.depth" = [1.0]'], "depth"),
        (['scenario = "mixed"', "[vary]", '"control.heading.q" = [1.0]'], "point 0, control.heading.q"),
        (['scenario = "mixed"', "[vary]", '"boat.id" = [1, 999]'], "point 1, boat.id"),
        (['scenario = "mixed"', "[vary]", '"boat.id" = []'], "vary.boat.id"),
        (['scenario = "mixed"', "[draw]", '"boat.id" = {}'], "one of uniform, normal, choice"),
        (['scenario = "mixed"', "[vary]", '"boat.id" = [1]', "[draw]", '"boat.id" = {choice = [1]}'], "varied and drawn"),
        (['scenario = "mixed"', "[vary]", '"thrusters.2.y_m" = [1.0]'], "thrusters.2.y_m: there are 2 of these"),
        (['scenario = "no-such.toml"'], "No such file"),
        (['scenario = "mixed"', "seeds = {count = 0}"], "seeds.count"),
        (
            ['scenario = "mixed"', "[vary]", *(f'"a{i}.b" = {{from=0,to=1,steps=1000}}' for i in range(3))],
            "at most 100000 points",
        ),
    ],
)
def test_what_is_wrong_in_it_is_said_before_the_first_run(tmp_path, lines, words):
    with pytest.raises(ConfigError) as refused:
        read(written(tmp_path, *lines))
    assert words in str(refused.value)


@given(st.integers(0, 10**9), st.integers(1, 300), st.sampled_from(["a.b", "simulation.sea.wind_mps"]))
def test_a_latin_hypercube_meets_each_slice_once(first, count, key):
    plan = plan_of({key: Draw(uniform=(2.0, 4.0))}, Seeds(first, count), latin=True)
    drawn = [plan.values(0, seed)[key] for seed in range(first, first + count)]
    assert sorted(int((value - 2.0) / 2.0 * count * (1 - 1e-12)) for value in drawn) == list(range(count))


@given(st.integers(0, 10**6), st.floats(-10, 10), st.floats(0, 5))
def test_what_is_drawn_depends_on_key_and_seed_alone(seed, mean, deviation):
    draw = {"a.b": Draw(normal=(mean, deviation)), "c.d": Draw(choice=("x", "y")), "e.f": Draw(uniform=(-1.0, 1.0))}
    one, two = plan_of(draw, Seeds(0, 10), latin=False), plan_of(draw | {"g.h": Draw(choice=(1,))}, Seeds(0, 99), latin=False)
    values = one.values(0, seed)
    assert values == {key: two.values(0, seed)[key] for key in values}
    assert values["c.d"] in ("x", "y")
    assert -1.0 <= values["e.f"] <= 1.0
    assert abs(values["a.b"] - mean) <= 8.0 * deviation


def test_values_lie_over_the_vehicles_file_key_by_key():
    tree = tables.read_toml(ETC / "delfimx.toml")
    over = laid(tree, {"simulation.sea.wind_mps": 7.0, "boat.name": "Other"})
    assert over["simulation"]["sea"] == tree["simulation"]["sea"] | {"wind_mps": 7.0}
    assert tables.decode(over, config.Vehicle, "test").boat.name == "Other"
    assert tree["boat"]["name"] == "DelfimX"


def test_a_number_in_a_key_is_a_place_in_a_list():
    tree = tables.read_toml(ETC / "delfimx.toml")
    over = tables.decode(laid(tree, {"thrusters.1.rate_per_s": 0.5, "thrusters.0.thrust_n.1": 400.0}), config.Vehicle, "test")
    assert [row.rate_per_s for row in over.thrusters] == [0.6667, 0.5]
    assert [row.thrust_n[1] for row in over.thrusters] == [400.0, 532.0]
