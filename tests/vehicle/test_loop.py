"""The critical program on a real bus: each of the five inputs does what figure 3-7 says, and nothing bad gets out."""

import copy
import math
import sys
import time

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from delfim import config
from delfim.base.frames import Frame, extended
from delfim.base.modes import Mode
from delfim.canproxy.dsor import messages
from delfim.canproxy.dsor.messages import NAVIGATION_ID, Fault, Navigation, Node, Status, pack_navigation
from delfim.canproxy.dsor.protocol import Message, segments
from delfim.vehicle import console
from delfim.vehicle.loop import COLD_CYCLES
from delfim.vehicle.rehearsal import Rehearsal

FOUR = {messages.PROPELLER_STARBOARD, messages.PROPELLER_PORT, messages.BATTERIES_STARBOARD, messages.BATTERIES_PORT}


def test_one_navigation_message_makes_four_propulsion_frames_and_one_record(boat):
    assert boat.navigate()
    assert {frame.arb for frame in boat.heard()} == FOUR
    assert boat.log.modes == ["IDLE"]


def test_no_message_no_actuation(boat):
    assert not boat.vehicle.on_navigation(boat.source)
    assert boat.heard() == []


def test_profile_stamps_follow_each_other_and_begin_with_the_kernels(boat, make_boat):
    from delfim.base.clock import SystemClock

    boat.vehicle.clock = SystemClock()
    for _ in range(COLD_CYCLES + 1):
        boat.navigate()
    assert boat.vehicle.latency.n == 1, "a program that comes up is slow, and spoils no figure"
    until_s = time.monotonic() + 200
    while boat.state.profile.t0 > boat.state.profile.t1 and time.monotonic() < until_s:
        boat.navigate()  # until the kernel stamps what arrives: it begins a moment after the first program asks for it
    p = boat.state.profile
    assert 0 < p.t0 <= p.t1 <= p.t2 <= p.t3 <= p.t4 <= p.t5


def test_heading_command_turns_the_propellers_at_once_and_again_each_cycle(boat):
    boat.ready()
    assert boat.vehicle.on_command(console.Heading(90.0, 1.0)) is None
    boat.pass_time(2.0)
    starboard, port = boat.propellers()
    assert starboard.run
    assert port.run
    assert port.rpm > starboard.rpm, "turning to starboard wants more port thrust"
    assert boat.state.mode is Mode.HEADING


def test_without_navigation_the_last_command_is_repeated_as_it_was_sent(boat):
    """Also while it was still rising: a replay does not know to a microsecond when the watchdog looked."""
    boat.ready()
    boat.clock.advance(0.2)
    boat.navigate()
    boat.vehicle.on_command(console.Heading(90.0, 1.0))
    boat.clock.advance(0.1)
    boat.navigate()
    rising = boat.propellers()
    boat.pass_time(0.8, navigation=False)
    assert [command[:2] for command in boat.propellers()] == [command[:2] for command in rising]


@pytest.mark.parametrize("command", [console.SetMode("heading"), console.Heading(90.0)])
def test_heading_mode_goes_on_as_the_boat_sails(boat, command):
    boat.ready()
    boat.navigate(heading_rad=math.pi / 2)
    boat.vehicle.on_command(console.Goto(38.6925, -9.10, 0.7))
    boat.navigate(heading_rad=math.pi / 2)
    assert boat.vehicle.on_command(command) is None
    assert boat.state.setpoint.heading_rad == pytest.approx(math.pi / 2, abs=1e-4)
    assert boat.state.setpoint.speed_mps == pytest.approx(0.7)


def test_course_mode_goes_on_as_the_boat_is_carried(boat):
    boat.ready()
    boat.navigate(north_mps=0.0, east_mps=1.0)
    assert boat.vehicle.on_command(console.SetMode("course")) is None
    assert boat.state.setpoint.heading_rad == pytest.approx(math.pi / 2)
    boat.vehicle.on_command(console.Stop())
    boat.navigate(north_mps=0.0, east_mps=0.1)
    assert boat.vehicle.on_command(console.SetMode("course")) is None
    assert boat.state.setpoint.heading_rad == 0.0, "a boat at rest has no course: the heading"


