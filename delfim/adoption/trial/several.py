"""Finding out which of three or four fixed motors is where, and which way each pushes, from how the boat moves. Pure.

Each motor by itself turns the boat: that says to which side. Then all push together in patterns in which their turns are
against each other: what is left is how the boat goes, ahead and aside. Every order of the motors foretells another answer to
the patterns; the one that fits must fit well, and better than any other by a margin. Else there is no clear answer, and
nothing is guessed. Motors that do the same to the boat, one behind the other at a side, cannot be told apart, nor need they be:
they keep their order.
"""

import math
from collections.abc import Callable, Generator, Iterator, Sequence
from itertools import combinations, permutations
from statistics import fmean
from typing import Final, NamedTuple

from delfim.adoption.suited import AHEAD_LEAST, ThrusterPlace, at_side, place_of
from delfim.adoption.trial.motors import (
    AHEAD_MPS,
    AHEAD_NOISES,
    LATE_S,
    LEVELS,
    MEAN_S,
    PROOF_RADPS,
    SURGE_LEVELS,
    TURN_NOISES,
    TURN_RADPS,
    Doublet,
    DriftNoise,
    Finding,
    MotorsFound,
    Response,
    Sample,
    agreeing,
    beyond,
    hold_s,
    levels_from,
)
from delfim.config import ThrusterTable

Pattern = tuple[int, ...]

PATTERNS: Final[dict[int, tuple[Pattern, ...]]] = {  # each motor turned to starboard by as much as others turn to port
    3: ((1, -1, 0), (0, 1, -1), (-1, 0, 1)),
    4: ((1, 1, -1, -1), (1, -1, 1, -1), (1, -1, -1, 1)),
}
HELD_S, HELD_S_PER_M = (2.0, 3.0), 0.8  # least and most, of the boat's length: there are more doublets than for two motors
ALIKE: Final = 0.05  # of what the strongest does: motors that differ by less do the same
MODEL: Final = 0.15  # of the answers ahead, or aside: what this model does not tell of them
ASKEW_RAD: Final = 0.25  # deviation of a compass, with its iron
ASIDE: Final = 0.3, 0.45, 0.65, 0.95  # how easily a boat goes aside, of how easily ahead
UNEQUAL: Final = 0.2  # of its strength: deviation of a motor from its file
AXES: Final = 1, 2  # of an answer: ahead, aside
ROUNDS: Final = 3
NOISE_MPS: Final = 0.04  # of an answer, at least
ARM_SPREAD: Final = 0.25  # of the boat's length: the antenna may be so far from the point about which she turns
REST_S: Final = 1.0  # between two doublets
FIT_MOST, MARGIN = 16.0, 12.0  # of the sum of squares: of the best order, and by which the next is worse
DISAGREE: Final = 0.6  # of the largest answer: two tries that differ by more contradict each other


class PatternAnswers(NamedTuple):
    """The answers to the patterns."""

    patterns: tuple[Pattern, ...]
    answers: tuple[Response, ...]
    noise_mps: float


class MotorOrder(NamedTuple):
    """An order of the motors, and how badly it fits."""

    places: tuple[int, ...]
    off: float


def response(samples: Sequence[Sample], from_s: float, held_s: float) -> Response:
    """The answer to a doublet, as `motors.response`; the velocity is that over ground, seen from the boat as she lay in the
    middle of it: a current falls out however she turns."""
    times_s = from_s + 0.1, from_s + held_s + LATE_S, from_s + 2.0 * held_s + LATE_S
    begin, middle, end = (_near(samples, at_s) for at_s in times_s)

    def bent(of: Callable[[Sample], float]) -> float:
        return 2.0 * fmean(map(of, middle)) - fmean(map(of, begin)) - fmean(map(of, end))

    north, east = bent(lambda each: each.north_mps), bent(lambda each: each.east_mps)
    c, s = (fmean(of(each.heading_rad) for each in middle) for of in (math.cos, math.sin))
    return Response(bent(lambda each: each.turn_radps), north * c + east * s, east * c - north * s)


