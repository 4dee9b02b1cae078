"""The compass alone: a world of circles and straight ways in which the iron is known."""

import math
from typing import Any, NamedTuple

import numpy as np
import pytest

from delfim.adoption import magnet
from delfim.adoption.magnet import compass_of, gyro_agrees, motors_turn, shape_of
from delfim.adoption.model import said
from delfim.adoption.record import BoatRecord, Manoeuvre, Series
from delfim.base.errors import DelfimError
from delfim.config import CompassTable
from delfim.vehicle.navigation.iron import Iron

STEP_S = 0.1
RATE = math.radians(12.0)


class Magnets(NamedTuple):
    """What is wrong in this world."""

    hard: tuple[float, float] = (0.12, -0.1)
    soft: tuple[float, float] = (0.03, -0.02)
    offset_deg: float = 14.0
    place: tuple[float, float] = (0.0, 0.0)  # field of a pier that is there in the second circle
    motors: tuple[float, float] = (0.0, 0.0)  # at full power
    bias: float = 0.005
    gyro: float = 1.0  # its sign; 0: it says nothing
    noise_deg: float = 2.0
    turns: float = 1.15

    def told(self, heading: Any, power: Any = 0.0, near: Any = 0.0) -> Any:
        numbers = {"soft_along": self.soft[0], "soft_across": self.soft[1], "compass_offset": math.radians(self.offset_deg)}
        for name, hard, place, motors in zip(("ahead", "aside"), self.hard, self.place, self.motors, strict=True):
            numbers[f"hard_{name}"] = hard + near * place + power * motors
        return said(numbers, heading)


def sailed(its: Magnets, seed: int = 1) -> BoatRecord:
    """Circles each way, then four straight ways in three directions in a current, motors off between them."""
    random = np.random.default_rng(seed)
    circle = round(its.turns * math.tau / RATE / STEP_S)
    turn = [*[RATE] * circle, *[0.0] * 15, *[-RATE] * circle, *[0.0] * 15]
    near, power, speed = [0.0] * (circle + 15) + [1.0] * (circle + 15), [0.1] * len(turn), [0.4] * len(turn)
    circles = len(turn)
    for _ in range(4):
        turn += [*[0.0] * 110, *[math.pi / 3.0] * 20, *[0.0] * 40]
        power += [*[1.0] * 70, *[0.0] * 100]
        speed += [*np.minimum(1.5, 0.1 * np.arange(70)), *(1.5 * np.exp(-0.03 * np.arange(100)))]
    turned, pushed = np.array(turn), np.array(power)
    near += [0.0] * (len(turn) - circles)
    heading = 0.7 + (np.cumsum(turned) - 0.5 * turned) * STEP_S
    at_s = STEP_S * np.arange(len(turned))
    count = len(turned)
    told = its.told(heading, pushed, np.array(near)) + random.normal(0.0, math.radians(its.noise_deg), count)
    rate = its.gyro * turned + its.bias + random.normal(0.0, 0.0035, count)
    way = np.array(speed)[:, None] * np.stack([np.cos(heading), np.sin(heading)], 1) + [0.2, -0.1]
    velocity = way + random.normal(0.0, 0.05, (count, 2))
    return BoatRecord(
        ("starboard", "port"),
        Series(at_s, np.stack([pushed, pushed], 1)),
        Series(at_s, np.zeros((count, 2))),
        Series(at_s[::2], velocity[::2]),
        Series(at_s, np.mod(told, math.tau)[:, None]),
        Series(at_s, rate[:, None]),
        manoeuvres=(Manoeuvre("circles", 0.0, circles * STEP_S),),
    )


HEADINGS = np.radians(np.arange(0.0, 360.0, 10.0))


