"""How far and how long the guard may lead the boat: a table of looks, one each second."""

import math

import pytest

from delfim import config
from delfim.parts.traffic.encounter import Own
from delfim.parts.traffic.leash import REST_S, Leash, paid_out
from delfim.parts.traffic.trialways import RouteAhead
from delfim.vehicle.target import CourseOrder

LIMITS = config.TrafficGuard(away_m=100.0, away_s=200.0)
LEG = RouteAhead(((1000.0, 0.0), (1000.0, 500.0)), 1.5)
COURSE = RouteAhead(((20_000.0, 0.0),), 1.5, has_end=False)
PLACE = RouteAhead(((0.0, 0.0),), 1.5, has_end=False, place=(0.0, 0.0))
ASTRAY = CourseOrder(1.0, 1.0, 1.5, "away", "1", 1.0, 0.0)
STOP = ASTRAY._replace(speed_part=0.0, speed_mps=0.0)


def led(
    was: Leash, route: RouteAhead, at: tuple[float, float], order: CourseOrder | None, seconds: int = 1, task: str = ""
) -> Leash:
    """Looks at one place."""
    for _ in range(seconds):
        now_s = 0.0 if was.at_s == -math.inf else was.at_s + 1.0
        was = paid_out(was, LIMITS, task, route, Own(*at, 0.0, 1.5), order, now_s)
    return was


@pytest.mark.parametrize("route", [LEG, COURSE, PLACE])
def test_beyond_away_m_it_rests_for_a_minute_at_least(route: RouteAhead) -> None:
    begun = led(Leash(), route, (0.0, 0.0), ASTRAY)
    assert led(begun, route, (0.0, 99.0), ASTRAY).spent == ""
    spent = led(begun, route, (0.0, 101.0), ASTRAY)
    assert spent.spent == "it led the boat 101 m away (traffic.guard.away_m)"
    assert led(spent, route, (0.0, 101.0), None, round(REST_S) - 2).spent
    assert not led(spent, route, (0.0, 101.0), None, round(REST_S) + 1).spent


def test_along_its_way_is_not_away_and_backwards_is() -> None:
    begun = led(Leash(), LEG, (0.0, 0.0), ASTRAY)
    assert not led(begun, LEG, (900.0, 90.0), ASTRAY).spent
    assert not led(begun, LEG, (1000.0, 400.0), ASTRAY).spent
    assert led(begun, LEG, (-101.0, 0.0), ASTRAY).spent


def test_it_rests_for_as_long_as_it_led_and_stops_do_not_count() -> None:
    begun = led(Leash(), PLACE, (50.0, 0.0), STOP, 5000)
    assert (begun.led_s, begun.spent) == (0.0, "")
    spent = led(begun, PLACE, (50.0, 0.0), ASTRAY, 200)
    assert spent.spent == "it led the boat for 200 s (traffic.guard.away_s)"
    assert led(spent, PLACE, (0.0, 0.0), None, 197).spent
    assert not led(spent, PLACE, (0.0, 0.0), None, 202).spent


def test_often_and_shortly_is_long_too() -> None:
    leash = Leash()
    for _ in range(30):
        leash = led(led(leash, PLACE, (50.0, 0.0), ASTRAY, 15), PLACE, (50.0, 0.0), None, 5)
        if leash.spent:
            return
    pytest.fail("led for 450 s of 600")


def test_a_leg_begins_anew_and_a_course_does_not_while_it_is_led_again_and_again() -> None:
    for route, is_spent in ((LEG, False), (COURSE, True)):
        led_once = led(Leash(), route, (0.0, 0.0), ASTRAY, 20)
        clear = led(led_once, route, (0.0, 60.0), None, 5)
        assert bool(led(led(clear, route, (0.0, 60.0), ASTRAY), route, (0.0, 120.0), ASTRAY).spent) is is_spent
        free = led(clear, route, (0.0, 60.0), None, 60)
        assert not led(led(free, route, (0.0, 60.0), ASTRAY), route, (0.0, 120.0), ASTRAY).spent


def test_a_course_that_was_led_to_its_end_is_led_no_farther_after_the_rest() -> None:
    spent = led(led(Leash(), COURSE, (0.0, 0.0), ASTRAY), COURSE, (0.0, 101.0), ASTRAY)
    rested = led(spent, COURSE, (0.0, 101.0), None, round(REST_S) + 1)
    assert led(rested, COURSE, (0.0, 101.0), ASTRAY).spent == ""
    while spent.spent:
        spent = led(spent, COURSE, (0.0, 101.0), None)
    assert led(spent, COURSE, (0.0, 101.0), ASTRAY).spent


