"""The last, dumb gate before the thrusters: value, rate, and that a stop is immediate. Pure."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from delfim.base.geodesy import wrap
from delfim.config import ThrusterTable
from delfim.vehicle.state import Actuation

_new = tuple.__new__  # half the time of Actuation(...)


class TurnLimits(NamedTuple):
    """The limits of a thruster that turns."""

    row: int  # which one
    most_rad: float  # to either side; pi: all round
    rate_radps: float
    forbidden: tuple[tuple[float, float], ...]  # sectors, rad, in which it gives no thrust


class GateLimits:
    """The limits of the rows of a vehicle's file."""

    def __init__(self, rows: Sequence[ThrusterTable]) -> None:
        self.still = Actuation((0.0,) * len(rows), (0.0,) * len(rows), False)
        self.rates_per_s = tuple(row.rate_per_s for row in rows)
        self.turning = tuple(
            TurnLimits(
                index,
                math.radians(row.steer.angle_max_deg),
                math.radians(row.steer.rate_dps),
                tuple((math.radians(start), math.radians(end)) for start, end in row.steer.forbidden_deg),
            )
            for index, row in enumerate(rows)
            if row.steer is not None
        )


def limited(wanted: Actuation, previous: Actuation, limits: GateLimits, dt_s: float) -> Actuation:
    """`wanted` within -1..1 and the greatest angles, changed from `previous` by no more than the rates allow. A stop is
    immediate and leaves angles as they are; so is a value that is not finite, and a command that misses a thruster."""
    thrust, _, run = wanted
    rates = limits.rates_per_s
    if not run or len(thrust) != len(rates) or not math.isfinite(sum(thrust, dt_s)):
        return limits.still._replace(angle_rad=previous.angle_rad) if limits.turning else limits.still
    if dt_s < 0.0:
        dt_s = 0.0
    sent: list[float] = []
    for row, was in enumerate(previous.thrust):  # plain statements: this is on the critical path
        part, change = thrust[row], rates[row] * dt_s
        if part - was > change:
            part = was + change
        elif was - part > change:
            part = was - change
        sent.append(-1.0 if part < -1.0 else 1.0 if part > 1.0 else part)
    if limits.turning:
        return _turned(wanted, previous, limits, dt_s, sent)
    return _new(Actuation, (tuple(sent), previous.angle_rad, True))


def _turned(wanted: Actuation, previous: Actuation, limits: GateLimits, dt_s: float, sent: list[float]) -> Actuation:
    """The same for the angles. A thruster in a forbidden sector, on its way through, gives no thrust."""
    asked, angles = wanted.angle_rad, list(previous.angle_rad)
    if len(asked) != len(angles) or not math.isfinite(sum(asked)):
        return limits.still._replace(angle_rad=previous.angle_rad)
    for row, most, rate, forbidden in limits.turning:
        was, change = angles[row], rate * dt_s
        if most >= math.pi:
            now = wrap(was + min(max(wrap(asked[row] - was), -change), change))
        else:
            now = min(max(asked[row], was - change, -most), was + change, most)
        angles[row] = now
        if any(start < now < end for start, end in forbidden):
            sent[row] = 0.0
    return _new(Actuation, (tuple(sent), tuple(angles), True))
