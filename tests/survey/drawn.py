"""Areas from a seed: coasts, rivers, harbours with piers, several parts, half of them with holes."""

import math
from collections.abc import Callable
from random import Random
from typing import Final

from shapely import affinity
from shapely.geometry import LineString, MultiPolygon, Point, Polygon, box
from shapely.geometry.base import BaseGeometry

from delfim.base.geodesy import origin
from delfim.survey.ground import Ground, polygons, union

AT: Final = origin(math.radians(38.69), math.radians(-9.21))


def drawn(seed: int, far_m: tuple[float, float] = (100.0, 500.0), with_holes: float = 0.5) -> tuple[Ground, float]:
    """An area of this size, such a part of them with holes, and a spacing."""
    draw = Random(f"survey area {seed}")
    return _drawn(draw, seed, draw.uniform(*far_m), with_holes)


def _drawn(draw: Random, seed: int, far_m: float, with_holes: float) -> tuple[Ground, float]:
    shape = affinity.rotate(SHAPES[seed % len(SHAPES)](draw, far_m), draw.uniform(0.0, 360.0), origin=(0.0, 0.0))
    cut = _holes(draw, shape, far_m) if draw.random() < with_holes else []
    holes = union([part for part in cut if part.intersects(shape)])
    parts = [part for part in polygons(shape.difference(holes)) if part.area > 200.0]
    return Ground(AT, MultiPolygon(parts), holes), draw.choice((5.0, 10.0, 15.0, 20.0))


def _holes(draw: Random, shape: BaseGeometry, far_m: float) -> list[Polygon]:
    west, south, east, north = shape.bounds
    found = list[Polygon]()
    for _ in range(draw.randint(1, 4)):
        at, wide_m = Point(draw.uniform(west, east), draw.uniform(south, north)), draw.uniform(0.03, 0.12) * far_m
        thin = affinity.scale(at.buffer(wide_m, 5), 1.0, draw.choice((0.3, 1.0)))
        found.append(affinity.rotate(thin, draw.uniform(0.0, 180.0)))
    return found


def _coast(draw: Random, far_m: float) -> BaseGeometry:
    count = draw.randint(7, 25)
    far = [far_m / 2.0 * draw.uniform(0.4, 1.0) for _ in range(count)]
    turns = [math.tau * step / count for step in range(count)]
    return Polygon([(r * math.cos(turn), 0.75 * r * math.sin(turn)) for r, turn in zip(far, turns, strict=True)])


def _bay(draw: Random, far_m: float) -> BaseGeometry:
    return Polygon([(draw.gauss(0.0, far_m / 3.0), draw.gauss(0.0, far_m / 4.0)) for _ in range(12)]).convex_hull


def _basins(draw: Random, far_m: float) -> BaseGeometry:
    corners = [(draw.uniform(0.0, 0.4) * far_m, draw.uniform(0.0, 0.4) * far_m) for _ in range(3)]
    return union([box(x, y, x + draw.uniform(0.3, 0.7) * far_m, y + draw.uniform(0.2, 0.5) * far_m) for x, y in corners])


def _river(draw: Random, far_m: float) -> BaseGeometry:
    x, y, to_rad, places = 0.0, 0.0, draw.uniform(0.0, math.tau), [(0.0, 0.0)]
    for _ in range(draw.randint(4, 8)):
        to_rad += draw.uniform(-0.9, 0.9)
        x, y = x + 0.3 * far_m * math.cos(to_rad), y + 0.3 * far_m * math.sin(to_rad)
        places.append((x, y))
    return LineString(places).buffer(draw.uniform(0.06, 0.14) * far_m, 4)


def _harbour(draw: Random, far_m: float) -> BaseGeometry:
    piers = [box(at * far_m, -1.0, (at + 0.05) * far_m, draw.uniform(0.2, 0.45) * far_m) for at in (0.2, 0.4, 0.6, 0.8)]
    return box(0.0, 0.0, far_m, 0.6 * far_m).difference(union([pier for pier in piers if draw.random() < 0.75]))


def _two(draw: Random, far_m: float) -> BaseGeometry:
    return union([*polygons(_bay(draw, 0.6 * far_m)), *polygons(affinity.translate(_coast(draw, 0.6 * far_m), 0.8 * far_m))])


SHAPES: Final[tuple[Callable[[Random, float], BaseGeometry], ...]] = (_coast, _bay, _basins, _river, _harbour, _two)
