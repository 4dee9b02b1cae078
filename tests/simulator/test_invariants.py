"""The true place of the hull, and its clearance of the fence, as those who look at a run are told them."""

from random import Random
from types import SimpleNamespace
from typing import cast

from delfim import config
from delfim.base.geodesy import origin
from delfim.simulator.invariants import onlooker
from delfim.simulator.invariants.onlooker import TruePlace
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle.plans.fence import Fence
from delfim.vehicle.plans.zones import Zone, circle, clearance_m, polygon

HERE = origin(0.67, -0.16)
ZONES = (
    polygon("in", True, [(-50.0, -50.0), (-50.0, 50.0), (50.0, 60.0), (40.0, -50.0)]),
    circle("out", False, (10.0, 5.0), 8.0),
)


def placed(zones: tuple[Zone, ...]) -> tuple[TruePlace, SimpleNamespace, SimpleNamespace]:
    """The place, the model that it looks at, and the plans that have the fence."""
    model = SimpleNamespace(origin=HERE, north_m=0.0, east_m=0.0)
    plans = SimpleNamespace(fence=Fence(zones, config.FenceTable()))
    vehicle = SimpleNamespace(helm=SimpleNamespace(plans=plans))
    run = SimpleNamespace(nodes=SimpleNamespace(model=model), vehicle=vehicle, state=SimpleNamespace(origin=HERE))
    return TruePlace(cast(Lockstep, run)), model, plans


def test_a_clearance_is_exact_where_it_is_less_than_asked_and_seldom_found_where_it_is_not(monkeypatch):
    found = list[str]()
    monkeypatch.setattr(onlooker, "clearance_m", lambda zone, *at: found.append(zone.name) or clearance_m(zone, *at))
    (place, model, _), random, least_m = placed(ZONES), Random("walk"), 1e9
    for _ in range(5000):
        model.north_m += random.uniform(-1.0, 1.0)
        model.east_m += random.uniform(-1.0, 1.0)
        place.look()
        assert place.at is not None
        truth_m = min(clearance_m(zone, *place.at) for zone in ZONES)
        for within_m in (5.0, least_m):
            told_m = place.clear_m(within_m)
            assert told_m == truth_m if truth_m < within_m else within_m <= told_m <= truth_m
        least_m = min(least_m, truth_m)
    assert least_m < -1.0, "the walk leaves the fence"
    assert len(found) < 5000 * len(ZONES)


def test_another_fence_is_looked_at_at_once():
    place, _, plans = placed(ZONES[:1])
    place.look()
    assert place.clear_m(1.0) > 30.0
    plans.fence = Fence(ZONES[1:], config.FenceTable())
    assert 0.0 < place.clear_m(5.0) < 5.0
    plans.fence = None
    assert place.clear_m(5.0) == float("inf")
