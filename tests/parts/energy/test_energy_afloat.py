"""A boat that reckons its energy sails home in time, and says what it has; in lock step, with the simulator's batteries."""

import math
from collections.abc import Callable
from pathlib import Path

import pytest

from delfim import config
from delfim.base.geodesy import from_plane
from delfim.base.modes import Mode
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.state import NoLog, State

CAPACITY_WH = 150.0
WARN = [f'failsafe.{name}.action="warn"' for name in ("battery_low", "battery_critical")]
FILE = "etc/delfimx.toml"


def boat(*keys: str, told: bool = True) -> Lockstep:
    batteries = ['sensors.names=["sysstat"]'] if told else ["sensors.names=[]"]
    settings = config.load(FILE, [*batteries, *WARN, f"energy.capacity_wh={CAPACITY_WH}", *keys])
    return Lockstep(settings, 1, lambda clock: NoLog())


def until(run: Lockstep, is_so: Callable[[State], bool], limit_s: float) -> None:
    for state in run.cycles(limit_s):
        if run.elapsed_s % 5.0 < 0.2:
            run.order(console.Alive(), "tester")
        if is_so(state):
            return
    raise AssertionError(f"not within {limit_s:.0f} s: {run.state.mode.name} {run.state.reason} {run.state.energy}")


def go(run: Lockstep, north_m: float, east_m: float) -> None:
    assert run.state.origin is not None
    latitude_rad, longitude_rad = from_plane(run.state.origin, north_m, east_m)
    assert run.order(console.Goto(math.degrees(latitude_rad), math.degrees(longitude_rad)), "tester") is None


def check_of(run: Lockstep, name: str) -> tuple[bool, str]:
    return next((each.ok, each.reason) for each in run.vehicle.helm.checks() if each.name == name)


def test_it_goes_home_while_the_reserve_is_left() -> None:
    run = boat("energy.reserve=0.2")
    until(run, lambda state: run.elapsed_s > 5.0, 30.0)
    go(run, 2000.0, 0.0)
    until(run, lambda state: "energy" in {each.name for each in state.notices}, 900.0)
    reason = next(each.reason for each in run.state.notices if each.name == "energy")
    assert reason.startswith("home takes ")
    assert reason.partition(";")[0].endswith(" Wh left, and 30 Wh are the reserve")
    until(run, lambda state: state.mode is Mode.HOME, 60.0)
    until(run, lambda state: state.mode is Mode.HOLD, 900.0)
    model = run.nodes.model
    assert math.hypot(model.north_m, model.east_m) < 20.0
    assert 0.1 < min(drive.charge for drive in model.drives.values()) < 0.4


def test_it_says_what_it_has_and_how_far_it_gets() -> None:
    run = boat("simulation.sea.current_mps=0.3", "simulation.sea.current_to_deg=90")
    until(run, lambda state: run.elapsed_s > 5.0, 30.0)
    for north_m, east_m in ((130.0, 0.0), (130.0, 130.0), (0.0, 130.0), (0.0, 0.0)):
        go(run, north_m, east_m)
        until(run, lambda state: state.mode is Mode.HOLD, 200.0)
    now = run.vehicle.report().energy
    assert now is not None
    assert now.left_wh is not None
    assert now.left_wh < CAPACITY_WH
    assert now.reserve_wh == pytest.approx(0.15 * CAPACITY_WH)
    assert (now.power_w is None, now.home_wh is None, now.why) == (False, False, "")
    assert now.range_m[9] > 1.3 * now.range_m[27] > 0.0  # east, with the current; west
    assert (now.current_mps, now.current_deg) == (pytest.approx(0.3, abs=0.1), pytest.approx(90.0, abs=30.0))
    assert check_of(run, "energy") == (True, f"{now.left_wh:.0f} Wh left")


def test_a_mission_that_takes_too_much_is_told_before_it_is_sailed() -> None:
    run = boat()
    until(run, lambda state: run.elapsed_s > 5.0, 30.0)
    places = "".join(f"[[waypoint]]\nlatitude_deg = {38.69 + 0.02 * (each % 2)}\nlongitude_deg = -9.21\n" for each in range(6))
    assert run.order(console.LoadMission(f'version = 1\nname = "far"\n{places}'), "tester") is None
    until(run, lambda state: state.energy is not None and state.energy.plan_wh is not None, 30.0)
    is_enough, words = check_of(run, "energy")
    assert not is_enough
    assert "the mission takes " in words
    assert words.endswith(" and 22 Wh are the reserve")
    assert run.order(console.Play(), "tester") is None  # it is told, and not refused


def test_batteries_that_tell_no_charge_are_no_trouble_and_are_told() -> None:
    run = boat(told=False)
    until(run, lambda state: run.elapsed_s > 3.0, 30.0)
    assert run.state.energy is not None
    assert (run.state.energy.left_wh, run.state.energy.range_m) == (None, ())
    assert check_of(run, "energy") == (False, "no battery tells its charge")
    assert "energy" not in {each.name for each in run.state.notices}


def test_a_boat_without_a_capacity_reckons_nothing() -> None:
    run = boat("energy.capacity_wh=0")
    until(run, lambda state: run.elapsed_s > 2.0, 30.0)
    assert run.state.energy is None
    assert not [each for each in run.vehicle.helm.checks() if each.name == "energy"]


def test_a_path_that_the_boat_is_still_on_its_way_to_counts_whole() -> None:
    run = boat()
    until(run, lambda state: run.elapsed_s > 5.0, 30.0)
    assert run.order(console.LoadMission(Path("etc/missions/lawnmower.toml").read_text()), "tester") is None
    until(run, lambda state: state.energy is not None and state.energy.plan_wh is not None, 30.0)
    before_wh = run.state.energy.plan_wh if run.state.energy is not None else None
    assert run.order(console.SetMode("path"), "tester") is None
    until(run, lambda state: run.elapsed_s > 12.0, 30.0)
    assert run.vehicle.helm.memory.leg < 0  # not on its first piece yet
    assert run.state.energy is not None
    assert run.state.energy.plan_wh == pytest.approx(before_wh, rel=0.1)


def test_it_slows_down_on_its_way_home_where_the_charge_would_not_do() -> None:
    run = boat()
    until(run, lambda state: run.elapsed_s > 5.0, 30.0)
    go(run, 250.0, 0.0)
    until(run, lambda state: state.mode is Mode.HOLD, 400.0)
    for drive in run.nodes.model.drives.values():
        drive.charge = 0.33  # of 150 Wh; home at 1.5 m/s takes some 45
    assert run.order(console.SetMode("home"), "tester") is None
    until(run, lambda state: (state.setpoint.override_mps or 9.0) < 1.4, 30.0)
    until(run, lambda state: state.mode is Mode.HOLD, 600.0)
    assert run.state.setpoint.override_mps is None
    assert min(drive.charge for drive in run.nodes.model.drives.values()) > 0.1


def test_the_speed_that_an_operator_asks_for_on_the_way_home_stays() -> None:
    run = boat()
    until(run, lambda state: run.elapsed_s > 5.0, 30.0)
    go(run, 100.0, 0.0)
    until(run, lambda state: state.mode is Mode.HOLD, 200.0)
    for drive in run.nodes.model.drives.values():
        drive.charge = 0.16
    assert run.order(console.SetMode("home"), "tester") is None
    assert run.order(console.SetSpeed(speed_mps=1.5), "tester") is None
    until(run, lambda state: state.mode is Mode.HOME and math.hypot(state.motion.north_m, state.motion.east_m) < 50.0, 200.0)
    assert run.state.setpoint.override_mps == 1.5
