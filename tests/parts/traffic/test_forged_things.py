"""Whatever is made up of ships and of things, no order leads over the fence, or for longer than the file says; and the operator
overrules it by one order.
"""

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.cooperative import Sliced
from delfim.base.modes import Mode
from delfim.parts.traffic.encounter import Own
from delfim.parts.traffic.keepclear import Memory, decide
from delfim.parts.traffic.leash import Leash, paid_out
from delfim.parts.traffic.pastthings import past
from delfim.parts.traffic.trialways import RouteAhead
from delfim.parts.traffic.watchkeeper import OVERRULED
from delfim.simulator.scenarios import random_faults
from delfim.simulator.scenarios.chased import forged
from delfim.vehicle import console
from delfim.vehicle.plans.fence import Fence, outside
from delfim.vehicle.plans.zones import circle, clearance_m
from delfim.vehicle.target import STATUS_UNKNOWN, CourseOrder, Target
from tests.parts.traffic.encounters import LIMITS
from tests.parts.traffic.test_forged_vessels import FLEET, Attack

VEHICLE = Path(__file__).parents[3] / "etc/delfimx.toml"
FENCE = Fence(
    (
        circle("bay", True, (0.0, 0.0), 120.0),
        circle("pier", False, (50.0, 20.0), 15.0),
        circle("rock", False, (-30.0, -60.0), 8.0),
    ),
    config.FenceTable(),
)
KEPT_M = FENCE.limits.mission_margin_m
SHORT_S = 5.0  # for which the boat follows an order at least
places = st.tuples(st.floats(-120.0, 120.0), st.floats(-120.0, 120.0))
courses = st.floats(-math.pi, math.pi)
things = st.tuples(places, st.sampled_from(("thing", "person")), st.sampled_from((0.5, 2.0, 20.0)))
ships = st.tuples(places, courses, st.floats(0.0, 10.0), st.sampled_from((6.0, 40.0, 200.0)))


def clear_m(at: tuple[float, float]) -> float:
    return min(clearance_m(zone, *at) for zone in FENCE.zones)


def thing_at(number: int, at: tuple[float, float], kind: str, radius_m: float) -> Target:
    size = (0.0, 0.0, math.nan, 2.0 * radius_m, 2.0 * radius_m)
    return Target(f"{kind} {number}", f"{kind} {number}", *at, *size, True, 2.0, 0.0, False, kind, STATUS_UNKNOWN)


def ship_at(number: int, at: tuple[float, float], course_rad: float, speed_mps: float, length_m: float) -> Target:
    size = (course_rad, speed_mps, course_rad, length_m, length_m / 6.0)
    return Target(str(number), f"ship {number}", *at, *size, True, 10.0, 0.0, False, "A", STATUS_UNKNOWN)


@given(st.lists(things, min_size=1, max_size=25), places, places, courses)
def test_no_way_past_made_up_things_leads_over_the_fence(rows, at, to, course_rad) -> None:
    if clear_m(at) < KEPT_M + 1.0:
        return
    told = [thing_at(number, *row) for number, row in enumerate(rows)]
    passage = Sliced(past(LIMITS, Own(*at, course_rad, 1.5), RouteAhead((to,), 1.5), told, FENCE, None)).finish()
    if passage is None or not passage.part:
        return
    north_m, east_m = passage.points[0]
    if (north_m, east_m) == to:
        return  # the mode's own way, which was checked when it was ordered
    for i in range(1, 21):
        assert clear_m((at[0] + i / 20 * (north_m - at[0]), at[1] + i / 20 * (east_m - at[1]))) > KEPT_M - 0.5


