"""Finding out which motor is where, and which way it pushes, from how the boat moves. Pure, standard library.

A doublet is one command for some seconds, then as much the other way. Of the rate of turn and of the speed along the keel we
take twice the middle less both ends: a wind or a current that stays falls out, and so does the way that the boat has. Each
motor turns the boat by itself, until two doublets agree beyond doubt; then both push it along its keel, with their turns
against each other. From side and direction follows a turn that was not tried before: it proves the answer. Where the doublets
do not agree there is no clear answer, and nothing is guessed.
"""

import math
from collections.abc import Callable, Generator, Sequence
from itertools import pairwise
from statistics import fmean, pstdev
from typing import Final, NamedTuple

import msgspec

from delfim.config import ThrusterTable

LEVELS: Final = (0.12, 0.2, 0.3, 0.45, 0.65, 0.9)  # of full command: more only where less moved nothing
SURGE_LEVELS, PROOF_LEVELS = LEVELS[2:], LEVELS[1:]
BEGIN_MOST: Final = 0.3  # of full command: with no more a motor is tried first
LATE_S: Final = 0.4  # the boat answers so much later: delay and lag of motors and receivers
MEAN_S: Final = 0.25  # to either side of a time: its value is the mean
TURN_RADPS, PROOF_RADPS, AHEAD_MPS = math.radians(4.0), math.radians(5.0), 0.25  # the least answers ...
TURN_NOISES, AHEAD_NOISES = 8.0, 6.0  # ... and so many times what the drift shows
HELD_S: Final = (2.0, 4.0)  # how long a doublet holds one command, least and most
HELD_S_PER_M: Final = 1.2  # of the boat's length
LEAST_PART: Final = 0.01


class Sample(NamedTuple):
    """The motion at one time."""

    at_s: float
    turn_radps: float  # positive to starboard
    ahead_mps: float  # over ground along the keel
    north_mps: float = 0.0  # over ground, with the heading, for boats of three or more thrusters
    east_mps: float = 0.0
    heading_rad: float = 0.0


class DriftNoise(NamedTuple):
    """By how much values change from one second to the next while the motors are off."""

    turn_radps: float
    ahead_mps: float


class Doublet(NamedTuple):
    """A command for some seconds, then its opposite for as long."""

    parts: tuple[float, ...]  # of each row, or of one and its angle
    held_s: float
    back: tuple[float, ...]  # the opposite


class Response(NamedTuple):
    """The answer of the boat to a doublet."""

    turn_radps: float
    ahead_mps: float
    aside_mps: float = 0.0  # to starboard, of boats of three or more thrusters


class MotorsFound(NamedTuple):
    """What was found, for the rows in the file's order: of two, of one that steers, or of three or more."""

    sides: tuple[int, ...]  # 1 starboard, -1 port; of one that steers to which side a positive angle turns the boat
    signs: tuple[int, ...]  # 1: a positive command pushes ahead, of three or more along the angle of its place; -1: astern
    least: tuple[float, ...]  # of full command: the first that moved the boat
    places: tuple[int, ...] = ()  # of three or more: the row of the file in whose place the motor is that each row reaches

    @property
    def steers(self) -> bool:
        """Whether it is one motor that steers."""
        return len(self.sides) == 1


Finding = Generator[Doublet, Response, MotorsFound | str]  # a text says why there is no answer


def noise(samples: Sequence[Sample]) -> DriftNoise:
    """What the drift shows. A boat that was not looked at for some seconds is quiet: the least answers count then."""
    if not samples:
        return DriftNoise(0.0, 0.0)
    seconds = dict[int, list[Sample]]()
    for each in samples:
        seconds.setdefault(int(each.at_s - samples[0].at_s), []).append(each)
    turns = [fmean(each.turn_radps for each in found) for found in seconds.values()]
    speeds = [fmean(each.ahead_mps for each in found) for found in seconds.values()]
    return DriftNoise(_change(turns), _change(speeds))


def _change(values: list[float]) -> float:
    return pstdev(after - before for before, after in pairwise(values)) if len(values) > 2 else 0.0


