"""Motor controllers of others on their buses in simulation: they obey and report as real ones do, and so do their faults."""

import math
import os
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from delfim import config
from delfim.base.frames import Frame, extended
from delfim.base.modes import Mode
from delfim.canproxy.dronecan.datatypes import (
    ARMING_STATUS,
    ESC_STATUS,
    NODE_STATUS,
    OFF,
    ON,
    RAW_COMMAND,
    EscStatus,
    NodeStatus,
    decode,
    raw_command,
)
from delfim.canproxy.dronecan.fields import DataType
from delfim.canproxy.dronecan.transfers import COMMAND, Publisher, TransferReceiver
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import ANYTHING, CanAddress
from delfim.parts.dronecan.table import Dronecan
from delfim.parts.vesc import driver as vesc
from delfim.parts.vesc.table import Vesc
from delfim.simulator.faults import fault
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.nodes import nodes_of
from delfim.simulator.tables import Simulation
from delfim.simulator.workspace import Workspace, settings_of
from delfim.vehicle import console
from delfim.vehicle.state import NoLog, ThrusterReport
from tests.parts.pwm.test_pulsefiles import rows, written

FLOAT = Path(__file__).parents[2] / "etc/boats/float.toml"
GPS = config.Sysstat(required=("gps",))
MEASURING = ["dronecan", "vesc"]


def boat(driver: str, **changes: object) -> config.Vehicle:
    hull = config.BoatTable(name="skiff", length_m=4.0, beam_m=1.6)
    return config.Vehicle(boat=hull, thrusters=rows(driver, **changes), sysstat=GPS)


def under_way(settings: config.Vehicle, part: float = 0.6) -> Lockstep:
    """A boat that was driven ahead by hand for eight seconds."""
    run = Lockstep(settings, 1, lambda clock: NoLog())
    list(run.cycles(3.0))
    driven(run, 8.0, part)
    return run


def driven(run: Lockstep, seconds: float, part: float = 0.6) -> None:
    for _ in run.cycles(seconds):
        assert run.command(console.Manual(starboard=part, port=part)) is None


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("driver", MEASURING)
def test_controllers_report_what_their_motors_do(driver: str, turned: bool) -> None:
    run = under_way(boat(driver, reversed=turned))
    drive, report = run.nodes.model.drives["port"], run.state.thrusters["port"]
    assert drive.rpm == pytest.approx(0.6 * 1800.0, abs=5.0), "it pushes ahead, whichever way it is mounted"
    assert report.rpm == pytest.approx(drive.rpm, abs=5.0)
    assert report.voltage_v == pytest.approx(drive.voltage_v, abs=0.1)
    assert report.current_a == pytest.approx(drive.motor_a, abs=0.2)
    assert report.temperature_c == pytest.approx(drive.temperature_c, abs=0.3)
    assert report.faults is None
    assert report.current_a > 1.0
    assert not run.state.notices


COMMANDS = [("dronecan", "raw"), ("dronecan", "rpm"), ("vesc", "duty"), ("vesc", "current"), ("vesc", "rpm")]


@pytest.mark.parametrize("rate_hz", [2.0, 20.0])
@pytest.mark.parametrize(("driver", "command"), COMMANDS)
def test_they_obey_each_kind_of_command_at_each_rate_of_navigation(driver: str, command: str, rate_hz: float) -> None:
    tables = {driver: {"dronecan": Dronecan, "vesc": Vesc}[driver](command=command)}
    settings = msgspec.structs.replace(boat(driver), navigation=config.NavigationTable(rate_hz=rate_hz), **tables)
    run = under_way(settings, 0.5)
    assert [drive.part for drive in run.nodes.model.drives.values()] == pytest.approx([0.5, 0.5], abs=0.02)
    run.command(console.Stop())
    list(run.cycles(5.0))
    assert [drive.part for drive in run.nodes.model.drives.values()] == pytest.approx([0.0, 0.0], abs=0.02)


@pytest.mark.parametrize("kind", ["thruster_dead", "thruster_reversed"])
@pytest.mark.parametrize("driver", [*MEASURING, "dsor"])
def test_a_motor_that_fails_under_way_is_told_in_words_and_drops_out(driver: str, kind: str) -> None:
    settings = config.Vehicle(boat=config.BoatTable(name="thesis")) if driver == "dsor" else boat(driver)
    run = under_way(settings)
    run.breaks(fault(kind, "port"))
    driven(run, 8.0)
    assert [(each.name, each.action) for each in run.state.notices] == [("thruster", "warn")]
    assert "port propeller turns " in run.state.notices[0].reason
    assert ("turns -" in run.state.notices[0].reason) is (kind == "thruster_reversed")
    assert list(run.state.failed) == ["port"]


