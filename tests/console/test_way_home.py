"""The way home before it is ordered: as the boat itself would sail it, as far as its track was heard here."""

import math
from random import Random
from typing import Any

import pytest
from pymavlink.dialects.v20 import development as mavlink

from delfim.base.errors import Refused
from delfim.base.geodesy import from_plane, origin, to_plane
from delfim.config import HomeTable
from delfim.console.boats.wayhome import HeardTrack
from delfim.vehicle.plans.track import Track
from tests.console.test_fleet import Sea

AT = origin(math.radians(38.69), math.radians(-9.215))


def place(north_m: float, east_m: float) -> tuple[float, float]:
    latitude_rad, longitude_rad = from_plane(AT, north_m, east_m)
    return math.degrees(latitude_rad), math.degrees(longitude_rad)


def plane(points: list[list[float]]) -> list[tuple[float, float]]:
    return [to_plane(AT, math.radians(latitude_deg), math.radians(longitude_deg)) for latitude_deg, longitude_deg in points]


@pytest.mark.parametrize("seed", range(5))
def test_it_is_the_boats_own_way_loops_cut_alike(seed: int) -> None:
    random, own, heard = Random(seed), Track(HomeTable()), HeardTrack()
    north_m = east_m = course = 0.0
    for _ in range(1500):
        course += random.uniform(-0.5, 0.5)
        north_m, east_m = north_m + 1.5 * math.cos(course), east_m + 1.5 * math.sin(course)
        own.add(north_m, east_m)
        heard.add(*place(north_m, east_m))
    way = heard.way_home(*place(*own.way_home()[0]))
    assert way["whole"]
    assert plane(way["points"]) == [pytest.approx(each, abs=0.05) for each in own.way_home()]


def test_it_begins_at_the_harbour_where_the_boats_way_ends() -> None:
    heard = HeardTrack()
    for north_m in range(200):
        heard.add(*place(float(north_m), 0.0))
    way = heard.way_home(*place(120.0, 2.0))
    assert way["whole"]
    assert plane(way["points"])[0] == pytest.approx((120.0, 0.0), abs=2.5)


def test_a_track_that_was_heard_from_a_later_place_on_does_not_pass_for_the_whole_way() -> None:
    heard = HeardTrack()
    assert heard.way_home(*place(0.0, 0.0)) == {"points": [], "whole": False}
    for north_m in range(500, 600):
        heard.add(*place(float(north_m), 0.0))
    way = heard.way_home(*place(0.0, 0.0))
    assert not way["whole"]
    assert plane(way["points"])[0] == pytest.approx((500.0, 0.0), abs=0.05)


def told(sea: Sea) -> list[dict[str, Any]]:
    return [each for each in sea.told if each["t"] == "way_home"]


def test_a_boat_is_asked_once_for_each_question_and_others_are_not_shown() -> None:
    sea = Sea(1, 2)
    sea.run(3.0)
    place_e7 = (*sea.boats[1].position, 0, 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0)
    home = mavlink.MAVLink_home_position_message(*place_e7)
    sea.boats[1].say(home)
    sea.run(0.5)
    assert told(sea) == [], "nobody asked"
    sea.fleet.ask_home(1)
    sea.run(0.5)
    sea.boats[1].say(home, home)
    sea.run(0.5)
    assert [(each["boat"], each["whole"], len(each["points"])) for each in told(sea)] == [(1, True, 1)]
    with pytest.raises(Refused, match="no boat 9"):
        sea.fleet.ask_home(9)
