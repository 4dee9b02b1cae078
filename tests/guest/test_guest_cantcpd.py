"""cantcpd on the kernel's own CAN: what cangen sends reaches python-can's client as candump sees it, frame by frame."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.guest.harness import PATH, ROOT, Guest, missing


@pytest.mark.long
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


@pytest.mark.long
def test_a_client_on_another_computer_sees_every_frame_of_cangen(tmp_path: Path) -> None:
    """python-can's client on the host, the kernel's bus in the guest, a cable between them in a namespace of its own."""
    if reason := missing():
        pytest.skip(reason)
    command = ["unshare", "--map-root-user", "--net", sys.executable, "tests/guest/guest_cantcpd_host.py", str(tmp_path)]
    environment = {**os.environ, "PATH": PATH}
    result = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=200)
    assert result.returncode == 0, result.stdout + result.stderr
    report = json.loads(result.stdout.split("REPORT ", 1)[1])
    assert report["heard_all"]
    *candump, sent = report["candump"]
    kinds = [len(line.split()[2].partition("#")[0]) for line in candump]
    assert kinds == [3] * 1000 + [8] * 1000 + [3]
    assert report["python_can"] == candump, "every frame, in order, with the kernel's stamp to the microsecond"
    assert sent.endswith(" vcan0 7FD#01FF"), "what a client sends is on the bus"
