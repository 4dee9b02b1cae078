"""The wall clock is set while everything runs: only stamps may change with it."""

import json

import pytest

from tests.guest.harness import Guest

pytestmark = pytest.mark.long


def test_the_wall_clock_is_set_by_days_and_decades_and_nobody_notices(can_guest: Guest) -> None:
    result = can_guest.run("python tests/guest/guest_clock.py", timeout_s=240.0)
    assert result.code == 0, result.output
    report = json.loads(result.output.split("REPORT ", 1)[1])
    states = [state for each in report["states"] for state in each]
    assert {(state["mode"], state["reason"]) for state in states} == {("heading", "operator")}
    assert [notice for state in states for notice in state["notices"]] == []
    assert {name: each["restarts"] for name, each in report["programs"].items() if each["restarts"]} == {}
    assert report["failures"] == {}, report["reasons"]
    assert min(report["visits"].values()) >= 2, report["visits"]
    assert report["gap_s"] < 5.0, "no record is missing in the state log"
    steps = [round(event["value"] / 86_400.0) for event in report["steps"]]
    assert len(steps) == 6, "each step is in the black box's sidecar"
    assert steps[:2] == [1, -2]
