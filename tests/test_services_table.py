"""The table of services, and which rows of it a vehicle's file runs."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from delfim import config
from delfim.base.clock import SystemClock
from delfim.base.errors import PermanentFailure
from delfim.services.runtime import LoadedService, Runtime
from delfim.services.suite import SERVICES, Service, _limits, services
from delfim.services.supervision.cgroup import Limits

VEHICLE = Path(__file__).parents[1] / "etc" / "delfimx.toml"


def names(*overrides: str) -> list[str]:
    return [row.name for row in services(config.load(VEHICLE, overrides))]


def test_the_vehicle_starts_last_and_stops_first() -> None:
    assert names()[-1] == "vehicle"


@pytest.mark.parametrize(
    ("service", "override"),
    [
        ("canip", "canip.enabled=true"),
        ("timed", 'timed.mode="redundant"'),
        ("logd", "logd.nodes=[1]"),
        ("router", 'routing.buses.sonars={interface="can1", nodes=[48]}'),
        ("payload", 'payload.sonar.command=["/log/programs/sonar"]'),
    ],
)
def test_some_services_run_only_where_their_own_table_asks_for_them(service: str, override: str) -> None:
    assert service not in names()
    assert service in names(override)
    assert service not in names(override, f"services.{service}.enabled=false")


@pytest.mark.parametrize(
    ("overrides", "memory_bytes", "is_asked"),
    [
        ((), 256 << 20, False),
        (("simulation.faults=true",), 0, False),
        (("services.syslogd.memory_max_mb=64",), 64 << 20, True),
        (("services.syslogd.memory_max_mb=0",), 0, False),
    ],
)
def test_a_service_of_its_own_process_has_a_limit_of_memory_at_sea(overrides, memory_bytes, is_asked):
    settings = config.load(VEHICLE, overrides)
    (row,) = (row for row in services(settings) if row.name == "syslogd")
    assert _limits(settings, row) == Limits(memory_bytes, 0.0, is_asked)


def test_a_name_that_is_no_service_is_refused() -> None:
    with pytest.raises(PermanentFailure, match=r"services\.nonsense: there is no such service"):
        names('services.nonsense.place="process"')


def test_the_vehicle_stays_where_the_dead_man_watches() -> None:
    with pytest.raises(PermanentFailure, match="the vehicle runs in the runtime, which the dead-man watches"):
        names('services.vehicle.place="process"')


def test_each_row_names_a_coroutine_that_there_is() -> None:
    for row in SERVICES:
        module, _, name = row.entry.partition(":")
        start: Any = row.loaded()
        assert (start.__module__, start.__name__) == (module, name)


@pytest.mark.parametrize("late", [False, True])
def test_a_service_whose_package_is_missing_says_so_and_is_not_started_again(late: bool) -> None:
    row = Service("radar", "no_such_package.radar:serve")
    runtime = Runtime(config.load(VEHICLE), SystemClock(), alone=True)
    runtime.main([LoadedService(row.name, row.loading() if late else row.loaded())])
    assert runtime.status["radar"].state == "failed"
    assert "no_such_package is not installed" in runtime.status["radar"].reason


def test_the_supervisor_loads_none_of_the_services() -> None:
    """What it loads at sea it loads before the first actuation."""
    modules = "sys, delfim.services.suite, delfim.services.clock.kernel, delfim.services.supervision.supervisor"
    look = f"import {modules}; print(*sys.modules)"
    loaded = set(subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True).stdout.split())
    assert loaded & {"asyncio", "aiohttp", "pymavlink", "delfim.vehicle", "delfim.services.runtime"} == set()


def test_what_is_large_does_not_keep_the_vehicle_from_its_first_command() -> None:
    look = "import sys; from delfim import config; from delfim.services import suite\n"
    look += f"rows = suite.services(config.load({str(VEHICLE)!r}))\n"
    look += "[row.loading() if row.late else row.loaded() for row in rows if row.place == 'runtime']; print(*sys.modules)"
    loaded = set(subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True).stdout.split())
    assert "delfim.vehicle.loop" in loaded
    assert loaded & {"aiohttp", "pymavlink"} == set()
