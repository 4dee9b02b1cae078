"""A new service: one file and one row. It runs in the runtime or in a process of its own, is started again, and shows."""

import json
import socket
import urllib.request
from typing import Any

import pytest

from tests.afloat import running
from tests.enlarged import Enlarged

TIDES = '''"""Says how high the water is, after it failed once."""

import asyncio
from pathlib import Path

from delfim.services.runtime import Runtime


async def serve(runtime: Runtime) -> None:
    failed = Path(runtime.config.runtime.run_directory) / "failed"
    if not failed.exists():
        failed.touch()
        raise OSError("no water")
    with runtime.publishing("tides", lambda: {"height_m": 1.5}):
        await asyncio.Event().wait()
'''


def shown(port: int) -> dict[str, Any]:
    """What the page tells of the service."""
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/api/state") as page:
            state = json.load(page)
    except OSError:  # it does not run yet
        return {}
    return (state["services"] | ((state["computer"] or {}).get("supervisor") or {})).get("tides", {})


@pytest.mark.parametrize("place", ["runtime", "process"])
def test_a_new_service_runs_is_started_again_and_shows(tmp_path, place):
    copy = Enlarged(tmp_path / "copy")
    copy.file("delfim/services/tides.py", TIDES)
    copy.row("delfim/suite.py", '    Service("powerd", ', '    Service("tides", "delfim.services.tides:serve"),\n')
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    values = (f'services.tides.place="{place}"', f'httpd.listen="127.0.0.1:{port}"', "mavlink.enabled=false")
    with running(tmp_path, 14550, *values, package=copy.place):
        while not ((tides := shown(port)).get("state") == "running" and tides["restarts"]):
            pass
        assert tides["place"] == place
