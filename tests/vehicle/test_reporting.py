"""The boat's report as its program tells it, with the figures of the runtime."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from delfim import config
from delfim.base.clock import ManualClock
from delfim.services.vehicle import BoatReporting
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle.log.logbook import Logbook


def test_who_asks_before_anything_was_measured_is_answered(tmp_path: Path) -> None:
    """The door of the command socket opens before the watchdog turns for the first time."""
    settings = config.load("etc/delfimx.toml", [f'log.directory="{tmp_path}"'])
    runtime: Any = SimpleNamespace(
        config=settings,
        board={"traffic light": lambda: {"red": 1}},
        status={},
        report=lambda: {"services": {"httpd": {"state": "running"}}, "window": {"open": 1}},
    )
    logs = list[Logbook]()

    def log(clock: ManualClock) -> Logbook:
        logs.append(Logbook(settings, clock))
        return logs[-1]

    run = Lockstep(settings, 1, log)
    reporting = BoatReporting(runtime, run.vehicle, logs[-1])
    early = json.loads(reporting.report())
    assert (early["mode"], early["services"], early["deadman"]) == ("idle", {}, {})
    reporting.measure()
    told = json.loads(reporting.report())
    run.close()
    assert told["services"]["httpd"]["state"] == "running"
    assert (told["traffic light"], told["window"], told["deadman"]) == ({"red": 1}, {"open": 1}, {})
