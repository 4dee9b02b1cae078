"""Whether a boat would take a plan of the page, found out without the boat: by the same code, and the values of its file."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from delfim import config
from delfim.base import geodesy
from delfim.base.cooperative import Work
from delfim.console.plans.plan import checked_tables
from delfim.vehicle.helm.planning import laid
from delfim.vehicle.plans.estimate import in_hours, mission_s

NO_FILE: Final = "checked with the usual limits, because no boat's file was given (--vehicle FILE)"


def verdict(
    plan: Mapping[str, Any], place: tuple[float, float] | None, vehicle: config.Vehicle | None, charts: Iterable[dict[str, Any]]
) -> Work[str]:
    """Remarks on a plan that the boat would take; the first is how long it takes by its length. `place` is the boat's, degrees,
    if it is known; otherwise the boat is taken to be at the first waypoint. Raises ConfigError, Refused with the reason why the
    boat would not take it."""
    mission = checked_tables(plan)
    first = mission.waypoint[0]
    at = place or (first.latitude_deg, first.longitude_deg)
    origin = geodesy.origin(math.radians(at[0]), math.radians(at[1]))
    control, fence = (vehicle.control, vehicle.fence) if vehicle is not None else (config.ControlTable(), config.FenceTable())
    yield from laid(mission, origin, control, fence)
    places = [(each.latitude_deg, each.longitude_deg) for each in mission.waypoint]
    time_s = mission_s(mission, control.speed.cruise_mps)
    remarks = [f"about {in_hours(time_s)}" if len(places) > 1 else ""]
    remarks += [_uncharted(places, [each["extent"] for each in charts]), "" if vehicle is not None else NO_FILE]
    return "; ".join(filter(None, remarks))


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