def _near(samples: Sequence[Sample], at_s: float) -> list[Sample]:
    near = [each for each in samples if abs(each.at_s - at_s) <= MEAN_S]
    return near or [min(samples, key=lambda each: abs(each.at_s - at_s))]


def finding(rows: Sequence[ThrusterTable], length_m: float, quiet: DriftNoise) -> Finding:
    """Ask for one doublet after the other, and take its answer; returns what was found."""
    held_s = hold_s(length_m, HELD_S, HELD_S_PER_M)
    turn_radps, turns, levels = max(TURN_RADPS, TURN_NOISES * quiet.turn_radps), list[int](), list[float]()
    for row in range(len(rows)):
        alone = tuple(float(each == row) for each in range(len(rows)))
        sure = yield from agreeing(_of(alone, held_s), 0, turn_radps, levels_from(levels[-1] if levels else 0.0))
        if isinstance(sure, str):
            return f"motor {row + 1} of the file: {sure}"
        turns.append(sure.sign)
        levels.append(sure.level)
    every, least_mps = [place_of(row) for row in rows], max(AHEAD_MPS, AHEAD_NOISES * quiet.ahead_mps)
    noise_mps = max(NOISE_MPS, quiet.ahead_mps)
    going = [level for level in SURGE_LEVELS if level > max(levels)] or [LEVELS[-1]]
    places: tuple[int, ...] | str = f"she does not go beyond doubt, up to {going[-1]:.0%}: no clear answer"
    heard = list[PatternAnswers]()
    for level in going:
        measured = yield from _patterns(rows, [level * sign for sign in turns], held_s, least_mps, noise_mps)
        if isinstance(measured, str):
            places = measured or places
            continue
        heard.append(measured)
        places = order(rows, heard, length_m)
        if not isinstance(places, str):
            break
    if isinstance(places, str):
        return f"all motors together: {places}"
    signs = tuple(sign if every[at].turn_m > 0.0 else -sign for sign, at in zip(turns, places, strict=True))
    return MotorsFound(tuple(every[at].side for at in places), signs, tuple(levels), places)


def _of(parts: Sequence[float], held_s: float) -> Callable[[float], Doublet]:
    return lambda level: Doublet(tuple(level * each for each in parts), held_s, tuple(-level * each for each in parts))


def _patterns(
    rows: Sequence[ThrusterTable], turning: Sequence[float], held_s: float, least_mps: float, noise_mps: float
) -> Generator[Doublet, Response, PatternAnswers | str]:
    """The answers to all patterns of commands that turn her to starboard one by one, each played both ways; empty: she goes too
    little. Otherwise why they tell nothing, in words."""
    patterns, axes = PATTERNS[len(rows)], AXES if _need_aside(rows) else AXES[:1]
    asked = [_of([way * part for way, part in zip(each, turning, strict=True)], held_s) for each in patterns]
    first = list[Response]()
    for of in asked:
        first.append((yield of(1.0)))
    if any(max(abs(each[axis]) for each in first) < least_mps for axis in axes):
        return ""
    again = list[Response]()
    for of in asked:
        again.append((yield of(-1.0)))
    pairs = list(zip(first, again, strict=True))
    means = tuple(Response(*(0.5 * (a - b) for a, b in zip(one, other, strict=True))) for one, other in pairs)
    apart = [math.hypot(one[1] + other[1], one[2] + other[2]) for one, other in pairs]
    if max(apart) > DISAGREE * 2.0 * max(map(_size, means)):
        return "two tries contradict each other: no clear answer"
    return PatternAnswers(patterns, means, noise_mps)


def _need_aside(rows: Sequence[ThrusterTable]) -> bool:
    """Whether two motors that do different things push ahead alike, where each turns her to starboard."""
    every = [place_of(row) for row in rows]
    ahead = {kind: math.copysign(1.0, every[kind].turn_m) * every[kind].ahead for kind in kinds_of(rows)}
    return any(abs(one - other) < AHEAD_LEAST for one, other in combinations(ahead.values(), 2))


