"""A picture of what is forbidden about a place, and why."""

from pathlib import Path

import numpy
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from shapely.geometry import MultiPolygon
from shapely.geometry.base import BaseGeometry

from delfim.base.geodesy import Origin
from delfim.survey.enc.clearing import half_m
from delfim.survey.enc.dangers import Charted, Need
from delfim.survey.enc.nogo import NOT_FOR
from delfim.survey.enc.plane import flat
from delfim.survey.ground import polygons

WATER, DRY, SHALLOW, NO_GO, INK = "#cfe4f2", "#e9dcb5", "#a9cbe3", "#c8323c", "#1b2a33"


def draw(chart: Charted, at: Origin, forbidden: MultiPolygon, file: Path) -> None:
    """Draw the window, north up, kilometres: no-go water in red above land and depths."""
    figure = Figure(figsize=(9, 9), dpi=120, layout="tight")
    axes = figure.subplots()
    reach = half_m() / 1000.0
    axes.set(
        aspect="equal", xlim=(-reach, reach), ylim=(-reach, reach), facecolor="white", xlabel="east, km", ylabel="north, km"
    )
    axes.set_title(f"{', '.join(chart.names)}: {_for(chart.need)}\n{NOT_FOR}", color=INK, fontsize=10)
    _fill(axes, flat(chart.covered, at), WATER)
    for danger in chart.dangers:
        if danger.band:
            _fill(axes, flat(danger.shape, at), SHALLOW)
    _fill(axes, forbidden, NO_GO, alpha=0.35, edge=NO_GO)
    for danger in chart.dangers:
        if danger.kind == "land":
            _fill(axes, flat(danger.shape, at), DRY, edge=INK)
    points = [flat(danger.shape, at) for danger in chart.dangers if danger.shape.geom_type == "Point"]
    axes.plot([each.x / 1000.0 for each in points], [each.y / 1000.0 for each in points], "+", color=INK, ms=4, mew=0.6)
    figure.savefig(file)


def _for(need: Need) -> str:
    return f"no-go for a draught of {need.draught_m:g} m, {need.under_keel_m:g} m under the keel, tide {need.tide_m:g} m"


def _fill(axes: Axes, shape: BaseGeometry, colour: str, alpha: float = 1.0, edge: str = "none") -> None:
    for part in polygons(shape):
        rings = [Outline(numpy.asarray(ring.coords)[:, :2] / 1000.0, closed=True) for ring in (part.exterior, *part.interiors)]
        axes.add_patch(PathPatch(Outline.make_compound_path(*rings), facecolor=colour, edgecolor=edge, lw=0.5, alpha=alpha))
