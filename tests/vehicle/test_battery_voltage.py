"""Batteries that tell no charge: their voltage, as motor controllers tell it, is a trouble below the limits of the file."""

import math

import msgspec
import pytest

from delfim import config
from delfim.base.modes import Mode
from delfim.canproxy.dsor.messages import BatteriesStatus, Fault, Status
from delfim.vehicle import console
from delfim.vehicle.failsafe.failsafe import NO_TROUBLE, Action, Rules
from delfim.vehicle.failsafe.failsafe import failsafe as judged
from delfim.vehicle.failsafe.troubles import Inputs, Look, Trigger, battery_critical, battery_low
from delfim.vehicle.state import State, ThrusterReport
from tests.vehicle.test_checks import lines
from tests.vehicle.test_drivers import settings as motors

LIMITS = config.Failsafe(battery_low=config.BatteryLow(voltage_v=22.2), battery_critical=config.BatteryCritical(voltage_v=20.4))
BOAT = msgspec.structs.replace(motors("vesc"), failsafe=LIMITS)
NOW_S = 100.0


def told(starboard_v: float | None, port_v: float | None = 25.0, age_s: float = 0.0) -> State:
    reports = {"starboard": starboard_v, "port": port_v}
    return State(thrusters={name: ThrusterReport(NOW_S - age_s, voltage_v=volts) for name, volts in reports.items()})


def look(state: State, *present: Trigger, file: config.Vehicle = BOAT) -> Look:
    return Look(file, state, Inputs("", None), present, NOW_S)


@pytest.mark.parametrize(
    ("state", "low", "critical"),
    [
        (told(22.3), None, None),
        (told(22.2), "starboard thruster at 22.2 V", None),
        (told(25.0, 20.4), "port thruster at 20.4 V", "port thruster at 20.4 V"),
        (told(0.3), None, None),  # its power is switched off: that is no battery's voltage
        (told(None, None), None, None),
        (told(19.0, age_s=60.0), None, None),
        (told(math.nan), None, None),
    ],
    ids=["enough", "low", "critical", "off", "unknown", "old", "no number"],
)
def test_the_lowest_voltage_is_low_or_critical(state, low, critical):
    assert (battery_low(look(state)), battery_critical(look(state))) == (low, critical)


def test_a_battery_without_a_charge_counts_by_its_voltage():
    state = State(sysstat={"batteries_port": (BatteriesStatus(Status.GOOD, Fault(0), 21.9, None, None, None), NOW_S)})
    assert battery_low(look(state)) == "batteries port at 21.9 V"


def test_a_voltage_is_not_looked_at_before_the_file_says_so():
    file = msgspec.structs.replace(BOAT, failsafe=config.Failsafe())
    assert battery_low(look(told(6.0), file=file)) is None


def test_a_low_battery_stays_low_until_its_voltage_is_well_above():
    assert battery_low(look(told(23.0), Trigger.BATTERY_LOW)) == "starboard thruster at 23.0 V"
    assert battery_low(look(told(23.4), Trigger.BATTERY_LOW)) is None


def test_the_boat_goes_home_and_then_stops_and_no_short_pull_of_the_motors_does_it():
    rules, memory = Rules(BOAT), NO_TROUBLE
    state = told(22.0)
    state.mode, state.navigation_s = Mode.HEADING, NOW_S
    actions = []
    for later_s in (0.0, 4.0, 5.1):
        now_s = NOW_S + later_s
        state.navigation_s = state.console_s = now_s
        state.thrusters = {name: report._replace(heard_s=now_s) for name, report in state.thrusters.items()}
        verdict = judged(rules, memory, state, Inputs("", None), now_s)
        memory = verdict.memory
        actions.append(any(notice.name == "battery_low" for notice in verdict.notices))
    assert actions == [False, False, True]
    assert rules.actions[Trigger.BATTERY_LOW][Mode.HEADING] is Action.HOME


def test_the_check_shows_the_voltage_and_refuses_a_boat_that_has_none_left(make_boat):
    boat = make_boat(failsafe=config.Failsafe(battery_critical=config.BatteryCritical(voltage_v=20.4)))
    boat.ready()
    unknown = BatteriesStatus(Status.GOOD, Fault(0), 48.0, None, None, None)
    boat.state.sysstat |= dict.fromkeys(("batteries_port", "batteries_starboard"), (unknown, boat.clock.monotonic_s()))
    boat.state.thrusters = {"port": ThrusterReport(boat.clock.monotonic_s(), voltage_v=24.1)}
    assert lines(boat)["battery"] == (True, "port thruster at 24.1 V")
    boat.state.thrusters = {"port": ThrusterReport(boat.clock.monotonic_s(), voltage_v=20.0)}
    assert lines(boat)["battery"] == (False, "port thruster at 20.0 V")
    assert boat.vehicle.on_command(console.Heading(0.0)) == "heading refused: port thruster at 20.0 V"
