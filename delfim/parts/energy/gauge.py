"""What a joule of the volts and amperes takes of the charge that the batteries tell: an old battery holds less than its file
says, a full one gives more volts than an empty one, the emptier side counts, and no ammeter is quite right."""

import math
from typing import Final

PRIOR: Final = 0.1  # of the capacity: so much counts as taken joule for joule before anything was told, and is forgotten
FORGET: Final = 0.25  # of the capacity
JUMP: Final = 0.03  # of it: what changes by more at once was changed by somebody
BOUNDS: Final = 0.6, 1.6


class Gauge:
    """Only `learn` changes it; no float makes it raise."""

    def __init__(self, capacity_wh: float) -> None:
        self._whole_j = max(capacity_wh, 1e-3) * 3600.0
        self._drawn_j = self._taken_j = PRIOR * self._whole_j
        self._was_j: float | None = None
        self.per = 1.0  # joules of the charge for each that is drawn

    def learn(self, left_wh: float | None, watts: float | None, dt_s: float) -> None:
        """The batteries held so much, and gave this power for so long. None: not told."""
        if left_wh is None or watts is None:
            self._was_j = None
            return
        left_j, was_j = left_wh * 3600.0, self._was_j
        self._was_j = left_j
        if was_j is None or not (abs(was_j - left_j) <= JUMP * self._whole_j and 0.0 <= watts * dt_s <= JUMP * self._whole_j):
            return
        keep = math.exp(-watts * dt_s / (FORGET * self._whole_j))
        self._drawn_j, self._taken_j = self._drawn_j * keep + watts * dt_s, self._taken_j * keep + was_j - left_j
        self.per = min(max(self._taken_j / max(self._drawn_j, 1e-3), BOUNDS[0]), BOUNDS[1])
