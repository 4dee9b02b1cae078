"""The failsafe table: every trouble in every mode, the pause, the operator, and that nothing flaps or moves by itself."""

from collections.abc import Iterable
from itertools import pairwise
from types import SimpleNamespace

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from delfim import config
from delfim.base.modes import Mode
from delfim.canproxy.dsor.messages import BatteriesStatus, Fault, GpsStatus, Navigation, PropellerStatus, Status
from delfim.parts.energy.table import EnergyTable
from delfim.vehicle.build import triggers
from delfim.vehicle.failsafe.failsafe import (
    NO_TROUBLE,
    Action,
    AnyTrigger,
    Episode,
    Rules,
    Verdict,
    bits,
    fallback,
    news,
    overruled,
)
from delfim.vehicle.failsafe.failsafe import failsafe as look
from delfim.vehicle.failsafe.troubles import Inputs, Trigger, astray
from delfim.vehicle.plans.fence import Fence, polygon
from delfim.vehicle.report import EnergyFacts, HandsetReport
from delfim.vehicle.state import Actuation, Killed, Motion, Notice, Reference, Setpoint, State, ThrusterReport
from delfim.vehicle.target import Danger, Traffic

ALL = frozenset({"position", "heading", "velocity"})
BOW = config.ThrusterTable(name="bow", driver="pwm", y_m=0.0, thrust_n=(-10.0, 10.0))
SETTINGS = config.Vehicle(
    boat=config.BoatTable(name="test"),
    thrusters=(*config.Vehicle(boat=config.BoatTable(name="test")).thrusters, BOW),
    handset=config.HandsetTable(device="/dev/receiver"),
    failsafe=config.Failsafe(shallow=config.Shallow(min_depth_m=1.0), beyond=config.Beyond(above={"bilge.leak": 0.5})),
    energy=EnergyTable(capacity_wh=1000.0),
)
RULES = Rules(SETTINGS, triggers(SETTINGS))
OF_PARTS = SimpleNamespace(**{each.name: each for each in RULES.of_parts})
TRIGGERS = (*Trigger, *RULES.of_parts)
FENCE = Fence((polygon("square", True, [(-50.0, -50.0), (50.0, -50.0), (50.0, 50.0), (-50.0, 50.0)]),), config.FenceTable())
WELL = Inputs("", None)
OUTWARDS = Motion(ALL, 44.0, 0.0, 0.0, 0.0, 1.5, 0.0)
DRIVING = [mode for mode in Mode if mode is not Mode.IDLE]
UNDER_WAY = [mode for mode in DRIVING if mode is not Mode.MANUAL]


def state(mode: Mode, now_s: float = 100.0) -> State:
    """All well at that moment: everything was heard just now."""
    well = (Status.GOOD, Fault(0))
    here = State(mode=mode, motion=Motion(ALL, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), actuation=Actuation((0.5, 0.5), (0.0, 0.0), True))
    here.navigation = Navigation(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3, 9, 0.9, 0)
    if mode is Mode.IDLE:
        here.actuation = Actuation((0.0, 0.0), (0.0, 0.0), False)
    here.handset = HandsetReport(now_s, 0.0, 0.0, takes=False, kills=False)
    here.navigation_s = here.changed_s = here.console_s = here.manual_s = here.guest_s = now_s
    rpm = round(1200.0 * here.actuation.thrust[1])
    here.thrusters = {name: ThrusterReport(now_s, rpm) for name in ("starboard", "port")}
    here.thrusters["bow"] = ThrusterReport(now_s)
    here.sysstat = {
        "gps": (GpsStatus(*well, 3, 9, 0.9, 0), now_s),
        "propeller_starboard": (PropellerStatus(*well, rpm, 1.0, 20, 0), now_s),
        "propeller_port": (PropellerStatus(*well, rpm, 1.0, 20, 0), now_s),
        "batteries_starboard": (BatteriesStatus(*well, 48.0, 1.0, 0.9, 20), now_s),
        "batteries_port": (BatteriesStatus(*well, 48.0, 1.0, 0.9, 20), now_s),
    }
    return here


