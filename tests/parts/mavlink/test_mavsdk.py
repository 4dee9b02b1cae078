"""MAVSDK, a program that others wrote for other vehicles, against the running one: over UDP, in real time."""

import asyncio
import os
import subprocess
import sys
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path

import pytest
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.geofence import GeofenceAsync
from mavsdk.asyncio.plugins.mission import MissionAsync
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.action import ActionError
from mavsdk.plugins.geofence import Circle, FenceType, GeofenceData, Point, Polygon
from mavsdk.plugins.mission import MissionItem as PlanItem
from mavsdk.plugins.mission import MissionPlan
from mavsdk.plugins.mission_raw import MissionItem, MissionRawError

from delfim.console.plans.planwriting import written
from delfim.vehicle.operator.link import Link
from tests.afloat import running

PORT = 20_000 + os.getpid() % 10_000  # below those that the kernel gives away
PLACES = [(38.6909, -9.2149), (38.6912, -9.2149), (38.6912, -9.2145)]


async def until(what: Callable[[], Awaitable[bool]]) -> None:
    while not await what():
        await asyncio.sleep(0.05)


async def armed(action: ActionAsync) -> bool:
    """It is refused while navigation is late, on a busy machine."""
    with suppress(ActionError):
        await action.arm()
        return True
    return False


def items(places: list[tuple[float, float]] = PLACES) -> list[MissionItem]:
    return [
        MissionItem(n, 6, 16, int(n == 0), 1, 0.0, 3.0, 0.0, float("nan"), round(lat * 1e7), round(lon * 1e7), 0.0, 0)
        for n, (lat, lon) in enumerate(places)
    ]


async def changed(mission: MissionRawAsync) -> None:
    """While it is sailed: one point more; but not another one to steer for."""
    await mission.upload_mission(items([*PLACES, (38.6909, -9.2141)]))
    assert len(await mission.download_mission()) == 4
    with pytest.raises(MissionRawError, match="DENIED"):
        await mission.upload_mission(items([(38.6915, -9.2149), *PLACES[1:]]))


async def read_by_others(mission: MissionRawAsync) -> None:
    """Plans that the console writes, as this program imports those of QGroundControl and Mission Planner."""
    stops = [{"latitude_deg": north, "longitude_deg": east, "acceptance_m": 3.0} for north, east in PLACES]
    fence = [[38.68, -9.23], [38.70, -9.23], [38.70, -9.20]]
    plan = {"name": "a", "waypoints": stops, "fence": fence, "home": stops[0]}
    importers = {
        ".plan": mission.import_qgroundcontrol_mission_from_string,
        ".waypoints": mission.import_mission_planner_mission_from_string,
    }
    for kind, imported in importers.items():
        told = await imported(written(kind, plan)[1].decode())
        ways = [(each.x / 1e7, each.y / 1e7, each.param2) for each in told.mission_items if each.command == 16]
        assert ways[-len(PLACES) :] == [(*place, 3.0) for place in PLACES]
        if kind == ".plan":
            assert [(each.x / 1e7, each.y / 1e7) for each in told.geofence_items] == [tuple(corner) for corner in fence]
            assert [(each.x / 1e7, each.y / 1e7) for each in told.rally_items] == PLACES[:1]


async def sailed(path: Path) -> list[str]:
    """Everything that a program does with a boat; the modes that the boat was in after each step."""
    modes: list[str] = []

    def mode() -> str:
        """Home is near: it may have been reached, and the boat holds."""
        with Link(path) as link:
            state = link.ask("state")
        return "home" if state["reason"] == "home done" else str(state["mode"])

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
        await until(lambda: armed(action))
        await mission.start_mission()
        modes.append(mode())

        async def moving() -> bool:
            v = await telemetry.velocity_ned()
            return abs(v.north_m_s) + abs(v.east_m_s) > 0.3

        await until(moving)
        await changed(mission)
        for pause in (mission.pause_mission, action.hold):
            await pause()
            modes.append(mode())
            await mission.start_mission()
            modes.append(mode())
        with Link(path) as link:
            assert link.ask("state")["reason"] == "operator continues"
        await action.return_to_launch()
        modes.append(mode())
        await action.disarm()
        modes.append(mode())
        await mission.clear_mission()
        assert await mission.download_mission() == []
    return modes