@pytest.mark.parametrize("command", [console.SetMode("heading"), console.Heading(20.0)])
def test_heading_mode_keeps_the_speed_that_was_asked_for(boat, command):
    boat.ready()
    boat.vehicle.on_command(console.Heading(20.0))
    assert boat.state.setpoint.speed_mps == boat.vehicle.helm.settings.control.speed.cruise_mps, "an idle boat begins with it"
    boat.vehicle.on_command(console.SetSpeed(0.0))
    assert boat.vehicle.on_command(command) is None
    assert (boat.state.setpoint.heading_rad, boat.state.setpoint.speed_mps) == (math.radians(20.0), 0.0)


def test_commands_are_refused_with_reasons_until_everything_is_well(boat):
    assert boat.vehicle.on_command(console.Heading(0.0)) == "heading refused: no navigation yet"
    boat.navigate()
    assert boat.vehicle.on_command(console.Heading(0.0)) == "heading refused: gps has not reported"
    boat.report()
    boat.log.why = "disk full"
    assert boat.vehicle.on_command(console.Heading(0.0)) == "heading refused: no log, no start: disk full"
    boat.log.why = ""
    assert boat.vehicle.on_command(console.Heading(0.0)) is None


def test_a_sailor_without_a_log_may_say_so(make_boat):
    boat = make_boat(log=config.LogTable(required=False))
    boat.ready()
    boat.log.why = "disk full"
    assert boat.vehicle.on_command(console.Heading(0.0)) is None


@pytest.mark.parametrize(
    ("mode", "reason"),
    [("play", "mission"), ("path", "path"), ("grex", "guest"), ("nonsense", "no mode 'nonsense'")],
)
def test_modes_without_what_they_need_are_refused_in_words(boat, mode, reason):
    boat.ready()
    answer = boat.vehicle.on_command(console.SetMode(mode))
    assert answer is not None
    assert reason in answer
    assert boat.state.mode is Mode.IDLE


TWO = """
version = 1
name = "two"
waypoint = [{ latitude_deg = 38.6930, longitude_deg = -9.2150 }, { latitude_deg = 38.6934, longitude_deg = -9.2150 }]
"""


def test_goto_without_a_place_goes_to_the_first_waypoint_and_needs_a_mission(boat):
    boat.ready()
    assert boat.vehicle.on_command(console.Goto()) == "goto refused: name a point or load a mission"
    boat.vehicle.on_command(console.LoadMission(TWO))
    assert boat.vehicle.on_command(console.Goto()) is None
    boat.pass_time(0.2)
    assert boat.state.reference.distance_m == pytest.approx(55.6, abs=0.5)


def test_the_mode_goto_waits_where_it_is_for_a_place(boat):
    """Also when a mission is loaded, and when an earlier place is still known."""
    boat.ready()
    boat.vehicle.on_command(console.LoadMission(TWO))
    boat.vehicle.on_command(console.Goto(38.6932, -9.2150))
    boat.vehicle.on_command(console.Stop())
    assert boat.vehicle.on_command(console.SetMode("goto")) is None
    boat.pass_time(3.0)
    assert boat.state.mode is Mode.GOTO
    assert boat.state.actuation.thrust == (0.0, 0.0)
    assert boat.vehicle.on_command(console.Goto(38.6932, -9.2150)) is None
    boat.pass_time(0.5)
    assert boat.state.actuation.thrust[1] > 0.0


@pytest.mark.parametrize(("latitude_deg", "longitude_deg"), [(38.69, 9.2153), (0.0, 0.0), (38.6925, -8.984)])
def test_no_place_is_gone_to_that_is_further_than_a_mission_may_lead(boat, latitude_deg, longitude_deg):
    boat.ready()
    far = boat.vehicle.on_command(console.Goto(latitude_deg, longitude_deg))
    assert far is not None
    assert "km to go; up to 20 km are allowed" in far
    assert boat.state.mode is Mode.IDLE
    assert boat.vehicle.on_command(console.Goto(38.6925, -8.986)) is None


