"""Each trouble by itself: the value at which it begins, the last one at which it is none, and its words."""

import math
from collections import deque
from collections.abc import Collection
from itertools import product

import msgspec
import pytest

from delfim import config
from delfim.base.modes import Mode
from delfim.canproxy.dsor.messages import BatteriesStatus, Fault, PropellerStatus, Status
from delfim.vehicle.failsafe.failsafe import AnyTrigger
from delfim.vehicle.failsafe.troubles import (
    NUMBERS,
    Inputs,
    Look,
    Trigger,
    astray,
    charge,
    handset_missed,
    low,
    outlet_missed,
    troubles,
    unstopped,
    voltage,
)
from delfim.vehicle.inputhealth import KINDS, InputHealth
from delfim.vehicle.report import HandsetReport
from delfim.vehicle.state import Actuation, Killed, Reference, State, ThrusterReport
from delfim.vehicle.target import CourseOrder, Danger, Traffic
from tests.vehicle.test_failsafe import FENCE, OF_PARTS, OUTWARDS, RULES, TRIGGERS, WELL, state

NOW_S = 100.0
SETTINGS = RULES.settings
WITH = msgspec.structs.replace


def seen(
    trigger: AnyTrigger,
    here: State,
    inputs: Inputs = WELL,
    settings: config.Vehicle = SETTINGS,
    present: Collection[Trigger] = (),
) -> str | None:
    return trigger.sees(Look(settings, here, inputs, present, NOW_S))


def test_the_numbers_of_the_troubles_are_bits_of_the_log() -> None:
    """Logs of years have them."""
    names = (
        *("CONTROL", "NAVIGATION_JUMPING", "NAVIGATION_SILENT", "NAVIGATION_FROZEN", "SENSOR_BAD", "BATTERY_CRITICAL"),
        *("THRUSTER", "MANUAL_SILENT", "CONSOLE_SILENT", "GUEST_SILENT", "FENCE", "BATTERY_LOW", "LOG", "GNSS_POOR", "KILL"),
        *("HANDSET_SILENT", "SHALLOW", "TRAFFIC", "TRAFFIC_CLOSE", "AIS_SILENT", "FENCE_LEFT", "TRAFFIC_UNCLEAR"),
        *("RESTARTED", "OUTLET", "NAVIGATION_TWICE", "ENERGY", "STUCK", "CAPSIZED", "BEYOND"),
    )
    assert {name.lower(): number for number, name in enumerate(names)} == NUMBERS
    assert {trigger.name: int(trigger) for trigger in TRIGGERS} == {name: number for number, name in enumerate(names)}


@pytest.mark.parametrize(
    ("trigger", "mode", "field", "after_s", "words", "unwatched"),
    [
        (Trigger.NAVIGATION_SILENT, Mode.PLAY, "navigation_s", 1.0, "navigation silent for 1.1 s", None),
        (Trigger.NAVIGATION_FROZEN, Mode.PLAY, "changed_s", 3.0, "navigation frozen for 3.1 s", Mode.IDLE),
        (Trigger.MANUAL_SILENT, Mode.MANUAL, "manual_s", 5.0, "no manual command for 5.1 s", Mode.HEADING),
        (Trigger.CONSOLE_SILENT, Mode.PLAY, "console_s", 10.0, "console silent for 10.1 s", Mode.IDLE),
        (Trigger.GUEST_SILENT, Mode.GREX, "guest_s", 5.0, "guest silent for 5.1 s", Mode.PLAY),
    ],
    ids=lambda each: getattr(each, "name", ""),
)
def test_silence_begins_after_its_age(trigger, mode, field, after_s, words, unwatched) -> None:
    here = state(mode)
    setattr(here, field, NOW_S - after_s)
    assert seen(trigger, here) is None
    setattr(here, field, NOW_S - after_s - 0.1)
    assert seen(trigger, here) == words
    if unwatched is not None:
        here.mode = unwatched
        assert seen(trigger, here) is None


def test_navigation_that_never_came_is_told_so() -> None:
    here = State()
    assert seen(Trigger.NAVIGATION_SILENT, here) == "no navigation yet"


