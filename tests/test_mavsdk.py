"""MAVSDK, a program that others wrote for other vehicles, against the running one: over UDP, in real time."""

import asyncio
import os
import subprocess
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.mission_raw import MissionItem

from delfim.console.link import Link
from tests.afloat import running

PORT = 20_000 + os.getpid() % 10_000  # below those that the kernel gives away
PLACES = [(38.6909, -9.2149), (38.6912, -9.2149), (38.6912, -9.2145)]


async def until(what: Callable[[], Awaitable[bool]]) -> None:
    while not await what():
        await asyncio.sleep(0.05)


def items() -> list[MissionItem]:
    return [
        MissionItem(n, 6, 16, int(n == 0), 1, 0.0, 3.0, 0.0, float("nan"), round(lat * 1e7), round(lon * 1e7), 0.0, 0)
        for n, (lat, lon) in enumerate(PLACES)
    ]


async def sailed(path: Path) -> list[str]:
    """Everything that a program does with a boat; the modes that the boat was in after each step."""
    modes: list[str] = []

    def mode() -> str:
        with Link(path) as link:
            return str(link.ask("state")["mode"])

    async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as sdk:
        await sdk.add_any_connection(f"udpin://127.0.0.1:{PORT}")
        system = await sdk.first_autopilot(timeout_s=60.0)
        assert system is not None
        assert await system.get_system_id() == 2
        telemetry, action, mission = TelemetryAsync(system), ActionAsync(system), MissionRawAsync(system)

        async def afloat() -> bool:
            here = await telemetry.position()
            return abs(here.latitude_deg - 38.6907) < 0.001 and abs(here.longitude_deg + 9.2153) < 0.001

        async def healthy() -> bool:
            with Link(path) as link:
                return all(
                    line["ok"] for line in link.ask("state")["checks"] if line["name"] in ("navigation", "sensors", "log")
                )

        await until(afloat)
        await until(healthy)
        await mission.upload_mission(items())
        aboard = await mission.download_mission()
        assert [(each.command, each.x, each.y, each.param2) for each in aboard] == [
            (each.command, each.x, each.y, each.param2) for each in items()
        ]
        await action.hold()
        modes.append(mode())
        await action.arm()
        await mission.start_mission()
        modes.append(mode())

        async def moving() -> bool:
            v = await telemetry.velocity_ned()
            return abs(v.north_m_s) + abs(v.east_m_s) > 0.3

        await until(moving)
        await action.hold()
        modes.append(mode())
        await mission.start_mission()
        await action.return_to_launch()
        modes.append(mode())
        await action.disarm()
        modes.append(mode())
        await mission.clear_mission()
        assert await mission.download_mission() == []
    return modes


def test_connect_watch_upload_download_start_hold_return_disarm(tmp_path):
    """And what was sailed so repeats bit by bit from its logs: nothing moved the boat that is not in them."""
    with running(tmp_path, PORT) as path:
        modes = asyncio.run(asyncio.wait_for(sailed(path), 90))
    assert modes == ["idle", "play", "idle", "home", "idle"]
    words = [sys.executable, "-m", "delfim", "log", "replay", str(tmp_path / "log")]
    replayed = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    assert "all the same, bit by bit" in replayed.stdout, replayed
