"""The position of a chart's pixels: from a world file, control points, or the tags of a GeoTIFF.

chart.png  chart.pgw     a world file (six lines); in degrees, or in the plane that chart.toml names: epsg = 32629
chart.png  chart.toml    two or more control points: [[point]] column, row, latitude_deg, longitude_deg
chart.tif                GeoTIFF
"""

import math
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

import msgspec
from PIL import Image, UnidentifiedImageError

from delfim.base import tables
from delfim.base.errors import ConfigError, DelfimError
from delfim.base.geodesy import origin
from delfim.base.input.untrusted import read_text
from delfim.base.projection import GEOGRAPHIC, plane

WORLD_FILES: Final = {".png": ".pgw", ".jpg": ".jgw", ".jpeg": ".jgw", ".tif": ".tfw", ".tiff": ".tfw"}
MISPLACED: Final = 0.05  # of the points' spread: a control point farther from where the others put it is a slip of the hand
_SCALE, _TIES, _MATRIX, _KEYS = 33550, 33922, 34264, 34735  # TIFF tags (OGC 19-008r4)
_RASTER_TYPE, _GEOGRAPHIC_KEY, _PROJECTED_KEY = 1025, 2048, 3072
_USER_DEFINED: Final = 32767

Matrix = tuple[float, float, float, float, float, float]  # x = a column + b row + c; y = d column + e row + f; of pixel corners


class Point(tables.Table, frozen=True):
    """A place that is known in the image and on the map. Column 0, row 0 is the upper left corner."""

    column: float
    row: float
    latitude_deg: Annotated[float, msgspec.Meta(ge=-89.0, le=89.0)]
    longitude_deg: Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)]


class Beside(tables.Table, frozen=True):
    """The file beside an image."""

    epsg: int = GEOGRAPHIC  # the plane of the world file
    point: tuple[Point, ...] = ()


class Placed(NamedTuple):
    """An image on the map."""

    size: tuple[int, int]
    epsg: int
    matrix: Matrix

    @property
    def upright(self) -> bool:
        """Whether its rows are parallels, evenly spaced: a browser can show it as it is."""
        a, b, _, d, e, _ = self.matrix
        return self.epsg == GEOGRAPHIC and b == d == 0.0 and a > 0.0 > e

    def degrees(self, column: float, row: float) -> tuple[float, float]:
        """(longitude_deg, latitude_deg) of a pixel's corner."""
        a, b, c, d, e, f = self.matrix
        return plane(self.epsg)[1](a * column + b * row + c, d * column + e * row + f)

    def pixel(self, longitude_deg: float, latitude_deg: float) -> tuple[float, float]:
        """The inverse."""
        a, b, c, d, e, f = self.matrix
        x, y = plane(self.epsg)[0](longitude_deg, latitude_deg)
        area = a * e - b * d
        return (e * (x - c) - b * (y - f)) / area, (a * (y - f) - d * (x - c)) / area

    def extent(self) -> tuple[float, float, float, float]:
        """West, south, east, north in degrees: the box around all of it."""
        width, height = self.size
        steps = [n / 16 for n in range(17)]
        edge = [(s * width, r) for s in steps for r in (0, height)] + [(c, s * height) for s in steps for c in (0, width)]
        longitudes, latitudes = zip(*(self.degrees(*each) for each in edge), strict=True)
        return min(longitudes), min(latitudes), max(longitudes), max(latitudes)


def placed(image: Path) -> Placed:
    """The position of an image. Raises ConfigError with the reason if there is none, or it is implausible."""
    size, tags = _header(image)
    beside = _beside(image)
    worlds = image.with_suffix(WORLD_FILES[image.suffix.lower()]), image.with_suffix(".wld")
    world = next((file for file in worlds if file.exists()), None)
    if beside.point:
        result = Placed(
            size, GEOGRAPHIC, _fit([(p.column, p.row, p.longitude_deg, p.latitude_deg) for p in beside.point], image)
        )
    elif world is not None:
        result = Placed(size, beside.epsg, _world(world))
    elif _KEYS in tags:
        result = Placed(size, *_geotiff(tags, image))
    else:
        raise ConfigError(
            str(image), "place", "nothing says where it lies", "a world file or control points beside it, or GeoTIFF"
        )
    return _sensible(result, image)


def _sensible(result: Placed, image: Path) -> Placed:
    a, b, _, d, e, _ = result.matrix
    try:
        if not all(map(math.isfinite, result.matrix)) or abs(a * e - b * d) < 1e-18:
            raise ValueError("its pixels have no area")
        west, south, east, north = result.extent()
        if not (-180.0 <= west < east <= 180.0 and -85.1 <= south < north <= 85.1):
            raise ValueError(
                f"it would reach from {west:.6g}, {south:.6g} to {east:.6g}, {north:.6g}; is its plane (epsg) given?"
            )
    except (DelfimError, ValueError, OverflowError) as error:
        raise ConfigError(str(image), "place", str(error)) from None
    return result


