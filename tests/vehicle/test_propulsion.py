"""From what control asks for to the command of every thruster: by forces, by hand, and when either means nothing."""

import math
from typing import cast

import pytest

from delfim.base.errors import Refused
from delfim.canproxy.dsor.messages import RESET, pack_reset
from delfim.canproxy.socket import CanSocket
from delfim.config import DELFIMX, Steer, ThrusterTable
from delfim.vehicle.control.allocation import thruster
from delfim.vehicle.control.safe import STOP
from delfim.vehicle.links import LoopInput
from delfim.vehicle.propulsion.propulsion import Propulsion, by_hand
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


def test_in_a_trial_each_thruster_gets_its_own() -> None:
    told = sent(DELFIMX, Wanted(parts=(0.25, -0.5)))
    assert (told.thrust, told.run) == (pytest.approx((0.25, -0.5)), True)
    told = sent((BOW, OUTBOARD), Wanted(parts=(0.25, 0.5, -0.5)))
    assert told.thrust == pytest.approx((0.25, 0.5))
    assert tuple(map(math.degrees, told.angle_rad)) == pytest.approx((0.0, -20.0)), "what turns has its angle behind all parts"


@pytest.mark.parametrize("parts", [(0.25, 0.5), (0.25, 0.5, -0.5, 0.1)])
def test_in_a_trial_no_part_is_left_out_and_none_is_over(parts: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="zip"):
        sent((BOW, OUTBOARD), Wanted(parts=parts))


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


class Driver:
    """An actuator that does not take two of its frames each time, and nodes that do not take any."""

    name = "driver"
    period_s: float | None = None
    inputs: tuple[LoopInput, ...] = ()

    def __init__(self, unsent: int = 2) -> None:
        self.unsent, self.sent, self.cut = unsent, list[tuple[Actuation, float]](), list[tuple[str, ...]]()

    def send(self, sent: Actuation, now_s: float) -> int:
        self.sent.append((sent, now_s))
        return self.unsent

    def repeat(self, now_s: float) -> int:
        return self.unsent

    def stop(self) -> None:
        """Nothing turns."""

    def disconnect(self, names: tuple[str, ...]) -> None:
        self.cut.append(names)

    def report(self) -> dict[str, object]:
        return {}

    def send_many(self, frames: tuple[tuple[int, bytes], ...]) -> int:
        assert frames == ((RESET, pack_reset(4)),)
        return self.unsent


FULL = Wanted(hand=(1.0, 1.0))
RATE = DELFIMX[0].rate_per_s


@pytest.mark.parametrize(
    ("after_s", "thrust"), [(-5.0, 0.0), (0.0, 0.0), (0.3, 0.3 * RATE), (1.0, RATE), (1.1, RATE), (60.0, RATE), (math.nan, 0.0)]
)
def test_thrust_grows_with_the_time_since_the_last_command_but_for_a_second_at_most(after_s: float, thrust: float) -> None:
    propulsion = Propulsion((), cast(CanSocket, None), DELFIMX, State())
    propulsion.send(STOP, 100.0)
    assert propulsion.send(FULL, 100.0 + after_s).thrust == pytest.approx((thrust, thrust))


def test_what_a_driver_does_not_take_is_counted_and_what_it_takes_is_not() -> None:
    rough, state = Driver(), State()
    propulsion = Propulsion((rough, Driver(0)), cast(CanSocket, None), DELFIMX, state)
    sent = propulsion.send(FULL, 0.3)
    assert (state.counts["propulsion_unsent"], propulsion.sent_s) == (2, 0.3)
    assert propulsion.again(0.9) == sent
    assert (state.counts["propulsion_unsent"], propulsion.sent_s) == (4, 0.9)
    assert rough.sent == [(sent, 0.3), (sent, 0.9)]
    propulsion.repeat(rough, 1.0)
    assert state.counts["propulsion_unsent"] == 6
    assert propulsion.send(FULL, 1.2).thrust == pytest.approx((0.6 * RATE, 0.6 * RATE)), "0.3 s after the last one"
    smooth = Propulsion((Driver(0),), cast(CanSocket, None), DELFIMX, calm := State())
    smooth.send(FULL, 0.3)
    smooth.again(0.9)
    smooth.repeat(Driver(0), 1.0)
    assert "propulsion_unsent" not in calm.counts


def test_a_thruster_alone_takes_the_thrust_of_starboard() -> None:
    propulsion = Propulsion((), cast(CanSocket, None), DELFIMX, State())
    propulsion.alone(1)
    assert propulsion.send(Wanted(hand=(0.25, -0.5)), 1.0).thrust == (0.0, 0.25)
    turning = Propulsion((), cast(CanSocket, None), (OUTBOARD, BOW), State())
    turning.alone(0)
    assert turning.send(Wanted(hand=(0.25, -0.5)), 1.0) == ((0.25, 0.0), (0.0, 0.0), True), "it does not turn"
    propulsion.alone(None)
    propulsion.send(STOP, 2.0)
    assert propulsion.send(Wanted(hand=(0.25, -0.5)), 3.0).thrust == (0.25, -0.5)


