"""Planes of charts by their EPSG numbers, and back to degrees: geographic, web Mercator, UTM.

ETRS89 (4258, 258zz) is taken for WGS 84: they differ by less than a metre, which no chart of this kind shows.
"""

import math
from collections.abc import Callable
from typing import Final

from delfim.base.errors import FormatError

Plane = tuple[Callable[[float, float], tuple[float, float]], Callable[[float, float], tuple[float, float]]]

GEOGRAPHIC: Final = 4326
_A, _F = 6378137.0, 1.0 / 298.257223563  # WGS 84: semi-major axis, m; flattening
_N = _F / (2.0 - _F)
_RADIUS: Final = _A / (1.0 + _N) * (1.0 + _N**2 / 4.0 + _N**4 / 64.0)
# Krueger's series to the third order (Karney 2011, eq. 35 and 36): better than a millimetre inside a zone.
_ALPHA: Final = (_N / 2 - 2 * _N**2 / 3 + 5 * _N**3 / 16, 13 * _N**2 / 48 - 3 * _N**3 / 5, 61 * _N**3 / 240)
_BETA: Final = (_N / 2 - 2 * _N**2 / 3 + 37 * _N**3 / 96, _N**2 / 48 + _N**3 / 15, 17 * _N**3 / 480)
_SCALE, _FALSE_EAST_M, _FALSE_NORTH_M = 0.9996, 500_000.0, 10_000_000.0
_E: Final = math.sqrt(_F * (2.0 - _F))


def plane(epsg: int) -> Plane:
    """(from degrees, to degrees): (longitude_deg, latitude_deg) -> (x, y) and back. Raises FormatError for other planes."""
    if epsg in (GEOGRAPHIC, 4258):
        return _same, _same
    if epsg == 3857:
        return _to_mercator, _from_mercator
    for first, south in ((32600, False), (32700, True), (25800, False)):
        if 1 <= epsg - first <= 60:
            return _utm(epsg - first, _FALSE_NORTH_M if south else 0.0)
    raise FormatError(f"EPSG:{epsg} is not known here: 4326, 3857 and UTM (326zz, 327zz, 258zz) are")


def _same(x: float, y: float) -> tuple[float, float]:
    return x, y


def _to_mercator(longitude_deg: float, latitude_deg: float) -> tuple[float, float]:
    return _A * math.radians(longitude_deg), _A * math.asinh(math.tan(math.radians(latitude_deg)))


def _from_mercator(x: float, y: float) -> tuple[float, float]:
    return math.degrees(x / _A), math.degrees(math.atan(math.sinh(y / _A)))


def _utm(zone: int, false_north_m: float) -> Plane:
    middle_deg = zone * 6.0 - 183.0

    def forward(longitude_deg: float, latitude_deg: float) -> tuple[float, float]:
        sine = math.sin(math.radians(latitude_deg))
        tau = math.sinh(math.atanh(sine) - _E * math.atanh(_E * sine))  # of the conformal latitude
        off = math.radians(longitude_deg - middle_deg)
        xi, eta = math.atan2(tau, math.cos(off)), math.asinh(math.sin(off) / math.hypot(tau, math.cos(off)))
        north, east = xi, eta
        for order, factor in enumerate(_ALPHA, 1):
            north += factor * math.sin(2 * order * xi) * math.cosh(2 * order * eta)
            east += factor * math.cos(2 * order * xi) * math.sinh(2 * order * eta)
        return _FALSE_EAST_M + _SCALE * _RADIUS * east, false_north_m + _SCALE * _RADIUS * north

    def back(x: float, y: float) -> tuple[float, float]:
        north = (y - false_north_m) / (_SCALE * _RADIUS)
        east = (x - _FALSE_EAST_M) / (_SCALE * _RADIUS)
        xi, eta = north, east
        for order, factor in enumerate(_BETA, 1):
            xi -= factor * math.sin(2 * order * north) * math.cosh(2 * order * east)
            eta -= factor * math.cos(2 * order * north) * math.sinh(2 * order * east)
        sine = math.sin(xi) / math.cosh(eta)  # of the conformal latitude
        isometric, latitude = math.atanh(sine), math.asin(sine)
        for _ in range(5):
            latitude = math.asin(math.tanh(isometric + _E * math.atanh(_E * math.sin(latitude))))
        return middle_deg + math.degrees(math.atan2(math.sinh(eta), math.cos(xi))), math.degrees(latitude)

    return forward, back
