"""The black box on a full bus of the kernel: not one frame missing, and what it costs beside `candump | gzip`.

--minutes 10 is the long form.
"""

import json

import pytest

from bench.critical_path import build
from tests.guest.harness import Guest

pytestmark = pytest.mark.long

FRAMES_PER_S = 7700


@pytest.mark.timeout(3600)
def test_every_frame_of_a_full_bus_is_in_the_black_box(can_guest: Guest, request: pytest.FixtureRequest) -> None:
    seconds = 60.0 * request.config.getoption("--minutes")
    feeder = build(can_guest.folder)["feeder"]
    command = f"python tests/guest/guest_blackbox.py {feeder} {FRAMES_PER_S} {seconds:g}"
    result = can_guest.run(command, timeout_s=120.0 + 3 * seconds)
    assert result.code == 0, result.output
    report = json.loads(result.output.split("REPORT ", 1)[1])
    print(f"measured: {json.dumps(report)}")
    assert report["logged"] == report["sent"] > 7000 * seconds
    assert report["in_order"]
    assert "frames lost" not in report["sidecars"]
