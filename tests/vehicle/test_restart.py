"""A restart under way: the boat goes on as its file says, with what was aboard, and tells what it does. In lock step; the real
programs are killed in tests/test_restart_afloat.py."""

import math
from pathlib import Path
from random import Random

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from delfim import config
from delfim.base.geodesy import from_plane
from delfim.base.modes import Mode
from delfim.simulator.invariants.onlooker import Onlooker
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.orders import voyage
from delfim.vehicle.orders.returning import RESTART
from delfim.vehicle.plans.fence import outside
from delfim.vehicle.state import NoLog

ROOT = Path(__file__).parents[2]
FILE = str(ROOT / "etc/delfimx.toml")
DOCA = (ROOT / "etc/missions/doca.toml").read_text()
FENCE = """
[fence]
version = 1
[[fence.keep_in]]
name = "the dock"
centre = [[38.6895, -9.2150]]
radius_m = 600
"""
GUEST = b'{"heading_deg": 90.0, "speed_mps": 1.0}'
ORDER, ENDED = {"in_order": True}, "it was ended in order; the boat stays idle"
WAYS = {  # into each mode, by a boat that has a mission
    Mode.MANUAL: console.Manual(0.4, 0.4),
    Mode.HEADING: console.Heading(90.0, 1.2),
    Mode.COURSE: console.Course(100.0, 1.2),
    Mode.GOTO: console.Goto(38.6927, -9.2145),
    Mode.PLAY: console.Play(),
    Mode.PATH: console.SetMode("path"),
    Mode.GREX: console.SetMode("grex"),
    Mode.HOLD: console.SetMode("hold"),
    Mode.HOME: console.SetMode("home"),
}


def settings_of(*more: str) -> config.Vehicle:
    return config.load(FILE, more)


def sailing(mode: Mode, *more: str, seed: int = 1, seconds: float = 25.0) -> Lockstep:
    """A boat with a mission, a fence, a harbour and a changed speed, under way in this mode."""
    run = Lockstep(settings_of(*more), seed, lambda clock: NoLog())
    for _ in run.cycles(4):
        pass
    for command in (console.LoadMission(DOCA + FENCE), console.Set("control.speed.max_mps", 1.4)):
        assert run.command(command) is None
    assert run.command(console.Rally(((38.6925, -9.2150),))) is None
    assert run.command(console.Play()) is None
    go_on(run, 15)
    if mode is not Mode.PLAY:
        run.guest_says(GUEST)
        assert run.command(WAYS[mode]) is None
    go_on(run, seconds, mode)
    assert run.state.mode is mode
    return run


def go_on(run: Lockstep, seconds: float, by: Mode | None = None) -> None:
    """Sail on; an operator by hand and a guest speak."""
    for state in run.cycles(seconds):
        if by is Mode.MANUAL and state.mode is Mode.MANUAL:
            run.command(WAYS[Mode.MANUAL])
        elif by is Mode.GREX:
            run.guest_says(GUEST)


@pytest.mark.parametrize("mode", WAYS, ids=lambda mode: mode.name.lower())
def test_each_mode_goes_on_as_the_table_says_within_three_seconds(mode):
    run = sailing(mode, seconds=5.0 if mode is Mode.HOME else 25.0)
    zones, track, mission = run.vehicle.helm.plans.zones, run.vehicle.helm.track.points(), run.vehicle.helm.plans.mission
    leg = run.vehicle.helm.memory.leg
    run.restart(1.0)
    began_s = run.elapsed_s
    after = {Mode.MANUAL: Mode.IDLE, Mode.HOME: Mode.HOME}.get(mode, Mode.HOLD)
    go_on(run, 3.0)
    state, helm = run.state, run.vehicle.helm
    assert state.mode is after
    assert state.mode_s - began_s < 3.0
    assert helm.plans.mission == mission
    assert helm.plans.zones == zones
    assert len(helm.plans.fence.zones) == 1
    assert helm.plans.rally == ((38.6925, -9.2150),)
    assert helm.settings.control.speed.max_mps == 1.4
    assert helm.track.points()[: len(track)] == track
    assert f"it was in {mode.name.lower()}" in next(n.reason for n in state.notices if n.name == "restarted")
    if mode in (Mode.PLAY, Mode.PATH, Mode.COURSE, Mode.HEADING):
        assert run.command(console.Continue()) is None
        go_on(run, 1.0)
        assert state.mode is mode
        assert helm.memory.leg == leg
        assert not state.restarted
    if after is Mode.IDLE:
        assert run.command(console.SetMode("hold")) is None, "its operator commands it as before"


