"""The checks before the start: a line and a reason each, and the one door that reads them."""

import math

import msgspec
import pytest
from msgspec.structs import replace

from delfim import config
from delfim.base.frames import Frame
from delfim.base.modes import Mode
from delfim.canproxy.dsor import messages
from delfim.canproxy.dsor.messages import BatteriesStatus, Fault, Node, Status
from delfim.vehicle import console
from delfim.vehicle.failsafe.checks import checks, refusal
from delfim.vehicle.failsafe.failsafe import Rules
from delfim.vehicle.failsafe.troubles import Inputs
from delfim.vehicle.inputhealth import InputHealth
from delfim.vehicle.plans.fence import Fence
from delfim.vehicle.report import Check, ClockStatus, HandsetReport
from delfim.vehicle.state import HANDSET, StartConditions, State, ThrusterReport
from tests.vehicle.test_pause import MISSION

AROUND = config.FenceTable(
    keep_in=(config.Area(polygon=((38.692, -9.216), (38.693, -9.216), (38.693, -9.214), (38.692, -9.214))),)
)


WELL = Inputs("", None)


def lines(boat) -> dict[str, tuple[bool, str]]:
    return {line.name: (line.ok, line.reason) for line in boat.vehicle.helm.checks()}


def charge(boat, part: float) -> None:
    status = BatteriesStatus(Status.GOOD, Fault(0), 44.0, 1.0, part, 20)
    boat.nodes.sendmsg(Frame(messages.sysstat_arb(Node.BATTERIES_PORT), messages.pack_batteries_status(status)))
    boat.vehicle.on_sensor(boat.sensor)


def test_a_boat_that_nobody_has_heard_of_says_so_line_by_line(boat):
    assert lines(boat) == {
        "kill": (True, "none"),
        "computer": (True, "started"),
        "navigation": (False, "no navigation yet"),
        "sensors": (False, "gps has not reported"),
        "gnss": (True, "not heard"),
        "clock": (True, "navigation gives no time to compare with"),
        "log": (True, "being written"),
        "battery": (True, "no charge reported"),
        "fence": (True, "none"),
        "mission": (True, "none loaded"),
        "hand-set": (True, "the boat has none"),
        "link": (False, "console never heard"),
        "last shutdown": (True, "no fault known"),
        "image": (True, "confirmed, or the computer has no image slots"),
    }


def test_a_boat_that_is_ready_says_what_it_knows(boat):
    boat.ready()
    boat.vehicle.on_command(console.Alive())
    known = lines(boat)
    assert all(ok for ok, _ in known.values())
    assert known["navigation"] == (True, "dsor, 0.0 s old")
    assert known["sensors"] == (True, "5 nodes report good")
    assert known["gnss"] == (True, "3D, 9 satellites, HDOP 0.9")
    assert known["battery"] == (True, "batteries starboard at 90%")
    assert known["link"] == (True, "console heard 0.0 s ago")


@pytest.mark.parametrize(("off_s", "ok"), [(-6.0, False), (-4.0, True), (0.0, True), (4.0, True), (6.0, False)])
def test_the_clock_is_held_against_that_of_navigation(boat, off_s, ok):
    boat.ready()
    boat.clock.step(off_s)
    assert lines(boat)["clock"] == (ok, f"the computer's clock is {off_s:+.1f} s off navigation's")


def test_a_clock_that_was_never_set_is_no_clock(boat):
    boat.ready()
    boat.clock.step(-40 * 365 * 86_400.0)
    assert lines(boat)["clock"] == (False, "the computer's clock was never set")


def test_the_line_says_who_keeps_the_clock_and_why_a_time_is_not_taken(boat):
    boat.ready()
    kept = ClockStatus("kept by this program", "the time frame", 0.0, "")
    boat.state.computer = StartConditions(clock=kept)
    words = "the computer's clock is +0.0 s off navigation's; kept by this program, compared with the time frame"
    assert lines(boat)["clock"] == (True, words)
    boat.state.computer = StartConditions(clock=replace(kept, fault="the time frame jumps by +1.4 s: it is not taken"))
    assert lines(boat)["clock"] == (False, f"{words}; the time frame jumps by +1.4 s: it is not taken")
    boat.clock.step(-40 * 365 * 86_400.0)
    boat.state.computer = StartConditions(clock=ClockStatus("kept by chronyd"))
    assert lines(boat)["clock"] == (False, "the computer's clock was never set; kept by chronyd")


