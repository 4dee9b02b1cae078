"""A new service: one file and one row. It runs in the runtime or in a process of its own, is started again, and shows."""

import pytest

from delfim.console.link import Link
from delfim.errors import DelfimError
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


@pytest.mark.parametrize("place", ["runtime", "process"])
def test_a_new_service_runs_is_started_again_and_shows(tmp_path, place):
    copy = Enlarged(tmp_path / "copy")
    copy.file("delfim/services/tides.py", TIDES)
    copy.row("delfim/suite.py", '    Service("powerd", ', '    Service("tides", "delfim.services.tides:serve"),\n')
    with running(tmp_path, 14550, f'services.tides.place="{place}"', "mavlink.enabled=false", package=copy.place) as command:
        tides = dict[str, object]()
        while not (tides.get("state") == "running" and tides.get("restarts")):
            try:
                with Link(command, 60.0) as link:
                    tides = link.ask("state").get("services", {}).get("tides", {})
            except DelfimError:  # it does not run yet
                continue
        assert tides["place"] == place
