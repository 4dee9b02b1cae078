"""Angles and the local plane. Controllers work in metres north and east of an origin; degrees exist at the borders only.

The plane is equirectangular at the origin's latitude with the WGS 84 radii of curvature: within 10 km of the origin, up
to 55 degrees of latitude, the error of a distance stays below 0.1 %, which a boat does not notice.
"""

import math
from typing import NamedTuple

_A = 6378137.0  # WGS 84 semi-major axis, m
_E2 = 6.69437999014e-3  # WGS 84 first eccentricity squared
TAU = math.tau


class Origin(NamedTuple):
    """Where north_m = east_m = 0, with metres per radian there."""

    latitude_rad: float
    longitude_rad: float
    north_m_per_rad: float
    east_m_per_rad: float


def origin(latitude_rad: float, longitude_rad: float) -> Origin:
    """The local plane at a position; latitude within +-89 degrees."""
    w = math.sqrt(1.0 - _E2 * math.sin(latitude_rad) ** 2)
    meridian, prime = _A * (1.0 - _E2) / w**3, _A / w
    return Origin(latitude_rad, longitude_rad, meridian, prime * math.cos(latitude_rad))


def to_plane(at: Origin, latitude_rad: float, longitude_rad: float) -> tuple[float, float]:
    """(north_m, east_m) of a position."""
    return (
        (latitude_rad - at.latitude_rad) * at.north_m_per_rad,
        wrap(longitude_rad - at.longitude_rad) * at.east_m_per_rad,
    )


def from_plane(at: Origin, north_m: float, east_m: float) -> tuple[float, float]:
    """(latitude_rad, longitude_rad) of a point of the plane."""
    return at.latitude_rad + north_m / at.north_m_per_rad, wrap(at.longitude_rad + east_m / at.east_m_per_rad)


def wrap(angle_rad: float) -> float:
    """The same angle in -pi..pi."""
    return math.remainder(angle_rad, TAU)


def compass(angle_rad: float) -> float:
    """The same angle in 0..2 pi, as headings and courses are shown."""
    return angle_rad % TAU % TAU  # twice, because -1e-20 % TAU is TAU
