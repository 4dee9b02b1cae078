"""Pause and continue, and the end of "go to": hold, whose propellers start again, or idle."""

import math

import pytest

from delfim import config
from delfim.base.modes import Mode
from delfim.vehicle import console
from delfim.vehicle.state import StartConditions

PLACES = [(38.6925, -9.2150), (38.6930, -9.2150), (38.6930, -9.2140)]  # the boat is at the first one
ROWS = ", ".join(f"{{ latitude_deg = {north}, longitude_deg = {east} }}" for north, east in PLACES)
MISSION = console.LoadMission(f'version = 1\nname = "survey"\nwaypoint = [{ROWS}]\n')
OTHER = console.LoadMission(MISSION.text.replace("38.6925", "38.6926"))
ASIDE = {"longitude_rad": math.radians(-9.21495)}  # 4 m beside the line of the second leg


def under_way(boat):
    """On the second leg of the mission, slowed down by the operator."""
    boat.ready()
    helm = boat.vehicle.helm
    for command in (MISSION, console.Play(0), console.SetSpeed(0.7)):
        assert boat.vehicle.on_command(command) is None
    boat.pass_time(0.4)
    assert boat.state.reference.leg == 1
    return helm


@pytest.mark.parametrize("word", [console.Continue(), console.SetMode("play")])
def test_play_goes_on_along_the_line_on_which_it_was_at_the_speed_it_had(boat, word):
    helm = under_way(boat)
    before = helm.memory
    assert boat.vehicle.on_command(console.Pause()) is None
    assert (boat.state.mode, boat.state.reason) == (Mode.HOLD, "operator paused play on leg 2")
    assert boat.vehicle.report().paused == "play"
    boat.pass_time(1.0, navigation=False)
    boat.navigate(**ASIDE)
    assert boat.vehicle.on_command(word) is None
    assert (boat.state.mode, boat.state.reason) == (Mode.PLAY, "operator continues")
    assert (helm.memory.leg, helm.memory.north_m, helm.memory.east_m) == (1, before.north_m, before.east_m)
    assert boat.state.setpoint.override_mps == 0.7
    assert abs(boat.state.reference.cross_track_m) > 3.0, "off the line of the mission, not on one of its own"
    assert boat.vehicle.report().paused is None


def test_what_a_failsafe_interrupted_goes_on_when_the_operator_says_so(make_boat):
    boat = make_boat(failsafe=config.Failsafe(console_silent=config.ConsoleSilent(after_s=1.0, action="hold")))
    boat.ready()
    boat.vehicle.on_command(console.Heading(90.0, 1.0))
    boat.pass_time(2.0)
    assert boat.state.mode is Mode.HOLD
    boat.vehicle.on_command(console.Alive())
    assert boat.state.mode is Mode.HOLD, "not by itself"
    assert boat.vehicle.on_command(console.Continue()) is None
    assert (boat.state.mode, boat.state.reference.heading_rad) == (Mode.HEADING, pytest.approx(math.pi / 2))


def test_a_path_goes_on_with_the_piece_that_it_was_on(boat):
    boat.ready()
    boat.vehicle.on_command(MISSION)
    boat.vehicle.on_command(console.SetMode("path"))
    boat.vehicle.helm.memory = boat.vehicle.helm.memory._replace(leg=1)
    boat.vehicle.on_command(console.Pause())
    boat.vehicle.on_command(console.Continue())
    assert (boat.state.mode, boat.vehicle.helm.memory.leg) == (Mode.PATH, 1)
    assert boat.state.reason == "operator continues"


@pytest.mark.parametrize("command", [console.Stop(), console.SetMode("manual"), console.Heading(0.0)])
def test_another_mode_forgets_the_pause(boat, command):
    under_way(boat)
    boat.vehicle.on_command(console.Pause())
    boat.vehicle.on_command(command)
    assert boat.vehicle.on_command(console.Continue()) == "continue refused: nothing is paused"


def test_another_mission_is_not_sailed_from_the_middle(boat):
    under_way(boat)
    boat.vehicle.on_command(console.Pause())
    boat.vehicle.on_command(OTHER)
    refused = boat.vehicle.on_command(console.Continue())
    assert refused == "continue refused: the mission has changed since the pause; choose the mode again"
    assert boat.state.mode is Mode.HOLD
    assert boat.vehicle.on_command(console.SetMode("play")) is None, "it is chosen again"
    assert (boat.state.mode, boat.state.reason, boat.state.reference.leg) == (Mode.PLAY, "operator", 0)


def test_a_leg_that_is_chosen_during_the_pause_is_the_one_that_is_sailed(boat):
    helm = under_way(boat)
    boat.vehicle.on_command(console.Pause())
    assert boat.vehicle.on_command(console.Leg(2)) is None
    assert boat.vehicle.on_command(console.Continue()) is None
    assert (boat.state.mode, helm.memory.leg) == (Mode.PLAY, 2)


def test_a_boat_that_is_unfit_does_not_go_on(boat):
    under_way(boat)
    boat.vehicle.on_command(console.Pause())
    boat.state.computer = StartConditions(is_starting=True)
    assert (boat.vehicle.on_command(console.Continue()) or "").startswith("play refused: the program is still starting")
    assert boat.vehicle.report().paused == "play", "it may be asked again"


def test_a_boat_that_cannot_hold_is_stopped_by_a_pause(boat):
    boat.ready()
    boat.vehicle.on_command(console.Heading(0.0, 1.0))
    boat.navigate(latitude_rad=None, longitude_rad=None)
    assert boat.vehicle.on_command(console.Pause()) is None
    assert (boat.state.mode, boat.state.reason) == (
        Mode.IDLE,
        "operator paused heading; cannot hold: no position: heading and velocity only",
    )
    assert boat.propellers()[0].run is False


def test_a_boat_at_rest_is_not_paused(boat):
    boat.ready()
    assert boat.vehicle.on_command(console.Pause()) == "pause refused: the boat is idle"
    assert boat.vehicle.on_command(console.Continue()) == "continue refused: nothing is paused"


@pytest.mark.parametrize(
    ("own", "asked", "mode"),
    [("hold", None, Mode.HOLD), ("idle", None, Mode.IDLE), ("hold", "idle", Mode.IDLE), ("idle", "hold", Mode.HOLD)],
)
def test_go_to_ends_in_hold_or_in_idle_as_the_file_or_the_command_says(make_boat, own, asked, mode):
    boat = make_boat(control=config.ControlTable(goto=config.GotoTable(end=own)))
    boat.ready()
    assert boat.vehicle.on_command(console.Goto(38.6925, -9.2150, end=asked)) is None
    boat.pass_time(0.4)
    assert (boat.state.mode, boat.state.reason) == (mode, "goto done")
    assert boat.state.actuation.run is (mode is Mode.HOLD)
    assert boat.vehicle.on_command(console.Continue()) == "continue refused: nothing is paused"