def troubled(trigger: AnyTrigger, mode: Mode, now_s: float = 100.0) -> tuple[State, Inputs]:
    """All well but for one trouble."""
    here, inputs = state(mode, now_s), WELL
    match trigger:
        case Trigger.CONTROL:
            here.reference = Reference(reason="no heading")
        case Trigger.NAVIGATION_JUMPING:
            here.jumping_s, here.jumped_s, here.jumped_m = now_s - 0.6, now_s, 40.0
        case Trigger.NAVIGATION_SILENT:
            here.navigation_s = now_s - 1.1
        case Trigger.NAVIGATION_FROZEN:
            here.changed_s = now_s - 3.1
        case Trigger.SENSOR_BAD:
            here.sysstat["gps"] = here.sysstat["gps"][0]._replace(status=Status.BAD, faults=Fault.NO_SIGNAL), now_s
        case Trigger.BATTERY_CRITICAL | Trigger.BATTERY_LOW:
            charge = 0.05 if trigger is Trigger.BATTERY_CRITICAL else 0.2
            here.sysstat["batteries_port"] = BatteriesStatus(Status.GOOD, Fault(0), 44.0, 1.0, charge, 20), now_s
        case Trigger.THRUSTER:
            here.thrusters["port"], here.overdue = ThrusterReport(now_s, 1100.0), ("port",)
            inputs = Inputs("", None, astray(RULES.settings, here, now_s))
        case Trigger.MANUAL_SILENT:
            here.manual_s = now_s - 5.1
        case Trigger.CONSOLE_SILENT:
            here.console_s = now_s - 10.1
        case Trigger.GUEST_SILENT:
            here.guest_s = now_s - 5.1
        case Trigger.FENCE:
            here.motion, inputs = OUTWARDS, Inputs("", FENCE)
        case Trigger.FENCE_LEFT:
            here.motion, inputs = OUTWARDS._replace(north_m=54.0, north_mps=0.0), Inputs("", FENCE)
        case Trigger.GNSS_POOR:
            assert here.navigation is not None
            here.navigation = here.navigation._replace(satellites=4)
        case Trigger.KILL:
            here.killed = Killed("kill switch: pressed")
        case Trigger.HANDSET_SILENT:
            here.handset = HandsetReport(now_s - 1.1, 0.0, 0.0, takes=False, kills=False)
        case OF_PARTS.ENERGY:
            here.energy = EnergyFacts(left_wh=300.0, home_wh=160.0, reserve_wh=150.0)
        case OF_PARTS.TRAFFIC:
            here.traffic = Traffic(dangers=(Danger("1", 40.0, 90.0, 0.5, "near", "MARIA is near"),))
        case OF_PARTS.TRAFFIC_CLOSE:
            here.traffic = Traffic(dangers=(Danger("1", 4.0, 9.0, 0.5, "danger", "MARIA is close"),))
        case OF_PARTS.AIS_SILENT:
            here.traffic = Traffic(heard_s=now_s - 180.1)
        case OF_PARTS.TRAFFIC_UNCLEAR:
            here.traffic = Traffic(unclear="more vessels than the boat can know")
        case Trigger.NAVIGATION_TWICE:
            here.twice.extend((now_s - 2.0, now_s - 1.0, now_s))
        case Trigger.OUTLET:
            here.thrusters["bow"] = ThrusterReport(now_s - 1.6)
        case Trigger.RESTARTED:
            here.restarted = "it was in play; hold now"
        case Trigger.LOG:
            inputs = Inputs("disk full", None)
        case _:
            _harm(here, trigger, now_s)
    return here, inputs


def _harm(here: State, trigger: AnyTrigger, now_s: float) -> None:
    """Bring about a trouble of the hull."""
    match trigger:
        case Trigger.SHALLOW:
            here.measured["depth_m"] = 0.9, now_s
        case Trigger.STUCK:
            here.reference = Reference(speed_mps=1.0)
        case Trigger.CAPSIZED:
            assert here.navigation is not None
            here.navigation = here.navigation._replace(roll_rad=-1.5)
        case Trigger.BEYOND:
            here.measured["bilge.leak"] = 1.0, now_s


def watched(trigger: AnyTrigger, mode: Mode, seconds: float, rules: Rules = RULES) -> Verdict:
    """The verdict after a trouble has lasted for so long."""
    verdict = Verdict(NO_TROUBLE, Action.NONE, "", ())
    for tick in range(round(seconds * 10) + 1):
        now_s = 100.0 + tick / 10
        verdict = look(rules, verdict.memory, *troubled(trigger, mode, now_s), now_s)
    return verdict


