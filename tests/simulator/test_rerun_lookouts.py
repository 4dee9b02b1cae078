"""What a radar and a sensor of the console's link see is in the log: a replay sees it too, and keeps clear of it bit by bit."""

import json
import math
from pathlib import Path

import pytest

from delfim.base.modes import Mode
from delfim.parts.mavlink.station import Station
from delfim.simulator import lockstep
from delfim.simulator.replay.rerun import rerun
from delfim.vehicle import console
from tests.logging.sailing import Day, logged
from tests.parts.mavlink.mavlink_console import Console, Radio

BODY, NOTHING = 12, 65_535


def around(day: Day) -> list[str]:
    return [each.name for each in day.sailing.state.traffic.targets]


def guarded(day: Day, seconds: float) -> set[str]:
    """The words of the guard's orders meanwhile."""
    words = set[str]()
    for _ in range(round(seconds)):
        day.sail(1.0)
        order = day.sailing.state.traffic.order
        words |= {order.words.partition(",")[0]} if order is not None else set()
    return words


def replayed(place: Path) -> None:
    result = rerun(logged(place), None)
    assert result.exact, result.text()
    assert result.cycles > 300


def test_targets_of_a_radar_come_from_the_black_box_of_its_line(tmp_path: Path) -> None:
    vessel = '{name="DHOW",transponder="none",north_m=350.0,east_m=0.0,course_deg=180.0,speed_mps=2.0}'
    day = Day(
        tmp_path,
        'sensors.names=["sysstat","nmea0183"]',
        'nmea0183.ports={radar={device="/dev/radar"}}',
        'simulation.things.lookout=[{port="radar",kind="radar"}]',
        f"simulation.traffic.vessel=[{vessel}]",
    )
    day.sail(15.0)
    assert any(name.startswith("radar ") for name in around(day))
    assert day.command(console.Course(0.0, 1.5)) is None
    assert guarded(day, 60.0), "it keeps clear of who comes"
    day.end()
    replayed(tmp_path)


def test_obstacles_of_mavlink_come_from_the_log_of_orders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lockstep, "WATCHDOG_S", 0.05)  # in each cycle, as at sea: a replay takes it to look ten times a second
    day = Day(tmp_path, "navigation.rate_hz=10.0")
    vehicle, radio = day.sailing.vehicle, Radio()

    def obey(command: console.Commands, operator: str) -> str | None:
        day.clock.advance(0.01)
        why = vehicle.on_command(command, operator)
        day.clock.advance(0.01)
        day.log.command(command, why, day.sailing.state, operator)
        return why

    link = Console(Station(vehicle, obey, radio, None), radio)
    link.beat()
    day.sail(5.0)
    assert day.command(console.Course(0.0, 1.5)) is None
    words, state = set[str](), day.sailing.state
    for _ in range(60):  # a buoy 40 m to the north of where the boat lay
        north_m, east_m = 40.0 - state.motion.north_m, -state.motion.east_m
        bearing_rad = math.atan2(east_m, north_m) - state.motion.heading_rad
        distances = [NOTHING] * 72
        distances[round(math.degrees(bearing_rad) / 5.0) % 72] = round(100.0 * math.hypot(north_m, east_m))
        link.say("obstacle_distance", 0, 0, distances, 5, 50, 6000, 0.0, 0.0, BODY)
        words |= guarded(day, 1.0)
    assert words, "it keeps clear of the buoy"
    assert any(name.startswith("lidar ") for name in around(day))
    assert state.mode is Mode.COURSE
    day.end()
    told = [json.loads(line) for file in logged(tmp_path) for line in Path(file.sidecar or "").read_text().splitlines()]
    assert sum(each["event"] == "command" and each["operator"] == "payload:sensor lidar" for each in told) > 40
    replayed(tmp_path)
