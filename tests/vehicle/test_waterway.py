"""The way through water that a chart leaves free: found, kept room on, short, and "there is no way" told with the reason."""

import itertools
import math
from collections.abc import Sequence
from pathlib import Path

import pytest

from delfim import config
from delfim.base.cooperative import Sliced
from delfim.base.modes import Mode
from delfim.vehicle import console
from delfim.vehicle.helm import detour
from delfim.vehicle.helm.waterway import Shut, way_through
from delfim.vehicle.plans.clearance import laid
from delfim.vehicle.plans.clearancefile import read
from delfim.vehicle.plans.fence import Fence
from delfim.vehicle.plans.zones import Point, Zone, charted, least, polygon
from tests.vehicle.charted import Shoal, chart
from tests.vehicle.test_charted import AT, CharteredSea

ROOM_M = 6.0
ROCK = (0.0, 0.0, 60.0)
RING = [(150.0 + 40.0 * math.cos(t / 4.0), 40.0 * math.sin(t / 4.0), 12.0) for t in range(26)]
"""Shoals all about a pond."""
WALL = polygon("wall", False, [(-10.0, -200.0), (10.0, -200.0), (10.0, 100.0), (-10.0, 100.0)])


def found(shoals: Sequence[Shoal], a: Point, b: Point, *zones: Zone) -> tuple[list[Point], Fence] | Shut:
    """The whole way, and the fence that it was found in."""
    field = laid(read(chart(AT, shoals)).water(""), AT)
    around = Fence((*zones, charted("no-go water", field)), config.FenceTable())
    by = Sliced(way_through(around, field, a, b, ROOM_M, [])).finish()
    return by if isinstance(by, Shut) else ([a, *by, b], around)


def length_m(way: Sequence[Point]) -> float:
    return sum(math.dist(a, b) for a, b in itertools.pairwise(way))


def test_the_way_round_a_rock_keeps_its_room_and_is_hardly_longer_than_the_shortest() -> None:
    for far_m in (80.0, 140.0, 220.0):
        by = found([ROCK], (-far_m, 3.0), (far_m, -2.0))
        assert not isinstance(by, Shut)
        way, around = by
        assert min(least(around.zones[0], a, b)[0] for a, b in itertools.pairwise(way)) > ROOM_M - 1.0
        radius_m = ROCK[2] + ROOM_M  # two tangents, and the arc between them
        shortest_m = 2.0 * math.sqrt(far_m**2 - radius_m**2) + radius_m * (math.pi - 2.0 * math.acos(radius_m / far_m))
        assert length_m(way) < 1.01 * shortest_m


def test_the_way_leads_round_zones_of_the_fence_too() -> None:
    by = found([(0.0, 170.0, 40.0)], (-100.0, 0.0), (100.0, 0.0), WALL)
    assert not isinstance(by, Shut)
    way, around = by
    assert all(least(zone, a, b)[0] > ROOM_M - 1.0 for zone in around.zones for a, b in itertools.pairwise(way))
    assert max(east_m for _, east_m in way) > 100.0
    assert length_m(way) < 2.0 * math.dist((100.0, 0.0), (10.0, 106.0)) + 20.0 + 3.0, "by the corners of its room"
    canal = polygon("canal", True, [(-200.0, -40.0), (200.0, -40.0), (200.0, 40.0), (-200.0, 40.0)])
    assert isinstance(found([ROCK], (-100.0, 0.0), (100.0, 0.0), canal), Shut), "the rock fills the canal"


def test_without_a_way_it_is_told_who_is_shut_in() -> None:
    pond, sea = (150.0, 0.0), (-150.0, 0.0)
    assert found(RING, sea, pond) == Shut("no-go water is all about the target")
    assert found(RING, pond, sea) == Shut("no-go water is all about the boat")
    assert not isinstance(found(RING[2:-3], sea, pond), Shut), "a gate stands open"
    assert found([], sea, (150.0, 298.0)) == Shut("no free water is near the target"), "the chart ends there"
    assert found([(-150.0, 0.0, 140.0)], sea, pond) == Shut("no free water is near the boat")


def test_from_within_the_room_the_way_leads_out() -> None:
    by = found([ROCK], (-62.0, 0.0), (100.0, 0.0))
    assert not isinstance(by, Shut)
    way, around = by
    assert least(around.zones[0], *way[:2])[0] > 0.5
    assert all(least(around.zones[0], a, b)[0] > ROOM_M - 1.0 for a, b in itertools.pairwise(way[1:]))


def test_the_way_is_the_same_in_slices_of_any_size_and_a_slice_is_small() -> None:
    field = laid(read(chart(AT, [ROCK, *RING])).water(""), AT)
    around = Fence((charted("no-go water", field),), config.FenceTable())
    ways = list[object]()
    for size in (1, 200):
        work = Sliced(way_through(around, field, (-140.0, 3.0), (120.0, 150.0), ROOM_M, []))
        spent = 0
        while not work.step(size):
            assert work.spent - spent < size + 100
            spent = work.spent
        ways.append(work.result)
    assert ways[0] == ways[1]


@pytest.fixture
def sea(tmp_path: Path) -> CharteredSea:
    return CharteredSea(tmp_path)


def test_goto_leads_round_what_the_chart_forbids(sea: CharteredSea) -> None:
    assert sea.run.command(console.Goto(*sea.at(150.0, 0.0))) is None
    assert (sea.run.state.mode, sea.run.state.setpoint.target) == (Mode.GOTO, None), "waits meanwhile"
    nearest_m = math.inf
    for _ in sea.run.cycles(200.0):
        around = sea.run.vehicle.helm.plans.fence
        assert around is not None
        motion = sea.run.state.motion
        nearest_m = min(nearest_m, least(around.zones[-1], (motion.north_m, motion.east_m), (motion.north_m, motion.east_m))[0])
    assert nearest_m > 3.0
    assert sea.run.state.mode is Mode.HOLD, "it has arrived"
    assert math.dist(sea.here, (150.0, 0.0)) < 10.0


@pytest.mark.parametrize(
    ("shoals", "most", "why"),
    [(RING, detour.CHARTED_MOST, "no-go water is all about the target"), ([(90.0, 0.0, 30.0)], 1, "the search took too long")],
)
def test_a_goto_without_a_way_waits_and_says_why(
    shoals: Sequence[Shoal], most: int, why: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.vehicle.test_charted.DATA", chart(AT, shoals))
    monkeypatch.setattr(detour, "CHARTED_MOST", most)
    monkeypatch.setattr(detour, "MOST", 0)
    shut = CharteredSea(tmp_path)
    assert shut.run.command(console.Goto(*shut.at(150.0, 0.0))) is None
    for state in shut.run.cycles(1.0):  # told within a second
        if state.reason.startswith("no way"):
            break
    assert (shut.run.state.mode, shut.run.state.setpoint.target) == (Mode.GOTO, None)
    assert shut.run.state.reason == (
        f"no way leads there, {why} (the way leads through no-go water of chart XX5TEST1 edition 2): waits for another point"
    )
