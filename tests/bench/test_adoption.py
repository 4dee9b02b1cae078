"""The bench of adoption: a trial of a hull of another hand, over UDP in lock step, and its table."""

import json
from pathlib import Path

import pytest

from bench import otherhulls
from bench.adoption import OTHERS, RADIUS_M, table, tried


@pytest.mark.long
def test_a_hull_of_another_hand_is_found_out_about(tmp_path: Path) -> None:
    row = tried(OTHERS + 1, 1, tmp_path / "a.trial", motors_alone=False)
    assert (row["motors"], row["ended"], row["refused"], row["place"]) == ("right", "", "", "")
    assert row["most_m"] < 1.25 * RADIUS_M
    assert abs(row["full_off"]) < 0.05
    assert abs(row["offset_off_deg"]) < 1.0
    assert row["deviation_off_deg"] < 1.5
    lines = list(table([json.loads(json.dumps(row, default=float))]))
    assert lines[2].startswith("| Heron, another hand | 1 | 1 | 0 | 0 | 1 |")


def test_the_hulls_of_a_number_are_the_same_each_time_and_their_days_differ() -> None:
    assert otherhulls.drawn(5, 2) == otherhulls.drawn(5, 2)
    one, other = otherhulls.drawn(5, 2), otherhulls.drawn(5, 3)
    assert (one.hull, one.dead) == (other.hull, other.dead)
    assert one.heading_rad != other.heading_rad
    assert otherhulls.full_mps(one) == otherhulls.full_mps(other)
