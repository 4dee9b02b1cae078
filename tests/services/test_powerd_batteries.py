"""powerd on boats whose batteries or motors are not DelfimX's own: it hears of them from the vehicle, as a console does."""

import asyncio
import contextlib
import os
import signal
import socket
import struct
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest

from delfim import config
from delfim.base.clock import ManualClock, SystemClock
from delfim.canproxy.dsor.messages import BatteriesStatus, Fault, Status
from delfim.canproxy.nmea2000 import instruments
from delfim.canproxy.opening import open_bound
from delfim.canproxy.socket import ANYTHING, CanAddress, CanSocket
from delfim.parts.frontseats.table import MavlinkFrontSeat
from delfim.parts.nmea2000.table import Nmea2000
from delfim.services import powerd
from delfim.services.powerd import FRESH_S, Powerd, is_told_by_vehicle
from delfim.services.runtime import LoadedService, Runtime
from delfim.services.supervision import shutdown
from delfim.services.tables import PowerdTable
from delfim.vehicle.console import answer
from delfim.vehicle.links import Links
from delfim.vehicle.operator.command import CommandServer
from delfim.vehicle.propulsion.actuators import open_actuator
from delfim.vehicle.report import reported
from delfim.vehicle.snapshot import in_json, report
from delfim.vehicle.state import Actuation, State
from tests.canproxy.test_instruments import Bus
from tests.parts.dronecan.test_dronecan_sensors import BATTERY, battery, heard
from tests.services.test_powerd import batteries
from tests.vehicle import test_drivers as drivers

NO_REVIEWS = SimpleNamespace(cancel=lambda why: None)
OFF, AHEAD = Actuation((0.0, 0.0), (0.0, 0.0), False), Actuation((0.5, 0.5), (0.0, 0.0), True)


class Boat:
    """powerd, a clock, and a vehicle that tells its state five times a second."""

    def __init__(self, settings: config.Vehicle, state: State) -> None:
        assert is_told_by_vehicle(settings)
        self.clock, self.settings, self.state = ManualClock(), settings, state
        self.powerd = Powerd(settings.powerd, self.clock, watches=True)

    def goes_on(self, seconds: float, sent: Actuation = OFF, *, tells: bool = True, reports: bool = True) -> str:
        """For so long; returns why the power is to be cut, or nothing. `reports`: batteries and motors are heard."""
        self.state.actuation = sent
        for _ in range(round(seconds * 5)):
            self.clock.advance(0.2)
            now_s = self.clock.monotonic_s()
            if reports:
                self.state.sysstat = {name: (told, now_s) for name, (told, _) in self.state.sysstat.items()}
                self.state.thrusters = {name: told._replace(heard_s=now_s) for name, told in self.state.thrusters.items()}
            if tells:
                told = in_json(report(self.state, now_s, self.settings.thrusters))
                self.powerd.on_state(reported(answer(None, told)))
            self.powerd.look()
        return self.powerd.reason


def dronecan() -> tuple[config.Vehicle, State]:
    """A battery on DroneCAN, at 4 %, as pydronecan makes its frames."""
    sensors = config.Sensors(names=("dronecan",))
    return config.Vehicle(boat=config.BoatTable(name="test"), sensors=sensors), heard((battery(4), BATTERY))


def nmea2000() -> tuple[config.Vehicle, State]:
    """A battery monitor on NMEA 2000, at 4 %."""
    bus = Bus(batteries=(1,))
    bus.say(instruments.BATTERY, struct.pack("<BhhHB", 1, 2310, -123, 29_315, 0), 1, 0.0)
    bus.say(instruments.BATTERY_CHARGE, struct.pack("<BBBBBHHH", 0, 1, 0, 4, 255, 0xFFFF, 0xFFFF, 0xFFFF), 1, 0.0)
    return config.Vehicle(boat=config.BoatTable(name="test"), nmea2000=Nmea2000(batteries=(1,))), bus.state


def told_by_motors(name: str, **tables: config.Table) -> tuple[config.Vehicle, State]:
    """Motors that say what their battery has, as their played devices do: a VESC 24.1 V, an ArduRover 80 %."""
    settings, wire, state = drivers.settings(name, **tables), drivers.Wire(), State()
    interface = f"canloop:powerd-motors-{os.getpid()}"
    with contextlib.ExitStack() as opened:

        def bus(_: str, filters: tuple[CanAddress, ...]) -> CanSocket:
            return opened.enter_context(open_bound(settings.can, interface, filters))

        device = drivers.DRIVERS[name].device(bus("", (ANYTHING,)), wire)
        driver = open_actuator(name, settings, Links(bus, lambda *_: wire))
        device.report(0.0)
        for each in driver.inputs:
            each.read(state, 0.0)
    return settings, state


def vesc() -> tuple[config.Vehicle, State]:
    return told_by_motors("vesc", powerd=PowerdTable(battery_v=24.5))