# The defaults, written down once more: (action, exceptions). Not in idle: there is nothing to stop.
TABLE: dict[AnyTrigger, tuple[Action, dict[Mode, Action]]] = {
    Trigger.CONTROL: (Action.STOP, {}),
    Trigger.NAVIGATION_JUMPING: (Action.STOP, {}),
    Trigger.NAVIGATION_SILENT: (Action.STOP, {}),
    Trigger.NAVIGATION_FROZEN: (Action.STOP, {}),
    Trigger.SENSOR_BAD: (Action.STOP, {}),
    Trigger.BATTERY_CRITICAL: (Action.STOP, {Mode.MANUAL: Action.WARN, Mode.HOME: Action.WARN}),
    Trigger.THRUSTER: (Action.STOP, {Mode.MANUAL: Action.WARN}),
    Trigger.MANUAL_SILENT: (Action.NONE, {Mode.MANUAL: Action.STOP}),
    Trigger.CONSOLE_SILENT: (Action.HOLD, {Mode.MANUAL: Action.STOP, **dict.fromkeys((Mode.HOME, Mode.UNSTICK), Action.WARN)}),
    Trigger.GUEST_SILENT: (Action.NONE, {Mode.GREX: Action.HOLD}),
    Trigger.FENCE: (Action.HOLD, {}),
    Trigger.FENCE_LEFT: (Action.STOP, {Mode.MANUAL: Action.WARN}),
    Trigger.BATTERY_LOW: (Action.HOLD, dict.fromkeys((Mode.MANUAL, Mode.HOME, Mode.UNSTICK), Action.WARN)),
    Trigger.LOG: (Action.WARN, {}),
    Trigger.GNSS_POOR: (Action.WARN, {}),
    Trigger.KILL: (Action.STOP, {}),
    Trigger.HANDSET_SILENT: (Action.WARN, {}),
    OF_PARTS.ENERGY: (Action.HOLD, dict.fromkeys((Mode.MANUAL, Mode.HOME, Mode.UNSTICK), Action.WARN)),
    OF_PARTS.TRAFFIC: (Action.WARN, {}),
    OF_PARTS.TRAFFIC_CLOSE: (Action.WARN, {}),
    OF_PARTS.AIS_SILENT: (Action.WARN, {}),
    OF_PARTS.TRAFFIC_UNCLEAR: (Action.WARN, {}),
    Trigger.OUTLET: (Action.STOP, {}),
    Trigger.RESTARTED: (Action.WARN, {}),
    Trigger.NAVIGATION_TWICE: (Action.STOP, {Mode.MANUAL: Action.WARN}),
    Trigger.STUCK: (Action.HOLD, dict.fromkeys((Mode.MANUAL, Mode.HOLD, Mode.TRIAL, Mode.UNSTICK), Action.NONE)),
    Trigger.CAPSIZED: (Action.STOP, {}),
    Trigger.BEYOND: (Action.HOLD, {Mode.MANUAL: Action.WARN, Mode.HOME: Action.WARN}),
    Trigger.SHALLOW: (Action.BACK, {Mode.MANUAL: Action.WARN, Mode.HOME: Action.WARN}),
}


def test_the_actions_differ_and_are_ordered_by_severity() -> None:
    names = "NONE WARN HOLD BACK UNSTICK HOME STOP DISCONNECT"
    assert [action.name for action in sorted(Action)] == names.split()
    assert list(Action) == list(range(8))


@pytest.mark.parametrize("mode", DRIVING, ids=lambda mode: mode.name)
@pytest.mark.parametrize("trigger", TRIGGERS, ids=lambda trigger: trigger.name)
def test_every_trouble_in_every_mode_does_what_the_table_says_and_says_why(trigger, mode):
    """16 s long: longer than any trouble must last, shorter than the pause before home."""
    usual, exceptions = TABLE[trigger]
    verdict = watched(trigger, mode, 16.0)
    assert verdict.action is exceptions.get(mode, usual)
    if verdict.action is not Action.NONE:
        notice = verdict.notices[0]
        assert notice.name == trigger.name.lower()
        assert Action[notice.action.upper()] is verdict.action
        assert verdict.reason == notice.reason != ""


