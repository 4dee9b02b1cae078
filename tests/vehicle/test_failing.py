"""A thruster that fails drops out and the rest carry on, as long as the boat can be steered; then the failsafe stops it."""

from typing import cast

import msgspec
import pytest

from delfim import config
from delfim.base.modes import Mode
from delfim.canproxy.socket import CanSocket
from delfim.vehicle.failsafe.failing import Failing
from delfim.vehicle.failsafe.failsafe import NO_TROUBLE, Action, Rules, Verdict, failsafe
from delfim.vehicle.failsafe.troubles import Inputs, Trigger
from delfim.vehicle.propulsion.propulsion import Propulsion
from delfim.vehicle.state import State, StateLog, ThrusterReport, Wanted
from tests.vehicle.closed_loop import DELFIMX

PLACES = ((-1.0, 0.5, -45.0), (-1.0, -0.5, 45.0), (1.0, 0.5, 45.0), (1.0, -0.5, -45.0))
FLOAT = tuple(
    config.ThrusterTable(
        name=f"m{i}",
        driver="vesc",
        address=i,
        x_m=x,
        y_m=y,
        angle_deg=a,
        thrust_n=(-40.0, 51.0),
        rpm_max=1000.0,
        rate_per_s=9.0,
    )
    for i, (x, y, a) in enumerate(PLACES)
)


