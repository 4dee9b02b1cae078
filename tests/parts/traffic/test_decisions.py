"""How a decision goes from the vessels in question to an order: with costs that are played, and the words that people read."""

import math
from collections.abc import Sequence
from typing import Any

import pytest

from delfim.parts.traffic import keepclear
from delfim.parts.traffic.cpa import Approach, Leg
from delfim.parts.traffic.encounter import Duty, Own
from delfim.parts.traffic.keepclear import Choice, Decision, Memory, PassedBy, Seen, decide
from delfim.parts.traffic.trialways import RouteAhead, route_legs, trial_legs
from delfim.vehicle.target import CourseOrder
from tests.parts.traffic.test_trial_costs import EAST, FAR, LIMITS, NORTH, OWN, Shore, lies, scene, vessel

ROUTE = RouteAhead(((400.0, 100.0),), 2.0)  # to the north-east
NEAR = Approach(1.25, 50.0, 0.0, 0.0)
TO_STARBOARD = (30, 45, 60, 75, 90, 120, 150, 180)
BOTH = (30, -30, 45, -45, 60, -60, 75, -75, 90, -90, 120, -120, 150, -150, 180)
STRAIGHT = [(0, 0.5), (0, 0.0)]
WAS = Choice(1.0, 1.0, False)
ORDER = CourseOrder(1.0, 1.0, 2.0, "", "1", 1.2, 0.0)
GIVE_WAY: Duty = "give-way"
INF = math.inf


def trials(*degrees: int) -> list[tuple[int, float]]:
    return [(each, part) for each in degrees for part in (1.0, 0.5)]


