"""From what control asks for to the command of every thruster: by forces, by hand, and when either means nothing."""

import math
from typing import cast

import pytest

from delfim.canproxy.socket import CanSocket
from delfim.config import DELFIMX, Steer, ThrusterTable
from delfim.vehicle.control.allocation import thruster
from delfim.vehicle.propulsion import Propulsion
from delfim.vehicle.safe import STOP
from delfim.vehicle.state import Actuation, State, Wanted

OUTBOARD = ThrusterTable(
    name="outboard",
    driver="pwm",
    x_m=-1.9,
    thrust_n=(-300.0, 800.0),
    rate_per_s=10.0,
    steer=Steer(kind="azimuth", angle_max_deg=40.0, rate_dps=400.0),
)
BOW = ThrusterTable(name="bow", driver="pwm", address=1, x_m=1.5, angle_deg=90.0, thrust_n=(-60.0, 60.0), rate_per_s=10.0)
REVERSED = ThrusterTable(name="back", driver="pwm", address=2, y_m=1.0, angle_deg=180.0, thrust_n=(-50.0, 90.0), rate_per_s=9.0)


def sent(rows: tuple[ThrusterTable, ...], wanted: Wanted) -> Actuation:
    """After a second at this command."""
    propulsion = Propulsion((), cast(CanSocket, None), rows, State())
    for step in range(5):
        actuation = propulsion.send(wanted, 10.0 + 0.2 * step)
    return actuation


def moment_nm(rows: tuple[ThrusterTable, ...], told: Actuation) -> float:
    """From first principles."""
    total_nm = 0.0
    for row, part, angle_rad in zip(rows, told.thrust, told.angle_rad, strict=True):
        force_n, to_rad = thruster(row).curve.force(part), math.radians(row.angle_deg) + angle_rad
        total_nm += force_n * (row.x_m * math.sin(to_rad) - row.y_m * math.cos(to_rad))
    return total_nm


def test_forces_become_commands_by_the_curve_of_each_thruster() -> None:
    told = sent(DELFIMX, Wanted(surge_n=532.0))
    assert told.thrust == pytest.approx((math.sqrt(0.5), math.sqrt(0.5)), abs=0.01)
    assert told.run
    told = sent(DELFIMX, Wanted(yaw_nm=300.0))
    assert told.thrust[0] < 0.0 < told.thrust[1], "weaker astern: it turns faster there"
    assert -told.thrust[0] > told.thrust[1]


def test_by_hand_each_side_gets_its_own() -> None:
    assert sent(DELFIMX, Wanted(hand=(0.25, -0.5))).thrust == pytest.approx((0.25, -0.5))
    told = sent((REVERSED, *DELFIMX), Wanted(hand=(0.25, 0.5)))
    assert told.thrust == pytest.approx((-0.25, 0.25, 0.5)), "what is mounted backwards pushes ahead with a command astern"


@pytest.mark.parametrize(("starboard", "port"), [(0.2, 0.8), (0.8, 0.2), (-0.3, 0.3)])
def test_by_hand_every_boat_turns_to_the_side_of_less_thrust(starboard: float, port: float) -> None:
    for rows in (DELFIMX, (OUTBOARD, BOW)):
        told = sent(rows, Wanted(hand=(starboard, port)))
        assert math.copysign(1.0, moment_nm(rows, told)) == math.copysign(1.0, port - starboard)
    assert told.thrust == pytest.approx((0.5 * (starboard + port), 0.5 * (port - starboard)))
    assert math.degrees(told.angle_rad[0]) == pytest.approx(40.0 * 0.5 * (starboard - port))


@pytest.mark.parametrize("wanted", [STOP, Wanted(math.nan), Wanted(yaw_nm=math.nan), Wanted(hand=(math.nan, 0.0))])
def test_what_means_nothing_is_a_stop(wanted: Wanted) -> None:
    told = sent(DELFIMX, wanted)
    assert (told.thrust, told.run) == ((0.0, 0.0), False)


def test_what_the_thrusters_are_short_of_is_told_until_they_are_not() -> None:
    propulsion = Propulsion((), cast(CanSocket, None), DELFIMX, State())
    propulsion.send(Wanted(surge_n=2000.0), 1.0)
    assert propulsion.short is not None
    assert propulsion.short[0] == pytest.approx(936.0, abs=5.0)
    for wanted in (Wanted(100.0), Wanted(hand=(0.1, 0.1)), STOP):
        propulsion.send(wanted, 1.2)
        assert propulsion.short is None
