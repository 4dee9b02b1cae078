"""The helm where it turns: what a push of the joystick, a failsafe, an end and a command change, and what they leave alone."""

import math
from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from delfim import config
from delfim.base import geodesy
from delfim.base.cooperative import Sliced
from delfim.base.modes import Mode
from delfim.vehicle import console
from delfim.vehicle.control.memory import Memory
from delfim.vehicle.control.safe import STOP
from delfim.vehicle.failsafe.failsafe import Action
from delfim.vehicle.helm.helm import Helm
from delfim.vehicle.plans.fence import Fence
from delfim.vehicle.plans.zones import circle
from delfim.vehicle.state import Killed, Reference, ThrusterReport, Waypoint
from tests.vehicle.test_pause import MISSION, under_way

UNFIT = "manual refused: no navigation yet"
HELD = "manual refused: {}; release the joystick for 1 s or choose a mode"
ROCK = Fence((circle("rock", False, (0.0, 50.0), 10.0),), config.FenceTable())


def push(boat, starboard: float = 0.0, port: float = 0.0) -> str | None:
    return boat.vehicle.on_command(console.Manual(starboard, port))


def places(boat, north_m: float, east_m: float) -> Helm:
    """Puts the boat there, at rest; its helm."""
    boat.state.motion = boat.state.motion._replace(north_m=north_m, east_m=east_m, north_mps=0.0, east_mps=0.0)
    return boat.vehicle.helm


def endless() -> Iterator[int]:
    while True:
        yield 1


# By hand.


def test_a_boat_that_was_not_fit_takes_the_joystick_as_soon_as_it_is(boat):
    assert [push(boat, 0.5), push(boat, 0.5)] == [UNFIT] * 2
    boat.ready()
    assert push(boat, 0.5) is None


@pytest.mark.parametrize(("silent_s", "is_taken"), [(0.9, False), (1.0, True)])
def test_a_joystick_that_was_held_over_counts_again_after_a_second(boat, silent_s, is_taken):
    boat.ready()
    boat.vehicle.helm.taken, boat.state.reason = True, "gps bad"
    boat.state.manual_s = boat.clock.monotonic_s() - silent_s
    assert push(boat, 0.5) == (None if is_taken else HELD.format("gps bad"))
    assert boat.state.mode is (Mode.MANUAL if is_taken else Mode.IDLE)


def test_a_joystick_is_let_go_when_it_asks_for_nothing_on_either_side(boat):
    boat.ready()
    assert push(boat, 0.5, 0.5) is push(boat, 0.4, 0.3) is None
    assert (boat.state.setpoint.starboard, boat.state.setpoint.port) == (0.4, 0.3)
    boat.vehicle.helm.taken, boat.state.reason = True, "no thrust"
    assert [push(boat, 0.0, 0.1), push(boat, 0.1, 0.0), push(boat, 0.1, 0.1)] == [HELD.format("no thrust")] * 3
    boat.clock.advance(2.0)
    assert push(boat, 0.1, 0.1) == HELD.format("no thrust"), "in manual mode silence lets nothing go"
    assert push(boat) is push(boat, 0.1, 0.1) is None


@pytest.mark.parametrize(
    "words", [(console.Stop(),), (console.Kill(), console.Clear()), (console.Pause(),), (console.ShutDown(),)]
)
@pytest.mark.parametrize("was_taken", [False, True])
def test_what_an_operator_ends_the_operator_begins_again(boat, words, was_taken):
    boat.ready()
    push(boat, 0.5)
    boat.vehicle.helm.taken = was_taken
    assert [boat.vehicle.on_command(word) for word in words] == [None] * len(words)
    assert push(boat, 0.5) is None