@pytest.mark.parametrize(
    ("thrust", "run", "is_told"),
    [
        ((0.04, -0.04), True, False),
        ((0.05, 0.0), True, True),
        ((0.0, -0.05), True, True),
        ((0.5, 0.5), False, False),
        ((), True, False),
    ],
)
def test_navigation_is_frozen_only_while_a_propeller_moves_the_boat(thrust, run, is_told) -> None:
    here = state(Mode.PLAY)
    here.changed_s, here.actuation = NOW_S - 4.0, Actuation(thrust, (0.0,) * len(thrust), run)
    assert (seen(Trigger.NAVIGATION_FROZEN, here) is not None) is is_told


@pytest.mark.parametrize(
    ("jumping_s", "jumped_s", "is_told"), [(99.5, 100.0, True), (99.6, 100.0, False), (98.0, 99.0, True), (98.0, 98.9, False)]
)
def test_positions_jump_for_half_a_second_and_are_forgotten_when_they_are_old(jumping_s, jumped_s, is_told) -> None:
    here = state(Mode.PLAY)
    here.jumping_s, here.jumped_s, here.jumped_m = jumping_s, jumped_s, 41.6
    settings = WITH(SETTINGS, navigation=WITH(SETTINGS.navigation, stale_s=1.0))
    assert seen(Trigger.NAVIGATION_JUMPING, here, settings=settings) == ("position jumped by 42 m" if is_told else None)


def test_an_input_of_the_estimator_is_told_although_its_navigation_goes_on() -> None:
    """Of the estimator that made the present navigation."""
    here = state(Mode.PLAY)
    inputs = [InputHealth(kind, *(NOW_S,) * 3, heard=9, value=(1.0,)) for kind in KINDS]
    inputs[2] = InputHealth("heading", NOW_S - 1.1, NOW_S, heard=9)
    inputs[0] = InputHealth("position", NOW_S, NOW_S - 3.1, jumping_s=NOW_S - 1.0, jumped_s=NOW_S, jump=41.6, heard=9)
    here.inputs[here.source] = tuple(inputs)
    told = {
        Trigger.NAVIGATION_SILENT: "heading silent for 1.1 s",
        Trigger.NAVIGATION_FROZEN: "position frozen for 3.1 s",
        Trigger.NAVIGATION_JUMPING: "position jumped by 42 m",
    }
    assert {trigger: seen(trigger, here) for trigger in told} == told
    here.inputs = {"another": tuple(inputs)}
    assert [seen(trigger, here) for trigger in told] == [None] * 3


@pytest.mark.parametrize(("ages_s", "is_told"), [((1.0, 0.0), False), ((10.0, 1.0, 0.0), True), ((10.1, 1.0, 0.0), False)])
def test_two_senders_are_three_messages_that_do_not_follow(ages_s, is_told) -> None:
    here = state(Mode.PLAY)
    here.twice = deque(NOW_S - age_s for age_s in ages_s)
    own = WITH(SETTINGS.failsafe, navigation_twice=config.NavigationTwice(after_s=10.0))
    assert (seen(Trigger.NAVIGATION_TWICE, here, settings=WITH(SETTINGS, failsafe=own)) is not None) is is_told


@pytest.mark.parametrize(
    ("reports", "has_power"),
    [
        ((), True),
        (((5.1, None), (5.1, None)), False),
        (((5.1, None), (5.0, None)), True),
        (((0.0, 4.9), (0.0, 0.0)), False),
        (((0.0, 4.9), (0.0, 5.0)), True),
        (((0.0, 4.9), (0.0, None)), True),
    ],
)
def test_a_kill_says_whether_the_thrusters_have_power(reports, has_power) -> None:
    here = state(Mode.IDLE)
    here.thrusters = {str(at): ThrusterReport(NOW_S - age_s, voltage_v=volts) for at, (age_s, volts) in enumerate(reports)}
    bad = PropellerStatus(Status.BAD, Fault(0), 0, 1.0, 20, 0), NOW_S
    here.sysstat |= {"propeller_starboard": bad, "propeller_port": bad}
    assert seen(Trigger.KILL, here) is None
    assert seen(Trigger.SENSOR_BAD, here) == "propeller starboard bad: no reason given", "nobody cut their power"
    here.killed = Killed("pressed")
    assert seen(Trigger.KILL, here) == "kill: pressed" + ("" if has_power else "; the thrusters have no power")
    assert (seen(Trigger.SENSOR_BAD, here) is None) is not has_power, "it is no fault of theirs"


