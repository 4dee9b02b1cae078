"""Other vessels by MAVLink, both ways, and from the guest: through the vehicle's loop, to its state."""

import json
import math
from types import SimpleNamespace
from typing import Any, get_args

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.parts.mavlink.codec.aisvessel import NEAR, guard, number_of, ordered
from delfim.parts.traffic.encounter import BEGINNINGS, Duty, words
from delfim.parts.traffic.lookout import LOOK_S
from delfim.vehicle.grex import sighted
from delfim.vehicle.state import State
from delfim.vehicle.target import CourseOrder, Target
from tests.parts.mavlink.mavlink_console import Console
from tests.parts.mavlink.test_mavlink_station import afloat, sail

MARIA = 244_660_123
HERE = 38.6907, -9.2153
KNOWN = 2 | 4 | 64 | 4096  # course, velocity, dimensions, name; of AIS_FLAGS


def say(console: Console, mmsi: int = MARIA, **more: Any) -> None:
    told: dict[str, Any] = {
        "lat": round((HERE[0] + 0.01) * 1e7),
        "lon": round(HERE[1] * 1e7),
        "COG": 9000,
        "heading": 9100,
        "velocity": 400,
        "turn_rate": 0,
        "navigational_status": 0,
        "type": 70,
        "dimension_bow": 20,
        "dimension_stern": 90,
        "dimension_port": 6,
        "dimension_starboard": 9,
        "callsign": b"PDAB",
        "name": b"MARIA",
        "tslc": 0,
        "flags": KNOWN,
    }
    console.say("ais_vessel", mmsi, *(told | more).values())


def looked(sea: SimpleNamespace) -> dict[str, Any]:
    """The targets after the next look."""
    sail(sea, 2.0 * LOOK_S)
    return {each.key: each for each in sea.state.traffic.targets}


@pytest.fixture
def sea(boat):
    return afloat(boat)


def test_a_vessel_of_a_console_is_a_target(sea):
    say(sea.console, tslc=20)
    target = looked(sea)["244660123"]
    assert (target.name, target.kind, target.length_m, target.beam_m, target.is_size_known) == ("MARIA", "A", 110.0, 15.0, True)
    assert target.speed_mps == 4.0
    assert math.degrees(target.course_rad) == pytest.approx(90.0)
    assert 20.0 <= target.age_s <= 22.5


@pytest.mark.parametrize("mmsi", [0, 999, 1_000_000_000, 4_294_967_295])
def test_a_number_that_no_vessel_has_is_refused_and_an_old_report_too(sea, mmsi):
    say(sea.console, mmsi=mmsi)
    say(sea.console, tslc=601)
    assert looked(sea) == {}
    assert sea.station.consoles.counts["vessels_refused"] == 2


def test_a_file_that_does_not_hear_mavlink_and_the_guest_computer_are_refused(sea):
    say(Console(sea.station, sea.radio, component=191))
    settings = sea.vehicle.helm.settings
    sea.vehicle.helm.settings = msgspec.structs.replace(settings, traffic=config.TrafficTable(hears=()))
    say(sea.console)
    sea.vehicle.on_guest(b'{"target": {"id": "radar 7", "latitude_deg": 38.69, "longitude_deg": -9.21}}')
    assert looked(sea) == {}
    assert sea.state.counts["guest_malformed"] == 1


def test_a_sister_tells_where_she_is_and_we_are_none_of_ours(sea):
    sister = Console(sea.station, sea.radio, system=3, component=1, address=("127.0.0.1", 14999))
    place = round((HERE[0] + 0.001) * 1e7), round(HERE[1] * 1e7)
    sister.say("global_position_int", 1, *place, 0, 0, 0, 150, 0, 9000)
    Console(sea.station, sea.radio, system=1, component=1).say("global_position_int", 1, *place, 0, 0, 0, 150, 0, 9000)
    (target,) = looked(sea).values()
    assert (target.key, target.kind, target.speed_mps) == ("boat 3", "fleet", 1.5)
    assert math.degrees(target.course_rad) == pytest.approx(90.0)
    assert not target.is_lost


def test_what_a_payload_sees_is_a_target_and_gives_no_set_point(sea):
    seen = {
        "id": "radar 7",
        "latitude_deg": HERE[0],
        "longitude_deg": HERE[1] + 0.01,
        "course_deg": 270,
        "speed_mps": 2,
        "length_m": 9,
    }
    sea.vehicle.on_guest(json.dumps({"target": seen}).encode())
    target = looked(sea)["payload radar 7"]
    assert (target.name, target.kind, target.speed_mps) == ("radar 7", "payload", 2.0)
    assert sea.state.setpoint.guest_heading_rad is None
    assert sea.state.guest_s < 0.0
    assert "guest_malformed" not in sea.state.counts