@pytest.mark.parametrize("trigger", TRIGGERS, ids=lambda trigger: trigger.name)
def test_in_idle_nothing_is_done_but_a_runaway_propeller_is_disconnected(trigger):
    expected = {Trigger.THRUSTER: Action.DISCONNECT, Trigger.KILL: Action.STOP}.get(trigger, Action.WARN)
    assert watched(trigger, Mode.IDLE, 6.0).action in (expected, Action.NONE)
    assert watched(Trigger.THRUSTER, Mode.IDLE, 6.0).action is Action.DISCONNECT


def test_no_file_decides_what_a_kill_and_a_restart_do_and_idle_warns_but_of_a_runaway_propeller():
    for mode in Mode:
        assert RULES.actions[Trigger.KILL][mode] is Action.STOP
        assert RULES.actions[Trigger.RESTARTED][mode] is Action.WARN
    idle = {each: RULES.actions[each][Mode.IDLE] for each in TRIGGERS if each is not Trigger.KILL}
    assert idle == dict.fromkeys(idle, Action.WARN) | {Trigger.THRUSTER: Action.DISCONNECT}
    kept = msgspec.structs.replace(RULES.table, thruster=msgspec.structs.replace(RULES.table.thruster, disconnect=False))
    assert Rules(msgspec.structs.replace(SETTINGS, failsafe=kept)).actions[Trigger.THRUSTER][Mode.IDLE] is Action.WARN


def test_a_propeller_that_was_stopped_just_now_may_come_to_rest_first():
    here, inputs = troubled(Trigger.THRUSTER, Mode.IDLE, 110.0)
    memory = watched(Trigger.THRUSTER, Mode.PLAY, 9.9).memory
    assert look(RULES, memory, here, inputs, 110.0).action is Action.DISCONNECT
    here.overdue = ()
    assert look(RULES, memory, here, inputs, 110.0).action is Action.WARN


@pytest.mark.parametrize("mode", Mode, ids=lambda mode: mode.name)
def test_a_healthy_boat_hears_nothing(mode):
    assert look(RULES, NO_TROUBLE, state(mode), WELL, 100.0) == Verdict(NO_TROUBLE, Action.NONE, "", ())


@pytest.mark.parametrize(
    ("trigger", "reason"),
    [
        (Trigger.CONTROL, "no heading"),
        (Trigger.NAVIGATION_JUMPING, "position jumped by 40 m"),
        (Trigger.NAVIGATION_SILENT, "navigation silent for 1.1 s"),
        (Trigger.NAVIGATION_FROZEN, "navigation frozen for 3.1 s"),
        (Trigger.SENSOR_BAD, "gps bad: no signal"),
        (Trigger.BATTERY_CRITICAL, "batteries port at 5%"),
        (Trigger.THRUSTER, "port propeller turns 1100 instead of 600 rpm"),
        (Trigger.FENCE, "square 6.0 m away at 1.5 m/s"),
        (Trigger.LOG, "log not written: disk full"),
    ],
    ids=lambda each: getattr(each, "name", ""),
)
def test_reasons_are_for_people(trigger, reason):
    assert reason in [notice.reason for notice in watched(trigger, Mode.PLAY, 6.0).notices]


@pytest.mark.parametrize(
    ("mode", "age_s", "told"),
    [(Mode.IDLE, 0.0, False), (Mode.IDLE, 5.0, False), (Mode.IDLE, 5.1, True), (Mode.PLAY, 5.0, False), (Mode.PLAY, 5.1, True)],
)
def test_a_program_that_has_started_gives_each_node_its_time_to_report(mode, age_s, told):
    here = state(mode)
    here.started_s = 100.0 - age_s
    del here.sysstat["gps"]
    notices = look(RULES, NO_TROUBLE, here, WELL, 100.0).notices
    assert [notice.reason for notice in notices] == (["gps has not reported"] if told else [])
    here = troubled(Trigger.SENSOR_BAD, Mode.IDLE)[0]
    assert [notice.reason for notice in look(RULES, NO_TROUBLE, here, WELL, 100.0).notices] == ["gps bad: no signal"]