@pytest.mark.parametrize(
    "its", [Magnets(), Magnets((0.0, 0.0), (0.0, 0.0), -20.0), Magnets((0.3, 0.2), (-0.08, 0.05), 3.0), Magnets((-0.5, 0.4))]
)
@pytest.mark.parametrize("seed", [1, 2])
def test_five_numbers_make_the_heading_true_again(its: Magnets, seed: int) -> None:
    found = compass_of(sailed(its, seed))
    assert not found.shape.hopeless
    iron = Iron(CompassTable(*(float(each) for each in (*found.hard, *found.soft)), offset_deg=math.degrees(found.offset_rad)))
    off = [math.remainder(iron.undone(float(its.told(heading))) - heading, math.tau) for heading in HEADINGS]
    assert abs(math.degrees(float(np.mean(off)))) < 1.0
    assert max(abs(math.degrees(each - float(np.mean(off)))) for each in off) < 1.5
    assert found.offset_spread_rad < math.radians(0.5)
    assert found.shape.residual_rad == pytest.approx(math.radians(its.noise_deg), rel=0.2)
    assert found.shape.bias_radps == pytest.approx(its.bias, abs=0.002)


def test_the_most_that_it_bends_is_what_a_quick_turn_must_know_of() -> None:
    shape = shape_of(sailed(Magnets((0.2, 0.0), (0.0, 0.0))))
    assert math.degrees(shape.deviation_rad) == pytest.approx(math.degrees(math.asin(0.2)), abs=1.0)
    told = shape.told(HEADINGS)
    assert np.allclose(np.angle(np.exp(1j * (shape.mended(told) - HEADINGS))), 0.0, atol=2e-3)
    assert shape.spread_rad < math.radians(1.0)


def test_a_place_whose_field_is_not_the_same_in_both_circles_is_hopeless() -> None:
    assert shape_of(sailed(Magnets(place=(0.2, 0.1)))).hopeless.startswith(
        "this place is magnetically hopeless: one circle tells of another magnet than the other, by 2"
    )
    noisy = shape_of(sailed(Magnets(noise_deg=5.0)))
    assert "no magnet explains the headings: they are " in noisy.hopeless
    assert noisy.hopeless.endswith("; try again away from piers and other iron")


def test_iron_that_is_as_strong_as_the_earth_wants_another_place_aboard() -> None:
    assert "0.9 at most: give the compass another place" in shape_of(sailed(Magnets((0.8, 0.47), noise_deg=0.5))).hopeless


def test_a_gyro_that_says_the_other_way_or_nothing_is_told() -> None:
    for sign, words in (
        (-1.0, "the gyro says port where the compass says starboard"),
        (0.0, "the gyro says nothing of the turns"),
    ):
        with pytest.raises(DelfimError, match=words):
            shape_of(sailed(Magnets(gyro=sign)))
    record = sailed(Magnets())
    assert gyro_agrees(record.heading, record.turn) == ""
    with pytest.raises(DelfimError, match="there is no gyro"):
        shape_of(record._replace(turn=Series.of((), 1)))


def test_half_circles_and_no_straight_ways_are_refused_in_words() -> None:
    with pytest.raises(DelfimError, match="whole circles are needed"):
        shape_of(sailed(Magnets(turns=0.6)))
    with pytest.raises(DelfimError, match="there are no circles"):
        shape_of(sailed(Magnets())._replace(manoeuvres=()))
    record = sailed(Magnets())
    slow = record.velocity.values.copy()
    slow[record.velocity.at_s > record.manoeuvres[0].to_s] = 0.1
    with pytest.raises(DelfimError, match="no straight ways under way"):
        compass_of(record._replace(velocity=Series(record.velocity.at_s, slow)))


def test_what_the_compass_alone_says_is_told_in_words() -> None:
    record = sailed(Magnets(motors=(0.0, 0.1)))
    found, motors = magnet.told(record)
    assert found.startswith("compass alone: off by 1")
    assert "motors at full power turn the compass by " in motors
    assert list(magnet.told(record._replace(manoeuvres=()))) == ["compass alone: there are no circles in this record"]


def test_motors_whose_current_turns_the_compass_are_seen() -> None:
    for motors, least, most in (((0.0, 0.0), 0.0, 1.0), ((0.0, 0.1), 4.0, 7.0)):
        record = sailed(Magnets(motors=motors))
        assert least <= math.degrees(motors_turn(record, shape_of(record))) <= most
