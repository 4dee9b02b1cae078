"""Whether a boat would take a plan of the page, found out without the boat: by the same code, and the values of its file."""

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import msgspec

from delfim import config
from delfim.base import geodesy
from delfim.base.cooperative import Work
from delfim.base.errors import Refused
from delfim.console.plans.plan import checked_tables
from delfim.vehicle.helm.planning import laid
from delfim.vehicle.plans import clearance, clearancefile
from delfim.vehicle.plans.estimate import in_hours, mission_s

NO_FILE: Final = "checked with the usual limits, because no boat's file was given (--vehicle FILE)"


LOOKS: Final = 50  # at a chart in one slice
STEP_M: Final = 1.0  # between two looks along a way, at least


class Crossed(Refused):
    """A plan leads through water that the boat's chart forbids, first at this place, degrees."""

    def __init__(self, words: str, place: tuple[float, float]) -> None:
        super().__init__(words)
        self.place = place


def chart_of(vehicle: config.Vehicle, folder: Path | None) -> tuple[Path, clearance.Chart] | None:
    """The chart aboard of a boat's file, and its place on this computer: where the file says, or by its name in the folder of
    charts. None: the boat has none, or it is not here. Raises ConfigError where it is not whole."""
    named = Path(vehicle.fence.chart)
    for file in (named, *((folder / named.name,) if folder is not None else ())) if vehicle.fence.chart else ():
        if file.is_file():
            there = msgspec.structs.replace(vehicle.fence, chart=str(file))
            chart = clearancefile.load(msgspec.structs.replace(vehicle, fence=there))
            return (file.resolve(), chart) if chart is not None else None
    return None


def verdict(
    plan: Mapping[str, Any],
    place: tuple[float, float] | None,
    vehicle: config.Vehicle | None,
    charts: Iterable[dict[str, Any]],
    chart: clearance.Chart | None = None,
) -> Work[str]:
    """Remarks on a plan that the boat would take; the first is how long it takes by its length. `place` is the boat's, degrees,
    if it is known; otherwise the boat is taken to be at the first waypoint. `chart`: the boat's. Raises ConfigError, Refused
    with the reason why the boat would not take it, Crossed where the chart is that."""
    mission = checked_tables(plan)
    first = mission.waypoint[0]
    at = place or (first.latitude_deg, first.longitude_deg)
    origin = geodesy.origin(math.radians(at[0]), math.radians(at[1]))
    control, fence = (vehicle.control, vehicle.fence) if vehicle is not None else (config.ControlTable(), config.FenceTable())
    places = [(each.latitude_deg, each.longitude_deg) for each in mission.waypoint]
    try:
        yield from laid(mission, origin, control, fence, chart=chart)
    except Refused as refused:
        water = chart.water(mission.opens) if chart is not None else None
        if water is None or water.name not in str(refused):
            raise
        where = yield from _crossed(places, origin, clearance.laid(water, origin), fence.mission_margin_m)
        raise Crossed(str(refused), where) if where is not None else refused from None
    time_s = mission_s(mission, control.speed.cruise_mps)
    remarks = [f"about {in_hours(time_s)}" if len(places) > 1 else ""]
    remarks += [_uncharted(places, [each["extent"] for each in charts]), "" if vehicle is not None else NO_FILE]
    if fence.chart and chart is None:
        remarks.append(f"checked without the boat's chart: {Path(fence.chart).name} is not among the charts of this computer")
    return "; ".join(filter(None, remarks))


def _crossed(
    places: Sequence[tuple[float, float]], origin: geodesy.Origin, field: clearance.ClearanceField, margin_m: float
) -> Work[tuple[float, float] | None]:
    """The first place of the legs that is nearer to no-go water than missions may be, degrees."""
    flat = [geodesy.to_plane(origin, math.radians(north), math.radians(east)) for north, east in places]
    for a, b in pairwise([flat[0], *flat]):
        length_m, far_m, looks = math.dist(a, b), 0.0, 0
        while far_m <= length_m:
            part = far_m / length_m if length_m else 0.0
            here = a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1])
            spare_m = field.clear_m(*here) - margin_m
            if spare_m < 0.0:
                latitude_rad, longitude_rad = geodesy.from_plane(origin, *here)
                return math.degrees(latitude_rad), math.degrees(longitude_rad)
            far_m, looks = far_m + max(spare_m, STEP_M), looks + 1
            if looks % LOOKS == 0:
                yield 2 * LOOKS
        yield LOOKS
    return None


def _uncharted(places: Sequence[tuple[float, float]], extents: Sequence[Sequence[float]]) -> str:
    """Which waypoints lie on no chart. Extents are west, south, east, north. Nothing where there are no charts."""

    def is_on(place: tuple[float, float], extent: Sequence[float]) -> bool:
        west, south, east, north = extent
        return south <= place[0] <= north and west <= place[1] <= east

    missing = [number for number, place in enumerate(places, 1) if not any(is_on(place, extent) for extent in extents)]
    if not extents or not missing:
        return ""
    more = f" and {len(missing) - 5} more" if len(missing) > 6 else ""
    shown = ", ".join(map(str, missing[:5] if more else missing))
    return f"on no chart: waypoint{'s' if len(missing) > 1 else ''} {shown}{more}"
