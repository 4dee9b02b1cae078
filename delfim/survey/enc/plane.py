"""Shapes of degrees, x longitude and y latitude, in the plane about a place, and back."""

import math
from typing import Any

import numpy
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from delfim.base.geodesy import Origin

Array = NDArray[numpy.float64]


def flat(shape: BaseGeometry, at: Origin) -> Any:
    """A shape in the plane: x to the east, y to the north, m."""
    latitude, longitude = math.degrees(at.latitude_rad), math.degrees(at.longitude_rad)
    by = math.radians(at.east_m_per_rad), math.radians(at.north_m_per_rad)

    def placed(places: Array) -> Array:
        east = numpy.remainder(places[:, 0] - longitude + 180.0, 360.0) - 180.0
        return numpy.column_stack((east * by[0], (places[:, 1] - latitude) * by[1]))

    return shapely.transform(shapely.force_2d(shape), placed)


def degrees(shape: BaseGeometry, at: Origin) -> Any:
    """A shape of the plane in degrees."""
    latitude, longitude = math.degrees(at.latitude_rad), math.degrees(at.longitude_rad)
    by = math.radians(at.east_m_per_rad), math.radians(at.north_m_per_rad)

    def placed(places: Array) -> Array:
        return numpy.column_stack((places[:, 0] / by[0] + longitude, places[:, 1] / by[1] + latitude))

    return shapely.transform(shape, placed)
