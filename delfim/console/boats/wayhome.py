"""The way home of a boat, before it is ordered: as the boat tells it, round what its chart forbids. Until it does, its track as
it was heard here, cut as the boat cuts its own, back to the place where the boat says that its way home ends.
"""

import math
from collections.abc import Sequence
from typing import Any, Final

from delfim.base.geodesy import Origin, from_plane, origin, to_plane
from delfim.config import HomeTable
from delfim.console.link.mavlink import wayhome
from delfim.vehicle.plans.track import Track

NEAR_M: Final = 10.0  # the track was heard from its beginning if it passes the end of the way home as near as this


class ToldWay:
    """The way home as the boat tells it in arrays, and its end, degrees."""

    def __init__(self, latitude_deg: float, longitude_deg: float) -> None:
        self._end = latitude_deg, longitude_deg
        self._parts = dict[int, wayhome.WayArray]()

    def hear(self, number: int, numbers: Sequence[float]) -> dict[str, Any] | None:
        """Takes an array. Returns the way for the page once all are there; without points while the boat knows none."""
        part = wayhome.read(numbers)
        if part is None or number >= wayhome.ARRAYS:
            return None
        self._parts[number] = part
        if any(each not in self._parts for each in range(part.arrays)):
            return None
        points = (point for each in range(part.arrays) for point in self._parts[each].points)
        north, east = self._end
        told = [[round(north + point[0], 7), round(east + point[1], 7)] for point in points]
        return {"points": told, "whole": True, "speed_mps": part.speed_mps}


class HeardTrack:
    """Points of one boat's track, as many as a boat keeps."""

    def __init__(self) -> None:
        self._track = Track(HomeTable())
        self._at: Origin | None = None

    def add(self, latitude_deg: float, longitude_deg: float) -> None:
        """The boat's present place."""
        place = math.radians(latitude_deg), math.radians(longitude_deg)
        self._at = self._at or origin(*place)
        self._track.add(*to_plane(self._at, *place))

    def way_home(self, latitude_deg: float, longitude_deg: float) -> dict[str, Any]:
        """The way to this end for the page, its end first; all that was heard, and not `whole`, where the track does not lead
        there."""
        points = self._track.points()
        if self._at is None or not points:
            return {"points": [], "whole": False}
        end = to_plane(self._at, math.radians(latitude_deg), math.radians(longitude_deg))
        nearest = min(range(len(points)), key=lambda number: math.dist(points[number], end))
        whole = math.dist(points[nearest], end) <= NEAR_M
        places = (from_plane(self._at, *point) for point in points[nearest if whole else 0 :])
        return {"points": [[round(math.degrees(each), 7) for each in place] for place in places], "whole": whole}