class Played:
    """A decision whose vessels, costs and ways into domains are played; what is asked for is written down."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *seen: Seen, route: float = 1000.0, others: float = 500.0) -> None:
        self.seen, self.costs, self.route, self.others = list(seen), dict[tuple[int, float], float](), route, others
        self.leads_in, self.scene, self.slices = False, scene(*seen), list[int]()
        self.asked, self.ways, self.tried, self.shore = list[Any](), list[Any](), list[tuple[int, float]](), Shore(is_met=False)
        for name in ("_in_question", "_cost", "_leads_in", "Shoreline", "_waits"):
            monkeypatch.setattr(keepclear, name, getattr(self, name))

    def _in_question(self, *told: Any) -> Any:
        self.asked.append(told)
        yield from ()
        return self.seen

    def _waits(self, limits: object, this: Seen, on: object) -> bool:
        return this.target.key == "waits"

    def Shoreline(self, *told: Any) -> Shore:  # noqa: N802 - in place of a class
        self.asked.append(told)
        return self.shore

    def _leads_in(self, of: object, legs: Sequence[Leg]) -> bool:
        self.ways.append(legs)
        return self.leads_in

    def _cost(self, *told: Any, is_route: bool = False) -> float:
        self.asked.append((*told, is_route))
        if is_route:
            return self.route
        trial = round(math.degrees(told[2])), told[3]
        self.tried.append(trial)
        return self.costs.get(trial, self.others)

    def cheapest(self, was: Choice | None = None, ahead_rad: float = 0.0) -> Choice | None:
        """The best trial, of a boat that goes north along its route and sees all that is seen."""
        work = keepclear._cheapest(LIMITS, self.scene, OWN, ahead_rad, ROUTE, NORTH, was)
        while True:
            try:
                self.slices.append(next(work))
            except StopIteration as end:
                return end.value  # type: ignore[no-any-return]


def test_all_trials_are_compared_and_the_cheapest_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    played = Played(monkeypatch, lies(0.0, 0.0, duty="stand-on", without=NEAR), lies(0.0, 0.0, duty="give-way"))
    assert played.cheapest() == pytest.approx((math.radians(30.0), 1.0, False, False))
    assert played.tried == [*trials(*BOTH[:-1]), (180, 1.0), (180, 0.5), *STRAIGHT]
    assert played.slices == [6] * 32
    assert played.asked[0] == (played.scene, NORTH, 0.0, 1.0, 2.0, INF, True)
    of, legs, turn_rad, part, far, enough, _ = played.asked[1]
    assert (of, legs) == (played.scene, trial_legs(LIMITS, OWN, math.radians(30.0), 2.0))
    assert (turn_rad, part, far, enough) == (pytest.approx(math.radians(30.0)), 1.0, 2.0, 994.0)
    assert played.asked[2][5] == 500.0
    assert played.ways == []


@pytest.mark.parametrize("trial", [(30, 0.5), (-45, 1.0), (-150, 0.5), (180, 1.0), (0, 0.5), (0, 0.0)])
def test_the_cheapest_trial_is_named_by_its_course(monkeypatch: pytest.MonkeyPatch, trial: tuple[int, float]) -> None:
    played = Played(monkeypatch, lies(0.0, 0.0, duty="give-way", without=NEAR._replace(nearness=1.3)))
    played.costs[trial] = 10.0
    found = played.cheapest(ahead_rad=3.0)
    assert found is not None
    turn_rad = math.remainder(found.course_rad - 3.0 - math.radians(trial[0]), math.tau)
    assert turn_rad == pytest.approx(0.0, abs=1e-9)
    assert found[1:] == (trial[1], False, False)
    assert -math.pi <= found.course_rad <= math.pi


@pytest.mark.parametrize("duty", ["head-on", "give-way"])
def test_to_port_of_a_vessel_from_starboard_only_where_all_else_leads_in(monkeypatch: pytest.MonkeyPatch, duty: Any) -> None:
    played = Played(monkeypatch, lies(0.0, 0.0, duty=duty, without=NEAR))
    played.costs = {(-45, 0.5): 350.0, (90, 1.0): 400.0}
    assert played.cheapest() == pytest.approx((math.radians(90.0), 1.0, False, False))
    assert played.tried == [*trials(*TO_STARBOARD), *STRAIGHT]
    assert played.ways == [trial_legs(LIMITS, OWN, math.radians(90.0), 2.0)]
    played.leads_in = True
    played.tried.clear()
    assert played.cheapest() == pytest.approx((math.radians(-45.0), 0.5, True, False))
    assert played.tried == [*trials(*TO_STARBOARD), *STRAIGHT, *trials(-30, -45, -60, -75, -90, -120, -150)]
    assert len(played.ways) == 2
    played.others = 2000.0
    played.costs = {}
    assert played.cheapest() is None
    assert played.ways[-1] is NORTH, "the route is the best so far"
    played.costs = {(0, 0.5): 10.0}
    assert played.cheapest() == (0.0, 0.5, False, False)


def test_another_course_must_be_better_than_the_one_steered(monkeypatch: pytest.MonkeyPatch) -> None:
    played = Played(monkeypatch)
    steered = Choice(math.radians(50.0), 1.0, True)
    played.costs = {(50, 1.0): 100.0, (90, 1.0): 79.0}
    assert played.cheapest(steered) == steered
    assert [told[5] for told in played.asked[1:3]] == [1006.0, 79.0]
    assert played.tried[:3] == [(50, 1.0), (30, 1.0), (30, 0.5)]
    played.costs[(90, 1.0)] = 78.5
    assert played.cheapest(steered) == pytest.approx((math.radians(90.0), 1.0, False, False))
    played.costs = {(50, 1.0): 1006.0, (90, 1.0): 849.0}
    assert played.cheapest(steered) == pytest.approx((math.radians(30.0), 1.0, False, False))
    played.others = 2000.0
    assert played.cheapest(steered) == pytest.approx((math.radians(90.0), 1.0, False, False)), "1006 - 6 - 150.9 = 849.1"
    played.costs = {(50, 1.0): 1006.0, (90, 1.0): 849.5}
    assert played.cheapest(steered) is None


def test_a_trial_must_be_better_than_the_route_and_need_not_be_reckoned_where_its_turn_costs_more(monkeypatch):
    played = Played(monkeypatch, route=100.0, others=94.0)
    assert played.cheapest() is None
    played.others = 93.5
    assert played.cheapest() is not None
    played = Played(monkeypatch, route=12.0, others=50.0)  # half the speed costs 6, as much as is left
    assert played.cheapest() is None
    assert played.tried == [(30, 1.0), (-30, 1.0), (45, 1.0)]
    played = Played(monkeypatch, route=12.25, others=50.0)
    assert played.cheapest() is None
    assert played.tried == [(30, 1.0), (-30, 1.0), (45, 1.0), (0, 0.5)]


def test_where_all_leads_ashore_the_boat_stops(monkeypatch: pytest.MonkeyPatch) -> None:
    stop = pytest.approx((4.0 - math.tau, 0.0, False, True))
    vessels = (lies(0.0, 0.0),)
    assert Played(monkeypatch, *vessels, route=1e6, others=2e6).cheapest(ahead_rad=4.0) == stop
    assert Played(monkeypatch, *vessels, route=1e6 - 1.0, others=2e6).cheapest(ahead_rad=4.0) is None
    assert Played(monkeypatch, route=1e6, others=2e6).cheapest() is None
    assert Played(monkeypatch, route=3e6, others=2e6).cheapest(ahead_rad=4.0) == stop
    assert Played(monkeypatch, *vessels, route=3e6, others=2e6).cheapest(ahead_rad=4.0) == stop


class Decided(Played):
    """The best trial is played, too."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *seen: Seen, route: float = 1000.0, best: Choice | None = None) -> None:
        super().__init__(monkeypatch, *seen, route=route)
        monkeypatch.setattr(keepclear, "_cheapest", self._cheapest)
        self.best = best

    def _cheapest(self, *told: Any) -> Any:
        self.asked.append(told)
        yield from ()
        return self.best

    def decide(self, *, own: Own = OWN, route: RouteAhead = ROUTE, around: Any = None, **memory: Any) -> Decision:
        self.asked.clear()
        self.ways.clear()
        return decide(LIMITS, Memory(**memory), own, route, [vessel()], around, 1000.0)