@pytest.mark.parametrize("sides", [(0.5, 0.0), (0.0, 0.5)])
def test_thrust_that_is_not_repeated_ends_after_its_time(make_boat, sides):
    own = config.ManualSilent(thrust_s=2.0, after_s=9.0)
    boat = make_boat(failsafe=config.Failsafe(manual_silent=own))
    boat.ready()
    push(boat, *sides)
    helm, now_s, before = boat.vehicle.helm, boat.clock.monotonic_s(), list(boat.log.notes)
    helm.fade(now_s + 2.0)
    assert (boat.state.setpoint.starboard, boat.state.setpoint.port) == sides
    helm.fade(now_s + 2.1)
    assert (boat.state.setpoint.starboard, boat.state.setpoint.port) == (0.0, 0.0)
    assert (boat.state.mode, boat.state.reason) == (Mode.MANUAL, "no thrust: no manual command for 2.1 s")
    assert boat.log.notes == [*before, boat.state.reason]
    assert not boat.state.actuation.run, "at once"
    assert push(boat, *sides) == HELD.format(boat.state.reason)
    helm.fade(now_s + 9.0)
    assert len(boat.log.notes) == len(before) + 1, "there is none any more"


def test_only_thrust_by_hand_fades(boat):
    boat.ready()
    boat.vehicle.on_command(console.Heading(0.0))
    boat.state.setpoint = boat.state.setpoint._replace(starboard=0.5, port=0.5)
    boat.vehicle.helm.fade(boat.clock.monotonic_s() + 9.0)
    assert boat.state.reason == "operator"


def test_manual_by_its_name_is_without_thrust_and_counts_as_a_command(boat):
    boat.ready()
    push(boat, 0.5, 0.4)
    boat.clock.advance(1.0)
    assert boat.vehicle.on_command(console.SetMode("manual")) is None
    assert (boat.state.setpoint.starboard, boat.state.setpoint.port) == (0.0, 0.0)
    assert boat.state.manual_s == boat.clock.monotonic_s()


def test_who_gives_the_boat_back_or_is_lost(boat):
    boat.ready()
    boat.vehicle.on_command(console.Leave())
    assert boat.state.reason == "operator gave the boat back: nobody"
    for word, reason in ((console.Heading(0.0), "operator"), (console.Manual(0.5, 0.5), "no thrust: no link")):
        boat.vehicle.on_command(word, "console 7")
        mode = boat.state.mode
        boat.vehicle.on_command(console.Leave(lost="no link"), "console 7")
        assert (boat.state.mode, boat.state.reason) == (mode, reason)
        assert boat.state.setpoint.starboard == 0.0
    boat.vehicle.on_command(console.Alive(), "console 7")
    boat.state.operator = "console 7"
    boat.vehicle.on_command(console.Leave(), "console 7")
    assert (boat.state.mode, boat.state.reason) == (Mode.IDLE, "operator gave the boat back: console 7")


# In a trial.


def attempt(boat, number: int, latitude_deg: float = 38.6925) -> str | None:
    pieces = ((1.0, (0.1, 0.1)), (5.0, (0.2, 0.2)))
    return boat.vehicle.on_command(console.Try(number, pieces, latitude_deg, -9.2150, 100.0, begin=True))


def test_the_next_manoeuvre_of_a_trial_begins_with_its_first_piece_in_its_own_circle(boat):
    assert attempt(boat, 1) == "trial refused: no position yet"
    boat.ready()
    helm = boat.vehicle.helm
    for number, latitude_deg, middle_m in ((1, 38.6925, 0.0), (2, 38.6930, 55.5)):
        assert attempt(boat, number, latitude_deg) is None
        assert (boat.state.mode, helm.memory.leg, helm.memory.north_m) == (Mode.TRIAL, 0, pytest.approx(middle_m, abs=0.1))
        helm.memory = helm.memory._replace(leg=1)
    assert attempt(boat, 2) is None
    assert helm.memory.leg == 1, "it goes on"


def test_a_trial_that_is_not_asked_for_again_ends_after_its_time(make_boat):
    boat = make_boat(failsafe=config.Failsafe(manual_silent=config.ManualSilent(thrust_s=2.0, after_s=9.0)))
    boat.ready()
    assert attempt(boat, 1) is None
    now_s = boat.clock.monotonic_s()
    boat.vehicle.helm.fade(now_s + 2.0)
    assert boat.state.mode is Mode.TRIAL
    boat.vehicle.helm.fade(now_s + 2.1)
    assert (boat.state.mode, boat.state.reason) == (Mode.IDLE, "trial ended: nobody asks for it for 2.1 s")


# Steps and stops.


