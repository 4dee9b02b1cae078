"""Whether anybody could have stayed clear: of a ship that turns early, of one that turns beside the boat, of one heard late."""

import math
from typing import Any

import pytest

from bench import breaches

BOAT_MPS, SHIP_MPS = 1.5, 6.0


def run(turned_s: float, heard_s: list[float], met_s: float = 500.0) -> dict[str, Any]:
    """The boat goes on to the north; a ship of 90 m that goes east turns to the north, and comes over it from astern."""
    instants = list[list[Any]]()
    met_m = BOAT_MPS * met_s
    for t in range(int(met_s) + 300):
        before_s = min(t, turned_s)
        east_m, north_m = SHIP_MPS * (before_s - turned_s), met_m - SHIP_MPS * (met_s - turned_s) + SHIP_MPS * (t - before_s)
        place = north_m, east_m, math.pi / 2.0 if t <= turned_s else 0.0
        instants.append([float(t), BOAT_MPS * t, 0.0, 0.0, BOAT_MPS, [place]])
    reports = [[t_s, 0] for t_s in heard_s]
    row = {"story": "made", "manner": "turn", "heard": "B", "seed": 1, "lengths": [90.0], "nearest": [0.0], "nearest_m": [0.0]}
    return row | {"instants": instants, "reports": reports}


@pytest.mark.parametrize(
    ("turned_s", "heard_s", "left"),
    [
        (200.0, [190.0, 210.0], "a course"),
        (200.0, [190.0, 430.0], "none when told"),
        (440.0, [430.0, 445.0], "none at the turn"),
    ],
)
def test_a_way_is_left_of_who_turns_early_and_is_heard(turned_s: float, heard_s: list[float], left: str) -> None:
    found = breaches.judged(run(turned_s, heard_s))
    assert (found.left, found.turned_s) == (left, turned_s)
    assert found.told_s == heard_s[-1]


def test_a_collision_is_told_apart_from_a_domain() -> None:
    assert breaches.judged(run(200.0, [210.0])).missed.endswith("a course")
    apart = run(200.0, [210.0]) | {"nearest_m": [100.0]}
    assert breaches.judged(apart).missed == ""
