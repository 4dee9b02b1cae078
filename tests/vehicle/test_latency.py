"""The histogram of the critical path against plain arithmetic on the samples."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.vehicle.log.latency import EDGES_US, Latency
from delfim.vehicle.state import Profile


def added(paths_us: list[float]) -> Latency:
    latency = Latency()
    for path in paths_us:
        latency.add(Profile(1, 1, 1, 1, 1 + round(path * 1000), 1 + round(path * 1000)))
    return latency


@given(st.lists(st.floats(0.001, 1e6), min_size=1), st.floats(0.01, 1.0))
def test_percentiles_are_the_samples_within_the_resolution(paths, part):
    exact = sorted(paths)[max(0, -(-round(part * 1e9) * len(paths) // 10**9) - 1)]
    assert added(paths).percentile_us(part) == pytest.approx(exact, rel=0.051, abs=1.0)


@given(st.lists(st.floats(0.001, 1e6), min_size=1))
def test_worst_and_share(paths):
    latency = added(paths)
    assert latency.worst_us == pytest.approx(max(paths), abs=0.001)
    assert latency.within(100.0) == pytest.approx(sum(round(p * 1000) <= 100_000 for p in paths) / len(paths))


def test_a_stepped_clock_is_not_a_latency():
    latency = Latency()
    latency.add(Profile(100, 50, 50, 50, 50, 50))
    latency.add(Profile(0, 50, 50, 50, 50, 50))
    set_ns = 1_770_000_000_000_000_000
    latency.add(Profile(100_000_000_000, set_ns, set_ns, set_ns, set_ns, set_ns))  # the frame came in 1970
    assert latency.n == 0
    assert latency.facts().p99_us == 0


def test_the_first_cycles_of_a_program_that_comes_up_spoil_no_figure():
    latency = Latency(skipped=2)
    for path_us in (46_074, 9_000, 90, 110):
        latency.add(Profile(1, 1, 1, 1, 1 + path_us * 1000, 1 + path_us * 1000))
    assert (latency.n, latency.worst_us) == (2, 110)


def test_edges_rise():
    assert all(a < b for a, b in pairwise(EDGES_US))


@given(st.lists(st.floats(0.001, 1e6), min_size=1))
def test_every_cycle_is_in_the_bar_that_its_path_belongs_to(paths):
    bars = added(paths).facts().histogram
    assert sum(n for _, n in bars) == len(paths)
    assert bars == tuple(sorted(bars))
    for edge, _ in bars:
        exact = sum(round(path * 1000) <= edge * 1000 for path in paths)
        assert sum(n for other, n in bars if other <= edge) == pytest.approx(exact, abs=sum(abs(p - edge) < 0.1 for p in paths))