def test_a_step_is_told_the_time_since_the_last_one_and_no_more_than_a_second(boat):
    told = list[float]()

    def shape(mode, memory, stepped, limits, dt_s):
        told.append(dt_s)
        return memory, Reference(), STOP

    helm, now_s = boat.vehicle.helm, boat.clock.monotonic_s()
    helm.shapes["test"] = shape
    for at_s in (0.25, 0.5, 1.5, 3.0, 4.5, 4.625):
        assert helm.control(now_s + at_s) is STOP
    assert told == [0.25, 0.25, 1.0, 1.0, 1.0, 0.125]
    boat.vehicle.propulsion.short = 1.0, 2.0, 3.0
    helm.control(now_s + 5.0)
    integrals = helm.memory.integrals
    assert (integrals.surge_short_n, integrals.sway_short_n, integrals.yaw_short_nm) == (1.0, 2.0, 3.0), "what was missing"


def test_the_end_of_the_way_home_is_a_place_where_both_it_and_the_plane_are_known(boat):
    helm = boat.vehicle.helm
    helm.track.restore(((0.0, 0.0),), 5.0)
    assert helm.home() is None
    boat.ready()
    assert helm.home() == (boat.state.origin.latitude_rad, boat.state.origin.longitude_rad)
    helm.track.restore((), 5.0)
    assert helm.home() is None


def test_a_stop_says_why_once_and_a_kill_stays_the_reason(boat):
    boat.ready()
    helm = boat.vehicle.helm
    for reason in ("a", "a", "b"):
        helm.stop(reason)
    boat.state.killed = Killed("pressed")
    helm.stop("c")
    assert boat.log.notes == ["idle: a", "idle: b", "idle: kill: pressed"]


def test_a_stop_ends_the_thrust_at_once(boat):
    boat.ready()
    push(boat, 0.5, 0.5)
    boat.vehicle.helm.steer(boat.clock.monotonic_s())
    assert [each.run for each in boat.propellers()] == [True, True]
    boat.vehicle.helm.stop("test")
    assert (boat.state.actuation.run, [each.run for each in boat.propellers()]) == (False, [False, False])


def test_a_mode_begins_once_and_the_voyage_is_remembered(boat):
    boat.ready()
    boat.vehicle.on_command(console.SetMode("hold"))
    began_s = boat.clock.monotonic_s()
    assert (boat.state.mode_s, boat.state.armed, boat.state.has_left_idle) == (began_s, True, True)
    boat.clock.advance(1.0)
    boat.vehicle.on_command(console.SetMode("hold"))
    assert boat.state.mode_s == began_s, "it goes on"
    boat.vehicle.on_command(console.Stop())
    assert (boat.state.mode_s, boat.state.armed, boat.state.has_left_idle) == (began_s + 1.0, False, True)


def test_to_arm_is_refused_in_idle_alone(boat):
    assert boat.vehicle.on_command(console.Arm()) == "arm refused: no navigation yet"
    assert not boat.state.armed
    boat.ready()
    assert boat.vehicle.on_command(console.Arm()) is None
    assert boat.state.armed
    boat.vehicle.on_command(console.Heading(0.0))
    boat.log.why, boat.state.armed = "disk full", False
    assert boat.vehicle.on_command(console.Arm()) is None
    assert boat.state.armed


def test_nodes_are_restarted_in_idle_alone(boat):
    boat.ready()
    asked = list[int]()
    boat.vehicle.propulsion.reset = asked.append
    assert boat.vehicle.on_command(console.Reset(5)) is None
    boat.vehicle.on_command(console.Heading(0.0))
    assert boat.vehicle.on_command(console.Reset(6)) == "reset refused: stop first"
    boat.vehicle.on_command(console.Stop())
    boat.state.thrusters["port"] = ThrusterReport(boat.clock.monotonic_s(), 500.0)
    assert boat.vehicle.on_command(console.Reset(7)) == "reset refused: port still turning"
    assert asked == [5]


