"""The way home of a boat, before it is ordered: its track as it was heard here, cut as the boat cuts its own, back to the place
where the boat says that its way home ends.
"""

import math
from typing import Any, Final

from delfim.base.geodesy import Origin, from_plane, origin, to_plane
from delfim.config import HomeTable
from delfim.vehicle.plans.track import Track

NEAR_M: Final = 10.0  # the track was heard from its beginning if it passes the end of the way home as near as this


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
