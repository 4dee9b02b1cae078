"""Forged AIS: vessels that follow the boat wherever it is drive it neither out of its fence nor farther than the file says."""

import math
import re
from pathlib import Path
from typing import Any

import pytest

from delfim import config
from delfim.base import tables
from delfim.base.clock import ManualClock
from delfim.base.modes import Mode
from delfim.simulator.invariants.onlooker import Onlooker
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.scenarios.scenario import laid_over
from delfim.vehicle import console
from delfim.vehicle.plans.fence import Fence
from delfim.vehicle.plans.zones import circle
from delfim.vehicle.state import NoLog

VEHICLE = Path(__file__).parents[3] / "etc/delfimx.toml"
START_S = 10.0
# Eight ships at anchor, always 20 m from the boat, on an arc to the east of it.
FLEET = [
    {"transponder": "A", "status": 1, "length_m": 60.0, "beam_m": 10.0, "follows_m": 20.0, "follows_deg": 45.0 + 90.0 * i / 7.0}
    for i in range(8)
]
PUSHING = [
    {"length_m": 12.0, "speed_mps": 1.0, "course_deg": 90.0, "follows_m": 45.0, "follows_deg": 250.0 + 20.0 * i}
    for i in range(3)
]
AHEAD = [{"transponder": "A", "length_m": 200.0, "beam_m": 30.0, "speed_mps": 3.0, "course_deg": 180.0, "follows_m": 300.0}]
SIDES = [{"length_m": 60.0, "beam_m": 10.0, "follows_m": 20.0, "follows_deg": 90.0, "sides_s": 90.0}]


class Notes(NoLog):
    def __init__(self, clock: ManualClock) -> None:
        self.lines: list[str] = []

    def note(self, text: str) -> None:
        self.lines.append(text)


class Attack:
    """A boat in lock step, and what is told of vessels that are not there."""

    def __init__(
        self, rows: list[dict[str, Any]], fence_m: float = 0.0, sea: dict[str, float] | None = None, **tree: Any
    ) -> None:
        before = tables.read_toml(VEHICLE)
        simulation = {"traffic": {"heard": "perfect", "vessel": rows}, "sea": sea or {}, "heading_deg": 0.0}
        more: dict[str, Any] = {"simulation": simulation, "sensors": {"names": ["sysstat", "nmea2000"]}, **tree}
        if fence_m:
            here = tables.decode(before, config.Vehicle, "test").simulation
            more["fence"] = {"keep_in": [{"centre": [[here.latitude_deg, here.longitude_deg]], "radius_m": fence_m}]}
        self.run = Lockstep(tables.decode(laid_over(before, more), config.Vehicle, "test"), 1, Notes)
        self.watch = Onlooker(self.run)
        self.away_m = self.led_s = 0.0  # from the start, at most; under way by orders
        self.notices = dict[str, str]()  # the last words of each
        self.said = set[str]()  # all of them
        self.after(START_S)

    def after(self, seconds: float) -> "Attack":
        model = self.run.nodes.model
        for state in self.run.cycles(seconds):
            self.watch.look()
            self.away_m = max(self.away_m, math.hypot(model.north_m, model.east_m))
            if state.traffic.order is not None and state.traffic.order.speed_mps:
                self.led_s += 0.2
            self.notices.update({each.name: each.reason for each in state.notices})
            self.said |= {each.reason for each in state.notices}
        return self

    def obey(self, command: console.Commands) -> "Attack":
        assert self.run.command(command) is None
        return self

    @property
    def notes(self) -> str:
        return "\n".join(self.run.log.lines)  # type: ignore[attr-defined]


@pytest.mark.parametrize("sea", [{}, {"current_mps": 0.4, "current_to_deg": 270.0}], ids=["calm", "current outwards"])
def test_a_boat_that_holds_is_not_driven_out_of_its_fence(sea: dict[str, float]) -> None:
    attack = Attack(FLEET, 80.0, sea).obey(console.SetMode("hold")).after(400.0)
    assert attack.watch.failures == []
    assert attack.away_m < 80.0
    assert attack.run.state.mode is Mode.HOLD


