"""Angles and the local plane. Controllers work in metres north and east of an origin; degrees exist at the borders only.

The plane is equirectangular at the origin's latitude with the WGS 84 radii of curvature: within 10 km of the origin, up
to 55 degrees of latitude, the error of a distance stays below 0.1 %, which a boat does not notice.
"""

import math
from collections.abc import Generator, Sequence
from typing import NamedTuple

_A = 6378137.0  # WGS 84 semi-major axis, m
_E2 = 6.69437999014e-3  # WGS 84 first eccentricity squared
TAU = math.tau
_remainder = math.remainder


class Origin(NamedTuple):
    """The origin of the local plane, where north_m = east_m = 0, with metres per radian there."""

    latitude_rad: float
    longitude_rad: float
    north_m_per_rad: float
    east_m_per_rad: float


def origin(latitude_rad: float, longitude_rad: float) -> Origin:
    """The origin of a local plane at this position; latitude within +-89 degrees."""
    w = math.sqrt(1.0 - _E2 * math.sin(latitude_rad) ** 2)
    meridian, prime = _A * (1.0 - _E2) / w**3, _A / w
    return Origin(latitude_rad, longitude_rad, meridian, prime * math.cos(latitude_rad))


def to_plane(at: Origin, latitude_rad: float, longitude_rad: float) -> tuple[float, float]:
    """Project a position onto the plane: (north_m, east_m)."""
    return (
        (latitude_rad - at.latitude_rad) * at.north_m_per_rad,
        wrap(longitude_rad - at.longitude_rad) * at.east_m_per_rad,
    )


def from_plane(at: Origin, north_m: float, east_m: float) -> tuple[float, float]:
    """Convert a point of the plane to (latitude_rad, longitude_rad)."""
    return at.latitude_rad + north_m / at.north_m_per_rad, wrap(at.longitude_rad + east_m / at.east_m_per_rad)


def wrap(angle_rad: float) -> float:
    """Wrap an angle to -pi..pi."""
    return _remainder(angle_rad, TAU)


def compass(angle_rad: float) -> float:
    """Wrap an angle to 0..2 pi, as headings and courses are shown."""
    return angle_rad % TAU % TAU  # twice, because -1e-20 % TAU is TAU


def polygon_fault(corners: Sequence[tuple[float, float]]) -> Generator[int, None, str | None]:
    """The reason, in words, why corners in any unit are not a usable polygon; None if they are. Cooperative work
    (delfim/base/cooperative.py): sides are compared with each other."""
    if len(corners) < 3:
        return f"a polygon of {len(corners)} corners: it needs three"
    if len(set(corners)) < len(corners):
        return "the polygon has the same corner twice"
    sides = list(zip(corners, [*corners[1:], corners[0]], strict=True))
    for i, (a, b) in enumerate(sides):
        for j in range(i + 2, len(sides) - (i == 0)):  # neighbours share a corner
            if segments_meet(a, b, *sides[j]):
                return f"the polygon crosses itself: the side from corner {i + 1} meets the one from corner {j + 1}"
        yield len(sides) - i
    if not any(_side(corners[0], corners[1], corner) for corner in corners[2:]):
        return "the polygon's corners lie on one line"
    return None


def segments_meet(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float], d: tuple[float, float]) -> bool:
    """Whether the segments a-b and c-d have a point in common."""
    to_c, to_d, to_a, to_b = _side(a, b, c), _side(a, b, d), _side(c, d, a), _side(c, d, b)
    if to_c * to_d < 0.0 and to_a * to_b < 0.0:
        return True
    return (
        (to_c == 0.0 and _within(a, b, c))
        or (to_d == 0.0 and _within(a, b, d))
        or (to_a == 0.0 and _within(c, d, a))
        or (to_b == 0.0 and _within(c, d, b))
    )


def _side(a: tuple[float, float], b: tuple[float, float], p: tuple[float, float]) -> float:
    """The side of the line through a and b on which the point p is, by sign."""
    return (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])


def _within(a: tuple[float, float], b: tuple[float, float], p: tuple[float, float]) -> bool:
    """Whether p, known to be on the line through a and b, is between them."""
    return min(a[0], b[0]) <= p[0] <= max(a[0], b[0]) and min(a[1], b[1]) <= p[1] <= max(a[1], b[1])
