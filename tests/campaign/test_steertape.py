"""What is measured of steering, in each mode, against a boat whose motion is given."""

import math
from types import SimpleNamespace
from typing import Any, cast

import pytest

from delfim.base.modes import Mode
from delfim.campaign.steering import Deviation, SteerTape
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle.control.modes.path import APPROACH
from delfim.vehicle.state import Arc, Line, Plan, Reference, Setpoint, State, Waypoint

NORTH = Line(0.0, 0.0, 100.0, 0.0, 1.5)


class Played:
    """A run of which the test says everything."""

    def __init__(self, mode: Mode, setpoint: Setpoint | None = None, reference: Reference | None = None) -> None:
        self.state = State(mode=mode, mode_s=0.0, setpoint=setpoint or Setpoint(), reference=reference or Reference())
        self.nodes = SimpleNamespace(model=SimpleNamespace(heading_rad=0.0, north_mps=1.0, east_mps=0.0))
        self.vehicle = SimpleNamespace(helm=SimpleNamespace(memory=SimpleNamespace(leg=0)))
        self.tape = SteerTape(cast(Lockstep, self))

    def look(self, at_s: float, north_m: float = 0.0, east_m: float = 0.0, **model: Any) -> None:
        vars(self.nodes.model).update(model)
        self.tape.look(at_s, (north_m, east_m))


def test_of_a_spread_without_values_nothing_is_known() -> None:
    spread = Deviation()
    assert (spread.rms, spread.most) == (None, None)
    for value in (3.0, -4.0):
        spread.add(value)
    assert (spread.rms, spread.most) == (pytest.approx(math.sqrt(12.5)), 4.0)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_turn_is_measured_by_its_overshoot_its_time_and_what_is_left(side: float) -> None:
    boat = Played(Mode.HEADING, Setpoint(heading_rad=side * math.pi / 2.0))
    for at_s, heading_deg in (
        (5.0, 0.0),
        (8.0, 85.0),
        (9.0, 97.0),
        (10.0, 88.0),
        (20.0, 89.0),
        (30.0, 96.0),
        (64.0, 91.0),
        (65.0, 91.0),
        (66.0, 88.0),
    ):
        boat.look(at_s, heading_rad=side * math.radians(heading_deg))
    tape = boat.tape
    assert (tape.over_deg, tape.settled_s) == (pytest.approx(7.0), 4.0), "5 % of 90 degrees are 4.5"
    assert (tape.steady_deg.rms, tape.steady_deg.most) == (pytest.approx(math.sqrt(2.5)), pytest.approx(2.0))


def test_half_a_turn_may_go_either_way_and_the_last_order_counts() -> None:
    boat = Played(Mode.HEADING, Setpoint(heading_rad=math.pi))
    for at_s, heading_deg in enumerate((1.0, -20.0, -100.0, -179.0, 178.0)):
        boat.look(float(at_s), heading_rad=math.radians(heading_deg))
    assert boat.tape.over_deg == pytest.approx(2.0)
    boat.state.setpoint = Setpoint(heading_rad=math.radians(170.0))
    boat.look(5.0, heading_rad=math.radians(178.0))
    assert (boat.tape.over_deg, boat.tape.settled_s) == (0.0, None)
    boat.look(15.0)
    assert boat.tape.settled_s is None, "it is still eight degrees off"


def test_a_course_is_that_over_ground() -> None:
    boat = Played(Mode.COURSE, Setpoint(heading_rad=0.0))
    boat.look(0.0)
    boat.look(70.0, heading_rad=1.0, north_mps=1.0, east_mps=math.tan(math.radians(3.0)))
    assert boat.tape.steady_deg.most == pytest.approx(3.0)


def test_a_hold_counts_from_a_minute_after_it_began_and_the_last_one_counts() -> None:
    boat = Played(Mode.HOLD, reference=Reference(0.1, 0.0, None, 0.0, 10.0, 0.0))
    boat.look(59.0, 90.0, 0.0)
    assert (boat.tape.held_m.most, boat.tape.resting) == (None, None)
    boat.look(60.0, 13.0, 4.0)
    boat.state.actuation = boat.state.actuation._replace(thrust=(0.2, 0.0))
    boat.look(61.0, 10.0, 1.0)
    assert (boat.tape.held_m.most, boat.tape.resting) == (5.0, 0.5)
    assert boat.tape.turned_deg.most == pytest.approx(math.degrees(0.1))
    boat.state.mode_s = 70.0
    boat.look(71.0, 90.0, 0.0)
    assert boat.tape.held_m.most is None


def test_lines_and_arcs_of_a_path_count_twenty_seconds_after_it_is_joined() -> None:
    boat = Played(Mode.PATH, Setpoint(plan=Plan("", (), (NORTH, Arc(100.0, 20.0, 20.0, -math.pi / 2.0, math.pi, 1.5)))))
    boat.vehicle.helm.memory.leg = APPROACH
    boat.look(30.0, 0.0, 50.0)
    boat.vehicle.helm.memory.leg = 0
    boat.look(49.0, 20.0, 9.0)
    assert boat.tape.lines_m.most is None
    boat.look(51.0, 50.0, -2.0)
    boat.vehicle.helm.memory.leg = 1
    boat.look(60.0, 123.0, 20.0)
    assert (boat.tape.lines_m.most, boat.tape.arcs_m.most) == (pytest.approx(2.0), pytest.approx(3.0))


def test_the_waypoint_that_was_missed_most_is_told() -> None:
    places = Waypoint(10.0, 0.0, 1.0, 3.0), Waypoint(20.0, 0.0, 1.0, 3.0)
    boat = Played(Mode.PLAY, Setpoint(plan=Plan("", places, ())))
    boat.look(1.0, 6.0, 0.0)
    assert boat.tape.missed_m is None, "it is still on its way"
    boat.state.reference = Reference(leg=1)
    boat.look(2.0, 6.5, 0.0)
    assert boat.tape.missed_m == 0.5
    boat.look(3.0, 9.0, 0.0)
    boat.look(4.0, 18.5, 0.0)
    assert boat.tape.missed_m == -2.0
    boat.state.mode, boat.state.mode_s, boat.state.reason = Mode.HOLD, 4.2, "play done"
    boat.look(4.2, 18.5, 0.0)
    assert boat.tape.missed_m == -1.5


def test_the_way_home_is_measured_against_the_true_track() -> None:
    boat = Played(Mode.HEADING)
    for metre in range(200):
        boat.look(metre, min(metre, 100), max(metre - 100, 0))
    boat.state.mode, boat.state.mode_s = Mode.HOME, 200.0
    for metre in range(199, -1, -1):
        boat.look(400.0 - metre, min(metre, 100) - 1.0 * (metre > 110), max(metre - 100, 0) + 2.0 * (metre < 90))
    assert boat.tape.home_m.count == 200
    assert boat.tape.home_m.most == pytest.approx(2.0)