@pytest.mark.parametrize("command", [console.Play(), console.Goto(), console.SetMode("path")])
def test_a_mission_that_was_loaded_before_the_position_was_known_is_not_sailed_across_an_ocean(boat, command):
    boat.vehicle.on_command(console.LoadMission(TWO))
    boat.report()
    assert boat.navigate(latitude_rad=math.radians(28.0), longitude_rad=math.radians(-15.4))
    far = boat.vehicle.on_command(command)
    assert far is not None
    assert "km to go; up to 20 km are allowed" in far


def test_a_path_is_begun_in_the_middle_only_when_told_and_says_so(boat):
    places = [(38.6920, -9.2140), (38.6920, -9.2150), (38.6930, -9.2150), (38.6930, -9.2140)]
    rows = ", ".join(f"{{ latitude_deg = {latitude}, longitude_deg = {longitude} }}" for latitude, longitude in places)
    boat.ready()
    assert boat.vehicle.on_command(console.LoadMission(f'version = 1\nname = "survey"\nwaypoint = [{rows}]\n')) is None
    assert boat.vehicle.on_command(console.SetMode("path")) is None
    assert (boat.state.reason, boat.state.reference.leg) == ("operator", 0), "the boat lies at the end of the first piece"
    assert boat.vehicle.on_command(console.SetMode("path", piece=1)) is None
    assert (boat.state.reason, boat.state.reference.leg) == ("operator; begins at piece 2 of 3", 1)
    assert boat.log.notes[-1] == f"path: {boat.state.reason}"
    assert boat.vehicle.on_command(console.SetMode("path", piece=3)) == "path refused: no piece 4: the path has pieces 1 to 3"
    assert boat.vehicle.on_command(console.SetMode("path")) is None
    assert boat.state.reason == "operator"


def test_a_path_goes_on_after_a_pause_where_it_was(boat):
    boat.ready()
    rows = ", ".join(f"{{ latitude_deg = {38.6925 + 0.001 * n}, longitude_deg = -9.2150 }}" for n in range(3))
    boat.vehicle.on_command(console.LoadMission(f'version = 1\nname = "survey"\nwaypoint = [{rows}]\n'))
    boat.vehicle.on_command(console.SetMode("path"))
    boat.pass_time(0.4)
    assert boat.vehicle.helm.memory.leg == 0
    for word in (console.SetMode("path"), console.Continue()):
        boat.vehicle.on_command(console.SetMode("hold"))
        assert boat.vehicle.on_command(word) is None
        assert (boat.state.reason, boat.vehicle.helm.memory.leg) == ("operator continues", 0)
    boat.vehicle.on_command(console.SetMode("hold"))
    assert boat.vehicle.on_command(console.SetMode("path", piece=1)) is None
    assert (boat.state.reason, boat.vehicle.helm.memory.leg) == ("operator; begins at piece 2 of 2", -2)


def test_navigation_silence_stops_the_boat_within_its_limit_and_says_why(boat):
    boat.ready()
    boat.vehicle.on_command(console.Heading(0.0, 1.0))
    boat.pass_time(3.0)
    boat.heard()
    boat.pass_time(1.2, navigation=False)
    assert boat.state.mode is Mode.IDLE
    assert boat.state.reason.startswith("navigation silent for 1.")
    starboard, port = boat.propellers()
    assert (starboard.run, starboard.rpm, port.run, port.rpm) == (False, 0, False, 0)


def test_console_silence_makes_the_boat_hold_and_a_word_keeps_it_sailing(make_boat):
    boat = make_boat(failsafe=config.Failsafe(console_silent=config.ConsoleSilent(after_s=3.0)))
    boat.ready()
    boat.vehicle.on_command(console.Heading(0.0, 1.0))
    boat.pass_time(2.0)
    boat.vehicle.on_command(console.Alive())
    boat.pass_time(2.0)
    assert boat.state.mode is Mode.HEADING
    boat.vehicle.on_command(console.TellState())
    boat.pass_time(2.0)
    assert boat.state.mode is Mode.HOLD, "an onlooker does not keep the boat sailing"
    assert boat.state.reason.startswith("console silent")


