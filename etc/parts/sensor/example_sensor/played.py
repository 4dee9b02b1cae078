"""The thermometer in simulation: once a second, warmer to the north."""

from typing import Any

from delfim.api import Vehicle


class PlayedThermometer:
    def __init__(self, model: Any) -> None:
        self._model, self.due_s = model, 0.0

    def step(self, now_s: float) -> float | None:
        """What it measures now; None while nothing is due."""
        if now_s < self.due_s:
            return None
        self.due_s = now_s + 1.0
        return 18.0 + 0.01 * float(self._model.north_m)

    def say(self, water_c: float, utc_ns: int) -> bytes:
        return b"%.2f\n" % water_c


def instrument_of(settings: Vehicle, model: Any, seed: int) -> PlayedThermometer:
    return PlayedThermometer(model)