def board() -> tuple[config.Vehicle, State]:
    return told_by_motors(
        "mavlink_front_seat",
        mavlink_front_seat=MavlinkFrontSeat(battery=True),
        powerd=PowerdTable(battery_charge=0.8),
    )


@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        (dronecan, "batteries at 4%"),
        (nmea2000, "batteries at 4%"),
        (vesc, "batteries at 24.1 V"),
        (board, "batteries at 80%"),
    ],
)
def test_an_empty_battery_of_any_kind_ends_a_boat_that_nobody_drives(kind, reason):
    boat = Boat(*kind())
    wait_s = boat.settings.powerd.battery_s
    assert boat.goes_on(2 * wait_s, AHEAD) == "", "an operator drives it home on its last charge"
    assert boat.goes_on(wait_s - 1.0) == ""
    assert boat.goes_on(2.0) == reason


@pytest.mark.parametrize("kind", [dronecan, nmea2000, vesc, board])
def test_a_battery_that_fell_silent_ends_nothing(kind):
    boat = Boat(*kind())
    boat.goes_on(1.0)
    assert boat.goes_on(300.0, reports=False) == ""


def test_a_voltage_above_the_level_and_one_without_a_battery_end_nothing():
    settings, state = vesc()
    for volts in (24.6, 0.3):
        state.thrusters = {name: told._replace(voltage_v=volts) for name, told in state.thrusters.items()}
        assert Boat(settings, state).goes_on(300.0) == ""


def test_a_boards_charge_counts_only_where_the_file_says_so():
    _, state = told_by_motors("mavlink_front_seat")
    assert not state.sysstat


def test_an_own_battery_beside_other_motors_ends_no_boat_that_is_driven():
    """Its motors are on another bus, where powerd hears no command."""
    settings = msgspec.structs.replace(vesc()[0], powerd=PowerdTable(battery_s=10.0))
    boat = Boat(settings, State())
    for _ in range(60):
        boat.powerd.on_frame(batteries(0.01))
        assert boat.goes_on(1.0, AHEAD) == ""
    for _ in range(11):
        boat.powerd.on_frame(batteries(0.01))
        boat.goes_on(1.0)
    assert boat.powerd.reason == "batteries at 1%"


def test_while_the_vehicle_is_silent_nobody_knows_whether_it_is_driven():
    settings = msgspec.structs.replace(vesc()[0], powerd=PowerdTable(battery_s=10.0))
    boat = Boat(settings, State())
    for _ in range(60):
        boat.powerd.on_frame(batteries(0.01))
        boat.powerd.on_silence("the vehicle does not answer")
        assert boat.goes_on(1.0, tells=False) == ""
    assert boat.powerd.report()["vehicle"] == "the vehicle does not answer"
    for _ in range(round(11 + FRESH_S)):
        boat.powerd.on_frame(batteries(0.01))
        boat.goes_on(1.0)
    assert boat.powerd.reason == "batteries at 1%"
    assert boat.powerd.report()["vehicle"] == ""


def test_a_boat_that_is_all_delfimx_asks_nobody():
    for file in ("etc/delfimx.toml", "etc/delfimx-sea.toml"):
        assert not is_told_by_vehicle(config.load(Path(__file__).parents[2] / file)), file


def test_the_service_asks_the_supervisor_when_the_vehicle_tells_of_an_empty_battery(tmp_path: Path):
    settings = config.load(
        Path(__file__).parents[2] / "etc/delfimx.toml",
        [
            f'can.interface="canloop:powerd-told-{os.getpid()}"',
            f'runtime.run_directory="{tmp_path}"',
            f'console.socket="{tmp_path}/command"',
            "powerd.battery_v=40.0",
            "powerd.battery_s=0.1",
        ],
    )
    runtime, state = Runtime(settings, SystemClock(), alone=True), State()
    power = BatteriesStatus(Status.GOOD, Fault(0), 39.5, None, None, None)

    def told_now() -> bytes:
        now_s = runtime.clock.monotonic_s()
        state.sysstat["batteries_starboard"] = power, now_s
        return in_json(report(state, now_s, settings.thrusters))

    async def vehicle(runtime: Runtime) -> None:
        commands = CommandServer(lambda command, operator: None, NO_REVIEWS, told_now, 1)
        loop = asyncio.get_running_loop()
        async with await loop.create_unix_server(commands.connection, settings.console.socket):
            with runtime.ticking(0.05, commands.publish):
                told.append(await loop.sock_recv(supervisor, 100))
            commands.close()
            while commands.clients:
                await asyncio.sleep(0)
        os.kill(os.getpid(), signal.SIGTERM)

    told: list[bytes] = []
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as supervisor:
        supervisor.bind(str(shutdown.socket_path(tmp_path)))
        supervisor.setblocking(False)
        runtime.main([LoadedService("vehicle", vehicle), LoadedService("powerd", powerd.serve)])
    assert told == [b"off batteries at 39.5 V"]