def _size(answer: Response) -> float:
    return math.hypot(answer.ahead_mps, answer.aside_mps)


def order(rows: Sequence[ThrusterTable], heard: Sequence[PatternAnswers], length_m: float) -> tuple[int, ...] | str:
    """The place of the motor that each row reaches, by the answers at one power or more; a text says why there is none."""
    ranked = sorted(_orders(rows, heard, length_m), key=lambda each: each.off)
    best, others, most = ranked[0], ranked[1:], FIT_MOST * len(heard)
    if best.off > most:
        return f"no order of the motors fits how she moves ({best.off:.0f}, {most:.0f} at most): no clear answer"
    if others and others[0].off - best.off < MARGIN:
        return "two orders of the motors fit how she moves: no clear answer"
    return best.places


def _orders(rows: Sequence[ThrusterTable], heard: Sequence[PatternAnswers], length_m: float) -> Iterator[MotorOrder]:
    """Each order that does something else to the boat: of those that do the same the one that moves the fewest motors."""
    kinds, seen = kinds_of(rows), set[tuple[int, ...]]()
    several = sorted(permutations(range(len(rows))), key=lambda each: sum(at != row for row, at in enumerate(each)))
    for places in several:
        kind = tuple(kinds[at] for at in places)
        if kind not in seen:
            seen.add(kind)
            yield MotorOrder(places, sum(_off([rows[at] for at in places], each, length_m) for each in heard))


def kinds_of(rows: Sequence[ThrusterTable]) -> list[int]:
    """Of each place the first one that does the same to the boat."""
    every = [_scaled(rows, place_of(row), max(row.ends_n)) for row in rows]
    return [next(at for at, other in enumerate(every) if math.dist(other, its) < ALIKE) for its in every]


def _scaled(rows: Sequence[ThrusterTable], its: ThrusterPlace, push_n: float) -> tuple[float, float, float]:
    arm_m, most_n = max(abs(place_of(row).turn_m) for row in rows), max(max(row.ends_n) for row in rows)
    return its.turn_m / arm_m * push_n / most_n, its.ahead * push_n / most_n, its.aside * push_n / most_n


def _off(motors: Sequence[ThrusterTable], measured: PatternAnswers, length_m: float) -> float:
    """The sum of squares of what this order foretells of both velocities less the answers. Free are the mass, which is more
    aside; how strong each motor is; where the antenna is, which makes a velocity of turns that are left; and how far the
    compass is off, which makes of a way ahead one aside."""
    every = [place_of(row) for row in motors]
    ways = [(math.copysign(max(row.ends_n), its.turn_m), its) for row, its in zip(motors, every, strict=True)]
    goes_aside = any(abs(its.aside) > AHEAD_LEAST for its in every)
    return min(_off_by(ways, measured, length_m, easier) for easier in (ASIDE if goes_aside else ASIDE[:1]))