@pytest.mark.parametrize("mode", [Mode.HEADING, Mode.COURSE, Mode.GOTO, Mode.PLAY, Mode.PATH, Mode.HOLD])
def test_a_mode_that_is_resumed_has_its_leg_its_set_points_and_its_place(mode):
    run = sailing(mode, 'failsafe.restarted.action="resume"', 'failsafe.sensor_bad.action="hold"')
    before, memory = run.state.setpoint, run.vehicle.helm.memory
    run.restart(1.0)
    go_on(run, 2.0)
    assert run.state.mode is mode
    after, now = run.state.setpoint, run.vehicle.helm.memory
    assert (after.heading_rad, after.speed_mps, after.target) == (before.heading_rad, before.speed_mps, before.target)
    assert now.leg == memory.leg
    if mode is not Mode.HEADING:
        assert (now.north_m, now.east_m) == pytest.approx((memory.north_m, memory.east_m))


@pytest.mark.parametrize(
    ("action", "mode", "more"), [("hold", Mode.HOLD, {}), ("resume", Mode.PLAY, {}), ("hold", Mode.IDLE, ORDER)]
)
def test_a_leg_behind_the_boat_that_a_fence_forbids_strands_it_not(action, mode, more):
    """The fence came under way."""
    run = sailing(Mode.PLAY, f'failsafe.restarted.action="{action}"')
    plan, helm = run.state.setpoint.plan, run.vehicle.helm
    assert run.command(console.Play(3)) is None
    go_on(run, 2)
    (a, b), origin = plan.waypoints[:2], run.state.origin
    middle = from_plane(origin, (a.north_m + b.north_m) / 2.0, (a.east_m + b.east_m) / 2.0)
    reef = config.Area(name="reef", centre=(tuple(map(math.degrees, middle)),), radius_m=2.0)
    zones = config.Zones(keep_in=helm.plans.zones.keep_in, keep_out=(reef,))
    assert run.command(console.SetFence(zones)) is None
    go_on(run, 2)
    run.restart(1.0, kept_by(run, **more))
    go_on(run, 3)
    state, helm = run.state, run.vehicle.helm
    assert (state.mode, helm.plans.zones, state.fence_lost) == (mode, zones, "")
    assert helm.plans.mission is not None
    assert state.restarted == (f"it was in play on leg 4; {action if action == 'hold' else 'play'} now" if not more else ENDED)
    assert run.command(console.Play(0)) == "play refused: the fence forbids the mission before waypoint 4: begin there"
    assert run.command(console.Continue() if mode is Mode.HOLD else console.Play(3)) is None
    go_on(run, 1)
    assert (state.mode, helm.memory.leg) == (Mode.PLAY, 3)
    mission = helm.plans.mission
    assert run.command(console.Stop()) is None
    refused = run.command(console.Upload(mission))
    assert refused == "mission refused: the leg to waypoint 2 leads through reef; missions keep 6 m away", (
        "of a new one all is judged"
    )


def test_a_boat_whose_console_stays_silent_goes_home_along_the_driven_track():
    run = sailing(Mode.PLAY, "failsafe.pause_s=5.0", seconds=60)
    way = run.vehicle.helm.track.way_home()
    run.restart(1.0)
    run.faults.on["console_lost"] = 0.0
    modes = list[Mode]()
    for state in run.cycles(30.0):
        modes += [state.mode] if state.mode not in modes[-1:] else []
    assert modes == [Mode.IDLE, Mode.HOLD, Mode.HOME]
    assert run.state.setpoint.track[: len(way)] == way


@pytest.mark.parametrize("before", ["stop", "kill", "arm"])
def test_a_boat_in_idle_stays_there(before):
    run = sailing(Mode.PLAY, 'failsafe.restarted.action="resume"')
    run.command(console.Stop())
    run.command(console.parse(msgspec.json.encode({"command": before})))
    killed = run.state.killed.reason
    run.restart(1.0)
    go_on(run, 10)
    assert run.state.mode is Mode.IDLE
    assert run.state.killed.reason == killed
    assert not run.state.restarted or killed
    assert run.vehicle.helm.plans.mission is not None
    refused = run.command(console.SetMode("hold"))
    assert ("kill" in (refused or "")) == bool(killed)


def test_what_was_asked_before_is_asked_by_nobody_now():
    """The thrust of a joystick, and a guest's set point, are never taken over."""
    run = sailing(Mode.MANUAL, 'failsafe.restarted.manual="hold"')
    run.restart(1.0)
    go_on(run, 2.0)
    assert run.state.mode is Mode.HOLD
    assert (run.state.setpoint.starboard, run.state.setpoint.port) == (0.0, 0.0)
    assert run.state.setpoint.guest_heading_rad is None
    with pytest.raises(config.ConfigError, match="thrust by hand is not resumed"):
        settings_of('failsafe.restarted.manual="resume"')