@pytest.mark.parametrize(
    ("trigger", "after_s"),
    [(Trigger.BATTERY_LOW, 5.0), (Trigger.BATTERY_CRITICAL, 5.0), (Trigger.THRUSTER, 4.0), (Trigger.LOG, 5.0)],
)
def test_what_must_last_does_nothing_before(trigger, after_s):
    assert watched(trigger, Mode.PLAY, after_s - 0.1).notices == ()
    assert watched(trigger, Mode.PLAY, after_s).notices != ()


def test_what_has_not_lasted_yet_is_forgotten_at_once():
    memory = watched(Trigger.THRUSTER, Mode.PLAY, 3.8).memory
    memory = look(RULES, memory, state(Mode.PLAY, 103.9), WELL, 103.9).memory
    verdict = look(RULES, memory, *troubled(Trigger.THRUSTER, Mode.PLAY, 104.0), 104.0)
    assert verdict.action is Action.NONE, "the four seconds begin again"


def sail(trigger: Trigger, there: Iterable[bool], mode: Mode = Mode.PLAY) -> list[tuple[Action, Mode]]:
    """Actions and modes of a boat that obeys, tick by tick, while a trouble comes and goes."""
    memory, seen = NO_TROUBLE, []
    for tick, troubling in enumerate(there):
        now_s = 100.0 + tick / 10
        here, inputs = troubled(trigger, mode, now_s) if troubling else (state(mode, now_s), WELL)
        verdict = look(RULES, memory, here, inputs, now_s)
        memory = verdict.memory
        if verdict.action > Action.WARN and mode is not Mode.IDLE:
            mode = fallback(verdict.action, verdict.reason, ALL, Setpoint(track=((0.0, 0.0),)))[0]
        seen.append((verdict.action, mode))
    return seen


def test_home_comes_after_a_hold_in_which_the_operator_may_overrule():
    seen = sail(Trigger.CONSOLE_SILENT, [True] * 310)
    assert {mode for _, mode in seen[:300]} == {Mode.HOLD}
    assert seen[300] == (Action.HOME, Mode.HOME)
    assert {mode for _, mode in seen[300:]} == {Mode.HOME}


def test_the_pause_is_counted_down_for_the_operator():
    verdict = watched(Trigger.BATTERY_LOW, Mode.HOLD, 15.0)
    assert verdict.reason == "batteries port at 20%; home in 20 s"
    memory = overruled(verdict.memory)
    verdict = look(RULES, memory, *troubled(Trigger.BATTERY_LOW, Mode.PLAY, 115.1), 115.1)
    assert verdict.action is Action.WARN, "he knows"
    assert verdict.notices[0].reason == "batteries port at 20%"


def test_who_is_overruled_is_not_heard_again_until_the_trouble_was_over():
    memory = overruled(watched(Trigger.BATTERY_LOW, Mode.PLAY, 6.0).memory)
    for tick in range(1, 1000):
        now_s = 106.0 + tick / 10
        verdict = look(RULES, memory, *troubled(Trigger.BATTERY_LOW, Mode.PLAY, now_s), now_s)
        memory = verdict.memory
        assert verdict.action is Action.WARN
    memory = look(RULES, memory, state(Mode.PLAY, 300.0), WELL, 300.0).memory
    assert memory == {}


@pytest.mark.parametrize("trigger", [Trigger.NAVIGATION_SILENT, Trigger.SENSOR_BAD, Trigger.FENCE, Trigger.CONTROL])
def test_a_stop_and_a_hold_cannot_be_overruled(trigger):
    verdict = watched(trigger, Mode.PLAY, 1.0)
    again = look(RULES, overruled(verdict.memory), *troubled(trigger, Mode.PLAY, 101.1), 101.1)
    assert again.action is verdict.action


def test_home_is_not_asked_for_again_where_the_boat_is_home():
    seen = sail(Trigger.CONSOLE_SILENT, [True] * 310)
    assert seen[-1][1] is Mode.HOME
    memory = watched(Trigger.CONSOLE_SILENT, Mode.HOLD, 30.5).memory
    verdict = look(RULES, memory, *troubled(Trigger.CONSOLE_SILENT, Mode.HOLD, 130.6), 130.6)
    assert verdict.action is Action.WARN


