"""A way round zones: found, kept room on, and sailed by goto."""

import itertools
import math
from pathlib import Path

import pytest

from delfim import config
from delfim.base import geodesy
from delfim.base.cooperative import Sliced
from delfim.base.modes import Mode
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.helm import detour
from delfim.vehicle.helm.detour import way_round
from delfim.vehicle.plans.fence import Fence
from delfim.vehicle.plans.zones import Point, Zone, circle, clearance_m, least, polygon
from delfim.vehicle.state import NoLog

VEHICLE = Path(__file__).parents[2] / "etc/delfimx.toml"
ROOM_M = 6.0
WALL = polygon("wall", False, [(100.0, -200.0), (110.0, -200.0), (110.0, 200.0), (100.0, 200.0)])
BAY = polygon(
    "bay",
    False,
    [(0.0, -100.0), (200.0, -100.0), (200.0, 100.0), (0.0, 100.0), (0.0, 90.0), (190.0, 90.0), (190.0, -90.0), (0.0, -90.0)],
)
ROCK = circle("rock", False, (100.0, 0.0), 50.0)
BEND = polygon("canal", True, [(-50.0, -50.0), (300.0, -50.0), (300.0, 300.0), (200.0, 300.0), (200.0, 50.0), (-50.0, 50.0)])
NEEDLE = polygon("needle", False, [(90.0, -300.0), (110.0, -300.0), (100.0, 80.0)])


def found(zones: tuple[Zone, ...], a: Point, b: Point) -> tuple[Point, ...] | None:
    return Sliced(way_round(Fence(zones, config.FenceTable()), a, b, ROOM_M)).finish()


@pytest.mark.parametrize(
    ("zones", "to", "longest_m"),
    [
        ((WALL,), (200.0, 0.0), 470.0),
        ((BAY,), (300.0, 0.0), 560.0),
        ((ROCK,), (200.0, 0.0), 245.0),
        ((BEND,), (250.0, 250.0), 425.0),
        ((NEEDLE,), (200.0, 0.0), 275.0),
        ((WALL, ROCK, NEEDLE, circle("buoy", False, (0.0, 120.0), 5.0)), (400.0, 0.0), 600.0),
        ((WALL,), (50.0, 300.0), 305.0),
    ],
)
def test_the_way_keeps_its_room_and_is_short(zones: tuple[Zone, ...], to: Point, longest_m: float) -> None:
    by = found(zones, (0.0, 0.0), to)
    assert by is not None
    way = [(0.0, 0.0), *by, to]
    legs = list(itertools.pairwise(way))
    assert min(least(zone, a, b)[0] for zone in zones for a, b in legs) >= ROOM_M - 1e-6
    assert sum(math.dist(a, b) for a, b in legs) < longest_m


def test_where_there_is_no_way_none_is_found() -> None:
    cage = polygon("cage", True, [(-100.0, -300.0), (149.0, -300.0), (149.0, 300.0), (-100.0, 300.0)])
    assert found((cage, WALL), (0.0, 0.0), (140.0, 0.0)) is not None
    assert found((cage, WALL), (0.0, 0.0), (240.0, 0.0)) is None


def test_from_within_the_room_the_way_leads_out() -> None:
    by = found((WALL,), (98.0, 0.0), (200.0, 0.0))
    assert by is not None
    assert math.dist((98.0, 0.0), by[0]) > 150.0


class Sea:
    """A boat at the origin of its plane, south of a wall 80 m long."""

    def __init__(self, *overrides: str) -> None:
        self.run = Lockstep(config.load(VEHICLE, ("simulation.heading_deg=0.0", *overrides)), 1, lambda clock: NoLog())
        self.sail(5.0)
        corners = [(40.0, -40.0), (50.0, -40.0), (50.0, 40.0), (40.0, 40.0)]
        area = config.Area(polygon=tuple(self.at(*each) for each in corners), name="wall")
        assert self.run.command(console.SetFence(config.Zones(keep_out=(area,)))) is None

    def at(self, north_m: float, east_m: float) -> tuple[float, float]:
        assert self.run.state.origin is not None
        latitude_rad, longitude_rad = geodesy.from_plane(self.run.state.origin, north_m, east_m)
        return math.degrees(latitude_rad), math.degrees(longitude_rad)

    def sail(self, seconds: float) -> float:
        """The smallest clearance meanwhile."""
        smallest = math.inf
        for state in self.run.cycles(seconds):
            around = self.run.vehicle.helm.plans.fence
            here = state.motion.north_m, state.motion.east_m
            smallest = min([smallest, *(clearance_m(zone, *here) for zone in (around.zones if around is not None else ()))])
        return smallest

    def goes(self, north_m: float, east_m: float) -> str | None:
        return self.run.command(console.Goto(*self.at(north_m, east_m)))


def test_a_goto_whose_straight_way_is_forbidden_is_led_round() -> None:
    sea = Sea()
    assert sea.goes(90.0, 0.0) is None
    assert (sea.run.state.mode, sea.run.state.setpoint.target) == (Mode.GOTO, None), "waits meanwhile"
    assert sea.sail(180.0) > 3.0
    assert sea.run.state.mode is Mode.HOLD, "it has arrived"
    assert math.dist((sea.run.state.motion.north_m, sea.run.state.motion.east_m), (90.0, 0.0)) < 10.0


def test_a_goto_that_was_paused_on_its_way_round_goes_on_round() -> None:
    sea = Sea()
    assert sea.goes(90.0, 0.0) is None
    sea.sail(20.0)
    assert sea.run.state.setpoint.via
    assert "as the way leads through wall" in sea.run.state.reason
    assert sea.run.command(console.Pause()) is None
    sea.sail(10.0)
    assert sea.run.command(console.Continue()) is None
    assert sea.sail(180.0) > 3.0
    assert math.dist((sea.run.state.motion.north_m, sea.run.state.motion.east_m), (90.0, 0.0)) < 10.0


def test_a_stop_or_another_command_ends_the_search() -> None:
    for command, mode in ((console.Stop(), Mode.IDLE), (console.Heading(90.0, 1.0), Mode.HEADING)):
        sea = Sea()
        assert sea.goes(90.0, 0.0) is None
        assert sea.run.command(command) is None
        sea.sail(5.0)
        assert sea.run.state.mode is mode


def test_a_goto_into_a_zone_is_refused_and_one_without_a_way_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    sea = Sea()
    assert sea.goes(45.0, 0.0) == "goto refused: the way leads through wall"
    monkeypatch.setattr(detour, "MOST", 1)
    assert sea.goes(90.0, 0.0) is None
    sea.sail(5.0)
    assert (sea.run.state.mode, sea.run.state.setpoint.target) == (Mode.GOTO, None)
    assert sea.run.state.reason == "no way round is found (the way leads through wall): waits for another point"
