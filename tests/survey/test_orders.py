"""The order of a survey's lines beside the one that OR-tools' routing found, whose lengths are kept in a file."""

import json
from statistics import median

from bench.orders import KEPT, SEEDS, survey_of, whole_m


def test_the_order_of_lines_makes_no_survey_5_percent_longer_than_or_tools_does() -> None:
    kept_m = {int(seed): length_m for seed, length_m in json.loads(KEPT.read_text()).items()}
    assert list(kept_m) == list(SEEDS)
    plans = {seed: survey_of(seed) for seed in SEEDS}
    longer = [whole_m(plan, plan.lines) / kept_m[seed] for seed, plan in plans.items()]
    assert max(longer) <= 1.05
    assert median(longer) <= 1.01
    assert min(longer) > 0.9, "other areas than those that were searched"
