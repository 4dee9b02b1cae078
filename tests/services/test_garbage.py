"""Garbage is collected in quiet time, and looked for again soon where it is not quiet."""

import gc
from types import SimpleNamespace
from typing import cast

import pytest

from delfim.base.clock import ManualClock
from delfim.services.priority.garbage import COLLECT_AGAIN_S, COLLECT_EVERY_S, Collector
from delfim.services.priority.window import NavigationWindow


@pytest.fixture
def collected(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The generations that were collected. There is garbage of 800 objects."""
    generations = list[int]()
    monkeypatch.setattr(gc, "isenabled", lambda: False)
    monkeypatch.setattr(gc, "get_count", lambda: (800, 0, 0))
    monkeypatch.setattr(gc, "get_threshold", lambda: (700, 10, 10))
    monkeypatch.setattr(gc, "collect", generations.append)
    return generations


def test_it_waits_for_a_quiet_moment_and_not_for_the_next_tick(collected: list[int]) -> None:
    """Navigation at 100 Hz is in step with ten ticks a second: if one is not quiet none is, until thousands of objects wait and
    take milliseconds."""
    clock = ManualClock()
    window = SimpleNamespace(opens_s=clock.monotonic_s() + 0.001)
    collector = Collector(cast(NavigationWindow, window), clock)
    assert collector._look() == COLLECT_AGAIN_S
    assert collected == []
    window.opens_s += 0.009
    assert collector._look() == COLLECT_EVERY_S
    assert collected == [0]


def test_what_is_long_overdue_is_collected_at_once(collected: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    clock = ManualClock()
    monkeypatch.setattr(gc, "get_count", lambda: (7001, 0, 0))
    collector = Collector(cast(NavigationWindow, SimpleNamespace(opens_s=clock.monotonic_s())), clock)
    assert collector._look() == COLLECT_EVERY_S
    assert collected == [0]