@pytest.mark.parametrize("off_s", [-40 * 365 * 86_400.0, -1024 * 7 * 86_400.0, -86_400.0, 6.0, 1024 * 7 * 86_400.0])
def test_a_wrong_clock_strands_no_boat(make_boat, off_s):
    """It is told, and every mode can be entered: by hand, or home."""
    for command in (
        console.Manual(0.2, 0.2),
        console.SetMode("hold"),
        console.Heading(0.0),
        console.SetMode("home"),
        console.Arm(),
    ):
        boat = make_boat()
        boat.ready()
        boat.clock.step(off_s)
        assert not lines(boat)["clock"][0]
        assert boat.vehicle.on_command(command) is None
        assert boat.state.armed


def test_a_computer_that_nobody_watches_over_yet_turns_nothing(boat):
    boat.ready()
    boat.state.computer = StartConditions(is_starting=True)
    reason = "the program is still starting and the dead-man does not watch it yet; wait a few seconds"
    assert lines(boat)["computer"] == (False, reason)
    for command in (console.Manual(0.5, 0.5), console.Heading(0.0), console.SetMode("hold"), console.Goto(38.69, -9.21)):
        assert boat.vehicle.on_command(command).endswith(f" refused: {reason}")
    boat.state.computer = StartConditions()
    assert boat.vehicle.on_command(console.Heading(0.0)) is None


def test_a_last_charge_is_for_the_way_home_and_for_the_hand(boat):
    boat.ready()
    charge(boat, 0.11)
    assert lines(boat)["battery"] == (True, "batteries port at 11%")
    charge(boat, 0.06)
    assert lines(boat)["battery"] == (False, "batteries port at 6%")
    assert boat.vehicle.on_command(console.Heading(0.0)) == "heading refused: batteries port at 6%"
    assert boat.vehicle.on_command(console.SetMode("home")) is None
    assert boat.vehicle.on_command(console.Manual(0.1, 0.1)) is None


def test_a_boat_outside_its_fence_is_driven_back_by_hand(make_boat):
    boat = make_boat(fence=AROUND)
    boat.report()
    assert boat.navigate(latitude_rad=math.radians(38.6931))
    assert lines(boat)["fence"] == (False, "11.1 m outside the keep-in zone")
    assert boat.vehicle.on_command(console.Heading(180.0)) == "heading refused: 11.1 m outside the keep-in zone"
    assert boat.vehicle.on_command(console.Manual(0.5, 0.5)) is None


def test_a_fence_without_a_position_refuses_what_does_not_need_one(make_boat):
    boat = make_boat(fence=AROUND)
    boat.report()
    assert boat.navigate(latitude_rad=None)
    refused = boat.vehicle.on_command(console.Heading(180.0))
    assert refused == "heading refused: no position: the fence cannot be watched"


def test_what_is_only_told_keeps_nobody_on_the_quay(boat):
    boat.ready()
    boat.state.computer = StartConditions(last_shutdown="the power was cut")
    assert lines(boat)["last shutdown"] == (False, "the power was cut")
    boat.state.computer = StartConditions(image="not confirmed yet")
    assert lines(boat)["image"] == (False, "not confirmed yet")
    assert boat.vehicle.on_command(MISSION) is None
    assert lines(boat)["mission"] == (True, "survey, 3 waypoints")
    assert boat.vehicle.on_command(console.Heading(0.0)) is None
    assert boat.state.mode is Mode.HEADING


def test_the_state_for_the_console_has_the_lines_and_the_present_troubles(boat):
    boat.log.why = "disk full"
    boat.ready()
    boat.pass_time(6.0)
    told = boat.vehicle.report()
    assert Check("log", False, "no log, no start: disk full") in told.checks
    notice = next(each for each in told.notices if each.name == "log")
    assert (notice.reason, notice.action) == ("log not written: disk full", "warn")
    assert notice.age_s == pytest.approx(5.9, abs=0.2)