@settings(deadline=None, max_examples=50)
@given(st.sampled_from(list(Trigger)), st.lists(st.booleans(), max_size=600), st.sampled_from(UNDER_WAY))
def test_however_a_trouble_flickers_no_mode_is_entered_twice(trigger, there, mode):
    """From under way to hold, home or idle, and never back to what was left: no flapping."""
    modes = [mode, *(mode for _, mode in sail(trigger, there, mode))]
    entered = [mode, *(after for before, after in pairwise(modes) if after is not before)]
    assert len(set(entered)) == len(entered)
    assert set(entered[1:]) <= {Mode.HOLD, Mode.HOME, Mode.IDLE}


@settings(deadline=None)
@given(st.lists(st.booleans(), min_size=40, max_size=200))
def test_a_notice_does_not_flicker_with_its_cause(there):
    """It stays for `clear_s` after the trouble was last there."""
    memory, last_s = NO_TROUBLE, -1e9
    for tick, troubling in enumerate(there):
        now_s = 100.0 + tick / 10
        here, inputs = troubled(Trigger.SENSOR_BAD, Mode.IDLE, now_s) if troubling else (state(Mode.IDLE, now_s), WELL)
        verdict = look(RULES, memory, here, inputs, now_s)
        memory, last_s = verdict.memory, now_s if troubling else last_s
        assert bool(verdict.notices) is (now_s - last_s < config.Failsafe().clear_s)


def test_the_worst_of_two_troubles_decides_and_both_are_told():
    here, inputs = troubled(Trigger.GUEST_SILENT, Mode.GREX)
    here.navigation_s = 98.0
    verdict = look(RULES, NO_TROUBLE, here, inputs, 100.0)
    assert (verdict.action, verdict.reason) == (Action.STOP, "navigation silent for 2.0 s")
    assert [notice.name for notice in verdict.notices] == ["navigation_silent", "guest_silent"]


def test_the_worst_is_told_first_wherever_it_stands_in_the_table():
    here, inputs = troubled(Trigger.OUTLET, Mode.GREX)
    here.guest_s = 94.0
    told = look(RULES, NO_TROUBLE, here, inputs, 100.0).notices
    assert [(notice.name, notice.action) for notice in told] == [("outlet", "stop"), ("guest_silent", "hold")]


@pytest.mark.parametrize(("left_s", "action"), [(0.5, Action.HOLD), (0.0, Action.HOME), (-0.5, Action.HOME)])
def test_home_begins_when_the_pause_is_over(left_s, action):
    memory = {Trigger.CONSOLE_SILENT: Episode("console silent", 50.0, 99.9, 100.0 - RULES.pause_s + left_s, False)}
    assert look(RULES, memory, *troubled(Trigger.CONSOLE_SILENT, Mode.HOLD), 100.0).action is action


def test_who_was_sent_home_is_not_sent_again():
    memory = {Trigger.CONSOLE_SILENT: Episode("console silent", 50.0, 99.9, 60.0, False)}
    verdict = look(RULES, memory, *troubled(Trigger.CONSOLE_SILENT, Mode.HOLD), 100.0)
    assert verdict.action is Action.HOME
    assert verdict.memory[Trigger.CONSOLE_SILENT].answered
    assert look(RULES, verdict.memory, *troubled(Trigger.CONSOLE_SILENT, Mode.HOLD, 100.1), 100.1).action is Action.WARN


def test_of_two_troubles_that_weigh_the_same_the_first_in_the_table_decides():
    here, inputs = troubled(Trigger.SENSOR_BAD, Mode.PLAY)
    here.navigation_s = 98.0
    verdict = look(RULES, NO_TROUBLE, here, inputs, 100.0)
    assert (verdict.action, verdict.reason) == (Action.STOP, "navigation silent for 2.0 s")
    assert [notice.reason for notice in verdict.notices] == ["navigation silent for 2.0 s", "gps bad: no signal"]


def test_a_notice_says_since_when_and_its_trouble_is_kept_as_it_was():
    memory = watched(Trigger.SENSOR_BAD, Mode.PLAY, 1.0).memory
    verdict = look(RULES, memory, state(Mode.PLAY, 102.5), WELL, 102.5)
    assert verdict.notices == (Notice("sensor_bad", "gps bad: no signal", 100.0, "warn"),)
    assert dict(verdict.memory) == dict(memory)
    over_s = 101.0 + RULES.clear_s
    assert look(RULES, memory, state(Mode.PLAY, over_s), WELL, over_s).notices == ()