def kept_by(run: Lockstep, **changes: object) -> bytes:
    """The kept voyage, with other words in its first line."""
    first, _, rest = run.kept().partition(b"\n")
    return msgspec.json.encode(msgspec.json.decode(first) | changes) + b"\n" + rest


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"boat": "Another"}, "another boat, 'Another'"),
        ({"digest": "0"}, "the boat's file or the program has changed"),
        ({"t_ns": 1_262_304_000_000_000_000 - 3_600_000_000_000, "boot": "the one before"}, "off for"),
        ({"in_order": True}, "ended in order"),
    ],
)
def test_a_voyage_that_is_not_this_one_is_not_gone_on_with(changes, words):
    run = sailing(Mode.PLAY)
    run.clock.step(1e9)  # to a time that a clock may show
    if "t_ns" in changes:
        changes = changes | {"t_ns": run.clock.time_ns() - 3_600_000_000_000}
    run.restart(1.0, kept_by(run, **changes))
    go_on(run, 5)
    state = run.state
    assert state.mode is Mode.IDLE
    assert words in state.restarted
    assert state.restarted.endswith("the boat stays idle")
    fence = next(line for line in run.vehicle.helm.checks() if line.name == "fence")
    if "digest" in changes:
        assert not fence.ok
        assert "zones were aboard before the restart and are not in force" in fence.reason
        assert "zones were aboard" in run.command(console.SetMode("hold"))
        assert run.command(console.SetFence(config.Zones())) is None, "the operator says that there are none"
        assert run.command(console.SetMode("hold")) is None
    else:
        assert fence.ok


@pytest.mark.parametrize("seconds", [0.0, 0.1, 0.4, 1.0, 2.0])
@pytest.mark.parametrize("boots", [("a boot", "a boot"), ("the second", "the third")], ids=["program", "computer"])
def test_a_boat_that_restarts_again_and_again_goes_on_all_the_same(seconds, boots):
    """A battery that cannot carry the load, or a program that dies at its start: the record of the voyage outlasts that."""
    run = sailing(Mode.PLAY, 'failsafe.restarted.action="resume"')
    zones, mission, leg = run.vehicle.helm.plans.zones, run.vehicle.helm.plans.mission, run.vehicle.helm.memory.leg
    run.clock.step(1e9)  # to a time that a clock may show
    for boot in boots:
        run.restart(1.0, boot=boot)
        go_on(run, seconds)
    run.restart(1.0, boot="the last")
    go_on(run, 3.0)
    helm = run.vehicle.helm
    assert run.state.mode is Mode.PLAY
    assert (helm.plans.zones, helm.plans.mission) == (zones, mission)
    assert leg <= helm.memory.leg <= leg + 1
    assert not run.state.fence_lost


def test_a_boat_that_is_ended_in_order_before_it_goes_on_keeps_its_plan_and_stays_idle():
    run = sailing(Mode.PLAY, 'failsafe.restarted.action="resume"')
    mission = run.vehicle.helm.plans.mission
    run.restart(1.0)
    run.restart(1.0, voyage.ended(run.kept()))
    go_on(run, 3.0)
    assert run.state.mode is Mode.IDLE
    assert run.state.restarted.endswith(ENDED)
    assert run.vehicle.helm.plans.mission == mission


def test_what_an_operator_says_before_the_boat_goes_on_is_kept():
    run = sailing(Mode.PLAY, 'failsafe.restarted.action="resume"')
    run.restart(1.0)
    assert run.command(console.Stop()) is None
    run.restart(1.0)
    go_on(run, 3.0)
    assert run.state.mode is Mode.IDLE
    assert not run.state.restarted


@given(st.data())
@settings(max_examples=150)
def test_a_damaged_record_brings_nothing_back_and_says_so(data):
    run = harbour()
    told = bytearray(run.kept())
    for _ in range(data.draw(st.integers(1, 4))):
        told[data.draw(st.integers(0, len(told) - 1))] = data.draw(st.integers(0, 255))
    found = voyage.read(bytes(told), run.settings, voyage.KeptHead("DelfimX", "", "a boot", 0, 0.0))
    again = Lockstep(run.settings, 1, lambda clock: NoLog())
    for command in (found.back, *found.sent):
        again.vehicle.on_command(command, RESTART)
    go_on(again, 2.0)
    assert again.state.mode in (Mode.IDLE, Mode.HOLD)
    assert all(math.isfinite(each) for each in again.state.actuation.thrust)


_harbour: list[Lockstep] = []


