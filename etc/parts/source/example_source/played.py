"""The compass in simulation: it measures the simulated boat five times a second and tells what the real one would."""

import math
from typing import Any

from delfim.api import Vehicle, from_plane

PERIOD_S = 0.2


class PlayedCompass:
    def __init__(self, model: Any) -> None:
        self._model, self.due_s, self._number = model, 0.0, 0

    def step(self, now_s: float) -> tuple[float, ...] | None:
        """What it measures now; None while nothing is due."""
        if now_s < self.due_s:
            return None
        self.due_s = now_s + PERIOD_S
        self._number += 1
        model = self._model
        angles = map(math.degrees, (*from_plane(model.origin, model.north_m, model.east_m), model.heading_rad))
        return *angles, model.north_mps, model.east_mps, self._number

    def say(self, measured: tuple[float, ...], utc_ns: int) -> bytes:
        return b"%.9f %.9f %.3f %.3f %.3f %d\n" % measured


def instrument_of(settings: Vehicle, model: Any, seed: int) -> PlayedCompass:
    return PlayedCompass(model)
