"""What two vessels are for each other: a table of bearings, courses and speeds on both sides of each limit."""

import math

import pytest

from delfim.parts.traffic.encounter import Own, duty, passing, stands_on, words
from delfim.vehicle.target import Target

UNDER_WAY = Target("1", "Ana", 0.0, 0.0, 0.0, 2.0, 0.0, 30.0, 8.0, True, 0.0, 0.0, False, "A", 0)


def other(bearing_deg: float, course_deg: float, speed_mps: float) -> Target:
    """A mile away, from a boat at 100 m north and 50 m west."""
    bearing_rad = math.radians(bearing_deg)
    place = 100.0 + 1852.0 * math.cos(bearing_rad), -50.0 + 1852.0 * math.sin(bearing_rad)
    return UNDER_WAY._replace(
        north_m=place[0], east_m=place[1], course_rad=math.radians(course_deg % 360.0), speed_mps=speed_mps
    )


@pytest.mark.parametrize(
    ("bearing_deg", "course_deg", "speed_mps", "owed"),
    [
        *((0.0, 90.0, 0.24, "at rest"), (0.0, 90.0, 0.25, "give-way")),
        *((0.0, 180.0, 2.0, "head-on"), (14.0, 180.0, 2.0, "head-on"), (-14.0, 180.0, 2.0, "head-on")),
        *((16.0, 180.0, 2.0, "give-way"), (-16.0, 180.0, 2.0, "stand-on")),
        *(
            (5.0, 166.0, 2.0, "head-on"),
            (5.0, 194.0, 2.0, "head-on"),
            (5.0, 164.0, 2.0, "give-way"),
            (-5.0, 196.0, 2.0, "stand-on"),
        ),
        *((0.0, 0.0, 1.9, "overtaking"), (0.0, 0.0, 2.0, "give-way"), (0.0, 0.0, 2.1, "give-way")),
        *(
            (0.0, 67.0, 1.9, "overtaking"),
            (0.0, 68.0, 1.9, "give-way"),
            (0.0, -67.0, 1.9, "overtaking"),
            (0.0, -68.0, 1.9, "give-way"),
        ),
        *((180.0, 0.0, 2.1, "overtaken"), (179.0, 0.0, 2.0, "give-way"), (-179.0, 0.0, 1.9, "stand-on")),
        *((113.0, 20.0, 2.1, "overtaken"), (112.0, 20.0, 2.1, "give-way")),
        *((-113.0, 20.0, 2.1, "overtaken"), (-112.0, 20.0, 2.1, "stand-on")),
        *((90.0, 270.0, 2.0, "give-way"), (-90.0, 90.0, 2.0, "stand-on"), (0.0, 90.0, 2.0, "give-way")),
    ],
)
@pytest.mark.parametrize("turned_deg", [0.0, 110.0])
def test_what_the_boat_is_bound_to_do(bearing_deg, course_deg, speed_mps, owed, turned_deg):
    target = other(bearing_deg + turned_deg, course_deg + turned_deg, speed_mps)
    if bearing_deg or not turned_deg:  # straight ahead to the last bit
        assert duty(Own(100.0, -50.0, math.radians(turned_deg), 2.0), target) == owed


@pytest.mark.parametrize(
    ("owed", "status", "length_m", "choices"),
    [
        ("stand-on", 0, 30.0, "always"),
        ("overtaken", 0, 20.0, "always"),
        ("stand-on", 15, 19.9, "small always"),
        *(("stand-on", status, 19.9, "") for status in (2, 3, 7, 8)),
        *(("stand-on", status, 19.9, "small always") for status in (1, 4, 5, 6, 9)),
        *((owed, 0, 19.9, "") for owed in ("overtaking", "head-on", "give-way", "at rest")),
    ],
)
def test_for_whom_it_keeps_course_and_speed(owed, status: int, length_m: float, choices: str) -> None:
    target = UNDER_WAY._replace(status=status, length_m=length_m)
    assert [choice for choice in ("never", "small", "always") if stands_on(owed, target, choice)] == choices.split()


@pytest.mark.parametrize(
    ("owed", "status", "is_late", "said"),
    [
        ("at rest", 7, False, "keeping clear of Ana, which lies still"),
        ("overtaking", 7, False, "overtaking Ana"),
        ("head-on", 2, False, "giving way to Ana, not under command"),
        ("stand-on", 3, True, "giving way to Ana, restricted in her ability to manoeuvre"),
        ("overtaken", 7, False, "giving way to Ana, fishing"),
        ("give-way", 8, False, "giving way to Ana, under sail"),
        ("overtaken", 0, True, "keeping clear of Ana, which overtakes"),
        ("stand-on", 0, False, "giving way to Ana, crossing from port"),
        ("stand-on", 0, True, "keeping clear of Ana, crossing from port and not giving way"),
        ("head-on", 0, False, "giving way to Ana, head-on"),
        ("give-way", 0, False, "giving way to Ana, crossing from starboard"),
    ],
)
def test_what_it_says(owed, status: int, is_late: bool, said: str) -> None:
    assert words(owed, UNDER_WAY._replace(status=status), is_late) == said


@pytest.mark.parametrize(
    ("owed", "ahead", "starboard", "said"),
    [
        *(("head-on", 1.0, -0.1, "port to port"), ("head-on", 1.0, 0.0, "starboard to starboard")),
        *((owed, 1.0, -0.1, "passing on its port side") for owed in ("overtaking", "overtaken", "at rest")),
        ("overtaken", 1.0, 0.0, "passing on its starboard side"),
        *(("give-way", 0.1, -1.0, "passing ahead"), ("stand-on", 0.0, 1.0, "passing astern")),
    ],
)
def test_how_it_passes(owed, ahead: float, starboard: float, said: str) -> None:
    assert passing(owed, ahead, starboard) == said


@pytest.mark.parametrize(
    ("own_rad", "course_rad", "speed_mps", "owed"),
    [
        (math.radians(112.5), math.radians(20.0), 2.1, "overtaken"),
        (0.0, math.pi - math.radians(112.5), 1.9, "overtaking"),
        (0.0, math.radians(165.0), 2.0, "give-way"),
        (math.radians(15.0), math.radians(195.0), 2.0, "stand-on"),
    ],
)
def test_the_limits_themselves(own_rad: float, course_rad: float, speed_mps: float, owed: str) -> None:
    target = UNDER_WAY._replace(north_m=100.0, course_rad=course_rad, speed_mps=speed_mps)
    assert duty(Own(0.0, 0.0, own_rad, 2.0), target) == owed