def test_another_task_has_another_way_and_the_time_goes_on() -> None:
    leash = led(led(Leash(), LEG, (0.0, 0.0), ASTRAY, 150), LEG, (0.0, 90.0), ASTRAY, 1, "another")
    assert not led(leash, LEG, (0.0, 180.0), ASTRAY, 1, "another").spent
    assert led(leash, LEG, (0.0, 90.0), ASTRAY, 60, "another").spent


def look(was: Leash, now_s: float, east_m: float, order: CourseOrder | None = ASTRAY, route: RouteAhead = PLACE) -> Leash:
    return paid_out(was, LIMITS, "", route, Own(0.0, east_m, 0.0, 1.5), order, now_s)


def test_time_runs_as_it_is_led_and_back_as_it_is_not_by_ten_seconds_a_look_at_most() -> None:
    looks = [
        (5.0, ASTRAY, 10.0),
        (8.0, ASTRAY, 13.0),
        (30.0, ASTRAY, 23.0),
        (29.0, ASTRAY, 23.0),
        (29.5, ASTRAY._replace(speed_mps=0.5), 23.5),
        (33.5, None, 19.5),
        (35.5, STOP, 17.5),
        (99.0, None, 7.5),
        (200.0, None, 0.0),
        (200.5, None, 0.0),
    ]
    leash = Leash()
    for now_s, order, led_s in looks:
        leash = look(leash, now_s, 0.0, order)
        assert leash == Leash("", () if order is None else ((0.0, 0.0),), led_s, "", now_s) or order is None
        assert (leash.led_s, leash.at_s) == (led_s, now_s)


def test_the_ends_of_both_bounds_are_within_them_no_more() -> None:
    begun = look(Leash(led_s=20.0, at_s=0.0), 1.0, 99.99)
    assert begun == Leash("", ((0.0, 0.0),), 21.0, "", 1.0)
    assert look(begun, 2.0, 100.0) == Leash("", ((0.0, 0.0),), 60.0, "it led the boat 100 m away (traffic.guard.away_m)", 2.0)
    assert look(Leash(led_s=198.5, at_s=0.0), 1.0, 0.0).spent == ""
    words = "it led the boat for 200 s (traffic.guard.away_s)"
    spent = look(Leash(led_s=199.0, at_s=0.0), 1.0, 0.0)
    assert spent == Leash("", ((0.0, 0.0),), 200.0, words, 1.0)
    again = look(spent, 2.0, 0.0, None)
    assert (again.led_s, again.spent) == (199.0, words)
    assert look(again, 3.0, 0.0).led_s == 200.0


def test_the_way_it_was_led_from() -> None:
    leg = look(Leash(), 1.0, 7.0, ASTRAY, LEG)
    assert leg.way == ((0.0, 7.0), *LEG.points)
    assert look(leg, 2.0, 9.0, ASTRAY, LEG).way == leg.way
    assert look(leg, 2.0, 9.0, None, LEG).way == ()
    course = look(Leash("", at_s=0.0), 1.0, 7.0, ASTRAY, COURSE)
    assert look(course, 1.5, 9.0, None, COURSE).way == course.way, "it is led for a second less a half"
    rested = look(course, 2.0, 9.0, None, COURSE)
    assert (rested.led_s, rested.way) == (0.0, ())
    spent = Leash("", course.way, 1.0, "spent", 0.0)
    assert look(spent, 1.0, 9.0, None, COURSE) == Leash("", course.way, 0.0, "", 1.0)
    assert look(look(spent, 1.0, 9.0, None, COURSE), 2.0, 9.0, None, COURSE).way == ()
    assert look(Leash("another", ((5.0, 5.0),), 9.0, "", 0.0), 1.0, 7.0, ASTRAY, LEG).way == leg.way
    nearly = look(Leash("", course.way, 1.5, "spent", 0.0), 1.0, 9.0, None, COURSE)
    assert (nearly.led_s, nearly.spent) == (0.5, "spent")
    assert look(Leash("", ((0.0, 100.0), (0.0, 200.0)), 5.0, "", 0.0), 1.0, 301.0, ASTRAY, LEG).spent.startswith(
        "it led the boat 101 m"
    )
