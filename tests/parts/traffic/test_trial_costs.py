"""What a trial manoeuvre costs, vessel by vessel and term by term, in numbers that follow from docs/traffic.md by hand."""

import math
from collections.abc import Sequence
from typing import Any

import pytest

from delfim.parts.traffic import keepclear
from delfim.parts.traffic.cpa import Approach, Domain, Leg, domain
from delfim.parts.traffic.encounter import Duty, Own
from delfim.parts.traffic.keepclear import Choice, Memory, Scene, Seen, measured, plausible
from delfim.parts.traffic.trialways import Caution, RouteAhead, route_legs, trial_legs
from delfim.vehicle.target import Target

LIMITS, OWN = Caution(4.0, 0.25, 0.5), Own(100.0, -200.0, 0.0, 1.5)
NORTH: tuple[Leg, ...] = ((0.0, math.inf, 0.0, 0.0, 1.0, 0.0),)
EAST: tuple[Leg, ...] = ((0.0, math.inf, 0.0, 0.0, 0.0, 1.0),)
FAR = Approach(9.0, 0.0, 0.0, 0.0)


def vessel(north_m: float = 0.0, east_m: float = 0.0, speed_mps: float = 0.0, length_m: float = 30.0, **more: Any) -> Target:
    """So far ahead of the boat and to starboard, on its way south."""
    place = OWN.north_m + north_m, OWN.east_m + east_m
    told = Target("1", "MARIA", *place, math.pi, speed_mps, math.nan, length_m, 8.0, True, 0.0, 0.0, False, "A", 0)
    return told._replace(**more)


def lies(north_m: float, east_m: float, rule: str = "", duty: Duty | None = None, look_s: float = 256.0, **more: Any) -> Seen:
    """A vessel that lies at a place, heading north, with a domain of 64 m around it: all numbers are exact."""
    around = Domain(north_m, east_m, 0.0, 0.0, 1.0 / 64.0, 0.0, 0.0, 1.0 / 64.0)
    target = vessel(speed_mps=1.0, key=more.pop("key", "1"), length_m=more.pop("length_m", 30.0))
    return Seen(target, around, look_s, 128.0, FAR, duty, rule)._replace(**more)


class Shore:
    """A shore that each way meets, or none."""

    name = "the rock"

    def __init__(self, is_met: bool) -> None:
        self.is_met, self.asked = is_met, list[object]()

    def meets(self, *told: object, is_route: bool = False) -> bool:
        self.asked.append((*told, *([is_route] if len(told) < 3 else [])))
        return self.is_met


def scene(*seen: Seen, shore: Any = None, weary: float = 1.0) -> Scene:
    return Scene(seen, shore, weary, bool(seen))


def cost(of: Scene, legs: Sequence[Leg] = NORTH, turn_rad: float = 0.0, part: float = 1.0, **more: Any) -> float:
    return keepclear._cost(of, legs, turn_rad, part, more.pop("far", 2.0), more.pop("enough", math.inf), **more)


def test_numbers_that_make_sense() -> None:
    assert plausible()
    assert plausible(-999_999.0, 0.0, 999_999.0)
    for odd in (1e6, -1e6, math.nan, math.inf, -math.inf):
        assert not plausible(1.0, odd, 1.0)


@pytest.mark.parametrize(
    ("target", "speed_mps", "look_s", "expected"),
    [
        (vessel(300.0, 400.0, margin_m=10.0), 1.5, 180.0, (132.0, 60.0, 180.0, 112.0, 302.0)),
        (vessel(300.0, 400.0, length_m=5.0), 0.1, 180.0, (52.0, 32.0, 4.0 * 32.0 / 0.3, 232.0, 422.0)),
        (vessel(-300.0, -400.0, length_m=5.0), 0.5, 180.0, (52.0, 32.0, 256.0, 155.2, 422.0)),
        (vessel(300.0, 400.0, length_m=5.0, margin_m=0.5), 2.0, 60.0, (52.5, 32.5, 65.0, 69.25, 421.25)),
        (vessel(300.0, 400.0, length_m=400.0), 1.5, 180.0, (1602.0, 642.0, 900.0, 810.4, -1903.0)),
        (vessel(300.0, 400.0, length_m=400.0), 1.5, 1000.0, (1602.0, 642.0, 1000.0, 810.4, -1903.0)),
        (vessel(300.0, 400.0, length_m=2.0, margin_m=1.0, kind="thing"), 1.5, 180.0, (14.0, 14.0, 112.0 / 3.0, 56.8, 479.0)),
        (vessel(300.0, 400.0, length_m=2.0, margin_m=1.0, kind="thing"), 70.0, 180.0, (14.0, 14.0, 0.8, 40.36, 479.0)),
        (vessel(300.0, 400.0, length_m=2.0, margin_m=1.0, kind="person"), 1.5, 180.0, (34.0, 34.0, 272.0 / 3.0, 80.8, 449.0)),
        *(
            (vessel(300.0, 400.0, length_m=5.0, margin_m=odd), 2.0, 60.0, (52.0, 32.0, 64.0, 68.8, 422.0))
            for odd in (-5.0, 1e6, math.nan, math.inf)
        ),
    ],
)
def test_a_domain_grows_with_the_vessel_the_boat_and_what_is_not_known(target, speed_mps, look_s, expected):
    ahead_m, abeam_m, *rest = expected
    found = measured(LIMITS._replace(look_s=look_s), OWN, speed_mps, target)
    assert found.around == pytest.approx(domain(target, ahead_m, abeam_m))
    assert tuple(found[1:]) == pytest.approx(tuple(rest))


