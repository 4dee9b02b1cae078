"""The largest inputs of a look-out aboard, for `python -m bench costs`: as many vessels and things as are known at once, by the
largest chart.
"""

import math
from collections.abc import Iterator
from random import Random
from typing import Final, Literal

from delfim import config
from delfim.base import geodesy
from delfim.base.cooperative import Sliced
from delfim.base.vessels import ThingSeen, VesselPosition
from delfim.parts.traffic import keepclear, things
from delfim.parts.traffic.encounter import Own
from delfim.parts.traffic.pastthings import past
from delfim.parts.traffic.targets import MOST as VESSELS
from delfim.parts.traffic.trialways import Caution, RouteAhead
from delfim.parts.traffic.watchkeeper import AMONG_THINGS
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.plans.clearance import METRES, ClearanceField, LaidGrid
from delfim.vehicle.plans.fence import Fence
from delfim.vehicle.plans.zones import charted
from delfim.vehicle.state import NoLog
from delfim.vehicle.target import Target

THINGS: Final = things.MOST
Callbacks = Iterator[object]  # as those of `bench.costs`
KNOTS: Final = 1024  # a side of the grids of a chart
TICKS: Final = 40
WARM_S: Final = 3.0
SEEN: Final = 12  # in a step, the most that one takes: five programs may tell 20 a second each


def field(near_m: float) -> ClearanceField:
    """A chart as large as one may be, with a danger so near everywhere: no look goes farther at once."""
    codes, most = bytes([next(code for code in range(256) if METRES[code] >= near_m)]) * KNOTS**2, KNOTS - 1
    grids = (LaidGrid(1.0 / m, KNOTS / 2, 1.0 / m, KNOTS / 2, most, most, KNOTS, 0.0, codes) for m in (4.0, 10.0))
    return ClearanceField(tuple(grids), 1.0)


def by_a_chart() -> Fence:
    """With so much room that a boat may sail there."""
    return Fence((charted("the largest chart", field(12.0)),), config.FenceTable())


def watched(settings: config.Vehicle, kind: Literal["thing", "person"]) -> Callbacks:
    """A step of the watch each, from the first report on. Swimmers are too far from each other to be taken for one, and all
    swim."""
    random, sea = Random(1), Lockstep(settings, 1, lambda clock: NoLog())
    for _ in sea.cycles(WARM_S):
        pass
    assert sea.command(console.Course(0.0, 1.5)) is None
    sea.vehicle.helm.plans.fence = by_a_chart()
    at = sea.state.origin
    assert at is not None
    for i in range(VESSELS):
        place = geodesy.from_plane(at, random.uniform(100.0, 900.0), random.uniform(-600.0, 600.0))
        course_rad, speed_mps = random.uniform(0.0, math.tau), random.uniform(0.5, 6.0) if i < keepclear.MOST else 0.5
        sea.state.hear(VesselPosition(200_000_000 + i, *place, course_rad, speed_mps, None, None, "B"), "ais", sea.elapsed_s)
    far = 1.0 if kind == "thing" else 8.0
    places = [(random.uniform(10.0, 190.0) * far, random.uniform(-60.0, 60.0) * far) for _ in range(THINGS)]
    swims = (None, None) if kind == "thing" else (1.0, 0.7)
    seen = [ThingSeen(*geodesy.from_plane(at, *place), 0.5, kind, 1.0, *swims) for place in places]
    yield None
    for tick in range(TICKS):
        sea.clock.advance(0.1)
        for number in range(SEEN):
            sea.state.hear(seen[(SEEN * tick + number) % THINGS], "payload lidar", sea.elapsed_s, f"lidar {number}")
        sea.vehicle.on_watchdog()
        yield None


def passed() -> Callbacks:
    """A slice each of the way past all things."""
    random, own, route = Random(1), Own(0.0, 0.0, 0.0, 1.5), RouteAhead(((200.0, 0.0),), 1.5)
    places = [(random.uniform(10.0, 190.0), random.uniform(-60.0, 60.0)) for _ in range(THINGS)]
    standing = [_standing(i, *place) for i, place in enumerate(sorted(places, key=lambda place: math.hypot(*place)))]
    sliced = Sliced(past(Caution(4.5, 0.26, 0.4), own, route, standing, by_a_chart(), None))
    yield None
    while not sliced.step(AMONG_THINGS):
        yield None
    yield None


def _standing(number: int, north_m: float, east_m: float) -> Target:
    return Target(f"thing {number}", "thing", north_m, east_m, 0.0, 0.0, math.nan, 1.0, 1.0, True, 2.0, 0.0, False, "thing", 15)
