"""Whether a way leads ashore, with zones that are played: which piece of it is looked at, how far from what, and how long."""

import math
from typing import Any

import pytest

from delfim.config import FenceTable
from delfim.parts.traffic import shoreline
from delfim.parts.traffic.cpa import Leg
from delfim.parts.traffic.encounter import Own
from delfim.parts.traffic.shoreline import Shoreline
from delfim.vehicle.plans.fence import RECEDES_M, Fence
from delfim.vehicle.plans.zones import Zone, circle

LIMITS = FenceTable(margin_m=4.0, mission_margin_m=8.0, reaction_s=1.0, deceleration_mps2=0.25)  # 3 m at 1 m/s, 10 m at 2 m/s
OWN = Own(100.0, -200.0, 0.0, 1.0)
STAYS: Leg = (0.0, math.inf, 100.0, -200.0, 0.0, 0.0)
TWO: tuple[Leg, ...] = ((0.0, 5.0, 100.0, -200.0, 0.6, 0.8), (5.0, math.inf, 103.0, -196.0, 0.0, 0.0))


def rock(ahead_m: float, keep_in: bool = False) -> Zone:
    return circle(f"rock {ahead_m:.0f}", keep_in, (OWN.north_m + ahead_m, OWN.east_m), 10.0)


class Water:
    """All zones are so far from the boat, and so near to its way; what is looked at is written down."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, here_m: float = 3.0, smallest_m: float = math.inf) -> None:
        self.here_m, self.smallest_m, self.looked, self.cost = here_m, smallest_m, 1, 0
        self.ways = list[Any]()
        monkeypatch.setattr(shoreline, "least", self.least)
        monkeypatch.setattr(shoreline, "cost", lambda zone, at: self.cost)
        monkeypatch.setattr(shoreline, "clearance_m", lambda zone, north_m, east_m: self.here_m)

    def least(self, zone: Zone, a: object, b: object, within_m: float) -> tuple[float, int]:
        self.ways.append((zone.name, a, b, within_m))
        return self.smallest_m, self.looked

    def shore(self, *zones: Zone, limits: FenceTable = LIMITS) -> Shoreline:
        return Shoreline(Fence(zones or (rock(20.0),), limits), OWN, 90.0)


def test_zones_within_reach_are_looked_at_and_those_to_stay_in_always(monkeypatch: pytest.MonkeyPatch) -> None:
    water = Water(monkeypatch)
    shore = water.shore(rock(111.0), rock(112.0), rock(5000.0, keep_in=True))  # 90, 3 and 8 m beyond its edge
    assert not shore.meets([STAYS], 90.0, is_route=True)
    here = 100.0, -200.0
    assert water.ways == [("rock 111", here, here, 4.0), ("rock 5000", here, here, 4.0)]
    assert not water.shore(rock(112.0)).meets([STAYS], 90.0, is_route=True)
    assert len(water.ways) == 2


@pytest.mark.parametrize(("mission_m", "is_route", "margin_m"), [(8.0, True, 4.0), (8.0, False, 8.0), (2.0, False, 4.0)])
def test_trials_keep_the_distance_of_missions(monkeypatch, mission_m, is_route, margin_m):
    water = Water(monkeypatch)
    limits = FenceTable(margin_m=4.0, mission_margin_m=mission_m)
    assert not water.shore(limits=limits).meets([STAYS], 90.0, is_route)
    assert [way[3] for way in water.ways] == [margin_m]


@pytest.mark.parametrize(
    ("leg", "is_route", "for_s"),
    [
        ((10.0, 20.0, 110.0, -195.0, 0.6, 0.8), True, 10.0),
        ((10.0, 20.0, 110.0, -195.0, 0.6, 0.8), False, 13.0),
        ((10.0, 20.0, 110.0, -195.0, 1.2, 1.6), False, 15.0),
        ((80.0, math.inf, 110.0, -195.0, 1.2, 1.6), False, 15.0),
        ((89.0, 99.0, 110.0, -195.0, 1.2, 1.6), True, 1.0),
        ((10.0, 20.0, 110.0, -195.0, 0.0, 0.0), False, 0.0),
    ],
)
def test_a_way_is_looked_at_as_far_as_the_boat_comes_and_would_need_to_stop(monkeypatch, leg, is_route, for_s):
    water = Water(monkeypatch)
    assert not water.shore().meets([leg, (90.0, math.inf, 0.0, 0.0, 1.0, 0.0)], 90.0, is_route)
    ((_, a, b, _),) = water.ways
    assert a == (110.0, -195.0)
    assert b == pytest.approx((110.0 + leg[4] * for_s, -195.0 + leg[5] * for_s))


@pytest.mark.parametrize(("here_m", "looks"), [(8.0, 2), (9.0, 2), (9.5, 0)])
def test_a_zone_that_the_way_cannot_come_near_is_not_looked_at(monkeypatch, here_m, looks):
    """Five metres of way, and four that must be left."""
    water = Water(monkeypatch, here_m)
    assert not water.shore().meets(TWO, 90.0, is_route=True)
    assert len(water.ways) == looks


@pytest.mark.parametrize(
    ("here_m", "smallest_m", "meets"),
    [
        (9.0, 4.0, False),
        (9.0, 3.5, True),
        (3.0, 2.5, True),
        (3.0, 3.0 - RECEDES_M, False),
        (3.0, 2.995, False),
        (3.0, 3.0, False),
    ],
)
def test_a_way_leads_ashore_that_comes_nearer_than_the_margin_and_than_the_boat_is(monkeypatch, here_m, smallest_m, meets):
    shore = Water(monkeypatch, here_m, smallest_m).shore(rock(20.0), rock(30.0))
    assert shore.limits is LIMITS
    assert shore.name == ""
    assert shore.meets(TWO[:1], 90.0, is_route=True) is meets
    assert shore.name == ("rock 20" if meets else "")


def test_with_too_many_corners_about_each_way_leads_ashore(monkeypatch: pytest.MonkeyPatch) -> None:
    water = Water(monkeypatch)
    shore = water.shore()
    water.looked, water.cost = 100, 50
    for _ in range(4):
        assert not shore.meets([STAYS], 90.0, is_route=True), "600 comparisons"
    water.looked, water.cost = 1, 0
    assert shore.meets([STAYS], 90.0, is_route=True)
    assert shore.name == "rock 20"