@pytest.mark.parametrize("at_s", [40.0, 40.2, 40.4, 40.6, 40.8])
def test_no_order_stands_while_the_fence_is_a_trouble(at_s: float) -> None:
    """Of a boat that is led by one, and finds a fence 4 m ahead of it, whenever the next decision is due."""
    attack = Attack(FLEET).obey(console.SetMode("hold")).after(at_s)
    state, helm = attack.run.state, attack.run.vehicle.helm
    assert state.traffic.order is not None
    motion = state.motion
    assert math.hypot(motion.north_mps, motion.east_mps) > 0.5
    course_rad = math.atan2(motion.east_mps, motion.north_mps)
    centre = motion.north_m - 96.0 * math.cos(course_rad), motion.east_m - 96.0 * math.sin(course_rad)
    helm.plans.fence = Fence((circle("ring", True, centre, 100.0),), config.FenceTable())
    attack.after(0.6)
    assert "fence" in attack.notices
    assert state.traffic.order is None
    assert helm.shapes == {}
    attack.after(2.0)
    assert state.traffic.guard.startswith("cannot avoid: the fence goes before: ring")
    assert "traffic: cannot avoid: the fence goes before" in attack.notes


def test_a_boat_that_steers_a_course_is_not_driven_out_of_its_fence() -> None:
    attack = Attack(FLEET, 100.0).obey(console.Course(270.0, 1.5)).after(400.0)
    assert attack.watch.failures == []
    assert attack.away_m < 100.0


@pytest.mark.parametrize("ghosts", [FLEET, PUSHING, AHEAD], ids=["fleet", "pushing", "ahead"])
@pytest.mark.parametrize("mode", [Mode.HOLD, Mode.COURSE])
def test_without_a_fence_the_boat_is_led_no_farther_than_the_file_says(ghosts: list[dict[str, Any]], mode: Mode) -> None:
    attack = Attack(ghosts, traffic={"guard": {"away_m": 100.0}})
    attack.obey(console.SetMode("hold") if mode is Mode.HOLD else console.Course(0.0, 1.5)).after(700.0)
    beside_m = attack.away_m if mode is Mode.HOLD else abs(attack.run.nodes.model.east_m)
    assert beside_m < 100.0 + 25.0
    assert "(traffic.guard.away_m): warn" in attack.notes
    assert any("it led the boat" in words for words in attack.said)


def test_nor_for_longer_however_often_the_vessel_changes_sides() -> None:
    """It rests for as long as it led."""
    attack = Attack(SIDES, traffic={"guard": {"away_s": 120.0}}).obey(console.SetMode("hold")).after(700.0)
    assert "(traffic.guard.away_s): warn" in attack.notes
    assert 120.0 < attack.led_s < 0.6 * 700.0


def test_a_moored_boat_that_moves_a_holding_one_is_told_with_how_far() -> None:
    moored = {"name": "NINA", "status": 5, "transponder": "A", "length_m": 12.0, "north_m": 35.0}
    attack = Attack([moored]).obey(console.SetMode("hold")).after(300.0)
    assert 20.0 < attack.away_m < 60.0
    assert re.fullmatch(r"keeping clear of NINA, which lies still, .*; [2-5]\d m from its place", attack.notices["traffic"])


def test_a_boat_that_drifted_out_is_brought_back_by_a_hold_that_comes_nearer() -> None:
    """By hand it may go back; pushed outwards it is made to hold, inside, and does."""
    drifting = Attack([], 20.0, {"current_mps": 0.4, "current_to_deg": 90.0}).after(60.0)
    assert drifting.away_m > 24.0
    drifting.obey(console.SetMode("manual")).obey(console.Manual(0.3, 0.3)).after(60.0)
    assert drifting.run.state.mode is Mode.HOLD
    drifting.away_m = 0.0
    drifting.after(60.0)
    assert drifting.away_m < 20.0
    assert "fence_left" not in drifting.notices