@pytest.mark.parametrize(
    ("told", "limits", "reason"),
    [
        ({"satellites": 4}, {}, "4 satellites"),
        ({"hdop": 5.4}, {}, "HDOP 5.4"),
        ({"fix": 2, "satellites": 3}, {"fix": "3d"}, "2D fix, 3 satellites"),
        ({"fix": 6}, {"fix": "rtk"}, "RTK float fix"),
        ({"fix": 4}, {"fix": "rtk_float"}, "differential fix"),
        ({"fix": 5}, {"fix": "rtk_float"}, None),
        ({"fix": 6}, {"fix": "rtk_float"}, None),
        ({"satellites": 0}, {}, None),  # not told, as by a bus that sends no PGN 129029
        ({"hdop": None}, {}, None),
        ({"fix": 2, "satellites": 0, "hdop": None}, {"fix": "rtk"}, None),
        ({"fix": 9}, {"fix": "rtk"}, None),
        ({"accuracy_m": 0.014}, {"accuracy_m": 0.05}, None),
        ({"accuracy_m": 1.26}, {"accuracy_m": 0.05}, "accuracy 1.3 m"),
        ({"accuracy_m": 0.081, "satellites": 4}, {"accuracy_m": 0.05}, "4 satellites, accuracy 0.08 m"),
        ({}, {"accuracy_m": 0.05}, "accuracy not told"),
        ({"fix": 2, "satellites": 0, "hdop": None}, {"accuracy_m": 0.05}, "accuracy not told"),
        ({"accuracy_m": 50.0, "corrections_s": 600.0}, {}, None),  # no limits
        ({"corrections_s": 10.0}, {"corrections_s": 10.0}, None),
        ({"corrections_s": 15.0}, {"corrections_s": 10.0}, "corrections 15 s old"),
        ({}, {"corrections_s": 10.0}, "no corrections"),
    ],
)
def test_poor_satellite_navigation_is_a_line_and_keeps_out_of_a_mode_whose_key_says_so(make_boat, told, limits, reason):
    boat = make_boat(failsafe=config.Failsafe(gnss_poor=config.GnssPoor(heading="stop", **limits)))
    boat.ready()
    boat.navigate(**told)
    ok, words = lines(boat)["gnss"]
    assert ok is (reason is None)
    refused = boat.vehicle.on_command(console.Heading(90.0))
    if reason is not None:
        assert words == f"satellite navigation poor: {reason}"
        assert refused == f"heading refused: {words}"
    assert (refused is None) is ok
    assert boat.vehicle.on_command(console.SetMode("hold")) is None, "whose key says to warn"


@pytest.mark.parametrize(
    ("told", "reason"),
    [
        ({"satellites": 4}, "4 satellites"),
        ({"accuracy_m": 0.4}, "accuracy 0.40 m"),
        ({"corrections_s": 20.0}, "corrections 20 s old"),
    ],
)
def test_satellite_navigation_that_becomes_poor_does_what_the_table_says(make_boat, told, reason):
    limits = config.GnssPoor(after_s=1.0, heading="hold", accuracy_m=0.1, corrections_s=15.0)
    boat = make_boat(failsafe=config.Failsafe(gnss_poor=limits))
    well = {"accuracy_m": 0.014, "corrections_s": 1.0}
    boat.ready()
    boat.navigate(**well)
    boat.vehicle.on_command(console.Heading(90.0, 1.0))
    for seconds, mode in ((0.6, Mode.HEADING), (0.8, Mode.HOLD)):
        for _ in range(round(seconds * 10)):
            boat.clock.advance(0.1)
            boat.navigate(**(well | told))
            boat.vehicle.on_watchdog()
        assert boat.state.mode is mode
    assert boat.state.reason == f"satellite navigation poor: {reason}"


PLAIN = config.Vehicle(boat=config.BoatTable(name="test"))
LINES = {
    *("kill", "computer", "navigation", "sensors", "outlet", "gnss", "clock", "log", "battery", "fence", "mission", "hand-set"),
    *("link", "last shutdown", "image"),
}
TOLD = {"clock", "mission", "link", "last shutdown", "image"}  # and no more
WARN, HOLD, STOP = ({"action": word} for word in ("warn", "hold", "stop"))


def allowed(line: str, at_sea: bool = False, vehicle: config.Vehicle = PLAIN, **failsafe: config.Trouble) -> set[Mode]:
    """The modes that may be entered although this line alone is not in order."""
    rules = Rules(msgspec.structs.replace(vehicle, failsafe=config.Failsafe(**failsafe)))
    wrong = [Check(name, name != line, f"why {name}") for name in sorted(LINES)]
    told = {mode: refusal(rules, mode, wrong, at_sea) for mode in Mode}
    assert {reason for reason in told.values() if reason is not None} <= {f"why {line}"}
    return {mode for mode in Mode if told[mode] is None}


