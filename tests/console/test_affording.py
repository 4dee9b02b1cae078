"""Whether the mission aboard fits the energy: the boat is asked until it has reckoned that mission, and not for ever."""

import math
from typing import Any

import pytest

from delfim.console.boats.affording import AGAIN_S, GIVE_UP_S, EnergyAsks, shortage

SHORT = {"left_wh": 500.0, "plan_wh": 610.0, "reserve_wh": 180.0}
WORDS = "takes 610 Wh with the way home, 500 Wh are left, and 180 Wh are the reserve"


class Asked:
    def __init__(self) -> None:
        self.boats: list[int] = []
        self.answers: list[tuple[bool, str]] = []
        self.asks = EnergyAsks(self.boats.append)

    def begin(self, number: int, now_s: float) -> None:
        self.asks.begin(number, lambda well, why: self.answers.append((well, why)), now_s)


@pytest.mark.parametrize(
    ("energy", "words"),
    [
        (SHORT, WORDS),
        (SHORT | {"plan_wh": 320.0}, ""),
        (SHORT | {"plan_wh": 320.1}, WORDS.replace("610", "320")),
        (SHORT | {"plan_wh": None}, ""),
        (SHORT | {"left_wh": None}, ""),
        (SHORT | {"reserve_wh": None}, WORDS.replace("180", "0")),
        ({}, ""),
    ],
)
def test_what_lacks_is_told_with_its_figure(energy: dict[str, Any], words: str) -> None:
    assert shortage(energy) == words


def test_what_the_boat_told_before_it_was_asked_does_not_count() -> None:
    asked = Asked()
    asked.asks.hear(1, SHORT)
    asked.begin(1, 10.0)
    assert (asked.boats, asked.answers) == ([1], [])
    asked.asks.hear(2, SHORT)
    asked.asks.hear(1, SHORT)
    asked.asks.hear(1, SHORT)
    assert asked.answers == [(False, WORDS)]


def test_a_boat_that_has_not_reckoned_the_mission_yet_is_asked_again() -> None:
    asked = Asked()
    asked.begin(1, 10.0)
    asked.asks.hear(1, SHORT | {"plan_wh": None})
    asked.asks.tick(10.0 + AGAIN_S / 2.0)
    assert (asked.boats, asked.answers) == ([1], [])
    asked.asks.tick(10.0 + 1.1 * AGAIN_S)
    asked.asks.hear(1, SHORT | {"plan_wh": 100.0})
    assert (asked.boats, asked.answers) == ([1, 1], [(True, "")])


def test_a_boat_that_does_not_answer_does_not_keep_its_mission_from_being_sailed_and_all_who_asked_hear_it() -> None:
    asked = Asked()
    asked.begin(1, 10.0)
    asked.begin(1, 12.0)
    for step in range(math.ceil(GIVE_UP_S / 0.1) + 1):
        asked.asks.tick(10.0 + 0.1 * step)
    assert asked.answers == [(True, ""), (True, "")]
    assert len(asked.boats) <= 2 + GIVE_UP_S / AGAIN_S
