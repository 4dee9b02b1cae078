"""Targets of a radar by TTM and TLL, written by an encoder that is not the project's, through the boat's source and sensor."""

import math
from contextlib import suppress

import pynmea2
import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.errors import FormatError
from delfim.base.geodesy import to_plane
from delfim.lines.nmea0183.sentences import READERS, RadarTarget
from delfim.vehicle.state import Motion
from tests.parts.nmea0183.test_ais_lines import Aboard

ALL = frozenset({"position", "heading", "velocity"})
NAUTICAL_M = 1852.0


def ttm(
    number=7, distance=0.5, bearing=90.0, seen="T", speed=6.0, course=180.0, by="T", unit="N", name="", status="T"
) -> bytes:
    fields = (f"{number:02}", f"{distance}", f"{bearing}", seen, f"{speed}", f"{course}", by, "0.1", "2.0", unit, name, status)
    return (str(pynmea2.TTM("RA", "TTM", (*fields, "", "120000.00", "A"))) + "\r\n").encode()


def tll(number=12, latitude="4735.0000", longitude="12220.0000", name="BUOY", status="T") -> bytes:
    fields = (f"{number:02}", latitude, "N", longitude, "W", name, "120000.00", status, "")
    return (str(pynmea2.TLL("RA", "TLL", fields)) + "\r\n").encode()


def read(line: bytes) -> RadarTarget | None:
    fields = line.decode().strip()[1:].partition("*")[0].split(",")
    return READERS[fields[0][2:]][1](fields)  # type: ignore[return-value]


def aboard(*, navigates: bool, heading_deg: float = 30.0) -> Aboard:
    boat = Aboard(navigates=navigates)
    boat.state.motion = Motion(ALL, 100.0, 50.0, math.radians(heading_deg), 0.0, 0.0, 0.0)
    boat.state.navigation_s = boat.clock.monotonic_s()
    return boat


@pytest.mark.parametrize("navigates", [True, False])
@pytest.mark.parametrize(("seen", "bearing_deg"), [("T", 90.0), ("R", 60.0)])
def test_a_target_is_told_where_it_is_and_how_it_goes_with_who_saw_it(navigates, seen, bearing_deg) -> None:
    boat = aboard(navigates=navigates)
    boat.hear(ttm(bearing=bearing_deg, seen=seen))
    (target,) = boat.state.traffic.targets
    assert (target.key, target.name, target.kind) == ("payload ais 7", "ais 7", "payload")
    assert (target.north_m, target.east_m) == pytest.approx((100.0, 50.0 + 0.5 * NAUTICAL_M), abs=0.1)
    assert (target.speed_mps, target.course_rad) == pytest.approx((6.0 * NAUTICAL_M / 3600.0, math.pi))


def test_a_place_by_itself_needs_no_boat_and_two_make_a_course() -> None:
    boat = Aboard(navigates=False)
    boat.hear(tll())
    boat.clock.advance(20.0)
    boat.hear(tll(latitude="4735.0200"))
    (target,) = boat.state.traffic.targets
    assert target.name == "BUOY"
    assert target.speed_mps == pytest.approx(0.02 * NAUTICAL_M / 21.0, rel=0.05)
    assert boat.state.origin is not None
    place = to_plane(boat.state.origin, math.radians(47.0 + 35.02 / 60.0), -math.radians(122.0 + 20.0 / 60.0))
    assert (target.north_m, target.east_m) == pytest.approx(place, abs=0.1)


@pytest.mark.parametrize("status", ["L", "Q"])
def test_what_is_lost_or_not_acquired_yet_is_no_target(status) -> None:
    boat = aboard(navigates=False)
    boat.hear(ttm(status=status), tll(status=status))
    assert boat.state.traffic.targets == ()


def test_a_boat_that_does_not_know_where_it_is_counts_it_in_words() -> None:
    boat = aboard(navigates=False)
    boat.state.navigation_s -= 5.0
    boat.hear(ttm())
    assert boat.state.traffic.targets == ()
    assert boat.lookout.tracker.refused == {"radar target while the boat does not know where it is, and how it lies": 1}


def test_a_relative_course_is_none() -> None:
    told = read(ttm(by="R"))
    assert told is not None
    assert (told.course_rad, told.speed_mps) == (None, None)


@given(
    st.integers(0, 999),
    st.decimals("0", "99", places=2),
    st.decimals("0", "359.9", places=1),
    st.sampled_from("KNS"),
    st.decimals("0", "90", places=1),
)
def test_what_the_other_encoder_says_is_what_is_read(number, distance, bearing, unit, speed) -> None:
    told = read(ttm(number, distance, bearing, speed=speed, unit=unit, name="A B"))
    assert told is not None
    metres = {"K": 1000.0, "N": NAUTICAL_M, "S": 1609.344}[unit]
    assert (told.number, told.name) == (number, "A B")
    assert told.distance_m == pytest.approx(float(distance) * metres)
    assert told.bearing_rad == pytest.approx(math.radians(float(bearing)))
    assert told.speed_mps == pytest.approx(float(speed) * metres / 3600.0)


@given(st.lists(st.text(max_size=8), min_size=8, max_size=16), st.sampled_from(["TTM", "TLL"]))
def test_malformed_targets_are_refused_in_words(fields, formatter) -> None:
    least, reader = READERS[formatter]
    whole = [f"RA{formatter}", *fields]
    if len(whole) < least:
        return
    for status in ("T", fields[0]):
        whole[12 if formatter == "TTM" and len(whole) > 12 else 8] = status
        with suppress(FormatError):
            told = reader(whole)
            assert told is None or isinstance(told, RadarTarget)
