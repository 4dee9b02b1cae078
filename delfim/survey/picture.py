"""A survey drawn: its area, the lines with their direction, and the ways between. PNG or SVG, as the file's name says."""

from pathlib import Path
from typing import Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from shapely.geometry import Polygon

from delfim.survey.ground import polygons
from delfim.survey.planning import SurveyPlan, drawn

LAND, AREA, LINE, WAY, CROSS, INK = "#e8b04a", "#d6e8f2", "#0a5fa8", "#8797a0", "#7b4fa3", "#1b2a33"
NUMBERED: Final = 60  # lines; of more, the first and the last have their numbers alone


def draw(plan: SurveyPlan, title: str, file: Path) -> None:
    """Draw it, north up, metres."""
    figure = Figure(figsize=(8, 8), dpi=120, layout="tight")
    axes = figure.subplots()
    axes.set_aspect("equal")
    axes.set_title(title, color=INK)
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    for part in polygons(plan.ground.area):
        _fill(axes, part, AREA)
    for hole in polygons(plan.ground.holes):
        _fill(axes, Polygon(hole.exterior), LAND)
    axes.plot(*zip(*drawn(plan), strict=True), color=WAY, lw=0.8, zorder=2)
    axes.plot(*plan.begin, "o", color=INK, ms=5, zorder=4)
    for number, (begin, end) in enumerate(plan.lines, 1):
        colour = LINE if number <= len(plan.lines) - plan.across else CROSS
        axes.annotate("", end, begin, arrowprops={"arrowstyle": "->", "color": colour, "lw": 1.4, "shrinkA": 0, "shrinkB": 0})
        if len(plan.lines) <= NUMBERED or number in (1, len(plan.lines)):
            axes.annotate(str(number), begin, (3, 3), textcoords="offset points", color=INK, fontsize=7)
    axes.autoscale_view()
    figure.savefig(file)


def _fill(axes: Axes, part: Polygon, colour: str) -> None:
    rings = [Outline([*ring.coords], closed=True) for ring in (part.exterior, *part.interiors)]
    axes.add_patch(PathPatch(Outline.make_compound_path(*rings), facecolor=colour, edgecolor=INK, lw=0.6, zorder=1))