def test_with_a_thruster_that_failed_the_others_carry_on_while_the_boat_can_be_steered():
    memory = watched(Trigger.THRUSTER, Mode.PLAY, 5.0).memory
    for failed, unsteerable, action in (
        ({}, "", Action.STOP),
        ({"port": "it failed"}, "", Action.WARN),
        ({"port": "it failed"}, "why", Action.STOP),
    ):
        here, inputs = troubled(Trigger.THRUSTER, Mode.PLAY, 105.1)
        here.failed, here.unsteerable = failed, unsteerable
        assert look(RULES, memory, here, inputs, 105.1).action is action


def test_the_vehicles_file_changes_the_table():
    own = config.Failsafe(
        pause_s=0.0, console_silent=config.ConsoleSilent(after_s=3.0, action="warn", play="home", grex="stop")
    )
    rules = Rules(config.Vehicle(boat=config.BoatTable(name="test"), failsafe=own))
    asked = {mode: watched(Trigger.CONSOLE_SILENT, mode, 0.0, rules).action for mode in DRIVING}
    expected = dict.fromkeys(DRIVING, Action.WARN) | {Mode.PLAY: Action.HOME, Mode.GREX: Action.STOP, Mode.MANUAL: Action.STOP}
    assert asked == expected


@pytest.mark.parametrize(
    ("action", "has", "track", "mode", "reason"),
    [
        (Action.STOP, ALL, True, Mode.IDLE, "why"),
        (Action.HOLD, ALL, True, Mode.HOLD, "why"),
        (Action.BACK, ALL, True, Mode.HOLD, "why"),
        (Action.BACK, ALL - {"velocity"}, True, Mode.IDLE, "why; cannot hold: no velocity: heading and position only"),
        (Action.HOLD, ALL - {"position"}, True, Mode.IDLE, "why; cannot hold: no position: heading and velocity only"),
        (Action.HOLD, frozenset(), True, Mode.IDLE, "why; cannot hold: no heading and no position and no velocity"),
        (Action.HOME, ALL, True, Mode.HOME, "why"),
        (Action.HOME, ALL, False, Mode.HOLD, "why"),
        (Action.HOME, ALL - {"heading"}, True, Mode.IDLE, "why; cannot hold: no heading: position and velocity only"),
    ],
)
def test_what_cannot_be_done_becomes_the_next_safer_thing(action, has, track, mode, reason):
    assert fallback(action, "why", has, Setpoint(track=((0.0, 0.0),) if track else ())) == (mode, reason)


def test_a_report_of_revolutions_that_is_old_or_missing_proves_nothing():
    here = state(Mode.IDLE)
    for report in (ThrusterReport(98.0, 1100.0), ThrusterReport(100.0)):
        here.thrusters["port"] = report
        assert astray(RULES.settings, here, 100.0) == {}


def test_without_a_position_the_fence_cannot_be_watched():
    here = state(Mode.HEADING)
    here.motion = here.motion._replace(has=frozenset({"heading"}))
    verdict = look(RULES, NO_TROUBLE, here, Inputs("", FENCE), 100.0)
    assert (verdict.action, verdict.reason) == (Action.HOLD, "no position: the fence cannot be watched")
    here.mode = Mode.MANUAL
    assert look(RULES, NO_TROUBLE, here, Inputs("", FENCE), 100.0).action is Action.NONE, "the operator sees it"


def test_the_log_is_told_what_changed_and_has_a_bit_for_each():
    first, second = Notice("log", "disk full", 1.0, "warn"), Notice("fence", "rock 3.0 m away", 2.0, "hold")
    assert news((), (first,)) == ["log: disk full: warn"]
    assert news((first,), (first,)) == []
    assert news((first,), (second, first)) == ["fence: rock 3.0 m away: hold"]
    assert news((first, second), (first,)) == ["fence: over"]
    assert bits((first, second)) == 1 << Trigger.LOG | 1 << Trigger.FENCE
    assert bits(()) == 0
    assert {trigger.name.lower() for trigger in TRIGGERS} - {"control", "kill"} == {
        name for name in config.Failsafe.__struct_fields__ if name not in ("pause_s", "clear_s", "back_m")
    }
