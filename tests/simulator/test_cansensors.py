"""A boat whose receiver, compass, gyro and batteries are on a DroneCAN bus, in lock step: devices, source, estimator, loop."""

import math
from collections.abc import Callable
from pathlib import Path

import pytest

from delfim import config
from delfim.base.modes import Mode
from delfim.parts.dronecan.table import Dronecan
from delfim.simulator.faults import fault
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.nodes.cansensors import FIRST_NODE, CanSensors
from delfim.simulator.tables import Sea, Simulation
from delfim.simulator.workspace import Workspace, settings_of
from delfim.vehicle import console
from delfim.vehicle.state import NoLog, State

FLOAT = Path(__file__).parents[2] / "etc/boats/float.toml"
BENT = Dronecan(
    compass_deg=40.0, variation_deg=-1.5, hard_iron_ut=(12.0, -20.0, 3.0), soft_iron=(1.1, 0.9, 1.0, 0.05, 0.0, -0.1)
)


def boat(estimator: bool = True, gyro: bool = True, table: Dronecan = BENT) -> Lockstep:
    sea = Sea(current_mps=0.5, current_to_deg=250.0, wind_mps=6.0)
    settings = config.Vehicle(
        boat=config.BoatTable(name="test"),
        navigation=config.NavigationTable(sources=("dronecan",), rate_hz=10.0, estimator=estimator),
        sensors=config.Sensors(names=("dronecan",)),
        sysstat=config.Sysstat(required=()),
        dronecan=table,
        simulation=Simulation(sea=sea, gyro=gyro),
    )
    return Lockstep(settings, 1, lambda clock: NoLog())


def sensors(run: Lockstep) -> CanSensors:
    (found,) = (each for each in run.nodes.beside if isinstance(each, CanSensors))
    return found


def sailing(run: Lockstep) -> Lockstep:
    list(run.cycles(5.0))
    assert run.command(console.Heading(60.0, 1.5)) is None
    list(run.cycles(30.0))
    assert run.state.mode is Mode.HEADING, run.state.reason
    return run


def off_rad(state: State, run: Lockstep) -> float:
    return abs(math.remainder(state.motion.heading_rad - run.nodes.model.heading_rad, math.tau))


@pytest.mark.parametrize(
    ("estimator", "gyro", "within_deg"), [(True, True, 1.5), (False, True, 3.0), (True, False, 6.0)], ids=str
)
def test_a_bent_compass_that_lies_askew_keeps_the_boat_on_its_heading_in_waves(estimator, gyro, within_deg):
    run = sailing(boat(estimator, gyro))
    worst = max(off_rad(state, run) for state in run.cycles(60.0))
    assert math.degrees(worst) < within_deg, "without a gyro it is taken to lie flat, and the boat rolls"
    assert run.state.counts == {}
    said = run.state.navigation
    assert said is not None
    assert (said.fix, said.satellites, said.hdop) == (3, 10, pytest.approx(0.9, abs=1e-3))
    assert (said.roll_rad is None) is not gyro
    if gyro:
        assert said.roll_rad == pytest.approx(run.nodes.model.roll_rad, abs=0.02)
    if estimator:
        assert [each.refused for each in run.state.inputs["dronecan"]] == [0, 0, 0, 0]


def test_the_same_seed_is_the_same_voyage():
    voyages = [[(state.motion, state.actuation) for state in sailing(boat()).cycles(20.0)] for _ in range(2)]
    assert voyages[0] == voyages[1]


def _receiver_freezes(found: CanSensors) -> None:
    found.receiver.frozen = True


def _compass_freezes(found: CanSensors) -> None:
    found.compass.frozen = True


def _receiver_falls_silent(found: CanSensors) -> None:
    found.receiver.silent = True


def _compass_falls_silent(found: CanSensors) -> None:
    found.compass.silent = True


@pytest.mark.parametrize(
    ("happens", "reason", "within_s"),
    [
        (_receiver_freezes, "position frozen for 3.", 3.6),
        (_compass_freezes, "heading frozen for 3.", 3.6),
        (_receiver_falls_silent, "position silent for 1.", 1.5),
        (_compass_falls_silent, "heading silent for 1.", 1.5),
    ],
)
def test_what_breaks_stops_the_boat_and_is_called_by_its_name(happens: Callable[[CanSensors], None], reason, within_s):
    run = sailing(boat())
    happens(sensors(run))
    began_s = run.elapsed_s
    for state in run.cycles(10.0):
        if state.mode is Mode.IDLE:
            break
    assert state.reason.startswith(reason), state.reason
    assert run.elapsed_s - began_s <= within_s


def test_the_batteries_are_those_of_the_first_two_thrusters_and_low_ones_send_the_boat_home():
    run = sailing(boat())
    assert set(run.state.sysstat) == {"batteries_starboard", "batteries_port"}
    run.breaks(fault("battery_sag", "port", 0.2, thrusters=run.faults.thrusters))
    list(run.cycles(10.0))
    assert run.state.mode is Mode.HOLD
    assert "batteries port at 20%" in run.state.reason


def test_no_sensor_has_the_number_of_the_computer():
    run = boat(table=Dronecan(node=FIRST_NODE + 1))
    list(run.cycles(3.0))
    told = run.vehicle.sources[0].report(run.elapsed_s)["devices"]
    assert list(told) == [str(FIRST_NODE + number) for number in (0, 2, 3)]


def test_the_float_has_motors_and_sensors_on_one_simulated_bus(tmp_path):
    vehicle = config.load(FLOAT)
    overrides, *_ = settings_of(vehicle, Workspace(1, tmp_path), ())
    simulated = config.load(FLOAT, tuple(overrides))
    assert simulated.dronecan.interface == f"{simulated.can.interface}-dronecan"
    run = Lockstep(vehicle, 1, lambda clock: NoLog())
    assert {each.interface for each in run.nodes.beside} == {"can1"}
    list(run.cycles(5.0))
    assert run.command(console.Heading(60.0, 0.8)) is None
    list(run.cycles(20.0))
    assert run.state.mode is Mode.HEADING, run.state.reason
    assert set(run.state.thrusters) == {row.name for row in vehicle.thrusters}
    assert run.state.source == "dronecan"
    assert list(run.state.sysstat) == ["batteries_starboard", "batteries_port"]