class Notes:
    """A log that keeps the events."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        self.notes.append(text)


class Afloat:
    """The thrusters of a boat under way, each of which turns as told, except the dead."""

    def __init__(self, rows: tuple[config.ThrusterTable, ...]) -> None:
        self.settings = msgspec.structs.replace(DELFIMX, thrusters=rows, sysstat=config.Sysstat(required=()))
        self.state, self.log, self.now_s = State(mode=Mode.PLAY, mode_s=0.0, armed=True), Notes(), 100.0
        self.propulsion = Propulsion((), cast(CanSocket, None), rows, self.state)
        self.failing = Failing(self.settings, self.state, self.propulsion, cast(StateLog, self.log))
        self.rules, self.memory, self.dead = Rules(self.settings), NO_TROUBLE, set[str]()
        self.wanted = Wanted(40.0, 0.0, 10.0)

    def sail(self, seconds: float) -> Verdict:
        for _ in range(round(10.0 * seconds)):
            self.now_s += 0.1
            self.state.actuation = sent = self.propulsion.send(self.wanted, self.now_s)
            for row, part in zip(self.settings.thrusters, sent.thrust, strict=True):
                rpm = 0.0 if row.name in self.dead else part * self.settings.rpm_max(row)
                self.state.thrusters[row.name] = ThrusterReport(self.now_s, rpm=rpm)
            self.state.navigation_s = self.state.changed_s = self.state.console_s = self.now_s
            inputs = Inputs("", None, self.failing.look(self.now_s))
            verdict = failsafe(self.rules, self.memory, self.state, inputs, self.now_s)
            self.memory = verdict.memory
        return verdict

    def trouble(self, verdict: Verdict) -> tuple[str, str]:
        """(action, reason) of the trouble."""
        return next(((n.action, n.reason) for n in verdict.notices if n.name == Trigger.THRUSTER.name.lower()), ("", ""))


def test_three_of_four_carry_on_with_the_same_forces() -> None:
    boat = Afloat(FLOAT)
    boat.wanted = Wanted(60.0, 0.0, 0.0)
    boat.sail(2.0)
    assert boat.propulsion.short is None
    boat.dead = {"m1"}
    assert boat.trouble(boat.sail(3.5)) == ("", "")
    action, reason = boat.trouble(boat.sail(1.0))
    assert (action, reason.partition(" turns 0 instead of ")[0]) == ("warn", "m1 propeller")
    assert boat.state.actuation.thrust[1] == 0.0
    assert boat.propulsion.short is None or max(map(abs, boat.propulsion.short)) < 0.5
    assert boat.log.notes == ["m1 dropped out: the others carry on"]
    assert boat.trouble(boat.sail(60.0))[0] == "warn", "it stays out, and is still told"
    assert boat.log.notes == ["m1 dropped out: the others carry on"]


def test_a_boat_that_cannot_be_steered_any_more_stops_and_says_why() -> None:
    boat = Afloat(FLOAT)
    boat.wanted = Wanted(60.0, 0.0, 0.0)
    boat.sail(2.0)
    boat.dead = {"m0"}
    assert boat.sail(5.0).action is Action.WARN
    boat.dead = {"m0", "m2", "m3"}
    verdict = boat.sail(6.0)
    assert verdict.action is Action.STOP
    assert verdict.reason.endswith(": the boat cannot turn to both sides while it goes ahead")
    assert "m2 propeller turns 0" in verdict.reason


@pytest.mark.parametrize("side", ["starboard", "port"])
def test_one_of_two_propellers_does_not_steer_a_boat(side: str) -> None:
    boat = Afloat(DELFIMX.thrusters)
    boat.wanted = Wanted(600.0, 0.0, 0.0)
    boat.sail(4.0)
    boat.dead = {side}
    assert boat.sail(3.8).action is Action.NONE
    verdict = boat.sail(0.4)
    assert verdict.action is Action.STOP
    assert verdict.reason.startswith(f"{side} propeller turns 0 instead of ")
    assert verdict.reason.endswith(": the boat cannot turn to both sides while it goes ahead")


def test_an_idle_boat_begins_anew_with_all_its_thrusters() -> None:
    boat = Afloat(FLOAT)
    boat.wanted = Wanted(60.0, 0.0, 0.0)
    boat.dead = {"m1"}
    boat.sail(6.0)
    assert set(boat.state.failed) == {"m1"}
    boat.state.mode, boat.wanted, boat.dead = Mode.IDLE, Wanted(run=False), set()
    boat.sail(0.2)
    assert (boat.state.failed, boat.state.unsteerable) == ({}, "")
    boat.state.mode, boat.wanted = Mode.PLAY, Wanted(60.0, 0.0, 0.0)
    boat.sail(5.0)
    assert boat.state.actuation.thrust[1] > 0.5


def test_a_motor_that_is_switched_off_has_its_time_and_orders_to_go_do_not_give_it_anew() -> None:
    boat = Afloat(DELFIMX.thrusters)

    def look(rpm: float, seconds: float = 0.1) -> tuple[str, ...]:
        """What is overdue at the last of these looks."""
        for _ in range(round(10.0 * seconds)):
            boat.now_s += 0.1
            run = boat.state.mode is not Mode.IDLE
            boat.state.actuation = boat.propulsion.send(Wanted(0.0, 0.0, 0.0, run), boat.now_s)
            boat.state.thrusters["port"] = ThrusterReport(boat.now_s, rpm=rpm)
            boat.failing.look(boat.now_s)
        return boat.state.overdue

    def order(mode: Mode) -> None:
        boat.state.mode, boat.state.off_s = mode, boat.now_s if mode is Mode.IDLE else boat.state.off_s

    assert look(900.0, 9.0) == (), "by its mode it goes, and was never switched off"
    order(Mode.IDLE)
    assert look(900.0, 3.9) == ()
    assert look(900.0, 0.2) == ("port",)
    assert look(0.0) == (), "at rest"
    assert look(900.0, 3.9) == (), "and again: the time is its own"
    order(Mode.PLAY)
    assert look(900.0, 0.3) == ("port",), "whatever is ordered"
    assert look(100.0) == look(900.0, 9.0) == (), "it did as commanded once: it obeys, until it is switched off"
    for _ in range(41):  # it stops and goes again before each look
        order(Mode.IDLE)
        order(Mode.PLAY)
        told = look(900.0)
    assert told == ("port",)
    towed = msgspec.structs.replace(boat.settings, failsafe=config.Failsafe(thruster=config.ThrusterAstray(disconnect=False)))
    boat.failing = Failing(towed, boat.state, boat.propulsion, cast(StateLog, boat.log))
    order(Mode.IDLE)
    assert look(900.0, 9.0) == ()
