"""What a sensor sees about the boat by its echoes alone, as things that stand (docs/traffic.md). Nobody tells what an echo is:
a swimmer is one of them.
"""

import math
from collections.abc import Iterable, Iterator
from operator import itemgetter
from typing import Final, NamedTuple

EVERY_S: Final = 0.25  # a sensor is heard so often; what comes between says the same
STALE_S: Final = 2.0  # distances are from the boat: an older place of the boat is none
APART_M: Final = 4.0  # what is nearer to another is taken for the same one
RADIUS_MIN_M, RADIUS_MAX_M = 0.3, 50.0
HALF_MOST_RAD: Final = math.radians(45.0)
CONFIDENCE: Final = 0.5  # so that what is seen for a moment turns nobody


class EchoPlace(NamedTuple):
    """What stands somewhere about the boat."""

    north_m: float  # of its middle from the boat
    east_m: float
    radius_m: float


def radius_m(far_m: float, half_rad: float) -> float:
    """How wide a thing is that fills a beam of this half width at this distance."""
    return min(max(far_m * math.tan(min(half_rad, HALF_MOST_RAD)), RADIUS_MIN_M), RADIUS_MAX_M)


def nearest(echoes: Iterable[tuple[float, float]], half_rad: float, most: int) -> Iterator[EchoPlace]:
    """The nearest of echoes (distance of the near edge in m, bearing in rad), so many at most."""
    told = list[tuple[float, float]]()
    for far_m, bearing_rad in sorted(echoes, key=itemgetter(0)):
        if len(told) == most:
            return
        wide_m = radius_m(far_m, half_rad)
        place = (far_m + wide_m) * math.cos(bearing_rad), (far_m + wide_m) * math.sin(bearing_rad)
        if all(math.dist(place, other) >= APART_M for other in told):
            told.append(place)
            yield EchoPlace(*place, wide_m)