@pytest.mark.parametrize(
    ("owed", "status", "speed_mps", "rule"),
    [
        ("head-on", 0, 1.0, "starboard"),
        ("stand-on", 0, 1.0, "port"),
        ("stand-on", 7, 0.75, "ahead"),
        ("stand-on", 7, 0.5, ""),
        ("give-way", 0, 0.75, "ahead"),
        ("give-way", 0, 0.5, ""),
        ("overtaking", 0, 3.0, ""),
        ("at rest", 0, 0.0, ""),
        (None, 0, 3.0, ""),
    ],
)
def test_what_the_rules_do_not_like(owed: Duty | None, status: int, speed_mps: float, rule: str) -> None:
    assert keepclear._rule(owed, vessel(speed_mps=speed_mps, status=status)) == rule


def test_the_boat_waits_for_who_must_give_way_until_it_is_late() -> None:
    limits = LIMITS._replace(stand_on="always")
    this = lies(192.0, 0.0, duty="stand-on")  # its domain is entered after 128 s
    assert keepclear._waits(limits, this._replace(late_s=127.0), NORTH)
    assert not keepclear._waits(limits, this, NORTH)
    assert keepclear._waits(limits, this._replace(look_s=100.0, late_s=99.0), NORTH)
    for odd in (this._replace(duty=None), this._replace(duty="give-way")):
        assert not keepclear._waits(limits, odd._replace(late_s=1.0), NORTH)
    assert not keepclear._waits(LIMITS._replace(stand_on="never"), this._replace(late_s=1.0), NORTH)


@pytest.mark.parametrize(
    ("turn_rad", "part", "weary", "expected"),
    [(0.0, 1.0, 1.0, 0.0), (math.pi / 2.0, 1.0, 1.0, 10.0), (-math.pi / 2.0, 1.0, 1.0, 13.0), (0.0, 0.25, 1.0, 9.0),
     (math.pi / 4.0, 0.5, 3.0, 21.0), (-math.pi, 0.0, 2.0, 64.0)],
)  # fmt: skip
def test_turns_and_slowness_cost_by_themselves(turn_rad: float, part: float, weary: float, expected: float) -> None:
    assert keepclear._deviation(scene(weary=weary), turn_rad, part) == pytest.approx(expected)
    assert cost(scene(weary=weary), NORTH, turn_rad, part) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("nearness", "at_s", "expected"),
    [(0.75, 0.0, 325.0), (0.75, 50.0, 260.0), (0.25, 0.0, 8275.0), (0.0, 100.0, 8000.0), (1.0, 0.0, 15.0), (1.15, 50.0, 7.5),
     (1.3, 0.0, 0.0), (1.5, 0.0, 0.0)],
)  # fmt: skip
def test_to_be_near_costs_the_more_the_nearer_and_the_sooner(nearness: float, at_s: float, expected: float) -> None:
    assert keepclear._hazard(nearness, at_s, 100.0) == pytest.approx(expected)


def test_each_vessel_adds_what_its_domain_costs() -> None:
    by_the_edge, soft = lies(500.0, 32.0), lies(500.0, 73.6)  # half a domain off, and 1.15 domains
    entered_s = 500.0 - math.sqrt(64.0**2 - 32.0**2)
    inside = 550.0 / (1.0 + (entered_s / 256.0) ** 2)
    assert cost(scene(by_the_edge)) == pytest.approx(inside)
    assert cost(scene(soft)) == pytest.approx(7.5)
    assert cost(scene(by_the_edge, soft), turn_rad=math.pi / 2.0) == pytest.approx(inside + 17.5)
    assert cost(scene(lies(600.0, 32.0))) == pytest.approx(0.0), "after twice the time that is looked ahead"
    nearest, entered_s = math.hypot(32.0, 44.0) / 64.0, 300.0 - math.sqrt(64.0**2 - 32.0**2)
    inside = (100.0 + 900.0 * (1.0 - nearest)) / (1.0 + (entered_s / 256.0) ** 2)
    assert cost(scene(lies(300.0, 32.0)), far=1.0) == pytest.approx(inside), "as near as it comes within that time"


