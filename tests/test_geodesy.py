"""The local plane against the earth it stands for."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.geodesy import TAU, compass, from_plane, origin, to_plane, wrap

latitude = st.floats(-80.0, 80.0).map(math.radians)
longitude = st.floats(-180.0, 180.0).map(math.radians)
metres = st.floats(-10_000.0, 10_000.0)
angle = st.floats(-1e4, 1e4)


def ecef(latitude_rad: float, longitude_rad: float) -> tuple[float, float, float]:
    """Position on the WGS 84 ellipsoid in metres from the centre of the earth (NIMA TR8350.2, 4.4)."""
    a, f = 6378137.0, 1.0 / 298.257223563
    e2 = f * (2.0 - f)
    n = a / math.sqrt(1.0 - e2 * math.sin(latitude_rad) ** 2)
    x = n * math.cos(latitude_rad) * math.cos(longitude_rad)
    y = n * math.cos(latitude_rad) * math.sin(longitude_rad)
    return x, y, n * (1.0 - e2) * math.sin(latitude_rad)


@given(latitude, longitude, metres, metres)
def test_round_trip(latitude_rad: float, longitude_rad: float, north_m: float, east_m: float) -> None:
    at = origin(latitude_rad, longitude_rad)
    assert to_plane(at, *from_plane(at, north_m, east_m)) == pytest.approx((north_m, east_m), abs=1e-4)


@given(latitude, longitude)
def test_the_origin_is_zero(latitude_rad: float, longitude_rad: float) -> None:
    at = origin(latitude_rad, longitude_rad)
    assert to_plane(at, latitude_rad, longitude_rad) == (0.0, 0.0)


@given(st.floats(-55.0, 55.0).map(math.radians), longitude, st.floats(1.0, 10_000.0), st.floats(0.0, TAU))
def test_distance_from_the_origin_is_right_within_a_thousandth(lat, lon, distance_m, bearing):
    """Where the module promises it; measured straight through the earth, which is 1e-7 shorter at most."""
    there = from_plane(origin(lat, lon), distance_m * math.cos(bearing), distance_m * math.sin(bearing))
    assert math.dist(ecef(lat, lon), ecef(*there)) == pytest.approx(distance_m, rel=1e-3)


def test_known_distances() -> None:
    """A degree of latitude at 45 degrees is 111,131.8 m, one of longitude at the equator 111,319.5 m; here minutes of them."""
    minute = math.radians(1 / 60)
    assert to_plane(origin(math.radians(45.0), 0.0), math.radians(45.0) + minute, 0.0)[0] == pytest.approx(
        111131.8 / 60, rel=1e-3
    )
    assert to_plane(origin(0.0, 0.0), 0.0, minute)[1] == pytest.approx(111319.5 / 60, rel=1e-6)


def test_across_the_antimeridian() -> None:
    at = origin(0.0, math.radians(179.999))
    _, east_m = to_plane(at, 0.0, math.radians(-179.999))
    assert east_m == pytest.approx(111319.5 * 0.002, rel=1e-6)
    _, longitude_rad = from_plane(at, 0.0, east_m)
    assert math.degrees(longitude_rad) == pytest.approx(-179.999)


@given(latitude, longitude, metres, metres)
def test_longitudes_stay_in_their_range(latitude_rad: float, longitude_rad: float, north_m: float, east_m: float) -> None:
    assert -math.pi <= from_plane(origin(latitude_rad, longitude_rad), north_m, east_m)[1] <= math.pi


@given(angle)
def test_wrap(angle_rad: float) -> None:
    wrapped = wrap(angle_rad)
    assert -math.pi <= wrapped <= math.pi
    assert math.cos(wrapped - angle_rad) == pytest.approx(1.0)


@given(angle)
def test_compass(angle_rad: float) -> None:
    shown = compass(angle_rad)
    assert 0.0 <= shown < TAU
    assert math.cos(shown - angle_rad) == pytest.approx(1.0)