def test_manual_thrust_fades_without_fresh_commands(boat):
    boat.ready()
    boat.vehicle.on_command(console.Manual(0.5, 0.5))
    boat.pass_time(1.5)
    assert boat.propellers()[0].rpm == 600
    boat.pass_time(1.0)
    assert boat.propellers()[0].rpm == 0
    assert boat.state.mode is Mode.MANUAL, "the thrust first, then the mode"
    assert boat.state.reason.startswith("no thrust: no manual command")
    assert "release the joystick" in boat.vehicle.on_command(console.Manual(0.5, 0.5)), "what comes back late does not push on"
    for _ in range(6):
        boat.vehicle.on_command(console.Alive())
        boat.pass_time(1.0)
    assert boat.state.reason.startswith("no manual command")


def test_a_bad_or_silent_required_node_stops_the_boat(boat):
    boat.ready()
    boat.vehicle.on_command(console.Heading(0.0, 1.0))
    boat.report(Status.BAD, Fault.OVERHEATED)
    boat.vehicle.on_watchdog()
    assert boat.state.reason == "propeller starboard bad: overheated"


def test_a_silent_node_is_named_with_its_silence(boat):
    boat.ready()
    boat.vehicle.on_command(console.Heading(0.0, 1.0))
    for _ in range(6):
        boat.clock.advance(1.0)
        boat.navigate()
        boat.report(silent=("batteries_port",))
        boat.vehicle.on_command(console.Alive())
        boat.vehicle.on_watchdog()
    assert boat.state.reason == "batteries port silent for 6.0 s"


def test_losing_the_heading_stops_a_mode_that_needs_it(boat):
    boat.ready()
    boat.vehicle.on_command(console.Heading(0.0, 1.0))
    boat.clock.advance(0.2)
    boat.navigate(heading_rad=None)
    assert not boat.propellers()[0].run, "not even one cycle on a guess"
    boat.vehicle.on_watchdog()
    assert boat.state.reason == "no heading: position and velocity only"


def test_an_impossible_jump_is_refused_and_counted_until_silence_allows_it(boat):
    boat.ready()
    boat.clock.advance(0.2)
    assert not boat.navigate(latitude_rad=math.radians(38.70))
    assert boat.state.counts["navigation_jumps"] == 1
    boat.clock.advance(1.5)
    assert boat.navigate(latitude_rad=math.radians(38.70))


def test_malformed_messages_are_counted_and_harmless(boat):
    boat.send(b"short", Node.NAVIGATION, messages.NAVIGATION_ID)
    assert not boat.vehicle.on_navigation(boat.source)
    boat.nodes.sendmsg(Frame(messages.sysstat_arb(Node.PROPELLER_PORT), b"\x09"))
    boat.nodes.sendmsg(Frame(messages.sysstat_arb(Node(0x02)), bytes(8)))
    boat.vehicle.on_sensor(boat.sensor)
    assert boat.state.counts == {"navigation_malformed": 1, "sysstat_malformed": 2}


def test_a_shutdown_stops_the_propellers(boat):
    boat.ready()
    boat.vehicle.on_command(console.Manual(1.0, 1.0))
    boat.heard()
    boat.vehicle.helm.stop("shutdown")
    starboard, port = boat.propellers()
    assert not starboard.run
    assert not port.run


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.integers(0, 0x1FFFFFFF), st.binary(max_size=8)), max_size=30), st.integers(0, 3))
def test_random_frames_raise_nothing(boat, frames, kind):
    """Frames that pass the kernel's filters by construction: right nodes, random rest."""
    nodes = (Node.NAVIGATION, Node.GPS, Node.PROPELLER_PORT, Node.BATTERIES_STARBOARD)
    for identifier, data in frames:
        boat.nodes.sendmsg(Frame(extended(identifier & ~(0x7F << 12) | nodes[kind] << 12), data))
        boat.vehicle.on_navigation(boat.source)
        boat.vehicle.on_sensor(boat.sensor)