def test_whoever_is_met_within_half_a_minute_is_looked_at_after_it_again() -> None:
    now = lies(0.0, 32.0)
    later = keepclear._hazard(math.hypot(30.0, 32.0) / 64.0, 30.0, 256.0)
    assert cost(scene(now)) == pytest.approx(550.0 + later)
    assert cost(scene(now), far=0.0625) == pytest.approx(550.0), "nothing is looked at after 16 s"
    assert cost(scene(lies(40.0, 64.0))) == pytest.approx(15.0)
    assert cost(scene(lies(30.0, 64.0))) == pytest.approx(15.0)
    assert cost(scene(lies(29.0, 64.0))) == pytest.approx(15.0 + 50.0 * (1.3 - math.hypot(1.0, 64.0) / 64.0))


def test_a_cost_that_is_enough_is_not_reckoned_to_its_end() -> None:
    soft, shore = lies(500.0, 73.6), Shore(is_met=True)
    both = scene(lies(500.0, 64.0), soft, shore=shore)
    assert cost(both, enough=15.0) == 15.0
    assert cost(both, enough=22.0) == pytest.approx(22.5)
    assert cost(scene(soft, lies(500.0, 64.0), shore=shore), enough=22.5) == pytest.approx(22.5)
    assert cost(scene(lies(500.0, 64.0), shore=shore), enough=15.0) == 15.0
    assert shore.asked == []


def test_no_vessel_is_a_reason_to_go_ashore() -> None:
    soft = lies(500.0, 73.6, without=FAR._replace(nearness=1.15))
    for is_met, is_route in ((True, False), (False, False), (True, True)):
        shore = Shore(is_met)
        assert cost(scene(soft, shore=shore), is_route=is_route) == pytest.approx(7.5 + is_met * 1e6)
        assert shore.asked == [(NORTH, 90.0, is_route)]
    cost(scene(shore=shore))
    assert shore.asked[1:] == [(NORTH, 90.0, False)]


def test_on_its_route_a_boat_does_not_look_twice_at_whom_it_passes_far_away() -> None:
    near = lies(500.0, 73.6)
    assert cost(scene(near._replace(without=FAR._replace(nearness=2.5))), is_route=True) == 0.0
    assert cost(scene(near._replace(without=FAR._replace(nearness=2.5))), is_route=False) == pytest.approx(7.5)
    assert cost(scene(near._replace(without=FAR._replace(nearness=2.0, at_s=9.0))), is_route=True) == pytest.approx(7.5)


@pytest.mark.parametrize(
    ("seen", "legs", "turn_rad", "part", "expected"),
    [
        (lies(400.0, -100.0, "starboard"), NORTH, 1.0, 1.0, 60.0),  # the boat is to starboard of it as it passes
        (lies(400.0, -10.0 * 6.4, "starboard", look_s=1.0), NORTH, 1.0, 1.0, 0.0),  # not looked at so far ahead
        (lies(400.0, 100.0, "starboard"), NORTH, 1.0, 1.0, 0.0),
        (lies(400.0, -32.0, "starboard"), NORTH, 1.0, 1.0, 60.0),
        (lies(-32.0, 400.0, "ahead"), EAST, 1.0, 1.0, 60.0),
        (lies(400.0, 0.0, "starboard"), NORTH, 1.0, 1.0, None),
        (lies(400.0, -96.0, "starboard"), NORTH, 0.0, 1.0, 0.0),  # on its course, as fast as asked
        (lies(400.0, -96.0, "starboard"), NORTH, 0.0, 0.5, 60.0),
        (lies(400.0, -96.0, ""), NORTH, 1.0, 0.5, 0.0),
        (lies(-100.0, 400.0, "ahead"), EAST, 1.0, 1.0, 60.0),
        (lies(-90.0, 400.0, "ahead"), EAST, -1.0, 1.0, 60.0),
        (lies(100.0, 400.0, "ahead"), EAST, -1.0, 1.0, 0.0),
        (lies(-100.0, 400.0, "port"), EAST, 1.0, 1.0, 0.0),
        (lies(-100.0, 400.0, "port"), EAST, -1.0, 1.0, 40.0),
        (lies(-100.0, 400.0, "port"), EAST, -0.25, 1.0, 40.0),
        (lies(-100.0, 400.0, "port"), EAST, -2.0, 1.0, 0.0),
        (lies(-100.0, 400.0, "port"), EAST, -3.0, 1.0, 0.0),
        (lies(-100.0, 400.0, "port"), EAST, 0.5, 1.0, 0.0),
        (lies(-100.0, 400.0, "port"), EAST, 0.0, 0.5, 0.0),
        (lies(400.0, 100.0, "port"), NORTH, -1.0, 1.0, 40.0),
        (lies(400.0, -160.0, "port"), NORTH, -1.0, 1.0, 0.0),  # 2.5 domains away
        (lies(400.0, -159.0, "port"), NORTH, -1.0, 1.0, 40.0),
    ],
)
def test_what_is_against_the_rules_costs_more(seen, legs, turn_rad, part, expected):
    plain = cost(scene(seen._replace(rule="")), legs, turn_rad, part)
    assert cost(scene(seen), legs, turn_rad, part) - plain == pytest.approx(expected or 0.0)
    middle = lies(0.0, 400.0, "ahead")  # neither ahead nor astern
    assert cost(scene(middle), EAST, 1.0) == cost(scene(middle._replace(rule="")), EAST, 1.0)


