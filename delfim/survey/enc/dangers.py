"""What in a chart is dangerous for one boat, with the reason in words. Water is safe only where the chart says that it is deep
enough: an unknown depth is a danger, and so is water without a chart.

Classes and attributes: IHO S-57, edition 3.1, appendix A. Positions of what lies under water are as good as its zone of
confidence says (S-57 supplement: A1 5 m, A2 20 m, B 50 m, C 500 m); land and what is built is drawn, 0.25 mm of the chart.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from delfim.base.errors import FormatError
from delfim.survey.enc.reading import ChartObject, EncCell

DRAWN: Final = 0.25e-3  # m on the chart
LEAST_M: Final = 5.0  # of a margin
ZONES_M: Final = {1: 5.0, 2: 20.0, 3: 50.0, 4: 500.0}  # by CATZOC; D and unassessed: nobody knows
ZONES: Final = {1: "A1", 2: "A2", 3: "B", 4: "C", 5: "D"}
SUNK: Final = {"OBSTRN": "obstruction", "WRECKS": "wreck", "UWTROC": "rock", "WEDKLP": "weed", "PIPSOL": "pipe on the ground"}
STANDS: Final = {
    "LNDARE": "land",
    "COALNE": "coast line",
    "UNSARE": "water not surveyed",
    "PONTON": "pontoon",
    "HULKES": "hulk",
    "FLODOC": "floating dock",
    "DRYDOC": "dry dock",
    "LOGPON": "log pond",
    "DAMCON": "dam",
    "CAUSWY": "causeway",
    "DYKCON": "dyke",
    "FNCLNE": "fence",
    "GATCON": "gate",
    "SLCONS": "structure of the shore",
    "PILPNT": "pile",
    "MORFAC": "mooring",
    "OFSPLF": "platform",
    "FSHFAC": "fish stakes",
    "MARCUL": "fish farm",
    "PYLONS": "pylon",
    "CRANES": "crane",
    "LNDMRK": "landmark",
    "OILBAR": "oil barrier",
    "RAPIDS": "rapids",
    "WATFAL": "waterfall",
    "ICEARE": "ice",
    "LITFLT": "light float",
    "LITVES": "light vessel",
    **dict.fromkeys(("BCNCAR", "BCNISD", "BCNLAT", "BCNSAW", "BCNSPP"), "beacon"),
    **dict.fromkeys(("BOYCAR", "BOYINB", "BOYISD", "BOYLAT", "BOYSAW", "BOYSPP"), "buoy"),
}
OVER: Final = {"BRIDGE": "bridge", "CBLOHD": "overhead cable", "PIPOHD": "overhead pipe", "CONVYR": "conveyor"}
CLEAR: Final = ("VERCCL", "VERCSA", "VERCLR")  # the first that is known counts: closed, safe of a cable, fixed
CLOSED: Final = {"7": "entry prohibited", "8": "entry restricted", "14": "to be avoided"}  # RESTRN
AREAS: Final = {"1": "safety zone", "9": "military", "12": "safety zone of a mark", "14": "minefield"}  # CATREA
RESTRICTED: Final = ("RESARE", "MIPARE", "OSPARE", "SPLARE", "ACHARE")
LAYERS: Final = ("DEPARE", "DRGARE", "SOUNDG", "M_COVR", "M_QUAL", *SUNK, *STANDS, *OVER, *RESTRICTED)
LEVELS: Final = {  # WATLEV
    1: "partly above the water",
    2: "always dry",
    4: "that covers and uncovers",
    5: "awash",
    6: "that floods",
    7: "afloat",
}
DRY: Final = frozenset(LEVELS)  # whatever its depth says
DOUBTFUL: Final = frozenset("23489")  # QUASOU: unknown, doubtful, unreliable, reported and not surveyed, not confirmed


Values = dict[str, float | str | list[str]]
"""Attributes of an object that are known."""


class Need(NamedTuple):
    """What a boat needs of the water, m. The tide is the least above the chart's datum while she is out; over bridges' own
    datum nothing is taken for it that helps."""

    draught_m: float
    under_keel_m: float = 0.5
    air_draught_m: float = 3.0
    tide_m: float = 0.0
    margin_m: float = 50.0  # at most, whatever the zone of confidence says

    @property
    def depth_m(self) -> float:
        """Of charted water."""
        return self.draught_m + self.under_keel_m - self.tide_m


class ChartDanger(NamedTuple):
    """A danger, with its shape in degrees (x longitude, y latitude)."""

    kind: str  # "rock"
    what: str  # "rock awash"
    source: str  # "US5OH10M, edition 25, 1:40,000, zone of confidence B"
    shape: BaseGeometry
    margin_m: float
    band: str = ""  # "0-1.8 m" of an area of water that an operator may open
    asked_m: float = 0.0  # the margin that the zone of confidence asks for; infinite: it says of none that it is enough

    @property
    def why(self) -> str:
        return f"{self.what}, {self.source}"


class DepthArea(NamedTuple):
    """Water between two depths, m, where they are known; in degrees."""

    least_m: float | None
    most_m: float | None
    shape: BaseGeometry


class Charted(NamedTuple):
    """What cells say of the water for one boat."""

    need: Need
    dangers: list[ChartDanger]
    depths: list[DepthArea]
    covered: BaseGeometry  # by a cell, degrees
    names: tuple[str, ...]  # "US5OH10M edition 25"


def charted(cells: Sequence[EncCell], need: Need) -> Charted:
    """The dangers of all cells together: where two of them differ, the shoaler one counts. Raises FormatError."""
    found, depths, covered = list[ChartDanger](), list[DepthArea](), list[BaseGeometry]()
    for cell in cells:
        try:
            shapes = shapely.from_wkb([each.shape for each in cell.objects])
        except shapely.errors.GEOSException:
            raise FormatError(f"{cell.name}: an object has a shape that is not whole") from None
        covered += [shape for each, shape in zip(cell.objects, shapes, strict=True) if _covers(each)]
        depths += [
            DepthArea(_known(each.values.get("DRVAL1")), _known(each.values.get("DRVAL2")), shape)
            for each, shape in zip(cell.objects, shapes, strict=True)
            if each.layer in ("DEPARE", "DRGARE") and "Polygon" in shape.geom_type
        ]
        found += _dangers(cell, shapes, need)
    if not covered:
        raise FormatError(f"{cells[0].name}: it does not say which water it covers (M_COVR)")
    names = tuple(f"{cell.name} edition {cell.edition}" + (f".{cell.update}" if cell.update else "") for cell in cells)
    return Charted(need, found, depths, shapely.union_all(covered, grid_size=1e-8), names)


def _covers(each: ChartObject) -> bool:
    return each.layer == "M_COVR" and each.values.get("CATCOV") == 1.0


def _dangers(cell: EncCell, shapes: NDArray[numpy.object_], need: Need) -> Iterator[ChartDanger]:
    quality = [
        (shape, int(float(str(each.values.get("CATZOC", 6)))))
        for each, shape in zip(cell.objects, shapes, strict=True)
        if each.layer == "M_QUAL"
    ]
    tree, drawn_m = shapely.STRtree([shape for shape, _ in quality]), max(LEAST_M, DRAWN * cell.scale)
    bands = _bands(cell, shapes)
    water = shapely.STRtree([shape for shape, _, _ in bands])
    edition = f"edition {cell.edition}" + (f", update {cell.update}" if cell.update else "")
    for each, shape in zip(cell.objects, shapes, strict=True):
        for kind, more, where, is_under, band in _found(each, shape, need):
            source = f"{cell.name}, {edition}, 1:{cell.scale:,}"
            zone = max((quality[at][1] for at in tree.query(where, predicate="intersects")), default=6)
            source += f", zone of confidence {ZONES.get(zone, 'not assessed')}"
            margin_m = max(drawn_m, ZONES_M.get(zone, math.inf)) if is_under else drawn_m
            if each.layer == "SOUNDG":  # one that a band tells of is opened with it
                lies = (bands[at] for at in water.query(where, predicate="intersects"))
                band = next((name for _, least, name in lies if where.z >= least), "")
            yield ChartDanger(kind, f"{kind}{more}", source, where, min(margin_m, need.margin_m), band, margin_m)


def _bands(cell: EncCell, shapes: NDArray[numpy.object_]) -> list[tuple[BaseGeometry, float, str]]:
    """The areas of water whose depth has a name, and their least depth."""
    found = list[tuple[BaseGeometry, float, str]]()
    for each, shape in zip(cell.objects, shapes, strict=True):
        least = _number(each.values.get("DRVAL1"))
        if each.layer in ("DEPARE", "DRGARE") and (name := _band(least, _number(each.values.get("DRVAL2")))):
            found.append((shape, least, name))
    return found


def _found(each: ChartObject, shape: BaseGeometry, need: Need) -> Iterator[tuple[str, str, BaseGeometry, bool, str]]:
    """What is dangerous in an object: its kind, more of it in words, where, whether it lies under water, its band."""
    layer, values = each.layer, each.values
    if layer in ("DEPARE", "DRGARE"):
        least, most = _number(values.get("DRVAL1")), _number(values.get("DRVAL2"))
        if "Polygon" in shape.geom_type and not least >= need.depth_m:
            kind = "dredged area" if layer == "DRGARE" else "shallow water"
            yield kind, _shallow(least, most, need), shape, True, _band(least, most)
    elif layer == "SOUNDG":
        for point in getattr(shape, "geoms", [shape]):
            if not point.z >= need.depth_m:
                yield "sounding", f" of {point.z:.1f} m", point, True, ""
    elif layer in SUNK:
        depth = _depth(values)
        if not depth >= need.depth_m:
            yield SUNK[layer], _level(values, depth), shape, True, ""
    elif layer in STANDS:
        if layer != "SLCONS" or values.get("WATLEV") != 3.0 or not _depth(values) >= need.depth_m:
            yield STANDS[layer], _name(values), shape, False, ""
    elif layer in OVER:
        clear = next((float(str(values[key])) for key in CLEAR if key in values), math.nan)
        if not clear - max(need.tide_m, 0.0) >= need.air_draught_m:
            height = "of unknown clearance" if math.isnan(clear) else f"{clear:.1f} m above the water"
            yield OVER[layer], f"{_name(values)} {height}", shape, False, ""
    elif layer in RESTRICTED and (why := _restriction(values)):
        yield "restricted area", f"{_name(values)}: {why}", shape, False, ""


def _name(values: Values) -> str:
    return f" {values['OBJNAM']}" if "OBJNAM" in values else ""


def _known(value: object) -> float | None:
    return value if isinstance(value, float) else None


def _number(value: object) -> float:
    return value if isinstance(value, float) else math.nan


def _depth(values: Values) -> float:
    """The least depth over an object; NaN: not known, or not to be relied on."""
    quality = values.get("QUASOU", [])
    doubts = set(quality if isinstance(quality, list) else str(quality).split(",")) & DOUBTFUL
    return math.nan if doubts or values.get("WATLEV") in DRY else _number(values.get("VALSOU"))


def _shallow(least: float, most: float, need: Need) -> str:
    if math.isnan(least):
        return " of unknown depth"
    if least < 0.0:
        return f" that dries {-least:.1f} m"
    return f" of {_band(least, most) or f'{least:g} m'}, {need.depth_m:g} m needed"


def _band(least: float, most: float) -> str:
    """The name of a band that can be opened: none where a depth is not known or water dries."""
    return f"{least:g}-{most:g} m" if 0.0 <= least < most else ""


def _level(values: Values, depth: float) -> str:
    level = values.get("WATLEV")
    if isinstance(level, float) and int(level) in LEVELS:
        return f" {LEVELS[int(level)]}"
    return " of unknown depth" if math.isnan(depth) else f" {depth:.1f} m deep"


def _restriction(values: Values) -> str:
    """Why an area is closed, in words; "": it is not."""
    told, kind = values.get("RESTRN", []), values.get("CATREA", [])
    why = [CLOSED[each] for each in (told if isinstance(told, list) else str(told).split(",")) if each in CLOSED]
    why += [AREAS[each] for each in (kind if isinstance(kind, list) else [str(kind)]) if each in AREAS]
    return ", ".join(why)
