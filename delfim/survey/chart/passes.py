"""The straight passes of a boat over the bed, found in its soundings: where two cross their depths tell how good they are, and
two along one line, to and fro, tell how late the depths come.
"""

import math
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from delfim.base.errors import DelfimError
from delfim.survey.chart.reduction import Reduced
from delfim.survey.chart.soundings import Array

LOOK_M: Final = 4.0  # a course is that of so far behind to so far ahead
BENT_RAD: Final = math.radians(20.0)  # a pass ends where the course changes by more over twice that
PAUSE_S: Final = 10.0
LEAST_M: Final = 15.0  # of a pass
JUMP_M: Final = 20.0  # from one sounding to the next
PINGS: Final = 5
ASIDE_M: Final = 4.0  # a pass lies so close to a straight line
ANGLE_RAD: Final = math.radians(30.0)  # two passes cross at more
REACH_M: Final = 3.0  # soundings about a crossing, or ...
STEPS: Final = 2.5  # ... so many steps from ping to ping
AT_LEAST: Final = 3  # of each pass, about a crossing
MOST: Final = 20_000  # crossings
BESIDE_M: Final = 3.0  # two passes along one line lie so close
OPPOSITE: Final = -math.cos(math.radians(15.0))
PAIRS: Final = 200  # of passes to and fro at most
APART_S: Final = 0.05  # a latency more and less, for its slope
BIN_M, SMOOTH_M = 0.5, 2.0  # of the profiles of lines to and fro; the errors of their slopes would be taken for slopes
ALIKE: Final = 80  # bins of a profile: the boat is as far beside its line there, and on a slope its errors are alike
ALONG_M: Final = 50.0  # of a line, from one slope across to another one
TOO_FLAT_S: Final = 0.25
ORDERS: Final = {  # S-44 edition 6: depths are good to sqrt(a2 + (b depth)2), 95 %
    "exclusive": (0.15, 0.0075),
    "special": (0.25, 0.0075),
    "1a, 1b": (0.5, 0.013),
    "2": (1.0, 0.023),
}


class StraightPass(NamedTuple):
    """A straight pass: its soundings, by their numbers, and the line through their places."""

    numbers: NDArray[np.intp]  # (n,), in the order of time
    begin: tuple[float, float]  # east and north, m
    end: tuple[float, float]

    @property
    def long_m(self) -> float:
        return math.dist(self.begin, self.end)


class Crossing(NamedTuple):
    """Where two passes cross."""

    east_m: float
    north_m: float
    depth_m: float  # the mean of both
    off_m: float  # the later one less the earlier one
    scatter_m2: float  # variance of the soundings about it, along each pass


def passes(its: Reduced) -> list[StraightPass]:
    """The straight passes of the soundings that are believed, in the order of time."""
    numbers = np.flatnonzero(its.good)
    if len(numbers) < PINGS:
        return []
    east, north, at_s = its.east_m[numbers], its.north_m[numbers], its.at_s[numbers]
    by = _stride(east, north)
    smooth = [_mean(each, by) for each in (east, north)]
    behind, ahead = ([np.take(each, _clipped(len(each), off)) for each in smooth] for off in (-by, by))
    course = np.arctan2(ahead[0] - behind[0], ahead[1] - behind[1])
    turned = np.take(course, _clipped(len(course), by)) - np.take(course, _clipped(len(course), -by))
    turned = np.abs(np.remainder(turned + math.pi, math.tau) - math.pi)
    steps = np.hypot(*(np.diff(each, prepend=each[0]) for each in smooth))
    way = np.cumsum(steps)
    is_broken = (turned > BENT_RAD) | (np.abs(np.diff(at_s, prepend=at_s[0])) > PAUSE_S) | (steps > JUMP_M)
    edges = np.flatnonzero(np.diff(np.concatenate([[True], is_broken, [True]]).astype(np.int8)))
    found = list[StraightPass]()
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        if end - begin >= PINGS and way[end - 1] - way[begin] >= LEAST_M:
            found += _straight(numbers[begin:end], its)
    return found