UNHEARD = "gps has not reported"


def test_what_lies_idle_is_told_of_nodes_that_are_bad_and_of_values_that_are_required() -> None:
    here = state(Mode.IDLE)
    settings = WITH(SETTINGS, sensors=config.Sensors(required=("depth_m",), stale_s=5.0))
    assert seen(Trigger.SENSOR_BAD, here, settings=settings) == "depth_m not heard yet"
    here.measured["depth_m"] = 3.0, NOW_S - 5.0
    assert seen(Trigger.SENSOR_BAD, here, settings=settings) is None
    here.measured["depth_m"] = 3.0, NOW_S - 5.1
    assert seen(Trigger.SENSOR_BAD, here, settings=settings) == "depth_m silent for 5.1 s"
    nodes, here.measured["depth_m"] = here.sysstat.pop("gps"), (3.0, NOW_S)
    for age_s, mode, words in product((5.0, 5.1), (Mode.IDLE, Mode.PLAY), (UNHEARD, "depth_m not heard yet")):
        here.started_s, here.mode, here.measured = NOW_S - age_s, mode, {"depth_m": (3.0, NOW_S)} if words == UNHEARD else {}
        here.sysstat |= {} if words == UNHEARD else {"gps": (nodes[0], NOW_S)}
        told = words if age_s > 5.0 else None
        assert seen(Trigger.SENSOR_BAD, here, settings=settings) == told, "each has its time to report, after a restart, too"
        here.sysstat.pop("gps", None)
    for age_s, faults, is_told in ((5.0, Fault.NO_COMMAND, False), (5.1, Fault.NO_COMMAND, True), (5.0, Fault(5), True)):
        here.started_s, here.measured = NOW_S - age_s, {"depth_m": (3.0, NOW_S)}
        here.sysstat["gps"] = PropellerStatus(Status.BAD, faults, 0, 1.0, 20, 0), NOW_S
        assert (seen(Trigger.SENSOR_BAD, here, settings=settings) is not None) is is_told, "nobody commanded before the start"
    here.sysstat["gps"], here.started_s = (nodes[0], NOW_S - 9.0), NOW_S - 9.5
    assert seen(Trigger.SENSOR_BAD, here, settings=settings) == "gps silent for 9.0 s"


@pytest.mark.parametrize(
    ("age_s", "lost", "words"),
    [
        (None, "", "hand-set not heard yet"),
        (1.0, "", None),
        (1.1, "", "hand-set silent for 1.1 s"),
        (1.0, "no radio", None),
        (1.1, "no radio", "hand-set lost for 1.1 s: no radio"),
    ],
)
def test_the_hand_set_is_silent_after_its_age(age_s, lost, words) -> None:
    here = state(Mode.PLAY)
    report = HandsetReport(NOW_S - (age_s or 0.0), 0.0, 0.0, takes=False, kills=False, lost=lost)
    here.handset = None if age_s is None else report
    assert seen(Trigger.HANDSET_SILENT, here) == words
    assert seen(Trigger.HANDSET_SILENT, here, settings=WITH(SETTINGS, handset=config.HandsetTable())) is None
    assert handset_missed(config.HandsetTable(), here.handset, NOW_S) == ""


def batteries(
    here: State, starboard: tuple[float | None, float], port: tuple[float | None, float], age_s: float = 0.0
) -> State:
    for name, (part, volts) in (("starboard", starboard), ("port", port)):
        here.sysstat[f"batteries_{name}"] = BatteriesStatus(Status.GOOD, Fault(0), volts, 1.0, part, 20), NOW_S - age_s
    here.thrusters = {}
    return here


def test_the_emptier_side_counts_of_those_that_tell() -> None:
    here = state(Mode.PLAY)
    assert charge(State()) == (1.0, "")
    assert charge(batteries(here, (0.4, 48.0), (0.4, 48.0))) == (0.4, "batteries_starboard")
    assert charge(batteries(here, (0.4, 48.0), (0.3, 48.0))) == (0.3, "batteries_port")
    assert charge(batteries(here, (None, 48.0), (1.0, 48.0))) == (1.0, "batteries_port")
    assert charge(batteries(here, (None, 48.0), (None, 48.0))) == (1.0, "")


