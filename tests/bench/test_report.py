"""What the benchmark makes of its samples."""

import math

import pytest

from bench import report
from bench.report import Cycle, over_budget, within


def cycles(*paths_us: float) -> list[Cycle]:
    """Cycles of these lengths, all of it in the poll stage but the last microsecond."""
    return [Cycle(1000, round((us - 1) * 1000) + 1000, *[round(us * 1000) + 1000] * 4) for us in paths_us]


def test_percentiles() -> None:
    ordered = [float(n) for n in range(1000)]
    assert [report.percentile(ordered, part) for part in (0.0, 0.5, 0.99, 0.999, 1.0)] == [0, 500, 990, 999, 999]
    assert report.percentile([], 0.5) is None


def test_a_missing_sample_is_longer_than_all() -> None:
    """Nine of ten are there: the median is known, the worst is not."""
    ordered = [float(n) for n in range(9)]
    assert [report.percentile(ordered, part, 10) for part in (0.5, 0.89, 0.9, 0.99)] == [5.0, 8.0, None, None]


def test_figures_of_a_known_distribution() -> None:
    got = report.figures(cycles(*[50.0] * 990, *[150.0] * 9, 3000.0), 1000)
    assert (got["cycles"], got["p50_us"], got["p99_us"], got["p999_us"], got["worst_us"]) == (1000, 50, 150, 3000, 3000)
    assert got["within_100_us"] == 0.99
    assert got["lost"] == 0
    assert sum(got["histogram"]) == 1000
    assert got["histogram"][33] == 990
    assert report.EDGES_US[33] <= 50 < report.EDGES_US[34]


def test_stages_of_a_loop_that_was_awake_before_the_last_frame() -> None:
    """It began to read 20 us before t0: its poll stage is zero and its navigation stage starts at t0."""
    got = report.figures([Cycle(100_000, 80_000, 110_000, 115_000, 135_000, 150_000)], 1)
    assert got["stages_us"] == {"poll": 0.0, "navigation": 10.0, "control": 5.0, "propulsion": 20.0, "log": 15.0}
    assert got["p50_us"] == 35.0


def test_figures_of_nothing() -> None:
    got = report.figures([], 0)
    assert (got["cycles"], got["p50_us"], got["worst_us"], got["within_100_us"]) == (0, None, 0.0, 0.0)


def test_a_loop_that_passes_messages_over_gains_nothing_by_it() -> None:
    got = report.figures(cycles(*[50.0] * 970), 1000)
    assert (got["cycles"], got["lost"], got["p50_us"], got["p99_us"], got["within_100_us"]) == (970, 30, 50.0, None, 0.97)
    told = report.compared(got, report.figures(cycles(*[50.0] * 1000), 1000), {"p50": 1.0, "p99": 1.0, "p999": 1.0}, 0.0)
    assert told["verdict"] == {"p50": "held", "p99": "missed", "p999": "too few cycles"}


def test_samples_outside_the_histogram_are_kept() -> None:
    counts = report.histogram([0.1, 5.0, 1e9])
    assert sum(counts) == 3
    assert (counts[0], counts[-1]) == (1, 1)


def test_noise_of_a_quiet_and_of_a_loud_machine() -> None:
    half = [float(n) for n in range(20, 1020)]
    assert report.noise(cycles(*half), cycles(*half)) == {"p50": 1.0, "p99": 1.0, "p999": 1.0}
    loud = report.noise(cycles(*half), cycles(*[2 * us for us in half]))
    assert loud == report.noise(cycles(*[2 * us for us in half]), cycles(*half))
    assert all(factor is not None and math.isclose(factor, 2.0, rel_tol=0.01) for factor in loud.values())
    assert report.noise([], cycles(*half)) == {"p50": None, "p99": None, "p999": None}


@pytest.mark.parametrize(
    ("ratio", "factor", "limit", "beyond", "expected"),
    [
        (1.0, 1.0, 1.0, 100, "held"),
        (1.01, 1.0, 1.0, 100, "missed"),
        (1.1, 1.1, 1.25, 100, "held"),
        (1.2, 1.1, 1.25, 100, "too noisy to tell"),
        (1.3, 1.1, 1.25, 100, "too noisy to tell"),
        (1.4, 1.1, 1.25, 100, "missed"),
        (0.2, 3.0, 1.0, 100, "held"),
        (0.9, 1.0, 1.0, 4, "too few cycles"),
        (None, 1.0, 1.0, 100, "missed"),
        (1.0, None, 1.0, 100, "too few cycles"),
    ],
)
def test_verdict(ratio: float | None, factor: float | None, limit: float, beyond: float, expected: str) -> None:
    assert report.verdict(ratio, factor, limit, beyond) == expected


def test_comparison_names_what_too_few_cycles_cannot_tell() -> None:
    c, fast = report.figures(cycles(*[100.0] * 2000), 2000), report.figures(cycles(*[50.0] * 2000), 2000)
    got = report.compared(fast, c, {"p50": 1.0, "p99": 1.0, "p999": 1.0}, 0.02)
    assert got["ratio"] == {"p50": 0.5, "p99": 0.5, "p999": 0.5}
    assert got["verdict"] == {"p50": "held", "p99": "held", "p999": "too few cycles"}


def test_on_a_machine_that_others_use_nothing_is_held_and_nothing_missed() -> None:
    c, fast = report.figures(cycles(*[100.0] * 9000), 9000), report.figures(cycles(*[50.0] * 9000), 9000)
    for row in (c, fast):
        got = report.compared(row, fast, {"p50": 1.0, "p99": 1.0, "p999": 1.0}, 0.3)
        assert set(got["verdict"].values()) == {"too noisy to tell"}


@pytest.mark.parametrize(
    ("mine", "by_c", "taken", "said"),
    [
        (0.999, 0.996, 0.0, "held, 99.90%"),
        (0.997, 0.996, 0.0, "missed, 99.70%"),
        (0.997, 0.996, 0.3, "too noisy to tell, 99.70%"),
        (0.9, 0.994, 0.0, "not asked, for C has 99.40%"),
    ],
)
def test_the_share_within_100_us_is_asked_where_c_shows_that_the_machine_allows_it(mine, by_c, taken, said):
    assert within({"within_100_us": mine}, {"within_100_us": by_c}, taken).startswith(said)


@pytest.mark.parametrize(
    ("per_s", "others_share", "beyond"), [(0.9, 0.0, []), (1.1, 0.0, ["httpd"]), (1.1, 0.11, [])], ids=["few", "many", "noisy"]
)
def test_a_service_with_too_many_long_callbacks_is_named_on_a_quiet_machine(per_s, others_share, beyond):
    row = {"competitor": "delfim", "over_budget_per_s": {"canzlogd": 0.0, "httpd": per_s}}
    assert over_budget({"others_share": others_share, "steal_share": 0.0, "rows": [row]}) == beyond
