"""A process of tests that is killed, as by whoever stops `make test`, leaves no browser, gateway or boat behind."""

import os
import select
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BROWSER = "from tests.services import browser as b; import asyncio; asyncio.run(b._port(b._shared()[1] / 'DevToolsActivePort'))"
GATEWAY = "from tests.console.chain import *; Gateway(folder).start()"
BOAT = "from tests.console.chain import *; boat = afloat(folder / 'boat', 1, 9); asyncio.run(boat.__enter__().until(bool))"
PATIENCE_S = 200.0


def descendants(owner: int) -> list[int]:
    found = [int(each) for file in Path(f"/proc/{owner}/task").glob("*/children") for each in file.read_text().split()]
    return [*found, *(each for child in found for each in descendants(child))]


@pytest.mark.parametrize(("starts", "least"), [(BROWSER, 3), (GATEWAY, 1), (BOAT, 4)], ids=["browser", "gateway", "boat"])
def test_what_a_test_started_ends_when_its_process_is_killed(starts: str, least: int) -> None:
    with tempfile.TemporaryDirectory(prefix="left-", ignore_cleanup_errors=True) as folder:  # Chromium takes no longer path
        ends(folder, starts, least)


def ends(folder: str, starts: str, least: int) -> None:
    command = [
        sys.executable,
        "-c",
        f"import sys; from pathlib import Path; folder = Path(sys.argv[1]); {starts}; print('started', flush=True); input()",
        folder,
    ]
    env = os.environ | {"PYTHONPATH": str(ROOT), "TMPDIR": folder}
    with subprocess.Popen(command, env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as owner:
        assert owner.stdout
        assert owner.stdout.readline() == "started\n"
        started = descendants(owner.pid)
        watched = [os.pidfd_open(each) for each in started]
        owner.kill()
    left = [pid for pid, watch in zip(started, watched, strict=True) if not select.select([watch], [], [], PATIENCE_S)[0]]
    for watch in watched:
        os.close(watch)
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    assert len(started) >= least
    assert left == []
