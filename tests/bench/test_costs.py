"""The benchmark of the largest inputs: each row is gone through by counts, and a callback that is too long fails it."""

import argparse
from itertools import count
from pathlib import Path

import pytest

from bench import costs
from bench.costs import Cost, Row, measured
from delfim import config
from tests.vehicle_fixtures import MOST_AT_ONCE, counted

__all__ = ["counted"]

VEHICLE = str(Path(__file__).parents[2] / "etc" / "delfimx.toml")


@pytest.mark.parametrize("most", [40, pytest.param(100, marks=pytest.mark.long)])
def test_no_slice_of_any_row_compares_more_than_it_may(monkeypatch, counted, most):
    monkeypatch.setattr(costs, "ROWS", most)  # waypoints, and circles; all zones and corners
    rows = costs.rows(config.load(VEHICLE))
    for row in rows:
        callbacks = row.callbacks()
        assert next(callbacks) is None, row.name
        assert sum(1 for _ in callbacks) > 0, row.name
    assert len({row.name for row in rows}) == len(rows)
    assert len(counted) > 4000
    assert max(counted) <= MOST_AT_ONCE


def test_each_callback_counts_with_the_best_of_its_repetitions():
    times = iter([0.0, 0.003, 0.0, 0.001, 0.0, 9.0, 0.0, 0.001, 0.0, 0.002, 0.0, 9.0])
    row = Row("row", lambda: iter([None, None, None]))
    assert measured(row, 2, lambda: next(times)) == Cost("row", 2, 1.0, 2.0)


@pytest.mark.parametrize(("longest_s", "code"), [(0.0004, 0), (0.0006, 1)])
def test_a_callback_beyond_the_budget_fails_it(longest_s, code, tmp_path, monkeypatch, capsys):
    ticks = count()
    monkeypatch.setattr(costs, "rows", lambda settings: [Row("largest", lambda: iter([None, None]))])
    monkeypatch.setattr(costs, "measured", lambda row, times: measured(row, times, lambda: next(ticks) * longest_s))
    asked = argparse.Namespace(file=VEHICLE, set=[], quick=True, output=str(tmp_path))
    assert costs.run(asked) == code
    assert ("over budget" in capsys.readouterr().out) is bool(code)
    assert "largest" in (tmp_path / "costs.json").read_text()
