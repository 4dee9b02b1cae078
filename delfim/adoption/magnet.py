"""The compass alone: what the iron about it makes of headings, from two slow circles, the gyro, and the course over ground.

A compass that tells a heading has five numbers: two of hard iron, two of soft iron, an offset. In the circles the gyro says how
far she turned, and from that follows the shape; the offset is what courses over ground differ by on straight legs both ways,
the current taken out. A place is hopeless where the field changes while she turns in it, as near a pier: both circles then tell
of another magnet.
"""

from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np

from delfim.adoption.model import Array, said
from delfim.adoption.record import BoatRecord, Manoeuvre, Series
from delfim.base.errors import DelfimError
from delfim.config import HARD_MOST

CIRCLES: Final = "circles"  # the manoeuvre's name
TURNED: Final = 0.9  # of a turn, each way: with less the shape is a guess
AGREE: Final = 0.3  # of the turn that the compass tells, at least, the gyro tells, too
APART_MOST: Final = 0.04  # hard iron of one circle less that of the other: sound places have up to 0.025
RESIDUAL_MOST_RAD: Final = np.radians(3.0)
MOTORS_MOST_RAD: Final = np.radians(2.0)  # that motors at full power turn the compass
HUBER: Final = 2.5  # deviations, beyond which a value counts by its size instead of its square
ROUNDS: Final = 25
HEADING_RAD: Final = np.radians(1.0)  # the least deviation of a heading
SPREADS: Final = np.array([0.4, 0.4, 0.1, 0.1, np.inf, np.radians(2.0), 0.3])  # hard, soft, start, gyro's bias, lateness
MOTORS_SPREADS: Final = np.array([0.1, 0.1, 0.3])  # hard iron of the motors, which one heading alone does not tell; lateness
STRAIGHT_RADPS: Final = np.radians(6.0)
UNDER_WAY_MPS: Final = 0.4
SETTLED_S: Final = 1.5  # straight for so long: what is left of a turn's drift angle has gone
LEGS_LEAST: Final = 40  # values
PIECE_S: Final = 8.0  # of the record, over which gyro and compass may drift apart by themselves


class CompassShape(NamedTuple):
    """How iron bends headings, in the frame of what the compass tells, and how well that is known."""

    hard: Array  # (2,) ahead and to starboard, over the earth's horizontal field
    soft: Array  # (2,) along and across
    bias_radps: float  # of the gyro
    residual_rad: float  # deviation of the circles' headings from it
    apart: float  # hard iron of one circle less that of the other
    spread_rad: float  # standard deviation of a heading that is mended, rms over all headings

    def told(self, heading: Array) -> Array:
        """What the compass tells at these headings, rad."""
        return _told(self.hard, self.soft, heading)

    def mended(self, told: Array) -> Array:
        """The heading, but for the offset, of what the compass tells, rad."""
        grid = np.linspace(-np.pi, 3.0 * np.pi, 1441)
        every = np.unwrap(self.told(grid))
        away = np.mod(told - every[360], 2.0 * np.pi)
        return np.asarray(np.interp(every[360] + away, every, grid))

    @property
    def deviation_rad(self) -> float:
        """The most that a heading is bent, but for what is the same on all."""
        headings = np.radians(np.arange(0.0, 360.0, 5.0))
        off = _wrapped(self.told(headings) - headings)
        return float(np.abs(off - off.mean()).max())

    @property
    def hopeless(self) -> str:
        """Why no compass can be set at this place, in words; empty: it can."""
        hard = float(np.hypot(*self.hard)) / (1.0 - float(np.hypot(*self.soft)))
        if hard > HARD_MOST:
            return (
                f"the boat's own iron is {hard:.2f} of the earth's field, {HARD_MOST:g} at most: give the compass another place"
            )
        why = ""
        if self.apart > APART_MOST:
            why = f"one circle tells of another magnet than the other, by {self.apart:.0%} of the earth's field"
        elif self.residual_rad > RESIDUAL_MOST_RAD:
            why = (
                f"no magnet explains the headings: they are {np.degrees(self.residual_rad):.1f} degrees off what one would make"
            )
        return f"this place is magnetically hopeless: {why}; try again away from piers and other iron" if why else ""


class CompassFound(NamedTuple):
    """The five numbers of a compass, as `[compass]` has them but about true north."""

    hard: Array
    soft: Array
    offset_rad: float
    offset_spread_rad: float
    shape: CompassShape


