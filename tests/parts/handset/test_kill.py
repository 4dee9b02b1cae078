"""The kill by a pin, by a console, and while the relay cuts the thrusters' power. A socket plays the pin."""

import pytest

from delfim import config
from delfim.base.modes import Mode
from delfim.parts.handset.killswitch import KillSwitch
from delfim.vehicle import console
from tests.test_gpio import Pin

SETTINGS = config.KillTable(chip="/dev/gpiochip0", line="KILL")
PRESSED = "kill: kill switch: pressed, or its wire is open"


@pytest.fixture
def pin():
    pin = Pin()
    yield pin
    pin.close()


@pytest.fixture
def sailing(boat, pin):
    """A boat with a kill switch, which is closed, in heading mode."""
    boat.hands = (KillSwitch(SETTINGS, pin.line),)
    boat.ready()
    assert boat.vehicle.on_command(console.Heading(90.0, 1.5), "console 7") is None
    boat.pass_time(2.0)
    assert boat.state.mode is Mode.HEADING
    return boat


def test_a_pin_that_opens_kills_at_once_and_the_kill_outlasts_it(sailing, pin):
    sailing.heard()
    pin.becomes(True)
    sailing.attend()
    assert (sailing.state.mode, sailing.state.reason) == (Mode.IDLE, PRESSED)
    starboard, port = sailing.propellers()
    assert (starboard.rpm, port.rpm) == (0, 0)
    refused = sailing.vehicle.on_command(console.Clear(), "console 7")
    assert refused == "clear refused: kill switch still says kill; release it first"
    pin.becomes(False)
    sailing.pass_time(5.0)
    assert sailing.vehicle.on_command(console.Heading(90.0), "console 7") == f"heading refused: {PRESSED}"
    assert sailing.vehicle.on_command(console.Arm(), "console 7") == f"arm refused: {PRESSED}"
    assert sailing.vehicle.on_command(console.Clear(), "console 7") is None
    assert sailing.vehicle.on_command(console.Heading(90.0), "console 7") is None


def test_a_short_touch_kills(sailing, pin):
    pin.becomes(True)
    pin.becomes(False)
    sailing.attend()
    assert sailing.state.reason == PRESSED
    assert not sailing.state.killed.held


def test_a_short_touch_kills_once(sailing, pin):
    pin.becomes(True)
    pin.becomes(False)
    sailing.attend()
    assert sailing.vehicle.on_command(console.Clear(), "console 7") is None
    sailing.attend()
    assert not sailing.state.killed.reason


def test_a_pin_that_was_open_before_anybody_listened_kills(boat, pin):
    pin.is_high = True
    boat.hands = (KillSwitch(SETTINGS, pin.line),)
    boat.ready()
    boat.attend()
    assert boat.state.reason == PRESSED


def test_a_pin_that_cannot_be_read_kills(sailing, pin):
    pin.far.close()
    sailing.attend()
    assert sailing.state.reason == "kill: kill switch: it cannot be read: hung up"
    assert sailing.vehicle.on_command(console.Clear()) == "clear refused: kill switch still says kill; release it first"


def test_a_switch_that_kills_at_low(boat, pin):
    pin.is_high = True
    boat.hands = (KillSwitch(config.KillTable(chip="/dev/gpiochip0", line="KILL", kills_at="low"), pin.line),)
    boat.ready()
    boat.attend()
    assert not boat.state.killed.reason
    pin.becomes(False)
    boat.attend()
    assert boat.state.reason == PRESSED


def test_the_first_reason_of_a_kill_stays_and_every_switch_is_to_be_released(sailing, pin):
    assert sailing.vehicle.on_command(console.Kill(), "console 7") is None
    pin.becomes(True)
    sailing.attend()
    assert sailing.state.reason == "kill: operator: commanded"
    assert sailing.vehicle.on_command(console.Clear(), "console 7") is not None
    pin.becomes(False)
    sailing.attend()
    assert sailing.vehicle.on_command(console.Clear(), "console 7") is None


def test_a_stop_leaves_the_kill_and_its_reason(sailing):
    sailing.vehicle.on_command(console.Kill(), "console 7")
    sailing.vehicle.on_command(console.Stop(), "console 7")
    assert sailing.state.reason == "kill: operator: commanded"
    assert [line.reason for line in sailing.vehicle.helm.checks() if not line.ok] == ["kill: operator: commanded"]


def test_what_is_not_killed_is_not_cleared(boat):
    assert boat.vehicle.on_command(console.Clear()) == "clear refused: the boat is not killed"


def test_thrusters_without_power_are_the_kill_and_no_fault(sailing, pin):
    """A relay in series with the thrusters opens with the same switch: their nodes are silent from then on."""
    pin.becomes(True)
    for _ in range(80):
        sailing.clock.advance(0.1)
        sailing.navigate()
        sailing.report(silent=("propeller_starboard", "propeller_port"))
        sailing.attend()
        sailing.vehicle.on_watchdog()
    assert [(n.name, n.reason) for n in sailing.state.notices] == [("kill", f"{PRESSED}; the thrusters have no power")]


def test_one_silent_thruster_of_two_is_a_fault_though_the_boat_is_killed(sailing, pin):
    pin.becomes(True)
    for _ in range(80):
        sailing.clock.advance(0.1)
        sailing.navigate()
        sailing.report(silent=("propeller_port",))
        sailing.attend()
        sailing.vehicle.on_watchdog()
    assert {n.name for n in sailing.state.notices} == {"kill", "sensor_bad"}


@pytest.mark.parametrize("volts", [0.4, None])
def test_thrusters_that_still_speak_without_voltage_have_no_power(sailing, pin, volts):
    pin.becomes(True)
    sailing.attend()
    now_s = sailing.clock.monotonic_s()
    for name, report in sailing.state.thrusters.items():
        sailing.state.thrusters[name] = report._replace(heard_s=now_s, voltage_v=volts)
    sailing.vehicle.on_watchdog()
    assert sailing.state.notices[0].reason == PRESSED + ("; the thrusters have no power" if volts else "")


def test_a_switch_needs_its_chip_and_its_line():
    with pytest.raises(ValueError, match="both its chip and its line"):
        config.KillTable(line="KILL")
