"""Values that payload programs tell for the trouble `beyond`: who may, which are kept, and what is refused."""

from pathlib import Path

import pytest

from delfim import config
from delfim.base.errors import ConfigError, FormatError
from delfim.base.modes import Mode
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.state import NoLog

ROOT = Path(__file__).parents[2]
BOUND = 'failsafe.beyond={above={"bilge.leak"=0.5}, action="stop"}'
BILGE = 'payload.bilge={command=["/bin/true"], may=["values"]}'
EYE = 'payload.eye={command=["/bin/true"], may=["obstacles"]}'


@pytest.fixture
def sea():
    run = Lockstep(config.load(ROOT / "etc/delfimx.toml", (BOUND, BILGE, EYE)), 1, lambda clock: NoLog())
    for _ in run.cycles(5.0):
        pass
    yield run
    run.close()


def tells(sea: Lockstep, program: str = "bilge", **values: float) -> str | None:
    return sea.vehicle.on_command(console.Tell(values), f"payload:{program}")


def test_a_leak_that_is_told_stops_the_boat_and_one_that_is_silent_is_forgotten(sea) -> None:
    assert sea.command(console.Heading(90.0, 1.0)) is None
    assert tells(sea, leak=0.0) is None
    for _ in sea.cycles(3.0):
        assert sea.state.mode is Mode.HEADING
    for _ in range(3):
        assert tells(sea, leak=1.0) is None
        for _ in sea.cycles(1.0):
            pass
    assert sea.state.mode is Mode.IDLE
    assert sea.state.reason == "bilge.leak is 1, above 0.5"
    for _ in sea.cycles(sea.settings.sensors.stale_s + sea.settings.failsafe.clear_s + 1.0):
        pass
    assert "beyond" not in [notice.name for notice in sea.state.notices]


def test_only_values_with_a_bound_are_kept_and_only_of_those_who_may(sea) -> None:
    before = dict(sea.state.measured)
    assert tells(sea, smoke=1.0) == "refused: failsafe.beyond has no bound for bilge.smoke"
    assert "values is not among the rights of eye" in (tells(sea, "eye", leak=1.0) or "")
    assert "only a payload program says this" in (sea.command(console.Tell({"leak": 1.0})) or "")
    assert sea.state.measured == before
    assert sea.settings.helmsmen == (), "who may tell values alone never has the boat"


@pytest.mark.parametrize("values", ["{}", '{"leak": NaN}', '{"leak": "yes"}', '{"leak": 1e999}', "[1]"])
def test_what_is_no_number_with_a_name_is_refused(values) -> None:
    with pytest.raises(FormatError, match="not understood"):
        console.parse(f'{{"command": "tell", "values": {values}}}'.encode())


def test_a_bound_for_a_program_without_the_right_is_refused() -> None:
    with pytest.raises(ConfigError, match='no program of this name has the right "values"'):
        Lockstep(config.load(ROOT / "etc/delfimx.toml", (BOUND, EYE)), 1, lambda clock: NoLog())
    with pytest.raises(ConfigError, match=r"no sensor of sensors\.names measures water_c"):
        Lockstep(config.load(ROOT / "etc/delfimx.toml", ("failsafe.beyond.above={water_c=1.0}",)), 1, lambda clock: NoLog())