def gyro_agrees(heading: Series, turn: Series) -> str:
    """Why the gyro cannot tell how far she turned, in words; empty: it can. Its sign is told, too."""
    if len(turn.at_s) < 2 or len(heading.at_s) < 2:
        return "there is no gyro: without one the circles do not tell how iron bends the headings"
    inside = (heading.at_s >= turn.at_s[0]) & (heading.at_s <= turn.at_s[-1])
    turned = np.diff(np.unwrap(heading.values[inside, 0]))
    by_gyro = np.diff(np.interp(heading.at_s[inside], turn.at_s, _summed(turn)))
    block = max(len(turned) // 40, 1)  # seconds: noise of single values falls out
    count = len(turned) // block * block
    turned, by_gyro = (each[:count].reshape(-1, block).sum(1) for each in (turned, by_gyro))
    if by_gyro @ by_gyro < AGREE**2 * (turned @ turned):
        return "the gyro says nothing of the turns that the compass tells"
    if turned @ by_gyro < -AGREE * (by_gyro @ by_gyro):
        return "the gyro says port where the compass says starboard: mend its sign first (delfim sensors --turn)"
    return ""


def shape_of(record: BoatRecord) -> CompassShape:
    """How iron bends headings, from the circles of a trial. Raises DelfimError, in words, where they do not tell."""
    spans = [each for each in record.manoeuvres if each.name == CIRCLES]
    if not spans:
        raise DelfimError("there are no circles in this record")
    heading, turn = _within(record.heading, spans[-1]), _within(record.turn, spans[-1])
    if why := gyro_agrees(heading, turn):
        raise DelfimError(why)
    way = np.interp(heading.at_s, turn.at_s, _summed(turn))
    top = int(np.argmax(np.abs(way - way[0])))
    there, back = abs(float(way[top] - way[0])), abs(float(way[-1] - way[top]))
    if min(there, back) < TURNED * 2.0 * np.pi:
        raise DelfimError(f"she turned by {np.degrees(there):.0f} and {np.degrees(back):.0f} degrees: whole circles are needed")
    rate = np.interp(heading.at_s, turn.at_s, turn.values[:, 0])
    every = _circled(heading, way, rate)
    halves = [_circled(Series(heading.at_s[part], heading.values[part]), way[part], rate[part]).numbers for part in _parts(top)]
    return CompassShape(
        every.numbers[:2],
        every.numbers[2:4],
        float(every.numbers[5]),
        every.residual_rad,
        float(np.hypot(*(halves[0][:2] - halves[1][:2]))),
        float(np.sqrt(0.5 * every.variances[:4].sum())),
    )


def _parts(top: int) -> tuple[slice, slice]:
    return slice(None, top), slice(top, None)


class _Circled(NamedTuple):
    """Hard iron, soft iron, first heading, bias of the gyro, lateness of the compass."""

    numbers: Array  # (7,)
    variances: Array  # (7,)
    residual_rad: float


def _circled(heading: Series, way: Array, rate: Array) -> _Circled:
    """Gauss and Newton with Huber's weights; the gyro has summed up `way`, rad, and turns at `rate`."""
    told, since_s = heading.values[:, 0], heading.at_s - heading.at_s[0]
    numbers = np.array([0.0, 0.0, 0.0, 0.0, told[0] - way[0], 0.0, 0.0])

    def off(numbers: Array) -> Array:
        psi = numbers[4] + way - numbers[5] * since_s - numbers[6] * rate
        return _wrapped(_told(numbers[:2], numbers[2:4], psi) - told)

    numbers[4] += float(np.angle(np.exp(-1j * off(numbers)).mean()))
    sigma, priors = np.radians(5.0), SPREADS**-2.0
    for _ in range(ROUNDS):
        away = off(numbers)
        slopes = np.stack([(off(numbers + nudge) - away) / 1e-5 for nudge in 1e-5 * np.eye(7)], 1)
        weights = np.minimum(1.0, HUBER * sigma / np.maximum(np.abs(away), 1e-9)) / sigma**2
        normal = (slopes * weights[:, None]).T @ slopes + np.diag(priors)
        step = np.linalg.solve(normal, -(slopes * weights[:, None]).T @ away - priors * numbers)
        numbers = numbers + np.clip(step, -0.3, 0.3)
        sigma = max(1.4826 * float(np.median(np.abs(off(numbers)))), HEADING_RAD)
        if np.abs(step).max() < 1e-5:
            break
    away = off(numbers)
    return _Circled(numbers, np.diag(np.linalg.inv(normal)).copy(), float(np.sqrt(np.mean(away**2))))


def compass_of(record: BoatRecord) -> CompassFound:
    """All five numbers, from the circles and from what came behind them. Raises DelfimError, in words."""
    shape = shape_of(record)
    offset, spread = _offset(record, shape)
    c, s = np.cos(offset), np.sin(offset)
    turn = np.array([[c, -s], [s, c]])
    ellipse = np.array([[shape.soft[0], shape.soft[1]], [shape.soft[1], -shape.soft[0]]])
    ellipse = turn @ ellipse @ turn.T
    return CompassFound(turn @ shape.hard, ellipse[0], offset, spread, shape)


def _offset(record: BoatRecord, shape: CompassShape) -> tuple[float, float]:
    """What the compass tells too much, with its deviation: on straight ways the velocity through the water has no part across
    the keel, but for the drift that wind makes, which is one with the current."""
    at_s, velocity = record.velocity.at_s, record.velocity.values
    mended = np.interp(at_s, record.heading.at_s, np.unwrap(shape.mended(record.heading.values[:, 0])))
    rate = np.interp(at_s, record.turn.at_s, record.turn.values[:, 0]) - shape.bias_radps
    after_s = at_s - np.maximum.accumulate(np.where(np.abs(rate) > STRAIGHT_RADPS, at_s, at_s[0]))
    chosen = (after_s > SETTLED_S) & (np.hypot(*velocity.T) > UNDER_WAY_MPS) & (at_s <= record.heading.at_s[-1])
    if chosen.sum() < LEGS_LEAST:
        raise DelfimError("no straight ways under way: the course over ground says nothing of the compass' offset")
    mended, rate, north, east = mended[chosen], rate[chosen], velocity[chosen, 0], velocity[chosen, 1]
    numbers, sigma = np.zeros(4), 0.3  # offset, current north and east, the antenna ahead of the turning point
    spreads = np.array([np.inf, 0.5, 0.5, 1.0])
    for _ in range(ROUNDS):
        c, s = np.cos(mended - numbers[0]), np.sin(mended - numbers[0])
        north_w, east_w = north - numbers[1], east - numbers[2]
        away = east_w * c - north_w * s - numbers[3] * rate
        slopes = np.stack([east_w * s + north_w * c, s, -c, -rate], 1)
        weights = np.minimum(1.0, HUBER * sigma / np.maximum(np.abs(away), 1e-9)) / sigma**2
        normal = (slopes * weights[:, None]).T @ slopes + np.diag(spreads**-2.0)
        step = np.linalg.solve(normal, -(slopes * weights[:, None]).T @ away - spreads**-2.0 * numbers)
        numbers = numbers + step
        sigma = max(1.4826 * float(np.median(np.abs(away))), 0.02)
        if np.abs(step).max() < 1e-6:
            break
    return float(_wrapped(numbers[:1])[0]), float(np.sqrt(np.linalg.inv(normal)[0, 0]))


def motors_turn(record: BoatRecord, shape: CompassShape) -> float:
    """How far the motors at full power turn the compass, rad at the most: what the mended heading does against the gyro while
    their power changes, as of a magnet that grows with it."""
    at_s = record.heading.at_s
    power = np.interp(at_s, record.told.at_s, np.abs(record.told.values).mean(1))
    turned = np.interp(at_s, record.turn.at_s, _summed(record.turn)) - shape.bias_radps * (at_s - at_s[0])
    off = np.unwrap(shape.mended(record.heading.values[:, 0])) - turned
    heading = turned + float(np.median(off))  # without the noise of the compass
    rate = np.interp(at_s, record.turn.at_s, record.turn.values[:, 0])  # of a compass that is late
    columns = np.stack([-np.sin(heading) * power, -np.cos(heading) * power, rate], 1)  # of hard iron, ahead and to starboard
    piece = ((at_s - at_s[0]) / PIECE_S).astype(int)
    for each in np.unique(piece):
        here = piece == each
        off[here] -= off[here].mean()
        columns[here] -= columns[here].mean(0)
    found, sigma = np.zeros(3), np.radians(5.0)
    for _ in range(5):
        away = np.abs(off - columns @ found)
        weights = np.minimum(1.0, HUBER * sigma / np.maximum(away, 1e-9)) / sigma**2
        normal = (columns * weights[:, None]).T @ columns + np.diag(MOTORS_SPREADS**-2.0)
        found = np.linalg.solve(normal, columns.T @ (weights * off))
        sigma = max(1.4826 * float(np.median(np.abs(off - columns @ found))), HEADING_RAD)
    return float(np.hypot(*found[:2]))


def told(record: BoatRecord) -> Iterator[str]:
    """What the compass alone says, a sentence each."""
    try:
        found = compass_of(record)
    except DelfimError as error:
        yield f"compass alone: {error}"
        return
    offset, spread, bent = np.degrees([found.offset_rad, found.offset_spread_rad, found.shape.deviation_rad])
    yield f"compass alone: off by {offset:.1f} ±{spread:.1f} degrees, bent by {bent:.1f} at most, by circles and straight ways"
    if (turned := motors_turn(record, found.shape)) > MOTORS_MOST_RAD:
        yield f"motors at full power turn the compass by {np.degrees(turned):.0f} degrees: lead their cables away from it"


def _told(hard: Array, soft: Array, heading: Array) -> Array:
    names = "hard_ahead", "hard_aside", "soft_along", "soft_across", "compass_offset"
    numbers: dict[str, Any] = dict(zip(names, (*hard, *soft, 0.0), strict=True))
    return said(numbers, heading)


def _summed(turn: Series) -> Array:
    """How far the gyro says that she turned since its first value, rad."""
    steps = 0.5 * (turn.values[1:, 0] + turn.values[:-1, 0]) * np.diff(turn.at_s)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _within(series: Series, span: Manoeuvre) -> Series:
    inside = (series.at_s >= span.from_s) & (series.at_s <= span.to_s)
    return Series(series.at_s[inside], series.values[inside])


def _wrapped(angle: Array) -> Array:
    return np.asarray(np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi)