@pytest.mark.parametrize(
    ("part", "volts", "was_low", "words"),
    [
        (0.25, 48.0, False, "batteries port at 25%"),
        (0.26, 48.0, False, None),
        (0.27, 48.0, True, "batteries port at 27%"),
        (0.28, 48.0, True, None),
        (0.9, 44.0, False, "batteries port at 44.0 V"),
        (0.9, 44.1, False, None),
        (0.9, 46.2, True, "batteries port at 46.2 V"),
        (0.9, 46.3, True, None),
    ],
)
def test_batteries_are_low_at_their_limits_and_until_they_have_a_little_more(part, volts, was_low, words) -> None:
    here = batteries(state(Mode.PLAY), (0.9, 50.0), (part, volts))
    own = WITH(
        SETTINGS.failsafe, battery_low=config.BatteryLow(voltage_v=44.0), battery_critical=config.BatteryCritical(charge=0.25)
    )
    settings = WITH(SETTINGS, failsafe=own)
    present = [Trigger.BATTERY_LOW, Trigger.BATTERY_CRITICAL] if was_low else []
    assert seen(Trigger.BATTERY_LOW, here, settings=settings, present=present) == words
    assert seen(Trigger.BATTERY_CRITICAL, here, settings=settings, present=present) == (words if part < 0.5 else None)
    assert low(settings, config.BatteryLow(), here, NOW_S, was_low) == (words if part < 0.5 else None), "no volts are looked at"


def test_the_lowest_voltage_is_a_fresh_one_of_a_battery_that_is_not_dead() -> None:
    here = batteries(state(Mode.PLAY), (0.9, 50.0), (0.9, 5.0), age_s=5.0)
    assert voltage(SETTINGS, here, NOW_S) == (50.0, "batteries_starboard")
    here.thrusters = {"bow": ThrusterReport(NOW_S, voltage_v=5.1), "stern": ThrusterReport(NOW_S - 5.1, voltage_v=7.0)}
    assert voltage(SETTINGS, here, NOW_S) == (5.1, "bow thruster")
    assert voltage(SETTINGS, State(), NOW_S) == (math.inf, "")


def test_thrusters_astray_and_those_that_failed_are_told_together() -> None:
    here = state(Mode.PLAY)
    assert seen(Trigger.THRUSTER, here) is None
    assert seen(Trigger.THRUSTER, here, Inputs("", None, {"port": "port turns"})) == "port turns"
    here.failed = {"bow": "bow failed"}
    assert seen(Trigger.THRUSTER, here) == "bow failed"
    assert seen(Trigger.THRUSTER, here, Inputs("", None, {"port": "port turns"})) == "port turns, bow failed"
    here.unsteerable = "nothing pushes"
    assert seen(Trigger.THRUSTER, here) == "bow failed: nothing pushes"


@pytest.mark.parametrize(
    ("mode", "near", "left"),
    [
        (Mode.IDLE, "4.0 m outside the square", None),
        (Mode.MANUAL, "square 0.0 m away at 1.5 m/s", "4.0 m outside the square and not coming back"),
        (Mode.PLAY, "square 0.0 m away at 1.5 m/s", "4.0 m outside the square and not coming back"),
    ],
)
def test_in_idle_the_fence_is_told_where_the_boat_is_and_else_where_it_goes(mode, near, left) -> None:
    here, inputs = state(mode), Inputs("", FENCE)
    here.motion = OUTWARDS._replace(north_m=54.0)
    assert (seen(Trigger.FENCE, here, inputs), seen(Trigger.FENCE_LEFT, here, inputs)) == (near, left)
    assert seen(Trigger.FENCE, here) is seen(Trigger.FENCE_LEFT, here) is None
    here.motion = here.motion._replace(has=frozenset({"heading"}))
    blind = "no position: the fence cannot be watched" if mode is Mode.PLAY else None
    assert (seen(Trigger.FENCE, here, inputs), seen(Trigger.FENCE_LEFT, here, inputs)) == (blind, None)