def test_what_is_set_is_what_everything_goes_by(boat):
    helm = boat.vehicle.helm
    rules = helm.rules
    assert boat.vehicle.on_command(console.Set("control.speed.max_mps", 1.0)) is None
    assert helm.rules is rules
    assert rules.settings is helm.settings
    assert helm.plans.limits is helm.limits
    assert helm.limits.control.speed.max_mps == helm.settings.control.speed.max_mps == 1.0
    assert boat.vehicle.on_command(console.Set("failsafe.console_silent.after_s", 7.0)) is None
    assert helm.rules is not rules
    assert helm.rules.table.console_silent.after_s == 7.0
    assert (boat.vehicle.on_command(console.Set("control.speed.max_mps", -1.0)) or "").startswith(
        "set refused: control.speed.max_mps: "
    )
    assert helm.changed == {"control.speed.max_mps": 1.0, "failsafe.console_silent.after_s": 7.0}


# The failsafe's actions.


def test_power_that_is_cut_changes_no_mode_and_a_stop_cuts_it_too(boat):
    boat.ready()
    boat.vehicle.on_command(console.Heading(0.0))
    helm, now_s, cut = boat.vehicle.helm, boat.clock.monotonic_s(), list[tuple[str, ...]]()
    boat.vehicle.propulsion.disconnect = cut.append
    boat.state.overdue = ("port",)
    helm.fall_back(Action.HOME, "console silent", now_s)
    assert not cut
    helm.enter(Mode.HEADING, "test")
    before = list(boat.log.notes)
    helm.fall_back(Action.DISCONNECT, "port turns", now_s)
    assert (boat.state.mode, cut, boat.log.notes) == (Mode.HEADING, [("port",)], before)
    helm.fall_back(Action.STOP, "port turns", now_s)
    assert (boat.state.mode, cut) == (Mode.IDLE, [("port",)] * 2)


def test_the_helm_knows_when_the_thrusters_were_switched_off(boat):
    boat.ready()
    helm, state, told = boat.vehicle.helm, boat.state, list[float]()
    assert state.off_s < 0.0
    for run, mode in ((True, Mode.HEADING), (False, Mode.IDLE), (True, Mode.IDLE), (False, Mode.HEADING)):
        boat.clock.advance(1.0)
        state.mode, state.actuation = mode, state.actuation._replace(run=run)
        helm.stop(f"{mode}, {run}")
        told.append(boat.clock.monotonic_s() - state.off_s)
    assert told == [0.0, 1.0, 0.0, 0.0], "a stop of what is off already changes nothing"
    helm.enter(Mode.MANUAL, "test")
    assert boat.clock.monotonic_s() == state.off_s


@pytest.mark.parametrize(("action", "is_seeking"), [(Action.BACK, False), (Action.HOLD, True)])
def test_a_boat_that_goes_back_or_looks_for_a_place_does_not_hold_anew(boat, action, is_seeking):
    """Also where a zone is on the straight way to its place."""
    boat.ready()
    helm = places(boat, 0.0, 0.0)
    helm.enter(Mode.HOLD, "test")
    helm.plans.fence, seeking = ROCK, Sliced(endless()) if is_seeking else None
    helm._seeking = seeking
    places(boat, 0.0, 100.0)
    helm.fall_back(action, "rock 4 m away", boat.clock.monotonic_s())
    assert boat.state.reason == "test"
    assert seeking is None or helm._seeking is seeking


def test_a_boat_in_trouble_goes_back_along_its_track_as_often_as_it_is_there(boat):
    boat.ready()
    helm = boat.vehicle.helm
    helm.track.restore(tuple((0.0, 10.0 * n) for n in range(11)), 10.0)

    def back() -> tuple[float, float]:
        helm.fall_back(Action.BACK, "shallow", boat.clock.monotonic_s())
        return helm.memory.north_m, helm.memory.east_m

    places(boat, 3.0, 100.0)
    assert back() == (0.0, 80.0)
    assert (boat.state.mode, boat.state.reason) == (Mode.HOLD, "shallow")
    assert back() == (0.0, 80.0), "it is not there yet"
    places(boat, 0.0, 85.1)
    assert back() == (0.0, 80.0)
    places(boat, 3.0, 84.0)
    assert back() == (0.0, 60.0), "5 m are near enough"
    helm._seeking = Sliced(endless())
    places(boat, 0.0, 60.0)
    assert back() == (0.0, 60.0), "a better place is looked for"


