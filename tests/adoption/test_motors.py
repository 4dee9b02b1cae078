"""Which motor is where and which way it pushes: from doublets of boats that are played, of every wiring."""

import math
from collections.abc import Callable, Generator
from itertools import product
from pathlib import Path
from typing import Any

import pytest

from delfim import config
from delfim.adoption.trial.motors import (
    Doublet,
    DriftNoise,
    MotorsFound,
    Response,
    Sample,
    as_corrected,
    corrected,
    finding,
    noise,
    proving,
    response,
    unfit,
    wiring,
)

BOATS = Path(__file__).parents[2] / "etc/boats"
OTTER = config.load(BOATS / "otter.toml").thrusters
QUIET = DriftNoise(0.0, 0.0)
Boat = Callable[[Doublet], Response]


def boat(sides: tuple[int, int], signs: tuple[int, int], dead: float = 0.15) -> Boat:
    """A boat that turns and goes by its two motors beyond a dead band."""

    def answer(asked: Doublet) -> Response:
        pushes = [math.copysign(max(abs(part) - dead, 0.0), part) * sign for part, sign in zip(asked.parts, signs, strict=True)]
        turn = sum(-side * push for side, push in zip(sides, pushes, strict=True))
        return Response(turn, 4.0 * sum(pushes))

    return answer


def asked(what: Generator[Doublet, Response, Any], answers: Boat) -> tuple[Any, list[Doublet]]:
    said = list[Doublet]()
    try:
        doublet = next(what)
        while True:
            said.append(doublet)
            doublet = what.send(answers(doublet))
    except StopIteration as end:
        return end.value, said


@pytest.mark.parametrize(("sides", "signs"), list(product([(1, -1), (-1, 1)], product((1, -1), repeat=2))))
def test_every_wiring_is_found_and_proven_with_no_more_power_than_it_takes(sides: Any, signs: Any) -> None:
    found, said = asked(finding(2.0, QUIET), boat(sides, signs))
    assert found == MotorsFound(sides, signs, (0.3, 0.3))
    assert max(abs(part) for each in said for part in each.parts) == 0.3
    assert asked(proving(found, 2.0, QUIET), boat(sides, signs))[0] == ""
    other = boat((-sides[0], -sides[1]), signs)
    assert asked(proving(found, 2.0, QUIET), other)[0].startswith(
        "she turns to port where what was found turns her to starboard"
    )


def test_no_answer_is_an_answer() -> None:
    found, said = asked(finding(2.0, QUIET), boat((1, -1), (1, 1), dead=0.95))
    assert found == "motor 1 of the file: she does not move beyond doubt, up to 90%: no clear answer"
    assert [each.parts[0] for each in said] == [0.12, 0.2, 0.3, 0.45, 0.65, 0.9]
    assert asked(finding(2.0, QUIET), boat((1, 1), (1, 1)))[0].startswith("both motors ")


def test_two_tries_that_contradict_each_other_end_it() -> None:
    ways = iter((0.5, -0.5))
    found, said = asked(finding(2.0, QUIET), lambda doublet: Response(next(ways), 0.0))
    assert found == "motor 1 of the file: two tries contradict each other: no clear answer"
    assert len(said) == 2


def test_one_answer_is_not_believed_and_noise_asks_for_more() -> None:
    answers = iter((0.5, 0.01, *(0.0 for _ in range(5))))
    assert asked(finding(2.0, QUIET), lambda doublet: Response(next(answers), 0.0))[0].startswith(
        "motor 1 of the file: she does"
    )
    found, _ = asked(finding(2.0, DriftNoise(0.05, 0.0)), boat((1, -1), (1, 1)))
    assert found.least == (0.65, 0.65), "eight times the noise"


def test_a_turn_and_a_way_that_last_fall_out_of_the_answer() -> None:
    def motion(at_s: float) -> Sample:
        """A doublet from 2 s on, of 2 s each way, whose answer is 0.3 rad/s and 0.5 m/s, on a turn and a way that change."""
        pushed = min(max(at_s - 2.4, 0.0), 2.0) - min(max(at_s - 4.4, 0.0), 2.0)
        return Sample(at_s, 0.1 + 0.02 * at_s + 0.15 * pushed, 1.0 - 0.1 * at_s + 0.25 * pushed)

    samples = [motion(0.1 * i) for i in range(80)]
    found = response(samples, 2.0, 2.0)
    assert found.turn_radps == pytest.approx(0.6, abs=0.05)
    assert found.ahead_mps == pytest.approx(0.9, abs=0.1)


def test_the_noise_is_what_changes_from_second_to_second() -> None:
    steady = [Sample(0.1 * i, 0.3, 1.0) for i in range(150)]
    assert noise(steady) == pytest.approx(QUIET)
    rocking = [Sample(0.1 * i, 0.1 * (-1) ** (i // 10), 1.0) for i in range(150)]
    assert noise(rocking).turn_radps == pytest.approx(0.2, rel=0.05)
    assert noise([]) == QUIET


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("otter", ""),
        ("wam-v", ""),
        ("float", "it has 4 thrusters; two that push ahead are found, one at each side"),
        ("bait-boat", "it has 1 thrusters; two that push ahead are found, one at each side"),
    ],
)
def test_boats_with_other_motors_are_told_so(name: str, words: str) -> None:
    assert unfit(config.load(BOATS / f"{name}.toml").thrusters) == words


def test_what_was_found_corrects_the_rows_of_the_file() -> None:
    starboard, port = OTTER
    assert corrected(MotorsFound((1, -1), (1, 1), (0.2, 0.2)), OTTER) == [{}, {}]
    assert corrected(MotorsFound((1, -1), (1, -1), (0.2, 0.2)), OTTER) == [{}, {"reversed": not port.reversed}]
    exchanged = MotorsFound((-1, 1), (-1, 1), (0.2, 0.2))
    wired = wiring(exchanged, OTTER)
    assert wired == (True, (True, False))
    assert wired.words(OTTER) == [
        "The motors of port and starboard are exchanged.",
        f"The motor that {starboard.name} reaches is reversed.",
    ]
    first, second = corrected(exchanged, OTTER)
    assert first == {"address": port.address}
    assert second == {"address": starboard.address, "reversed": not starboard.reversed}
    assert as_corrected(exchanged, OTTER, (0.3, -0.2)) == (-0.2, -0.3)
