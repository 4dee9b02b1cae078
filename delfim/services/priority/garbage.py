"""Collects garbage as the interpreter would, but in quiet time; if there is none, when it is long overdue."""

import asyncio
import gc
from typing import Final

from delfim.base.clock import Clock
from delfim.services.priority.window import NavigationWindow

COLLECT_EVERY_S: Final = 0.1  # garbage is looked for so often ...
COLLECT_QUIET_S: Final = 0.002  # ... and collected when no navigation is due for so long ...
COLLECT_AGAIN_S: Final = 0.003  # ... otherwise looked for again: ten looks a second may all come just before navigation ...
OVERDUE: Final = 10  # ... or when there is this many times more than the interpreter's threshold


class Collector:
    """Collects garbage; it begins with `tick`, which comes again by itself."""

    def __init__(self, window: NavigationWindow, clock: Clock) -> None:
        self._window, self._clock = window, clock
        self._collections, self._longest_s = 0, 0.0
        self._took_s = [0.0, 0.0, 0.0]  # the last one of each generation

    def tick(self) -> None:
        asyncio.get_running_loop().call_later(self._look(), self.tick)

    def _look(self) -> float:
        """Collect if it is time for it. Returns how long until the next look, s."""
        counts, thresholds = gc.get_count(), gc.get_threshold()
        if gc.isenabled() or counts[0] <= thresholds[0]:
            return COLLECT_EVERY_S
        generation = 2 if counts[2] > thresholds[2] else 1 if counts[1] > thresholds[1] else 0
        began_s = self._clock.monotonic_s()
        quiet_s = self._window.opens_s - began_s
        if quiet_s <= 2 * self._took_s[generation] + COLLECT_QUIET_S and counts[0] <= OVERDUE * thresholds[0]:
            return COLLECT_AGAIN_S
        gc.collect(generation)
        self._collections += 1
        self._took_s[generation] = spent_s = self._clock.monotonic_s() - began_s
        self._longest_s = max(self._longest_s, spent_s)
        return COLLECT_EVERY_S

    def report(self) -> dict[str, object]:
        """The report, JSON-ready."""
        return {"collections": self._collections, "longest_collection_s": round(self._longest_s, 6)}
