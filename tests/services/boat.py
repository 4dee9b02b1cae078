"""A boat that answers as the vehicle does, and a service running in the test's own loop: what the daemons' tests stand on."""

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from delfim import config
from delfim.base.clock import SystemClock
from delfim.services.runtime import Runtime
from delfim.vehicle.operator.command import CommandServer

STATE: dict[str, Any] = {
    "mode": "play",
    "reason": "operator",
    "boat": "Test",
    "cycle": 1000,
    "utc_ns": 1_795_231_735_093_121_524,
    "source": "dsor",
    "latitude_deg": 38.6906848,
    "longitude_deg": -9.2152974,
    "heading_deg": 131.65,
    "speed_mps": 1.306,
    "satellites": 10,
    "thrusters": {"starboard": {"thrust": 0.727, "rpm": 870.0, "current_a": 3.0, "age_s": 0.1}, "port": {"thrust": -0.6}},
    "reference": {"heading_deg": 113.64, "speed_mps": 1.5, "cross_track_m": 1.1, "distance_m": 28.01, "leg": 0},
    "mission": "Doca",
    "legs": 12,
    "age_s": {"navigation": 0.177, "console": 1.014, "guest": None, "gps": 0.269, "batteries_port": 4.9},
    "sysstat": {
        "gps": {"fix": 3, "status": "good", "faults": []},
        "batteries_port": {"voltage_v": 53.88, "charge": 0.4, "status": "bad", "faults": ["overheated"]},
    },
    "counts": {"navigation_jumps": 3},
    "latency": {
        "n": 1000,
        "p50_us": 37.0,
        "p99_us": 101.0,
        "p999_us": 203.0,
        "worst_us": 640.2,
        "within_100_us": 0.98,
        "stages_us": {"poll": 12.0, "navigation": 10.0, "control": 6.0, "propulsion": 9.0, "log": 20.0},
        "histogram": [[32.0, 300], [40.0, 400], [100.0, 280], [126.0, 17], [638.1, 2], [704.0, 1]],
    },
    "log": {"writable": True, "reason": "", "file": "/log/x", "bytes": 3061, "records": 18, "dropped": 0},
    "services": {
        "vehicle": {"place": "runtime", "state": "running", "for_s": 5.1, "restarts": 0, "reason": "", "pid": 1, "busy_s": 0.1},
        "canzlogd": {"place": "runtime", "state": "waiting", "for_s": 1.0, "restarts": 4, "reason": "bus off", "pid": 1},
    },
    "checks": [{"name": "navigation", "ok": True, "reason": "dsor"}, {"name": "log", "ok": False, "reason": "disk full"}],
    "notices": [{"name": "battery_low", "reason": "batteries port at 12 %", "age_s": 3.0, "action": "home"}],
}


def vehicle_file(tmp_path: Path, **tables: Any) -> config.Vehicle:
    """A vehicle's file whose places are all in `tmp_path`."""
    (tmp_path / "log").mkdir(exist_ok=True)
    return config.Vehicle(
        boat=config.BoatTable(name="Test"),
        console=config.Console(socket=str(tmp_path / "command")),
        log=config.LogTable(directory=str(tmp_path / "log"), free_bytes_min=0),
        runtime=config.RuntimeTable(run_directory=str(tmp_path)),
        **tables,
    )


@contextlib.asynccontextmanager
async def vehicle(settings: config.Vehicle, state: dict[str, Any]) -> AsyncIterator[CommandServer]:
    """The vehicle's command socket, saying `state`, which the test may change."""
    reviews = SimpleNamespace(cancel=lambda reason: None)
    commands = CommandServer(lambda command, operator: None, reviews, lambda: json.dumps(state).encode(), 16)
    server = await asyncio.get_running_loop().create_unix_server(commands.connection, settings.console.socket)
    try:
        yield commands
    finally:
        commands.close()
        server.close()


@contextlib.asynccontextmanager
async def served(settings: config.Vehicle, serve: Callable[[Runtime], Awaitable[None]], name: str) -> AsyncIterator[Runtime]:
    """A service, from the moment it shows where it is until the test is over; then it must end at once."""
    runtime = Runtime(settings, SystemClock(), alone=True)
    task = asyncio.create_task(serve(runtime))
    try:
        async with asyncio.timeout(200):
            while name not in runtime.board and not task.done():
                await asyncio.sleep(0.01)
        if task.done():
            await task
        yield runtime
    finally:
        task.cancel()
        async with asyncio.timeout(200):
            with contextlib.suppress(asyncio.CancelledError):
                await task