def _off_by(ways: Sequence[tuple[float, ThrusterPlace]], measured: PatternAnswers, length_m: float, easier: float) -> float:
    """The same for a boat that goes so much more easily aside than ahead. In turn the mass is found, and all else."""
    had = [each[axis] for each in measured.answers for axis in AXES]
    sizes = [math.sqrt(fmean(each[axis] ** 2 for each in measured.answers)) for axis in AXES]
    sigmas = [math.hypot(measured.noise_mps, MODEL * size) for size in sizes]
    priors = [*(ARM_SPREAD * length_m,) * 2, ASKEW_RAD, *(UNEQUAL,) * len(ways)]
    pushed, moved = list[list[float]](), list[list[float]]()  # of each answer: by each motor; by antenna and compass
    for pattern, answer in zip(measured.patterns, measured.answers, strict=True):
        turn, ahead, aside = answer
        pushed.append([way * n * its.ahead for way, (n, its) in zip(pattern, ways, strict=True)])
        pushed.append([way * n * its.aside * easier for way, (n, its) in zip(pattern, ways, strict=True)])
        moved += [[turn, 0.0, -aside], [0.0, turn, ahead]]
    weights = [1.0 / sigmas[at % 2] for at in range(len(had))]
    free = [0.0] * len(priors)
    rows, rest = list[list[float]](), list[float]()
    for _ in range(ROUNDS):
        told = [w * (sum(its) + _dot(its, free[3:])) for w, its in zip(weights, pushed, strict=True)]
        left = [w * (y - _dot(its, free[:3])) for w, y, its in zip(weights, had, moved, strict=True)]
        scale = max(_dot(told, left) / max(_dot(told, told), 1e-9), 0.0)
        rows = [
            [w * each for each in (*by, *(scale * n for n in its))] for w, by, its in zip(weights, moved, pushed, strict=True)
        ]
        rest = [w * (y - scale * sum(its)) for w, y, its in zip(weights, had, pushed, strict=True)]
        free = _ridge(rows, rest, priors)
    off = [y - _dot(its, free) for its, y in zip(rows, rest, strict=True)]
    return _dot(off, off) + sum((value / prior) ** 2 for value, prior in zip(free, priors, strict=True))


def _ridge(rows: Sequence[Sequence[float]], rest: Sequence[float], priors: Sequence[float]) -> list[float]:
    """The numbers that make the least sum of squares of rest - rows numbers, and of each over its prior: Gauss, for the matrix
    is positive definite."""
    count = len(priors)
    columns = [[row[at] for row in rows] for at in range(count)]
    m = [[*(_dot(one, other) for other in columns), _dot(one, rest)] for one in columns]
    for at, prior in enumerate(priors):
        m[at][at] += prior**-2.0
    for at in range(count):
        for below in range(at + 1, count):
            part = m[below][at] / m[at][at]
            m[below] = [b - part * a for a, b in zip(m[at], m[below], strict=True)]
    found = [0.0] * count
    for at in reversed(range(count)):
        found[at] = (m[at][count] - _dot(m[at][at + 1 : count], found[at + 1 :])) / m[at][at]
    return found


def _dot(one: Sequence[float], other: Sequence[float]) -> float:
    return sum(a * b for a, b in zip(one, other, strict=True))


def proving(
    found: MotorsFound, rows: Sequence[ThrusterTable], length_m: float, quiet: DriftNoise
) -> Generator[Doublet, Response, str]:
    """A turn to starboard by all motors, which was never tried. Returns why that proves nothing, in words; empty: proven."""
    held_s = hold_s(length_m, HELD_S, HELD_S_PER_M)
    every = [place_of(rows[at]) for at in found.places]
    parts = [math.copysign(1.0, its.turn_m) * sign for its, sign in zip(every, found.signs, strict=True)]
    least_radps, levels = max(PROOF_RADPS, TURN_NOISES * quiet.turn_radps), levels_from(max(found.least))
    sure = yield from agreeing(_of(parts, held_s), 0, least_radps, levels)
    if isinstance(sure, str):
        return sure
    return "" if sure.sign > 0 else "she turns to port where what was found turns her to starboard: nothing of it is sure"


def mix(found: MotorsFound, rows: Sequence[ThrusterTable], surge: float, turn: float) -> tuple[float, ...]:
    """Parts of the rows for a push ahead and a turn to starboard: those at a side alike, who push aside alone not at all."""
    parts = [0.0] * len(rows)
    for side in (1, -1):
        its = [index for index, at in enumerate(found.places) if at in at_side(rows, side)]
        part = beyond(max(-1.0, min(1.0, surge - side * turn)), max(found.least[index] for index in its))
        for index in its:
            parts[index] = found.signs[index] * place_of(rows[found.places[index]]).way * part
    return tuple(parts)