def test_a_boat_whose_numbers_make_no_sense_decides_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    decided = Decided(monkeypatch, lies(0.0, 0.0), best=WAS)
    nothing = Decision(Memory(None, None, 0.0, 0.0, ()), None, ())
    for own in (OWN._replace(north_m=math.nan), OWN._replace(speed_mps=1e6)):
        assert decided.decide(own=own, order=ORDER) == nothing
    for point in ((math.nan, 0.0), (0.0, 1e6)):
        assert decided.decide(route=ROUTE._replace(points=((0.0, 0.0), point)), order=ORDER) == nothing
    for speed_mps in (-0.5, 100.0, 150.0, math.nan):
        assert decided.decide(route=ROUTE._replace(speed_mps=speed_mps), order=ORDER) == nothing
    for speed_mps in (0.0, 0.5, 99.5):
        found = decided.decide(route=ROUTE._replace(speed_mps=speed_mps))
        assert (found.order is not None, len(found.passes)) == (True, 1)


@pytest.mark.parametrize(("order", "cost", "far", "stays"), [
    (None, 5.0, 1.0, True), (None, 5.5, 1.0, False), (ORDER, 0.0, 2.0, True), (ORDER, 0.5, 2.0, False),
])  # fmt: skip
def test_the_route_is_left_for_what_costs_and_taken_again_where_nothing_does(monkeypatch, order, cost, far, stays):
    seen = lies(0.0, 0.0, duty="give-way", without=NEAR), lies(0.0, 0.0, duty=None, key="2"), lies(0.0, 0.0, key="waits")
    decided = Decided(monkeypatch, *seen, route=cost, best=WAS)
    found = decided.decide(order=order, left_s=900.0, since_s=900.0)
    on, duties = route_legs(OWN, ROUTE), (("1", GIVE_WAY),)
    assert decided.asked[0][:3] == (LIMITS, Memory(order, None, 900.0, 900.0), OWN)
    assert decided.asked[0][3:] == (pytest.approx(math.pi / 4.0), 2.0, [vessel()], on)
    mine = list(seen) if order else list(seen[:2])
    assert decided.asked[1] == ((mine, None, 1.0, True), on, 0.0, 1.0, far, INF, True)
    if stays:
        assert found[:2] == (Memory(duties=duties), None)
        assert found.passes == tuple(PassedBy(each.target.key, each.without, each.without.nearness) for each in seen)
        assert len(decided.asked) == 2
        return
    judged = list(seen), None, 1.0 + 100.0 / 180.0, True
    assert decided.asked[2] == (LIMITS, judged, OWN, decided.asked[0][3], ROUTE, on, None)
    assert found.memory == Memory(found.order, WAS, 1000.0, 900.0, duties)
    assert found.order is not None
    assert found.order[:3] == (1.0, 1.0, 2.0)
    assert (found.order.key, found.order.at_s) == ("1", 1000.0)
    assert [each.key for each in found.passes] == ["1", "2", "waits"]
    assert found.passes[0].nearness > 2.0, "of the course that it is given, not of the route"


@pytest.mark.parametrize(("speed_mps", "knows"), [(1.5, True), (0.3, True), (0.25, False)])
def test_a_boat_that_hardly_moves_owes_nothing_yet(monkeypatch: pytest.MonkeyPatch, speed_mps: float, knows: bool) -> None:
    decided = Decided(monkeypatch, lies(0.0, 0.0, duty="give-way"), lies(0.0, 0.0, key="2"), route=0.0)
    assert decided.decide(own=OWN._replace(speed_mps=speed_mps)).memory.duties == ((("1", "give-way"),) if knows else ())


