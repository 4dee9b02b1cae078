"""The way home as a boat would sail it now, for its console: arrays that follow HOME_POSITION, which is its end."""

import math
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

WITHIN_M: Final = 2.0  # what is told is as near to the way
ARRAY_POINTS: Final = 28
ARRAYS: Final = 6  # at most: 1.6 kB
MOST: Final = ARRAYS * ARRAY_POINTS

Point = tuple[float, float]


class WayArray(NamedTuple):
    """What one array says. `arrays`: how many there are; 0: the boat knows no way now."""

    arrays: int
    speed_mps: float
    points: list[Point]  # degrees beyond the end, north and east; the end itself first


def thinned(points: Sequence[Point], within_m: float = WITHIN_M, most: int = MOST) -> list[Point]:
    """The points of a way, metres, that matter: all others are as near as `within_m` to the straight ways between those, or
    twice that, and so on, where more than `most` are left."""
    kept = _sleeves(points, within_m)
    return kept if len(kept) <= most else thinned(kept, 2.0 * within_m, most)


def _sleeves(points: Sequence[Point], within_m: float) -> list[Point]:
    """One pass over the points (sleeve fitting, Zhao and Saalfeld 1997)."""
    kept, last = [points[0]], points[0]
    far_m, straight, low, high = 0.0, 0.0, -math.pi, math.pi
    for point in points[1:]:
        away_m, turn = _seen(kept[-1], point)
        aside = math.remainder(turn - straight, math.tau)
        if far_m and (away_m < far_m or not low <= aside <= high):
            kept.append(last)
            away_m, turn = _seen(last, point)
            far_m, low, high = 0.0, -math.pi, math.pi
        if far_m == 0.0:
            straight = turn
        aside = math.remainder(turn - straight, math.tau)
        half = math.asin(within_m / away_m) if away_m > within_m else math.pi
        low, high = max(low, aside - half), min(high, aside + half)
        far_m, last = away_m, point
    return kept if len(points) == 1 else [*kept, points[-1]]


def _seen(a: Point, b: Point) -> tuple[float, float]:
    """How far it is from one to the other, m, and the direction."""
    north_m, east_m = b[0] - a[0], b[1] - a[1]
    return math.hypot(north_m, east_m), math.atan2(east_m, north_m)


def arrays(points: Sequence[Point], speed_mps: float) -> Iterator[list[float]]:
    """The numbers of each array, for points in degrees beyond the end. No point: no way is known."""
    count = -(-len(points) // ARRAY_POINTS)
    if not points:
        yield [0.0, speed_mps]
    for at in range(0, len(points), ARRAY_POINTS):
        part = points[at : at + ARRAY_POINTS]
        yield [
            float(count),
            speed_mps,
            *(angle for point in part for angle in point),
            *(math.nan,) * 2 * (ARRAY_POINTS - len(part)),
        ]


def read(numbers: Sequence[float]) -> WayArray | None:
    """What an array says; None: nothing that makes sense."""
    count, speed_mps, *angles = numbers
    if count not in range(ARRAYS + 1) or not 0.0 <= speed_mps < 1000.0:
        return None
    pairs = zip(angles[::2], angles[1::2], strict=True)
    points = [(north, east) for north, east in pairs if abs(north) <= 90.0 and abs(east) <= 180.0]
    return WayArray(int(count), speed_mps, points if count else [])
