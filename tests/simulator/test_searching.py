"""Runs that search: they aim at pairs of things that happen at once, and meet none that is held to be impossible."""

from pathlib import Path

import pytest

from delfim import config
from delfim.simulator.scenarios import pairs
from delfim.simulator.scenarios.pairs import ALL, IMPOSSIBLE, PAIRS, THINGS, PairTape
from delfim.simulator.scenarios.random_faults import mixed_mission, sail_mixed
from delfim.simulator.scenarios.scenario import settings_of
from delfim.simulator.scenarios.searching import AIMS, searching
from delfim.simulator.scenarios.trial import sail
from delfim.vehicle.console import KINDS

ETC = Path(__file__).parents[2] / "etc"
VEHICLE = ETC / "delfimx.toml"


def met(seed: int) -> set[tuple[str, str]]:
    """The pairs that a run meets; it has no failure."""
    here, tape = config.load(VEHICLE), PairTape()
    scenario = searching(seed, here)
    settings = settings_of(scenario, VEHICLE)
    result = sail(scenario, settings, seed, mixed_mission(here.simulation), look=lambda run, place: tape.look(run))
    assert not result.failures
    return {ALL[place] for place in tape.met}


def test_runs_meet_what_they_aim_at_and_nothing_that_is_held_to_be_impossible():
    found = {seed: met(seed) for seed in range(10)}
    assert all(pairs.possible(*pair) for each in found.values() for pair in each)
    assert sum(AIMS[seed] in each for seed, each in found.items()) >= 6
    assert len(set().union(*found.values())) > 150


def test_a_run_is_repeated_by_its_seed_and_the_list_is_gone_through():
    here = config.load(VEHICLE)
    assert searching(7, here) == searching(7, here) != searching(7 + len(AIMS), here)
    assert searching(7, here).name == f"searching for {AIMS[7][0]} with {AIMS[7][1]}, seed 7"
    assert sorted(AIMS) == sorted(PAIRS)


@pytest.mark.parametrize("boat", sorted(ETC.glob("boats/*.toml")), ids=lambda boat: boat.stem)
def test_other_boats_search_with_the_parts_that_they_have(boat):
    assert not sail_mixed(boat, 1, (), searching).failures


@pytest.mark.parametrize("never", IMPOSSIBLE, ids=lambda never: never.why)
def test_what_is_impossible_is_named_as_it_is_elsewhere(never):
    assert never.these | never.those <= {*THINGS}
    assert any(not pairs.possible(one, other) for one in never.these for other in never.those)


def test_each_order_of_a_console_is_looked_for_or_left_out_by_name():
    assert {thing.split()[1] for thing in pairs.ORDERS} | {*pairs.NO_ORDERS} == {*KINDS}
    assert {*pairs.OBEYED_ALWAYS} <= {*KINDS}
