"""Margins of the loops of heading and speed: how much later, or stronger, the boat may be than was found before she swings.

A loop is p + d s + i / s of the error, late by a dead time, through a motor that lags, into a mass (or an inertia) with
damping: K. J. Astrom, R. M. Murray, Feedback Systems, 2008, 9.3.
"""

import cmath
import math
from typing import NamedTuple

FROM_RADPS, TO_RADPS, STEPS = 0.02, 30.0, 300


class Margins(NamedTuple):
    """The least of a loop: phase, deg, and gain, as a factor."""

    phase_deg: float
    gain: float

    def holds(self, least: tuple[float, float]) -> bool:
        """Whether they are these or more."""
        return self.phase_deg >= least[0] and self.gain >= least[1]


class Loop(NamedTuple):
    """A loop, SI units. `poles` at the origin: 1 of a speed, 2 of a heading."""

    p: float
    i: float
    d: float
    mass: float
    damping: float
    lag_s: float
    dead_s: float
    poles: int

    def at(self, w: float) -> complex:
        """Its gain at this frequency, rad/s."""
        s = 1j * w
        controller = self.p + self.i / s + self.d * s
        return (
            controller
            * cmath.exp(-s * self.dead_s)
            / ((self.lag_s * s + 1.0) * (self.mass * s + self.damping) * s ** (self.poles - 1))
        )

    @property
    def margins(self) -> Margins:
        """With the phase followed from low frequencies, where the loop is strong."""
        step = (TO_RADPS / FROM_RADPS) ** (1.0 / STEPS)
        phase_deg, gain, before = 180.0, math.inf, self.at(FROM_RADPS)
        at_deg = math.degrees(cmath.phase(before))
        if at_deg > 90.0:  # of an integral before two poles: -180 deg and a little less
            at_deg -= 360.0
        for index in range(1, STEPS + 1):
            now = self.at(FROM_RADPS * step**index)
            was_deg, at_deg = at_deg, at_deg + math.degrees(cmath.phase(now / before))
            if (abs(before) - 1.0) * (abs(now) - 1.0) <= 0.0:
                phase_deg = min(phase_deg, 180.0 + at_deg)
            if was_deg > -180.0 >= at_deg and abs(now) < 1.0:
                gain = min(gain, 1.0 / abs(now))
            elif was_deg > -180.0 >= at_deg:
                gain = 0.0
            before = now
        return Margins(phase_deg, gain)