def test_a_line_that_is_only_told_forbids_nothing_and_the_first_of_the_others_is_the_reason():
    assert {line for line in LINES if allowed(line) == set(Mode)} == TOLD | {"gnss", "hand-set"}
    both = [
        Check("link", False, "a"),
        Check("kill", True, "b"),
        Check("computer", False, "c"),
        Check("sensors", False, "d"),
    ]
    assert refusal(Rules(PLAIN), Mode.HEADING, both, False) == "c"
    assert refusal(Rules(PLAIN), Mode.HEADING, [], False) is None


@pytest.mark.parametrize(
    ("line", "key", "table", "ashore", "at_sea"),
    [
        ("kill", "log", config.LogNotWritable, (False, False, False), (False, False, False)),
        ("navigation", "navigation_silent", config.NavigationSilent, (False, False, False), (True, True, False)),
        ("sensors", "sensor_bad", config.SensorBad, (False, False, False), (True, True, False)),
        ("hand-set", "handset_silent", config.HandsetSilent, (False, False, False), (True, True, False)),
        ("log", "log", config.LogNotWritable, (False, False, False), (True, True, False)),
        ("gnss", "gnss_poor", config.GnssPoor, (True, False, False), (True, False, False)),
        ("outlet", "outlet", config.OutletSilent, (True, False, False), (True, False, False)),
        ("battery", "battery_critical", config.BatteryCritical, (True, True, False), (True, True, False)),
    ],
)
def test_a_line_forbids_a_mode_by_the_table_of_its_trouble(line, key, table, ashore, at_sea):
    """In heading, which has no key of its own: where the boat is only warned, holds, or stops."""
    handset = config.HandsetTable(device="/dev/receiver", mandatory=True)
    vehicle = msgspec.structs.replace(PLAIN, handset=handset)
    for how, may, may_at_sea in zip((WARN, HOLD, STOP), ashore, at_sea, strict=True):
        rows = {key: table(**how)}
        assert (Mode.HEADING in allowed(line, False, vehicle, **rows)) is may
        assert (Mode.HEADING in allowed(line, True, vehicle, **rows)) is may_at_sea


def test_a_line_forbids_all_modes_but_those_that_bring_the_boat_back():
    assert allowed("fence") == allowed("fence", at_sea=True) == {Mode.MANUAL}
    assert allowed("log", log=config.LogNotWritable(action="stop")) == {Mode.MANUAL, Mode.HOME}
    free = msgspec.structs.replace(PLAIN, log=config.LogTable(required=False))
    assert allowed("log", vehicle=free) == set(Mode)
    assert allowed("kill") == allowed("computer", at_sea=True) == set()
    assert allowed("hand-set") == set(Mode)


def test_a_console_is_lost_after_five_seconds_and_two_of_one_name_are_none(boat):
    boat.ready()
    now_s, helm = boat.clock.monotonic_s(), boat.vehicle.helm
    for age_s, told in (
        (4.9, (True, "console heard 4.9 s ago")),
        (5.0, (False, "console heard 5.0 s ago")),
        (9e7, (False, "console heard 90000000.0 s ago")),
        (1e8, (False, "console never heard")),
    ):
        boat.state.console_s = now_s - age_s
        assert lines(boat)["link"] == told
    boat.state.console_s, boat.state.namesakes = now_s, "two of one name"
    assert lines(boat)["link"] == (False, "two of one name")
    assert {line.name for line in helm.checks()} == LINES - {"outlet"}


def test_the_line_of_the_fence_says_what_it_waits_for(make_boat):
    boat = make_boat(fence=AROUND)
    boat.ready()
    assert boat.navigate(latitude_rad=math.radians(38.6925), longitude_rad=math.radians(-9.215))
    assert lines(boat)["fence"] == (True, "1 zones, the boat is where it may be")
    boat.state.fence_lost = "its file is gone"
    assert lines(boat)["fence"] == (False, "its file is gone")
    boat.state.fence_lost, helm = "", boat.vehicle.helm
    unlaid = Inputs("", Fence((), AROUND, is_laid=False))
    told = checks(helm.rules, boat.state, unlaid, boat.clock.monotonic_s(), boat.clock.time_ns())
    assert [(line.ok, line.reason) for line in told if line.name == "fence"] == [
        (False, "its zones are still being prepared: wait a moment")
    ]


