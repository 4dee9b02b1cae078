"""Which vessels the guard judges, where there are more than twelve."""

import math
from collections.abc import Sequence

import pytest

from delfim.parts.traffic.encounter import Own
from delfim.parts.traffic.judged import judged
from delfim.parts.traffic.keepclear import Choice
from delfim.parts.traffic.trialways import Caution, RouteAhead
from delfim.vehicle.target import Target

LIMITS, OWN = Caution(5.0, 0.2, 0.3), Own(200.0, -300.0, 0.0, 1.5)
NORTH = RouteAhead(((9200.0, -300.0),), 1.5)
EAST = Choice(math.pi / 2.0, 1.0, False)
TOO_MANY = "13 vessels in the way at once: the boat heeds the 12 that it meets first"


def ship(key: object, north_m: float, east_m: float = 0.0, speed_mps: float = 1.5, course_rad: float = math.pi) -> Target:
    """So far ahead and to starboard of the boat."""
    place = OWN.north_m + north_m, OWN.east_m + east_m
    return Target(str(key), "", *place, course_rad, speed_mps, course_rad, 30.0, 8.0, True, 0.0, 0.0, False, "A", 0)


def asked(
    targets: Sequence[Target], choice: Choice | None = None, own: Own = OWN, route: RouteAhead = NORTH
) -> tuple[list[str], str, list[int]]:
    """The keys of those that are judged, what is said, and what it cost."""
    work, costs = judged(LIMITS, own, route, choice, targets), list[int]()
    while True:
        try:
            costs.append(next(work))
        except StopIteration as end:
            found, words = end.value
            return [each.key for each in found], words, costs


AHEAD = [ship(number, 900.0 - 30.0 * number) for number in range(13)]
FIRST = [str(number) for number in range(12, 0, -1)]
BEHIND = [ship("slow", -3000.0, 0.0, 0.0), ship("fast", -5000.0, 10.0, 4.0)]


def test_of_thirteen_that_are_met_the_twelve_first() -> None:
    assert asked(AHEAD) == (FIRST, TOO_MANY, 13 * [4])


def test_twelve_are_all_judged_whatever_they_say() -> None:
    few = [*AHEAD[:11], ship("odd", math.nan)]
    assert asked(few) == ([each.key for each in few], "", [])


def test_harmless_ones_hide_nobody_and_those_that_could_be_met_first_come_next() -> None:
    assert asked([BEHIND[0], *AHEAD[1:]]) == (FIRST, "", 13 * [4])
    assert asked([*BEHIND, *AHEAD[2:]])[:2] == ([*FIRST[:11], "fast"], "")
    assert asked([ship("slow", -1000.0, 0.0, 0.0), ship("fast", -4000.0, 10.0, 4.0), *AHEAD[2:]])[0][-1] == "slow"
    for east_m in (-2900.0, 2900.0):
        assert asked([ship("behind", -3000.0, 0.0, 0.0), ship("abeam", 0.0, east_m, 0.0), *AHEAD[2:]])[0][-1] == "abeam"


def test_one_that_makes_no_sense_is_left_out() -> None:
    for odd in (ship("odd", math.nan), AHEAD[12]._replace(length_m=math.inf), AHEAD[12]._replace(speed_mps=1e7)):
        assert asked([odd, *AHEAD[1:]])[:2] == (FIRST, "")
        assert asked([odd, BEHIND[0], *AHEAD[2:]])[:2] == ([*FIRST[:11], "slow"], "")
    unknown = [each._replace(heading_rad=math.nan) for each in AHEAD]
    assert asked(unknown) == (FIRST, TOO_MANY, 13 * [4]), "their headings are not known"


@pytest.mark.parametrize("way", [NORTH._replace(points=((math.nan, 0.0),)), NORTH._replace(points=((0.0, 2e6),))])
def test_a_boat_whose_way_makes_no_sense_judges_all(way: RouteAhead) -> None:
    assert asked(AHEAD, route=way) == ([each.key for each in AHEAD], "", [])
    assert asked(AHEAD, own=OWN._replace(speed_mps=math.nan)) == ([each.key for each in AHEAD], "", [])


def test_those_on_the_course_that_it_was_given_are_met_too() -> None:
    abeam = [ship(number, 0.0, 900.0 - 30.0 * number, 1.5, 1.5 * math.pi) for number in range(13)]
    assert asked(abeam)[1] == ""
    assert asked(abeam, EAST)[:2] == (FIRST, TOO_MANY)
    assert asked([*AHEAD[:6], *abeam[6:]], EAST)[1] == TOO_MANY
    for east_m, part, words in ((590.0, 1.0, TOO_MANY), (620.0, 1.0, ""), (300.0, 0.5, TOO_MANY), (400.0, 0.5, "")):
        at_rest = [ship(number, 0.0, east_m, 0.0) for number in range(13)]
        assert asked(at_rest, EAST._replace(part=part))[1] == words


def test_it_looks_ahead_for_six_minutes() -> None:
    assert asked([ship(number, 650.0, 0.0, 0.0) for number in range(13)])[1] == TOO_MANY
    assert asked([ship(number, 760.0, 0.0, 0.0) for number in range(13)])[1] == ""
