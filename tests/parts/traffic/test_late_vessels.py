"""Vessels that turn late, or without a reason: kept clear of where that can be, and otherwise as well as anybody could."""

import math
from collections.abc import Callable, Sequence

import pytest

from tests.parts.traffic.encounters import LIMITS, ClassB, Instant, Ship, encounters, exactly, late, moved, place, sail, turning

SMALL = LIMITS._replace(stand_on="small")
COURSES, PARTS = range(0, 360, 5), (1.0, 0.5, 0.0)
ALIKE = 0.15  # domains
Manner = Callable[[Sequence[Ship], int], tuple[Ship, ...]]


@pytest.mark.long
@pytest.mark.parametrize("manner", [late, turning])
@pytest.mark.parametrize("by_class_b", [False, True])
def test_vessels_of_the_boats_own_speed_that_turn_late_are_kept_clear_of(manner: Manner, by_class_b: bool) -> None:
    for seed, (title, ships) in enumerate(encounters("imazu22-similar")):
        log = sail(manner(ships, seed), SMALL, see=ClassB(seed) if by_class_b else exactly)
        assert nearest(log) >= 1.0, title


@pytest.mark.parametrize(("name", "manner"), [("imazu-12", late), ("imazu-20", late), ("imazu-18", turning)])
def test_for_a_fast_ship_that_turns_late_nothing_better_could_have_been_done(name: str, manner: Manner) -> None:
    """Ships of 90 m and 6 m/s: from their last turn on no course and speed that is kept stays out of their domains."""
    cases = enumerate(encounters("imazu22-real"))
    seed, ships = next((i, ships) for i, (title, ships) in cases if title.startswith(name))
    ships = manner(ships, seed)
    log = sail(ships, SMALL)
    turned_s = max(each.turns_s for each in ships if each.turns_s < math.inf)
    best = max(kept(log[int(turned_s) + 1], ships, math.radians(course), 1.5 * part) for course in COURSES for part in PARTS)
    assert best < 1.0
    assert nearest(log) > best - ALIKE


def nearest(log: Sequence[Instant]) -> float:
    return min(place(now.own, ship)[0] for now in log for ship in now.ships)


def kept(begin: Instant, ships: Sequence[Ship], course_rad: float, speed_mps: float) -> float:
    """The least nearness of a boat that keeps this course and speed for five minutes."""
    own, smallest = begin.own, math.inf
    for t in range(int(begin.t_s), int(begin.t_s) + 300):
        smallest = min([smallest, *(place(own, ship.at(float(t)))[0] for ship in ships)])
        own = moved(own, course_rad, speed_mps, SMALL)
    return smallest