@pytest.mark.parametrize(
    ("reports", "told"),
    [
        ({"bow": ThrusterReport(100.0)}, (True, "it answers")),
        ({}, (False, "the motors may turn: the outlet, which writes their pulses, has not answered yet")),
    ],
)
def test_the_line_of_the_outlet_is_there_for_motors_that_pulses_turn(reports, told):
    bow = config.ThrusterTable(name="bow", driver="pwm", address=3, thrust_n=(-10.0, 10.0))
    rules = Rules(msgspec.structs.replace(PLAIN, thrusters=(*config.DELFIMX, bow)))
    found = checks(rules, State(thrusters=reports), WELL, 100.0, 0)
    assert [(line.ok, line.reason) for line in found if line.name == "outlet"] == [told]


def test_the_line_of_navigation_is_right_up_to_its_age(boat):
    boat.ready()
    stale_s = boat.vehicle.helm.rules.settings.navigation.stale_s
    boat.state.navigation_s, boat.state.inputs = boat.clock.monotonic_s() - stale_s, {}
    assert lines(boat)["navigation"] == (True, f"dsor, {stale_s:.1f} s old")
    boat.state.navigation_s -= 0.1
    assert lines(boat)["navigation"] == (False, f"navigation silent for {stale_s + 0.1:.1f} s")
    boat.state.navigation_s = now_s = boat.clock.monotonic_s()
    boat.state.inputs = {boat.state.source: (InputHealth("position", now_s - stale_s - 0.1, heard=1),)}
    assert lines(boat)["navigation"] == (False, f"position silent for {stale_s + 0.1:.1f} s")
    boat.state.inputs = {boat.state.source: (InputHealth("velocity", now_s - 8.0, heard=1),)}
    assert lines(boat)["navigation"] == (True, "dsor, 0.0 s old; velocity silent for 8 s")


def test_a_clock_is_set_from_2009_on_and_five_seconds_are_in_order(boat):
    boat.ready()
    boat.clock.advance(0.5)
    helm, navigation = boat.vehicle.helm, boat.state.navigation
    now_s = boat.clock.monotonic_s()

    def clock(time_ns: int) -> Check:
        return next(each for each in checks(helm.rules, boat.state, WELL, now_s, time_ns) if each.name == "clock")

    age_ns = round((now_s - boat.state.navigation_s) * 1e9)
    for off_s, ok in ((-5.1, False), (-5.0, True), (5.0, True), (5.1, False)):
        assert clock(navigation.utc_ns + age_ns + round(off_s * 1e9)).ok is ok
    boat.state.navigation = navigation._replace(utc_ns=0)
    assert clock(1_230_768_000_000_000_000) == Check("clock", True, "navigation gives no time to compare with")
    assert clock(1_230_767_999_999_999_999) == Check("clock", False, "the computer's clock was never set")
    boat.state.computer = StartConditions(clock=ClockStatus("kept by this program", fault="it jumps"))
    assert clock(1_230_768_000_000_000_000).ok is False


def test_the_hand_set_says_whether_it_has_the_boat_and_how_good_its_radio_is(make_boat):
    boat = make_boat(handset=config.HandsetTable(device="/dev/receiver"))
    boat.ready()
    assert lines(boat)["hand-set"] == (False, "hand-set not heard yet")
    report = HandsetReport(boat.clock.monotonic_s(), 0.0, 0.0, takes=False, kills=False)
    boat.state.handset = report
    assert lines(boat)["hand-set"] == (True, "heard")
    boat.state.handset, boat.state.operator = replace(report, quality_pct=0), HANDSET
    assert lines(boat)["hand-set"] == (True, "has the boat, radio 0%")
    for age_s, told in ((0.5, (True, "has the boat, radio 0%")), (0.6, (False, "hand-set silent for 0.6 s"))):
        boat.state.handset = replace(boat.state.handset, heard_s=boat.clock.monotonic_s() - age_s)
        assert lines(boat)["hand-set"] == told
    without = make_boat()
    without.state.handset = report
    assert lines(without)["hand-set"] == (True, "the boat has none")
