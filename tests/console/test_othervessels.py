"""Other vessels on the console: what its boats tell of them, by their messages, and how near they come to each of its boats."""

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from delfim.base.geodesy import origin, to_plane
from delfim.console.boats.othervessels import AT_ONCE, MEETS, MOST, around
from tests.console.test_fleet import Sea

MARIA = 244_660_123
KNOWN = 2 | 4 | 4096  # course, velocity, name; of AIS_FLAGS
SIZED = 64
AT = 386_901_000, -92_150_000  # of boat 1, which sails north at 1 m/s


def vessel(number: int = MARIA, north_m: float = 0.0, east_m: float = 0.0, **more: Any) -> Any:
    """Beside boat 1, under way to the south at 4 m/s."""
    plane = origin(math.radians(AT[0] / 1e7), math.radians(AT[1] / 1e7))
    lat = AT[0] + round(math.degrees(north_m / plane.north_m_per_rad) * 1e7)
    lon = AT[1] + round(math.degrees(east_m / plane.east_m_per_rad) * 1e7)
    told = {"COG": 18_000, "heading": 18_000, "velocity": 400, "turn_rate": 0, "navigational_status": 0, "type": 0}
    told |= {"bow": 55, "stern": 55, "port": 6, "starboard": 6, "callsign": b"", "name": b"MARIA", "tslc": 0}
    told |= {"flags": KNOWN | SIZED} | more
    return mavlink.MAVLink_ais_vessel_message(number, lat, lon, *told.values())


def shown(sea: Sea) -> dict[str, dict[str, Any]]:
    return {each["name"]: each for each in around(list(sea.fleet.boats.values()), sea.clock.monotonic_s())["vessels"]}


def test_a_vessel_is_reckoned_on_from_its_report_and_compared_with_the_boat() -> None:
    sea = Sea(1)
    sea.run(2.0)
    sea.boats[1].say(vessel(north_m=1000.0, east_m=40.0, tslc=20))
    sea.run(1.0)
    maria = shown(sea)["MARIA"]
    at = math.radians(maria["latitude_deg"]), math.radians(maria["longitude_deg"])
    north_m, east_m = to_plane(origin(math.radians(AT[0] / 1e7), math.radians(AT[1] / 1e7)), *at)
    assert (north_m, east_m) == pytest.approx((1000.0 - 4.0 * 21.0, 40.0), abs=1.0)
    assert {"key": str(MARIA), "kind": "A", "size_known": True, "length_m": 110.0, "lost": False}.items() <= maria.items()
    (near,) = maria["boats"]
    north_mps, east_mps = 4.0 + 1.0, 0.5  # the boat's 1 m/s north and 0.5 m/s east against it
    tcpa_s = (north_m * north_mps + east_m * east_mps) / (north_mps**2 + east_mps**2)
    assert near["tcpa_s"] == pytest.approx(tcpa_s, rel=0.02)
    cpa_m = abs(north_m * east_mps - east_m * north_mps) / math.hypot(north_mps, east_mps)
    assert near["cpa_m"] == pytest.approx(cpa_m, rel=0.05)
    assert near["danger"] == "danger"
    assert maria["domain_m"][0] > 4 * 110


def test_class_size_and_those_without_a_number_of_their_own_are_told_apart() -> None:
    sea = Sea(1)
    sea.run(2.0)
    sea.boats[1].say(
        vessel(244_000_001, 3000.0, name=b"SAIL", navigational_status=15, flags=KNOWN),
        vessel(970_000_001, 3000.0, name=b"SART"),
        vessel(17, 3000.0, name=b"radar 7"),
        vessel(18, 3000.0, name=b"boat 9"),
        vessel(19, 3000.0, name=b"boat 1"),
        vessel(244_000_002, name=b"TOO FAST", velocity=60_000),
    )
    sea.run(1.0)
    seen = shown(sea)
    kinds = {name: each["kind"] for name, each in seen.items()}
    assert kinds == {"SAIL": "B", "SART": "distress", "radar 7": "payload", "boat 9": "fleet"}, "boat 1 is on the map already"
    assert (seen["SAIL"]["size_known"], seen["SAIL"]["length_m"]) == (False, 15.0)


def test_a_silent_vessel_is_lost_and_then_forgotten() -> None:
    sea = Sea(1)
    sea.run(2.0)
    sea.boats[1].say(vessel(north_m=5000.0))
    sea.run(59.0)
    assert not shown(sea)["MARIA"]["lost"]
    sea.run(3.0)
    assert shown(sea)["MARIA"]["lost"]
    sea.run(405.0)
    told = around(list(sea.fleet.boats.values()), sea.clock.monotonic_s())
    assert told["vessels"] == []
    assert 460.0 < told["heard_s"] < 480.0, "it is still known when somebody was heard last"
    assert sea.fleet.boats[1].others.tracks == {}


def test_the_newest_report_of_several_boats_counts_and_their_knowledge_is_one() -> None:
    sea = Sea(1, 2)
    sea.run(2.0)
    sea.boats[1].say(vessel(north_m=3000.0, tslc=30))
    sea.boats[2].say(vessel(north_m=2880.0, tslc=1, flags=2 | 4))
    sea.run(1.0)
    maria = shown(sea)["MARIA"]
    assert maria["age_s"] < 4.0
    assert maria["size_known"]
    assert {each["boat"] for each in maria["boats"]} == {1, 2}