def test_a_boat_in_trouble_without_a_track_holds_here(boat):
    boat.ready()
    helm = places(boat, 3.0, 4.0)
    helm.track.restore((), 5.0)
    boat.heard()
    helm.fall_back(Action.BACK, "shallow", boat.clock.monotonic_s())
    assert boat.heard(), "the propellers hear of it at once"
    assert (boat.state.mode, helm.memory.north_m, helm.memory.east_m) == (Mode.HOLD, 3.0, 4.0)


@pytest.mark.parametrize(
    ("mode", "target", "settles"),
    [
        (Mode.HOLD, None, True),
        (Mode.GOTO, None, True),
        (Mode.GOTO, Waypoint(0.0, -90.0, 1.0, 2.0), False),
        (Mode.HEADING, None, False),
    ],
)
def test_who_stays_stays_where_the_fence_leaves_room(boat, mode, target, settles):
    boat.ready()
    helm = places(boat, 0.0, 0.0)
    helm.track.restore(((0.0, -20.0), (0.0, -6.0)), 5.0)
    near = Fence((circle("rock", False, (0.0, 14.0), 10.0),), config.FenceTable())
    helm.plans.fence, boat.state.setpoint = near, boat.state.setpoint._replace(target=target)
    helm.enter(mode, "test")
    assert (helm.memory.north_m, helm.memory.east_m) == ((0.0, -6.0) if settles else (0.0, 0.0))
    assert helm.memory.room == 1.0


# Ends, and what goes on.


def test_long_work_goes_on_and_ends_with_the_mode_that_it_was_for(boat):
    boat.ready()
    helm = boat.vehicle.helm
    helm.track.restore(((0.0, 0.0), (90.0, 0.0)), 5.0)
    helm.track.call_at(((90.0, 0.0),), 5.0)
    helm.plans.fence, helm._seeking = ROCK, Sliced(endless())
    helm.detour = SimpleNamespace(step=lambda: (boat.state.setpoint, "a way is found"), held=[])
    helm.stop("enough")
    helm.go_on()
    assert (boat.state.mode, boat.state.reason, helm._seeking) == (Mode.IDLE, "enough", None)
    assert helm.track.end() == (90.0, 0.0), "the harbour was looked for"
    helm.detour = SimpleNamespace(step=lambda: None, held=[])
    helm.go_on()
    assert boat.state.mode is Mode.IDLE
    helm.detour = SimpleNamespace(step=lambda: (boat.state.setpoint, "a way is found"), held=[])
    helm.go_on()
    assert (boat.state.mode, boat.state.reason) == (Mode.GOTO, "a way is found")


@pytest.mark.parametrize(
    ("mode", "is_home", "goes"),
    [(Mode.PLAY, True, Mode.HOME), (Mode.PATH, True, Mode.HOME), (Mode.PLAY, False, Mode.HOLD), (Mode.GOTO, True, Mode.HOLD)],
)
def test_at_its_end_a_mission_leads_home_if_it_says_so(boat, mode, is_home, goes):
    boat.ready()
    helm = boat.vehicle.helm
    helm.track.restore(((0.0, 0.0), (30.0, 0.0)), 5.0)
    boat.vehicle.on_command(MISSION)
    plan = boat.state.setpoint.plan._replace(then_home=is_home)
    end = "hold" if mode is Mode.GOTO else "idle"  # of an earlier goto
    boat.state.setpoint = boat.state.setpoint._replace(plan=plan, track=(), end=end)
    boat.state.mode = mode
    helm.finish()
    assert (boat.state.mode, boat.state.reason) == (goes, f"{mode.name.lower()} done")
    assert boat.state.setpoint.track == (((0.0, 0.0), (30.0, 0.0)) if goes is Mode.HOME else ())


