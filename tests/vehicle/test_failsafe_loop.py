"""The failsafe in the loop: what the propellers are told, and that only the operator starts anything again."""

import math
from pathlib import Path

import pytest

from delfim import config
from delfim.base.frames import Frame
from delfim.base.modes import Mode
from delfim.canproxy.dsor import messages
from delfim.canproxy.dsor.messages import Fault, Node, PropellerStatus, Status
from delfim.simulator.faults import fault
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.failsafe import failing, troubles
from delfim.vehicle.state import NoLog

VEHICLE = Path(__file__).parents[2] / "etc/delfimx.toml"
NORTH_8_M = math.radians(38.6925) + 8.0 / 6_360_000


def test_navigation_that_comes_back_resumes_nothing(boat):
    boat.ready()
    boat.vehicle.on_command(console.Heading(0.0, 1.0))
    boat.pass_time(1.5, navigation=False)
    assert boat.state.mode is Mode.IDLE
    boat.heard()
    boat.pass_time(5.0)
    assert boat.state.mode is Mode.IDLE
    assert not boat.propellers()[0].run
    assert boat.vehicle.on_command(console.Heading(0.0, 1.0)) is None


def test_a_joystick_that_stays_pushed_does_not_take_the_boat_back(make_boat):
    boat = make_boat(sysstat=config.Sysstat(required=("gps",)))
    boat.ready()
    boat.vehicle.on_command(console.Manual(0.5, 0.5))
    boat.clock.advance(0.2)
    boat.send(messages.pack_gps_status(messages.GpsStatus(Status.BAD, Fault.NO_SIGNAL, 0, 0, None, 0)), Node.GPS, 2)
    boat.vehicle.on_sensor(boat.sensor)
    boat.vehicle.on_watchdog()
    assert boat.state.reason == "gps bad: no signal"
    boat.report()
    for _ in range(50):
        boat.clock.advance(0.1)
        boat.navigate()
        refused = boat.vehicle.on_command(console.Manual(0.5, 0.5))
        assert refused == "manual refused: gps bad: no signal; release the joystick for 1 s or choose a mode"
    boat.pass_time(1.2)
    assert boat.vehicle.on_command(console.Manual(0.5, 0.5)) is None


def test_manual_mode_by_name_begins_without_thrust(boat):
    boat.ready()
    boat.vehicle.on_command(console.Manual(1.0, 1.0))
    boat.vehicle.on_command(console.Stop())
    boat.pass_time(5.0)
    assert boat.vehicle.on_command(console.SetMode("manual")) is None
    boat.pass_time(1.0)
    assert boat.state.mode is Mode.MANUAL
    assert boat.propellers()[0].rpm == 0


@pytest.mark.parametrize(("turns", "mode"), [(True, Mode.IDLE), (False, Mode.HOLD)])
def test_navigation_that_freezes_in_hold_stops_the_boat_where_its_propellers_turn(turns: bool, mode: Mode) -> None:
    """A current sets it out of the radius, again and again. At rest nothing in the messages says that they are old."""
    current = "simulation.sea.current_mps=0.4", "simulation.sea.current_to_deg=90.0"
    run = Lockstep(config.load(VEHICLE, current), 1, lambda clock: NoLog())
    list(run.cycles(5.0))
    assert run.command(console.SetMode("hold")) is None
    list(run.cycles(20.0))
    for state in run.cycles(120.0):
        if (max(map(abs, state.actuation.thrust)) > 2.0 * troubles.TURNING) is turns:
            break
    run.faults.begin(fault("navigation_frozen"), run.elapsed_s)
    *_, state = run.cycles(4.0)
    assert state.mode is mode
    assert ("navigation frozen for 3." in state.reason) is turns


def test_positions_that_jump_stop_the_boat_before_they_would_be_believed(boat):
    boat.ready()
    boat.vehicle.on_command(console.Heading(0.0, 1.0))
    for _ in range(4):
        boat.clock.advance(0.2)
        assert not boat.navigate(latitude_rad=math.radians(38.70))
        boat.vehicle.on_watchdog()
    assert boat.state.mode is Mode.IDLE
    assert boat.state.reason == "position jumped by 833 m"


def test_a_message_that_comes_again_is_not_news(boat):
    boat.ready()
    boat.vehicle.on_command(console.Heading(0.0, 1.0))
    number, at_ns = boat._number, boat.clock.time_ns()
    boat.clock.advance(0.2)
    assert not boat.navigate(counter=number & 255, utc_ns=at_ns)
    assert boat.state.counts["navigation_repeated"] == 1


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e30])
def test_a_position_that_is_no_number_is_refused_and_leaves_no_origin(boat, value):
    """No bus can carry it, but the loop does not rely on that."""
    from delfim.canproxy.dsor.messages import Navigation
    from delfim.vehicle.navigation.fixes import Fix

    class Wild:
        name, heard_s = "wild", 0.0

        def read(self, now_s):
            return Fix(Navigation(0, value, -0.16, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3, 9, 0.9, 1), 0, now_s)

    boat.vehicle.sources = (Wild(),)
    assert not boat.vehicle.on_navigation(boat.vehicle.sources[0])
    assert boat.state.origin is None
    assert boat.state.counts == {"navigation_malformed": 1}


