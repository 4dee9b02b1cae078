"""Turns to a new heading by way of a reference that the boat can follow, and gains that grow with the way."""

import math
from pathlib import Path

import msgspec
import pytest

from delfim.base.geodesy import wrap
from delfim.base.modes import Mode
from delfim.config import Vehicle, load
from delfim.simulator.invariants.onlooker import Onlooker
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.measured import model_of
from delfim.simulator.tables import Sea, Simulation
from delfim.vehicle import console
from delfim.vehicle.control import control
from delfim.vehicle.control.autopilot import entered, steer
from delfim.vehicle.control.memory import Memory, settings_of
from delfim.vehicle.control.turning import follow
from delfim.vehicle.state import Motion, NoLog, Setpoint
from tests.adoption.hulls import HERON
from tests.vehicle.closed_loop import ALL, DT_S, Boat, heading_step

FILE = Path(__file__).parents[2] / "etc/boats/heron.toml"
GAINS = (
    "p_nm_per_rad=8.0",
    "p_limit_nm=8.0",
    "d_nm_per_radps=9.0",
    "i_nm_per_rad_s=0.8",
    "i_limit_nm=6.0",
    "turn_nm_per_radps=7.0",
)
TURN = "ahead_per_mps=0.3", "turn_dps=20.0", "turn_dps2=20.0"


def heron(*heading: str, wind_mps: float = 0.0) -> Vehicle:
    """The Heron as a fit found her, with motors that are late by a quarter of a second, and these heading keys."""
    hull = (f"simulation.hull.{name}={value}" for name, value in HERON.items())
    file = load(FILE, [*hull, "boat.inertia_kgm2=9.0", *(f"control.heading.{each}" for each in (*GAINS, *heading))])
    rows = tuple(msgspec.structs.replace(row, delay_s=0.25, lag_s=0.15) for row in file.thrusters)
    there = msgspec.structs.replace(file.of(Simulation), sea=Sea(wind_mps=wind_mps, wind_from_deg=250.0))
    return msgspec.structs.replace(file, thrusters=rows, simulation=there)


def sailed(vehicle: Vehicle, degrees: float, speed_mps: float) -> tuple[float, float]:
    over_deg, settled_s, _ = heading_step(Boat(vehicle=vehicle, model=model_of(vehicle, 1)), degrees, speed_mps)
    return over_deg, settled_s


@pytest.mark.parametrize("speed_mps", [0.0, 0.6, 1.3])
@pytest.mark.parametrize("degrees", [20.0, 90.0, 180.0])
def test_a_turn_ends_where_it_should(degrees: float, speed_mps: float) -> None:
    over_deg, settled_s = sailed(heron(*TURN), degrees, speed_mps)
    assert over_deg < 4.0
    assert settled_s < (14.0 if degrees > 90.0 else 10.0)


def test_it_ends_nearer_to_the_new_heading_than_one_without_a_reference() -> None:
    by_reference, at_once = (sailed(heron(*keys, wind_mps=4.0), 90.0, 1.3)[0] for keys in (TURN, ()))
    assert by_reference < 0.5 * at_once


def test_she_turns_no_faster_than_the_file_says() -> None:
    vehicle = heron(*TURN)
    boat = Boat(vehicle=vehicle, model=model_of(vehicle, 1), noise=0.0)
    rates = [
        abs(math.degrees(each.truth.yaw_rate_radps))
        for each in boat.sail(Mode.HEADING, Setpoint(heading_rad=2.0, speed_mps=1.2), 20.0)
    ]
    assert 17.0 < max(rates) < 24.0


def test_a_boat_that_is_turned_away_begins_anew_from_there() -> None:
    """As after a hold that is continued: the reference of before is half a circle away."""
    settings = settings_of(heron(*TURN))
    memory = Memory(heading_rad=0.0)
    motion = Motion(ALL, 0.0, 0.0, 3.0, 0.0, 0.0, 0.0)
    after, wanted = follow(memory, motion, 0.0, 1.0, settings, DT_S)
    assert after.heading_rad is not None
    assert abs(wrap(after.heading_rad - 3.0)) < 0.1
    assert wanted.yaw_nm < 0.0


def test_the_reference_waits_for_a_boat_that_does_not_follow() -> None:
    settings, motion = settings_of(heron(*TURN)), Motion(ALL, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    memory = Memory(entered(motion))
    for _ in range(100):
        memory, _ = follow(memory, motion, 3.0, 1.0, settings, DT_S)
    assert memory.heading_rad is not None
    assert 0.3 < memory.heading_rad < 0.7


@pytest.mark.parametrize("dt_s", [0.0, 1e-3, 1.0])
def test_any_time_between_two_steps_will_do(dt_s: float) -> None:
    settings, motion = settings_of(heron(*TURN)), Motion(ALL, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    memory = control.enter(Mode.HEADING, motion, Setpoint(heading_rad=1.0, speed_mps=1.0), settings)
    for _ in range(50):
        memory, reference, wanted = control.control(
            Mode.HEADING, memory, motion, Setpoint(heading_rad=1.0, speed_mps=1.0), settings, dt_s
        )
        assert not reference.reason
        assert math.isfinite(wanted.yaw_nm)
    _, reference, wanted = control.control(
        Mode.HEADING, memory, motion, Setpoint(heading_rad=math.inf, speed_mps=1.0), settings, dt_s
    )
    assert reference.reason == "set point makes no sense"
    assert not wanted.run


def test_gains_grow_with_the_way_ahead() -> None:
    settings = settings_of(heron(*TURN))

    def yaw_nm(ahead_mps: float) -> float:
        motion = Motion(ALL, 0.0, 0.0, 0.0, 0.0, ahead_mps, 0.0)
        return steer(entered(motion), motion, 0.1, ahead_mps, settings, DT_S)[1].yaw_nm

    assert yaw_nm(1.0) == pytest.approx(1.3 * yaw_nm(0.0), rel=0.05)
    assert yaw_nm(-1.0) == yaw_nm(0.0)


def test_both_bounds_of_a_turn_or_none() -> None:
    with pytest.raises(Exception, match="turn_dps and turn_dps2 bound a turn together: give both, or none"):
        heron("turn_dps=20.0")


def test_the_rules_of_every_boat_hold_for_one_whose_gains_grow() -> None:
    run = Lockstep(heron(*TURN, wind_mps=3.0), 1, lambda clock: NoLog())
    for _ in run.cycles(4.0):
        pass
    onlooker = Onlooker(run)
    for order in (console.Heading(80.0, 1.2), console.SetMode("hold"), console.Course(200.0, 1.2), console.Heading(20.0, 0.5)):
        assert onlooker.order(order, "") is None
        for _ in run.cycles(15.0):
            onlooker.look()
    assert onlooker.failures == []