@pytest.mark.parametrize(
    ("depth_m", "age_s", "words"),
    [(1.0, 0.0, None), (0.9, 0.0, "shallow: 0.9 m of water"), (0.9, 5.0, "shallow: 0.9 m of water"), (0.9, 5.1, None)],
)
def test_shallow_is_less_water_than_the_boat_needs_told_lately(depth_m, age_s, words) -> None:
    here = state(Mode.PLAY)
    assert seen(Trigger.SHALLOW, here) is None
    here.measured["depth_m"] = depth_m, NOW_S - age_s
    assert seen(Trigger.SHALLOW, here) == words


NEAR, NEAR_TOO = Danger("1", 40.0, 90.0, 0.5, "near", "MARIA is near"), Danger("2", 40.0, 90.0, 0.5, "near", "ANNA is near")
CLOSE, NONE = Danger("3", 4.0, 9.0, 0.5, "danger", "EVA is close"), Danger("4", 4e3, 9.0, 9.0, "none", "")


@pytest.mark.parametrize(
    ("told", "near", "close"),
    [
        (Traffic(), None, None),
        (Traffic(dangers=(NONE,)), None, None),
        (Traffic(guard="cannot avoid: no position"), None, None),
        (Traffic(dangers=(NONE,), guard="cannot avoid: no position"), "cannot avoid: no position", None),
        (Traffic(dangers=(NEAR,)), "MARIA is near", None),
        (Traffic(dangers=(NEAR, NEAR_TOO, CLOSE)), "MARIA is near, and 1 more", "EVA is close"),
        (Traffic(dangers=(NEAR, NEAR_TOO, NEAR), guard="on"), "MARIA is near, and 2 more", None),
        (
            Traffic(dangers=(CLOSE,), guard="cannot avoid: sea room"),
            "cannot avoid: sea room",
            "EVA is close; cannot avoid: sea room",
        ),
    ],
)
def test_traffic_is_told_by_the_nearest_of_each_level(told, near, close) -> None:
    here = state(Mode.PLAY)
    here.traffic = told
    assert (seen(OF_PARTS.TRAFFIC, here), seen(OF_PARTS.TRAFFIC_CLOSE, here)) == (near, close)


def test_an_order_of_the_guard_has_its_own_words() -> None:
    here = state(Mode.HOLD)
    order = CourseOrder(**{name: 0.0 for name in CourseOrder._fields if name != "words"}, words="gives way to MARIA")
    here.traffic, here.reference = Traffic(dangers=(NEAR, CLOSE), order=order), Reference(distance_m=12.4)
    assert seen(OF_PARTS.TRAFFIC, here) == "gives way to MARIA; 12 m from its place"
    assert seen(OF_PARTS.TRAFFIC_CLOSE, here) == "EVA is close"
    here.reference = Reference(distance_m=0.0)
    assert seen(OF_PARTS.TRAFFIC, here) == "gives way to MARIA"
    here.mode, here.reference = Mode.PLAY, Reference(distance_m=12.4)
    assert seen(OF_PARTS.TRAFFIC, here) == "gives way to MARIA"


def test_what_the_guard_cannot_judge_is_told_before_what_is_unclear() -> None:
    here = state(Mode.PLAY)
    for told, words in ((Traffic(), None), (Traffic(unclear="a"), "a"), (Traffic(unclear="a", unjudged="b"), "b")):
        here.traffic = told
        assert seen(OF_PARTS.TRAFFIC_UNCLEAR, here) == words


OWN = "AIS silent: own transponder not heard for 31 s"


@pytest.mark.parametrize(
    ("heard_s", "own_s", "words"),
    [
        (-1e9, -1e9, None),
        (180.0, -1e9, None),
        (180.6, -1e9, "AIS silent for 181 s: other vessels are not seen"),
        (30.0, 30.6, None),
        (30.6, 30.0, None),
        (30.6, 30.6, OWN),
        (-1e9, 30.6, OWN),
        (-1e9, 30.0, None),
    ],
)
def test_ais_is_silent_after_its_age_or_that_of_the_boats_own_transponder(heard_s, own_s, words) -> None:
    """Of ages; -1e9: never."""
    here = state(Mode.PLAY)
    here.traffic = Traffic(
        **{name: age if age < 0.0 else NOW_S - age for name, age in (("heard_s", heard_s), ("own_s", own_s))}
    )
    assert seen(OF_PARTS.AIS_SILENT, here) == words


