"""A board without a battery clock, from 1970 to sailing, on a real kernel whose clock is really set."""

import json
from datetime import UTC, datetime
from pathlib import Path

import pytest

from tests.guest.harness import guest, missing

WIRE = "ip link add can0 type vxcan peer name sea0; ip link set can0 up; ip link set sea0 up\n"


@pytest.mark.long
@pytest.mark.timeout(400)
def test_a_board_that_starts_in_1970_gets_its_time_in_idle_and_sails(tmp_path: Path) -> None:
    """Frames through vxcan come from elsewhere, as those of a real node do; a computer's own time frames are none."""
    if reason := missing():
        pytest.skip(reason)
    with guest(tmp_path, modules=("vxcan", "can-raw")) as board:
        result = board.run(WIRE + "python tests/guest/guest_1970.py", timeout_s=300.0)
    assert result.code == 0, result.output
    report = json.loads(result.output.split("REPORT ", 1)[1])
    before, after = report["before"], report["after"]

    assert before["at_s"] < 1000.0, "it was 1970"
    assert before["state"]["clock"]["kept"] == after["state"]["clock"]["kept"] == "kept by this program"
    assert after["state"]["clock"]["source"] == "the time frame"
    assert after["state"]["mode"] == "idle", "it was stepped in idle"
    assert abs(report["off_s"]) < 0.3
    assert (before["ssh"], after["ssh"], after["ftp"][:3]) == (True, True, "200"), "open sessions go on"
    assert {(state["mode"], state["reason"]) for state in report["sailed"]} == {("heading", "operator")}
    assert [state["notices"] for state in report["sailed"] if state["notices"]] == []
    assert {state["clock"]["fault"] for state in report["sailed"]} == {""}
    assert report["restarts"] == {}
    assert report["failures"] == {}, report["reasons"]
    assert min(report["visits"].values()) >= 1, report["visits"]

    state_step = [event for event in report["steps"] if event.get("source")]
    assert [event["source"] for event in state_step] == ["the time frame"], "the state log notes who stepped"
    assert len(report["steps"]) == 2, "and so does the black box"
    assert all(event["value"] > 50 * 365.25 * 86_400.0 for event in report["steps"])
    assert report["gap_s"] < 5.0, "no record is missing in the state log"
    words = [json.loads(line)["text"] for line in report["said"]]
    assert [each for each in words if each.startswith("clock: stepped by ")], "and the system log"
    page, metrics, api = report["page"]
    assert "kept by this program, compared with the time frame" in page
    assert 'delfim_clock_offset_seconds{source="the time frame"}' in metrics
    check = next(line for line in json.loads(api)["vehicle"]["checks"] if line["name"] == "clock")
    assert check["ok"], check
    assert check["reason"].endswith("; kept by this program, compared with the time frame")
    today = f"{datetime.now(UTC):%Y%m%d}"
    for log in ("can0", "state"):
        days = [name.split("/")[0] for name in report["files"] if f"/{log}/" in name]
        assert days == [today], "after the step a log has the name of the day on which it began"
