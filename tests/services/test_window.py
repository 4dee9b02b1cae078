"""The estimator of the navigation window: arrival times in, windows out. No clock, no loop."""

import random
from itertools import accumulate, pairwise
from math import inf
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.services.priority.window import HOLD_MAX_S, MISSES_MAX, NavigationWindow

GUARD_S, SHARE = 0.0006, 0.1


class Held(NamedTuple):
    """One time that the loop was held."""

    from_s: float
    to_s: float


def sail(window: NavigationWindow, arrivals: list[tuple[float, int]], end_s: float = 0.0) -> tuple[list[bool], list[Held]]:
    """What a loop without any other work does with these (time, source): for each, whether it came into a window; all holds."""
    hits, held, now_s, opened_s, until_s = list[bool](), list[Held](), 0.0, 0.0, 0.0

    def close(at_s: float) -> float:
        window.close(opened_s, at_s)
        held.append(Held(opened_s, at_s))
        return at_s

    for at_s, source in [*sorted(arrivals), (end_s, -1)]:
        while window.is_open or window.opens_s < at_s:
            if not window.is_open:
                now_s = opened_s = max(window.opens_s, now_s)
                until_s = max(window.open(now_s), now_s)
            if until_s >= at_s and source >= 0:
                break
            now_s = close(until_s)
        now_s = max(now_s, at_s)
        if source >= 0:
            was_open, before = window.is_open, window.hits
            window.arrived(source, at_s)
            hits.append(window.hits > before)
            if was_open and not window.is_open:
                close(now_s)
    return hits, held


def one_source(times_s: list[float], source: int = 1) -> list[tuple[float, int]]:
    return [(at_s, source) for at_s in times_s]


def steady(period_s: float, n: int, start_s: float = 10.0) -> list[float]:
    return [start_s + i * period_s for i in range(n)]


@pytest.mark.parametrize("rate_hz", [1, 5, 20, 100, 500])
def test_a_steady_source_is_met_from_the_fifth_message_on(rate_hz: int) -> None:
    hits, _ = sail(NavigationWindow(GUARD_S, SHARE), one_source(steady(1 / rate_hz, 100)))
    assert hits == [False] * 5 + [True] * 95


@pytest.mark.parametrize("rate_hz", [1, 5, 20])
def test_jitter_widens_the_window_until_it_meets_nearly_all(rate_hz: int) -> None:
    noise = random.Random(1)
    times_s = [at_s + noise.gauss(0.0, 0.0005) for at_s in steady(1 / rate_hz, 1000)]
    hits, _ = sail(NavigationWindow(GUARD_S, SHARE), one_source(times_s))
    assert sum(hits) > 950


def test_a_source_without_rhythm_has_no_window() -> None:
    noise = random.Random(2)
    times_s = list(accumulate((noise.expovariate(10.0) for _ in range(2000)), initial=10.0))
    hits, held = sail(NavigationWindow(GUARD_S, SHARE), one_source(times_s))
    assert sum(hits) < 20
    assert sum(hold.to_s - hold.from_s for hold in held) < 0.005 * times_s[-1]


def test_a_source_that_scatters_more_than_a_window_covers_has_none() -> None:
    noise = random.Random(3)
    times_s = [at_s + noise.uniform(-0.02, 0.02) for at_s in steady(0.2, 500)]
    _, held = sail(NavigationWindow(GUARD_S, SHARE), one_source(times_s))
    assert len(held) < 50


@pytest.mark.parametrize("drift", [-1e-4, 1e-5, 1e-4])
def test_drift_is_followed(drift: float) -> None:
    """The period grows or shrinks by up to 100 ppm with each message: far beyond any oscillator."""
    times_s = list(accumulate((0.1 * (1 + drift) ** i for i in range(500)), initial=10.0))
    hits, _ = sail(NavigationWindow(GUARD_S, SHARE), one_source(times_s))
    assert sum(hits) > 480


@pytest.mark.parametrize("every", [3, 7, 50])
def test_a_missing_message_costs_its_own_window_only(every: int) -> None:
    times_s = [at_s for i, at_s in enumerate(steady(0.1, 400)) if i % every or i < 10]
    window = NavigationWindow(GUARD_S, SHARE)
    hits, _ = sail(window, one_source(times_s), end_s=49.95)
    assert sum(hits) == len(times_s) - 5
    assert window.misses == 400 - len(times_s)


def test_an_additional_message_does_no_harm() -> None:
    times_s = [at_s for i, at_s in enumerate(steady(0.1, 400)) for at_s in ([at_s, at_s + 0.013] if i % 10 == 9 else [at_s])]
    hits, _ = sail(NavigationWindow(GUARD_S, SHARE), one_source(times_s))
    assert sum(hits) >= 395 - 5