def _header(image: Path) -> tuple[tuple[int, int], dict[int, Any]]:
    """Size and TIFF tags; the pixels are not read."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with Image.open(image) as opened:
                return opened.size, dict(getattr(opened, "tag_v2", {}))
    except (Image.DecompressionBombWarning, Image.DecompressionBombError):
        raise ConfigError(str(image), "size", "too many pixels", f"up to {Image.MAX_IMAGE_PIXELS}, or MBTiles") from None
    except (OSError, ValueError, SyntaxError, Warning, UnidentifiedImageError) as error:
        raise ConfigError(str(image), "file", f"no image: {error}") from None


def _beside(image: Path) -> Beside:
    file = image.with_suffix(".toml")
    return tables.decode(tables.read_toml(file), Beside, str(file)) if file.exists() else Beside()


def _world(file: Path) -> Matrix:
    """Its six numbers are a, d, b, e and the centre of the upper left pixel."""
    try:
        a, d, b, e, x, y = (float(word.replace(",", ".")) for word in read_text(file).split())
    except (OSError, ValueError) as error:
        raise ConfigError(str(file), "file", f"no world file: {error}", "six numbers") from None
    return a, b, x - (a + b) / 2.0, d, e, y - (d + e) / 2.0


def _geotiff(tags: dict[int, Any], image: Path) -> tuple[int, Matrix]:
    words = list(tags[_KEYS])
    keys = {words[n]: words[n + 3] for n in range(4, len(words) - 3, 4) if words[n + 1] == 0}
    epsg = keys.get(_PROJECTED_KEY) or keys.get(_GEOGRAPHIC_KEY, GEOGRAPHIC)
    if epsg == _USER_DEFINED:
        raise ConfigError(
            str(image), "place", "a plane of its own, without an EPSG number", "a world file in degrees beside it"
        )
    ties, scale = list(tags.get(_TIES, ())), list(tags.get(_SCALE, ()))
    if len(tags.get(_MATRIX, ())) == 16:
        a, b, _, c, d, e, _, f = tags[_MATRIX][:8]
    elif len(scale) >= 2 and len(ties) >= 6:
        column, row, _, x, y, _ = ties[:6]
        a, b, d, e = scale[0], 0.0, 0.0, -scale[1]
        c, f = x - column * a, y - row * e
    elif len(ties) >= 18:
        a, b, c, d, e, f = _fit([(ties[n], ties[n + 1], ties[n + 3], ties[n + 4]) for n in range(0, len(ties) - 5, 6)], image)
    else:
        raise ConfigError(str(image), "place", "a GeoTIFF without scale, tie points or matrix")
    half = 0.5 if keys.get(_RASTER_TYPE) == 2 else 0.0  # its numbers are of pixel centres
    return epsg, (a, b, c - half * (a + b), d, e, f - half * (d + e))


def _fit(points: Sequence[tuple[float, float, float, float]], image: Path) -> Matrix:
    """The matrix by control points (column, row, x, y): two give place, size and rotation, more also shear (least squares)."""
    if len(points) < 2:
        raise ConfigError(str(image), "point", "a single control point", "two or more")
    mean = [sum(values) / len(points) for values in zip(*points, strict=True)]
    off = [tuple(value - middle for value, middle in zip(point, mean, strict=True)) for point in points]
    if len(points) == 2:
        off += [_square(off[1], mean[3])]
    cc, rr, cr = (sum(p[i] * p[j] for p in off) for i, j in ((0, 0), (1, 1), (0, 1)))
    area = cc * rr - cr * cr
    if area <= 1e-9 * max(cc, rr) ** 2:
        raise ConfigError(str(image), "point", "the control points lie on one line")
    rows = []
    for axis in (2, 3):
        ca, ra = (sum(p[i] * p[axis] for p in off) for i in (0, 1))
        rows.append(((rr * ca - cr * ra) / area, (cc * ra - cr * ca) / area))
    (a, b), (d, e) = rows
    spread = max(math.hypot(p[2], p[3]) for p in off)
    errors = [math.hypot(a * p[0] + b * p[1] - p[2], d * p[0] + e * p[1] - p[3]) for p in off]
    if max(errors) > MISPLACED * spread:
        worst = errors.index(max(errors))
        raise ConfigError(str(image), f"point[{worst}]", "lies elsewhere than the other control points say")
    return a, b, mean[2] - a * mean[0] - b * mean[1], d, e, mean[3] - d * mean[0] - e * mean[1]


def _square(point: tuple[float, ...], latitude_deg: float) -> tuple[float, ...]:
    """A third point beside the middle of two, at right angles to them on the image and on the water."""
    column, row, longitude_deg, latitude_off_deg = point
    at = origin(math.radians(latitude_deg), 0.0)
    stretch = at.east_m_per_rad / at.north_m_per_rad
    return -row, column, latitude_off_deg / stretch, -longitude_deg * stretch