def test_at_an_end_where_it_cannot_go_on_the_boat_stops(boat):
    boat.ready()
    helm = boat.vehicle.helm
    helm.track.restore((), 5.0)
    boat.vehicle.on_command(MISSION)
    boat.state.mode, boat.state.setpoint = (
        Mode.PLAY,
        boat.state.setpoint._replace(plan=boat.state.setpoint.plan._replace(then_home=True)),
    )
    helm.finish()
    assert boat.state.mode is Mode.HOLD
    assert boat.state.reason.startswith("play done, cannot go home: ")
    boat.state.motion = boat.state.motion._replace(has=frozenset())
    helm.finish()
    assert (boat.state.mode, boat.state.reason) == (
        Mode.IDLE,
        "hold done, cannot hold: no heading and no position and no velocity",
    )


def test_a_hold_within_a_pause_forgets_nothing(boat):
    helm = under_way(boat)
    boat.vehicle.on_command(console.Pause())
    helm.enter(Mode.HOLD, "shallow")
    assert boat.vehicle.on_command(console.Pause()) is None
    assert boat.state.reason == "shallow", "it holds already"
    assert boat.vehicle.on_command(console.Continue()) is None
    assert boat.state.mode is Mode.PLAY
    boat.vehicle.on_command(console.Stop())
    boat.vehicle.on_command(console.SetMode("hold"))
    assert boat.vehicle.on_command(console.Continue()) == "continue refused: nothing is paused"
    push(boat)
    boat.vehicle.on_command(console.SetMode("hold"))
    assert boat.vehicle.on_command(console.Continue()) == "continue refused: nothing is paused"


def test_play_that_was_left_begins_with_its_leg_and_one_that_was_done_does_not(boat):
    helm = under_way(boat)
    boat.vehicle.on_command(console.Stop())
    assert boat.state.setpoint.leg == 1
    assert boat.vehicle.on_command(console.Leg(2)) is None
    boat.vehicle.on_command(console.Heading(0.0))
    helm.memory = helm.memory._replace(leg=1)
    boat.vehicle.on_command(console.Stop())
    assert boat.state.setpoint.leg == 2, "of another mode it is none"
    assert boat.vehicle.on_command(console.SetMode("play")) is None
    assert (boat.state.reason, helm.memory.leg) == ("operator", 2)
    boat.vehicle.on_command(console.SetSpeed(0.6))
    assert boat.vehicle.on_command(console.Leg(1)) is None
    assert (helm.memory.leg, boat.state.setpoint.leg, boat.state.setpoint.override_mps) == (1, 1, 0.6)
    helm.memory, boat.state.reference = helm.memory._replace(leg=2), Reference(done=True)
    helm.enter(Mode.HOLD, "play done")
    assert boat.state.setpoint.leg == 1
    boat.vehicle.on_command(console.SetMode("play"))
    assert boat.state.setpoint.override_mps is None, "until the next change of mode"
    assert boat.vehicle.on_command(console.Leg(3)) == "leg refused: no leg 4: the mission has legs 1 to 3"


def test_a_speed_is_the_operators_until_it_is_given_up(boat):
    boat.ready()
    speeds = boat.vehicle.helm.settings.control.speed
    for asked_mps, speed_mps, override_mps in (
        (0.7, 0.7, 0.7),
        (None, speeds.cruise_mps, None),
        (99.0, *(speeds.max_mps,) * 2),
    ):
        boat.vehicle.on_command(console.SetSpeed(asked_mps))
        assert (boat.state.setpoint.speed_mps, boat.state.setpoint.override_mps) == (speed_mps, override_mps)
    boat.vehicle.on_command(console.SetSpeed(speed_pct=25.0))
    assert (boat.state.setpoint.speed_mps, boat.state.setpoint.override_mps) == (0.25 * speeds.max_mps,) * 2


def test_only_what_is_paused_is_continued_by_its_name(boat):
    under_way(boat)
    assert boat.vehicle.on_command(console.SetMode("play")) is None
    assert boat.state.reason == "operator", "it was under way"
    boat.vehicle.on_command(console.Pause())
    assert boat.vehicle.on_command(console.SetMode("play")) is None
    assert boat.state.reason == "operator continues"
    for name, mode in (("path", Mode.PATH), ("home", Mode.HOME)):
        boat.vehicle.on_command(console.Pause())
        assert boat.vehicle.on_command(console.SetMode(name)) is None
        assert (boat.state.mode, boat.state.reason) == (mode, "operator")
        boat.vehicle.on_command(console.SetMode("play"))


