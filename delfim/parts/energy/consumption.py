"""The power that the boat draws by its push, learnt while it sails. Push is told as the speed that it gives in still water.

The file's guess is idle + full (push / full push)^1.5: the push that the file's drag takes at that speed, and the power of a
propeller. What the batteries told, and what the guess was at the same seconds, is kept in bins of speed, forgotten within half
an hour. What the motors drew over the guess is taken to be a power of the speed, a (v / full)^b: least squares of the bins,
with a prior, so that a boat that never sailed has an answer, and one that sailed at 1 m/s has one for 1.5.
"""

import math
from typing import Final

BINS: Final = 20  # of speed, up to that of full push
FORGET_S: Final = 1800.0
DOUBT: Final = 1.0  # of the guess: ln a, and ...
SHAPE: Final = 0.7  # ... b
NOISE: Final = 0.1  # of what was told within ALIKE_S, of which no bin counts more than MOST
ALIKE_S: Final = 10.0
MOST: Final = 20.0
LEAST_W: Final = 1.0
MOST_MPS: Final = 50.0  # what no boat does is not learnt
MOST_W: Final = 1e7
LAW: Final = 1.5  # power for thrust of a propeller in still water (momentum theory)


class Propulsive:
    """The hull as the energy needs it: push and speed in still water, as the vehicle's file has them.

    drag: N per m/s, and N per (m/s)^2; `ahead_n`: of all thrusters at full command."""

    def __init__(self, drag: tuple[float, float], ahead_n: float) -> None:
        self._linear, self._square = drag
        self.ahead_n = max(ahead_n, 1e-3)
        self.full_mps = max(self.still_mps(1.0), 0.1)

    def push(self, still_mps: float) -> float:
        """The part of full push that keeps this speed."""
        return (self._linear + self._square * still_mps) * still_mps / self.ahead_n

    def still_mps(self, push: float) -> float:
        """The speed that this part of full push keeps; 0 for a push astern."""
        force_n = max(push, 0.0) * self.ahead_n
        root = math.sqrt(self._linear * self._linear + 4.0 * self._square * force_n)
        return 2.0 * force_n / (self._linear + root) if force_n and root else 0.0


class Consumption:
    """The cost of a call is bounded, and no float makes it raise."""

    def __init__(self, hull: Propulsive, idle_w: float, full_w: float) -> None:
        self._hull, self._idle_w, self._full_w = hull, idle_w, max(full_w, LEAST_W)
        self._bins = [(0.0, 0.0, 0.0)] * (BINS + 1)  # s, J, J of the motors by the guess
        self._a, self._b = 0.0, 0.0  # ln a
        self._spread = DOUBT**2, 0.0, SHAPE**2  # variances of both, and between them their covariance
        self.learnt_s = 0.0  # for how long the batteries told

    def learn(self, speed_mps: float, watts: float, dt_s: float) -> None:
        """The boat drew this power at this still-water speed for this long; 0: its motors rested."""
        if not (0.0 <= speed_mps < MOST_MPS and 0.0 <= watts < MOST_W and dt_s > 0.0):
            return
        keep, dt_s = math.exp(-dt_s / FORGET_S), min(dt_s, 10.0)
        index = min(round(speed_mps / self._hull.full_mps * BINS), BINS) if speed_mps else 0
        seconds, joules, guess = self._bins[index]
        motors_w = self._motors_w(speed_mps) if index else 0.0
        self._bins[index] = seconds * keep + dt_s, joules * keep + watts * dt_s, guess * keep + motors_w * dt_s
        self.learnt_s += dt_s
        if not index:
            self._idle_w = self._bins[0][1] / self._bins[0][0]
        self._fit()

    def _fit(self) -> None:
        """Two unknowns of the bins under way."""
        one, x1, xx, y1, xy = 1.0 / DOUBT**2, 0.0, 1.0 / SHAPE**2, 0.0, 0.0
        for index, (seconds, joules, guess) in enumerate(self._bins[1:], 1):
            if seconds:
                counts = min(seconds / ALIKE_S, MOST) / NOISE**2
                x, y = math.log(index / BINS), math.log(max(joules - self._idle_w * seconds, LEAST_W * seconds) / guess)
                one, x1, xx, y1, xy = one + counts, x1 + counts * x, xx + counts * x * x, y1 + counts * y, xy + counts * x * y
        both = one * xx - x1 * x1
        self._b = (one * xy - x1 * y1) / both
        self._a, self._spread = (y1 - self._b * x1) / one, (xx / both, -x1 / both, one / both)

    def _motors_w(self, speed_mps: float) -> float:
        """The file's guess."""
        return max(self._full_w * math.pow(min(self._hull.push(speed_mps), 1.0), LAW), 1e-3)

    def watts(self, speed_mps: float) -> float:
        """The power at this still-water speed, W; beyond that of full push that of full push."""
        share = self._share(speed_mps)
        return self._idle_w + self._motors_w(share * self._hull.full_mps) * math.exp(self._a + self._b * math.log(share))

    def off(self, speed_mps: float) -> float:
        """The standard deviation of that, as a part of it."""
        x, (aa, ab, bb) = math.log(self._share(speed_mps)), self._spread
        return math.sqrt(max(aa + 2.0 * ab * x + bb * x * x, 0.0))

    def _share(self, speed_mps: float) -> float:
        return min(max(speed_mps / self._hull.full_mps, 0.5 / BINS), 1.0)