def response(samples: Sequence[Sample], from_s: float, held_s: float) -> Response:
    """The answer to a doublet that began at this time and held each of its commands for so long."""
    begin, middle, end = (_at(samples, from_s + at_s) for at_s in (0.1, held_s + LATE_S, 2.0 * held_s + LATE_S))
    return Response(2.0 * middle[0] - begin[0] - end[0], 2.0 * middle[1] - begin[1] - end[1])


def _at(samples: Sequence[Sample], at_s: float) -> tuple[float, float]:
    near = [each for each in samples if abs(each.at_s - at_s) <= MEAN_S] or [
        min(samples, key=lambda each: abs(each.at_s - at_s))
    ]
    return fmean(each.turn_radps for each in near), fmean(each.ahead_mps for each in near)


def hold_s(length_m: float, bounds_s: tuple[float, float] = HELD_S, s_per_m: float = HELD_S_PER_M) -> float:
    """How long a doublet of a boat so long holds one command."""
    return min(max(s_per_m * length_m, bounds_s[0]), bounds_s[1])


def levels_from(level: float) -> tuple[float, ...]:
    """The levels from that at which another motor was found, which is no stronger."""
    return tuple(each for each in LEVELS if each >= min(level, BEGIN_MOST))


def finding(length_m: float, quiet: DriftNoise, drifts: Callable[[], bool] = lambda: False) -> Finding:
    """Ask for one doublet after the other, and take its answer; returns what was found. `drifts`: whether she is carried off:
    then the second motor is not tried with less than what the first one needed."""
    held_s = hold_s(length_m)
    turn_radps = max(TURN_RADPS, TURN_NOISES * quiet.turn_radps)
    turns = list[SureAnswer]()
    for row in (0, 1):
        levels = levels_from(turns[0].level) if turns and drifts() else LEVELS
        sure = yield from agreeing(_of(float(row == 0), float(row == 1), held_s), 0, turn_radps, levels)
        if isinstance(sure, str):
            return f"motor {row + 1} of the file: {sure}"
        turns.append(sure)
    against = -1.0 if turns[0].sign == turns[1].sign else 1.0  # with these signs of commands the turns cancel
    ahead_mps = max(AHEAD_MPS, AHEAD_NOISES * quiet.ahead_mps)
    both = yield from agreeing(_of(1.0, against, held_s + 0.5), 1, ahead_mps, SURGE_LEVELS)
    if isinstance(both, str):
        return f"both motors together: {both}"
    signs = both.sign, int(both.sign * against)
    sides = -turns[0].sign * signs[0], -turns[1].sign * signs[1]  # who pushes ahead at starboard turns her to port
    if sides[0] == sides[1]:
        return "both motors seem to be at one side"
    return MotorsFound(sides, signs, (turns[0].level, turns[1].level))


def proving(found: MotorsFound, length_m: float, quiet: DriftNoise) -> Generator[Doublet, Response, str]:
    """A turn to starboard by both motors, which was never tried. Returns why that proves nothing, in words; empty: proven."""
    held_s = hold_s(length_m)
    first, second = (float(-side * sign) for side, sign in zip(found.sides, found.signs, strict=True))
    least_radps = max(PROOF_RADPS, TURN_NOISES * quiet.turn_radps)
    sure = yield from agreeing(_of(first, second, held_s), 0, least_radps, PROOF_LEVELS)
    if isinstance(sure, str):
        return sure
    return "" if sure.sign > 0 else "she turns to port where what was found turns her to starboard: nothing of it is sure"


class SureAnswer(NamedTuple):
    """An answer that came twice."""

    sign: int
    level: float
    size: float = 0.0  # the mean of both


def _of(first: float, second: float, held_s: float) -> Callable[[float], Doublet]:
    """Doublets of both rows: so many times a level."""
    return lambda level: Doublet((first * level, second * level), held_s, (-first * level, -second * level))


def agreeing(
    of: Callable[[float], Doublet], what: int, least: float, levels: Sequence[float]
) -> Generator[Doublet, Response, SureAnswer | str]:
    """Doublets of a level that grows until two of one level answer with more than the least. `what`: 0 the rate of turn, 1 the
    speed."""
    for level in levels:
        before = 0.0
        for _ in range(2):
            answer = (yield of(level))[what]
            if abs(answer) < least:
                break
            if before:
                agree = before * answer > 0.0
                contradict = "two tries contradict each other: no clear answer"
                return SureAnswer(1 if answer > 0.0 else -1, level, 0.5 * abs(before + answer)) if agree else contradict
            before = answer
    return f"she does not move beyond doubt, up to {levels[-1]:.0%}: no clear answer"


