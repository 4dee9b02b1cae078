"""The boat as an NMEA 2000 device on the kernel's own CAN: two of them, a bus that goes down and comes back."""

import json

import pytest

from tests.guest.harness import Guest


@pytest.mark.long
def test_devices_on_vcan_share_the_addresses_and_join_a_bus_that_was_down(can_guest: Guest) -> None:
    result = can_guest.run(
        "python -m tests.parts.nmea2000.nmea2000_pair vcan1; code=$?; ip link set vcan1 up; exit $code", timeout_s=200.0
    )
    assert result.code == 0, result.output
    report = json.loads(result.output.split("REPORT ", 1)[1])
    assert sorted(report["before"]) == [100, 101]
    assert sorted(report["after"]) == [100, 101]
    assert all("vcan1" in words or "Network is down" in words for words in report["troubles"]), report["troubles"]
    assert report["troubles_after"] == ["", ""]
    assert report["claims_after"] >= report["claims_before"] + 2, "they joined the bus anew"