@pytest.mark.parametrize(
    "seen",
    [
        {},
        {"id": "", "latitude_deg": 1, "longitude_deg": 1},
        {"id": "x" * 25, "latitude_deg": 1, "longitude_deg": 1},
        {"id": "a\u0000", "latitude_deg": 1, "longitude_deg": 1},
        {"id": "a", "latitude_deg": 91, "longitude_deg": 1},
        {"id": "a", "latitude_deg": None, "longitude_deg": 1},
        {"id": "a", "latitude_deg": 1, "longitude_deg": 1, "speed_mps": -1},
        {"id": "a", "latitude_deg": 1, "longitude_deg": 1, "colour": "red"},
    ],
)
def test_what_no_payload_can_see_is_counted(sea, seen):
    sea.vehicle.on_guest(json.dumps({"target": seen}).encode())
    assert looked(sea) == {}
    assert sea.state.counts["guest_malformed"] == 1


@given(st.binary(max_size=200) | st.text().map(lambda text: f'{{"target": {{"id": "{text}"}}}}'.encode()))
def test_any_line_is_a_vessel_or_none(line: bytes) -> None:
    state = State()
    assert sighted(line, state, 0.0) == bool(state.heard)


def test_consoles_are_told_the_nearest_often_and_all_in_turn(sea):
    for i in range(40):
        say(sea.console, mmsi=MARIA + i, lat=round((HERE[0] + 0.001 * (i + 1)) * 1e7), name=f"SHIP {i}".encode())
    sea.vehicle.on_guest(
        json.dumps({"target": {"id": "radar 7", "latitude_deg": HERE[0], "longitude_deg": HERE[1] + 0.1}}).encode()
    )
    looked(sea)
    heard = [m for m in sail(sea, 10.5) if m.get_type() == "AIS_VESSEL"]
    assert {m.MMSI for m in heard} == {MARIA + i for i in range(40)} | {number_of("payload radar 7")}
    assert len(heard) <= 2 * 4 * 11
    assert sum(m.MMSI < MARIA + NEAR for m in heard) > len(heard) / 2
    first = next(m for m in heard if m.MMSI == MARIA)
    assert (first.COG, first.heading, first.velocity, first.navigational_status, first.name) == (9000, 9100, 400, 0, "SHIP 0")
    assert first.flags & 64
    assert first.lat * 1e-7 == pytest.approx(HERE[0] + 0.001, abs=2e-5)
    assert first.lon * 1e-7 == pytest.approx(HERE[1], abs=5e-4)  # the middle of the hull, the antenna was told
    assert (first.dimension_bow, first.dimension_stern) == (55, 55)
    payload = next(m for m in heard if m.MMSI < 1000)
    assert (payload.name, payload.heading, payload.flags & 64) == ("radar 7", 0xFFFF, 0)


@pytest.mark.parametrize(("profile", "times"), [("wifi", 1), ("radio", 4)])
def test_none_of_many_is_passed_over_whatever_the_link(boat, profile, times):
    sea = afloat(boat, profile=profile)
    for i in range(40):
        say(sea.console, mmsi=MARIA + i, lat=round((HERE[0] + 0.001 * (i + 1)) * 1e7))
    looked(sea)
    heard = list[int]()
    for _ in range(times):
        sea.console.beat()
        heard += [m.MMSI for m in sail(sea, 10.5) if m.get_type() == "AIS_VESSEL"]
    assert set(heard) == {MARIA + i for i in range(40)}
    assert min(heard.count(MARIA + i) for i in range(NEAR)) > 3, "the nearest come often"


def test_nobody_is_told_of_nobody(sea):
    assert not [m for m in sail(sea, 3.0) if m.get_type() == "AIS_VESSEL"]


def test_consoles_are_told_the_order_and_the_guard_once_somebody_was_heard(sea):
    def told(seconds: float = 2.0) -> dict[str, float]:
        heard = [m for m in sail(sea, seconds) if m.get_type().startswith("NAMED_VALUE")]
        return {m.name: m.value for m in heard if m.name in ("ORDER_CRS", "GUARD")}

    assert told() == {}
    say(sea.console)
    looked(sea)
    assert (math.isnan(told()["ORDER_CRS"]), told()["GUARD"]) == (True, 0), "idle: it keeps clear of nobody"
    order = CourseOrder(math.radians(-90.0), 1.0, 1.5, "giving way to MARIA, head-on", str(MARIA), 1.2, sea.state.traffic.at_s)
    sea.state.traffic = sea.state.traffic._replace(order=order, guard="cannot avoid: no position")
    assert [(m.name, m.value) for m in ordered(sea.state, 0)] == [("ORDER_CRS", 270.0)]
    assert [(m.name, m.value) for m in guard(sea.state, 0)] == [("GUARD", 2)]


@pytest.mark.parametrize("owed", get_args(Duty))
@pytest.mark.parametrize("is_late", [True, False])
def test_what_an_order_says_begins_as_a_console_expects(owed: Duty, is_late: bool) -> None:
    target = Target("1", "MARIA", 0, 0, 0, 1, math.nan, 15, 5, True, 10, 1, False, "A", 0)
    assert words(owed, target, is_late).startswith(BEGINNINGS)
    assert words(owed, target._replace(status=7), is_late).startswith(BEGINNINGS)