@pytest.mark.parametrize("driver", [*MEASURING, "dsor"])
def test_a_motor_that_does_not_stop_is_told_in_words(driver: str) -> None:
    settings = config.Vehicle(boat=config.BoatTable(name="thesis")) if driver == "dsor" else boat(driver)
    run = under_way(settings)
    run.breaks(fault("thruster_stuck", "starboard"))
    assert run.command(console.Stop()) is None
    list(run.cycles(6.0))
    assert run.state.mode is Mode.IDLE
    assert [each.name for each in run.state.notices if "starboard propeller turns" in each.reason] == ["thruster"]


@pytest.mark.parametrize("driver", MEASURING)
def test_a_controller_without_power_is_silent(driver: str) -> None:
    run = under_way(boat(driver))
    run.breaks(fault("battery_sag", "port", 0.0))
    driven(run, 12.0)
    assert "port propeller silent for" in run.state.notices[0].reason


@pytest.mark.parametrize("driver", ["pwm", "otter", "heron", "mavlink_front_seat"])
def test_motors_of_which_nobody_speaks_report_nothing(driver: str) -> None:
    run = under_way(boat(driver))
    assert run.nodes.beside == ()
    told = {name: report._replace(heard_s=0.0) for name, report in run.state.thrusters.items()}
    assert set(told.values()) <= {ThrusterReport(0.0)}, "of an outlet one hears that it writes, and no more"


def test_what_turns_does_so_with_the_number_of_its_actuator() -> None:
    steer = config.Steer(kind="azimuth", address=7, angle_max_deg=40.0, rate_dps=30.0)
    for way in ("unitless", "position"):
        row = config.ThrusterTable(name="outboard", driver="dronecan", x_m=-1.5, thrust_n=(-100.0, 150.0), steer=steer)
        settings = config.Vehicle(
            boat=config.BoatTable(name="skiff"), thrusters=(row,), sysstat=GPS, dronecan=Dronecan(steer=way)
        )
        run = Lockstep(settings, 1, lambda clock: NoLog())
        list(run.cycles(3.0))
        for _ in run.cycles(6.0):
            run.command(console.Manual(starboard=0.2, port=0.8))
        asked_rad = run.state.actuation.angle_rad[0]
        assert abs(asked_rad) > 0.1
        assert run.nodes.model.drives["outboard"].angle_rad == pytest.approx(asked_rad, abs=math.radians(0.5))


class Bench:
    """The controllers of a boat, told by hand."""

    def __init__(self, driver: str) -> None:
        nodes = nodes_of(boat(driver), 1)
        (self.devices,), self.model, self.now_s = nodes.beside, nodes.model, 10.0

    def hear(self, *frames: tuple[int, bytes]) -> None:
        for arb, data in frames:
            self.devices.feed(Frame(arb, data), self.now_s)

    def passes(self, seconds: float) -> list[Frame]:
        """Time in small steps; what they say meanwhile."""
        said = list[Frame]()
        for _ in range(round(seconds / 0.01)):
            self.now_s += 0.01
            self.model.advance(0.01)
            said += self.devices.step(self.now_s, 0)
        return said


class Speaker:
    """A computer that commands them."""

    def __init__(self) -> None:
        self._publishers = dict[DataType, Publisher]()

    def frames(self, kind: DataType, payload: bytes) -> list[tuple[int, bytes]]:
        return self._publishers.setdefault(kind, Publisher(kind, 10, COMMAND)).frames(payload)


def test_a_dronecan_controller_turns_only_when_armed_and_told_zero_first_and_stops_when_nobody_speaks() -> None:
    bench, speaker = Bench("dronecan"), Speaker()
    ahead, still = raw_command([0.5, 0.5]), raw_command([0.0, 0.0])

    def told(*said: tuple[DataType, bytes]) -> float:
        for _ in range(20):
            for kind, payload in said:
                bench.hear(*speaker.frames(kind, payload))
            bench.passes(0.05)
        return bench.model.drives["port"].part

    assert told((RAW_COMMAND, ahead)) == 0.0, "not armed"
    assert told((ARMING_STATUS, ON), (RAW_COMMAND, ahead)) == 0.0, "no zero yet"
    assert told((RAW_COMMAND, still)) == 0.0
    assert told((RAW_COMMAND, ahead)) > 0.4
    assert told() < 0.2, "nobody speaks"
    assert told((RAW_COMMAND, ahead)) > 0.4
    assert told((ARMING_STATUS, OFF), (RAW_COMMAND, ahead)) < 0.2


def test_a_dronecan_controller_says_its_state_and_that_of_its_motor() -> None:
    bench, receiver = Bench("dronecan"), TransferReceiver((ESC_STATUS, NODE_STATUS))
    heard = [transfer for frame in bench.passes(2.0) if (transfer := receiver.feed(frame, 1.0)) is not None]
    said = [(each.source, decode(each)) for each in heard]
    reports = [(node, each.motor) for node, each in said if isinstance(each, EscStatus)]
    assert set(reports) == {(20, 0), (21, 1)}
    assert len(reports) == pytest.approx(2 * 2 * 25, abs=4)
    assert {node for node, each in said if isinstance(each, NodeStatus) and each.health == 0} == {20, 21}
    assert dict(receiver.errors) == {}


