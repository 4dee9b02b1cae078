"""The radio's line for real: the kernel's SLIP at the boat's end, ours on a TUN device at the other, a slow wire between."""

import json
from pathlib import Path
from typing import Any

import pytest

from tests.guest.harness import guest


def sailed(tmp_path: Path, encapsulation: str, mode: str, seconds: float) -> dict[str, Any]:
    with guest(tmp_path, modules=("slip", "tun"), memory_mib=256) as booted:
        result = booted.run(f"python tests/guest/guest_slip.py {encapsulation} {mode} {seconds}", timeout_s=60 + 12 * seconds)
        assert result.code == 0, result.output
        report: dict[str, Any] = json.loads(result.output.split("REPORT ", 1)[1])
        return report


@pytest.mark.timeout(240)
@pytest.mark.parametrize(("encapsulation", "mode"), [("cslip", "kernel"), ("slip", "user")])
def test_the_line_comes_up_favours_the_console_and_comes_back(tmp_path: Path, encapsulation: str, mode: str) -> None:
    report = sailed(tmp_path, encapsulation, mode, 4.0)
    assert report["interface"].startswith("sl" if mode == "kernel" else "radio")
    medians = report["medians"]
    assert medians["idle_ms"] < medians["lowdelay_ms"] < medians["loaded_ms"], "an urgent packet overtakes a download"
    assert report["bytes_per_s"] > 5000
    assert report["after_cut_s"] < 5.0
    assert report["after_carrier_s"] < 5.0
    assert report["exit_codes"] == [0, 0]
