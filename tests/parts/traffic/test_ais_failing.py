"""The guard with a receiver that fails: the whole boat among real vessels in lock step, and what the table says comes of it."""

import math
from pathlib import Path
from typing import Any

import msgspec
import pytest

from delfim import config
from delfim.base.modes import Mode
from delfim.parts.traffic import lookout
from delfim.parts.traffic.watchkeeper import LATE_S
from delfim.simulator.faults import fault
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.tables import SimulatedTraffic, SimulatedVessel
from delfim.vehicle import console
from delfim.vehicle.state import NoLog
from tests.parts.traffic.test_lookout import slices

VEHICLE = Path(__file__).parents[3] / "etc/delfimx.toml"
SET = ("simulation.heading_deg=0.0", 'sensors.names=["sysstat", "nmea2000"]')
BOAT_MPS, MEETS_S, FAILS_S = 1.5, 300.0, 100.0


def crossing(number: int = 0, **row: Any) -> SimulatedVessel:
    """From starboard, to where the boat is after MEETS_S; the others of a crowd farther along the way."""
    north_m, east_m = BOAT_MPS * (MEETS_S - 10.0) + 60.0 * (number // 10), 2.0 * MEETS_S + 40.0 * (number % 10)
    told = {"transponder": "A", "length_m": 30.0, "course_deg": 270.0, "speed_mps": 2.0, "north_m": north_m, "east_m": east_m}
    return SimulatedVessel(name=f"SHIP {number}", **(told | row))


class Voyage:
    """The boat steers north at 1.5 m/s; its receiver fails after a while."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, fault: str, *vessels: SimulatedVessel, **failsafe: Any) -> None:
        settings, replace = config.load(VEHICLE, SET), msgspec.structs.replace
        world = replace(settings.simulation, traffic=SimulatedTraffic(vessel=vessels))
        settings = replace(settings, simulation=world, failsafe=replace(settings.failsafe, **failsafe))
        self.spent, self.orders, self.told = slices(monkeypatch), 0, set[str]()
        self.run = Lockstep(settings, 1, lambda clock: NoLog())
        list(self.run.cycles(10.0))
        assert self.run.command(console.Course(0.0, BOAT_MPS)) is None
        self._fault = fault

    def sail(self, seconds: float) -> None:
        for state in self.run.cycles(seconds):
            now_s, order = self.run.elapsed_s, state.traffic.order
            if self._fault and now_s > FAILS_S:
                self.run.faults.begin(fault(self._fault), now_s)
                self._fault = ""
            if order is not None:
                self.orders += 1
                assert math.isfinite(order.course_rad)
                assert 0.0 <= order.speed_mps <= BOAT_MPS
                assert now_s - order.at_s <= LATE_S
            self.told |= {each.name for each in state.notices}
        assert max(self.spent) < 2 * lookout.SLICE, "a slice in each step"

    @property
    def nearest(self) -> float:
        return min(each.nearest for each in self.run.nodes.vessels)


@pytest.mark.parametrize(
    ("broken", "refused"),
    [
        ("ais_silent", set[str]()),  # the vessel is reckoned on
        ("ais_frozen", {"the same place of a vessel that moves"}),  # so it is, too
        ("ais_late", set[str]()),
        ("ais_wrong", {"jump faster than 60 kn", "two vessels with one number"}),
    ],
)
def test_the_boat_keeps_clear_and_goes_on_where_its_receiver_fails(monkeypatch, broken, refused):
    """Two hundred seconds before a vessel from starboard would be met."""
    voyage = Voyage(monkeypatch, broken, crossing())
    voyage.sail(500.0)
    state = voyage.run.state
    assert voyage.nearest >= 1.0
    assert voyage.orders
    assert (state.mode, state.traffic.order) == (Mode.COURSE, None), "past, and on its course again"
    assert set(dict(state.traffic.refused)) == refused
    more = {"ais_silent": {"ais_silent"}, "ais_wrong": {"traffic_unclear"}}
    assert voyage.told == {"traffic"} | more.get(broken, set())


def test_a_boat_holds_where_its_file_says_so_when_ais_is_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    voyage = Voyage(monkeypatch, "ais_silent", crossing(), ais_silent=config.AisSilent(action="hold"))
    voyage.sail(FAILS_S + 150.0)
    assert voyage.run.state.mode is Mode.COURSE
    voyage.sail(30.0)
    assert voyage.run.state.mode is Mode.HOLD
    assert voyage.run.state.reason == "AIS silent for 180 s: other vessels are not seen"
    assert voyage.nearest >= 1.0


@pytest.mark.parametrize("speed_mps", [0.0, BOAT_MPS])
@pytest.mark.parametrize(("action", "mode"), [("warn", Mode.COURSE), ("hold", Mode.HOLD)])
def test_with_a_vessel_where_the_boat_is_the_table_is_obeyed(monkeypatch, speed_mps, action, mode):
    """It lies there, or goes as the boat does: a transponder of its own that the file does not name."""
    on_us = crossing(north_m=0.0, east_m=0.0, course_deg=0.0, speed_mps=speed_mps)
    voyage = Voyage(monkeypatch, "", on_us, traffic_close=config.TrafficClose(action=action))
    voyage.sail(30.0)
    assert voyage.run.state.mode is mode
    assert "traffic_close" in voyage.told


def test_among_two_hundred_vessels_the_boat_keeps_clear_of_all(monkeypatch: pytest.MonkeyPatch) -> None:
    voyage = Voyage(monkeypatch, "", *(crossing(i) for i in range(200)))
    voyage.sail(300.0)
    assert len(voyage.run.state.traffic.targets) == 200
    assert voyage.orders
    assert voyage.nearest >= 1.0
    assert voyage.run.state.mode is Mode.COURSE
