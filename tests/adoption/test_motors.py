"""Which motor is where and which way it pushes: from doublets of boats that are played, of every wiring."""

import math
from collections.abc import Callable, Generator
from itertools import product
from pathlib import Path
from typing import Any

import pytest

from delfim import config
from delfim.adoption.suited import unfit
from delfim.adoption.trial import steered
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
    wiring,
)

BOATS = Path(__file__).parents[2] / "etc/boats"
OTTER = config.load(BOATS / "otter.toml").thrusters
BAIT = config.load(BOATS / "bait-boat.toml").thrusters
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
        ("float", ""),
        ("bait-boat", ""),
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
    assert wired == (True, (True, False), False, ())
    assert wired.words(OTTER) == [
        "The motors of port and starboard are exchanged.",
        f"The motor that {starboard.name} reaches is reversed.",
    ]
    first, second = corrected(exchanged, OTTER)
    assert first == {"address": port.address}
    assert second == {"address": starboard.address, "reversed": not starboard.reversed}
    assert as_corrected(exchanged, OTTER, (0.3, -0.2)) == (-0.2, -0.3)


def boat_that_steers(side: int, sign: int, dead: float = 0.15, helm: float = 1.0) -> Boat:
    """It goes by its motor, and turns by its angle while that pushes ahead."""

    def answer(asked: Doublet) -> Response:
        (part, angle), (_, back) = asked.parts, asked.back
        push = math.copysign(max(abs(part) - dead, 0.0), part) * sign
        return Response(helm * side * max(push, 0.0) * (angle - back), 4.0 * push if asked.back[0] == -part else 0.0)

    return answer


@pytest.mark.parametrize(("side", "sign"), list(product((1, -1), repeat=2)))
def test_a_motor_that_steers_is_found_whichever_way_it_pushes_and_turns(side: int, sign: int) -> None:
    found, said = asked(steered.finding(1.0, QUIET), boat_that_steers(side, sign))
    assert found == MotorsFound((side,), (sign,), (0.3,))
    assert {abs(each.parts[0]) for each in said} == {0.12, 0.2, 0.3}, "no more power than it takes"
    ahead, angle = steered.mix(found, 0.0, 0.4)
    assert (ahead * sign > 0.0, angle) == (True, 0.4 * side), "without a push nothing turns her"
    assert steered.mix(found, -0.5, 0.0)[0] * sign < -0.5
    row = BAIT[0]
    assert wiring(found, BAIT).turned is (side > 0), "behind the middle a thrust to starboard turns her to port"
    (keys,) = corrected(found, BAIT)
    assert (keys.get("reversed", False), "steer" in keys) == (sign < 0, side > 0)
    most_rad = math.radians(row.steer.angle_max_deg)
    part, angle_rad = as_corrected(found, BAIT, (sign * 0.5, side * 0.5))
    assert (part, angle_rad) == (0.5, pytest.approx(-0.5 * most_rad)), (
        "as the file has it then: to starboard she turns by less than 0"
    )


@pytest.mark.parametrize(
    ("its", "words"),
    [({"dead": 0.95}, "the motor: she does not move"), ({"helm": 0.0}, "what turns the motor: she does not move")],
)
def test_a_boat_that_does_not_answer_her_motor_or_her_helm_gives_no_answer(its: Any, words: str) -> None:
    assert asked(steered.finding(1.0, QUIET), boat_that_steers(1, 1, **its))[0].startswith(words)
