"""cantcpd on the kernel's own CAN: what cangen sends reaches python-can's client as candump sees it, frame by frame."""

import json
import re

import pytest

from tests.guest.harness import Guest


@pytest.mark.timeout(180)
def test_python_can_sees_by_tcp_what_candump_sees_on_the_bus(can_guest: Guest) -> None:
    result = can_guest.run("python tests/guest/guest_cantcpd.py", timeout_s=120.0)
    assert result.code == 0, result.output
    report = json.loads(result.output.split("REPORT ", 1)[1])
    assert report["heard_all"]
    *candump, sent = report["candump"]
    assert len(candump) == 2001
    assert re.search(r" [0-9A-F]{3}#", candump[0])
    assert re.search(r" [0-9A-F]{8}#", candump[-2])
    assert report["python_can"] == candump
    assert report["python_can_stamps"] == report["candump_stamps"][:-1], "the kernel's own, to the microsecond"
    assert sent == "vcan0 7FD#01FF", "what a client sends is on the bus"
    assert report["exit_code"] == 0
