"""Values that payload programs tell for the trouble `beyond`: who may, which are kept, and what is refused."""

from pathlib import Path

import pytest

from delfim import config
from delfim.base.errors import ConfigError, FormatError
from delfim.base.modes import Mode
from delfim.parts.mavlink.telemetry import TelemetryView, floats
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
    assert tells(sea, smoke=1.0) == "refused: neither failsafe.beyond nor payload.bilge.shown names smoke"
    assert "values is not among the rights of eye" in (tells(sea, "eye", leak=1.0) or "")
    assert "only a payload program says this" in (sea.command(console.Tell({"leak": 1.0})) or "")
    assert sea.state.measured == before
    assert sea.settings.helmsmen == (), "who may tell values alone never has the boat"


def test_values_that_the_file_shows_are_told_to_consoles_and_a_sensors_comes_first() -> None:
    probe = 'payload.probe={command=["/bin/true"], may=["values"], shown=["water_c", "depth_m"]}'
    words = probe, 'nmea2000.interface="canloop:values"', 'sensors.names=["sysstat", "nmea2000"]'
    run = Lockstep(config.load(ROOT / "etc/delfimx.toml", words), 1, lambda clock: NoLog())
    for _ in run.cycles(2.0):
        pass
    assert run.vehicle.on_command(console.Tell({"water_c": 18.5, "depth_m": 3.0}), "payload:probe") is None
    now_s = run.state.measured["probe.water_c"][1]
    run.state.measured["depth_m"] = 7.0, now_s
    view = TelemetryView(run.vehicle, run.settings.mavlink, 0, lambda leg: 0, lambda kind: None, now_s, 0)
    told = {each.name: each.value for each in floats(view)}
    assert (told["water_c"], told["depth_m"]) == (18.5, 7.0)
    run.close()


@pytest.mark.parametrize("shown", [("Water",), ("water_celsius",), ("OWNER",), ("",)])
def test_what_may_not_be_shown(shown: tuple[str, ...]) -> None:
    with pytest.raises(ConfigError):
        config.load(ROOT / "etc/delfimx.toml", (f'payload.a={{command=["/bin/true"], may=["values"], shown={list(shown)}}}',))


def test_who_shows_values_may_tell_them() -> None:
    with pytest.raises(ConfigError, match='needs the right "values"'):
        config.load(ROOT / "etc/delfimx.toml", ('payload.a={command=["/bin/true"], shown=["water_c"]}',))


def test_an_operator_stops_a_program_and_starts_it_again_but_not_under_a_kill(sea) -> None:
    assert sea.command(console.PartOrder("stop_bilge")) is None
    assert sea.state.resting == {"bilge"}
    assert sea.command(console.Kill()) is None
    assert "kill" in (sea.command(console.PartOrder("start_bilge")) or "")
    assert sea.command(console.PartOrder("stop_eye")) is None, "what may turn something is stopped at any time"
    assert sea.command(console.Clear()) is None
    assert sea.command(console.PartOrder("start_bilge")) is None
    assert sea.state.resting == {"eye"}
    assert "there is no order" in (sea.command(console.PartOrder("stop_nobody")) or "")


@pytest.mark.parametrize("values", ["{}", '{"leak": NaN}', '{"leak": "yes"}', '{"leak": 1e999}', "[1]"])
def test_what_is_no_number_with_a_name_is_refused(values) -> None:
    with pytest.raises(FormatError, match="not understood"):
        console.parse(f'{{"command": "tell", "values": {values}}}'.encode())


def test_a_bound_for_a_program_without_the_right_is_refused() -> None:
    with pytest.raises(ConfigError, match='no program of this name has the right "values"'):
        Lockstep(config.load(ROOT / "etc/delfimx.toml", (BOUND, EYE)), 1, lambda clock: NoLog())
    with pytest.raises(ConfigError, match=r"no sensor of sensors\.names measures water_c"):
        Lockstep(config.load(ROOT / "etc/delfimx.toml", ("failsafe.beyond.above={water_c=1.0}",)), 1, lambda clock: NoLog())