def harbour() -> Lockstep:
    if not _harbour:
        _harbour.append(sailing(Mode.PLAY))
    return _harbour[0]


def test_a_boat_that_is_elsewhere_stays_idle():
    run = sailing(Mode.PLAY)
    model = run.nodes.model
    told = run.kept()
    model.north_m += 900.0
    run.restart(1.0, told)
    go_on(run, 5)
    assert run.state.mode is Mode.IDLE
    assert "m from where it was" in run.state.restarted
    assert run.command(console.SetMode("home")) is not None, "the way home of before does not begin here"


def test_a_computer_without_a_clock_learns_from_the_satellites_how_long_it_was_off():
    for off_s, mode in ((20.0, Mode.HOLD), (2000.0, Mode.IDLE)):
        run = sailing(Mode.PLAY)
        kept = kept_by(run, boot="the one before", t_ns=run.clock.time_ns() - round((off_s - 1.0) * 1e9))
        run.restart(1.0, kept)  # lock step begins in 2010, before the program was made: nobody set that clock
        go_on(run, 3)
        assert run.state.mode is mode


def test_only_the_program_itself_goes_on_with_a_voyage():
    run = sailing(Mode.HOLD)
    back = console.Return(voyage.sailed(run.vehicle.helm, run.state))
    refused = "refused: the program alone goes on with a voyage, when it starts"
    assert run.command(console.parse(msgspec.json.encode(back))) == refused
    assert run.vehicle.on_command(back, RESTART) == "return refused: the boat sails already"
    assert run.state.mode is Mode.HOLD


def test_somebody_who_commands_meanwhile_is_obeyed():
    run = sailing(Mode.PLAY, 'failsafe.restarted.action="resume"')
    run.restart(1.0)
    assert run.command(console.Stop()) is None
    go_on(run, 5)
    assert run.state.mode is Mode.IDLE
    assert not run.state.restarted
    assert run.vehicle.helm.plans.mission is not None


@pytest.mark.parametrize("mode", [Mode.HOLD, Mode.HOME, Mode.MANUAL, Mode.PLAY])
def test_a_dead_disk_and_a_restart_do_not_strand_the_boat(mode):
    run = sailing(Mode.PLAY, "log.required=true")
    run.faults.on["disk_full"] = 0.0
    go_on(run, 6)
    run.restart(1.0)
    go_on(run, 3)
    assert run.state.mode is Mode.HOLD
    assert run.command(WAYS[mode]) is None
    go_on(run, 4)
    assert any(notice.name == "log" for notice in run.state.notices)


def test_on_the_quay_a_dead_disk_keeps_the_boat_until_its_operator_says_so():
    run = Lockstep(settings_of("log.required=true"), 1, lambda clock: NoLog())
    run.faults.on["disk_full"] = 0.0
    go_on(run, 4)
    assert run.command(console.SetMode("hold")) == "hold refused: no log, no start: no space left on device"
    assert run.command(console.Set("log.required", "no")) is None
    assert run.command(console.SetMode("hold")) is None


MODES = [mode for mode in WAYS if mode is not Mode.MANUAL]


@pytest.mark.parametrize("seed", range(6))
def test_fifty_restarts_and_power_cuts_on_one_voyage(seed):
    """At random moments, in each mode: the same boat after each, inside its fence, and nothing that must never happen."""
    random = Random(f"restarts {seed}")
    run = sailing(Mode.PLAY, f'failsafe.restarted.action="{random.choice(["hold", "resume"])}"', seed=seed, seconds=5)
    helm = run.vehicle.helm
    mission, rally, points = helm.plans.mission, helm.plans.rally, len(helm.track.points())
    watch = Onlooker(run, facts=True)
    for number in range(9):
        mode = random.choice(MODES)
        run.guest_says(GUEST)
        watch.order(WAYS[mode], "local")
        for _ in run.cycles(random.uniform(1.0, 25.0)):
            watch.look()
        before = run.state.mode
        run.restart(random.uniform(0.4, 4.0), boot=f"boot {number}" if random.random() < 0.5 else "a boot")
        began_s = run.elapsed_s
        for _ in run.cycles(6.0):
            watch.look()
        helm, state = run.vehicle.helm, run.state
        assert (helm.plans.mission, helm.plans.rally) == (mission, rally)
        assert helm.settings.control.speed.max_mps == 1.4
        assert state.mode is not Mode.IDLE or before is Mode.IDLE
        assert state.mode_s - began_s < 3.0 or before is Mode.IDLE
        assert len(helm.track.points()) >= min(points, 2)
        assert outside(helm.plans.fence, state.motion.north_m, state.motion.east_m) is None
    assert watch.failures == []
