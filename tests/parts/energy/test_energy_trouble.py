"""When the way home is a trouble, and in which words."""

import pytest

from delfim import config
from delfim.base.parts import OWN
from delfim.parts.energy.table import EnergyTable
from delfim.parts.energy.troubles import energy
from delfim.vehicle.failsafe.checks import checks
from delfim.vehicle.failsafe.failsafe import Rules
from delfim.vehicle.failsafe.troubles import NUMBERS, Inputs, Look
from delfim.vehicle.report import Check, EnergyFacts
from delfim.vehicle.state import State

SETTINGS = config.Vehicle(boat=config.BoatTable(name="test"), energy=EnergyTable(capacity_wh=1000.0))  # type: ignore[call-arg]


def told(left_wh: float | None, home_wh: float | None, *, was: bool = False, no_way: bool = False) -> str | None:
    facts = EnergyFacts(
        left_wh=left_wh, home_wh=home_wh, reserve_wh=150.0, current_mps=2.4, current_deg=80.0, no_way_home=no_way
    )
    present = (NUMBERS["energy"],) if was else ()
    return energy(Look(SETTINGS, State(energy=facts), Inputs("", None), present, 0.0))


@pytest.mark.parametrize(
    ("left_wh", "home_wh", "was", "is_there"),
    [
        (400.0, 249.0, False, False),
        (400.0, 250.0, False, True),
        (400.0, 231.0, True, True),  # it stays until a fiftieth of the capacity more is there
        (400.0, 229.0, True, False),
        (None, 900.0, False, False),
        (400.0, None, False, False),
    ],
)
def test_it_is_a_trouble_when_the_way_home_takes_all_but_the_reserve(
    left_wh: float | None, home_wh: float | None, was: bool, is_there: bool
) -> None:
    assert (told(left_wh, home_wh, was=was) is not None) == is_there


def test_its_words_have_the_figures() -> None:
    assert told(392.0, 250.0) == "home takes 250 Wh of the 392 Wh left, and 150 Wh are the reserve"
    assert told(392.0, None, no_way=True) == "no way home: the water runs at 2.4 m/s towards 80 degrees"


def test_what_is_not_known_of_the_way_home_is_kept_beside_the_reserve() -> None:
    facts = EnergyFacts(left_wh=400.0, home_wh=240.0, doubt_wh=11.0, reserve_wh=150.0)
    words = energy(Look(SETTINGS, State(energy=facts), Inputs("", None), (), 0.0))
    assert words == "home takes 240 to 251 Wh of the 400 Wh left, and 150 Wh are the reserve"


def test_a_boat_that_reckons_nothing_has_no_trouble() -> None:
    assert energy(Look(SETTINGS, State(), Inputs("", None), (), 0.0)) is None
    assert OWN["energy"].keys == ("energy.capacity_wh",)


@pytest.mark.parametrize(
    ("facts", "line"),
    [
        (None, None),
        (EnergyFacts(why="no battery tells its charge"), Check("energy", False, "no battery tells its charge")),
        (EnergyFacts(left_wh=400.0, reserve_wh=150.0), Check("energy", True, "400 Wh left")),
        (EnergyFacts(left_wh=150.0, reserve_wh=150.0), Check("energy", True, "150 Wh left")),
        (EnergyFacts(left_wh=140.0, reserve_wh=150.0), Check("energy", False, "140 Wh left, and 150 Wh are the reserve")),
        (
            EnergyFacts(left_wh=400.0, plan_wh=250.0, reserve_wh=150.0),
            Check("energy", True, "400 Wh left; the mission takes 250 Wh with the way home, and 150 Wh are the reserve"),
        ),
        (
            EnergyFacts(left_wh=400.0, plan_wh=251.0, reserve_wh=150.0),
            Check("energy", False, "400 Wh left; the mission takes 251 Wh with the way home, and 150 Wh are the reserve"),
        ),
    ],
)
def test_the_line_of_the_checks_says_whether_it_is_enough(facts: EnergyFacts | None, line: Check | None) -> None:
    lines = checks(Rules(SETTINGS), State(energy=facts), Inputs("", None), 0.0, 0)
    assert next((each for each in lines if each.name == "energy"), None) == line
