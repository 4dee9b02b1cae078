"""Profiling (thesis 2.12, 3.5): the histogram of figure 3-10 and the stage means of figure 3-11, kept while sailing."""

from bisect import bisect_left
from itertools import accumulate
from operator import sub

from delfim.vehicle.report import LatencyFacts
from delfim.vehicle.state import Profile

# Upper edges in microseconds: 1 us wide up to 500 us, then 5 % wide up to 10 s.
EDGES_US = [*range(1, 501), *accumulate([1.05] * 205, lambda edge, ratio: edge * ratio, initial=525.0)]
# The bars that are shown: ten a decade from 10 us on, the last one without an upper edge.
_BARS = [*(bisect_left(EDGES_US, 10.0 * 10.0 ** (k / 10)) for k in range(60)), len(EDGES_US) - 1]
_BARS_US = [round(float(EDGES_US[last]), 1) for last in _BARS]
LONGEST_NS = 10_000_000_000  # the end of the histogram; no cycle takes longer without the dead-man
STAGES = ("poll", "navigation", "control", "propulsion", "log")


class Latency:
    """Distribution of t0 to t4, the critical path. Adding costs a microsecond and is done after the path ends.

    The first `skipped` cycles do not count: a program that has just come up would be the worst case of the whole run."""

    def __init__(self, skipped: int = 0) -> None:
        self._skipped = skipped
        self.counts = [0] * (len(EDGES_US) + 1)
        self.n = 0
        self.worst_us = 0.0
        self._sums_ns = [0] * len(STAGES)

    def add(self, p: Profile) -> None:
        """One cycle. An impossible path (the wall clock was stepped in between) is not counted."""
        t0, t1, t2, t3, t4, t5 = p
        path_ns = t4 - t0
        if not 0 <= path_ns <= LONGEST_NS or t0 == 0:
            return
        if self._skipped:
            self._skipped -= 1
            return
        path_us = path_ns / 1e3
        self.n += 1
        self.counts[bisect_left(EDGES_US, path_us)] += 1
        if path_us > self.worst_us:
            self.worst_us = path_us
        if t1 < t0:  # the loop may have been awake before the last frame came
            t1 = t0
        sums = self._sums_ns
        sums[0] += t1 - t0
        sums[1] += t2 - t1
        sums[2] += t3 - t2
        sums[3] += t4 - t3
        sums[4] += t5 - t4

    def percentile_us(self, part: float, totals: list[int] | None = None) -> float:
        """The path that `part` (0..1) of all cycles did not exceed, to the histogram's resolution; 0 before the first.
        `totals` are the counts added up, where that is done already."""
        index = bisect_left(totals or list(accumulate(self.counts)), part * self.n)
        return min(float(EDGES_US[index]), self.worst_us) if index < len(EDGES_US) else self.worst_us

    def within(self, limit_us: float) -> float:
        """Share of cycles that took at most this long, 0..1."""
        return sum(self.counts[: bisect_left(EDGES_US, limit_us) + 1]) / self.n if self.n else 0.0

    def facts(self) -> LatencyFacts:
        """Count, percentiles, share within 100 us, means of the stages, and the bars of figure 3-10; the first starts at 0."""
        means = [sum_ns / 1e3 / self.n if self.n else 0.0 for sum_ns in self._sums_ns]
        totals = list(accumulate(self.counts))  # once: consoles ask five times a second
        upto = [totals[last] for last in _BARS]
        return LatencyFacts(
            n=self.n,
            p50_us=round(self.percentile_us(0.5, totals), 1),
            p99_us=round(self.percentile_us(0.99, totals), 1),
            p999_us=round(self.percentile_us(0.999, totals), 1),
            worst_us=round(self.worst_us, 1),
            within_100_us=round(self.within(100.0), 5),
            stages_us={name: round(mean, 2) for name, mean in zip(STAGES, means, strict=True)},
            histogram=tuple([bar for bar in zip(_BARS_US, map(sub, upto, [0, *upto]), strict=False) if bar[1]]),
        )
