"""Shallow water: when it is a trouble, that an unknown depth is none and may be required, and the way back along the track."""

import math

import pytest

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.errors import ConfigError
from delfim.base.modes import Mode
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.lockstepbus import LockstepBus
from delfim.simulator.model import Bank
from delfim.vehicle import console, sensors
from delfim.vehicle.failsafe.checks import refusal
from delfim.vehicle.failsafe.troubles import Inputs, Look, sensor_bad, shallow
from delfim.vehicle.links import Links
from delfim.vehicle.plans.track import back
from delfim.vehicle.state import NoLog, State

LEGS = ((0.0, 0.0), (5.0, 0.0), (10.0, 0.0), (10.0, 5.0), (10.0, 10.0))


def settings(names: tuple[str, ...] = ("sysstat", "nmea2000"), least_m: float = 1.0, **more: object) -> config.Vehicle:
    return config.Vehicle(
        boat=config.BoatTable(name="test"),
        sensors=config.Sensors(names=names, **more),  # type: ignore[arg-type]
        sysstat=config.Sysstat(required=()),
        failsafe=config.Failsafe(shallow=config.Shallow(min_depth_m=least_m)),
    )


def look(state: State, file: config.Vehicle, now_s: float = 100.0) -> Look:
    return Look(file, state, Inputs("", None), (), now_s)


@pytest.mark.parametrize(
    ("depth_m", "age_s", "words"),
    [
        (0.9, 0.0, "shallow: 0.9 m of water"),
        (0.9, 5.1, None),
        (1.1, 0.0, None),
        (math.nan, 0.0, None),
        (0.0, 4.0, "shallow: 0.0 m of water"),
    ],
)
def test_less_water_than_the_boat_needs_is_a_trouble_and_an_old_depth_is_none(depth_m, age_s, words) -> None:
    state = State(measured={"depth_m": (depth_m, 100.0 - age_s)})
    assert shallow(look(state, settings())) == words
    assert shallow(look(state, settings(least_m=0.0))) is None, "not watched"


def test_a_required_value_that_is_silent_is_as_bad_as_a_silent_node() -> None:
    file, state = settings(required=("depth_m",)), State()
    assert sensor_bad(look(state, file)) == "depth_m not heard yet"
    state.measured["depth_m"] = 4.0, 96.0
    assert sensor_bad(look(state, file)) is None
    assert sensor_bad(look(state, file, 101.5)) == "depth_m silent for 5.5 s"
    assert sensor_bad(look(state, settings(), 101.5)) is None, "it is not required"


def test_the_check_before_the_start_names_the_silent_value() -> None:
    run = Lockstep(settings(required=("depth_m",)), 1, lambda clock: NoLog())
    run.cycle()
    helm = run.vehicle.helm
    assert {line.name: line.ok for line in helm.checks()}["sensors"]
    run.state.measured = {}
    line = next(line for line in helm.checks() if line.name == "sensors")
    assert (line.ok, line.reason) == (False, "depth_m not heard yet")
    assert refusal(helm.rules, Mode.MANUAL, [line], is_at_sea=False) == line.reason
    assert refusal(helm.rules, Mode.MANUAL, [line], is_at_sea=True) == line.reason, "the table stops a boat for it, too"


@pytest.mark.parametrize(
    ("file", "key"),
    [
        (settings(("sysstat",)), "failsafe.shallow.min_depth_m"),
        (settings(("sysstat",), least_m=0.0, required=("depth_m",)), "sensors.required"),
        (settings(required=("depth",)), "sensors.required"),
    ],
)
def test_a_file_that_relies_on_a_value_that_nobody_measures_is_refused(file, key) -> None:
    bus = LockstepBus(ManualClock())
    with pytest.raises(ConfigError, match="measures depth") as refused:
        sensors.open_sensors(file, Links(lambda name, filters: bus.bound(*filters), lambda *port: None))  # type: ignore[arg-type,return-value]
    assert refused.value.key == key


@pytest.mark.parametrize(("far_m", "kept"), [(0.0, 5), (1.0, 4), (5.0, 4), (5.1, 3), (12.0, 2), (20.0, 1), (99.0, 1)])
def test_the_way_back_ends_so_far_back_along_the_track(far_m, kept) -> None:
    assert back(LEGS, far_m) == LEGS[:kept]
    assert back((), far_m) == ()


def sailing() -> Lockstep:
    """Under way to the east, on a straight track of more than a hundred metres."""
    run = Lockstep(settings(), 1, lambda clock: NoLog())
    for _ in run.cycles(3.0):
        pass
    assert run.command(console.Heading(90.0, 1.5)) is None
    for _ in run.cycles(80.0):
        pass
    return run


def test_a_boat_goes_back_until_the_water_is_deep_enough_and_no_further() -> None:
    """A bank that follows it for a while: back_m at a time."""
    run = sailing()
    model = run.nodes.model
    deep_m = model.east_m - 45.0
    for _ in run.cycles(150.0):
        model.bank = Bank(model.north_m, model.east_m, 0.5) if model.east_m > deep_m else None
        assert run.state.mode in (Mode.HEADING, Mode.HOLD)
    assert run.state.mode is Mode.HOLD
    assert deep_m - 25.0 < model.east_m < deep_m
    assert not run.state.notices


def test_a_boat_that_only_began_goes_back_to_the_beginning_of_its_track() -> None:
    run = Lockstep(settings(), 1, lambda clock: NoLog())
    for _ in run.cycles(3.0):
        pass
    assert run.command(console.Heading(90.0, 1.5)) is None
    for _ in run.cycles(60.0):
        run.nodes.model.bank = Bank(run.nodes.model.north_m, run.nodes.model.east_m, 0.5)
    assert run.state.mode is Mode.HOLD
    assert math.hypot(run.nodes.model.north_m, run.nodes.model.east_m) < 8.0