@pytest.mark.parametrize(
    ("mmsi", "mode", "heard_s", "is_told"),
    [
        (263000009, Mode.PLAY, -1e9, True),
        (0, Mode.PLAY, -1e9, False),
        (263000009, Mode.IDLE, -1e9, False),
        (263000009, Mode.PLAY, 1.0, False),
    ],
)
def test_a_receiver_that_never_spoke_is_told_where_the_boat_has_a_transponder(mmsi, mode, heard_s, is_told) -> None:
    here, settings = state(mode), WITH(SETTINGS, traffic=WITH(SETTINGS.traffic, mmsi=mmsi))
    here.traffic = Traffic(heard_s=heard_s if heard_s < 0.0 else NOW_S - heard_s)
    words = "AIS never heard, not even the own transponder: other vessels are not seen" if is_told else None
    assert seen(OF_PARTS.AIS_SILENT, here, settings=settings) == words


@pytest.mark.parametrize(
    ("age_s", "refuses", "run", "words"),
    [
        (None, "", True, "the motors may turn: the outlet, which writes their pulses, has not answered yet"),
        (1.5, "", True, None),
        (1.6, "", True, "the motors may turn: the outlet, which writes their pulses, has been silent for 1.6 s"),
        (0.0, "no such chip", False, "the motors may turn: no such chip"),
        (0.0, "no such chip", True, None),
        (0.0, "", False, None),
    ],
)
def test_motors_may_turn_when_their_outlet_does_not_answer(age_s, refuses, run, words) -> None:
    here = state(Mode.PLAY)
    here.actuation = here.actuation._replace(run=run)
    here.thrusters = {} if age_s is None else {"bow": ThrusterReport(NOW_S - age_s, refuses=refuses)}
    assert seen(Trigger.OUTLET, here) == words
    assert outlet_missed(WITH(SETTINGS, thrusters=SETTINGS.thrusters[:2]), here, NOW_S) == ""


def test_what_others_found_is_told_in_their_words() -> None:
    here = state(Mode.PLAY)
    assert troubles(Look(SETTINGS, here, WELL, (), NOW_S)) == []
    here.restarted, here.reference = "it was in play", Reference(reason="no heading")
    assert troubles(Look(SETTINGS, here, Inputs("disk full", None), (), NOW_S)) == [
        (Trigger.CONTROL, "no heading"),
        (Trigger.LOG, "log not written: disk full"),
        (Trigger.RESTARTED, "it was in play"),
    ]
    here.mode = Mode.IDLE
    assert seen(Trigger.CONTROL, here) is None


TURNS = config.Steer(kind="azimuth", angle_max_deg=90.0, rate_dps=90.0)
POD = config.ThrusterTable(name="pod", driver="pwm", address=3, thrust_n=(-10.0, 10.0), rpm_max=1000.0, steer=TURNS)
PLAIN = config.ThrusterTable(name="plain", driver="pwm", address=4, thrust_n=(-10.0, 10.0))
NODE = SETTINGS.thrusters[0]