def test_a_boat_without_points_looks_along_its_course(monkeypatch: pytest.MonkeyPatch) -> None:
    decided = Decided(monkeypatch)
    decided.decide(own=OWN._replace(course_rad=0.75), route=RouteAhead((), 1.0))
    assert decided.asked[0][3] == 0.75
    assert decided.asked[-1][3] == 0.75
    decided.decide(route=RouteAhead(((160.0, -120.0), (9.0, 9.0)), 1.0))
    assert decided.asked[0][3] == pytest.approx(math.atan2(80.0, 60.0))


@pytest.mark.parametrize(("has_end", "key", "order", "is_asked"), [
    (True, "waits", None, True), (False, "waits", None, False), (False, "1", None, True), (False, "waits", ORDER, True),
])  # fmt: skip
def test_a_course_is_ended_by_the_fence_and_bent_by_vessels_alone(monkeypatch, has_end, key, order, is_asked):
    decided = Decided(monkeypatch, lies(0.0, 0.0, key=key))
    decided.decide(route=ROUTE._replace(has_end=has_end), around="fence", order=order)
    assert decided.asked[1] == ("fence", OWN, 180.0)
    assert decided.asked[2][0][1] is (decided.shore if is_asked else None)
    assert decided.asked[3][1][1] is decided.shore
    decided.decide(own=OWN._replace(speed_mps=3.0), around="fence")
    assert decided.asked[1] == ("fence", OWN._replace(speed_mps=3.0), 270.0)


@pytest.mark.parametrize(("left_s", "weary"), [(0.0, 1.0), (910.0, 1.5), (1000.0, 1.0), (1090.0, 1.0)])
def test_a_deviation_is_dearer_the_longer_it_lasts(monkeypatch: pytest.MonkeyPatch, left_s: float, weary: float) -> None:
    decided = Decided(monkeypatch, best=WAS)
    assert decided.decide(left_s=left_s).memory.left_s == (left_s or 1000.0)
    assert decided.asked[-1][1] == ([], None, weary, False)
    decided.best = None
    seen = lies(0.0, 0.0, duty="give-way")
    decided.seen = [seen]
    passes = (PassedBy("1", FAR, 9.0),)
    assert decided.decide(left_s=left_s) == Decision(Memory(left_s=left_s or 1000.0, duties=(("1", "give-way"),)), None, passes)


@pytest.mark.parametrize(
    ("since_s", "leads_in", "is_held"), [(970.5, False, True), (970.0, False, False), (970.5, True, False)]
)
def test_an_order_that_leads_into_nothing_is_held(monkeypatch, since_s, leads_in, is_held):
    other = Choice(0.5, 0.5, False)
    decided = Decided(monkeypatch, best=other)
    decided.leads_in = leads_in
    found = decided.decide(order=ORDER, choice=WAS, since_s=since_s, left_s=950.0)
    assert (found.memory.choice, found.memory.since_s) == ((WAS, since_s) if is_held else (other, 1000.0))
    assert len(decided.asked) == (2 if is_held else 3)
    assert is_held or decided.asked[-1][-1] == WAS
    assert decided.ways == ([trial_legs(LIMITS, OWN, 1.0, 2.0)] if since_s > 970.0 else [])
    decided.best = WAS
    assert decided.decide(order=ORDER, choice=WAS, since_s=since_s).memory.since_s == since_s, "the same again"


def test_how_a_vessel_is_passed_is_known_for_twice_the_time_that_is_looked_ahead() -> None:
    seen = [lies(500.0, 32.0, without=NEAR), lies(600.0, 32.0, key="2")]
    assert keepclear._passes(seen, NORTH, NORTH) == (PassedBy("1", NEAR, 1.25), PassedBy("2", FAR, 9.0))
    found = keepclear._passes(seen, EAST, NORTH)
    assert found == (PassedBy("1", NEAR, 0.5), PassedBy("2", FAR, pytest.approx(math.hypot(88.0, 32.0) / 64.0)))  # type: ignore[arg-type]


def passed(key: str, without: float, at_s: float, nearness: float) -> PassedBy:
    return PassedBy(key, Approach(without, at_s, 0.0, 0.0), nearness)


ANNA, MARIA = (
    "overtaking ANNA, passing on its starboard side, CPA 500 m",
    "overtaking MARIA, passing on its starboard side, CPA 500 m",
)