def test_a_mission_that_is_refused_leaves_everything_as_it_was(make_boat):
    rock = config.Area(name="rock", centre=((38.70, -9.215),), radius_m=50.0)
    boat = make_boat(fence=config.FenceTable(keep_out=(rock,)))
    text = 'version = 1\nname = "x"\n[[waypoint]]\nlatitude_deg = 38.70\nlongitude_deg = -9.215\n'
    refused = boat.vehicle.on_command(console.LoadMission(text))
    assert refused == "mission refused: waypoint 1 leads through rock; missions keep 6 m away"
    assert boat.state.origin is None
    assert boat.state.setpoint.plan is None


def test_a_missions_fence_is_obeyed_as_soon_as_it_is_loaded(boat):
    text = (
        'version = 1\nname = "x"\n[[waypoint]]\nlatitude_deg = 38.6925\nlongitude_deg = -9.215\n'
        "[fence]\nkeep_in = [{ polygon = [[38.692, -9.216], [38.6926, -9.216], [38.6926, -9.214], [38.692, -9.214]] }]\n"
    )
    boat.ready()
    assert boat.vehicle.on_command(console.LoadMission(text)) is None
    assert boat.vehicle.on_command(console.Heading(0.0, 1.5)) is None
    boat.clock.advance(0.2)
    boat.navigate(latitude_rad=NORTH_8_M, north_mps=1.5)
    boat.vehicle.on_watchdog()
    assert boat.state.mode is Mode.HOLD
    assert boat.state.reason.startswith("mission's keep-in zone 3.")


def test_holding_near_the_fence_is_where_there_is_room(make_boat):
    zone = ((38.69, -9.216), (38.69265, -9.216), (38.69265, -9.214), (38.69, -9.214))  # ends 16.7 m north of where it starts
    boat = make_boat(fence=config.FenceTable(keep_in=(config.Area(polygon=zone),)))
    boat.ready()
    boat.vehicle.on_command(console.Heading(0.0, 1.0))
    for metres in range(1, 12):
        boat.clock.advance(1.0)
        boat.vehicle.on_command(console.Alive())
        boat.report()
        boat.navigate(latitude_rad=math.radians(38.6925) + metres / 6_360_000)
    assert boat.vehicle.on_command(console.SetMode("hold")) is None
    reference = boat.state.reference
    assert reference.north_m is not None
    assert 16.7 - reference.north_m >= 8.0, "its own radius and the margin"


@pytest.mark.parametrize("every", [0, 7, 1], ids=["nobody orders", "every 0.7 s", "before each look"])
def test_a_propeller_that_does_not_stop_loses_its_batteries_whatever_is_ordered(boat, every):
    boat.ready()
    runaway = messages.pack_propeller_status(PropellerStatus(Status.GOOD, Fault(0), 700, 9.0, 20, 0))
    for tick in range(90 if every else 42):
        boat.clock.advance(0.1)
        boat.navigate()
        if every and tick and not tick % every:
            boat.vehicle.on_command(console.SetMode("hold"))
        boat.report()
        boat.nodes.sendmsg(Frame(messages.sysstat_arb(Node.PROPELLER_PORT), runaway))
        boat.vehicle.on_sensor(boat.sensor)
        boat.vehicle.on_watchdog()
    newest = {frame.arb: frame.data for frame in boat.heard()}
    assert messages.unpack_batteries_command(newest[messages.BATTERIES_STARBOARD]).connected
    assert not messages.unpack_batteries_command(newest[messages.BATTERIES_PORT]).connected
    assert boat.state.mode is Mode.IDLE
    told = [note for note in boat.log.notes if note.startswith("thruster: port propeller turns 700 instead of ")]
    assert told[-1].endswith(": stop" if every == 1 else ": disconnect"), "by the mode in which the boat looks"


def test_every_change_of_mode_and_every_trouble_is_in_the_log_in_words(boat):
    boat.ready()
    boat.vehicle.on_command(console.Heading(0.0, 1.0))
    boat.pass_time(1.5, navigation=False)
    boat.pass_time(5.0)
    mine = [note for note in boat.log.notes if not note.startswith("sensor_bad")]
    assert mine[0] == "heading: operator"
    assert mine[1].startswith("navigation_silent: navigation silent for 1.")
    assert mine[2].startswith("idle: navigation silent for 1.")
    assert "navigation_silent: over" in mine


def test_the_thrusters_are_judged_once_for_each_look_of_the_watchdog(boat, monkeypatch):
    """By `Failing`, which tells the failsafe; ten times a second it is a tenth of the watchdog's work."""
    judged = 0

    def counted(*asked):
        nonlocal judged
        judged += 1
        return {"port": "port propeller stands still"}

    for module in (failing, troubles):
        monkeypatch.setattr(module, "astray", counted)
    boat.vehicle.on_watchdog()
    assert judged == 1
