"""Heading and speed: the bounds of step responses that docs/control.md states, and the rules of saturation."""

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.geodesy import wrap
from delfim.base.modes import Mode
from delfim.config import load
from delfim.simulator.model import Model, hull_of
from delfim.simulator.tables import Sea
from delfim.vehicle.control.allocation import Allocation, thruster
from delfim.vehicle.control.autopilot import clamp, entered, steer
from delfim.vehicle.control.memory import Integrals, Memory, lacking
from delfim.vehicle.state import Motion, Setpoint
from tests.vehicle.closed_loop import ALL, DELFIMX, DT_S, SETTINGS, Boat, heading_step

BOATS = Path(__file__).parents[2] / "etc/boats"

THRUSTERS = Allocation([thruster(row) for row in DELFIMX.thrusters])
AT_REST = Motion(ALL, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(("degrees", "within_s"), [(20.0, 6.0), (90.0, 10.0), (180.0, 14.0)])
@pytest.mark.parametrize("speed_mps", [0.0, 1.5, 2.2])
def test_a_heading_step_settles_without_overshoot(degrees: float, within_s: float, speed_mps: float) -> None:
    over_deg, settled_s, steady = heading_step(Boat(), degrees, speed_mps)
    assert over_deg < 2.5
    assert settled_s < within_s
    assert steady.rms < 0.3


@pytest.mark.parametrize("name", ["heron", "otter"])
def test_a_short_boat_turns_without_going_far_over(name: str) -> None:
    """Its hull damps a turn less than control guesses."""
    vehicle = load(BOATS / f"{name}.toml")
    model = Model(hull_of(vehicle), Sea(), 1, 0.675, -0.161, 0.0, vehicle.thrusters)
    assert heading_step(Boat(vehicle=vehicle, model=model), 90.0, 1.5)[0] < 6.0


def test_wind_abeam_costs_a_few_degrees_not_the_heading() -> None:
    over_deg, settled_s, steady = heading_step(Boat(sea=Sea(wind_mps=8.0, wind_from_deg=0.0)), 90.0, 1.5)
    assert over_deg < 4.0
    assert settled_s < 15.0
    assert steady.rms < 2.0


def test_a_boat_without_a_rate_of_turn_still_holds_its_heading() -> None:
    _, settled_s, steady = heading_step(Boat(rate_sensor=False), 90.0, 1.5)
    assert settled_s < 20.0
    assert steady.rms < 0.5


@pytest.mark.parametrize("to_deg", [0.0, 90.0, 180.0])
def test_speed_over_ground_is_kept_in_current(to_deg: float) -> None:
    boat = Boat(sea=Sea(current_mps=0.5, current_to_deg=to_deg))
    speeds = [x.truth.north_mps for x in boat.sail(Mode.HEADING, Setpoint(speed_mps=1.5), 60.0)]
    assert max(speeds) < 1.9  # a following current is felt before the integral has answered it
    assert all(abs(speed - 1.5) < 0.1 for speed in speeds[150:])


def test_without_velocity_the_surge_is_the_drag() -> None:
    motion = AT_REST._replace(has=frozenset({"heading"}), north_mps=9.0)
    integrals = entered(AT_REST)
    for _ in range(50):
        integrals, wanted = steer(integrals, motion._replace(north_mps=0.0), 0.0, 1.0, SETTINGS, DT_S)
    assert wanted.surge_n == pytest.approx(SETTINGS.hull.drag_n_per_mps + SETTINGS.hull.drag_n_per_mps2)
    assert integrals.surge_n == 0.0


@given(
    st.floats(-math.pi, math.pi),
    st.floats(-1.0, 1.0),
    st.floats(-2.5, 2.5),
    st.floats(-math.pi, math.pi),
    st.floats(-3.0, 3.0),
    st.builds(Integrals, st.floats(-150.0, 150.0), st.floats(-400.0, 400.0), st.floats(-2.2, 2.2)),
)
def test_the_yaw_moment_does_not_depend_on_the_speed(heading_rad, yaw_radps, surge_mps, asked_rad, asked_mps, was):
    """And the thrusters keep as much of it as they can: the forces of both propellers differ by it."""
    north_mps, east_mps = surge_mps * math.cos(heading_rad), surge_mps * math.sin(heading_rad)
    motion = Motion(ALL, 0.0, 0.0, heading_rad, yaw_radps, north_mps, east_mps)
    _, moving = steer(was, motion, asked_rad, asked_mps, SETTINGS, DT_S)
    _, still = steer(was, motion._replace(has=frozenset({"heading"})), asked_rad, 0.0, SETTINGS, DT_S)
    assert moving.yaw_nm == still.yaw_nm
    forces, _, _ = THRUSTERS.allocate(*moving[:3], (0.0, 0.0), DT_S)
    given_nm = DELFIMX.thrusters[0].y_m * (forces[1] - forces[0])
    kept_nm = clamp(moving.yaw_nm, -THRUSTERS.yaw_nm, THRUSTERS.yaw_nm)
    assert given_nm == pytest.approx(kept_nm, abs=0.02 * THRUSTERS.yaw_nm)


@given(st.floats(-math.pi, math.pi), st.floats(0.0, 2.2), st.floats(-1.0, 3.0))
def test_an_order_ahead_never_asks_for_surge_astern(error_rad: float, asked_mps: float, surge_mps: float) -> None:
    motion = AT_REST._replace(north_mps=surge_mps)
    assert steer(Integrals(speed_mps=asked_mps), motion, error_rad, asked_mps, SETTINGS, DT_S)[1].surge_n >= 0.0
    assert steer(Integrals(speed_mps=-asked_mps), motion, error_rad, -asked_mps - 0.1, SETTINGS, DT_S)[1].surge_n <= 0.0


def test_the_boat_turns_first() -> None:
    _, wanted = steer(Integrals(speed_mps=1.5), AT_REST, math.pi / 2.0 + 0.1, 1.5, SETTINGS, DT_S)
    assert wanted.surge_n == 0.0
    assert wanted.yaw_nm == SETTINGS.gains.p_limit_nm


@pytest.mark.parametrize(("heading_deg", "asked_deg"), [(179.0, -179.0), (-179.0, 179.0), (1.0, 359.0), (350.0, 730.0)])
def test_the_short_way_round(heading_deg: float, asked_deg: float) -> None:
    motion = AT_REST._replace(heading_rad=math.radians(heading_deg))
    _, wanted = steer(Integrals(), motion, math.radians(asked_deg), 0.0, SETTINGS, DT_S)
    error_rad = wrap(math.radians(asked_deg - heading_deg))
    assert abs(error_rad) < 0.5
    assert math.copysign(1.0, wanted.yaw_nm) == math.copysign(1.0, error_rad)


def test_integrals_do_not_wind_up() -> None:
    """Of a boat that is held fast. An error that is being turned away adds nothing, either."""
    integrals = Integrals()
    for _ in range(5000):
        integrals, _ = steer(integrals, AT_REST, 0.3, 2.2, SETTINGS, DT_S)
    assert abs(integrals.yaw_nm) == SETTINGS.gains.i_limit_nm
    assert abs(integrals.surge_n) == SETTINGS.gains.i_limit_n
    turning = Integrals()
    for _ in range(500):
        turning, _ = steer(turning, AT_REST._replace(yaw_rate_radps=0.2), 2.0, 1.5, SETTINGS, DT_S)
    assert (turning.yaw_nm, turning.surge_n) == (0.0, 0.0)


def test_what_the_thrusters_cannot_give_stops_the_integral_that_asked_for_it() -> None:
    """The other one goes on, and each comes back from where it is."""
    held = Memory(Integrals(20.0, 100.0, 1.5))
    for short, yaw_waits, surge_waits in (
        ((0.0, 0.0, 5.0), True, False),
        ((5.0, 0.0, 0.0), False, True),
        ((-5.0, 0.0, -5.0), False, False),
    ):
        after, _ = steer(lacking(held, short).integrals, AT_REST, 0.1, 1.5, SETTINGS, DT_S)
        assert (after.yaw_nm == 20.0, after.surge_n == 100.0) == (yaw_waits, surge_waits)
        assert (after.yaw_short_nm, after.surge_short_n) == (0.0, 0.0)


def test_a_boat_that_cannot_keep_up_does_not_wind_up_its_speed() -> None:
    """Against a current that is faster than the boat, through the thrusters that run at their limit."""
    boat = Boat(sea=Sea(current_mps=3.5, current_to_deg=180.0))
    pushes = [boat.memory.integrals.surge_n for _ in boat.sail(Mode.HEADING, Setpoint(speed_mps=2.2), 120.0)]
    assert pushes[-1] == pytest.approx(pushes[50], abs=1.0)
    assert pushes[-1] < 0.95 * SETTINGS.gains.i_limit_n


def test_entering_at_speed_changes_no_revolutions_by_a_jump() -> None:
    """From hold or heading at 1.5 m/s into a mode that asks for the same: within 10 % of the steady revolutions at once."""
    boat = Boat(noise=0.0)
    steady = [x.sent.thrust[1] for x in boat.sail(Mode.HEADING, Setpoint(speed_mps=1.5), 90.0)][-1]
    first = next(iter(boat.sail(Mode.HEADING, Setpoint(speed_mps=1.5), 1.0))).sent.thrust[1]
    assert first == pytest.approx(steady, rel=0.1)