@pytest.mark.parametrize(
    ("passes", "was", "key", "words", "nearness"),
    [
        ([passed("1", 1.25, 60.0, 1.5), passed("2", 1.25, 50.0, 1.75)], None, "2", ANNA, 1.5),
        ([passed("1", 1.25, 50.0, 1.5), passed("2", 1.25, 60.0, 1.25)], None, "1", MARIA, 1.25),
        ([passed("1", 1.3, 40.0, 1.5), passed("2", 1.25, 60.0, 1.5)], None, "2", ANNA, 1.5),
        ([passed("1", 1.3, 40.0, 1.0), passed("2", 1.25, 60.0, 1.5)], "1", "2", ANNA, 1.0),
        ([passed("1", 1.3, 40.0, 1.5), passed("2", 1.3, 60.0, 1.5)], "2", "2", ANNA, 1.5),
        ([passed("1", 1.3, 40.0, 1.5), passed("2", 1.3, 60.0, 1.5)], "3", "", "keeping clear of the rock", 1.5),
        ([passed("1", 1.3, 40.0, 1.5), passed("2", 1.3, 60.0, 1.5)], None, "", "keeping clear of the rock", 1.5),
        ([passed("1", 1.25, 40.0, 0.75), passed("2", 1.3, 60.0, 1.5)], None, "1", f"{MARIA}, nothing is clear", 0.75),
        ([], None, "", "keeping clear of the rock", INF),
    ],
)
def test_an_order_is_for_the_vessel_that_would_be_met_first(passes, was, key, words, nearness):
    seen = [lies(500.0, 0.0, duty="overtaking", key=each) for each in ("1", "2")]
    seen[1] = seen[1]._replace(target=seen[1].target._replace(name="ANNA"))
    seen = [each._replace(target=each.target._replace(north_m=0.0, east_m=-500.0, speed_mps=0.0)) for each in seen]
    before = ORDER._replace(key=was) if was else None
    around = scene(*seen, shore=Shore(is_met=False))
    found = keepclear._ordered(around, WAS, 2.0, NORTH, NORTH, passes, before, 7.0)
    assert found == CourseOrder(1.0, 1.0, 2.0, words, key, nearness, 7.0)


@pytest.mark.parametrize(
    ("choice", "shore", "words"),
    [
        (Choice(1.0, 1.0, False), None, "the way back"),
        (Choice(1.0, 1.0, False), "", "the way back"),
        (Choice(1.0, 1.0, False), "a rock", "a rock"),
        (Choice(1.0, 0.5, False), None, "the way back, at half speed"),
        (Choice(1.0, 0.0, False), None, "the way back, stopped"),
        (Choice(1.0, 0.5, True), None, "the way back, to port as nothing else is clear, at half speed"),
        (Choice(1.0, 0.0, False, True), None, "the way back, as all else leads over the fence, stopped"),
    ],
)
def test_an_order_says_how_and_why(choice: Choice, shore: str | None, words: str) -> None:
    rock = Shore(is_met=False)
    rock.name = shore or ""
    found = keepclear._ordered(scene(shore=None if shore is None else rock), choice, 3.0, NORTH, NORTH, (), None, 7.0)
    assert found == CourseOrder(1.0, choice.part, 3.0 * choice.part, f"keeping clear of {words}", "", INF, 7.0)


@pytest.mark.parametrize(
    ("this", "words"),
    [
        (lies(500.0, 40.0), "giving way to MARIA, crossing from starboard, passing astern, CPA 40 m"),
        (lies(600.0, 40.0), "giving way to MARIA, crossing from starboard, passing ahead, CPA 97 m"),
        (lies(500.0, 40.0, duty="head-on"), "giving way to MARIA, head-on, starboard to starboard, CPA 40 m"),
        (lies(500.0, -40.0, duty="overtaking"), "overtaking MARIA, passing on its port side, CPA 40 m"),
        (
            lies(192.0, 0.0, duty="stand-on"),
            "keeping clear of MARIA, crossing from port and not giving way, passing astern, CPA 0 m",
        ),
        (lies(193.0, 0.0, duty="stand-on"), "giving way to MARIA, crossing from port, passing astern, CPA 0 m"),
    ],
)
def test_what_is_said_of_a_vessel(this: Seen, words: str) -> None:
    """It lies with its bow to the south."""
    around = this.around._replace(ahead_n=-1.0 / 64.0, starboard_e=-1.0 / 64.0)
    target = vessel(north_m=this.around.north_m - OWN.north_m, east_m=this.around.east_m - OWN.east_m)
    assert keepclear._said(this._replace(around=around, target=target), NORTH, NORTH) == words