def test_a_point_that_is_too_far_away_is_refused(boat):
    boat.ready()
    assert boat.vehicle.on_command(console.Goto(39.6925, -9.2150)) == "goto refused: 111.0 km to go; up to 20 km are allowed"
    assert boat.state.mode is Mode.IDLE


def test_goto_goes_on_straight_and_home_along_the_track_as_it_is_now(boat):
    boat.ready()
    boat.vehicle.on_command(console.Goto(38.6930, -9.2150))
    boat.vehicle.on_command(console.Pause())
    assert boat.vehicle.on_command(console.Continue()) is None
    assert (boat.state.mode, boat.state.reason) == (Mode.GOTO, "operator continues")
    boat.vehicle.helm.track.restore(((500.0, 0.0), (0.0, 0.0)), 5.0)
    boat.vehicle.on_command(console.SetMode("home"))
    boat.vehicle.on_command(console.Pause())
    assert boat.vehicle.on_command(console.Continue()) is None
    assert (boat.state.mode, boat.state.reason) == (Mode.HOME, "operator")


def test_a_goto_behind_a_zone_says_that_it_looks_for_a_way(boat):
    boat.ready()
    helm = places(boat, 0.0, 0.0)
    helm.plans.fence = ROCK
    latitude_rad, longitude_rad = geodesy.from_plane(boat.state.origin, 0.0, 100.0)
    assert boat.vehicle.on_command(console.Goto(math.degrees(latitude_rad), math.degrees(longitude_rad))) is None
    assert boat.log.notes[-1] == "goto: the way leads through rock: a way round is looked for"


def test_a_mission_in_parts_is_loaded_with_its_last_one(boat):
    boat.ready()
    text, missing = MISSION.text, "mission refused: a part of its text is missing; send it again from the start"
    assert boat.vehicle.on_command(console.LoadMission(text[:50], more=True)) is None
    assert boat.state.setpoint.plan is None
    assert boat.vehicle.on_command(console.LoadMission(text[50:], 50)) is None
    assert boat.vehicle.report().mission == "survey"
    assert boat.vehicle.on_command(console.LoadMission(text[:50], more=True)) is None
    assert boat.vehicle.on_command(console.LoadMission(text[60:], 60)) == missing


def test_points_on_the_way_round_are_of_goto_alone(boat):
    helm = under_way(boat)
    boat.state.setpoint = boat.state.setpoint._replace(via=(Waypoint(0.0, 0.0, 1.0, 2.0),))
    boat.vehicle.on_command(console.Pause())
    assert boat.vehicle.on_command(console.Continue()) is None
    assert (boat.state.mode, helm.memory.leg) == (Mode.PLAY, 1)
    boat.vehicle.on_command(console.Pause())
    assert boat.vehicle.on_command(console.Unload()) is None
    refused = boat.vehicle.on_command(console.Continue())
    assert refused == "continue refused: the mission has changed since the pause; choose the mode again"


@pytest.mark.parametrize(("age_s", "refused"), [(5.0, None), (5.1, "grex refused: no set point from the guest")])
def test_the_guest_is_followed_while_its_word_is_young(boat, age_s, refused):
    boat.ready()
    boat.state.guest_s = boat.clock.monotonic_s() - age_s
    assert boat.vehicle.on_command(console.SetMode("grex")) == "grex refused: no set point from the guest computer"
    boat.state.setpoint = boat.state.setpoint._replace(guest_heading_rad=1.0)
    assert boat.vehicle.on_command(console.SetMode("grex")) == refused
    assert boat.vehicle.on_command(console.SetMode("hold")) is None


def test_after_a_restart_the_boat_goes_on_for_its_own_reason(boat):
    boat.ready()
    helm = boat.vehicle.helm
    helm.taken, memory = True, Memory(leg=3, north_m=math.pi)
    helm.request(Mode.HEADING, boat.state.setpoint, boat.clock.monotonic_s(), memory, "it was in heading")
    assert (boat.state.reason, helm.taken) == ("it was in heading", True)
    assert (helm.memory.leg, helm.memory.north_m) == (3, math.pi)