def _stride(east: Array, north: Array) -> int:
    """So many soundings make LOOK_M of the way: between two, errors of the places may be larger than the way."""
    by = 1
    while 4 * by < len(east) and float(np.median(np.hypot(east[by:] - east[:-by], north[by:] - north[:-by]))) < LOOK_M:
        by = by + max(1, by // 4)
    return by


def _clipped(count: int, off: int) -> NDArray[np.intp]:
    return np.clip(np.arange(count) + off, 0, count - 1)


def _mean(values: Array, by: int) -> Array:
    """The mean of each with so many about it, from `by` / 2 before to `by` / 2 after."""
    half = by // 2
    total = np.cumsum(np.pad(values - values[0], (half + 1, half), mode="edge"))
    return np.asarray((total[2 * half + 1 :] - total[: -2 * half - 1]) / (2 * half + 1) + values[0])


def _straight(numbers: NDArray[np.intp], its: Reduced) -> Iterator[StraightPass]:
    """The line through places, and of a run that is bent, its halves."""
    east, north = its.east_m[numbers], its.north_m[numbers]
    middle = np.array([east.mean(), north.mean()])
    off = np.stack([east, north], 1) - middle
    direction = np.linalg.svd(off, full_matrices=False)[2][0]
    if (off[-1] - off[0]) @ direction < 0.0:
        direction = -direction
    along, aside = off @ direction, off @ np.array([direction[1], -direction[0]])
    if np.abs(aside).max() <= ASIDE_M:
        ends = (middle + each * direction for each in (along.min(), along.max()))
        begin, end = ((float(x), float(y)) for x, y in ends)
        if math.dist(begin, end) >= LEAST_M:
            yield StraightPass(numbers, begin, end)
    elif len(numbers) >= 2 * PINGS:
        half = len(numbers) // 2
        yield from _straight(numbers[:half], its)
        yield from _straight(numbers[half:], its)


def crossings(found: list[StraightPass], its: Reduced) -> list[Crossing]:
    """Where passes cross, with the depths of both there; of very many some, all over the area."""
    if len(found) < 2:
        return []
    begins, ends = (np.array([getattr(each, name) for each in found]) for name in ("begin", "end"))
    ways = ends - begins
    pairs = list[tuple[int, int, float, float]]()
    for number in range(len(found) - 1):
        others = slice(number + 1, None)
        cross = ways[number, 0] * ways[others, 1] - ways[number, 1] * ways[others, 0]
        sine = np.abs(cross) / (np.hypot(*ways[number]) * np.hypot(ways[others, 0], ways[others, 1]))
        off = begins[others] - begins[number]
        with np.errstate(divide="ignore", invalid="ignore"):
            one = (off[:, 0] * ways[others, 1] - off[:, 1] * ways[others, 0]) / cross
            other = (off[:, 0] * ways[number, 1] - off[:, 1] * ways[number, 0]) / cross
        does = (sine > math.sin(ANGLE_RAD)) & (one > 0.0) & (one < 1.0) & (other > 0.0) & (other < 1.0)
        for index in np.flatnonzero(does):
            place = begins[number] + one[index] * ways[number]
            pairs.append((number, number + 1 + int(index), float(place[0]), float(place[1])))
    step = max(1, math.ceil(len(pairs) / MOST))
    met = (_met(found[a], found[b], (x, y), its) for a, b, x, y in pairs[::step])
    return [each for each in met if each is not None]


def _met(one: StraightPass, other: StraightPass, place: tuple[float, float], its: Reduced) -> Crossing | None:
    first, second = (_depth_at(each, place, its) for each in (one, other))
    if first is None or second is None:
        return None
    return Crossing(*place, (first[0] + second[0]) / 2.0, second[0] - first[0], (first[1] + second[1]) / 2.0)


def _depth_at(its: StraightPass, place: tuple[float, float], reduced: Reduced) -> tuple[float, float] | None:
    """The depth of a pass at a place on its line, by a straight line through the soundings about it, and their variance, as far
    as they do not share it."""
    (x, y), (to_x, to_y) = its.begin, its.end
    ux, uy = (to_x - x) / its.long_m, (to_y - y) / its.long_m
    along = (reduced.east_m[its.numbers] - place[0]) * ux + (reduced.north_m[its.numbers] - place[1]) * uy
    near = np.abs(along) < max(REACH_M, STEPS * its.long_m / len(its.numbers))
    if (count := int(near.sum())) < AT_LEAST or along[near].min() > 0.0 or along[near].max() < 0.0:
        return None
    depths, far = reduced.depth_m[its.numbers][near], along[near]
    slope, depth = (float(each) for each in np.polyfit(far, depths, 1))
    left = depths - depth - slope * far
    return depth, float(left @ left) / (count - 2) * (1.0 - 1.0 / count)


def one_sounding_m(found: list[Crossing]) -> float:
    """What one sounding is good to, 95 %, as the crossings say: the difference of two passes has twice the variance that the
    soundings of a pass share. NaN where there are fewer than three crossings."""
    if len(found) < 3:
        return math.nan
    return 1.96 * math.sqrt(sum(each.off_m**2 / 2.0 + each.scatter_m2 for each in found) / len(found))


def within(order: str, depth_m: float) -> float:
    """The vertical uncertainty, 95 %, that an order of S-44 allows at a depth, m."""
    a, b = ORDERS[order]
    return math.hypot(a, b * depth_m)


class FoundLatency(NamedTuple):
    """How late depths come, beyond what was corrected, as lines to and fro tell it."""

    latency_s: float
    spread_s: float  # standard deviation
    pairs: int  # of passes


def patch_test(again: Callable[[float], Reduced]) -> FoundLatency:
    """The latency by which passes to and fro along one line see the same bed. `again` reduces all soundings with a latency.
    Raises DelfimError where no two lie so, or where the bed is too flat to tell."""
    here = again(0.0)
    found = passes(here)
    pairs = [(a, b) for number, a in enumerate(found) for b in found[number + 1 :] if _is_to_and_fro(a, b)]
    if not pairs:
        raise DelfimError(
            f"no two lines to and fro: sail one line of {LEAST_M:g} m or more across a slope, and the same line back"
        )
    pairs = pairs[:: math.ceil(len(pairs) / PAIRS)]
    late_s = spread_s = 0.0
    for _ in range(2):
        by_s, spread_s = _step(pairs, again(late_s - APART_S), again(late_s), again(late_s + APART_S))
        late_s += by_s
    spread_s = math.hypot(spread_s, _beside_s(pairs, here))
    if not spread_s < TOO_FLAT_S:
        raise DelfimError(f"the bed under these lines is too flat to tell a latency: {late_s:+.2f} s ±{spread_s:.2f}")
    return FoundLatency(late_s, spread_s, len(pairs))


def _beside_s(pairs: list[tuple[StraightPass, StraightPass]], its: Reduced) -> float:
    """The deviation of a latency because the boat was not on the same line: a slope across is as steep as one along."""
    asides = np.concatenate([_difference(*pair, its, aside=True) for pair in pairs])
    speeds = [2.0 * each.long_m / float(np.ptp(its.at_s[each.numbers])) for pair in pairs for each in pair]
    far_m = float(np.sqrt(np.nanmean(asides**2))) if np.isfinite(asides).any() else math.inf
    long_m = sum({each.begin: each.long_m for pair in pairs for each in pair}.values()) / 2.0
    return far_m / float(np.mean(speeds)) * min(1.0, math.sqrt(ALONG_M / long_m))


def _step(
    pairs: list[tuple[StraightPass, StraightPass]], before: Reduced, here: Reduced, after: Reduced
) -> tuple[float, float]:
    """What latency more makes the profiles of pairs alike, by least squares, and its deviation."""
    offs, slopes = list[Array](), list[Array]()
    for pair in pairs:
        unlike, less, more = (_difference(*pair, its) for its in (here, before, after))
        moved = (more - less) / (2.0 * APART_S)
        known = np.isfinite(unlike + moved)
        offs.append(unlike[known])
        slopes.append(moved[known])
    strength = sum(float(slope @ slope) for slope in slopes)
    if sum(map(len, offs)) < PINGS or not strength:
        return 0.0, math.inf
    by_s = -sum(float(slope @ off) for slope, off in zip(slopes, offs, strict=True)) / strength
    variance = 0.0
    for off, slope in zip(offs, slopes, strict=True):  # Newey and West 1987
        pull = slope * (off + by_s * slope)
        variance += float(pull @ pull)
        for lag in range(1, min(ALIKE, len(pull))):
            variance += 2.0 * (1.0 - lag / ALIKE) * float(pull[lag:] @ pull[:-lag])
    return by_s, math.sqrt(max(variance, 0.0)) / strength


def _is_to_and_fro(a: StraightPass, b: StraightPass) -> bool:
    (ax, ay), (bx, by) = a.begin, b.begin
    ux, uy = (a.end[0] - ax) / a.long_m, (a.end[1] - ay) / a.long_m
    vx, vy = (b.end[0] - bx) / b.long_m, (b.end[1] - by) / b.long_m
    if ux * vx + uy * vy > OPPOSITE:
        return False
    asides = [abs((x - ax) * uy - (y - ay) * ux) for x, y in (b.begin, b.end)]
    alongs = sorted((x - ax) * ux + (y - ay) * uy for x, y in (b.begin, b.end))
    return max(asides) < BESIDE_M and min(alongs[1], a.long_m) - max(alongs[0], 0.0) >= LEAST_M


def _difference(a: StraightPass, b: StraightPass, its: Reduced, aside: bool = False) -> Array:
    """The depths of `b` less those of `a` along the line of `a`, each BIN_M, smoothed; NaN where either has too few. Or how far
    `b` was beside `a`."""
    ux, uy = (a.end[0] - a.begin[0]) / a.long_m, (a.end[1] - a.begin[1]) / a.long_m
    bins, half = int(a.long_m / BIN_M), int(3.0 * SMOOTH_M / BIN_M)
    weights = np.exp(-0.5 * (np.arange(-half, half + 1) * BIN_M / SMOOTH_M) ** 2)
    values: Array = its.depth_m
    found = list[Array]()
    if aside:
        values = (its.east_m - a.begin[0]) * uy - (its.north_m - a.begin[1]) * ux
    for each in (a, b):
        at = its.east_m[each.numbers] - a.begin[0], its.north_m[each.numbers] - a.begin[1]
        along = at[0] * ux + at[1] * uy
        whole = np.floor(along / BIN_M).astype(int)
        part, inside = along / BIN_M - whole - 0.5, (whole > 0) & (whole < bins - 1)
        beside = whole + np.where(part < 0.0, -1, 1)  # a sounding is shared with the nearer neighbour, so that nothing steps
        count, total = np.zeros(bins), np.zeros(bins)
        for place, share in ((whole, 1.0 - np.abs(part)), (beside, np.abs(part))):
            count += np.bincount(place[inside], share[inside], bins)
            total += np.bincount(place[inside], share[inside] * values[each.numbers][inside], bins)
        count, total = np.convolve(count, weights, "same"), np.convolve(total, weights, "same")
        with np.errstate(divide="ignore", invalid="ignore"):
            found.append(np.where(count > 1.0, total / count, np.nan))
    off = found[1] - found[0]
    off[:half], off[-half:] = np.nan, np.nan
    return np.asarray(off)
