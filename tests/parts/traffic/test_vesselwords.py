"""Other vessels in the state that people and programs read."""

import math

import msgspec

from delfim.base import geodesy
from delfim.base.cooperative import Sliced
from delfim.parts.traffic.vesselwords import making, traffic_told
from delfim.vehicle.target import Target, Traffic

AT = geodesy.origin(math.radians(38.5), math.radians(-9.0))
MARIA = Target(
    *("244660123", "MARIA", 1000.0, -500.0, math.radians(350.0), 5.14444, math.radians(352.0)),
    *(110.0, 15.0, True, 12.04, 4.0, False, "A", 0),
)


def decoded(tree: object) -> dict[str, object]:
    """As people and programs read it: its vessels are encoded already."""
    return msgspec.json.decode(msgspec.json.encode(tree), type=dict[str, object])


def told(traffic: Traffic, now_s: float) -> dict[str, object]:
    tree = traffic_told(traffic._replace(told=Sliced(making(traffic, AT)).finish()), now_s)
    assert tree is not None
    return decoded(tree)


def test_a_boat_that_never_heard_anybody_tells_nothing() -> None:
    assert traffic_told(Traffic(), 5.0) is None
    assert decoded(traffic_told(Traffic(), 5.0, awaits=True)) == {
        "heard_s": None,
        "own_s": None,
        "refused": {},
        "targets": [],
        "order": None,
        "guard": "off",
    }


def test_a_vessel_is_told_in_degrees_and_with_its_age_now() -> None:
    traffic = Traffic((MARIA,), at_s=100.0, heard_s=99.5, own_s=98.0, refused=(("jump", 3),))
    tree = told(traffic, 100.5)
    assert (tree["heard_s"], tree["own_s"], tree["refused"]) == (1.0, 2.5, {"jump": 3})
    (vessel,) = msgspec.convert(tree["targets"], list[dict[str, object]])
    latitude_rad, longitude_rad = geodesy.from_plane(AT, 1000.0, -500.0)
    assert vessel == {
        "key": "244660123",
        "name": "MARIA",
        "latitude_deg": round(math.degrees(latitude_rad), 7),
        "longitude_deg": round(math.degrees(longitude_rad), 7),
        "course_deg": 350.0,
        "speed_mps": 5.14,
        "heading_deg": 352.0,
        "length_m": 110.0,
        "beam_m": 15.0,
        "size_known": True,
        "margin_m": 12.0,
        "kind": "A",
        "status": 0,
        "age_s": 4.0,
        "lost": False,
        "cpa_m": None,
        "tcpa_s": None,
        "nearness": None,
        "danger": "none",
    }


def test_a_vessel_that_lies_has_no_course_and_one_without_compass_no_heading() -> None:
    lies = MARIA._replace(speed_mps=0.0, heading_rad=math.nan)
    tree = told(Traffic((lies,), 1.0, 1.0), 1.0)
    (vessel,) = msgspec.convert(tree["targets"], list[dict[str, object]])
    assert (vessel["course_deg"], vessel["heading_deg"]) == (None, None)


def test_the_words_are_encoded_once_and_not_for_each_who_watches() -> None:
    crowd = Traffic(tuple(MARIA._replace(key=str(i)) for i in range(200)), 1.0, 1.0)
    words = Sliced(making(crowd, AT)).finish()
    tree = traffic_told(crowd._replace(told=words), 1.0)
    assert tree is not None
    assert list(tree.targets) == list(words)
    assert [msgspec.json.decode(each)["key"] for each in words] == [str(i) for i in range(200)]