def test_the_better_source_wins_while_it_speaks(boat):
    """Preference and age, with the function that decides."""
    from delfim.parts.dsor.source import DsorNavigation
    from delfim.vehicle.navigation.fixes import preferred

    first, second = boat.source, DsorNavigation(boat.sensor.input, boat.state)
    first.heard_s, second.heard_s = 10.0, 10.4
    assert preferred(first, (first, second), 10.5, 1.0)
    assert not preferred(second, (first, second), 10.5, 1.0)
    assert preferred(second, (first, second), 11.5, 1.0)


def test_a_rehearsal_goes_the_whole_way_sends_nothing_and_changes_nothing(boat):
    rehearsal = Rehearsal(boat.vehicle, boat.outlets, boat.outlets[0].mirror())
    rehearsal.whole()
    rehearsal.part()
    boat.ready()
    boat.vehicle.on_command(console.Heading(90.0, 1.0))
    boat.pass_time(1.0)
    boat.heard()
    before = copy.deepcopy((boat.vehicle.helm.memory, boat.vehicle.propulsion._sent, boat.state))
    for _ in range(3):
        rehearsal.whole()
    for _ in range(8):
        rehearsal.part()
    assert boat.heard() == []
    assert (boat.vehicle.helm.memory, boat.vehicle.propulsion._sent, boat.state) == before
    twin = rehearsal._twin
    assert (twin.state.cycles, twin.state.mode, twin.state.actuation.run) == (3 + 2, Mode.HEADING, True)


def test_a_rehearsal_computes_with_the_boats_own_tables_which_get_cold_as_its_code_does(boat):
    rehearsal = Rehearsal(boat.vehicle, boat.outlets, boat.outlets[0].mirror())
    boat.ready()
    boat.vehicle.on_command(console.Heading(90.0, 1.0))
    boat.vehicle.on_command(console.Set("control.heading.p_nm_per_rad", 500.0))
    boat.vehicle.propulsion.drop(("port",))
    boat.navigate()
    for _ in range(2):
        rehearsal.part()
    helm, its = boat.vehicle.helm, rehearsal._twin.helm
    assert its.limits is helm.limits
    assert its.limits.gains.p_nm_per_rad == 500.0
    propulsion, its = boat.vehicle.propulsion, rehearsal._twin.propulsion
    assert its._allocate.__self__ is propulsion.allocation
    assert its._commands is propulsion._commands
    assert its._sent.thrust[1] == 0.0, "the port thruster is not used"


def test_the_critical_path_of_two_propellers_calls_few_functions(boat):
    boat.ready()
    boat.vehicle.on_command(console.Heading(0.0, 2.0))  # the boat is fed a place that stays: it asks for more than there is
    boat.pass_time(10.0)
    assert boat.vehicle.propulsion.short is not None
    called = list[str]()
    real = boat.vehicle.on_navigation

    def counted(source):
        sys.setprofile(lambda frame, event, _: called.append(frame.f_code.co_name) if event == "call" else None)
        try:
            return real(source)
        finally:
            sys.setprofile(None)

    boat.vehicle.on_navigation = counted
    assert boat.navigate()
    assert len(called) <= 75, called


@pytest.mark.parametrize("node", [0, 5])
def test_navigation_for_this_computers_node_is_taken_and_for_another_one_not(make_boat, node):
    boat = make_boat(can=config.Can(node=5))
    still = Navigation(boat.clock.time_ns(), 0.6, -0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3, 9, 0.9, 1)
    message = Message(0x20, Node.NAVIGATION, node, NAVIGATION_ID, pack_navigation(still))
    for frame in segments(message, 1):
        boat.nodes.sendmsg(frame)
    assert boat.vehicle.on_navigation(boat.source) is (node == 5)
