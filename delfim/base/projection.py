"""Planes of charts by their EPSG numbers, and back to degrees: geographic, web Mercator, UTM.

ETRS89 (4258, 258zz) is taken for WGS 84: they differ by less than a metre, which no chart of this kind shows.
"""

import math
from collections.abc import Callable
from typing import Any, Final

from delfim.base.errors import FormatError

Plane = tuple[Callable[[Any, Any], tuple[Any, Any]], Callable[[Any, Any], tuple[Any, Any]]]

GEOGRAPHIC: Final = 4326
_A, _F = 6378137.0, 1.0 / 298.257223563  # WGS 84: semi-major axis, m; flattening
_N = _F / (2.0 - _F)
_RADIUS: Final = _A / (1.0 + _N) * (1.0 + _N**2 / 4.0 + _N**4 / 64.0)
# Krueger's series to the third order (Karney 2011, eq. 35 and 36): better than a millimetre inside a zone.
_ALPHA: Final = (_N / 2 - 2 * _N**2 / 3 + 5 * _N**3 / 16, 13 * _N**2 / 48 - 3 * _N**3 / 5, 61 * _N**3 / 240)
_BETA: Final = (_N / 2 - 2 * _N**2 / 3 + 37 * _N**3 / 96, _N**2 / 48 + _N**3 / 15, 17 * _N**3 / 480)
_SCALE, _FALSE_EAST_M, _FALSE_NORTH_M = 0.9996, 500_000.0, 10_000_000.0
_E: Final = math.sqrt(_F * (2.0 - _F))


def utm_of(latitude_deg: float, longitude_deg: float) -> int:
    """The EPSG number of the zone of UTM that a place lies in, of WGS 84."""
    zone = int((longitude_deg + 180.0) // 6.0) % 60 + 1
    return (32700 if latitude_deg < 0.0 else 32600) + zone


def plane(epsg: int, functions: Any = math) -> Plane:
    """(from degrees, to degrees): (longitude_deg, latitude_deg) -> (x, y) and back. With numpy for `functions` UTM takes
    arrays, of any one shape. Raises FormatError for other planes."""
    if epsg in (GEOGRAPHIC, 4258):
        return _same, _same
    if epsg == 3857:
        return _to_mercator, _from_mercator
    for first, south in ((32600, False), (32700, True), (25800, False)):
        if 1 <= epsg - first <= 60:
            return _utm(epsg - first, _FALSE_NORTH_M if south else 0.0, functions)
    raise FormatError(f"EPSG:{epsg} is not known here: 4326, 3857 and UTM (326zz, 327zz, 258zz) are")


def _same(x: float, y: float) -> tuple[float, float]:
    return x, y


def _to_mercator(longitude_deg: float, latitude_deg: float) -> tuple[float, float]:
    return _A * math.radians(longitude_deg), _A * math.asinh(math.tan(math.radians(latitude_deg)))


def _from_mercator(x: float, y: float) -> tuple[float, float]:
    return math.degrees(x / _A), math.degrees(math.atan(math.sinh(y / _A)))


def _utm(zone: int, false_north_m: float, m: Any) -> Plane:
    middle_deg = zone * 6.0 - 183.0

    def forward(longitude_deg: Any, latitude_deg: Any) -> tuple[Any, Any]:
        sine = m.sin(m.radians(latitude_deg))
        tau = m.sinh(m.atanh(sine) - _E * m.atanh(_E * sine))  # of the conformal latitude
        off = m.radians(longitude_deg - middle_deg)
        xi, eta = m.atan2(tau, m.cos(off)), m.asinh(m.sin(off) / m.hypot(tau, m.cos(off)))
        north, east = xi, eta
        for order, factor in enumerate(_ALPHA, 1):
            north = north + factor * m.sin(2 * order * xi) * m.cosh(2 * order * eta)
            east = east + factor * m.cos(2 * order * xi) * m.sinh(2 * order * eta)
        return _FALSE_EAST_M + _SCALE * _RADIUS * east, false_north_m + _SCALE * _RADIUS * north

    def back(x: Any, y: Any) -> tuple[Any, Any]:
        north = (y - false_north_m) / (_SCALE * _RADIUS)
        east = (x - _FALSE_EAST_M) / (_SCALE * _RADIUS)
        xi, eta = north, east
        for order, factor in enumerate(_BETA, 1):
            xi = xi - factor * m.sin(2 * order * north) * m.cosh(2 * order * east)
            eta = eta - factor * m.cos(2 * order * north) * m.sinh(2 * order * east)
        sine = m.sin(xi) / m.cosh(eta)  # of the conformal latitude
        isometric, latitude = m.atanh(sine), m.asin(sine)
        for _ in range(5):
            latitude = m.asin(m.tanh(isometric + _E * m.atanh(_E * m.sin(latitude))))
        return middle_deg + m.degrees(m.atan2(m.sinh(eta), m.cos(xi))), m.degrees(latitude)

    return forward, back