@pytest.mark.parametrize(
    ("row", "thrust", "run", "report", "words"),
    [
        (POD, 0.4, True, ThrusterReport(-1.0, 699.0), None),  # too old to count
        (POD, 0.4, True, ThrusterReport(-1.0, 900.0), "propeller turns 900 instead of 400 rpm"),
        (POD, 0.4, True, ThrusterReport(-1.1, 900.0), None),
        (POD, 0.4, True, ThrusterReport(-5.0), None),
        (POD, 0.4, True, ThrusterReport(-5.1), "propeller silent for 5.1 s"),
        (POD, 0.4, False, ThrusterReport(-5.1), None),
        (NODE, 0.4, True, ThrusterReport(-5.1), None),  # sysstat tells of it
        (POD, 0.4, True, ThrusterReport(0.0, refuses="it is hot"), "thruster does not obey: it is hot"),
        (POD, 0.4, False, ThrusterReport(0.0, refuses="it is hot"), None),
        (POD, 0.4, True, ThrusterReport(0.0, 800.0), None),  # 300 and a quarter of 400 rpm
        (POD, 0.4, True, ThrusterReport(0.0, 801.0), "propeller turns 801 instead of 400 rpm"),
        (POD, 0.4, True, ThrusterReport(0.0, 0.0), None),
        (POD, 0.4, True, ThrusterReport(0.0, -1.0), "propeller turns -1 instead of 400 rpm"),
        (POD, -0.4, True, ThrusterReport(0.0, -800.0), None),
        (POD, -0.4, True, ThrusterReport(0.0, -801.0), "propeller turns -801 instead of -400 rpm"),
        (POD, 0.4, False, ThrusterReport(0.0, 100.0), None),
        (POD, 0.4, False, ThrusterReport(0.0, -101.0), "propeller turns -101 instead of 0 rpm"),
        (PLAIN, 0.29, True, ThrusterReport(0.0, 0.0), None),
        (PLAIN, 0.3, True, ThrusterReport(0.0, 0.9), "propeller stands still at 30% thrust"),
        (PLAIN, -0.5, True, ThrusterReport(0.0, -0.9), "propeller stands still at -50% thrust"),
        (PLAIN, 0.5, True, ThrusterReport(0.0, 1.0), None),
        (PLAIN, 0.5, True, ThrusterReport(0.0, -1.0), "propeller turns -1 rpm at 50% thrust"),
        (PLAIN, -0.5, True, ThrusterReport(0.0, -1.0), None),
        (POD, 0.4, True, ThrusterReport(0.0, angle_rad=math.radians(29.9)), None),
        (POD, 0.4, True, ThrusterReport(0.0, angle_rad=math.radians(-10.0)), None),
        (POD, 0.4, True, ThrusterReport(0.0, angle_rad=math.radians(31.0)), "thruster stands at 31 instead of 10 degrees"),
        (POD, 0.4, True, ThrusterReport(0.0, angle_rad=math.radians(-11.0)), "thruster stands at -11 instead of 10 degrees"),
        (
            POD,
            0.4,
            True,
            ThrusterReport(0.0, 400.0, angle_rad=math.radians(31.0)),
            "thruster stands at 31 instead of 10 degrees",
        ),
        (POD, 0.4, False, ThrusterReport(0.0, angle_rad=math.radians(31.0)), None),
    ],
)
def test_a_thruster_is_astray_beyond_its_limits(row, thrust, run, report, words) -> None:
    """`heard_s` of these reports is how long ago they came."""
    here, settings = state(Mode.PLAY), WITH(SETTINGS, thrusters=(*SETTINGS.thrusters[:2], POD, PLAIN))
    here.actuation = Actuation((thrust,) * 4, (math.radians(10.0),) * 4, run)
    here.thrusters = {row.name: report._replace(heard_s=NOW_S + report.heard_s)}
    found = {} if words is None else {row.name: f"{row.name} {words}"}
    assert astray(settings, here, NOW_S) == found
    assert unstopped(settings, here, NOW_S) == (() if run else tuple(found))
    here.actuation = Actuation((), (), run)
    assert astray(settings, here, NOW_S) == {}, "nothing was commanded yet"


def going(speed_mps: float, asked_mps: float, thrust: float, mode: Mode = Mode.PLAY) -> State:
    here = state(mode)
    here.motion = here.motion._replace(north_mps=speed_mps)
    here.actuation, here.reference = Actuation((thrust,) * 3, (0.0,) * 3, True), Reference(speed_mps=asked_mps)
    return here


@pytest.mark.parametrize(
    ("speed_mps", "asked_mps", "thrust", "mode", "is_told"),
    [
        (0.19, 0.4, 0.3, Mode.PLAY, True),
        (0.2, 0.4, 0.3, Mode.PLAY, False),
        (0.0, 0.39, 0.3, Mode.PLAY, False),
        (0.0, 1.5, 0.29, Mode.PLAY, False),
        (0.0, 1.5, -0.9, Mode.HEADING, False),
        *((0.0, 1.5, 0.9, mode, mode not in (Mode.IDLE, Mode.MANUAL, Mode.HOLD, Mode.TRIAL, Mode.UNSTICK)) for mode in Mode),
    ],
)
def test_a_boat_that_pushes_and_does_not_go_is_stuck(speed_mps, asked_mps, thrust, mode, is_told) -> None:
    here = going(speed_mps, asked_mps, thrust, mode)
    assert (seen(Trigger.STUCK, here) is not None) is is_told
    here.motion = here.motion._replace(has=frozenset({"heading", "position"}))
    assert seen(Trigger.STUCK, here) is None, "nobody knows its speed"