def test_a_boats_own_transponder_heard_by_another_boat_is_no_danger_to_it() -> None:
    sea = Sea(1, 2)
    sea.run(2.0)
    sea.boats[2].say(vessel(name=b"DELFIM", COG=2700, velocity=112, bow=2, stern=2, port=1, starboard=1))
    sea.run(0.5)
    delfim = shown(sea)["DELFIM"]
    assert [each["boat"] for each in delfim["boats"]] == [2]


def test_who_moves_as_a_boat_does_is_near_to_it_and_no_danger_until_it_is_off() -> None:
    """Its own transponder, which its file does not name; or a tender alongside, which then leaves."""
    sea, levels, said = Sea(1), list[str](), list[bool]()
    sea.run(2.0)
    for second in range(90):
        east_m = 3.0 if second < 80 else 60.0
        sea.boats[1].say(vessel(east_m=east_m, COG=2700, velocity=112, bow=2, stern=2, port=1, starboard=1))
        sea.run(1.0)
        (met,) = shown(sea)["MARIA"]["boats"]
        levels.append(met["danger"])
        said.append(met["words"].startswith("MARIA moves as this boat does"))
    assert set(levels[:55]) == {"danger"}
    assert set(levels[65:80]) == {"near"}
    assert (any(said[:55]), all(said[65:80]), said[-1]) == (False, True, False)


def test_two_hundred_vessels_of_a_boat_are_kept_the_newest() -> None:
    sea = Sea(1)
    sea.run(2.0)
    for number in range(MOST + 50):
        sea.fleet._take(1, decoded(vessel(200_000_000 + number, 2000.0 + 10.0 * number)))
    told = around(list(sea.fleet.boats.values()), sea.clock.monotonic_s())
    assert len(sea.fleet.boats[1].others.tracks) == len(told["vessels"]) == MOST
    assert str(200_000_000) not in {each["key"] for each in told["vessels"]}


def decoded(message: Any) -> Any:
    message.pack(mavlink.MAVLink(None, 1, 1))
    return message


def test_the_order_of_a_boat_is_known_with_its_sentence_until_it_is_over() -> None:
    sea = Sea(1)
    words = "giving way to MARIA, crossing from starboard, passing astern, CPA 62 m"
    sea.run(2.0)
    assert (sea.shown(1)["order"], sea.shown(1)["guard"]) == (None, None)
    assert len(words) > 50, "it comes in two pieces"
    sea.boats[1].say(
        mavlink.MAVLink_statustext_message(5, words[:50].encode(), 7, 0),
        mavlink.MAVLink_statustext_message(5, words[50:].encode(), 7, 1),
        mavlink.MAVLink_named_value_float_message(0, b"ORDER_CRS", 45.0),
        mavlink.MAVLink_named_value_int_message(0, b"GUARD", 1),
    )
    sea.run(1.0)
    assert (sea.shown(1)["order"], sea.shown(1)["guard"]) == ({"course_deg": 45.0, "words": words}, "on")
    assert "ORDER_CRS" not in sea.shown(1)["measured"]
    sea.boats[1].say(mavlink.MAVLink_named_value_float_message(0, b"ORDER_CRS", math.nan))
    sea.run(1.0)
    assert sea.shown(1)["order"] is None
    sea.boats[1].say(mavlink.MAVLink_named_value_float_message(0, b"ORDER_CRS", 45.0))
    sea.run(1.0)
    assert sea.shown(1)["order"] == {"course_deg": 45.0, "words": "keeping clear of another vessel"}, "the sentence was lost"
    sea.run(15.0)
    assert (sea.shown(1)["order"], sea.shown(1)["guard"]) == (None, None), "the boat says it no more"


def test_a_boat_on_guard_is_in_danger_only_in_a_domain() -> None:
    sea = Sea(1)
    sea.run(2.0)

    maria = vessel(north_m=900.0, east_m=90.0, bow=10, stern=10)

    def danger(guard: int) -> str:
        sea.boats[1].say(mavlink.MAVLink_named_value_int_message(0, b"GUARD", guard), maria)
        sea.run(1.0)
        return str(shown(sea)["MARIA"]["boats"][0]["danger"])

    assert danger(1) == "near", "it will keep clear"
    assert danger(2) == "danger", "it cannot"


def test_of_many_boats_each_is_judged_in_its_turn() -> None:
    numbers = range(1, 2 * AT_ONCE + 2)
    sea = Sea(*numbers)
    sea.run(2.0)
    sea.boats[1].say(vessel(north_m=1000.0))
    sea.run(0.5)
    met = set[int]()
    for _ in range(3):
        (near,) = around(list(sea.fleet.boats.values()), sea.clock.monotonic_s())["vessels"]
        assert len(near["boats"]) == MEETS
        met |= {number for number in numbers if sea.fleet.boats[number].others.met}
        sea.run(1.0)
    assert met == set(numbers)