async def planned(path: Path, home: bool) -> None:
    """A mission by the high-level interface, there and back; then a take-off, which is nothing for a boat. `home`: item 0 is
    that to an ArduRover, and to this interface a place like others."""
    async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as sdk:
        await sdk.add_any_connection(f"udpin://127.0.0.1:{PORT}")
        system = await sdk.first_autopilot(timeout_s=60.0)
        assert system is not None
        mission, action = MissionAsync(system), ActionAsync(system)
        await read_by_others(MissionRawAsync(system))

        async def fit() -> bool:
            with Link(path) as link:
                lines = link.ask("state")["checks"]
                return all(line["ok"] for line in lines if line["name"] in ("navigation", "sensors", "log"))

        await until(fit)
        kind = {"relative_altitude_m": 0.0, "speed_m_s": 1.2, "is_fly_through": True, "acceptance_radius_m": 3.0}
        north, south = (
            [Point(38.6890 + n, -9.2200 + e) for n, e in ((a, 0), (a, 0.01), (a + 0.002, 0.01), (a + 0.002, 0))]
            for a in (0.0015, 0)
        )
        areas = [Polygon(corners, FenceType.INCLUSION) for corners in (north, south)]
        await GeofenceAsync(system).upload_geofence(
            GeofenceData(areas, [Circle(Point(38.70, -9.22), 300.0, FenceType.INCLUSION)])
        )
        await mission.set_return_to_launch_after_mission(True)
        kind["camera_action"] = PlanItem.CameraAction.TAKE_PHOTO
        places = [PlanItem(*place, **kind) for place in [*PLACES[:1] * home, *PLACES]]
        await mission.upload_mission(MissionPlan(places))
        aboard = (await mission.download_mission()).mission_items[int(home) :]
        assert [(round(each.latitude_deg, 7), round(each.longitude_deg, 7)) for each in aboard] == PLACES
        assert [each.acceptance_radius_m for each in aboard] == [3.0] * 3
        assert {each.camera_action for each in aboard} == {PlanItem.CameraAction.TAKE_PHOTO}
        assert await mission.get_return_to_launch_after_mission()
        with pytest.raises(ActionError, match=r"COMMAND_DENIED|UNSUPPORTED"):
            await action.takeoff()
        await asyncio.sleep(1.0)
        with Link(path) as link:
            state = link.ask("state")
        assert state["mode"] in ("idle", "goto")
        assert [each["thrust"] for each in state["thrusters"].values()] == [0.0, 0.0]


@pytest.mark.long
@pytest.mark.parametrize("autopilot", ["generic", "ardurover"])
def test_a_mission_of_the_high_level_interface_comes_back_and_a_take_off_moves_nothing(tmp_path, autopilot):
    with running(tmp_path, PORT, f'mavlink.autopilot="{autopilot}"') as path:
        asyncio.run(asyncio.wait_for(planned(path, autopilot == "ardurover"), 240))


def test_connect_watch_upload_download_start_hold_return_disarm(tmp_path):
    """And what was sailed so repeats bit by bit from its logs: nothing moved the boat that is not in them."""
    with running(tmp_path, PORT) as path:
        modes = asyncio.run(asyncio.wait_for(sailed(path), 240))
    assert modes == ["idle", "play", "hold", "play", "hold", "play", "home", "idle"]
    words = [sys.executable, "-m", "delfim", "log", "replay", str(tmp_path / "log")]
    replayed = subprocess.run(words, capture_output=True, text=True, timeout=200, check=False)
    assert "all the same, bit by bit" in replayed.stdout, replayed