def test_a_way_leads_in_where_a_domain_is_entered_or_the_shore_is_met() -> None:
    touched, entered = lies(100.0, 64.0), lies(100.0, 63.0)
    assert not keepclear._leads_in(scene(touched), NORTH)
    assert not keepclear._leads_in(scene(), NORTH)
    assert keepclear._leads_in(scene(touched, entered), NORTH)
    assert keepclear._leads_in(scene(lies(0.5, 63.0)), NORTH), "at once"
    assert not keepclear._leads_in(scene(entered._replace(look_s=64.0)), NORTH)
    for is_met in (True, False):
        shore = Shore(is_met)
        assert keepclear._leads_in(scene(touched, shore=shore), NORTH) == is_met
        assert shore.asked == [(NORTH, 90.0, False)]
        assert keepclear._leads_in(scene(entered, shore=shore), NORTH)


def test_a_choice_is_a_course_and_a_part_of_the_speed() -> None:
    route = RouteAhead((), 2.0)
    assert Choice(1.0, 0.5, False) == (1.0, 0.5, False, False)
    assert keepclear._tried(LIMITS, OWN, Choice(1.0, 0.5, False), route) == trial_legs(LIMITS, OWN, 1.0, 1.0)


def asked(*targets: Target, own: Own = OWN, memory: Memory | None = None) -> tuple[list[Seen], list[int]]:
    """The vessels in question of a boat whose route leads east, and what each slice cost."""
    on, costs = route_legs(own, RouteAhead(((100.0, 9800.0),), 1.5)), list[int]()
    work = keepclear._in_question(LIMITS, memory or Memory(), own, math.pi / 2.0, 1.5, targets, on)
    while True:
        try:
            costs.append(next(work))
        except StopIteration as end:
            return end.value, costs


def test_who_makes_no_sense_is_not_in_question() -> None:
    sane = [
        vessel(200.0, 0.0), vessel(200.0, 0.0, 99.0), vessel(200.0, 0.0, length_m=0.0), vessel(200.0, 0.0, length_m=999.0),
        vessel(200.0, 0.0, 0.5, 0.5), vessel(200.0, 0.0, course_rad=999_999.0),
    ]  # fmt: skip
    odd = [
        vessel(200.0, 0.0, -0.5), vessel(200.0, 0.0, 100.0), vessel(200.0, 0.0, math.nan), vessel(200.0, 0.0, 150.0),
        vessel(200.0, 0.0, length_m=-0.5), vessel(200.0, 0.0, length_m=1000.0), vessel(200.0, 0.0, length_m=1500.0),
        vessel(1e6 + 120.0, 0.0, 9.0), vessel(1e6, 2e5, 9000.0), vessel(math.nan, 0.0), vessel(math.inf, 0.0),
    ]  # fmt: skip
    for each in sane:
        found, costs = asked(each)
        assert ([seen.target for seen in found], costs) == ([each], [1, 2]), each
    for each in odd:
        assert asked(each) == ([], [1]), each
    for course_rad in (1e6, -1e6, math.nan):
        found, costs = asked(vessel(200.0, 0.0, course_rad=course_rad), sane[0])
        assert (len(found), costs) == (1, [1, 1, 2])
    far = vessel(1e6 + 119.0, 0.0, 99.0)
    assert asked(far) == ([], [1, 2])


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (vessel(330.0, 0.0), vessel(-250.0, 0.0, length_m=5.0)),  # longer: nearer
        (vessel(0.0, -330.0), vessel(0.0, 250.0, length_m=5.0)),
        (vessel(420.0, 0.0, 9.0), vessel(220.0, 0.0)),  # faster: sooner
        (vessel(220.0, 0.0), vessel(720.0, 0.0, 8.7)),
        (vessel(680.0, 0.0, 8.7), vessel(220.0, 0.0)),
        (vessel(220.0, 0.0, name="A"), vessel(220.0, 0.0, name="B")),
        (vessel(220.0, 0.0, name="B"), vessel(220.0, 0.0, name="A")),
    ],
)
def test_who_could_be_met_first_comes_first(first: Target, second: Target) -> None:
    for order in ((first, second), (second, first)):
        if first.name == "MARIA" or order[0] is first:
            assert [seen.target for seen in asked(*order)[0]] == [first, second]
    crowd = [vessel(200.0 + i, 0.0) for i in range(14)]
    assert [seen.target for seen in asked(*crowd)[0]] == crowd[:12]