def test_a_vesc_says_its_state_twenty_times_a_second_and_releases_its_motor_when_nobody_speaks() -> None:
    bench = Bench("vesc")
    for _ in range(20):
        bench.hear(vesc.pack_duty(1, 0.5))
        said = bench.passes(0.05)
    assert bench.model.drives["port"].part == pytest.approx(0.5 / 0.95, abs=0.05)
    assert bench.model.drives["starboard"].part == 0.0
    assert {frame.identifier for frame in said} == {kind << 8 | each for kind in (9, 16, 27) for each in (0, 1)}
    bench.passes(0.6)
    assert not bench.model.drives["port"].run


@pytest.mark.parametrize("driver", MEASURING)
def test_noise_moves_nothing(driver: str) -> None:
    bench = Bench(driver)
    for identifier in (0, 1, 0x100, 0x301, 16 << 24 | 1030 << 8 | 10, 8 << 24 | 1030 << 8 | 10, 16 << 24 | 1100 << 8 | 10):
        for data in (b"", b"\xff", b"\xc0", b"\xff\xc0", bytes(8), b"\xff" * 3):
            bench.hear((extended(identifier), data))
    bench.passes(1.0)
    assert all(math.isfinite(drive.rpm) for drive in bench.model.drives.values())


def test_in_real_time_the_maker_s_driver_speaks_on_a_bus_of_the_simulation(tmp_path: Path) -> None:
    """Never on the real bus of the file, whatever the bus of the boat's own nodes is."""
    for interface in ("canloop:can0", "vcan0"):
        for name in MEASURING:
            file = tmp_path / "boat.toml"
            file.write_text(written(config.Vehicle(boat=config.BoatTable(name="skiff"), thrusters=rows(name))))
            given = [f'simulation.interface="{interface}"']
            vehicle = config.load(file, given)
            simulated = config.load(file, [*given, *settings_of(vehicle, Workspace(2, tmp_path), ()).overrides])
            assert [row.driver for row in simulated.thrusters] == [name, name]
            bus = getattr(simulated, name).interface
            assert bus.startswith("canloop:")
            assert bus.endswith(f"-{name}")
            assert bus != getattr(config.load(file, settings_of(vehicle, Workspace(3, tmp_path), ()).overrides), name).interface


def test_a_boat_with_four_thrusters_keeps_on_with_three(tmp_path: Path) -> None:
    run = Lockstep(config.load(FLOAT), 1, lambda clock: NoLog())
    list(run.cycles(10.0))
    name = run.settings.thrusters[0].name
    while run.command(console.Heading(heading_deg=90.0, speed_mps=0.5)) is not None:
        list(run.cycles(1.0))
    list(run.cycles(5.0))
    run.breaks(fault("thruster_dead", name))
    list(run.cycles(25.0))
    assert list(run.state.failed) == [name]
    assert run.state.mode is Mode.HEADING


@pytest.mark.parametrize("driver", MEASURING)
def test_the_program_of_the_nodes_plays_them_in_real_time_unless_others_do(driver: str, tmp_path: Path) -> None:
    bus, file = f"canloop:{driver}-{os.getpid()}", tmp_path / "boat.toml"
    file.write_text(written(boat(driver)))
    values = (f'can.interface="{bus}-nodes"', f'{driver}.interface="{bus}"', f'runtime.run_directory="{tmp_path}"')
    with (
        open_can(bus) as ear,
        subprocess.Popen(
            [sys.executable, "-m", "delfim", "nodes", str(file), *(word for each in values for word in ("--set", each))]
        ) as nodes,
    ):
        ear.bind(ANYTHING)
        ear.settimeout(60.0)
        try:
            if driver == "vesc":
                turns = 0.0
                while turns < 1000.0:  # electrical
                    ear.sendto(vesc.pack_duty(0, 0.5)[1], CanAddress(extended(0)))
                    frame = ear.recvmsg()
                    told = vesc.unpack_status(frame.identifier, frame.data)
                    turns = told.electrical_rpm or turns if told is not None and told.controller == 0 else turns
            else:
                receiver, motors = TransferReceiver((ESC_STATUS,)), set[int]()
                while motors != {0, 1}:
                    transfer = receiver.feed(ear.recvmsg(), 0.0)
                    motors |= {decode(transfer).motor} if transfer is not None else set()
        finally:
            nodes.terminate()
    others = msgspec.structs.replace(boat(driver), simulation=Simulation(motors=False))
    assert nodes_of(others, 1).beside == ()
