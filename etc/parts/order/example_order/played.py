"""The winch in simulation: five times a second it says how much rope is out."""

import struct
from typing import Any

from delfim.api import Frame, Vehicle
from example_order import WinchTable
from example_order.winch import OUT, WANTED


class PlayedWinch:
    def __init__(self, interface: str) -> None:
        self.interface, self.hears, self.due_s = interface, (WANTED,), 0.0
        self._out_m, self._wanted_m, self._rate_mps = 0.0, 0.0, 0.5

    def feed(self, frame: Frame, now_s: float) -> None:
        """A frame of the boat."""
        self._wanted_m, self._rate_mps = struct.unpack("<ff", frame.data)

    def step(self, now_s: float, utc_ns: int) -> list[Frame]:
        """What it says now."""
        if now_s < self.due_s:
            return []
        self.due_s, most_m = now_s + 0.2, 0.2 * self._rate_mps
        self._out_m += max(-most_m, min(self._wanted_m - self._out_m, most_m))
        return [Frame(OUT.arb, struct.pack("<f", self._out_m))]


def devices_of(settings: Vehicle, model: Any, seed: int) -> PlayedWinch | None:
    return PlayedWinch(settings.of(WinchTable).interface) if "example_order" in settings.sensors.names else None
