"""The checks before the start: a line and a reason each, and the one door that reads them."""

import math

import pytest

from delfim import config, messages
from delfim.frames import Frame
from delfim.messages import BatteriesStatus, Fault, Node, Status
from delfim.modes import Mode
from delfim.vehicle import console
from delfim.vehicle.state import ClockStatus, StartConditions

AROUND = config.FenceTable(
    keep_in=(config.Area(polygon=((38.692, -9.216), (38.693, -9.216), (38.693, -9.214), (38.692, -9.214))),)
)


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
    boat.state.computer = StartConditions(clock=kept._replace(fault="the time frame jumps by +1.4 s: it is not taken"))
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
    assert boat.vehicle.on_command(console.Heading(0.0)) is None
    assert boat.state.mode is Mode.HEADING


def test_the_state_for_the_console_has_the_lines_and_the_present_troubles(boat):
    boat.log.why = "disk full"
    boat.ready()
    boat.pass_time(6.0)
    state = boat.vehicle.snapshot({})
    assert {"name": "log", "ok": False, "reason": "no log, no start: disk full"} in state["checks"]
    notice = next(each for each in state["notices"] if each["name"] == "log")
    assert (notice["reason"], notice["action"]) == ("log not written: disk full", "warn")
    assert notice["age_s"] == pytest.approx(5.9, abs=0.2)


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
