"""The dangers of charts as GeoJSON: what is forbidden about a place, and why.

The no-go water is a union, on a grid and verified part by part (delfim/survey/ground.py); each danger stands beside it with its
reason, for whoever taps on it.
"""

import json
from collections.abc import Sequence
from typing import Any, Final

import numpy
import shapely
from numpy.typing import NDArray
from shapely.geometry import MultiPolygon, Polygon, box, mapping
from shapely.geometry.base import BaseGeometry

from delfim.base.geodesy import Origin
from delfim.survey.enc.clearing import Growing, half_m
from delfim.survey.enc.dangers import Charted
from delfim.survey.enc.plane import degrees, flat
from delfim.survey.ground import polygons, union

ARC: Final = 8  # corners of a quarter circle
DIGITS: Final = 6  # of degrees: a decimetre
NOT_FOR: Final = "not for navigation"


def no_go(dangers: Sequence[Growing], reach_m: float) -> MultiPolygon:
    """All dangers grown by their margins, in a square about the middle. Raises DelfimError where one would be lost."""
    window, parts = box(-reach_m, -reach_m, reach_m, reach_m), list[Polygon]()
    for margin_m, shapes in dangers:
        for shape in shapes:
            sound = shape if shape.is_valid else shapely.make_valid(shape)
            parts += polygons(_outwards(sound, margin_m).intersection(window))
    return union(parts)


def _outwards(shape: BaseGeometry, margin_m: float) -> BaseGeometry:
    """Grown so that the chords of its arcs stay outside of the margin, too."""
    return shape.buffer(margin_m / numpy.cos(numpy.pi / (4 * ARC)), ARC)


def geojson(chart: Charted, at: Origin, forbidden: MultiPolygon) -> str:
    """Its text: the no-go water, the areas of depth, and the dangers, each within the window."""
    reach_m = half_m()
    window = box(-reach_m, -reach_m, reach_m, reach_m)
    rows = [_feature(degrees(forbidden, at), kind="no-go", why=f"no-go water: {', '.join(chart.names)}")]
    rows += [
        _feature(degrees(shape, at), kind="depth", least_m=depth.least_m, most_m=depth.most_m)
        for depth in chart.depths
        if not (shape := shapely.make_valid(flat(depth.shape, at)).intersection(window)).is_empty
    ]
    for danger in chart.dangers:
        if (shape := flat(danger.shape, at)).intersects(window):
            within = shapely.make_valid(shape).intersection(window)
            told = {"band": danger.band} if danger.band else {}
            rows.append(_feature(degrees(within, at), kind="danger", why=danger.why, margin_m=danger.margin_m, **told))
    head = {"type": "FeatureCollection", "delfim": {"charts": chart.names, **chart.need._asdict(), "note": NOT_FOR}}
    return json.dumps(head | {"features": rows}, separators=(",", ":"), allow_nan=False)


def _feature(shape: BaseGeometry, **told: Any) -> dict[str, Any]:
    def rounded(places: NDArray[numpy.float64]) -> NDArray[numpy.float64]:
        return numpy.round(places, DIGITS)

    return {"type": "Feature", "properties": told, "geometry": mapping(shapely.transform(shape, rounded))}