def mix(found: MotorsFound, surge: float, turn: float) -> tuple[float, ...]:
    """Parts of the rows for a push ahead and a turn to starboard, beyond what did not move the boat."""
    parts = list[float]()
    for side, sign, least in zip(found.sides, found.signs, found.least, strict=True):
        parts.append(sign * beyond(max(-1.0, min(1.0, surge - side * turn)), least))
    return tuple(parts)


def beyond(part: float, least: float) -> float:
    """A part of the command beyond what did not move the boat."""
    dead = 0.4 * least
    return 0.0 if abs(part) < LEAST_PART else math.copysign(dead + (1.0 - dead) * abs(part), part)


class Wiring(NamedTuple):
    """How the boat differs from its file."""

    swapped: bool  # the motors of both rows, or of some of more, are exchanged
    reversed: tuple[bool, ...]  # by row of the file: the motor that its commands reach pushes the other way
    turned: bool = False  # what turns the motor turns it the other way
    places: tuple[int, ...] = ()  # of three or more, as `MotorsFound` has them

    def words(self, rows: Sequence[ThrusterTable]) -> list[str]:
        """A sentence for each difference."""
        found = ["The motors of port and starboard are exchanged."] if self.swapped and not self.places else []
        moved = [(row.name, rows[at].name) for row, at in zip(rows, self.places, strict=False) if rows[at] is not row]
        found += [f"The motor that {name} reaches is that of {place}." for name, place in moved]
        found += [
            f"The motor that {row.name} reaches is reversed." for row, is_so in zip(rows, self.reversed, strict=True) if is_so
        ]
        return found + ([f"What turns {rows[0].name} turns it the other way."] if self.turned else [])


def wiring(found: MotorsFound, rows: Sequence[ThrusterTable]) -> Wiring:
    back = tuple(sign < 0 for sign in found.signs)
    if found.places:
        return Wiring(found.places != tuple(range(len(rows))), back, places=found.places)
    if found.steers:  # a thrust that is turned to starboard behind the middle turns the boat to port
        return Wiring(False, back, found.sides[0] * rows[0].x_m < 0.0)
    return Wiring(any(side * row.y_m < 0.0 for side, row in zip(found.sides, rows, strict=True)), back)


def corrected(found: MotorsFound, rows: Sequence[ThrusterTable]) -> list[dict[str, object]]:
    """The keys of each row of the file that change: the row of a side reaches the motor of that side. Its driver, address and
    direction belong to the motor; its place and name to the side."""
    its = wiring(found, rows)
    changed = list[dict[str, object]]()
    for index, row in enumerate(rows):
        at = its.places.index(index) if its.places else 1 - index if its.swapped else index
        motor = rows[at]
        wanted = {"driver": motor.driver, "address": motor.address, "reversed": motor.reversed != its.reversed[at]}
        changed.append({key: value for key, value in wanted.items() if getattr(row, key) != value})
        if its.turned and row.steer is not None:
            changed[-1]["steer"] = msgspec.structs.replace(row.steer, reversed=not row.steer.reversed)
    return changed


def as_corrected(found: MotorsFound, rows: Sequence[ThrusterTable], told: Sequence[float]) -> tuple[float, ...]:
    """Parts that were told to the rows of the file, as those of its corrected rows: positive is ahead, of three or more along
    the angle of each. Behind that of a motor that steers is its angle, rad."""
    its = wiring(found, rows)
    parts = tuple(sign * part for sign, part in zip(found.signs, told, strict=False))
    if found.steers and rows[0].steer is not None:
        return *parts, math.radians(rows[0].steer.angle_max_deg) * told[1] * (-1.0 if its.turned else 1.0)
    if its.places:
        return tuple(parts[its.places.index(index)] for index in range(len(parts)))
    return tuple(reversed(parts)) if its.swapped else parts
