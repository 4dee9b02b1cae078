"""The real program on the kernel's own CAN: nodes and boat meet on vcan0, candump looks on, navigation is pulled."""

import json
import math

import pytest

from tests.guest.harness import Guest


def test_the_boat_sails_on_a_real_bus_and_stops_when_navigation_is_pulled(can_guest: Guest) -> None:
    result = can_guest.run("python tests/guest/guest_sail.py", timeout_s=120.0)
    assert result.code == 0, result.output
    report = json.loads(result.output.split("REPORT ", 1)[1])
    before, after = report["before"], report["after"]

    moved_m = math.dist(
        (before["latitude_deg"] * 111e3, before["longitude_deg"] * 87e3),
        (after["latitude_deg"] * 111e3, after["longitude_deg"] * 87e3),
    )
    assert moved_m > 3.0, "the boat sailed"
    assert report["headers"] > 10, "navigation at 5 Hz for 8 s, and fewer where the host has other things to do"
    for frames in report["propulsion"]:
        assert frames == pytest.approx(report["headers"], abs=25), "four propulsion frames for each navigation message"
    # candump came and went at any moment, so a cycle at either end may be seen in part
    assert max(report["propulsion"]) - min(report["propulsion"]) <= 2, report["propulsion"]

    assert report["reason"].startswith("navigation silent for ")
    assert report["last_command"].startswith("000000"), "motor off"
    assert report["exit_code"] == 0
    assert any("/state/" in path for path in report["logs"])
    assert any("/vcan0/" in path for path in report["logs"])
