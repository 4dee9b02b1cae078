"""The navigation window: when the next message of navigation is due, and for how long the loop may be held for it."""

from collections import deque
from itertools import accumulate, pairwise
from math import inf
from typing import Final

ARRIVALS: Final = 16  # the rhythm of a source is taken from this many last messages
ARRIVALS_MIN: Final = 5  # fewer say nothing
MISSES_MAX: Final = 3  # windows in a row without their message; then there are none until messages come again
FORGET_PERIODS: Final = 4.0  # a source silent for so long starts anew
RATE_CHANGE: Final = 0.25  # of the period, by which the last four intervals all have to differ
IRREGULAR: Final = 0.125  # of the period: a source that scatters more is not periodic
HOLD_MAX_S: Final = 0.01  # the longest time that the loop is ever held


class Rhythm:
    """Period and phase of one source, from its last arrivals alone: older ones are forgotten.

    Order statistics throughout: a late, missing or additional message moves them little. Drift is followed.
    """

    def __init__(self) -> None:
        self._times_s: deque[float] = deque(maxlen=ARRIVALS)
        self.period_s = inf
        self.spread_s = 0.0  # four of five messages come within this of when they are due
        self.next_s = inf  # when the next message is due; infinite where there is no rhythm
        self.misses = 0  # windows in a row

    def arrived(self, at_s: float) -> None:
        """Note that a message came at this monotonic time."""
        times_s = self._times_s
        if times_s and at_s - times_s[-1] > FORGET_PERIODS * self.period_s:
            times_s.clear()
        times_s.append(at_s)
        self.misses = 0
        self.next_s = self.period_s = inf
        if len(times_s) >= ARRIVALS_MIN:
            self._estimate()

    def missed(self) -> None:
        """Note that a window passed without its message."""
        self.misses += 1
        self.next_s = self.next_s + self.period_s if self.misses < MISSES_MAX else inf

    def _estimate(self) -> None:
        times_s = self._times_s
        gaps_s = [later - sooner for sooner, later in pairwise(times_s)]
        typical_s = _quartile(gaps_s)
        if all(abs(gap_s - typical_s) > RATE_CHANGE * typical_s for gap_s in gaps_s[1 - ARRIVALS_MIN :]):
            gaps_s = gaps_s[1 - ARRIVALS_MIN :]
            typical_s = _quartile(gaps_s)
            while len(times_s) > ARRIVALS_MIN:
                times_s.popleft()
        if typical_s <= 0.0:
            return
        turns = list(accumulate((round(gap_s / typical_s) for gap_s in gaps_s), initial=0))
        half = len(turns) // 2
        halves = zip(range(half, len(turns)), range(half + 1), strict=False)
        periods_s = [(times_s[j] - times_s[i]) / (turns[j] - turns[i]) for j, i in halves if turns[j] > turns[i]]
        if not periods_s:
            return
        period_s = _median(periods_s)
        phases_s = [at_s - turn * period_s for at_s, turn in zip(times_s, turns, strict=True)]
        phase_s = _median(phases_s)
        self.spread_s = sorted(abs(each_s - phase_s) for each_s in phases_s)[len(phases_s) * 4 // 5]
        if self.spread_s <= IRREGULAR * period_s:
            self.period_s = period_s
            self.next_s = phase_s + (turns[-1] + 1) * period_s


class NavigationWindow:
    """Computes when to hold the loop for navigation. Monotonic times in, next window out; it never looks at a clock itself.

    guard_s: a window opens so long before its message is due, and longer for a source that scatters, but never longer than
    HOLD_MAX_S / 2 nor than the share allows. A callback that begins before the window must end before the message comes, so
    it should be no less than the callback budget.
    share_max: part of one processor, 0..1, that all windows together may use; 0: no windows. Over any time t the loop is held
    for no longer than share_max * t + HOLD_MAX_S.
    """

    def __init__(self, guard_s: float, share_max: float) -> None:
        self.opens_s = inf  # of the next window
        self.due_s = inf  # when its message should come
        self.hits = 0  # windows in which the message came
        self.misses = 0  # windows in which it did not
        self.late = 0  # windows that were over before the loop was free to hold them
        self.spent_s = 0.0  # held altogether
        self._guard_s, self._share_max = guard_s, share_max
        self._rhythms: dict[int, Rhythm] = {}
        self.awaited = -1  # the source whose window is next
        self._due: Rhythm | None = None  # and its rhythm
        self._closes_s = -inf
        self._is_open = False
        self._credit_s, self._credit_at_s = HOLD_MAX_S, inf  # the budget left, and when it was computed

    def arrived(self, source: int, at_s: float) -> None:
        """Note that a navigation message was complete at this time."""
        rhythm = self._rhythms.setdefault(source, Rhythm())
        if self._is_open and rhythm is self._due:
            self._is_open = False
            self.hits += 1
        rhythm.arrived(at_s)
        if not self._is_open:
            self._plan()

    def forget(self, source: int) -> None:
        """Forget a source that exists no longer."""
        rhythm = self._rhythms.pop(source, None)
        if rhythm is self._due:
            self._is_open = False
        if not self._is_open:
            self._plan()

    def open(self, now_s: float) -> float:
        """Open the window: the loop is held from now on. Returns until when, at most: while `is_open`."""
        earned_s = max(0.0, now_s - self._credit_at_s) * self._share_max
        self._credit_s, self._credit_at_s = min(self._credit_s + earned_s, HOLD_MAX_S), now_s
        self._is_open = True
        return min(self._closes_s, now_s + self._credit_s)

    @property
    def is_open(self) -> bool:
        """Whether the message is still awaited."""
        return self._is_open

    def close(self, opened_s: float, now_s: float) -> None:
        """Close the window: the loop is let go."""
        self.spent_s += now_s - opened_s
        self._credit_s = max(self._credit_s - (now_s - opened_s), -HOLD_MAX_S)  # no windows are owed for time asleep
        if self._is_open and self._due:
            self._is_open = False
            if opened_s < self._closes_s:
                self.misses += 1
            else:
                self.late += 1
            self._due.missed()
        self._plan()

    def report(self) -> dict[str, object]:
        """The report, JSON-ready: periods and scatter of the sources, windows with and without their message, time held."""
        steady = [rhythm for rhythm in self._rhythms.values() if rhythm.next_s < inf]
        return {
            "periods_s": [round(rhythm.period_s, 6) for rhythm in steady],
            "spreads_s": [round(rhythm.spread_s, 6) for rhythm in steady],
            "hits": self.hits,
            "misses": self.misses,
            "late": self.late,
            "spent_s": round(self.spent_s, 3),
        }

    def _plan(self) -> None:
        """Choose the window that opens first. A source that scatters more than a window can cover has none."""
        self.opens_s = inf
        for source, rhythm in self._rhythms.items():
            allowed_s = min(self._share_max * rhythm.period_s, HOLD_MAX_S / 2)
            early_s = min(self._guard_s + 2.0 * rhythm.spread_s, allowed_s)
            if rhythm.next_s - early_s < self.opens_s and rhythm.spread_s < early_s:
                self.awaited, self._due, self.due_s = source, rhythm, rhythm.next_s
                self.opens_s, self._closes_s = rhythm.next_s - early_s, rhythm.next_s + early_s


def _median(values: list[float]) -> float:
    """The upper of the two middle values: their mean would belong to neither."""
    return sorted(values)[len(values) // 2]


def _quartile(values: list[float]) -> float:
    """The lower quartile: the gap between two messages, even where every third one is missing."""
    return sorted(values)[len(values) // 4]