@pytest.mark.parametrize("factor", [0.5, 2.0, 0.2, 5.0])
def test_another_rate_is_learnt_within_seven_messages(factor: float) -> None:
    first = steady(0.1, 100)
    times_s = first + steady(0.1 * factor, 100, first[-1] + 0.1 * factor)
    hits, _ = sail(NavigationWindow(GUARD_S, SHARE), one_source(times_s))
    assert all(hits[5:100])
    assert all(hits[107:])


def test_two_sources_have_their_windows_each() -> None:
    arrivals = one_source(steady(0.1, 200), 1) + one_source(steady(0.25, 80, 10.037), 2)
    window = NavigationWindow(GUARD_S, SHARE)
    hits, _ = sail(window, arrivals)
    assert sum(hits) == len(arrivals) - 2 * 5
    assert sorted(window.report()["periods_s"]) == [0.1, 0.25]  # type: ignore[call-overload]


def test_two_sources_at_the_same_moment() -> None:
    arrivals = one_source(steady(0.1, 200), 1) + one_source(steady(0.1, 200, 10.0003), 2)
    hits, _ = sail(NavigationWindow(GUARD_S, SHARE), arrivals)
    assert sum(hits) > len(arrivals) // 2 - 5  # either of them may be met outside the other's window


def test_a_source_that_stops_is_not_waited_for() -> None:
    window = NavigationWindow(GUARD_S, SHARE)
    _, held = sail(window, one_source(steady(0.1, 50)), end_s=100.0)
    assert window.misses == MISSES_MAX
    assert held[-1].to_s < 16.0
    assert window.opens_s == inf


def test_a_source_that_comes_back_is_learnt_anew() -> None:
    window = NavigationWindow(GUARD_S, SHARE)
    hits, _ = sail(window, one_source(steady(0.1, 50) + steady(0.1, 50, 1000.0333)))
    assert hits == ([False] * 5 + [True] * 45) * 2


def test_a_source_that_is_forgotten_has_no_window() -> None:
    window = NavigationWindow(GUARD_S, SHARE)
    sail(window, one_source(steady(0.1, 50)))
    assert window.opens_s < inf
    window.forget(1)
    assert window.opens_s == inf


def test_no_share_no_window() -> None:
    hits, held = sail(NavigationWindow(GUARD_S, 0.0), one_source(steady(0.1, 50)))
    assert (sum(hits), held) == (0, [])


def test_a_window_that_the_loop_comes_too_late_for_is_late_and_not_held() -> None:
    window = NavigationWindow(GUARD_S, SHARE)
    sail(window, one_source(steady(0.1, 50)))
    now_s = window.opens_s + 0.03
    assert window.open(now_s) <= now_s
    window.close(now_s, now_s)
    assert (window.late, window.misses) == (1, 0)
    assert window.opens_s > now_s


def test_the_window_opens_a_guard_before_the_message() -> None:
    window = NavigationWindow(GUARD_S, SHARE)
    sail(window, one_source(steady(0.1, 50)))
    assert window.opens_s == pytest.approx(10.0 + 50 * 0.1 - GUARD_S, abs=1e-6)


@pytest.mark.parametrize("share", [0.02, 0.1])
def test_windows_in_vain_do_not_exceed_the_share(share: float) -> None:
    """Half of the messages are lost, so half of the windows are held for their whole length."""
    luck = random.Random(4)
    times_s = [at_s for at_s in steady(0.01, 2000) if luck.random() < 0.5]
    window = NavigationWindow(0.005, share)
    _, held = sail(window, one_source(times_s))
    assert window.misses > 100
    assert share * 15 < sum(hold.to_s - hold.from_s for hold in held) <= share * 20 + HOLD_MAX_S


@given(
    st.lists(st.tuples(st.floats(0.0, 0.5), st.integers(1, 3)), max_size=200),
    st.floats(1e-4, 0.05),
    st.floats(0.0, 1.0),
)
def test_whatever_comes_the_share_and_every_hold_are_bounded(gaps, guard_s, share):
    times_s = accumulate((gap_s for gap_s, _ in gaps), initial=10.0)
    arrivals = [(at_s, source) for at_s, (_, source) in zip(times_s, gaps, strict=False)]
    _, held = sail(NavigationWindow(guard_s, share), arrivals, end_s=200.0)
    assert all(0.0 <= hold.to_s - hold.from_s <= HOLD_MAX_S + 1e-9 for hold in held)
    assert all(one.to_s <= next_one.from_s + 1e-9 for one, next_one in pairwise(held))
    for i, first in enumerate(held):
        spent_s = 0.0
        for last in held[i:]:
            spent_s += last.to_s - last.from_s
            assert spent_s <= share * (last.to_s - first.from_s) + HOLD_MAX_S + 1e-6


@given(st.floats(0.003, 1.0), st.floats(0.0, 1000.0))
def test_every_rate_is_learnt(period_s: float, start_s: float) -> None:
    hits, _ = sail(NavigationWindow(GUARD_S, SHARE), one_source(steady(period_s, 30, start_s)))
    assert hits == [False] * 5 + [True] * 25