def test_a_push_to_the_side_is_none_ahead() -> None:
    first, *others = SETTINGS.thrusters
    rows = first, *(WITH(row, driver="pwm", angle_deg=90.0) for row in others)
    here = going(0.0, 1.5, 0.9)
    here.actuation = here.actuation._replace(thrust=(0.2, 0.9, 0.9))
    assert seen(Trigger.STUCK, here, settings=WITH(SETTINGS, thrusters=rows)) is None


@pytest.mark.parametrize(
    ("off_deg", "turn_dps", "thrust", "is_told"),
    [
        (46.0, 1.4, 0.3, True),
        (44.0, 0.0, 0.3, False),
        (-90.0, 1.6, 0.9, False),
        (-90.0, -1.4, 0.9, True),
        (90.0, 0.0, 0.2, False),
    ],
)
def test_a_boat_that_does_not_turn_is_stuck(off_deg, turn_dps, thrust, is_told) -> None:
    here = going(1.0, 1.0, thrust)
    here.reference = Reference(heading_rad=math.radians(off_deg), speed_mps=1.0)
    here.motion = here.motion._replace(yaw_rate_radps=math.radians(turn_dps))
    words = f"stuck: {abs(off_deg):.0f} degrees off its heading, and it does not turn at {thrust:.0%} thrust"
    assert seen(Trigger.STUCK, here) == (words if is_told else None)


@pytest.mark.parametrize(("roll_deg", "is_told"), [(60.5, True), (-60.5, True), (59.5, False), (None, False)])
def test_a_boat_on_its_side_has_capsized(roll_deg, is_told) -> None:
    here = state(Mode.HOLD)
    assert here.navigation is not None
    here.navigation = here.navigation._replace(roll_rad=None if roll_deg is None else math.radians(roll_deg))
    assert (seen(Trigger.CAPSIZED, here) is not None) is is_told


@pytest.mark.parametrize(
    ("name", "value", "age_s", "words"),
    [
        ("bilge.leak", 0.6, 5.0, "bilge.leak is 0.6, above 0.5"),
        ("bilge.leak", 0.5, 0.0, None),
        ("bilge.leak", 0.6, 5.1, None),
        ("bilge.leak", math.nan, 0.0, None),
        ("volts", 10.9, 0.0, "volts is 10.9, below 11"),
        ("volts", 11.0, 0.0, None),
        ("other", 99.0, 0.0, None),
    ],
)
def test_a_value_is_beyond_its_bound_while_it_is_fresh(name, value, age_s, words) -> None:
    here = state(Mode.PLAY)
    here.measured[name] = value, NOW_S - age_s
    bounds = config.Beyond(above={"bilge.leak": 0.5}, below={"volts": 11.0})
    own = WITH(SETTINGS, failsafe=WITH(SETTINGS.failsafe, beyond=bounds))
    assert seen(Trigger.BEYOND, here, settings=own) == words


@pytest.mark.parametrize(
    ("told", "runs", "words"),
    [
        ({"current_a": 25.1}, True, "port thruster is overloaded: 25 A of 25"),
        ({"current_a": 25.0, "temperature_c": 80.0}, True, None),
        ({"temperature_c": 80.6}, True, "port thruster is too hot: 81 of 80 degrees"),
        ({"temperature_c": 90.0}, False, None),
        ({}, True, None),
    ],
)
def test_a_motor_is_overloaded_by_what_it_tells(told, runs, words) -> None:
    limits = WITH(SETTINGS.failsafe.thruster, current_a=25.0, temperature_c=80.0)
    own = WITH(SETTINGS, failsafe=WITH(SETTINGS.failsafe, thruster=limits))
    here = state(Mode.PLAY if runs else Mode.IDLE)
    here.thrusters["port"] = here.thrusters["port"]._replace(**told)
    assert astray(own, here, NOW_S).get("port") == words
    assert "port" not in astray(SETTINGS, here, NOW_S), "without limits nothing is too much"