def test_a_boat_goes_on_from_the_command_of_the_one_that_it_follows() -> None:
    first, second = (Propulsion((), cast(CanSocket, None), DELFIMX, State()) for _ in range(2))
    sent = first.send(Wanted(surge_n=100.0), 1.0)
    second.follow(first)
    assert second.again(1.1) == sent


def test_without_a_side_the_boat_cannot_be_steered_and_says_why() -> None:
    propulsion = Propulsion((), cast(CanSocket, None), DELFIMX, State())
    assert propulsion.drop(()) == ""
    assert propulsion.drop(("port",)) == propulsion.allocation.steerable() != ""
    told = propulsion.send(Wanted(surge_n=200.0), 1.0).thrust
    assert told[1] == 0.0
    assert propulsion.drop(()) == ""
    propulsion.send(STOP, 2.0)
    assert min(propulsion.send(Wanted(surge_n=200.0), 3.0).thrust) > 0.0


def test_a_reset_that_the_bus_does_not_take_is_refused_and_all_drivers_disconnect() -> None:
    drivers = Driver(), Driver()
    propulsion = Propulsion(drivers, cast(CanSocket, Driver()), DELFIMX, State())
    with pytest.raises(Refused, match="reset refused: the CAN bus did not take the frame"):
        propulsion.reset(4)
    Propulsion(drivers, cast(CanSocket, Driver(0)), DELFIMX, State()).reset(4)
    propulsion.disconnect(("port",))
    assert [driver.cut for driver in drivers] == [[("port",)]] * 2


@pytest.mark.parametrize(
    ("x_m", "y_m", "angle_deg", "turns_deg", "expected"),
    [
        (0.0, 0.5, 0.0, None, (1.0, 0.0, 0.0)),
        (0.0, -0.5, 0.0, None, (0.0, 1.0, 0.0)),
        (0.0, 0.1, 0.0, None, (1.0, 0.0, 0.0)),
        (0.0, -0.1, 0.0, None, (0.0, 1.0, 0.0)),
        (0.0, 0.09, 0.0, None, (0.5, 0.5, 0.0)),
        (0.0, -0.09, 0.0, None, (0.5, 0.5, 0.0)),
        (0.0, 0.5, 180.0, None, (-1.0, 0.0, 0.0)),
        (0.0, 0.0, 180.0, None, (-0.5, -0.5, 0.0)),
        (0.0, 0.5, 60.0, None, (1.0, 0.0, 0.0)),  # still ahead
        (0.0, -0.5, -60.0, None, (0.0, 1.0, 0.0)),
        (1.5, 0.5, 61.0, None, (-0.5, 0.5, 0.0)),
        (1.5, 0.0, 90.0, None, (-0.5, 0.5, 0.0)),  # at the bow, to starboard: more port thrust turns it so
        (-1.5, 0.0, 90.0, None, (0.5, -0.5, 0.0)),
        (-1.5, 0.0, -90.0, None, (-0.5, 0.5, 0.0)),
        (0.1, -1.5, 80.0, None, (-0.5, 0.5, 0.0)),  # the little that it pushes ahead turns the boat, too
        (-0.1, 1.5, 80.0, None, (0.5, -0.5, 0.0)),
        (-0.1, -1.5, 80.0, None, (-0.5, 0.5, 0.0)),
        (0.5, 1.03, 61.0, None, (0.5, -0.5, 0.0)),
        (-1.9, 0.0, 0.0, 40.0, (0.5, 0.5, -40.0)),
        (1.9, 0.0, 0.0, 40.0, (0.5, 0.5, 40.0)),
        (1.9, 0.0, 0.0, 180.0, (0.5, 0.5, 90.0)),
        (1.9, 0.0, 180.0, 40.0, (-0.5, -0.5, -40.0)),
        (0.5, 1.5, 90.0, 40.0, (-0.5, 0.5, 40.0)),
        (0.5, -1.5, 90.0, 40.0, (-0.5, 0.5, -40.0)),
    ],
)
def test_by_hand_a_thruster_takes_the_part_of_its_place(x_m, y_m, angle_deg, turns_deg, expected):
    steer = None if turns_deg is None else Steer(kind="azimuth", angle_max_deg=turns_deg, rate_dps=90.0)
    row = ThrusterTable(
        name="one", driver="pwm", x_m=x_m, y_m=y_m, angle_deg=angle_deg, thrust_n=(-50.0, 90.0), rate_per_s=9.0, steer=steer
    )
    of_starboard, of_port, angle_rad = by_hand(thruster(row))
    assert (of_starboard, of_port, math.degrees(angle_rad)) == pytest.approx(expected)