@given(st.lists(ships, min_size=1, max_size=12), places, places, courses, st.floats(0.0, 2.0))
def test_no_order_for_made_up_ships_leads_nearer_to_the_fence(rows, at, to, course_rad, speed_mps) -> None:
    if clear_m(at) < KEPT_M:
        return
    told = [ship_at(number, *row) for number, row in enumerate(rows)]
    own = Own(*at, course_rad, speed_mps)
    _, order, _ = decide(LIMITS, Memory(), own, RouteAhead((to,), 1.5), told, FENCE, 0.0)
    if order is None or not order.speed_mps or outside(FENCE, *at):
        return
    far_m = order.speed_mps * SHORT_S
    there = at[0] + far_m * math.cos(order.course_rad), at[1] + far_m * math.sin(order.course_rad)
    assert clear_m(there) > min(KEPT_M, clear_m(at)) - 0.5


@given(st.lists(st.integers(1, 60), max_size=60), st.floats(30.0, 300.0))
def test_however_it_is_led_and_let_go_it_is_led_for_half_of_the_time_and_away_s(spans, away_s) -> None:
    """Spans of seconds for which somebody would lead it, and lets it go, in turn."""
    limits, leash, led_s, now_s = config.TrafficGuard(away_s=away_s), Leash(at_s=0.0), 0.0, 0.0
    order = CourseOrder(1.0, 1.0, 1.5, "away", "1", 1.0, 0.0)
    route = RouteAhead(((0.0, 0.0),), 1.5, has_end=False, place=(0.0, 0.0))
    for number, seconds in enumerate(spans):
        for _ in range(seconds):
            now_s += 1.0
            given_order = order if number % 2 == 0 and not leash.spent else None
            led_s += given_order is not None
            leash = paid_out(leash, limits, "", route, Own(10.0, 0.0, 0.0, 1.5), given_order, now_s)
            assert led_s <= 0.5 * (now_s + away_s) + 2.0


@pytest.mark.parametrize("seed", [0, 4, 9, 17])
def test_runs_of_the_campaign_of_made_up_things(seed: int) -> None:
    """Some of etc/campaigns/forged.toml."""
    assert not random_faults.sail_mixed(VEHICLE, seed, (), forged).failures


def led_away(**guard: object) -> Attack:
    attack = Attack(FLEET, traffic={"guard": guard}).obey(console.SetMode("hold")).after(40.0)
    assert attack.run.state.traffic.order is not None
    return attack


def test_the_operator_overrules_the_guard_at_once_and_is_told_so() -> None:
    attack = led_away().obey(console.Overrule())
    attack.after(0.4)
    assert attack.run.state.traffic.order is None
    attack.after(60.0)
    assert attack.run.state.mode is Mode.HOLD
    assert attack.run.state.traffic.guard == f"cannot avoid: {OVERRULED}"
    assert OVERRULED in attack.notices["traffic"]
    assert "traffic: overruled for 600 s: operator" in attack.notes
    model, memory = attack.run.nodes.model, attack.run.vehicle.helm.memory
    assert math.dist((model.north_m, model.east_m), (memory.north_m, memory.east_m)) < 8.0, "it is back at its place"


def test_the_same_order_again_gives_way_again_and_so_does_time() -> None:
    again = led_away().obey(console.Overrule()).after(5.0).obey(console.Overrule()).after(10.0)
    assert again.run.state.traffic.order is not None
    assert "traffic: the guard works again: operator" in again.notes
    assert led_away(overruled_s=20.0).obey(console.Overrule()).after(30.0).run.state.traffic.order is not None


def test_what_the_file_says_of_a_guard_that_fails_is_not_done() -> None:
    attack = Attack(FLEET, traffic={"guard": {"on_failure": "hold"}}).obey(console.Course(0.0, 1.0)).after(20.0)
    attack.obey(console.Overrule()).after(20.0)
    assert attack.run.state.mode is Mode.COURSE


def test_a_boat_without_a_guard_has_nothing_to_overrule() -> None:
    attack = Attack([], traffic={"guard": {"enabled": False}})
    assert attack.run.command(console.Overrule()) == "overrule refused: the boat gives way to nobody, by its file"