def test_who_passes_clear_is_in_question_while_both_could_go_for_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    passed = list[Any]()
    near = vessel(438.0, 0.0, 0.5, 5.0)  # 78 m less: 360 m at 2 m/s

    def passing(*told: Any) -> Approach:
        passed.append(told)
        return Approach(1.3, 9.0, 0.0, 0.0)

    monkeypatch.setattr(keepclear, "approach", passing)
    (seen,), _ = asked(near)
    assert (seen.duty, seen.rule, seen.without.nearness, seen.look_s) == (None, "", 1.3, 180.0)
    assert passed[-1][2] == 360.0
    assert asked(near._replace(north_m=538.5))[0] == []
    known = Memory(duties=(("1", "stand-on"),))
    assert [(each.duty, each.rule) for each in asked(near, memory=known)[0]] == [("stand-on", "port")]
    assert asked(near._replace(north_m=538.5), memory=known)[0] == []


@pytest.mark.parametrize(("speed_mps", "owed"), [(1.5, "head-on"), (0.3, "head-on"), (0.25, "stand-on")])
def test_what_a_boat_owes_that_hardly_moves_follows_from_its_route(monkeypatch, speed_mps, owed):
    monkeypatch.setattr(keepclear, "approach", lambda *_: Approach(1.25, 9.0, 0.0, 0.0))
    (seen,), _ = asked(vessel(300.0, 0.0, 2.0), own=OWN._replace(speed_mps=speed_mps))
    assert (seen.duty, seen.rule) == (owed, {"head-on": "starboard", "stand-on": "port"}[owed])
    assert tuple(seen[1:4]) == (*measured(LIMITS, OWN, 1.5, seen.target)[:3],)
    known = Memory(duties=(("1", "overtaking"),))
    assert asked(vessel(300.0, 0.0, 2.0), memory=known)[0][0].duty == "overtaking"


def buoy(north_m: float, east_m: float, **more: Any) -> Target:
    """Kept clear of by 16 m, from middle to middle."""
    return vessel(north_m, east_m, length_m=2.0, margin_m=3.0, kind="thing")._replace(**more)


@pytest.mark.parametrize("course_deg", [0.0, 90.0, 180.0, 240.0])
@pytest.mark.parametrize(
    ("north_m", "east_m", "is_judged"),
    [
        (105.75, 0.0, True),
        (-105.75, 0.0, True),
        (0.0, 105.75, True),
        (106.25, 0.0, False),
        (0.0, -106.25, False),
        (63.0, 84.0, True),
    ],
)
def test_trials_heed_what_the_boat_can_reach_in_a_minute(north_m, east_m, is_judged, course_deg) -> None:
    """90 m, and so far as it keeps clear."""
    this = buoy(north_m, east_m, course_rad=math.radians(course_deg))
    around, _, late_s, _ = measured(LIMITS, OWN, 1.5, this)
    expected = Seen(this, around, 60.0, late_s, Approach(math.inf, math.inf, 0.0, 0.0), None, "")
    assert keepclear._standing(LIMITS, OWN, 1.5, [this]) == [expected] * is_judged


def test_trials_heed_the_nearest_twelve_and_none_at_the_very_end_of_their_reach() -> None:
    row = [buoy(10.0 + i, 0.0) for i in range(14)]
    assert [each.target for each in keepclear._standing(LIMITS, OWN, 1.5, row)] == row[:12]
    assert keepclear._standing(LIMITS, OWN, 1.5, [buoy(106.0, 0.0, course_rad=0.0)]) == []
