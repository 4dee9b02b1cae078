"""The way home before it is ordered: as the boat tells it, or as far as its track was heard here."""

import math
from itertools import pairwise
from pathlib import Path
from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import development as mavlink

from delfim.base.errors import Refused
from delfim.base.geodesy import from_plane, origin, to_plane
from delfim.config import HomeTable
from delfim.console.boats.wayhome import HeardTrack, ToldWay
from delfim.parts.mavlink.codec import wayhome, wire
from delfim.parts.mavlink.codec.params import WAY_HOME
from delfim.parts.mavlink.received.requests import home
from delfim.parts.mavlink.telemetry import TelemetryView
from delfim.vehicle import console
from delfim.vehicle.plans.track import Track
from tests.console.test_fleet import Sea
from tests.vehicle.test_charted import CharteredSea
from tests.vehicle.test_homeward import BAR, LIMITS, OVER, driven, least_m, looked_at, water

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


# As the boat tells it.

COORDINATE = st.floats(-2000.0, 2000.0)


def aside_m(point: tuple[float, float], a: tuple[float, float], b: tuple[float, float]) -> float:
    """How far a point is from a straight way."""
    along = b[0] - a[0], b[1] - a[1]
    square = along[0] ** 2 + along[1] ** 2
    part = ((point[0] - a[0]) * along[0] + (point[1] - a[1]) * along[1]) / square if square else 0.0
    part = min(max(part, 0.0), 1.0)
    return math.dist(point, (a[0] + part * along[0], a[1] + part * along[1]))


@given(st.lists(st.tuples(COORDINATE, COORDINATE), min_size=1, max_size=80))
def test_what_is_left_out_of_a_way_lies_near_what_is_told(way: list[tuple[float, float]]) -> None:
    kept = wayhome.thinned(way)
    assert (kept[0], kept[-1]) == (way[0], way[-1])
    places = iter(enumerate(way))
    at = [next(number for number, point in places if point == each) for each in kept[:-1]] + [len(way) - 1]
    for begin, end in pairwise(at):
        for point in way[begin + 1 : end]:
            assert aside_m(point, way[begin], way[end]) <= wayhome.WITHIN_M + 1e-6


def test_the_longest_track_is_told_in_few_arrays() -> None:
    random = Random(1)
    points = [(n * 5.0 + random.uniform(-2.0, 2.0), 300.0 * math.sin(n / 7.0)) for n in range(1500)]
    assert 2 <= len(wayhome.thinned(points)) <= wayhome.MOST


def test_a_way_round_what_is_closed_now_arrives_as_it_will_be_sailed() -> None:
    around, track = water(BAR), driven((0.0, 0.0), OVER)
    assert looked_at(track, around).why == ""
    end = place(*track.way_home()[0])
    beyond = [(north - end[0], east - end[1]) for north, east in (place(*each) for each in wayhome.thinned(track.way_home()))]
    way, heard = ToldWay(*end), None
    for number, numbers in reversed(list(enumerate(wayhome.arrays(beyond, 1.5)))):
        heard = way.hear(number, numbers)
    assert heard is not None
    assert heard["speed_mps"] == 1.5
    assert least_m(around, plane(heard["points"])) >= LIMITS.margin_m - 1.0 - wayhome.WITHIN_M
    assert max(east_m for _, east_m in plane(heard["points"])) > 72.0, "round the end of the bar, and not over it"


@given(st.lists(st.floats(width=32), min_size=58, max_size=58), st.integers(0, 65535))
def test_an_array_of_anything_is_a_way_or_nothing(numbers: list[float], number: int) -> None:
    told = ToldWay(38.69, -9.215).hear(number, numbers)
    assert told is None or all(math.isfinite(each) for point in told["points"] for each in point)


def test_a_boat_tells_its_way_over_the_link_and_none_while_it_knows_none(tmp_path: Path) -> None:
    sea = CharteredSea(tmp_path)
    sea.run.command(console.Heading(0.0, 1.0))
    for _ in sea.run.cycles(20.0):
        pass
    settings = sea.run.settings
    view = TelemetryView(sea.run.vehicle, settings.mavlink, 0, lambda leg: 0, lambda kind: None, sea.run.elapsed_s, 0)
    first, array = (wire.decode(wire.Sender(1, 1, None, lambda: 0).pack(each)) for each in home(view, 0))
    assert array.name.rstrip("\0") == WAY_HOME
    heard = ToldWay(first.latitude / 1e7, first.longitude / 1e7).hear(array.array_id, array.data)
    assert heard is not None
    assert heard["speed_mps"] == settings.control.home.speed_mps
    helm = sea.run.vehicle.helm
    assert plane(heard["points"])[-1] == pytest.approx(
        to_plane(AT, *from_plane(helm.state.origin, *helm.track.way_home()[-1])), abs=0.2
    )
    helm.track.look_again()
    helm.track.add(-500.0, 0.0)
    assert helm.homeward.why
    _, array = home(view, 0)
    told = ToldWay(0.0, 0.0).hear(array.array_id, array.data)
    assert told is not None
    assert told["points"] == []


def test_a_page_that_asked_is_told_what_the_boat_tells_in_place_of_what_was_heard() -> None:
    sea = Sea(1)
    sea.run(3.0)
    boat = sea.boats[1]
    end = mavlink.MAVLink_home_position_message(*boat.position, 0, 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0)
    arrays = [
        mavlink.MAVLink_debug_float_array_message(0, WAY_HOME.encode(), number, numbers)
        for number, numbers in enumerate(wayhome.arrays([(0.0, 0.0)] + [(n * 1e-4, 0.001) for n in range(40)], 1.5))
    ]
    boat.say(*arrays)
    sea.run(0.5)
    assert told(sea) == [], "nobody asked"
    sea.fleet.ask_home(1)
    sea.run(0.5)
    boat.say(end, *arrays)
    sea.run(0.5)
    assert [len(each["points"]) for each in told(sea)] == [1, 41]
    assert told(sea)[-1]["points"][-1] == [
        pytest.approx(boat.position[0] / 1e7 + 39e-4, abs=1e-6),
        pytest.approx(boat.position[1] / 1e7 + 0.001, abs=1e-6),
    ]
